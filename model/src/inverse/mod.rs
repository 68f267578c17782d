//! The inverse network: it reads one picture and finds what the picture shows, without its light: albedo, normals, depth and
//! material of every pixel.
//!
//! The network does not paint the albedo itself. It predicts, in each pixel, how the picture must be changed to become the albedo
//! ([`head`]), so that the albedo keeps the detail of the picture. An untrained network returns the picture as albedo, with a
//! little less contrast.
//!
//! - [`example`] defines what is learned from a frame;
//! - [`graph`] is the U-Net;
//! - [`head`] computes the buffers from the outputs of the U-Net, with derivatives;
//! - [`batch`] draws random crops with augmentations;
//! - [`loss`] is the loss;
//! - [`training`] is the training loop;
//! - [`find`] is inference.

pub mod batch;
pub mod example;
pub mod find;
pub mod graph;
pub mod head;
pub mod loss;
pub mod training;

pub use find::{Found, Inverse};
pub use graph::{InverseConfig, InverseNet};
