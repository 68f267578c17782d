//! Lights without an area: points, spots, and light from one direction. No ray meets them, so light samples alone find them, and
//! what they send counts whole.

use super::MAX_RADIANCE;
use super::sampler::UNITS;
use glam::{Mat3A, Vec3A};
use renderflow_frame::color::luminance;
use renderflow_scenes::ies::Profile;
use renderflow_scenes::loaded::{PunctualKind, PunctualLight};
use std::f32::consts::{FRAC_PI_2, PI};
use std::sync::Arc;

/// Unit direction and length of the way `towards` a light; `None` where it has no length, or none that is finite.
#[inline(always)]
pub(crate) fn direction_and_distance(towards: Vec3A) -> Option<(Vec3A, f32)> {
    // Scaled before squaring: distances from 1e-30 to 1e30 keep their digits.
    let scale = towards.abs().max_element();
    if !(scale > 0.0 && scale.is_finite()) {
        return None;
    }
    let scaled = towards / scale;
    let length = scaled.length();
    Some((scaled / length, scale * length))
}

/// A point or a spot.
#[derive(Clone, Debug)]
pub struct Lamp {
    /// In the space that shading points are in.
    pub position: Vec3A,
    /// Light to that space, a rotation. A spot shines along -z.
    axes: Mat3A,
    /// W/sr on the axis of a spot, or where the profile is 1.
    pub intensity: Vec3A,
    /// `None` for a point.
    cone: Option<Cone>,
    profile: Option<Arc<Profile>>,
}

/// The cone of a spot: brightness is `(scale (cos - end))^2`, the base within 0..=1 (KHR_lights_punctual).
#[derive(Clone, Copy, Debug)]
struct Cone {
    inner: f32,
    outer: f32,
    scale: f32,
    /// Cosine of `outer`.
    end: f32,
}

impl Cone {
    fn new(inner: f32, outer: f32) -> Self {
        // The difference of the cosines with all its digits. Below .08 degrees, directions in single precision do not tell them
        // apart.
        let difference = 2.0 * (0.5 * (outer + inner)).sin() * (0.5 * (outer - inner)).sin();
        Self { inner, outer, scale: 1.0 / difference.max(1e-6), end: outer.cos() }
    }

    fn brightness(&self, cos: f32) -> f32 {
        ((cos - self.end) * self.scale).clamp(0.0, 1.0).powi(2)
    }
}

/// Light from one direction.
#[derive(Clone, Copy, Debug)]
pub struct DistantLight {
    /// Unit direction to the light.
    pub wi: Vec3A,
    /// W/m^2 on a surface that faces it.
    pub irradiance: Vec3A,
}

/// What a light without an area sends to a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Arriving {
    /// Unit direction to the light.
    pub wi: Vec3A,
    pub distance: f32,
    /// W/m^2 on a surface that faces the light, before anything stands in the way.
    pub irradiance: Vec3A,
}

impl Lamp {
    /// A point or a spot at `frame`; `None` for other lights, and for black ones.
    pub fn new(light: &PunctualLight, frame: usize) -> Option<Self> {
        let (intensity, cone) = match light.kind {
            PunctualKind::Point { intensity } => (intensity, None),
            PunctualKind::Spot { intensity, inner, outer } => (intensity, Some(Cone::new(inner, outer))),
            PunctualKind::Directional { .. } => return None,
        };
        let place = light.transform(frame);
        let intensity = Vec3A::from_array(intensity).min(Vec3A::splat(MAX_RADIANCE));
        let lamp = Self { position: place.translation, axes: place.matrix3, intensity, cone, profile: light.profile.clone() };
        (lamp.strength() > 0.0).then_some(lamp)
    }

    /// Luminance of the intensity in the brightest direction.
    pub(super) fn strength(&self) -> f64 {
        f64::from(luminance(self.intensity.to_array()))
    }

    /// Luminance of the intensity, all directions together, over pi: of a surface it would be area times radiance.
    pub(super) fn power(&self) -> f64 {
        let share = self.cone.map_or(4.0, |cone| 2.0 - cone.inner.cos() - cone.outer.cos());
        self.strength() * f64::from(share)
    }

