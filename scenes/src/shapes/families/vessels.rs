//! Vessels: turned walls with handles, spouts and lids. Parts run into one another.

use crate::draw::Draw;
use crate::family::{choice, family};
use crate::shapes::builder::Builder;
use crate::shapes::parts::{hollow, profile, spline};
use glam::{DAffine3, DQuat, DVec2, DVec3};
use std::f64::consts::TAU;

choice! {
    /// The kind of a vessel.
    VesselKind {
        /// A mug with one handle.
        Cup,
        /// A wide bowl on a foot.
        Bowl,
        /// A vase.
        Vase,
        /// A bottle with a long neck.
        Bottle,
        /// A teapot with spout, handle and lid.
        Teapot,
        /// A jar with two handles.
        Amphora,
        /// A jug with a handle.
        Jug,
        /// A glass on a stem.
        Goblet,
        /// A jar with a lid and a knob.
        Jar,
    }
}

family! {
    /// A hollow vessel.
    shape Vessel("vessel", Upright) |rng| {
        /// The kind.
        kind: VesselKind = VesselKind::draw(rng);
        /// Height over width, against the kind's usual one.
        tall: f32 [0.5, 2] = rng.log(0.75, 1.4);
        /// How much the belly bulges, against the usual.
        belly: f32 [0.5, 1.5] = rng.between(0.75, 1.25);
        /// Width of the mouth or neck, against the usual.
        mouth: f32 [0.6, 1.5] = rng.between(0.75, 1.3);
        /// Thickness of the wall as a share of the width.
        wall: f32 [0.01, 0.06] = rng.between(0.015, 0.045);
        /// Vertical flutes on the outside; below 3 none.
        flutes: u32 [0, 40] = if rng.chance(0.7) { 0 } else { 6 + rng.below(20) };
        /// Size of handles, against the usual.
        handle: f32 [0.6, 1.4] = rng.between(0.8, 1.2);
    }
}

impl Vessel {
    /// Half outline from the foot's rim to the lip, width about 1.
    fn outline(&self) -> Vec<(f64, f64)> {
        let (belly, mouth) = (f64::from(self.belly), f64::from(self.mouth));
        let b = |r: f64| (r * belly).min(0.62);
        let m = |r: f64| (r * mouth).min(0.6);
        match self.kind {
            VesselKind::Cup => {
                vec![(0.3, 0.0), (0.33, 0.02), (b(0.36), 0.25), (b(0.38), 0.6), (0.7 * b(0.4) + 0.3 * m(0.42), 0.95)]
            }
            VesselKind::Bowl => {
                vec![(0.22, 0.0), (0.2, 0.06), (b(0.34), 0.14), (b(0.46), 0.28), (0.5 * b(0.5) + 0.5 * m(0.55), 0.48)]
            }
            VesselKind::Vase => {
                vec![(0.2, 0.0), (0.24, 0.05), (b(0.4), 0.45), (b(0.38), 0.75), (m(0.16), 1.1), (m(0.15), 1.25), (m(0.24), 1.4)]
            }
            VesselKind::Bottle => {
                vec![(0.28, 0.0), (b(0.3), 0.04), (b(0.31), 0.6), (b(0.28), 0.8), (m(0.11), 1.05), (m(0.1), 1.35), (m(0.12), 1.4)]
            }
            VesselKind::Teapot => vec![(0.26, 0.0), (0.3, 0.03), (b(0.5), 0.3), (b(0.46), 0.52), (m(0.22), 0.68)],
            VesselKind::Amphora => {
                vec![
                    (0.16, 0.0),
                    (0.12, 0.08),
                    (b(0.3), 0.45),
                    (b(0.42), 0.85),
                    (b(0.36), 1.08),
                    (m(0.14), 1.25),
                    (m(0.14), 1.42),
                    (m(0.2), 1.5),
                ]
            }
            VesselKind::Jug => vec![(0.26, 0.0), (0.3, 0.04), (b(0.42), 0.35), (b(0.36), 0.65), (m(0.22), 0.88), (m(0.29), 1.05)],
            VesselKind::Goblet => vec![(0.07, 0.52), (b(0.2), 0.58), (b(0.31), 0.75), (b(0.31), 0.95), (m(0.27), 1.2)],
            VesselKind::Jar => {
                vec![(0.3, 0.0), (b(0.34), 0.04), (b(0.42), 0.35), (b(0.4), 0.6), (m(0.28), 0.76), (m(0.29), 0.82)]
            }
        }
    }

