//! The fusion network: it renders a frame from everything that is known about it. The G-buffer is always given. The terms of
//! deferred shading, warped keyframes, and a few traced samples of the frame and of its neighbours are optional.
//!
//! The network does not paint the picture itself. It weighs and corrects the pictures that it is given: it predicts kernels that
//! filter the samples (Bako et al. 2017; on three scales, as in Balint et al. 2023), one factor for each term of deferred
//! shading, the weights of all candidates, and a residual. Its last layers begin at zero, so that an untrained network returns
//! the best of its input pictures.
//!
//! - [`record`] defines the numbers that are stored for a pixel, and the channels that the network reads;
//! - [`fill`] makes records from G-buffers, deferred shading, keyframes and samples;
//! - [`graph`] is the U-Net;
//! - [`head`] computes the picture from the outputs of the U-Net, with derivatives;
//! - [`batch`] draws random crops with exact augmentations;
//! - [`loss`] is the loss;
//! - [`training`] is the training loop;
//! - [`mod@render`] is inference.

pub mod batch;
pub mod fill;
pub mod graph;
mod grow;
pub mod head;
pub mod loss;
pub mod record;
pub mod render;
pub mod training;

#[cfg(test)]
mod team_tests;

pub use graph::{FusionConfig, FusionNet};
pub use record::{Groups, Record};
pub use render::Fusion;
