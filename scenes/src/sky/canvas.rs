//! From directions to texels: a smooth background and compact emitters whose total light is fixed before they are drawn.

use glam::DVec3;
use rayon::prelude::*;
use renderflow_frame::hdr;
use renderflow_frame::image::Rgb;
use std::f64::consts::{PI, TAU};
use std::path::Path;

/// Radiance as a function of a unit direction.
pub(super) type Radiance = Box<dyn Fn(DVec3) -> DVec3 + Sync>;

/// Something small and bright, added to the background.
pub(super) struct Emitter {
    /// Unit direction of the cone that contains it.
    pub axis: DVec3,
    /// Half angle of that cone, radians.
    pub bound: f64,
    /// Radiance; zero outside the cone.
    pub radiance: Radiance,
    /// Integral of the radiance over solid angle, from a quadrature of its own that does not know the map's size.
    pub energy: DVec3,
}

/// A light much smaller than a texel: unit direction and integral of its radiance over solid angle.
pub(super) type Point = (DVec3, DVec3);

/// A whole environment before it has texels.
pub(super) struct Dome {
    pub background: Radiance,
    pub emitters: Vec<Emitter>,
    /// Each is drawn into the one texel that holds it.
    pub points: Vec<Point>,
}

/// Unit direction of map coordinates, as in `renderflow_frame::Environment`.
pub(super) fn direction(u: f64, v: f64) -> DVec3 {
    let ((sin_phi, cos_phi), (sin_theta, cos_theta)) = ((TAU * u).sin_cos(), (PI * v).sin_cos());
    DVec3::new(sin_phi * sin_theta, cos_theta, -cos_phi * sin_theta)
}

/// Unit direction at `elevation` and `azimuth` degrees.
pub(super) fn toward(elevation: f32, azimuth: f32) -> DVec3 {
    direction(f64::from(azimuth) / 360.0, 0.5 - f64::from(elevation) / 180.0)
}

/// Linear Rec.709 luminance.
pub(super) fn luminance(rgb: DVec3) -> f64 {
    rgb.dot(DVec3::new(0.2126, 0.7152, 0.0722))
}

/// A colour of the description in f64.
pub(super) fn rgb(color: [f32; 3]) -> DVec3 {
    DVec3::from(color.map(f64::from))
}

/// Cubic step from 0 at `low` to 1 at `high`.
pub(super) fn smoothstep(low: f64, high: f64, x: f64) -> f64 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

impl Dome {
    /// Area-averaged map, quantised as its `.hdr` file is.
    pub fn render(&self, width: usize, height: usize) -> Rgb {
        if width == 0 || height == 0 {
            return Rgb::filled(width, height, [0.0; 3]);
        }
        // Enough samples a texel that small maps average what large ones resolve.
        let sub = 512usize.div_ceil(width).clamp(1, 8);
        let mut texels: Vec<DVec3> = (0..width * height)
            .into_par_iter()
            .map(|i| average(i % width, i / width, width, height, sub, &self.background))
            .collect();
        for emitter in &self.emitters {
            emitter.add(&mut texels, width, height);
        }
        for &(direction, energy) in &self.points {
            let texel = texel_of(direction, width, height);
            texels[texel] += energy / solid_angle(texel / width, width, height);
        }
        let pixels = texels.iter().map(|t| t.max(DVec3::ZERO).as_vec3().to_array()).collect();
        let bytes = hdr::encode(&Rgb { width, height, pixels });
        // The encoder's own bytes always decode.
        hdr::decode(Path::new("generated sky"), &bytes).expect("a map just encoded decodes").map
    }
}

/// Index of the texel that holds a unit direction.
fn texel_of(d: DVec3, width: usize, height: usize) -> usize {
    let u = (d.x.atan2(-d.z) / TAU).rem_euclid(1.0);
    let v = d.y.clamp(-1.0, 1.0).acos() / PI;
    ((v * height as f64) as usize).min(height - 1) * width + ((u * width as f64) as usize).min(width - 1)
}

/// Solid angle of a texel of row `y`.
fn solid_angle(y: usize, width: usize, height: usize) -> f64 {
    let (top, bottom) = (PI * y as f64 / height as f64, PI * (y + 1) as f64 / height as f64);
    TAU / width as f64 * (top.cos() - bottom.cos())
}

/// Mean of `f` over a texel, by solid angle, from `sub x sub` samples.
fn average(x: usize, y: usize, width: usize, height: usize, sub: usize, f: &Radiance) -> DVec3 {
    let (mut sum, mut weight) = (DVec3::ZERO, 0.0);
    for j in 0..sub {
        let v = (y as f64 + (j as f64 + 0.5) / sub as f64) / height as f64;
        let sin = (PI * v).sin();
        for i in 0..sub {
            let u = (x as f64 + (i as f64 + 0.5) / sub as f64) / width as f64;
            sum += sin * f(direction(u, v));
            weight += sin;
        }
    }
    sum / weight
}

