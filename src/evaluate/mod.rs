//! Compares pictures with path-traced truth, by metrics and seconds: every method on every frame of test sequences, or anybody's
//! pictures. [`inverse`] measures recovered buffers, [`relight`] what they show under another light, and [`autoencoder`] what an
//! autoencoder loses.

pub mod autoencoder;
pub mod external;
pub mod find;
pub mod inverse;
pub mod inverter;
pub mod method;
pub mod relight;
pub mod renderer;
pub mod results;
pub mod run;
mod shell;
