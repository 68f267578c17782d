//! Camera rays and motion: what the pinhole camera of the contract needs inside a renderer.

use crate::error::{Error, Result};
use crate::ray::Ray;
use glam::{DVec2, DVec3, Vec2, Vec3A};
use renderflow_frame::{Camera, Distortion};
use serde::{Deserialize, Serialize};
use std::f32::consts::FRAC_PI_4;
use std::ops::RangeInclusive;

/// Moments of a picture that has a camera ray for each of them.
const USUAL_MOMENTS: u32 = 32;

/// Pixel filter, always importance sampled: a sample counts fully for its own pixel and for no other.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Filter {
    /// The pixel's own square. Coverage is then the exact share of the pixel, a pixel without geometry equals the environment
    /// behind it, and no two pixels see the same point, which a network or a denoiser would have to undo.
    #[default]
    Box,
    /// Blackman-Harris of 1.5 pixels width (the common choice for final pictures): softer edges.
    BlackmanHarris,
}

impl Filter {
    /// Distance from the pixel centre within which all samples lie, pixels.
    pub fn radius(self) -> f32 {
        match self {
            Filter::Box => 0.5,
            Filter::BlackmanHarris => 0.75,
        }
    }

    /// Offset from the pixel centre for two uniform numbers, pixels.
    #[inline]
    pub fn sample(self, u: [f32; 2]) -> Vec2 {
        match self {
            Filter::Box => Vec2::new(u[0] - 0.5, u[1] - 0.5),
            Filter::BlackmanHarris => Vec2::new(blackman_harris(u[0]), blackman_harris(u[1])) * (2.0 * 0.75),
        }
    }
}

/// Inverse of the cumulative four-term Blackman-Harris window on -1/2..1/2.
fn blackman_harris(u: f32) -> f32 {
    const A: [f32; 4] = [0.35875, 0.48829, 0.14128, 0.01168];
    let tau = std::f32::consts::TAU;
    let cumulative = |x: f32| {
        // Window: a0 + a1 cos(2 pi x) + a2 cos(4 pi x) + a3 cos(6 pi x), centred at 0; its integral is a0.
        let sines = A[1] * (tau * x).sin() + A[2] / 2.0 * (2.0 * tau * x).sin() + A[3] / 3.0 * (3.0 * tau * x).sin();
        x + 0.5 + sines / (tau * A[0])
    };
    // Bisection: 24 halvings reach single precision, and the camera ray that follows costs several times more.
    let (mut low, mut high) = (-0.5f32, 0.5f32);
    for _ in 0..24 {
        let middle = 0.5 * (low + high);
        if cumulative(middle) < u { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

/// A lens that is open as a disc and shows one distance sharply (Cook, Porter and Carpenter 1984; Kolb, Mitchell and Hanrahan
/// 1995, the thin lens).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ThinLens {
    /// Radius of the opening, metres, > 0: focal length over twice the f-number.
    pub aperture: f32,
    /// Distance of the plane that is sharp, along the view, metres, > 0.
    pub focus: f32,
}

impl std::fmt::Display for ThinLens {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "aperture {} focus {}", self.aperture, self.focus)
    }
}

impl ThinLens {
    /// The ray of `camera` through the image point `pixel` and the point `u` of the lens.
    #[inline]
    pub(crate) fn ray(&self, camera: &Camera, pixel: Vec2, u: [f32; 2]) -> Ray {
        let on_lens = (self.aperture * disk(u)).extend(0.0);
        // All rays through an image point meet in the plane that is sharp.
        let towards = camera.direction_cam(pixel) * self.focus - Vec3A::from(on_lens);
        let origin = camera.camera_to_world.transform_point3a(on_lens.into());
        Ray::new(origin, (camera.camera_to_world.matrix3 * towards).normalize())
    }
}

/// A shutter that is open around each frame, for as long before it as after it. What moves while it is open is blurred.
///
/// A picture is the mean of pictures of single moments, evenly spaced over the time that the shutter is open (Haeberli and Akeley
/// 1990, the accumulation buffer): things move from moment to moment by jumps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shutter {
    /// Share of the time between two frames for which it is open, in (0, 1]; 0.5 is the 180 degrees of a film camera.
    pub open: f32,
    /// Number of moments, 1..=256.
    pub moments: u32,
}

