//! Silhouettes on the horizon: one height an azimuth and a little relief, so that they close around the eye without a seam.

use super::canvas::{Point, luminance, rgb, smoothstep};
use super::parts::{Horizon, HorizonKind};
use crate::noise;
use crate::seed::Seed;
use glam::DVec3;
use rand::RngExt;
use rand_pcg::Pcg64;
use std::f64::consts::{PI, TAU};

/// Azimuths of the tables.
const STEPS: usize = 2880;

/// One range of hills, one row of trees or houses.
struct Row {
    /// Sine of the elevation of its rim by azimuth.
    rim: Vec<f64>,
    /// Which tree or house stands there.
    owner: Vec<u16>,
    /// Share of the sky's colour before it.
    haze: f64,
    /// Factor on the colour.
    shade: f64,
}

/// Everything on the horizon.
pub(super) struct Silhouette {
    kind: HorizonKind,
    /// From the nearest to the farthest.
    rows: Vec<Row>,
    /// Sine of the elevation of the highest point.
    top: f64,
    color: DVec3,
    seed: u32,
    light: Light,
}

/// What lights the silhouette.
#[derive(Clone, Default)]
pub(super) struct Light {
    /// Unit direction of the sun and its irradiance on a facing surface.
    pub sun: DVec3,
    pub sun_irradiance: DVec3,
    /// Irradiance from sky and ground on an upright face.
    pub ambient: DVec3,
    /// Radiance just above the horizon by azimuth, [`AIR`] entries.
    pub air: Vec<DVec3>,
}

/// Azimuths of [`Light::air`].
pub(super) const AIR: usize = 64;

/// Horizontal unit vector of a turn 0..1 about the vertical.
pub(super) fn heading(turn: f64) -> DVec3 {
    let (sin, cos) = (TAU * turn).sin_cos();
    DVec3::new(sin, 0.0, -cos)
}

/// Turn 0..1 of a direction about the vertical.
pub(super) fn turn(d: DVec3) -> f64 {
    (d.x.atan2(-d.z) / TAU).rem_euclid(1.0)
}

impl Silhouette {
    pub fn new(horizon: &Horizon, light: Light) -> Self {
        let height = f64::from(horizon.height).to_radians();
        let mut rng = Seed::root(u64::from(horizon.seed)).child("horizon", 0).rng();
        let seed = horizon.seed;
        let haze = f64::from(horizon.haze);
        // Share of the full height, haze and shade from near to far.
        let plan: &[(f64, f64, f64)] = match horizon.kind {
            HorizonKind::Hills => &[(0.55, 0.35, 1.0), (1.0, 1.0, 0.9)],
            HorizonKind::Ridges => &[(0.4, 0.25, 0.8), (0.68, 0.6, 0.9), (1.0, 1.0, 1.0)],
            HorizonKind::Dunes => &[(0.6, 0.15, 1.0), (1.0, 0.6, 1.05)],
            HorizonKind::Trees => &[(1.0, 0.25, 1.0), (0.75, 1.0, 0.8)],
            HorizonKind::Skyline => &[(1.0, 0.3, 1.0), (0.9, 1.0, 0.9)],
            HorizonKind::Roofs => &[(1.0, 0.3, 1.0), (0.7, 1.0, 0.9)],
            HorizonKind::Cliffs => &[(1.0, 0.5, 1.0)],
        };
        let rows: Vec<Row> = plan
            .iter()
            .enumerate()
            .map(|(k, &(share, distance, shade))| {
                let mut row = Row { rim: vec![0.0; STEPS], owner: vec![0; STEPS], haze: haze * distance, shade };
                row.raise(horizon.kind, seed.wrapping_add(977 * k as u32), &mut rng);
                row.rim.iter_mut().for_each(|h| *h = (height * share * *h).clamp(0.0, 0.48 * PI).sin());
                row
            })
            .collect();
        let top = rows.iter().flat_map(|row| &row.rim).copied().fold(0.0, f64::max);
        Self { kind: horizon.kind, rows, top, color: rgb(horizon.color), seed, light }
    }

