//! Parts of machines: bolts, flanges and brackets.

use crate::draw::Draw;
use crate::family::{choice, family};
use crate::shapes::builder::Builder;
use crate::shapes::families::outlines::{hole, plate};
use crate::shapes::parts::{profile, shift};
use glam::{DAffine3, DVec2, DVec3};
use std::f64::consts::{FRAC_PI_2, TAU};

choice! {
    /// The head of a bolt.
    Head {
        /// Hexagonal.
        Hex,
        /// Square.
        Square,
        /// A cylinder with a hexagonal socket.
        Socket,
        /// A dome with a slot's collar.
        Dome,
        /// An eye.
        Eye,
        /// Two wings.
        Wing,
    }
}

family! {
    /// A threaded bolt with a head, perhaps with a washer and a nut, standing on its head.
    shape Bolt("mechanical", Any) |rng| {
        /// The head.
        head: Head = Head::draw(rng);
        /// Length of the shank over the diameter.
        length: f32 [1, 10] = rng.log(1.8, 5.5);
        /// Share of the shank with thread.
        thread: f32 [0.1, 1] = rng.between(0.4, 1.0);
        /// Turns of the thread a diameter.
        pitch: f32 [2, 9] = rng.between(3.5, 7.0);
        /// Depth of the thread as a share of the radius.
        depth: f32 [0.05, 0.3] = rng.between(0.1, 0.22);
        /// Width of the head over the diameter.
        width: f32 [1.2, 3] = rng.between(1.5, 2.2);
        /// A nut on the thread, with a washer.
        nut: bool = rng.chance(0.4);
    }
}

/// A polygon as seen from above, corners at radius `r`, `steps` points a side.
fn polygon(sides: usize, r: f64, steps: usize) -> Vec<DVec2> {
    (0..sides * steps)
        .map(|i| {
            let (side, t) = (i / steps, (i % steps) as f64 / steps as f64);
            let corner = |k: usize| r * DVec2::from_angle(TAU * k as f64 / sides as f64);
            corner(side).lerp(corner(side + 1), t)
        })
        .collect()
}

/// A plate lying flat at height `y`.
fn flat_plate(b: &mut Builder, y: f64, outer: &[DVec2], holes: &[Vec<DVec2>], height: f64, bevel: f64) {
    let mut flat = Builder::default();
    plate(&mut flat, outer, holes, height, bevel);
    flat.turn_z_to_y();
    flat.map_points(|p| p + DVec3::Y * y);
    b.absorb(flat);
}

