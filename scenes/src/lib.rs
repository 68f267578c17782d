//! Scenes: a serde description with its JSON Schema, validation, loading of glTF, OBJ and PLY, and a seeded procedural composer.
//!
//! It is *not* a renderer: the result, [`LoadedScene`], is plain data (meshes, materials, textures, cameras) that a renderer
//! compiles.
#![forbid(unsafe_code)]

pub mod catalog;
pub mod description;
mod draw;
pub mod error;
mod family;
pub mod ies;
pub mod load;
pub mod loaded;
pub mod mipmap;
mod model_format;
mod noise;
pub mod pattern;
pub mod procedural;
pub mod schema;
pub mod seed;
pub mod shapes;
pub mod sky;
mod tangents;
mod texture;
pub mod validate;

pub use description::{Principled, Scene};
pub use error::{Error, Problem, Result};
pub use loaded::{Instance, LoadReport, LoadedScene, Material, Mesh, Texture, TextureSlot, TriangleReport};
