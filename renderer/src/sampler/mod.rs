//! Random numbers: low-discrepancy points addressed by (seed, frame, pixel, sample), never by the order of work.
//!
//! Layout of the dimensions of one camera sample, in padded sets of four (Burley 2020):
//!
//! | set | numbers |
//! |---|---|
//! | 0 | image point x, y; the other two are unused |
//! | 2k - 1 | scattering at the k-th surface of the path: lobe, direction (2), Russian roulette |
//! | 2k | light at the k-th surface: direction (2); the other two are unused |
//!
//! A scene that needs no light samples (flat environment) never asks for the even sets; the others keep their numbers.

pub mod hash;
pub mod sobol;

pub use sobol::PixelSampler;
