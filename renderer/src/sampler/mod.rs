//! Random numbers: low-discrepancy points addressed by (seed, frame, pixel, sample), never by the order of work.
//!
//! Layout of the dimensions of one camera sample, in padded sets of four (Burley 2020):
//!
//! | set | numbers |
//! |---|---|
//! | 0 | image point x, y; the other two are unused |
//! | 2k - 1 | scattering at the k-th surface of the path: lobe, direction (2), Russian roulette |
//! | 2k | light at the k-th surface: direction (2), choice of the light (2) |
//!
//! Where a path splits (`Settings::branches` b > 1), set 0 belongs to camera sample `index`; branch j of it takes its scattering
//! and all later light from sample `index * b + j` of the other sets, so that these are stratified over all branches. The first
//! surface's `l` light samples are those of set 2 with the numbers `index * l` on.
//!
//! A scene that needs no light samples (flat environment, no emitters) never asks for the even sets; the others keep their
//! numbers.
//!
//! In pictures whose pixels all have the same samples, blocks of pixels share a sequence ([`block`]).

pub mod batch;
pub mod block;
pub mod hash;
pub mod sobol;

pub use batch::{Batched, LANES, Points};
pub use block::Sharing;
pub use sobol::PixelSampler;

use serde::{Deserialize, Serialize};

/// Kind of the random numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Sampler {
    /// Owen-scrambled Sobol points.
    #[default]
    Sobol,
    /// Independent numbers: more noise, but errors that textbooks give the size of.
    Independent,
}
