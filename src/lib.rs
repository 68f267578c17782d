//! RenderFlow: from a seed to an evaluated neural image.
//!
//! This package is the only one that knows every part: it renders sequences to folders ([`truth`], [`dataset`]), trains on them,
//! and compares what the network makes of a G-buffer with path-traced truth ([`evaluate`], by [`metrics`], on the sets of
//! [`testset`]), for a page one can read ([`report`]). The command line is in [`cli`]. What it costs, and how it compares with
//! others, is measured beside it, in the package `renderflow-bench`.
#![forbid(unsafe_code)]

#[macro_use]
pub mod console;

pub mod cli;
pub mod clock;
pub mod dataset;
pub mod evaluate;
pub mod inspect;
pub mod learning;
pub mod machine;
mod memory;
pub mod metrics;
pub mod output;
pub mod progress;
pub mod ranges;
pub mod report;
pub mod stop;
pub mod testset;
pub mod truth;
