//! Checks of numerical stability as counts, shared by the tests and the `stress` command.

pub mod geometry;
