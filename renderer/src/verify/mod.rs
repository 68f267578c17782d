//! Numerical-stability checks, usable from tests and from `renderflow stress`.

pub mod bsdf;
