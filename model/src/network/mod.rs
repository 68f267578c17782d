//! What networks are built of: random weights, layers.

pub mod init;
pub mod layers;
