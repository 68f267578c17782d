//! What stands between the eye and the sky: leaves, glazing bars, beams, rock, arches.

use super::canvas::{rgb, smoothstep, toward};
use super::horizon::{heading, turn};
use super::parts::{Cover, CoverKind};
use crate::noise;
use glam::DVec3;
use std::f64::consts::PI;

/// A cover ready to be asked.
pub(super) struct Shade {
    kind: CoverKind,
    amount: f64,
    scale: f64,
    /// Middle of a cave's opening.
    opening: DVec3,
    along: DVec3,
    across: DVec3,
    color: DVec3,
    seed: u32,
    /// Irradiance on its inner side, and the sun behind it.
    pub inside: DVec3,
    pub sun: DVec3,
}

/// Open share of a row of bars one unit apart that close `share` of it, seen with `blur` (in units).
fn bars(x: f64, share: f64, blur: f64) -> f64 {
    let from_bar = (x - x.round()).abs();
    let sharp = smoothstep(0.5 * share - blur, 0.5 * share + blur, from_bar);
    let far = smoothstep(0.2, 0.6, blur);
    sharp * (1.0 - far) + (1.0 - share) * far
}

/// Angle between the samples of a map 512 wide, radians.
const SAMPLE: f64 = 0.0123;

impl Shade {
    pub fn new(cover: &Cover) -> Self {
        let along = heading(f64::from(cover.azimuth) / 360.0);
        Self {
            kind: cover.kind,
            amount: f64::from(cover.amount),
            scale: f64::from(cover.scale),
            opening: toward(cover.elevation, cover.azimuth),
            along,
            across: DVec3::new(-along.z, 0.0, along.x),
            color: rgb(cover.color),
            seed: cover.seed,
            inside: DVec3::ZERO,
            sun: DVec3::Y,
        }
    }

    /// Share of the light from direction `d` above the horizon that comes through.
    pub fn open(&self, d: DVec3) -> f64 {
        match self.kind {
            CoverKind::Leaves => {
                let leaves = 0.5 + 0.5 * noise::fractal(d * (6.0 / self.scale), 4, self.seed) / 0.45;
                let edge = 1.15 - 1.3 * self.amount * (0.75 + 0.35 * smoothstep(0.0, 0.5, d.y));
                let crown = 1.0 - smoothstep(edge - 0.06, edge + 0.06, leaves);
                if d.y > 0.6 {
                    return crown;
                }
                // Trunks stand upright and taper into the crown.
                let stem = noise::gradient(heading(turn(d)) * (9.0 / self.scale), self.seed ^ 11);
                crown * (1.0 - smoothstep(0.42 + 0.5 * d.y, 0.46 + 0.5 * d.y, stem))
            }
            CoverKind::Ribs => {
                let (a, b, up) = (d.dot(self.across), d.dot(self.along), d.y.max(1e-4));
                let share = 1.0 - (1.0 - self.amount).sqrt();
                let ring = a.hypot(up);
                let (x, y) = if b.abs() < 2.2 * ring {
                    // The barrel: around it and along it.
                    (a.atan2(up) / (0.26 * self.scale), b / ring / (0.55 * self.scale))
                } else {
                    (a / b / (0.12 * self.scale), up / b.abs() / (0.12 * self.scale))
                };
                let blur = 0.6 * SAMPLE / (0.2 * self.scale);
                bars(x, share, blur) * bars(y, share, blur)
            }
            CoverKind::Lattice => {
                let up = d.y.max(1e-3);
                let (x, y) = (d.dot(self.across) / up, d.dot(self.along) / up);
                let spacing = 0.3 * self.scale;
                let blur = SAMPLE * (1.0 + x * x + y * y) / spacing;
                let roof = (1.0 - smoothstep(2.4, 3.0, x.abs())) * (1.0 - smoothstep(2.4, 3.0, y.abs()));
                let beams = bars(x / spacing, self.amount, 0.5 * blur) * bars(y / (3.0 * spacing), 0.12, 0.2 * blur);
                1.0 - roof * (1.0 - beams)
            }
            CoverKind::Cave => {
                // The cap that leaves `amount` of the sphere.
                let radius = (2.0 * self.amount - 1.0).clamp(-1.0, 1.0).acos();
                let angle = d.dot(self.opening).clamp(-1.0, 1.0).acos();
                let ragged = 0.7 * radius * noise::fractal(d * (2.5 / self.scale), 4, self.seed);
                1.0 - smoothstep(radius - 0.012, radius + 0.012, angle + ragged)
            }
            CoverKind::Arcade => {
                let bays = (10.0 / self.scale).round().clamp(3.0, 32.0);
                let x = (turn(d) * bays).fract() - 0.5;
                let (column, blur) = (0.22, SAMPLE * bays / 7.0);
                let half = 0.5 * (1.0 - column);
                let top = ((1.0 - self.amount) / 0.7).clamp(0.05, 0.95);
                let arch = 0.65 * top + 0.35 * top * (1.0 - (x / half).powi(2)).max(0.0).sqrt();
                (1.0 - smoothstep(half - blur, half, x.abs())) * (1.0 - smoothstep(arch - 0.012, arch + 0.004, d.y))
            }
        }
    }

    /// Radiance of the cover itself in direction `d`.
    pub fn radiance(&self, d: DVec3) -> DVec3 {
        let grain = |scale: f64| noise::fractal(d * (scale / self.scale), 3, self.seed ^ 29);
        let form = match self.kind {
            // Leaves before the sun glow through.
            CoverKind::Leaves => (0.7 + 1.3 * grain(14.0)).max(0.1) * (1.0 + 3.0 * d.dot(self.sun).max(0.0).powi(6)),
            // Walls that face the opening see more of it.
            CoverKind::Cave => (0.35 + 0.65 * (0.5 - 0.5 * d.dot(self.opening))) * (1.0 + 1.4 * grain(7.0)).max(0.1),
            CoverKind::Arcade => 1.0 - 0.45 * d.y + 0.2 * grain(9.0),
            CoverKind::Ribs | CoverKind::Lattice => 1.0 + 0.2 * grain(12.0),
        };
        self.color * self.inside * (form / PI)
    }
}