    /// Whether the open sky is seen in direction `d`.
    pub fn is_open(&self, d: DVec3) -> bool {
        d.y > self.top || {
            let at = index(turn(d));
            self.rows.iter().all(|row| d.y > row.rim[at])
        }
    }

    /// Radiance of what stands in direction `d`; `None` where the sky is open.
    pub fn radiance(&self, d: DVec3) -> Option<DVec3> {
        if d.y > self.top {
            return None;
        }
        let turn = turn(d);
        let at = index(turn);
        let row = self.rows.iter().find(|row| d.y <= row.rim[at])?;
        let outward = heading(turn);
        let share = d.y / row.rim[at].max(1e-6);
        let (color, normal) = self.surface(row, d, at, outward, share);
        let direct = self.light.sun_irradiance * normal.dot(self.light.sun).max(0.0);
        let lit = color * row.shade * (direct + self.light.ambient * (0.75 + 0.25 * share)) / PI;
        let x = turn * AIR as f64;
        let (i, f) = ((x as usize).min(AIR - 1), x.fract());
        let air = match self.light.air.get(i) {
            Some(here) => here.lerp(self.light.air[(i + 1) % AIR], f),
            None => DVec3::ZERO,
        };
        Some(lit.lerp(air, row.haze * (1.0 - 0.35 * share)))
    }

    /// Colour and a normal of about unit length, towards the eye.
    fn surface(&self, row: &Row, d: DVec3, at: usize, outward: DVec3, share: f64) -> (DVec3, DVec3) {
        let grain = |scale: f64, octaves: u32| noise::fractal(d * scale, octaves, self.seed.wrapping_add(17));
        let sideways = DVec3::new(-outward.z, 0.0, outward.x);
        let owner = f64::from(row.owner[at] % 61) / 61.0;
        match self.kind {
            HorizonKind::Hills => {
                (self.color * (1.0 + 0.6 * grain(22.0, 3)), DVec3::Y * 0.75 - outward * 0.6 + sideways * grain(9.0, 2))
            }
            HorizonKind::Dunes => {
                // Lee and windward faces meet in the crest: the slope of the rim says which one this is.
                let next = row.rim[(at + 12) % STEPS] - row.rim[(at + STEPS - 12) % STEPS];
                let tilt = (next * 40.0).clamp(-0.9, 0.9) * share;
                (self.color * (1.0 + 0.12 * grain(60.0, 2)), DVec3::Y * 0.7 - outward * 0.5 - sideways * tilt)
            }
            HorizonKind::Ridges => {
                // Gullies run down the slope.
                let relief = noise::fractal(DVec3::new(d.x * 8.0, d.y * 6.0, d.z * 8.0), 4, self.seed.wrapping_add(17));
                let normal = DVec3::Y * 0.6 - outward * 0.6 + sideways * (1.6 * relief);
                let snow = smoothstep(0.5, 0.7, share + 0.6 * relief) * smoothstep(0.85, 0.95, row.shade);
                ((self.color * (1.0 + 0.5 * relief)).lerp(DVec3::splat(0.82), snow), normal)
            }
            HorizonKind::Trees => {
                let tint = DVec3::new(1.0 + 0.35 * (owner - 0.5), 1.0, 1.0 - 0.3 * (owner - 0.5));
                (
                    self.color * tint * (1.0 + 1.1 * grain(55.0, 2)).max(0.1),
                    DVec3::Y * 0.5 - outward * 0.7 + sideways * 1.2 * grain(30.0, 1),
                )
            }
            HorizonKind::Skyline | HorizonKind::Roofs => {
                let tint = DVec3::new(0.75 + 0.5 * owner, 0.75 + 0.45 * owner, 0.7 + 0.5 * ((owner * 7.0).fract()));
                let (column, floor) = facade(self.kind, at, d.y);
                let glass = column.fract() > 0.35 && floor.fract() > 0.4;
                // Fronts turn this way and that; glass is darker than the wall.
                let front = (DVec3::Y * 0.05 - outward * 0.9 + sideways * 1.6 * (owner - 0.5)).normalize_or(-outward);
                (self.color * tint * if glass { 0.45 } else { 1.0 }, front)
            }
            HorizonKind::Cliffs => {
                let ledge = grain(11.0, 4) + 0.35 * (d.y * 40.0 + 4.0 * grain(5.0, 1)).sin();
                (self.color * (1.0 + 0.7 * ledge).max(0.15), DVec3::Y * 0.35 - outward * 0.8 + sideways * (1.6 * grain(8.0, 2)))
            }
        }
    }

