//! Datasets: a plan that fits in a page, folders of sequences made from it, and their reader.

pub mod folder;
pub mod plan;
pub mod render;
pub mod shard;
pub mod slurm;

pub use folder::{Dataset, SequenceFolder};
pub use plan::Plan;
pub use shard::Shard;