    fn build(&self) -> (Builder, f64) {
        let mut b = Builder::default();
        let tall = f64::from(self.tall);
        let points: Vec<(f64, f64)> = self.outline().iter().map(|&(r, y)| (r, y * tall)).collect();
        let outer = profile(&points, if points.len() > 6 { 7 } else { 9 });
        let wall = f64::from(self.wall);
        let closed = hollow(&outer, wall, 1.3 * wall);
        let flutes = if self.flutes >= 3 { f64::from(self.flutes) } else { 0.0 };
        let (foot, lip) = (outer[0].y, outer[outer.len() - 1].y);
        // Flutes fade out towards foot and lip, and the inside follows the outside.
        let flute = |p: DVec3| {
            let share = ((p.y - foot) / (lip - foot)).clamp(0.0, 1.0);
            let depth = 0.05 * (share * (1.0 - share) * 4.0).sqrt();
            let scale = 1.0 - depth * (0.5 + 0.5 * (flutes * p.x.atan2(p.z)).cos());
            if flutes > 0.0 { DVec3::new(p.x * scale, p.y, p.z * scale) } else { p }
        };
        let segments = if flutes > 0.0 { 120 } else { 72 };
        b.bent(flute, |p| p.lathe(&closed, segments));
        let radius = |y: f64| {
            let next = outer.iter().position(|p| p.y >= y).unwrap_or(outer.len() - 1).max(1);
            let (p, q) = (outer[next - 1], outer[next]);
            p.x + (q.x - p.x) * ((y - p.y) / (q.y - p.y).max(1e-9)).clamp(0.0, 1.0)
        };
        let wall_at = |y: f64| radius(y) - 0.4 * wall;
        match self.kind {
            VesselKind::Cup => self.handle(&mut b, &wall_at, [0.18 * tall, 0.75 * tall], 0.3, 0.0),
            VesselKind::Jug => self.handle(&mut b, &wall_at, [0.28 * tall, 0.9 * tall], 0.3, 0.0),
            VesselKind::Amphora => {
                for turn in [0.0, TAU / 2.0] {
                    self.handle(&mut b, &wall_at, [0.98 * tall, 1.38 * tall], 0.24, turn);
                }
            }
            VesselKind::Teapot => {
                self.handle(&mut b, &wall_at, [0.2 * tall, 0.54 * tall], 0.28, TAU / 2.0);
                let y = 0.22 * tall;
                let from = radius(y) - 0.5 * wall;
                let spout = spline(
                    &[
                        DVec3::new(from, y, 0.0),
                        DVec3::new(from + 0.14, y + 0.06, 0.0),
                        DVec3::new(from + 0.22, y + 0.24 * tall, 0.0),
                        DVec3::new(from + 0.36, y + 0.44 * tall, 0.0),
                    ],
                    false,
                    7,
                );
                let radii: Vec<f64> = (0..spout.len()).map(|i| 0.1 - 0.055 * i as f64 / spout.len() as f64).collect();
                b.rod(&spout, &radii, 16, true);
                self.lid(&mut b, outer[outer.len() - 1], wall);
            }
            VesselKind::Jar => self.lid(&mut b, outer[outer.len() - 1], wall),
            VesselKind::Goblet => {
                let stem = [(0.3, 0.0), (0.29, 0.03), (0.1, 0.07), (0.035, 0.18), (0.03, 0.4), (0.06, 0.52), (0.1, 0.57)];
                let mut turned = vec![DVec2::ZERO];
                turned.extend(profile(&stem.map(|(r, y)| (r, y * tall)), 6));
                // The stem ends within the thick floor of the cup.
                let top = turned[turned.len() - 1].y.min(foot + 1.2 * wall);
                turned.retain(|p| p.y < top);
                turned.push(DVec2::new(0.06, top));
                turned.push(DVec2::new(0.0, top));
                b.turned(DAffine3::IDENTITY, &turned, 48);
            }
            VesselKind::Bowl | VesselKind::Vase | VesselKind::Bottle => (),
        }
        (b, 40.0)
    }

    /// A handle between two heights that stands off by `reach`; its ends lie at the radii `within` the wall.
    fn handle(&self, b: &mut Builder, within: &dyn Fn(f64) -> f64, [low, high]: [f64; 2], reach: f64, turn: f64) {
        let reach = reach * f64::from(self.handle);
        let (r0, r1) = (within(low), within(high));
        let out = r0.max(r1);
        let spin = DQuat::from_rotation_y(turn);
        let points = [
            DVec3::new(r0, low, 0.0),
            DVec3::new(out + 0.65 * reach, low + 0.08 * (high - low), 0.0),
            DVec3::new(out + reach, 0.55 * low + 0.45 * high, 0.0),
            DVec3::new(out + 0.75 * reach, high, 0.0),
            DVec3::new(r1, high - 0.03, 0.0),
        ]
        .map(|p| spin * p);
        let path = spline(&points, false, 8);
        let thick = (0.09 * (high - low)).clamp(0.018, 0.05) * f64::from(self.handle).sqrt();
        // Flat ends within the wall; a flat strap is wider than thick.
        b.part(DAffine3::IDENTITY, |p| {
            p.tube(&path, false, 14, [1.0, 5.0], |_, a| DVec2::new(a.cos(), 0.75 * a.sin()) * thick);
        });
    }

    /// A domed lid with a knob on the lip.
    fn lid(&self, b: &mut Builder, lip: DVec2, wall: f64) {
        let r = lip.x + 0.3 * wall;
        let knob = 0.06 * f64::from(self.handle);
        let points = [
            (r, lip.y - 0.4 * wall),
            (r + 0.01, lip.y + 0.01),
            (0.75 * r, lip.y + 0.22 * r),
            (0.35 * r, lip.y + 0.32 * r),
            (0.4 * knob, lip.y + 0.36 * r),
            (0.5 * knob, lip.y + 0.36 * r + 0.4 * knob),
            (knob, lip.y + 0.36 * r + 1.1 * knob),
            (0.6 * knob, lip.y + 0.36 * r + 1.8 * knob),
        ];
        let mut outline = vec![DVec2::new(0.0, points[0].1)];
        outline.extend(profile(&points, 6));
        outline.push(DVec2::new(0.0, outline[outline.len() - 1].y + 0.1 * knob));
        b.turned(DAffine3::IDENTITY, &outline, 56);
    }
}