    /// Lit windows, `share` of all, that bring `mean` luminance to the whole map; `seen` says how much of each is not hidden.
    pub fn windows(&self, share: f64, mean: f64, seen: impl Fn(DVec3) -> f64) -> Vec<Point> {
        let has_windows = matches!(self.kind, HorizonKind::Skyline | HorizonKind::Roofs);
        if !(has_windows && share > 0.0 && mean > 0.0) {
            return Vec::new();
        }
        let mut rng = Seed::root(u64::from(self.seed)).child("windows", 0).rng();
        let mut found = Vec::new();
        let step = spacing(self.kind);
        for column in 0..(STEPS / step.0) {
            let at = column * step.0 + step.0 / 2;
            let outward = heading((at as f64 + 0.5) / STEPS as f64);
            let mut y = 0.6 * step.1;
            while y < self.top {
                let on: f64 = rng.random();
                let warm: f64 = rng.random();
                if self.rows.iter().any(|row| y + 0.3 * step.1 < row.rim[at]) && on < share {
                    let color = DVec3::new(1.0, 0.72, 0.42).lerp(DVec3::new(0.8, 0.92, 1.0), smoothstep(0.55, 0.9, warm));
                    let d = (outward * (1.0 - y * y).sqrt()).with_y(y);
                    found.push((d, color * (0.3 + rng.random::<f64>())));
                }
                y += step.1;
            }
        }
        let total: f64 = found.iter().map(|(_, energy)| luminance(*energy)).sum();
        let scale = if total > 0.0 { 4.0 * PI * mean / total } else { 0.0 };
        found.into_iter().map(|(d, energy)| (d, energy * (scale * seen(d)))).collect()
    }
}

/// Azimuth steps and sine of the elevation from window to window.
fn spacing(kind: HorizonKind) -> (usize, f64) {
    if kind == HorizonKind::Roofs { (18, 0.028) } else { (14, 0.026) }
}

/// Columns and floors of windows, whole numbers at their edges.
fn facade(kind: HorizonKind, at: usize, y: f64) -> (f64, f64) {
    let step = spacing(kind);
    (at as f64 / step.0 as f64, y / step.1)
}

fn index(turn: f64) -> usize {
    ((turn * STEPS as f64) as usize).min(STEPS - 1)
}

