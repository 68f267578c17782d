//! All lights of a scene as one.

use super::emitters::{EmissiveTriangle, EmitterLight, LightId, Receiver, Selection};
use super::envmap::{EnvironmentLight, EnvironmentSample};
use super::punctual::{Arriving, DistantLight, DistantLights, Lamp};
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
    /// A light without an area, which nothing else finds.
    Punctual {
        /// Number of a point or spot; `None` for light from one direction.
        lamp: Option<u32>,
        /// W/m^2 on a surface that faces it, when nothing is in between.
        irradiance: Vec3A,
    },
}

/// A direction towards a light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightSample {
    /// World-space unit direction.
    pub wi: Vec3A,
    /// Distance to the light, infinite for the environment and light from one direction.
    pub distance: f32,
    /// What is there.
    pub source: Source,
    /// Density of `wi` for this light, the choice between lights included; per steradian, > 0. For [`Source::Punctual`] the
    /// probability to draw it.
    pub pdf: f32,
}

impl LightSample {
    /// A light without an area that is drawn with a probability.
    pub(crate) fn punctual(Arriving { wi, distance, irradiance }: Arriving, lamp: Option<u32>, probability: f32) -> Self {
        Self { wi, distance, source: Source::Punctual { lamp, irradiance }, pdf: probability }
    }
}

/// A sample of the only light.
impl From<EnvironmentSample> for LightSample {
    #[inline(always)]
    fn from(EnvironmentSample { wi, radiance, pdf }: EnvironmentSample) -> Self {
        Self { wi, distance: f32::INFINITY, source: Source::Environment { radiance }, pdf }
    }
}

/// The lights of a scene besides its environment.
#[derive(Clone, Debug, Default)]
pub struct Lights {
    /// Emissive triangles.
    pub triangles: Vec<EmissiveTriangle>,
    /// Points and spots.
    pub lamps: Vec<Lamp>,
    /// Light from single directions.
    pub distant: Vec<DistantLight>,
    /// How one of the triangles and lamps is chosen.
    pub selection: Selection,
}

impl Lights {
    /// Emissive triangles alone.
    pub fn of(triangles: impl IntoIterator<Item = EmissiveTriangle>) -> Self {
        Self { triangles: triangles.into_iter().collect(), ..Self::default() }
    }
}

/// Draws from the environment and from all other lights.
#[derive(Clone, Debug)]
pub struct LightSampler {
    environment: EnvironmentLight,
    distant: Option<DistantLights>,
    emitters: Option<EmitterLight>,
    /// Of [`UNITS`] random numbers, how many choose the environment.
    environment_units: u32,
    /// How many choose the environment or light from one direction.
    far_units: u32,
    environment_share: f32,
}

impl LightSampler {
    /// All lights of a scene. Where there are both kinds, the environment is drawn as often as all others: whatever the one and
    /// the other send to a point (`a`, `b`), the second moment `a^2 / q + b^2 / (1 - q)` is then at most twice that of the best
    /// share `q`. A share by power would do worse wherever the stronger light is hidden, as a sky is from indoors. Other shares
    /// differ little where they are better (docs/measurements/renderer-notes.md, light-shares). Light from single directions
    /// gets one half of the rest for the same reason.
    pub fn new(environment: EnvironmentLight, lights: Lights) -> Self {
        Self::with_share(environment, lights, 0.5)
    }

    /// As [`Self::new`], where `share` (kept within 1/16..=15/16) of the samples go to the environment if there are both kinds.
    pub fn with_share(environment: EnvironmentLight, lights: Lights, share: f32) -> Self {
        let Lights { triangles, lamps, distant, selection } = lights;
        let wanted = if environment.is_black() { 0.0 } else { share.clamp(0.0625, 0.9375) };
        let environment_units = (wanted * UNITS as f32) as u32;
        let others = UNITS - environment_units;
        let half = if distant.is_empty() { 0 } else { others / 2 };
        let emitters = EmitterLight::with_units(triangles, lamps, selection, others - half);
        let distant_units = if emitters.is_none() && half > 0 { others } else { half };
        let distant = DistantLights::new(distant, distant_units);
        let environment_units = if emitters.is_none() && distant.is_none() { UNITS } else { environment_units };
        let far_units = if distant.is_some() { environment_units + distant_units } else { environment_units };
        let environment_share = environment_units as f32 / UNITS as f32;
        Self { environment, distant, emitters, environment_units, far_units, environment_share }
    }

    /// The environment.
    pub fn environment(&self) -> &EnvironmentLight {
        &self.environment
    }

    /// Draws a direction from the point `at` to a light; random numbers in 0..1, two that choose the light. `None` when what was
    /// drawn sends no light there.
    #[inline(always)]
    pub fn sample(&self, at: &Receiver, choice: [f32; 2], u: [f32; 2]) -> Option<LightSample> {
        let [unit, more] = choice.map(|number| ((number * UNITS as f32) as u32).min(UNITS - 1));
        if unit < self.environment_units {
            let drawn = self.environment.sample(u)?;
            let source = Source::Environment { radiance: drawn.radiance };
            return Some(LightSample { wi: drawn.wi, distance: f32::INFINITY, source, pdf: drawn.pdf * self.environment_share });
        }
        match &self.emitters {
            Some(emitters) if unit >= self.far_units => emitters.pick([unit - self.far_units, more], at, u),
            _ => {
                let (arriving, probability) = self.distant.as_ref()?.pick(unit - self.environment_units)?;
                Some(LightSample::punctual(arriving, None, probability))
            }
        }
    }

    /// Probability with which [`Self::sample`] for `at` draws a triangle or a lamp.
    pub(crate) fn probability(&self, at: &Receiver, light: LightId) -> f32 {
        self.emitters.as_ref().map_or(0.0, |emitters| emitters.probability(at, light))
    }

    /// W/m^2 that lamp `number` sends to a surface at `p` that faces it, when nothing is in between.
    pub(crate) fn irradiance(&self, number: u32, p: Vec3A) -> Vec3A {
        self.emitters.as_ref().map_or(Vec3A::ZERO, |emitters| emitters.irradiance(number, p))
    }

    /// [`EnvironmentLight::radiance`] along the world-space unit direction `wi`, and the density, per steradian, with which
    /// [`Self::sample`] draws `wi` as a direction to the environment.
    #[inline(always)]
    pub fn radiance_and_pdf(&self, wi: Vec3A) -> (Vec3A, f32) {
        let (radiance, pdf) = self.environment.radiance_and_pdf(wi);
        (radiance, pdf * self.environment_share)
    }

    /// Density with which [`Self::sample`] for `at` draws a direction that meets triangle `id` at `distance`, per steradian;
    /// `cos` as for [`EmitterLight::pdf`].
    #[inline(always)]
    pub fn pdf_emitter(&self, at: &Receiver, id: u32, distance: f32, cos: f32) -> f32 {
        self.emitters.as_ref().map_or(0.0, |emitters| emitters.pdf(at, id, distance, cos))
    }
}
