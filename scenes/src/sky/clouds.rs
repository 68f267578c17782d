//! Layers of clouds: where they are, how much light they let through, and how bright they look from below.

use super::canvas::smoothstep;
use super::parts::{CloudKind, CloudLayer};
use crate::noise;
use glam::DVec3;

/// A layer ready to be asked.
pub(super) struct Layer {
    kind: CloudKind,
    coverage: f64,
    /// Inverse size.
    pitch: f64,
    depth: f64,
    /// Horizontal unit vectors along and across the direction.
    along: DVec3,
    across: DVec3,
    seed: u32,
}

/// Light that clouds have to work with.
#[derive(Clone, Copy)]
pub(super) struct CloudLight {
    /// Unit direction of the sun, and the radiance of a white surface it lights.
    pub sun: DVec3,
    pub sunlit: DVec3,
    /// Radiance of a white surface under the clear sky.
    pub shaded: DVec3,
}

impl Layer {
    pub fn new(layer: &CloudLayer) -> Self {
        let (sin, cos) = f64::from(layer.direction).to_radians().sin_cos();
        Self {
            kind: layer.kind,
            coverage: f64::from(layer.coverage),
            pitch: 1.6 / f64::from(layer.scale),
            depth: f64::from(layer.depth),
            along: DVec3::new(sin, 0.0, -cos),
            across: DVec3::new(cos, 0.0, sin),
            seed: layer.seed,
        }
    }

    /// Relative thickness, 0..=1, in a direction above the horizon.
    fn density(&self, d: DVec3) -> f64 {
        // A flat layer that bends down a little, so that it does not shrink to nothing at the horizon.
        let p = d * (self.pitch / (d.y + 0.12));
        let (a, c) = (p.dot(self.along), p.dot(self.across));
        // Noise is about normal with deviation 0.22 about zero; the edges below cover the wanted share.
        let wool = |a: f64, c: f64, octaves: u32, seed: u32| {
            0.5 + 0.5 * noise::fractal(DVec3::new(a, c, 0.5), octaves, self.seed.wrapping_add(seed)) / 0.45
        };
        let edge = 1.15 - 1.3 * self.coverage;
        let horizon = smoothstep(0.0, 0.08, d.y);
        match self.kind {
            CloudKind::Cumulus => smoothstep(edge - 0.1, edge + 0.28, wool(a, c, 5, 0)) * smoothstep(0.0, 0.16, d.y),
            CloudKind::Altocumulus => {
                let bend = noise::gradient(DVec3::new(a, c, 0.2), self.seed.wrapping_add(7));
                let puff = 0.5 + 0.5 * (5.0 * a + 2.6 * bend).sin() * (6.5 * c + 1.9 * bend + 0.8 * (2.3 * a).sin()).cos();
                let field = wool(0.45 * a, 0.45 * c, 3, 3);
                smoothstep(edge - 0.22, edge + 0.3, 0.6 * field + 0.6 * puff - 0.1) * horizon
            }
            CloudKind::Cirrus => {
                let bend = noise::gradient(DVec3::new(0.35 * a, 0.35 * c, 0.7), self.seed.wrapping_add(5));
                // Fibres within fields.
                let streak =
                    0.45 * wool(0.35 * a, 2.6 * c + 0.7 * bend, 4, 0) + 0.55 * wool(0.3 * a + 0.3 * bend, 0.6 * c, 3, 13);
                smoothstep(edge - 0.22, edge + 0.5, streak) * smoothstep(0.0, 0.2, d.y)
            }
            CloudKind::Stratus => {
                let sheet = wool(0.35 * a, 0.8 * c, 3, 0);
                smoothstep(edge - 0.55, edge + 0.55, sheet)
            }
            CloudKind::Storm => {
                let bend = noise::gradient(DVec3::new(0.6 * a, 0.6 * c, 0.9), self.seed.wrapping_add(9));
                smoothstep(edge - 0.15, edge + 0.5, wool(0.7 * a + 0.5 * bend, 0.7 * c - 0.4 * bend, 5, 0))
            }
        }
    }

    /// Share of light from direction `d` (above the horizon) that comes through.
    pub fn passes(&self, d: DVec3) -> f64 {
        let veil = match self.kind {
            CloudKind::Cumulus => 7.0,
            CloudKind::Altocumulus => 3.0,
            CloudKind::Cirrus => 0.8,
            CloudKind::Stratus => 6.0,
            CloudKind::Storm => 12.0,
        };
        (-veil * self.depth * self.density(d.with_y(d.y.max(1e-3)))).exp()
    }

    /// 0..=1: whether this part of a heap is turned to the sun, from how its thickness falls that way.
    fn sunny_side(&self, d: DVec3, sun: DVec3) -> f64 {
        let thickness = |d: DVec3| {
            let p = d * (self.pitch / (d.y.max(0.0) + 0.12));
            noise::fractal(DVec3::new(p.dot(self.along), p.dot(self.across), 0.5), 2, self.seed)
        };
        let aside = sun - d * d.dot(sun);
        let step = aside.normalize_or(DVec3::Y) * 0.06;
        (0.4 + 1.6 * (thickness(d) - thickness((d + step).normalize()))).clamp(0.0, 1.0)
    }

    /// `behind` seen through the layer.
    pub fn before(&self, behind: DVec3, d: DVec3, light: &CloudLight) -> DVec3 {
        let density = self.density(d);
        if density <= 0.0 {
            return behind;
        }
        let toward = d.dot(light.sun);
        let thin = (1.0 - density).powi(2);
        let rim = smoothstep(0.75, 1.0, toward);
        // Thin parts glow towards the sun, thick ones are grey below; the weights are by eye.
        let (opacity, sunlit, shaded) = match self.kind {
            CloudKind::Cumulus => {
                let side = self.sunny_side(d, light.sun);
                (4.0, 0.45 * (0.12 + 0.75 * side + 0.2 * thin + 1.5 * thin * rim), 0.4 + 0.45 * (1.0 - density))
            }
            CloudKind::Altocumulus => (2.2, 0.42 * (0.4 + 0.4 * thin + 1.8 * thin * rim), 0.6 + 0.3 * (1.0 - density)),
            CloudKind::Cirrus => (0.9, 0.4 * (0.5 + 2.0 * rim * rim), 0.9),
            CloudKind::Stratus => (5.0, 0.16 * (0.6 + 0.8 * thin + 0.8 * rim), 0.75),
            CloudKind::Storm => {
                let base = 0.5 + noise::gradient(d * 5.0, self.seed.wrapping_add(31));
                (6.0, 0.2 * (0.08 + 0.9 * thin * thin + 2.2 * thin * rim), 0.14 + 0.16 * base.max(0.0) + 0.8 * thin)
            }
        };
        let cloud = light.sunlit * sunlit + light.shaded * shaded;
        behind.lerp(cloud, 1.0 - (-opacity * self.depth * density).exp())
    }
}
