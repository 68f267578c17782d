//! Sequences under other light. A path-traced picture is the sum of what each group of light contributes, so one render gives the
//! truth under many environments: those that differ from its own by a factor for each group. Everything else is cheap: it is
//! shaded anew.

use rand::RngExt;
use renderflow_frame::Light;
use renderflow_frame::frame::LIGHT_GROUPS;
use renderflow_renderer::deferred::{self, Lighting};
use renderflow_renderer::{LightGroups, RenderScene};
use renderflow_scenes::seed::Seed;
use std::sync::Arc;

/// Most that a group becomes brighter or darker, and that one of its channels departs from the others, in stops.
const STOPS: f32 = 2.0;
const TINGE: f32 = 0.5;

/// Light under which a sequence is shown.
pub(super) struct Lit {
    /// The environment.
    pub light: Arc<Light>,
    /// As deferred shading uses it; `None` where the recipe wants none.
    pub lighting: Option<Lighting>,
    /// Factor from scene radiance to display-linear.
    pub exposure: f32,
    /// Factors of the groups of light; `None` for the scene's own light.
    pub factors: Option<Vec<[f32; 3]>>,
}

impl Lit {
    fn new(light: Arc<Light>, factors: Option<Vec<[f32; 3]>>, deferred: bool) -> Self {
        let lighting = deferred.then(|| Lighting::new(Arc::clone(&light), deferred::LIGHTS));
        Self { lighting, exposure: light.exposure(), factors, light }
    }

    /// The light of `scene`. `deferred` says whether frames are shaded.
    pub fn own(scene: &RenderScene, deferred: bool) -> Self {
        Self::new(Arc::clone(scene.light()), None, deferred)
    }

    /// The environment of `scene` with factors for its `groups` that are drawn from `seed`. Lamps and surfaces that glow stay as
    /// they are.
    pub fn changed(scene: &RenderScene, groups: &LightGroups, seed: Seed, deferred: bool) -> Self {
        let mut rng = seed.rng();
        let mut factor = || {
            let stops: f32 = rng.random_range(-STOPS..STOPS);
            [(); 3].map(|()| (stops + rng.random_range(-TINGE..TINGE)).exp2())
        };
        let mut factors: Vec<[f32; 3]> = (0..LIGHT_GROUPS).map(|_| factor()).collect();
        if scene.features().lights() {
            factors[groups.emitters()] = [1.0; 3];
        }
        Self::new(Arc::new(Light::new(groups.weighed(scene.environment(), &factors))), Some(factors), deferred)
    }
}
