//! Compares pictures with path-traced truth: metrics on display values, seconds beside them.

pub mod psnr;
pub mod report;
pub mod results;
pub mod sequence;
pub mod ssim;
pub mod table;

pub use sequence::{Evaluation, Method, Options, Score};
