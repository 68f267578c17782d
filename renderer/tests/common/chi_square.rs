//! The library's chi-square harness, as tests use it: a refuted claim panics.

#[allow(unused_imports)] // Every test file uses its own part of this.
pub use renderflow_renderer::verify::chi_square::{Counts, DirectionGrid, Random, judge, upper_gamma};

/// Fails when any experiment is refuted at a significance of 1 % for all together.
pub fn assert_all(experiments: &[Counts]) {
    let outcome = judge("experiments", experiments);
    println!("{} experiments, smallest p = {:.3}, threshold {:.1e}", experiments.len(), outcome.worst, outcome.limit);
    assert!(outcome.passed, "{}", outcome.detail);
}
