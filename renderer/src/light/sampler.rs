//! All lights of a scene as one.

use super::emitters::{EmissiveTriangle, EmitterLight};
use super::envmap::{EnvironmentLight, EnvironmentSample};
use glam::Vec3A;

/// Random numbers that choose a light are taken as multiples of one over this: generators of 23 or more bits hit each equally
/// often.
pub(super) const UNITS: u32 = 1 << 23;

/// What a light sample leads to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Source {
    /// The environment.
    Environment {
        /// Scene-linear radiance arriving when nothing is in between.
        radiance: Vec3A,
    },
    /// An emissive triangle; its radiance at the point is the caller's to look up.
    Emitter {
        /// Number of the triangle.
        id: u32,
        /// Weights of its corners, each 0..=1.
        barycentrics: [f32; 3],
        /// Unit geometric normal of the emitter, on the side of the shading point.
        n: Vec3A,
    },
}

/// A direction towards a light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightSample {
    /// World-space unit direction.
    pub wi: Vec3A,
    /// Distance to the light, infinite for the environment.
    pub distance: f32,
    /// What is there.
    pub source: Source,
    /// Density of `wi` for this light, the choice between lights included; per steradian, > 0.
    pub pdf: f32,
}

/// A sample of the only light.
impl From<EnvironmentSample> for LightSample {
    #[inline(always)]
    fn from(EnvironmentSample { wi, radiance, pdf }: EnvironmentSample) -> Self {
        Self { wi, distance: f32::INFINITY, source: Source::Environment { radiance }, pdf }
    }
}

/// Draws from the environment and from emissive triangles.
#[derive(Clone, Debug)]
pub struct LightSampler {
    environment: EnvironmentLight,
    emitters: Option<EmitterLight>,
    /// Of [`UNITS`] random numbers, how many choose the environment.
    environment_units: u32,
    environment_share: f32,
}

impl LightSampler {
    /// All lights of a scene. Where there are both kinds, each is drawn as often as the other: whatever the one and the other
    /// send to a point (`a`, `b`), the second moment `a^2 / q + b^2 / (1 - q)` is then at most twice that of the best share `q`.
    /// A share by power would do worse wherever the stronger light is hidden, as a sky is from indoors. Other shares differ
    /// little where they are better (docs/measurements/renderer-notes.md, light-shares).
    pub fn new(environment: EnvironmentLight, emitters: impl IntoIterator<Item = EmissiveTriangle>) -> Self {
        Self::with_share(environment, emitters, 0.5)
    }

    /// As [`Self::new`], where `share` (kept within 1/16..=15/16) of the samples go to the environment if there are both kinds.
    pub fn with_share(environment: EnvironmentLight, emitters: impl IntoIterator<Item = EmissiveTriangle>, share: f32) -> Self {
        let wanted = if environment.is_black() { 0.0 } else { share.clamp(0.0625, 0.9375) };
        let environment_units = (wanted * UNITS as f32) as u32;
        let emitters = EmitterLight::with_units(emitters, UNITS - environment_units);
        let environment_units = if emitters.is_none() { UNITS } else { environment_units };
        let environment_share = environment_units as f32 / UNITS as f32;
        Self { environment, emitters, environment_units, environment_share }
    }

    /// Share of light samples that go to the environment.
    #[inline(always)]
    pub(crate) fn environment_share(&self) -> f32 {
        self.environment_share
    }

    /// The environment.
    pub fn environment(&self) -> &EnvironmentLight {
        &self.environment
    }

    /// Draws a direction from the shading point `p` to a light; random numbers in 0..1. `None` when what was drawn sends no light
    /// to `p`.
    #[inline(always)]
    pub fn sample(&self, p: Vec3A, choice: f32, u: [f32; 2]) -> Option<LightSample> {
        let unit = ((choice * UNITS as f32) as u32).min(UNITS - 1);
        match &self.emitters {
            Some(emitters) if unit >= self.environment_units => {
                let drawn = emitters.pick(unit - self.environment_units, p, u)?;
                let source = Source::Emitter { id: drawn.id, barycentrics: drawn.barycentrics, n: drawn.n };
                Some(LightSample { wi: drawn.wi, distance: drawn.distance, source, pdf: drawn.pdf })
            }
            _ => {
                let drawn = self.environment.sample(u)?;
                let source = Source::Environment { radiance: drawn.radiance };
                Some(LightSample { wi: drawn.wi, distance: f32::INFINITY, source, pdf: drawn.pdf * self.environment_share })
            }
        }
    }

    /// [`EnvironmentLight::radiance`] along the world-space unit direction `wi`, and the density, per steradian, with which
    /// [`Self::sample`] draws `wi` as a direction to the environment.
    #[inline(always)]
    pub fn radiance_and_pdf(&self, wi: Vec3A) -> (Vec3A, f32) {
        let (radiance, pdf) = self.environment.radiance_and_pdf(wi);
        (radiance, pdf * self.environment_share)
    }

    /// Density with which [`Self::sample`] draws a direction that meets triangle `id` at `distance`, per steradian; `cos` as for
    /// [`EmitterLight::pdf`].
    #[inline(always)]
    pub fn pdf_emitter(&self, id: u32, distance: f32, cos: f32) -> f32 {
        self.emitters.as_ref().map_or(0.0, |emitters| emitters.pdf(id, distance, cos))
    }
}
