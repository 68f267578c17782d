//! The light of a sequence as deferred shading uses it: dominant lights and the rest of the environment.

use super::lamps::LampView;
use super::pass::mirrors;
use super::shadow_map::ShadowMap;
use super::sky::{SkyCell, coarse, sky_cells};
use glam::Quat;
use renderflow_frame::environment::DominantLight;
use renderflow_frame::ibl::{self, IblTables, Shading};
use renderflow_frame::{Environment, Frame, Light};
use std::sync::Arc;

/// Number of lights that are taken out of an environment by default, at most.
pub const LIGHTS: usize = 4;

/// The environment of a sequence with its dominant lights taken out. It is made once per sequence.
#[derive(Clone, Debug)]
pub struct Lighting {
    /// The whole environment.
    pub whole: Arc<Light>,
    /// Lights that are shaded analytically, the strongest first.
    pub lights: Vec<DominantLight>,
    /// Tables of the environment without the lights; `None` where there are no lights, and the tables of `whole` serve.
    rest: Option<IblTables>,
    /// The environment without the lights in cells, one for each map of [`Shadows::sky`].
    pub sky: Vec<SkyCell>,
    /// What [`Self::sky`] is made of.
    coarse: Environment,
}

/// What the lights and the sky see of the scene at one frame, and the scene's own lights. A list may be empty: then nothing is
/// known.
#[derive(Clone, Debug, Default)]
pub struct Shadows {
    /// The maps of each of [`Lighting::lights`], the finest first. A pixel takes the first map that covers it.
    pub lights: Vec<Vec<ShadowMap>>,
    /// One coarse map for each cell of [`Lighting::sky`].
    pub sky: Vec<ShadowMap>,
    /// Lights of the scene itself without an area, with their shadows.
    pub lamps: Vec<LampView>,
}

impl Lighting {
    /// Takes up to `most` lights out of the environment ([`renderflow_frame::Environment::split_lights`]) and prefilters the
    /// rest.
    pub fn new(whole: impl Into<Arc<Light>>, most: usize) -> Self {
        let whole = whole.into();
        let (lights, without) = whole.environment.split_lights(most);
        let rest = (!lights.is_empty()).then(|| IblTables::new(&without));
        let coarse = coarse(&without);
        Self { whole, lights, rest, sky: sky_cells(&coarse), coarse }
    }

    /// This lighting with the environment turned, as [`Light::turned`]. It takes a few milliseconds.
    pub fn turned(&self, whole: impl Into<Arc<Light>>) -> Self {
        let whole = whole.into();
        let rotation = whole.environment.rotation;
        let turn = Quat::from_rotation_y(rotation - self.whole.environment.rotation);
        let lights = self.lights.iter().map(|light| DominantLight { direction: (turn * light.direction).normalize(), ..*light });
        let mut rest = self.rest.clone();
        if let Some(rest) = &mut rest {
            rest.turn(rotation);
        }
        let coarse = Environment { rotation, ..self.coarse.clone() };
        Self { lights: lights.collect(), rest, sky: sky_cells(&coarse), coarse, whole }
    }

    /// Tables of the environment without the lights.
    pub(super) fn rest(&self) -> &IblTables {
        self.rest.as_ref().unwrap_or_else(|| self.whole.tables())
    }

    /// The split-sum picture of the rest before the whole environment.
    pub(super) fn shade(&self, frame: &Frame) -> Shading {
        let surfaces = ibl::surfaces(frame, &self.whole.environment);
        if !self.lights.is_empty() && mirrors(&surfaces) {
            // Made here once, not by every thread that first shades a pixel.
            self.whole.tables();
        }
        ibl::shade_surfaces(&frame.info.camera, surfaces, self.rest())
    }
}
