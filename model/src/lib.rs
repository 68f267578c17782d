//! Single-step neural renderer: network, bridge matching, training, inference, LPIPS

pub mod bridge;
pub mod config;
pub mod data;
pub mod error;
pub mod features;
pub mod fusion;
pub mod infer;
pub mod kernels;
pub mod keyframe;
pub mod lpips;
pub mod network;
pub mod ops;
pub mod parameters;
pub mod renderer;
pub mod tokens;
pub mod train;
pub mod wan;
pub mod weights;

pub use config::NetworkConfig;
pub use data::{Clip, ClipSource};
pub use error::{Error, Result};
pub use infer::{Keyframe, NeuralRenderer, PreparedKeyframe};