impl std::fmt::Display for Shutter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "open {} moments {}", self.open, self.moments)
    }
}

impl Shutter {
    /// Range of [`Self::moments`].
    pub const MOMENTS: RangeInclusive<u32> = 1..=256;

    /// A shutter for pictures of `rays` camera rays a pixel ([`crate::Settings::camera_samples`]): a power of two of moments, at
    /// most 32, each with a camera ray of every pixel at least.
    pub fn new(open: f32, rays: u32) -> Self {
        Self { open, moments: (1 << rays.max(1).ilog2()).min(USUAL_MOMENTS) }
    }

    pub(crate) fn check(self) -> Result<()> {
        if !(self.open > 0.0 && self.open <= 1.0) {
            return Err(Error::inconsistent("shutter/open", format!("{} is outside (0, 1]", self.open)));
        }
        if !Self::MOMENTS.contains(&self.moments) {
            return Err(Error::Setting {
                name: "shutter.moments",
                value: self.moments.into(),
                range: format!("{:?}", Self::MOMENTS),
            });
        }
        Ok(())
    }

    /// When the moments are: frames from the frame in the middle of the time, from -0.5 to 0.5.
    pub fn offsets(self) -> Vec<f64> {
        let middle = |k: u32| (f64::from(k) + 0.5) / f64::from(self.moments) - 0.5;
        (0..self.moments).map(|k| f64::from(self.open) * middle(k)).collect()
    }
}

/// A uniform point of the unit disk (Shirley and Chiu 1997).
#[inline(always)]
pub(crate) fn disk(u: [f32; 2]) -> Vec2 {
    let (a, b) = (2.0 * u[0] - 1.0, 2.0 * u[1] - 1.0);
    let (r, phi) = if a.abs() > b.abs() {
        (a, FRAC_PI_4 * (b / a))
    } else {
        (b, 2.0 * FRAC_PI_4 - FRAC_PI_4 * (a / if b == 0.0 { 1.0 } else { b }))
    };
    let (sin, cos) = phi.sin_cos();
    Vec2::new(r * cos, r * sin)
}

/// The ray of `camera` through the image point `pixel`.
#[inline]
pub fn ray(camera: &Camera, pixel: Vec2) -> Ray {
    Ray::new(camera.position(), camera.ray_direction(pixel))
}

/// Projects in double precision, so that motion of a still point under a still camera is exactly 0 and sub-pixel motion is not
/// drowned by the roundings of two projections.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Projector {
    rotation: [DVec3; 3],
    position: DVec3,
    focal: DVec2,
    principal: DVec2,
    lens: Option<Distortion>,
}

impl Projector {
    pub fn new(camera: &Camera) -> Self {
        let m = camera.camera_to_world.matrix3;
        Self {
            rotation: [m.x_axis, m.y_axis, m.z_axis].map(|a| a.as_dvec3()),
            position: camera.position().as_dvec3(),
            focal: DVec2::new(camera.fl_x.into(), camera.fl_y.into()),
            principal: DVec2::new(camera.cx.into(), camera.cy.into()),
            lens: camera.distortion,
        }
    }

    /// Image point of a world-space point, `None` behind the camera.
    pub fn project(&self, p_world: DVec3) -> Option<DVec2> {
        let d = p_world - self.position;
        let [x, y, z] = self.rotation.map(|axis| axis.dot(d));
        if let Some(lens) = &self.lens {
            return (z < 0.0).then(|| self.principal + self.focal * lens.distort(DVec2::new(x, -y) / -z));
        }
        (z < 0.0).then(|| self.principal + DVec2::new(self.focal.x * x, -self.focal.y * y) / -z)
    }

