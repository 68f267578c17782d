//! Measures RenderFlow: rays, error against time, what is skipped, what a sequence keeps, and the same scenes in other renderers.
//!
//! Nothing here is part of the product. The program `renderflow-bench` has one command for each measurement; `docs/benchmarks.md`
//! says what their numbers mean. Unsafe code is in [`embree`] alone, which calls a C library.
#![deny(unsafe_code)]

// Output that is lost costs lines and not work, here as in the product.
#[macro_use]
extern crate renderflow;

pub mod cli;
pub mod composed;
pub mod convergence;
#[allow(unsafe_code)]
pub mod embree;
pub mod export;
pub mod files;
pub mod frame;
pub mod gallery;
pub mod kernels;
pub mod models;
pub mod orbit;
pub mod peers;
pub mod reference;
pub mod scaling;
pub mod scenes;
pub mod skip;
pub mod stages;

use renderflow::util::machine;
use serde::{Deserialize, Serialize};

/// What the numbers were measured with.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Machine {
    /// Version of this program.
    pub version: String,
    /// Name of the processor.
    pub processor: String,
    /// Threads that render.
    pub threads: usize,
}

impl Machine {
    /// This one.
    pub fn current() -> Self {
        Self { version: env!("CARGO_PKG_VERSION").into(), processor: machine::processor(), threads: rayon::current_num_threads() }
    }
}
