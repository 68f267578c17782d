//! Building blocks of networks: initial weights, layers, U-Nets, and files of weights.

pub(crate) mod file;
pub mod init;
pub mod layers;
pub mod unet;