    /// Axis and angles of the directions that it shines into: all within the second of the first brighter than elsewhere, and
    /// nothing beyond the sum of both.
    pub(super) fn spread(&self) -> (Vec3A, f32, f32) {
        let axis = -self.axes.z_axis;
        self.cone.map_or((axis, PI, FRAC_PI_2), |cone| (axis, cone.inner, cone.outer - cone.inner))
    }

    /// What arrives at `p`; `None` where nothing does, and where `p` is the lamp.
    #[inline]
    pub(crate) fn arriving(&self, p: Vec3A) -> Option<Arriving> {
        let (wi, distance) = direction_and_distance(self.position - p)?;
        let mut irradiance = self.intensity / distance / distance;
        if let Some(cone) = &self.cone {
            irradiance *= cone.brightness(self.axes.z_axis.dot(wi));
        }
        if let Some(profile) = &self.profile {
            irradiance *= profile.value(self.axes.transpose() * -wi);
        }
        (irradiance.is_finite() && irradiance != Vec3A::ZERO).then_some(Arriving { wi, distance, irradiance })
    }
}

impl DistantLight {
    /// Light from one direction at `frame`; `None` for other lights, and for black ones.
    pub fn new(light: &PunctualLight, frame: usize) -> Option<Self> {
        let PunctualKind::Directional { irradiance } = light.kind else { return None };
        let irradiance = Vec3A::from_array(irradiance).min(Vec3A::splat(MAX_RADIANCE));
        let wi = light.transform(frame).matrix3.z_axis.normalize();
        (luminance(irradiance.to_array()) > 0.0).then_some(Self { wi, irradiance })
    }
}

/// All light from single directions, each drawn by its irradiance.
#[derive(Clone, Debug)]
pub(super) struct DistantLights {
    lights: Vec<DistantLight>,
    /// `cumulative[i]` = units of lights 0..=i.
    cumulative: Vec<u32>,
}

impl DistantLights {
    /// For [`Self::pick`] of `0..units`; every light has a unit at least. `None` without lights.
    pub fn new(lights: Vec<DistantLight>, units: u32) -> Option<Self> {
        let strength = |light: &DistantLight| f64::from(luminance(light.irradiance.to_array()));
        let total: f64 = lights.iter().map(strength).sum();
        let spare = units.checked_sub(u32::try_from(lights.len()).ok()?)?;
        let (mut sum, mut cumulative) = (0.0, Vec::new());
        for (i, light) in lights.iter().enumerate() {
            sum += strength(light);
            cumulative.push(i as u32 + 1 + (f64::from(spare) * (sum / total).min(1.0)) as u32);
        }
        *cumulative.last_mut()? = units;
        Some(Self { lights, cumulative })
    }

    /// The light that the `unit`-th random number leads to, and its probability.
    #[inline]
    pub fn pick(&self, unit: u32) -> Option<(Arriving, f32)> {
        let i = self.cumulative.partition_point(|&units| units <= unit);
        let DistantLight { wi, irradiance } = *self.lights.get(i)?;
        let units = self.cumulative[i] - if i == 0 { 0 } else { self.cumulative[i - 1] };
        Some((Arriving { wi, distance: f32::INFINITY, irradiance }, units as f32 / UNITS as f32))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A spot has its intensity on its axis, and half of the base half way between the cosines of its angles, however narrow it
    /// is.
    #[test]
    fn narrow_spots_are_as_bright_as_wide_ones() {
        for degrees in [60.0_f32, 10.0, 2.0, 1.0, 0.5, 0.2] {
            let outer = degrees.to_radians();
            for inner in [0.0, 0.5 * outer] {
                let cone = Cone::new(inner, outer);
                assert!((cone.brightness(1.0) - 1.0).abs() < 0.02, "{degrees} degrees: {}", cone.brightness(1.0));
                let half = 0.5 * (f64::from(inner).cos() + f64::from(outer).cos());
                let found = cone.brightness(half as f32);
                assert!((found - 0.25).abs() < 0.02, "{degrees} degrees, half way: {found}");
                assert_eq!(cone.brightness((1.1 * outer).cos()), 0.0);
            }
        }
    }
}
