//! The light of a sequence: dominant lights and the rest of the environment.

use super::shadow::ShadowMap;
use super::sky::{SkyCell, sky_cells};
use crate::Environment;
use crate::environment::DominantLight;
use crate::ibl::IblTables;

/// Most lights taken out of an environment by default.
pub const LIGHTS: usize = 4;

/// What shading needs of an environment, made once a sequence.
#[derive(Clone, Debug)]
pub struct Lighting {
    /// Lights shaded analytically, the strongest first.
    pub lights: Vec<DominantLight>,
    /// The whole environment, as seen in the background.
    pub environment: Environment,
    /// Prefiltered environment without the lights.
    pub tables: IblTables,
    /// Prefiltered whole environment, `None` without lights: smooth surfaces mirror the lights in their own shape.
    pub whole: Option<IblTables>,
    /// The environment without the lights in cells, one for each map of [`Shadows::sky`].
    pub sky: Vec<SkyCell>,
}

/// What the lights and the sky see of the scene at one frame; empty lists mean that nothing is known.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Shadows {
    /// Of each of [`Lighting::lights`] its maps, the finest first: a pixel takes the first that covers it.
    pub lights: Vec<Vec<ShadowMap>>,
    /// One coarse map for each of [`Lighting::sky`].
    pub sky: Vec<ShadowMap>,
}

impl Lighting {
    /// Takes up to `most` lights out of `environment` ([`Environment::split_lights`]) and prefilters the rest and the whole (0.1 s each on
    /// four cores).
    pub fn new(environment: &Environment, most: usize) -> Self {
        let (lights, rest) = environment.split_lights(most);
        let tables = IblTables::new(&rest);
        let whole = (!lights.is_empty()).then(|| IblTables::new(environment));
        let sky = sky_cells(&rest);
        Self { lights, environment: environment.clone(), tables, whole, sky }
    }
}