impl Bolt {
    fn build(&self) -> (Builder, f64) {
        let mut b = Builder::default();
        let (r, length) = (0.5, f64::from(self.length));
        let wide = 0.5 * f64::from(self.width);
        let head = match self.head {
            Head::Hex | Head::Square => {
                let sides = if self.head == Head::Hex { 6 } else { 4 };
                flat_plate(&mut b, 0.0, &polygon(sides, wide * 1.12, 1), &[], 0.65, 0.06);
                0.65
            }
            Head::Socket => {
                // Knurled outside; the socket is a hexagonal hole down to a floor that closes it.
                let outer: Vec<DVec2> =
                    (0..96).map(|i| (wide + 0.025 * f64::from(i % 2)) * DVec2::from_angle(TAU * f64::from(i) / 96.0)).collect();
                let socket: Vec<DVec2> = polygon(6, 0.62 * wide, 1).into_iter().rev().collect();
                flat_plate(&mut b, 0.0, &outer, &[socket], 0.6, 0.03);
                b.turned(
                    shift(0.0, 0.5, 0.0),
                    &[DVec2::ZERO, DVec2::new(0.93 * wide, 0.0), DVec2::new(0.93 * wide, 0.43), DVec2::new(0.0, 0.43)],
                    64,
                );
                0.9
            }
            Head::Dome => {
                let points: Vec<(f64, f64)> = (0..=8)
                    .map(|i| f64::from(i) / 8.0 * FRAC_PI_2)
                    .map(|a| (wide * a.sin().max(0.35), 0.6 - 0.6 * a.cos()))
                    .collect();
                let mut outline = vec![DVec2::ZERO];
                outline.extend(profile(&points, 2));
                outline.push(DVec2::new(0.0, 0.6));
                b.turned(DAffine3::IDENTITY, &outline, 56);
                0.6
            }
            Head::Eye => {
                let ring: Vec<DVec3> = (0..56)
                    .map(|i| TAU * f64::from(i) / 56.0)
                    .map(|a| DVec3::new(wide * a.cos(), wide + 0.28 + wide * a.sin(), 0.0))
                    .collect();
                b.part(DAffine3::IDENTITY, |p| p.tube(&ring, true, 20, [1.0, 6.0], |_, a| 0.28 * DVec2::new(a.cos(), a.sin())));
                2.0 * wide + 0.4
            }
            Head::Wing => {
                for side in [-1.0, 1.0] {
                    let path =
                        [DVec3::new(0.0, 0.5, 0.0), DVec3::new(side * wide, 0.6, 0.0), DVec3::new(side * 1.9 * wide, 0.15, 0.0)];
                    let path = crate::shapes::parts::spline(&path, false, 8);
                    b.part(DAffine3::IDENTITY, |p| {
                        p.tube(&path, false, 24, [1.0, 3.0], |i, a| {
                            let s = i as f64 / 16.0;
                            DVec2::new(a.cos(), a.sin())
                                * DVec2::new(0.14 + 0.4 * s * (1.3 - s), 0.14)
                                * if i == 16 { 0.5 } else { 1.0 }
                        });
                    });
                }
                b.turned(
                    DAffine3::IDENTITY,
                    &[
                        DVec2::ZERO,
                        DVec2::new(0.6 * wide, 0.0),
                        DVec2::new(0.75 * wide, 0.3),
                        DVec2::new(0.8 * wide, 0.85),
                        DVec2::new(0.0, 0.85),
                    ],
                    40,
                );
                0.8
            }
        };
        // The shank from within the head up: plain, then threaded, with a chamfered end.
        let turns = f64::from(self.pitch);
        let rows = ((turns * length * 7.0) as usize).clamp(24, 190);
        let sides = 40;
        let plain = 1.0 - f64::from(self.thread);
        let bottom = head - 0.13;
        let radius = |u: f64, v: f64| {
            let depth = f64::from(self.depth) * r;
            let y = v * length;
            let phase = y * turns - u;
            let tooth = 1.0 - (2.0 * (phase - phase.floor()) - 1.0).abs();
            let fade = ((v - plain) * 20.0).clamp(0.0, 1.0);
            let end = ((1.0 - v) * length / 0.16).clamp(0.0, 1.0);
            (r - depth * fade * (1.0 - tooth)) * (0.78 + 0.22 * end)
        };
        b.part(shift(0.0, bottom, 0.0), |p| {
            let point = |i: usize, j: usize| {
                let (u, v) = ((i % sides) as f64 / sides as f64, j as f64 / rows as f64);
                let (sin, cos) = (TAU * u).sin_cos();
                let q = radius(u, v);
                DVec3::new(q * sin, v * length, q * cos)
            };
            p.cells(sides, rows, [2.0, 2.0 * length], point);
            for (j, flip) in [(0, true), (rows, false)] {
                let mut ring: Vec<DVec3> = (0..sides).map(|i| point(i, j)).collect();
                if flip {
                    ring.reverse();
                }
                p.fan(&ring);
            }
        });
        if self.nut {
            let y = bottom + length * (1.0 - 0.45 * f64::from(self.thread)) - 0.4;
            flat_plate(&mut b, y, &polygon(6, wide * 1.1, 1), &[hole(DVec2::ZERO, 0.93 * r, 40)], 0.55, 0.05);
            flat_plate(&mut b, y - 0.1, &polygon(48, wide * 1.2, 1), &[hole(DVec2::ZERO, 0.94 * r, 40)], 0.09, 0.01);
        }
        (b, 32.0)
    }
}

family! {
    /// A round or polygonal flange: a plate with a ring of holes and a hub with a bore, lying flat.
    shape Flange("mechanical", Any) |rng| {
        /// Corners of the plate; above 24 round.
        corners: u32 [3, 48] = if rng.chance(0.6) { 48 } else { 3 + rng.below(6) };
        /// Holes in the ring.
        holes: u32 [2, 16] = 3 + rng.below(8);
        /// Radius of a hole as a share of the room it has.
        hole: f32 [0.2, 0.9] = rng.between(0.4, 0.8);
        /// Radius of the bore as a share of the plate's.
        bore: f32 [0.1, 0.5] = rng.between(0.15, 0.4);
        /// Thickness of the plate over its radius.
        thick: f32 [0.05, 0.5] = rng.between(0.1, 0.25);
        /// Height of the hub over the plate's radius.
        hub: f32 [0, 1.5] = rng.between(0.1, 0.9);
        /// Ribs between plate and hub.
        ribs: bool = rng.chance(0.4);
    }
}

