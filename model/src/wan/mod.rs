//! The network of the paper: the Wan2.1 video autoencoder and diffusion transformer, the VACE context path, and the renderer that
//! is made of them ([`flow`]).
//!
//! Latents and pictures in the interface of this module are `[batch, channels, frames, height, width]` in f32. Inside, tensors
//! are channels-last, as [`crate::ops`] needs them. Making a network takes no memory for its weights ([`init`]): they are drawn,
//! or read from a file, when they are first needed. Weights files use the layout of diffusers or the original layout ([`names`],
//! [`weights`]).
//!
//! Sources: Wan (Wan Team 2025, arXiv 2503.20314) and VACE (Jiang et al. 2025, arXiv 2503.07598), both published under
//! Apache-2.0.

pub mod activations;
pub mod config;
mod config_file;
pub mod dit;
pub mod flow;
pub mod init;
pub mod layers;
pub mod names;
pub mod pictures;
pub mod train;
pub mod vace;
pub mod vae;
pub mod video;
pub mod weights;

pub use activations::Activation;
pub use config::{DitConfig, Gelu, VaceConfig, VaeConfig};
pub use dit::{Dit, DitInput};
pub use flow::{Flow, FlowConfig};
pub use vace::Vace;
pub use vae::Vae;
pub use video::{Autoencoder, open};
