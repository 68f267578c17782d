//! Measurements: what each subcommand of `renderflow bench` does.

pub mod clock;
#[allow(unsafe_code)]
pub mod embree;
pub mod kernels;