impl Row {
    /// Fills the rim with shares 0..=1 of the height.
    fn raise(&mut self, kind: HorizonKind, seed: u32, rng: &mut Pcg64) {
        match kind {
            HorizonKind::Hills => self.land(|p| 0.6 + 0.95 * noise::fractal(p * 1.7, 4, seed)),
            HorizonKind::Ridges => self.land(|p| {
                // Folded noise has sharp crests.
                let fold = 1.0 - 1.3 * noise::gradient(p * 1.7, seed).abs() - 0.5 * noise::fractal(p * 4.3, 3, seed ^ 9).abs();
                (0.12 + 0.88 * fold.max(0.0)) * (0.8 + 0.6 * noise::gradient(p * 1.1, seed ^ 5))
            }),
            HorizonKind::Dunes => self.land(|p| {
                let fold = 1.0 - 1.5 * noise::gradient(p * 1.6, seed).abs();
                0.1 + 0.9 * fold * (0.85 + 0.5 * noise::gradient(p * 0.9, seed ^ 3))
            }),
            HorizonKind::Cliffs => self.land(|p| {
                let wall = 0.6 + 0.9 * noise::fractal(p * 1.3, 3, seed);
                0.8 * smoothstep(0.2, 0.75, wall) + 0.12 + 0.12 * noise::fractal(p * 9.0, 4, seed ^ 1)
            }),
            HorizonKind::Trees => {
                self.land(|p| 0.28 + 0.2 * noise::fractal(p * 12.0, 4, seed));
                let count = 150 + rng.random_range(0..90u16);
                for id in 0..count {
                    let (centre, height): (f64, f64) = (rng.random(), rng.random());
                    let (width, pointed) = (rng.random_range(1.2..4.2f64) / 360.0, rng.random::<f64>() < 0.45);
                    let height = 0.4 + 0.6 * height * height;
                    self.stand(id, centre, if pointed { 0.6 * width } else { width }, |x| {
                        let ragged = 0.06 * noise::fractal(DVec3::new(x * 6.0, f64::from(id), 0.3), 3, seed);
                        let crown = if pointed { 1.0 - x.abs() } else { (1.0 - x * x).max(0.0).sqrt() };
                        height * (0.3 + 0.7 * crown) + ragged
                    });
                }
            }
            HorizonKind::Skyline => {
                let count = 60 + rng.random_range(0..60u16);
                for id in 0..count {
                    let (centre, height): (f64, f64) = (rng.random(), rng.random());
                    let width = rng.random_range(2.0..8.0f64) / 360.0;
                    // Few are high.
                    let height = 0.18 + 0.82 * height.powf(2.2);
                    let (stepped, spire) = (rng.random::<f64>() < 0.3, rng.random::<f64>() < 0.15);
                    self.stand(id, centre, 0.5 * width, |x| {
                        let set_back = if stepped && x.abs() > 0.6 { 0.82 } else { 1.0 };
                        let mast = if spire && x.abs() < 0.07 { 1.18 } else { 1.0 };
                        (height * set_back * mast).min(1.0)
                    });
                }
            }
            HorizonKind::Roofs => {
                let count = 46 + rng.random_range(0..30u16);
                for id in 0..count {
                    let (centre, height): (f64, f64) = (rng.random(), rng.random());
                    let (width, gable) = (rng.random_range(4.0..11.0f64) / 360.0, rng.random::<f64>() < 0.6);
                    self.stand(id, centre, 0.5 * width, |x| {
                        let roof = if gable { 1.0 - x.abs() } else { (2.5 * (1.0 - x.abs())).min(1.0) };
                        (0.3 + 0.4 * height) * (0.62 + 0.38 * roof) + if (x - 0.4).abs() < 0.06 { 0.1 } else { 0.0 }
                    });
                }
            }
        }
    }

    /// A rim that is a function of the point on the unit circle, so that it closes.
    fn land(&mut self, height: impl Fn(DVec3) -> f64) {
        for (i, rim) in self.rim.iter_mut().enumerate() {
            *rim = height(heading(i as f64 / STEPS as f64)).clamp(0.02, 1.0);
        }
    }

    /// Puts up one thing about the turn `centre`; `height` is its rim over -1..=1.
    fn stand(&mut self, id: u16, centre: f64, half_width: f64, height: impl Fn(f64) -> f64) {
        let first = ((centre - half_width) * STEPS as f64).floor() as i64;
        let last = ((centre + half_width) * STEPS as f64).ceil() as i64;
        for step in first..=last {
            let x = ((step as f64 + 0.5) / STEPS as f64 - centre) / half_width;
            let at = step.rem_euclid(STEPS as i64) as usize;
            if x.abs() <= 1.0 && height(x) > self.rim[at] {
                self.rim[at] = height(x).min(1.0);
                self.owner[at] = id;
            }
        }
    }
}
