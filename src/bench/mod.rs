//! Measurements: the scenes they run on, their errors, and what each subcommand of `renderflow bench` does.

pub mod metrics;
pub mod models;
pub mod scenes;
