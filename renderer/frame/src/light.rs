//! The light of a sequence.

use crate::Environment;
use crate::ibl::{self, IblTables};
use std::sync::OnceLock;

/// An environment with what shading derives from it, built once per sequence. Tables and exposure are computed when they are
/// first asked for, and kept.
#[derive(Clone, Debug)]
pub struct Light {
    /// Radiance from every direction.
    pub environment: Environment,
    exposure: OnceLock<f32>,
    tables: OnceLock<IblTables>,
    irradiance: OnceLock<Environment>,
}

impl Light {
    /// Light whose exposure follows from the environment alone ([`ibl::exposure`]).
    pub fn new(environment: Environment) -> Self {
        Self { environment, exposure: OnceLock::new(), tables: OnceLock::new(), irradiance: OnceLock::new() }
    }

    /// Light with the exposure that a sequence stores: the factor from scene radiance to display-linear, > 0.
    pub fn with_exposure(environment: Environment, exposure: f32) -> Self {
        Self { exposure: OnceLock::from(exposure), ..Self::new(environment) }
    }

    /// This light with its environment turned to `rotation` (radians). Tables that were made turn with it.
    pub fn turned(&self, rotation: f32) -> Self {
        let mut turned = self.clone();
        turned.environment.rotation = rotation;
        if let Some(tables) = turned.tables.get_mut() {
            tables.turn(rotation);
        }
        if let Some(irradiance) = turned.irradiance.get_mut() {
            irradiance.rotation = rotation;
        }
        turned
    }

    /// Factor from scene radiance to display-linear.
    pub fn exposure(&self) -> f32 {
        *self.exposure.get_or_init(|| ibl::exposure(&self.environment))
    }

    /// Split-sum tables of the environment. The first call takes about 0.1 s on four cores.
    pub fn tables(&self) -> &IblTables {
        kept(&self.tables, || IblTables::new(&self.environment))
    }

    /// [`IblTables::irradiance_map`] alone, for callers that need no other table.
    pub fn irradiance_map(&self) -> &Environment {
        match self.tables.get() {
            Some(tables) => &tables.irradiance_map,
            None => kept(&self.irradiance, || ibl::irradiance_map(&self.environment)),
        }
    }
}

/// The value of `cell`. `make` runs before the cell is locked: it works on rayon, where a thread that waits may pick up work that
/// asks for the same value and would then wait for itself.
fn kept<T>(cell: &OnceLock<T>, make: impl FnOnce() -> T) -> &T {
    match cell.get() {
        Some(value) => value,
        None => {
            let made = make();
            cell.get_or_init(|| made)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Rgb;

    #[test]
    fn light_derives_from_its_environment_and_keeps_a_stored_exposure() {
        let map = Rgb::from_fn(32, 16, |x, y| [0.1 * x as f32, 0.2, 0.05 * y as f32]);
        let environment = Environment { map, rotation: 0.4, intensity: 2.0 };
        let light = Light::new(environment.clone());
        assert_eq!(light.exposure(), ibl::exposure(&environment));
        let tables = IblTables::new(&environment);
        // The map by itself equals the one in the tables, before and after they are made.
        assert_eq!(light.irradiance_map(), &tables.irradiance_map);
        assert_eq!(light.tables().prefiltered_maps, tables.prefiltered_maps);
        assert_eq!(light.irradiance_map(), &tables.irradiance_map);
        assert_eq!(Light::with_exposure(environment.clone(), 0.25).exposure(), 0.25);

        // A light that is turned is the one that was made so.
        let again = Light::new(Environment { rotation: -1.3, ..environment });
        for turned in [light.turned(-1.3), Light::new(light.environment.clone()).turned(-1.3)] {
            assert_eq!(turned.environment, again.environment);
            assert_eq!(turned.exposure(), again.exposure());
            assert_eq!(turned.tables().irradiance_map, again.tables().irradiance_map);
            assert_eq!(turned.tables().prefiltered_maps, again.tables().prefiltered_maps);
        }
    }
}
