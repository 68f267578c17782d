//! Single-step neural renderer: network, bridge matching, training, inference, LPIPS

pub mod kernels;
pub mod ops;