    /// Bounds (low, high; pixels, possibly infinite) of what can be seen of a triangle, `None` when it is behind the camera. For
    /// lenses without distortion.
    pub fn bounds(&self, corners: [Vec3A; 3]) -> Option<(DVec2, DVec2)> {
        let p = corners.map(|c| {
            let d = c.as_dvec3() - self.position;
            DVec3::from_array(self.rotation.map(|axis| axis.dot(d)))
        });
        let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        let mut include = |point: DVec2| {
            low = low.min(point);
            high = high.max(point);
        };
        for (a, b) in [(p[0], p[1]), (p[1], p[2]), (p[2], p[0])] {
            if a.z < 0.0 {
                include(self.principal + DVec2::new(self.focal.x * a.x, -self.focal.y * a.y) / -a.z);
            }
            if (a.z < 0.0) != (b.z < 0.0) {
                // The edge runs through the camera plane: its image runs to infinity on the side where it crosses. A crossing
                // (nearly) straight above or through the eye may run to either side.
                let c = a.lerp(b, a.z / (a.z - b.z));
                let margin = 1e-9 * (a.abs() + b.abs()).max_element();
                let far = |v: f64| if v > margin { f64::INFINITY } else { f64::NEG_INFINITY };
                for tie in [-margin, margin] {
                    include(DVec2::new(far(c.x + tie), far(tie - c.y)));
                }
            }
        }
        (low.x <= high.x).then_some((low, high))
    }

    /// Bounds (low, high; pixels) of an upright box, `None` unless it is before the camera as a whole. For lenses without
    /// distortion.
    pub fn box_bounds(&self, [low, high]: [Vec3A; 2]) -> Option<(DVec2, DVec2)> {
        let (low, high) = (low.as_dvec3() - self.position, high.as_dvec3() - self.position);
        let (mut least, mut most) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        for k in 0..8 {
            let corner = DVec3::select(glam::BVec3::new(k & 1 != 0, k & 2 != 0, k & 4 != 0), high, low);
            let [x, y, z] = self.rotation.map(|axis| axis.dot(corner));
            // Written so that NaN fails.
            let before = z < -1e-9 * (x.abs() + y.abs());
            if !before {
                return None;
            }
            let point = self.principal + DVec2::new(self.focal.x * x, -self.focal.y * y) / -z;
            (least, most) = (least.min(point), most.max(point));
        }
        Some((least, most))
    }

    /// A world-space direction in camera space.
    pub fn direction_to_camera(&self, d: Vec3A) -> Vec3A {
        let d = d.as_dvec3();
        let [x, y, z] = self.rotation.map(|axis| axis.dot(d));
        DVec3::new(x, y, z).as_vec3a()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blackman_harris_has_the_window_s_variance() {
        let n = 10_000;
        let (mut mean, mut variance) = (0.0f64, 0.0f64);
        for i in 0..n {
            let x = f64::from(Filter::BlackmanHarris.sample([(i as f32 + 0.5) / n as f32, 0.5]).x);
            assert!(x.abs() <= 0.75);
            mean += x / f64::from(n);
            variance += x * x / f64::from(n);
        }
        // Numeric integral of x^2 w(x) / integral of w(x), width 1.5.
        let (mut top, mut bottom) = (0.0f64, 0.0f64);
        for i in 0..n {
            let x = (f64::from(i) + 0.5) / f64::from(n) - 0.5;
            let c = |k: f64| (k * std::f64::consts::TAU * x).cos();
            let w = 0.35875 + 0.48829 * c(1.0) + 0.14128 * c(2.0) + 0.01168 * c(3.0);
            top += w * (1.5 * x) * (1.5 * x);
            bottom += w;
        }
        assert!(mean.abs() < 1e-4, "{mean}");
        assert!((variance - top / bottom).abs() < 1e-4, "{variance} {}", top / bottom);
    }

    #[test]
    fn projector_agrees_with_the_camera() {
        let camera = Camera::look_at(Vec3A::new(3.0, 2.0, 5.0), Vec3A::new(0.1, 0.2, 0.3), Vec3A::Y, 0.7, 320, 200);
        let projector = Projector::new(&camera);
        for p in [Vec3A::ZERO, Vec3A::new(0.5, -0.3, 1.0), Vec3A::new(-1.0, 0.4, -7.0)] {
            let (expected, _) = camera.project(p).expect("in front");
            let found = projector.project(p.as_dvec3()).expect("in front").as_vec2();
            assert!((expected - found).length() < 1e-3, "{expected} {found}");
        }
        assert!(projector.project(DVec3::new(6.0, 4.0, 10.0)).is_none());
    }
}
