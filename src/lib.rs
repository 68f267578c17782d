//! RenderFlow: from a seed to an evaluated neural image.
//!
//! This package is the only one that knows every part. It renders sequences to folders and prepares them for training
//! ([`dataset`]), compares what the networks make of a G-buffer with path-traced truth ([`evaluate`], by [`metrics`]), and writes
//! pages about it ([`report`]). [`view`] is the page of an interactive viewer. The command line is in [`cli`]; `src/README.md`
//! says where everything is. The package `renderflow-bench` measures what the program costs, and how it compares with others.
#![forbid(unsafe_code)]

#[macro_use]
pub mod util;

pub mod cli;
pub mod dataset;
pub mod evaluate;
pub mod metrics;
pub mod paper;
pub mod report;
pub mod view;
