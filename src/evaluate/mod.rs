//! Compares pictures with path-traced truth: every method on every frame of test sequences, metrics and seconds, or anybody's
//! pictures.

mod engine;
pub mod find;
mod fused;
pub mod keyframes;
pub mod method;
pub mod outside;
mod painter;
mod players;
pub mod results;
pub mod run;
mod traced;
