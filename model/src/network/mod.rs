//! Building blocks of networks: initial weights, layers, U-Nets, and networks with their weights files.

pub mod init;
pub mod layers;
pub mod trained;
pub mod unet;
