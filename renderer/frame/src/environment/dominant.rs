//! The environment's dominant light: the sun, a lamp, or the brightest window.

use super::Environment;
use crate::color::luminance;
use glam::Vec3A;
use rayon::prelude::*;

/// Half-angle in radians of the cone about the peak that may belong to the dominant light.
const CONE: f32 = 0.21;

/// A light with a smaller [`DominantLight::share`] stays in the rest of the environment, see [`Environment::split_lights`].
const LEAST_SHARE: f32 = 0.05;

/// A light that is so far away and so small that it has one direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DominantLight {
    /// World-space unit direction towards the light.
    pub direction: Vec3A,
    /// Irradiance (intensity included) of a surface that faces the light.
    pub irradiance: [f32; 3],
    /// Radius in radians of the disc that spreads as wide as the light does.
    pub angular_radius: f32,
    /// Share, 0..=1, of the light in the luminance that a surface facing it receives.
    pub share: f32,
}

/// Where the light may be, and how bright its surroundings are.
struct Peak {
    /// World-space unit direction of the brightest cell.
    axis: Vec3A,
    /// Mean luminance (of the map) over the hemisphere about the axis, outside the cone.
    surroundings: f32,
}

impl Environment {
    /// The dominant light: the radiance above the mean luminance of the hemisphere about the brightest direction, inside a cone
    /// of 12 degrees about it. Its direction is the luminance-weighted mean of this radiance. Its irradiance and share are 0 in a
    /// constant or black map.
    pub fn dominant_light(&self) -> DominantLight {
        let none = DominantLight { direction: Vec3A::Y, irradiance: [0.0; 3], angular_radius: 0.0, share: 0.0 };
        let Some(peak) = self.peak() else { return none };
        // Row by row, summed in order: the same bits for any number of threads.
        let rows: Vec<(Vec3A, Vec3A)> = (0..self.map.height)
            .into_par_iter()
            .map(|row| {
                let (mut moment, mut energy) = (Vec3A::ZERO, Vec3A::ZERO);
                if self.row_meets_cone(row, peak.axis) {
                    let solid_angle = self.texel_solid_angle(row);
                    for (column, texel) in self.map.pixels[row * self.map.width..][..self.map.width].iter().enumerate() {
                        let direction = self.texel_direction(column, row);
                        let excess = peak.excess(*texel, direction) * solid_angle;
                        moment += direction * luminance(excess.to_array());
                        energy += excess;
                    }
                }
                (moment, energy)
            })
            .collect();
        let (moment, energy) = rows.iter().fold((Vec3A::ZERO, Vec3A::ZERO), |sum, row| (sum.0 + row.0, sum.1 + row.1));
        let bright = luminance(energy.to_array());
        let Some(direction) = moment.try_normalize() else { return none };
        // A uniform disc of radius rho has a mean cosine of (1 + cos rho) / 2 about its axis.
        let mean_cosine = (moment.length() / bright).min(1.0);
        // A surface facing the light receives the rest from the surroundings.
        let facing = bright * mean_cosine;
        DominantLight {
            direction,
            irradiance: (energy * (mean_cosine * self.intensity)).to_array(),
            angular_radius: (2.0 * mean_cosine - 1.0).clamp(-1.0, 1.0).acos(),
            share: facing / (facing + self.facing_irradiance(&peak)),
        }
    }

    /// Splits the environment into its dominant light and the rest. Together they have the environment's energy.
    pub fn split_dominant(&self) -> (DominantLight, Environment) {
        let light = self.dominant_light();
        let Some(peak) = self.peak().filter(|_| light.share > 0.0) else { return (light, self.clone()) };
        let mut rest = self.map.clone();
        rest.pixels.par_chunks_mut(rest.width).enumerate().filter(|(row, _)| self.row_meets_cone(*row, peak.axis)).for_each(
            |(row, texels)| {
                for (column, texel) in texels.iter_mut().enumerate() {
                    let excess = peak.excess(*texel, self.texel_direction(column, row));
                    *texel = (Vec3A::from_array(*texel) - excess).max(Vec3A::ZERO).to_array();
                }
            },
        );
        (light, self.with_map(rest))
    }

