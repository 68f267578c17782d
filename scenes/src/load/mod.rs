//! Loads everything a scene refers to, once each: environment, model files, textures, shapes, cameras of all frames.

mod build;
mod gltf;
mod mesh;
mod model;
mod obj;

pub use build::load;
pub use model::{Format, ModelView, describe_model};

/// Can the transform be undone in single precision? Renderers need its inverse for normals and rays.
fn invertible(transform: glam::Affine3A) -> bool {
    let determinant = transform.matrix3.determinant();
    transform.is_finite() && determinant.is_normal() && transform.inverse().is_finite()
}