impl Flange {
    fn build(&self) -> (Builder, f64) {
        let mut b = Builder::default();
        let (bore, thick, hub) = (f64::from(self.bore), f64::from(self.thick), f64::from(self.hub));
        let outer = if self.corners > 24 {
            polygon(72, 1.0, 1)
        } else {
            // Corners cut off and rounded by a step.
            let p = polygon(self.corners.max(3) as usize, 1.15, 6);
            p.iter().map(|&q| if q.length() > 1.0 { q / q.length() } else { q }).collect()
        };
        let inner = outer.iter().map(|p| p.length()).fold(f64::INFINITY, f64::min);
        let wall = bore + 0.1;
        let (low, high) = (wall + 0.04, (inner - 0.06).max(wall + 0.1));
        let ring = 0.5 * (low + high);
        let n = self.holes.max(2);
        let room = (0.5 * (high - low)).min(ring * (TAU / 2.0 / f64::from(n)).sin() - 0.02).max(0.015);
        let mut holes = vec![hole(DVec2::ZERO, bore, 56)];
        // Turned by half a hole so that ribs stand between.
        holes.extend((0..n).map(|i| {
            let at = DVec2::from_angle(TAU * (f64::from(i) + 0.5) / f64::from(n)) * ring;
            hole(at, room * f64::from(self.hole), 24)
        }));
        flat_plate(&mut b, 0.0, &outer, &holes, thick, 0.012);
        let top = thick + hub;
        let turned = [
            (bore + 0.003, 0.3 * thick),
            (wall + 0.03, 0.3 * thick),
            (wall + 0.03, thick + 0.2 * hub),
            (wall - 0.02, top - 0.02),
            (wall - 0.04, top),
            (bore + 0.003, top),
            (bore + 0.003, 0.3 * thick),
        ];
        b.turned(DAffine3::IDENTITY, &turned.map(|(x, y)| DVec2::new(x, y)), 64);
        if self.ribs && hub > 0.05 {
            for i in 0..n {
                let turn = DAffine3::from_rotation_y(-TAU * f64::from(i) / f64::from(n));
                let (x0, x1) = (wall - 0.01, (inner - 0.05).max(wall + 0.05));
                let rib = [
                    DVec2::new(x0, 0.6 * thick),
                    DVec2::new(x1, 0.6 * thick),
                    DVec2::new(x1, thick + 0.02),
                    DVec2::new(x0, thick + 0.75 * hub),
                ];
                b.part(turn, |p| plate(p, &rib, &[], 0.07, 0.01));
            }
        }
        (b, 30.0)
    }
}

family! {
    /// An angle bracket: two plates with holes and a gusset.
    shape Bracket("mechanical", Any) |rng| {
        /// Length of the upright plate over the lying one.
        ratio: f32 [0.3, 2] = rng.between(0.5, 1.4);
        /// Width over the lying plate's length.
        width: f32 [0.2, 2] = rng.between(0.35, 1.2);
        /// Thickness over the lying plate's length.
        thick: f32 [0.03, 0.2] = rng.between(0.05, 0.12);
        /// Holes in each plate.
        holes: u32 [0, 4] = 1 + rng.below(3);
        /// Size of holes as a share of the room they have.
        hole: f32 [0.2, 0.8] = rng.between(0.35, 0.7);
        /// Corner radius as a share of the width.
        round: f32 [0.02, 0.5] = rng.between(0.04, 0.5);
        /// Gussets.
        gussets: u32 [0, 3] = rng.below(4);
    }
}

impl Bracket {
    /// A tongue of this length and width from x = 0, its far corners round, with holes along it.
    fn tongue(&self, length: f64, width: f64, thick: f64) -> (Vec<DVec2>, Vec<Vec<DVec2>>) {
        let r = (f64::from(self.round) * width).min(0.49 * width).min(0.6 * length);
        let mut outer = vec![DVec2::new(0.0, -0.5 * width)];
        for (k, (cx, cy)) in [(length - r, -0.5 * width + r), (length - r, 0.5 * width - r)].into_iter().enumerate() {
            let start = FRAC_PI_2 * (k as f64 - 1.0);
            outer.extend((0..=8).map(|i| DVec2::new(cx, cy) + r * DVec2::from_angle(start + FRAC_PI_2 * f64::from(i) / 8.0)));
        }
        outer.push(DVec2::new(0.0, 0.5 * width));
        let n = self.holes;
        let clear = length - 2.0 * thick;
        let room = (0.5 * clear / f64::from(n.max(1))).min(0.5 * width) - 0.02;
        let radius = room * f64::from(self.hole);
        let holes = (0..n)
            .filter(|_| radius > 0.012)
            .map(|i| hole(DVec2::new(1.6 * thick + clear * (f64::from(i) + 0.5) / f64::from(n), 0.0), radius, 32))
            .collect();
        (outer, holes)
    }

    fn build(&self) -> (Builder, f64) {
        let mut b = Builder::default();
        let (ratio, width, thick) = (f64::from(self.ratio), f64::from(self.width), f64::from(self.thick));
        let bevel = 0.08 * thick;
        let (outer, holes) = self.tongue(1.0, width, thick);
        flat_plate(&mut b, 0.0, &outer, &holes, thick, bevel);
        let (outer, holes) = self.tongue(ratio, width - 0.004, thick);
        let upright = DAffine3::from_rotation_z(FRAC_PI_2);
        b.part(shift(thick + 0.001, 0.002, 0.0) * upright, |p| flat_plate(p, 0.0, &outer, &holes, thick, bevel));
        for i in 0..self.gussets {
            let z =
                if self.gussets == 1 { 0.0 } else { (f64::from(i) / f64::from(self.gussets - 1) - 0.5) * 0.86 * (width - thick) };
            let (x, y) = (0.6 - 0.1 * f64::from(self.gussets), 0.6 * ratio);
            let rib = [
                DVec2::new(0.5 * thick, 0.5 * thick),
                DVec2::new(thick + x, 0.6 * thick),
                DVec2::new(thick + x, thick + 0.03),
                DVec2::new(thick + 0.03, thick + y),
                DVec2::new(0.5 * thick, thick + y),
            ];
            b.part(shift(0.0, 0.0, z - 0.25 * thick), |p| plate(p, &rib, &[], 0.5 * thick, 0.1 * bevel));
        }
        (b, 30.0)
    }
}
