//! How much of an environment's light comes in through openings.

use crate::description::EnvironmentSource;
use crate::sky;
use glam::Vec3;
use renderflow_frame::Environment;

/// Size of the map that is asked: wide parts of the sky, not its details.
const SIZE: [usize; 2] = [16, 8];

/// An opening: the direction it faces (unit, outwards) and its area in square metres.
pub(super) struct Opening {
    pub faces: Vec3,
    pub area: f32,
}

/// The light of an environment by direction, unrotated.
pub(super) struct Daylight(Environment);

impl Daylight {
    /// Of maps in files and of named ones nothing is known before they are loaded: they count as even.
    pub fn of(source: &EnvironmentSource) -> Self {
        let [width, height] = SIZE;
        let mut even = Environment::constant([1.0; 3]);
        if let EnvironmentSource::Sky(sky) = source {
            even.map = sky::render(sky, width, height);
        }
        Self(even)
    }

    /// Mean irradiance of a room's surfaces over that of level ground outside, where the map is turned by `degrees`; light that
    /// came in is reflected with `reflectance` by `surface` square metres, openings included.
    pub fn inside(&self, degrees: f32, openings: &[Opening], surface: f32, reflectance: f32) -> f32 {
        let sky = Environment { rotation: degrees.rem_euclid(360.0).to_radians(), ..self.0.clone() };
        let (mut flux, mut ground) = (0.0f32, 0.0f32);
        for row in 0..sky.map.height {
            let angle = sky.texel_solid_angle(row);
            for column in 0..sky.map.width {
                let direction = Vec3::from(sky.texel_direction(column, row));
                let [r, g, b] = sky.map.pixels[row * sky.map.width + column];
                let light = (0.2126 * r + 0.7152 * g + 0.0722 * b) * angle;
                ground += light * direction.y.max(0.0);
                flux += openings.iter().map(|o| light * o.area * o.faces.dot(direction).max(0.0)).sum::<f32>();
            }
        }
        let open: f32 = openings.iter().map(|o| o.area).sum();
        // What is reflected leaves again where there is no wall.
        let kept = reflectance * (1.0 - (open / surface).min(0.95));
        flux / (surface * (1.0 - kept)) / ground.max(1e-6)
    }
}
