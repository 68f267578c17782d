//! Parts of the light that are summed apart.

use crate::error::{Error, Result};
use glam::{Vec2, Vec3A};
use renderflow_frame::Environment;
use renderflow_frame::image::Rgb;
use std::cmp::Ordering;

/// A partition of directions into groups, in the environment's own frame: it turns with the map.
///
/// The upper hemisphere (horizon included) is cut into `ceil(n / 2)` equal sectors of azimuth, the lower into the rest. Azimuth
/// runs as in the map, from -Z towards +X, and the first sector starts at 0. So 1 group is everything, 2 are sky and ground, 8
/// are octants. Where emitters have a group of their own, it is the last one, and directions have the groups before it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightGroups {
    count: usize,
    /// Groups of directions in the upper and the lower hemisphere.
    upper: usize,
    lower: usize,
    rotation: Vec2,
}

impl LightGroups {
    /// Most groups: channels of a frame.
    pub const MAXIMUM: usize = 8;

    /// `count` groups of directions, for a map turned by `rotation` radians as in [`renderflow_frame::Environment::rotation`].
    ///
    /// # Errors
    /// When `count` is outside 1..=8 or the rotation is not finite.
    pub fn new(count: usize, rotation: f32) -> Result<Self> {
        if !(1..=Self::MAXIMUM).contains(&count) {
            return Err(Error::Setting { name: "light_groups", value: count as u64, range: "1..=8".into() });
        }
        if !rotation.is_finite() {
            return Err(Error::inconsistent("environment/rotation", format!("{rotation} is not finite")));
        }
        Ok(Self { count, upper: count.div_ceil(2), lower: count / 2, rotation: Vec2::from_angle(rotation) })
    }

    /// Keeps the number of groups, but reserves the last one for emitters. A single group stays the group of all light.
    pub fn with_emitters(self) -> Self {
        let directions = (self.count - 1).max(1);
        Self { upper: directions.div_ceil(2), lower: directions / 2, ..self }
    }

    /// `environment` with the radiance of every texel times the factors, by channel, of its group; a group without factors stays
    /// as it is. Pictures of the groups times these factors add up to the picture under it, but for the texels between two
    /// groups, which bilinear look-ups mix. A constant environment becomes a map of 64 x 32 texels.
    pub fn weighed(&self, environment: &Environment, factors: &[[f32; 3]]) -> Environment {
        let map = match environment.map.pixels.first() {
            Some(radiance) if environment.is_constant() => Rgb::filled(64, 32, *radiance),
            _ => environment.map.clone(),
        };
        let mut weighed = environment.with_map(map);
        let width = weighed.map.width;
        for i in 0..weighed.map.pixels.len() {
            let group = self.group(weighed.texel_direction(i % width, i / width));
            let Some(factors) = factors.get(group) else { continue };
            weighed.map.pixels[i].iter_mut().zip(factors).for_each(|(value, factor)| *value *= factor);
        }
        weighed
    }

    /// Group of light from emitters: the last.
    pub fn emitters(&self) -> usize {
        self.count - 1
    }

    /// Group of light from the world-space direction `wi` (any length), below their number.
    #[inline]
    pub fn group(&self, wi: Vec3A) -> usize {
        // A lone group of directions has no lower half.
        let (first, sectors) = if wi.y >= 0.0 || self.lower == 0 { (0, self.upper) } else { (self.upper, self.lower) };
        if sectors == 1 {
            return first;
        }
        // Cosine and sine of the azimuth in the map, times some length.
        let d = self.rotation.rotate(Vec2::new(-wi.z, wi.x));
        let late = d.y < 0.0 || (d.y == 0.0 && d.x < 0.0);
        let passed = |&&(j, border): &&(usize, Vec2)| {
            let beyond = || border.perp_dot(d) >= 0.0;
            match (2 * j).cmp(&sectors) {
                Ordering::Less => late || beyond(),
                Ordering::Equal => late,
                Ordering::Greater => late && beyond(),
            }
        };
        first + BORDERS[sectors - 2][..sectors - 1].iter().filter(passed).count()
    }
}

/// Where sector `j` of 2, 3 or 4 begins, as (j, cosine and sine), `j` from 1.
const BORDERS: [[(usize, Vec2); 3]; 3] = {
    const fn at(j: usize, x: f32, y: f32) -> (usize, Vec2) {
        (j, Vec2::new(x, y))
    }
    const SIN: f32 = 0.866_025_4;
    [
        [at(1, -1.0, 0.0), at(2, 1.0, 0.0), at(3, 1.0, 0.0)],
        [at(1, -0.5, SIN), at(2, -0.5, -SIN), at(3, 1.0, 0.0)],
        [at(1, 0.0, 1.0), at(2, -1.0, 0.0), at(3, 0.0, -1.0)],
    ]
};
