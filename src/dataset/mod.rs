//! Datasets: a plan that fits in a page, folders of sequences made from it, and what can be done with them.

pub mod agreement;
pub mod check;
pub mod damage;
pub mod export;
pub mod folder;
pub mod home;
pub mod log;
pub mod manifest;
pub mod mend;
pub mod pack;
pub mod plan;
pub mod planning;
pub mod preview;
pub mod record;
pub mod render;
pub mod shard;
pub mod slurm;
pub mod source;
pub mod statistics;
pub mod stats;
pub mod verify;
pub mod view;

pub use folder::{Dataset, SequenceFolder};
pub use plan::Plan;
pub use shard::Shard;
pub use view::SequenceView;
