//! Single-step neural renderer: network, bridge matching, training, inference, LPIPS

pub mod bridge;
pub mod data;
pub mod device;
pub mod error;
pub mod fusion;
pub mod inverse;
pub mod kernels;
pub mod lpips;
pub mod network;
pub mod ops;
pub mod parameters;
pub mod renderer;
pub mod train;
pub mod wan;
pub mod weights;

pub use data::{Clip, ClipSource};
pub use error::{Error, Result};
