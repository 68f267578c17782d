//! Compares pictures with path-traced truth: every method on every frame of test sequences, metrics and seconds, or anybody's
//! pictures. [`inverse`] measures what recovered buffers are worth, [`autoencoder`] what an autoencoder loses.

pub mod autoencoder;
mod baseline;
pub mod external;
pub mod find;
mod fused;
pub mod inverse;
pub mod keyframes;
pub mod method;
pub mod renderer;
pub mod results;
pub mod run;
mod sessions;
mod traced;
pub mod tracing;
