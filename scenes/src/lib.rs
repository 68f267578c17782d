//! Scenes: a serde description with its JSON Schema, validation, loading of glTF and OBJ, and a seeded procedural composer.
//!
//! It is *not* a renderer: the result, [`LoadedScene`], is plain data (meshes, materials, textures, cameras) that a renderer compiles.
#![forbid(unsafe_code)]

pub mod description;
pub mod loaded;
pub mod shapes;
pub mod sky;

pub use loaded::{Instance, LoadReport, LoadedScene, Material, Mesh, Texture, TextureSlot};
