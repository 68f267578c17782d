//! One network for everything that may be known of a frame: its G-buffer, and where they are given the terms of deferred shading, keyframes
//! carried to it, a few traced samples of it and of its neighbours.
//!
//! The network does not draw. It weighs and corrects pictures that are given: samples are filtered by kernels that it predicts (Bako et
//! al. 2017; on three scales, as Balint et al. 2023), terms of deferred shading get a factor each, candidates are mixed, and a residual
//! is added. Its last layers begin at zero, so that an untrained network gives the best of the pictures it was handed.
//!
//! - [`record`] says what is stored of a pixel and what the network reads of it;
//! - [`fill`] makes records from G-buffers, deferred shading, keyframes and samples;
//! - [`graph`] is the U-Net;
//! - [`head`] goes from its outputs to the picture, with derivatives;
//! - [`batch`] draws random crops with exact augmentations;
//! - [`loss`] is the loss;
//! - [`training`] is the loop;
//! - [`mod@render`] is inference.

pub mod batch;
pub mod fill;
pub mod graph;
pub mod head;
pub mod loss;
pub mod record;
pub mod render;
pub mod training;

pub use graph::{FusionConfig, FusionNet};
pub use record::{Groups, Record};
pub use render::Fusion;