    /// Splits the environment into up to `most` lights, taken one after another, and the rest. Together they have the
    /// environment's energy. It stops at a light whose share is less than a twentieth. The first light is the one of
    /// [`Self::split_dominant`]; every [`DominantLight::share`] refers to the *whole* environment.
    pub fn split_lights(&self, most: usize) -> (Vec<DominantLight>, Environment) {
        let (mut lights, mut rest) = (Vec::new(), self.clone());
        while lights.len() < most {
            let (mut light, without) = rest.split_dominant();
            if light.share <= 0.0 {
                break;
            }
            let whole = self.facing_luminance(light.direction);
            if !lights.is_empty() {
                light.share = (luminance(light.irradiance) / whole.max(f32::MIN_POSITIVE)).min(1.0);
            }
            if light.share < LEAST_SHARE {
                break;
            }
            lights.push(light);
            rest = without;
        }
        (lights, rest)
    }

    /// Luminance (intensity included) that a surface with normal `n` receives from the whole environment.
    fn facing_luminance(&self, n: Vec3A) -> f32 {
        let mut sum = 0.0_f64;
        self.coarse().for_each_cell(|direction, solid_angle, bright| {
            sum += f64::from(bright * solid_angle * direction.dot(n).max(0.0));
        });
        sum as f32 * self.intensity
    }

    fn peak(&self) -> Option<Peak> {
        if self.is_constant() {
            return None;
        }
        // Cells of a few degrees, so that one hot texel does not outshine the sun's disc.
        let coarse = self.coarse();
        let brightest = (0..coarse.map.pixels.len())
            .fold(0, |best, i| if luminance(coarse.map.pixels[i]) > luminance(coarse.map.pixels[best]) { i } else { best });
        let axis = coarse.texel_direction(brightest % coarse.map.width, brightest / coarse.map.width);
        let (mut around, mut weight) = (0.0_f64, 0.0_f64);
        coarse.for_each_cell(|direction, solid_angle, bright| {
            let c = direction.dot(axis);
            if c > 0.0 && c < CONE.cos() {
                around += f64::from(solid_angle) * f64::from(bright);
                weight += f64::from(solid_angle);
            }
        });
        Some(Peak { axis, surroundings: (around / weight.max(1e-12)) as f32 })
    }

    /// Luminance that a surface facing the peak receives from all but the light (map units).
    fn facing_irradiance(&self, peak: &Peak) -> f32 {
        let mut sum = 0.0_f64;
        self.coarse().for_each_cell(|direction, solid_angle, bright| {
            let c = direction.dot(peak.axis);
            let bright = if c > CONE.cos() { bright.min(peak.surroundings) } else { bright };
            sum += f64::from(bright * solid_angle * c.max(0.0));
        });
        sum as f32
    }

    fn coarse(&self) -> Self {
        self.downsampled(self.map.width.min(128), self.map.height.min(64))
    }

    fn for_each_cell(&self, mut f: impl FnMut(Vec3A, f32, f32)) {
        for row in 0..self.map.height {
            let solid_angle = self.texel_solid_angle(row);
            for column in 0..self.map.width {
                f(self.texel_direction(column, row), solid_angle, luminance(*self.map.at(column, row)));
            }
        }
    }

    fn row_meets_cone(&self, row: usize, axis: Vec3A) -> bool {
        let theta = std::f32::consts::PI * (row as f32 + 0.5) / self.map.height as f32;
        (theta - axis.y.clamp(-1.0, 1.0).acos()).abs() < CONE + 0.01
    }
}

impl Peak {
    /// The part of a texel's radiance that belongs to the light.
    fn excess(&self, texel: [f32; 3], direction: Vec3A) -> Vec3A {
        let bright = luminance(texel);
        if direction.dot(self.axis) > CONE.cos() && bright > self.surroundings {
            Vec3A::from_array(texel) * (1.0 - self.surroundings / bright)
        } else {
            Vec3A::ZERO
        }
    }
}
