//! A clear sky: light of the sun scattered once by air and haze, dimmed by ozone, plus a multiple-scattering term.
//!
//! Densities and coefficients are those of Bruneton and Neyret (2008) and Hillaire (2020, "A Scalable and Production Ready Sky
//! and Atmosphere Rendering Technique"); the isotropic multiple-scattering term follows section 5.5 of the latter. Distances are
//! kilometres.

use super::canvas::luminance;
use glam::DVec3;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

const PLANET: f64 = 6360.0;
const TOP: f64 = 6440.0;
/// The eye stands a little above the ground, so that the horizon is a horizon.
const EYE: f64 = PLANET + 0.2;
const RAYLEIGH: DVec3 = DVec3::new(5.802e-3, 13.558e-3, 33.1e-3);
const RAYLEIGH_HEIGHT: f64 = 8.0;
const MIE_HEIGHT: f64 = 1.2;
/// Share of the light lost in haze that is scattered and not absorbed.
const MIE_ALBEDO: f64 = 0.9;
const MIE_ASYMMETRY: f64 = 0.8;
const OZONE: DVec3 = DVec3::new(0.650e-3, 1.881e-3, 0.085e-3);

/// Elevations and azimuths of the table of scattered light.
const ELEVATIONS: usize = 64;
const AZIMUTHS: usize = 32;

/// Altitudes and sines of the table of optical depths; the sines lie within `SINE_RANGE` of the sun's at the eye.
const ALTITUDES: usize = 40;
const SINES: usize = 96;
const SINE_RANGE: f64 = 0.25;
/// Altitudes of the tables end here, km.
const ATMOSPHERE: f64 = 60.0;

/// Scattered light in one direction before the phase functions.
#[derive(Clone, Copy, Default)]
struct Scattered {
    rayleigh: DVec3,
    mie: DVec3,
    multiple: DVec3,
}

/// A clear sky, scaled so that its mean luminance above the horizon is known.
pub(super) struct Atmosphere {
    /// Haze extinction at sea level, 1/km.
    mie: f64,
    /// Unit direction of the sun.
    pub sun: DVec3,
    table: Vec<Scattered>,
    /// Optical depth towards the sun by altitude and by the sine of the sun's elevation there ([`Atmosphere::sunlight`]).
    depths: Vec<DVec3>,
    scale: f64,
    /// Irradiance of the sun on a surface that faces it.
    pub sun_irradiance: DVec3,
    /// Irradiance of the sky (without the sun) on level ground.
    pub sky_irradiance: DVec3,
}

impl Atmosphere {
    /// `sun` is a unit direction, `mean` the wanted mean luminance of the upper half.
    pub fn new(sun: DVec3, turbidity: f64, albedo: DVec3, mean: f64) -> Self {
        // Turbidity is the optical depth of air and haze over that of air alone, upwards and at 550 nm.
        let mie = (turbidity - 1.0).max(0.0) * RAYLEIGH.y * RAYLEIGH_HEIGHT / MIE_HEIGHT;
        let mut sky = Self {
            mie,
            sun,
            table: Vec::new(),
            depths: Vec::new(),
            scale: 1.0,
            sun_irradiance: DVec3::ZERO,
            sky_irradiance: DVec3::ZERO,
        };
        sky.depths = (0..ALTITUDES * SINES)
            .map(|i| {
                let r = PLANET + altitude(i / SINES, ALTITUDES).max(0.001);
                let mu = sky.sine(i % SINES);
                sky.sun_depth(r, mu)
            })
            .collect();
        let multiple = sky.multiple_scattering(albedo);
        sky.table = (0..ELEVATIONS * AZIMUTHS)
            .map(|i| {
                let (e, a) = (i / AZIMUTHS, i % AZIMUTHS);
                sky.scatter(table_direction(sun, e, a), &multiple)
            })
            .collect();
        let (mut total, mut count) = (0.0, 0.0);
        for e in 0..48 {
            // Equal steps of the sine of the elevation are equal solid angles.
            let y = (f64::from(e) + 0.5) / 48.0;
            let across = (1.0 - y * y).sqrt();
            for a in 0..48 {
                let (s, c) = (TAU * (f64::from(a) + 0.5) / 48.0).sin_cos();
                let radiance = sky.radiance(DVec3::new(s * across, y, c * across));
                total += luminance(radiance);
                count += 1.0;
                sky.sky_irradiance += radiance * y;
            }
        }
        sky.scale = if total > 0.0 { mean * count / total } else { 0.0 };
        sky.sky_irradiance *= sky.scale * TAU / count;
        sky.sun_irradiance = sky.sunlight(DVec3::new(0.0, EYE, 0.0)) * sky.scale;
        sky
    }

