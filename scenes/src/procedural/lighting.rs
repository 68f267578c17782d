//! The light of a composed scene.

use super::Split;
use crate::description::{EnvironmentLight, EnvironmentSource};
use crate::draw::Draw;
use crate::sky;
use rand_pcg::Pcg64;

/// A random sky, or for [`Split::Test`] one of the held-out maps; turned at random.
pub(super) fn environment(rng: &mut Pcg64, split: Split) -> EnvironmentLight {
    let source = match split {
        Split::Train | Split::Val => EnvironmentSource::Sky(sky::random(rng)),
        Split::Test => {
            let names = sky::names();
            EnvironmentSource::Builtin(names[rng.below(names.len() as u32) as usize].into())
        }
    };
    EnvironmentLight { source, rotation: rng.between(0.0, 360.0), intensity: rng.log(0.5, 2.0) }
}
