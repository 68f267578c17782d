//! The module `renderflow._renderflow`. The package in `python/renderflow` gives it its public form, with types and defaults.

mod arrays;
mod fusion;
mod metrics;
mod neural;
mod render;
mod scene;
mod work;

use pyo3::prelude::*;

/// What the package `renderflow` is made of.
#[pymodule]
mod _renderflow {
    use super::*;

    #[pymodule_export]
    use super::fusion::{Batch, Network, Sequence, draw, tiers};
    #[pymodule_export]
    use super::metrics::Lpips;
    #[pymodule_export]
    use super::metrics::{flip, psnr, ssim};
    #[pymodule_export]
    use super::neural::{Neural, denoise, denoiser};
    #[pymodule_export]
    use super::render::{decode_frame, deferred, gbuffer, render};
    #[pymodule_export]
    use super::scene::{Scene, compose, describe, load};
    #[pymodule_export]
    use super::work::Error;

    /// Runs the command line and ends the process with its exit code.
    #[pyfunction]
    fn main(arguments: Vec<std::ffi::OsString>) {
        std::process::exit(renderflow::cli::main_with(arguments).into());
    }

    /// The version of the program.
    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
