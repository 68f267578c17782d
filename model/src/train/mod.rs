//! What the training of every network shares: options, the loop, the optimiser, checkpoints, the log, clips in memory, and
//! processes that train together.

pub mod checkpoint;
pub mod config;
mod launch;
mod links;
pub mod log;
pub mod optimizer;
pub mod pool;
pub mod report;
mod resident;
pub mod runner;
pub mod schedule;
pub mod sequences;
pub mod team;

pub use config::{Decay, Method, RunConfig, TrainingConfig};
pub use team::{Share, Team};

use rand::RngExt;
use rand_pcg::Pcg64Mcg;

/// Draws an index with a probability proportional to its weight. Weights are at least 0 and not all 0.
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
