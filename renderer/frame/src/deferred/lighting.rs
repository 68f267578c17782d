//! The light of a sequence: dominant lights and the rest of the environment.

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
    /// The environment without the lights.
    pub rest: Environment,
    /// Prefiltered `rest`.
    pub tables: IblTables,
    /// Prefiltered whole environment, `None` without lights: smooth surfaces mirror the lights in their own shape.
    pub whole: Option<IblTables>,
}

impl Lighting {
    /// Takes up to `most` lights out of `environment` ([`Environment::split_lights`]) and prefilters the rest and the whole (0.1 s each on
    /// four cores).
    pub fn new(environment: &Environment, most: usize) -> Self {
        let (lights, rest) = environment.split_lights(most);
        let tables = IblTables::new(&rest);
        let whole = (!lights.is_empty()).then(|| IblTables::new(environment));
        Self { lights, environment: environment.clone(), rest, tables, whole }
    }
}
