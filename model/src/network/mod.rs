//! Building blocks of networks: initial weights and layers.

pub mod init;
pub mod layers;
