//! What lights a scene. Directions are in world space, densities in solid angle at the shading point.
//!
//! [`EnvironmentLight`] alone lights a scene without emitters; [`LightSampler`] draws from it and an [`EmitterLight`] together.
//! [`LightGroups`] says which part of the light a direction belongs to.

mod cache;
mod distribution;
mod emitters;
mod envmap;
mod groups;
mod sampler;

pub(crate) use cache::LightSampleCache;
pub use emitters::{EmissiveTriangle, EmitterLight, EmitterSample};
pub use envmap::{EnvironmentLight, EnvironmentSample, MAX_RADIANCE, Repairs, Sampling};
pub use groups::LightGroups;
pub use sampler::{LightSample, LightSampler, Source};
