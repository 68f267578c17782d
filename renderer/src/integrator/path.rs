//! The state of a path from the camera, and the roulette that ends it.

use glam::Vec3A;

/// Number of surfaces that a path passes before roulette may end it.
const ROULETTE_FROM: u32 = 3;
/// Roulette spares paths of at least this throughput: less error than with 1 for few instructions more
/// (docs/measurements/renderer-notes.md, roulette).
const ROULETTE_BELOW: f32 = 0.3;
/// From this number of surfaces on, roulette keeps no path for certain; otherwise paths between white walls would end only at the
/// bounce limit.
const ROULETTE_ALWAYS: u32 = 8;
const ROULETTE_LIMIT: f32 = 0.95;

/// The state of a path.
#[derive(Clone, Copy)]
pub(super) struct Path {
    /// Number of the surface that the path is at; the first is 1.
    pub vertex: u32,
    /// Index of the path's random numbers.
    pub index: u32,
    /// Throughput from the camera, including the share of the branch.
    pub beta: Vec3A,
    /// Number of branches that the first surface splits the path into.
    pub branches: f32,
    /// Number of directions drawn at the first surface per light sample there.
    pub first_draws: f32,
    /// Factor of the density of light paths; 0 where no light path can come this way.
    pub reach: f32,
}

impl Path {
    /// At the first surface behind camera ray `index`.
    #[inline(always)]
    pub fn first(index: u32, branches: u32, lights: u32) -> Self {
        let (branches, lights) = (branches as f32, lights as f32);
        Self { vertex: 1, index, beta: Vec3A::ONE, branches, first_draws: branches / lights, reach: 0.0 }
    }

    /// Part `part` of `count` equal parts. Each part has its own random numbers, stratified together with those of all camera
    /// rays of the pixel.
    #[inline(always)]
    pub fn part(self, part: u32, count: u32) -> Self {
        Self { index: self.index * count + part, beta: Vec3A::splat(1.0 / count as f32), ..self }
    }

    /// The same path, marked as one that no light path finds, because it passes a surface from behind.
    #[inline(always)]
    pub fn unreached(self) -> Self {
        Self { reach: 0.0, ..self }
    }

    /// Number of directions drawn at this surface per light sample.
    #[inline(always)]
    pub fn draws(&self) -> f32 {
        if self.vertex == 1 { self.first_draws } else { 1.0 }
    }

    /// Plays roulette with the random number `u`; survivors are weighted up for the paths that end. `gain` is the factor by which
    /// the throughput grows when the path leaves the body that it is in, 1 in air.
    #[inline(always)]
    pub fn survives(&mut self, u: f32, gain: f32) -> bool {
        if self.vertex < ROULETTE_FROM {
            return true;
        }
        let limit = if self.vertex < ROULETTE_ALWAYS { 1.0 } else { ROULETTE_LIMIT };
        let keep = (self.beta.max_element() * gain * (self.branches / ROULETTE_BELOW)).min(limit);
        // A NaN continues, so that it is counted.
        if u >= keep {
            return false;
        }
        self.beta /= keep;
        true
    }
}