impl Emitter {
    /// Adds the emitter to a map; the sum over texels is `energy` exactly, whatever the resolution.
    fn add(&self, texels: &mut [DVec3], width: usize, height: usize) {
        let solid_angle = |y: usize| solid_angle(y, width, height);
        let texel = (PI / height as f64).hypot(TAU / width as f64);
        let reach = (self.bound + texel).min(PI).cos();
        let sub = ((16.0 * texel / self.bound).ceil() as usize).clamp(2, 48);
        let axis_theta = self.axis.y.clamp(-1.0, 1.0).acos();
        let drawn: Vec<(usize, DVec3)> = (0..texels.len())
            .into_par_iter()
            .filter_map(|i| {
                let (x, y) = (i % width, i / width);
                // Most rows are too far away whatever the column.
                if (PI * (y as f64 + 0.5) / height as f64 - axis_theta).abs() > self.bound + texel {
                    return None;
                }
                let centre = direction((x as f64 + 0.5) / width as f64, (y as f64 + 0.5) / height as f64);
                let value =
                    if centre.dot(self.axis) < reach { DVec3::ZERO } else { average(x, y, width, height, sub, &self.radiance) };
                (value != DVec3::ZERO).then_some((i, value))
            })
            .collect();
        let total: DVec3 = drawn.iter().map(|&(i, value)| value * solid_angle(i / width)).sum();
        let axis_texel = texel_of(self.axis, width, height);
        for channel in 0..3 {
            if total[channel] > 0.0 {
                let scale = self.energy[channel] / total[channel];
                drawn.iter().for_each(|&(i, value)| texels[i][channel] += value[channel] * scale);
            } else {
                // Thinner than the samples' spacing: all of it goes to one texel.
                texels[axis_texel][channel] += self.energy[channel] / solid_angle(axis_texel / width);
            }
        }
    }
}

/// A round emitter: `radiance` inside a cone of `radius` radians about `axis`.
pub(super) fn disc(axis: DVec3, radius: f64, radiance: impl Fn(DVec3) -> DVec3 + Sync + 'static) -> Emitter {
    let cos = radius.cos();
    let (a, b) = axis.any_orthonormal_pair();
    let (rings, sectors) = (32, 64);
    let mut energy = DVec3::ZERO;
    for ring in 0..rings {
        // Equal steps of the cosine are equal solid angles.
        let c = 1.0 - (1.0 - cos) * (f64::from(ring) + 0.5) / f64::from(rings);
        let s = (1.0 - c * c).max(0.0).sqrt();
        for sector in 0..sectors {
            let (sin, cosine) = (TAU * (f64::from(sector) + 0.5) / f64::from(sectors)).sin_cos();
            energy += radiance(axis * c + (a * cosine + b * sin) * s);
        }
    }
    energy *= TAU * (1.0 - cos) / f64::from(rings * sectors);
    let inside = move |d: DVec3| if d.dot(axis) >= cos { radiance(d) } else { DVec3::ZERO };
    Emitter { axis, bound: radius, radiance: Box::new(inside), energy }
}

/// A flat emitter with the given centre and half-extent vectors (perpendicular); `profile(a, b)` is its radiance at a, b in
/// -1..=1.
pub(super) fn flat(centre: DVec3, half_u: DVec3, half_v: DVec3, profile: impl Fn(f64, f64) -> DVec3 + Sync + 'static) -> Emitter {
    flat_by(96, centre, half_u, half_v, profile)
}

/// As [`flat`], its light measured on `cells x cells` places.
pub(super) fn flat_by(
    cells: u32,
    centre: DVec3,
    half_u: DVec3,
    half_v: DVec3,
    profile: impl Fn(f64, f64) -> DVec3 + Sync + 'static,
) -> Emitter {
    let normal = half_u.cross(half_v).normalize_or(DVec3::Y);
    let axis = centre.normalize_or(DVec3::Y);
    let area = 4.0 * half_u.cross(half_v).length() / f64::from(cells * cells);
    let mut energy = DVec3::ZERO;
    for j in 0..cells {
        for i in 0..cells {
            let mark = |k: u32| 2.0 * (f64::from(k) + 0.5) / f64::from(cells) - 1.0;
            let p = centre + half_u * mark(i) + half_v * mark(j);
            energy += profile(mark(i), mark(j)) * (area * p.dot(normal).abs() / p.length().powi(3).max(1e-12));
        }
    }
    let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
    let bound = corners
        .map(|(a, b)| (centre + half_u * a + half_v * b).normalize_or(axis).dot(axis).clamp(-1.0, 1.0).acos())
        .into_iter()
        .fold(1e-4, f64::max);
    let (distance, scale_u, scale_v) = (centre.dot(normal), half_u.length_squared(), half_v.length_squared());
    let radiance = move |d: DVec3| {
        let t = distance / d.dot(normal);
        if !(t.is_finite() && t > 0.0) {
            return DVec3::ZERO;
        }
        let q = d * t - centre;
        let (a, b) = (q.dot(half_u) / scale_u, q.dot(half_v) / scale_v);
        if a.abs() <= 1.0 && b.abs() <= 1.0 { profile(a, b) } else { DVec3::ZERO }
    };
    Emitter { axis, bound, radiance: Box::new(radiance), energy }
}