    /// Radiance of the sky in unit direction `d`, the sun's disc left out; below the horizon that of the horizon.
    pub fn radiance(&self, d: DVec3) -> DVec3 {
        let elevation = d.y.clamp(0.0, 1.0).asin();
        let turn = {
            let (a, b) = (self.sun.x.atan2(self.sun.z), d.x.atan2(d.z));
            let difference = (a - b).abs();
            difference.min(TAU - difference)
        };
        let x = (elevation / FRAC_PI_2).sqrt() * (ELEVATIONS - 1) as f64;
        let y = turn / PI * (AZIMUTHS - 1) as f64;
        let (i, j) = ((x as usize).min(ELEVATIONS - 2), (y as usize).min(AZIMUTHS - 2));
        let (fx, fy) = (x - i as f64, y - j as f64);
        let mut light = Scattered::default();
        for (di, dj, weight) in
            [(0, 0, (1.0 - fx) * (1.0 - fy)), (1, 0, fx * (1.0 - fy)), (0, 1, (1.0 - fx) * fy), (1, 1, fx * fy)]
        {
            let entry = &self.table[(i + di) * AZIMUTHS + j + dj];
            light.rayleigh += entry.rayleigh * weight;
            light.mie += entry.mie * weight;
            light.multiple += entry.multiple * weight;
        }
        let cos = d.dot(self.sun);
        (light.rayleigh * rayleigh_phase(cos) + light.mie * mie_phase(cos) + light.multiple) * self.scale
    }

    /// Extinction by (air, haze, ozone) at radius `r`, 1/km.
    fn extinction(&self, r: f64) -> DVec3 {
        let (air, haze) = self.scattering(r);
        let height = r - PLANET;
        let ozone = OZONE * (1.0 - (height - 25.0).abs() / 15.0).max(0.0);
        air + DVec3::splat(haze / MIE_ALBEDO) + ozone
    }

    /// Scattering by air and by haze at radius `r`, 1/km.
    fn scattering(&self, r: f64) -> (DVec3, f64) {
        let height = (r - PLANET).max(0.0);
        (RAYLEIGH * (-height / RAYLEIGH_HEIGHT).exp(), MIE_ALBEDO * self.mie * (-height / MIE_HEIGHT).exp())
    }

    /// Share of the sunlight that reaches `p` (from the planet's centre); the planet's shadow has a soft rim.
    fn sunlight(&self, p: DVec3) -> DVec3 {
        let r = p.length();
        let mu = p.dot(self.sun) / r;
        let horizon = -(1.0 - (PLANET / r).powi(2)).max(0.0).sqrt();
        // The disc is half a degree wide: it fades while it sets.
        let visible = ((mu - horizon) / 0.0093 + 0.5).clamp(0.0, 1.0);
        if visible == 0.0 {
            return DVec3::ZERO;
        }
        // Along any view the sun's elevation changes by the bend of the planet only: a narrow table holds all that is asked for.
        let x = ((r - PLANET) / ATMOSPHERE).clamp(0.0, 1.0).sqrt() * (ALTITUDES - 1) as f64;
        let y = ((mu - self.sun.y) / SINE_RANGE * 0.5 + 0.5).clamp(0.0, 1.0) * (SINES - 1) as f64;
        let (i, j) = ((x as usize).min(ALTITUDES - 2), (y as usize).min(SINES - 2));
        let at = |i: usize, j: usize| self.depths[i * SINES + j];
        let low = at(i, j).lerp(at(i, j + 1), y - j as f64);
        let high = at(i + 1, j).lerp(at(i + 1, j + 1), y - j as f64);
        (-low.lerp(high, x - i as f64)).exp() * visible
    }

    /// Sine of the sun's elevation of table column `j`.
    fn sine(&self, j: usize) -> f64 {
        self.sun.y + SINE_RANGE * (2.0 * j as f64 / (SINES - 1) as f64 - 1.0)
    }

    /// Optical depth from radius `r` to the top along a direction whose sine of elevation is `mu`.
    fn sun_depth(&self, r: f64, mu: f64) -> DVec3 {
        let mu = mu.clamp(-1.0, 1.0);
        let (p, d) = (DVec3::new(0.0, r, 0.0), DVec3::new((1.0 - mu * mu).sqrt(), mu, 0.0));
        let length = to_top(p, d);
        let mut depth = DVec3::ZERO;
        let steps = 40;
        for i in 0..steps {
            // Quadratic steps: air is dense near the start.
            let (t, dt) = quadratic_step(i, steps, length);
            depth += self.extinction((p + d * t).length()) * dt;
        }
        depth
    }

    /// Light scattered towards the eye from direction `d`.
    fn scatter(&self, d: DVec3, multiple: &[DVec3]) -> Scattered {
        let eye = DVec3::new(0.0, EYE, 0.0);
        let length = to_top(eye, d);
        let mut light = Scattered::default();
        let mut depth = DVec3::ZERO;
        let steps = 48;
        for i in 0..steps {
            let (t, dt) = quadratic_step(i, steps, length);
            let p = eye + d * t;
            let r = p.length();
            let step = self.extinction(r) * dt;
            let through = (-(depth + 0.5 * step)).exp();
            depth += step;
            let (air, haze) = self.scattering(r);
            let sun = self.sunlight(p) * through * dt;
            light.rayleigh += air * sun;
            light.mie += haze * sun;
            light.multiple += (air + DVec3::splat(haze)) * through * dt * lookup(multiple, r - PLANET);
        }
        light
    }

