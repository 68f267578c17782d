//! Compares pictures with path-traced truth: metrics on display values, seconds beside them.

pub mod report;
pub mod results;
pub mod sequence;
pub mod table;

pub use crate::metrics::{psnr, ssim};
pub use sequence::{Evaluation, Method, Options, Score};
