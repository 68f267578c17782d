//! Measurements: the scenes they run on, their errors, and what each subcommand of `renderflow bench` does.

pub mod clock;
#[allow(unsafe_code)]
pub mod embree;
pub mod export;
pub mod kernels;
pub mod metrics;
pub mod models;
pub mod peers;
pub mod scenes;
