//! Datasets: a plan that fits in a page, folders of sequences made from it, and what can be done with them.

pub mod agreement;
pub mod check;
pub mod contact;
pub mod damage;
pub mod denoise;
pub mod export;
pub mod home;
pub mod inspect;
pub mod job;
pub mod layout;
pub mod learned;
pub mod learning;
pub mod log;
pub mod manifest;
pub mod mend;
pub mod merge;
pub mod pack;
pub mod plan;
pub mod planning;
pub mod preview;
pub mod record;
pub mod render;
pub mod repair;
pub mod sequence;
pub mod shard;
pub mod slurm;
pub mod source;
pub mod statistics;
pub mod stats;
pub mod testset;
pub mod verify;
pub mod whole;

pub use learned::Dataset;
pub use plan::Plan;
pub use sequence::{Sequence, find};
pub use shard::Shard;
