//! Single-step neural renderer: network, bridge matching, training, inference, LPIPS

pub mod error;
pub mod kernels;
pub mod lpips;
pub mod ops;

pub use error::{Error, Result};