    /// Mean radiance of light scattered twice and more, by altitude ([`lookup`]).
    fn multiple_scattering(&self, albedo: DVec3) -> Vec<DVec3> {
        let (altitudes, directions, steps) = (12, 48, 20);
        let mut table = Vec::new();
        for level in 0..altitudes {
            let eye = DVec3::new(0.0, PLANET + altitude(level, altitudes).max(0.01), 0.0);
            let (mut second, mut again) = (DVec3::ZERO, DVec3::ZERO);
            for k in 0..directions {
                // A spiral of equal solid angles.
                let y = 1.0 - 2.0 * (f64::from(k) + 0.5) / f64::from(directions);
                let (s, c) = (f64::from(k) * 2.399_963_229_728_653).sin_cos();
                let across = (1.0 - y * y).sqrt();
                let d = DVec3::new(s * across, y, c * across);
                let ground = to_ground(eye, d);
                let length = ground.unwrap_or_else(|| to_top(eye, d));
                let mut depth = DVec3::ZERO;
                for i in 0..steps {
                    let (t, dt) = quadratic_step(i, steps, length);
                    let p = eye + d * t;
                    let r = p.length();
                    let step = self.extinction(r) * dt;
                    let through = (-(depth + 0.5 * step)).exp();
                    depth += step;
                    let (air, haze) = self.scattering(r);
                    let scattering = (air + DVec3::splat(haze)) * through * dt;
                    second += scattering * self.sunlight(p) / (4.0 * PI);
                    again += scattering;
                }
                if let Some(t) = ground {
                    let p = eye + d * t;
                    let cos = (p.normalize().dot(self.sun)).max(0.0);
                    second += (-depth).exp() * albedo * self.sunlight(p) * (cos / PI);
                }
            }
            let n = f64::from(directions);
            table.push(second / n / (DVec3::ONE - again / n).max(DVec3::splat(0.05)));
        }
        table
    }
}

/// Altitude in km of entry `level`; denser near the ground.
fn altitude(level: usize, levels: usize) -> f64 {
    ATMOSPHERE * (level as f64 / (levels - 1) as f64).powi(2)
}

fn lookup(table: &[DVec3], height: f64) -> DVec3 {
    let x = (height / ATMOSPHERE).clamp(0.0, 1.0).sqrt() * (table.len() - 1) as f64;
    let i = (x as usize).min(table.len() - 2);
    table[i].lerp(table[i + 1], x - i as f64)
}

/// Direction of table entry (e, a): elevation 0..90 degrees with dense rows at the horizon, azimuth 0..180 degrees from the
/// sun's.
fn table_direction(sun: DVec3, e: usize, a: usize) -> DVec3 {
    let elevation = FRAC_PI_2 * (e as f64 / (ELEVATIONS - 1) as f64).powi(2);
    let azimuth = sun.x.atan2(sun.z) + PI * a as f64 / (AZIMUTHS - 1) as f64;
    DVec3::new(elevation.cos() * azimuth.sin(), elevation.sin(), elevation.cos() * azimuth.cos())
}

/// Middle and length of step `i` of `steps` along `length`, steps growing with the distance.
fn quadratic_step(i: i32, steps: i32, length: f64) -> (f64, f64) {
    let mark = |k: f64| length * (k / f64::from(steps)).powi(2);
    (mark(f64::from(i) + 0.5), mark(f64::from(i) + 1.0) - mark(f64::from(i)))
}

/// Distance from `p` inside the atmosphere to its top along `d`.
fn to_top(p: DVec3, d: DVec3) -> f64 {
    let b = p.dot(d);
    (-b + (b * b - p.length_squared() + TOP * TOP).max(0.0).sqrt()).max(0.0)
}

/// Distance to the ground along `d`, if it is met.
fn to_ground(p: DVec3, d: DVec3) -> Option<f64> {
    let b = p.dot(d);
    let discriminant = b * b - p.length_squared() + PLANET * PLANET;
    (b < 0.0 && discriminant >= 0.0).then(|| (-b - discriminant.sqrt()).max(0.0))
}

fn rayleigh_phase(cos: f64) -> f64 {
    3.0 / (16.0 * PI) * (1.0 + cos * cos)
}

/// Cornette and Shanks (1992).
fn mie_phase(cos: f64) -> f64 {
    let g = MIE_ASYMMETRY;
    let base = 1.0 + g * g - 2.0 * g * cos;
    3.0 / (8.0 * PI) * (1.0 - g * g) * (1.0 + cos * cos) / ((2.0 + g * g) * base * base.sqrt())
}
