//! Training: steps, checkpoints, a log, clips in memory.

pub mod checkpoint;
pub mod log;
pub mod optimizer;
pub mod pool;
pub mod runner;
pub mod schedule;

use rand::RngExt;
use rand_pcg::Pcg64Mcg;

/// Index of one of `weights` (>= 0, not all 0), drawn in proportion.
pub(crate) fn draw_weighted(weights: impl Iterator<Item = f32> + Clone, rng: &mut Pcg64Mcg) -> usize {
    let total: f32 = weights.clone().sum();
    let mut u = rng.random::<f32>() * total;
    let mut drawn = 0;
    for (i, weight) in weights.enumerate().filter(|(_, weight)| *weight > 0.0) {
        drawn = i;
        u -= weight;
        if u < 0.0 {
            break;
        }
    }
    drawn
}
