//! The environment's dominant light: the sun, a lamp, or the brightest window.

use super::Environment;
use crate::color::luminance;
use crate::image::Image;
use glam::Vec3A;
use rayon::prelude::*;

/// Half-angle in radians of the cone about the peak that may belong to the dominant light.
const CONE: f32 = 0.21;

/// A light so far away and so small that one direction stands for it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DominantLight {
    /// World-space unit direction towards the light.
    pub direction: Vec3A,
    /// Irradiance (intensity included) the light gives a surface that faces it.
    pub irradiance: [f32; 3],
    /// Radius in radians of the disc that spreads as wide as the light does.
    pub angular_radius: f32,
    /// Share, 0..=1, of the luminance that the light gives a surface facing it, of all that the surface receives.
    pub share: f32,
}

impl Environment {
    /// World-space unit direction of the dominant light and its share of a facing surface's irradiance
    /// (0 for a constant map; then the direction is +Y).
    pub fn dominant_direction(&self) -> (Vec3A, f32) {
        let (light, _) = self.split_dominant();
        (light.direction, light.share)
    }

    /// Splits the environment into its dominant light and the rest; both together give the environment's energy.
    ///
    /// The light is what rises above the mean luminance of the hemisphere about the brightest direction, inside a cone of
    /// 12 degrees about it; its direction is the luminance-weighted mean of that part.
    pub fn split_dominant(&self) -> (DominantLight, Environment) {
        let none = DominantLight { direction: Vec3A::Y, irradiance: [0.0; 3], angular_radius: 0.0, share: 0.0 };
        if self.is_constant() {
            return (none, self.clone());
        }
        // The peak of a map averaged to a few degrees: one hot texel must not outshine the sun's whole disc.
        let coarse = self.downsampled(self.map.width.min(128), self.map.height.min(64));
        let peak = (0..coarse.map.pixels.len())
            .fold(0, |best, i| if luminance(coarse.map.pixels[i]) > luminance(coarse.map.pixels[best]) { i } else { best });
        let axis = coarse.texel_direction(peak % coarse.map.width, peak / coarse.map.width);

        // Luminance that is not the light's: the mean over the hemisphere outside the cone.
        let (mut around, mut weight) = (0.0_f64, 0.0_f64);
        for row in 0..coarse.map.height {
            let solid_angle = f64::from(coarse.texel_solid_angle(row));
            for column in 0..coarse.map.width {
                let c = coarse.texel_direction(column, row).dot(axis);
                if c > 0.0 && c < CONE.cos() {
                    around += solid_angle * f64::from(luminance(*coarse.map.at(column, row)));
                    weight += solid_angle;
                }
            }
        }
        let threshold = (around / weight.max(1e-12)) as f32;

        // Move the excess from the map to the light, row by row in order.
        let mut rest = self.map.clone();
        let width = self.map.width;
        let sums: Vec<(Vec3A, Vec3A, f32)> = rest
            .pixels
            .par_chunks_mut(width)
            .enumerate()
            .map(|(row, texels)| {
                let solid_angle = self.texel_solid_angle(row);
                let (mut moment, mut energy, mut facing) = (Vec3A::ZERO, Vec3A::ZERO, 0.0);
                for (column, texel) in texels.iter_mut().enumerate() {
                    let direction = self.texel_direction(column, row);
                    let c = direction.dot(axis);
                    let bright = luminance(*texel);
                    if c > 0.0 {
                        facing += bright * solid_angle * c;
                    }
                    if c > CONE.cos() && bright > threshold {
                        let excess = Vec3A::from_array(*texel) * (1.0 - threshold / bright);
                        moment += direction * ((bright - threshold) * solid_angle);
                        energy += excess * solid_angle;
                        *texel = (Vec3A::from_array(*texel) - excess).max(Vec3A::ZERO).to_array();
                    }
                }
                (moment, energy, facing)
            })
            .collect();
        let (moment, energy, facing) =
            sums.iter().fold((Vec3A::ZERO, Vec3A::ZERO, 0.0), |sum, row| (sum.0 + row.0, sum.1 + row.1, sum.2 + row.2));
        let bright = luminance(energy.to_array());
        let Some(direction) = moment.try_normalize() else { return (none, self.clone()) };
        if bright.is_nan() || bright <= 0.0 || facing <= 0.0 {
            return (none, self.clone());
        }
        // A uniform disc of radius rho has a mean cosine of (1 + cos rho) / 2 about its axis.
        let mean_cosine = (moment.length() / bright).min(1.0);
        let light = DominantLight {
            direction,
            irradiance: (energy * (mean_cosine * self.intensity)).to_array(),
            angular_radius: (2.0 * mean_cosine - 1.0).clamp(-1.0, 1.0).acos(),
            share: (bright * mean_cosine / facing).clamp(0.0, 1.0),
        };
        (light, Environment { map: Image { pixels: rest.pixels, ..rest }, ..*self })
    }
}
