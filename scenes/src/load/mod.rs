//! Loads everything a scene refers to, once each: environment, model files, textures, shapes, cameras of all frames.

mod build;
mod mesh;
mod model;

pub use build::load;
pub use model::{Format, ModelView, describe_model};
