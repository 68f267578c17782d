//! What lights a scene. Directions are in world space, densities in solid angle at the shading point.
//!
//! [`EnvironmentLight`] alone lights a scene without other lights; [`LightSampler`] draws from it and from all others together:
//! an [`EmitterLight`] of emissive triangles, points and spots, and light from single directions.
//! [`LightGroups`] says which part of the light a direction belongs to.

mod cache;
mod distribution;
mod emitters;
mod envmap;
mod groups;
mod punctual;
mod sampler;
mod tree;

pub(crate) use cache::LightSampleCache;
pub(crate) use emitters::LightId;
pub use emitters::{EmissiveTriangle, EmitterLight, Receiver, Selection};
pub use envmap::{EnvironmentLight, EnvironmentSample, MAX_RADIANCE, Repairs, Sampling};
pub use groups::LightGroups;
pub(crate) use punctual::{Arriving, direction_and_distance};
pub use punctual::{DistantLight, Lamp};
pub use sampler::{LightSample, LightSampler, Lights, Source};
