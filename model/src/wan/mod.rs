//! The graph of the paper: the Wan2.1 video autoencoder and diffusion transformer, with the VACE context path, and the renderer made
//! of them ([`flow`]).
//!
//! Latents and pictures are `[batch, channels, frames, height, width]` in f32 at this module's border; inside, everything is
//! channels-last, so that the arithmetic is that of [`crate::ops`]. A network is made without touching memory for its weights
//! ([`init`]): they are drawn, or read from a file, when they are first needed. Weights come in the layout of diffusers and in
//! the original one ([`names`], [`weights`]).
//!
//! Sources: Wan (Wan Team 2025, arXiv 2503.20314) and VACE (Jiang et al. 2025, arXiv 2503.07598), both published under Apache-2.0.

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
