//! CPU path tracer: compiled scenes, Disney materials, environment light, G-buffers, film.
//!
//! [`RenderScene::compile`] turns a loaded scene into what rays need. [`render`] path-traces a frame with its G-buffer,
//! [`render_gbuffer`] traces camera rays alone, [`ibl::render`] shades them with the split sum, and [`deferred`] with shadow maps
//! and screen-space effects.
//!
//! It is *not* a scene format (see `renderflow-scenes`) and writes no files (see `renderflow-frame`).

pub mod accel;
mod angle;
pub mod camera;
mod clear;
mod compile;
pub mod deferred;
pub mod denoise;
mod error;
pub mod features;
pub mod film;
mod geometry;
mod integrator;
mod interaction;
pub mod light;
pub mod material;
mod number;
mod query;
mod random;
pub mod ray;
#[cfg(feature = "record")]
pub mod record;
pub mod sampler;
mod schedule;
mod settings;
mod simd;
mod skips;
mod stats;
mod texture;
pub mod verify;

pub use camera::{Filter, Shutter, ThinLens};
pub use compile::{Clear, RenderScene};
pub use error::{Error, Result};
pub use film::Film;
pub use geometry::{Builds, Sharing};
pub use integrator::{
    Memory, detail::detail_map, develop, expose, expose_whole, ibl, render, render_gbuffer, render_gbuffer_until, render_mapped,
    render_with_shutter, render_with_stats,
};
pub use light::LightGroups;
pub use material::Mode;
pub use sampler::Sampler;
pub use schedule::Progress;
pub use settings::{Budget, DirectLight, Settings};
pub use skips::{Channels, Skips};
pub use stats::Stats;
