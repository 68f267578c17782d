//! Architecture: towers, houses and columns. Storeys, roofs and ornaments are closed and run into one another.

use crate::draw::Draw;
use crate::family::{choice, family};
use crate::shapes::builder::Builder;
use crate::shapes::parts::{Dice, profile, shift};
use glam::{DAffine3, DVec2, DVec3};
use std::f64::consts::TAU;

/// Openings of a wall: how many across and up, their share of a bay, and how deep they go in.
#[derive(Clone, Copy)]
struct Openings {
    across: usize,
    up: usize,
    share: DVec2,
    depth: f64,
}

/// A prism over the plan `corners` (counter-clockwise from above: x, z with z down the page), from 0 to `height`, each side a
/// wall with recessed openings.
fn storey(b: &mut Builder, corners: &[DVec2], height: f64, openings: Openings) {
    let n = corners.len();
    // Marks between 0 and 1: wall, opening, wall, opening, ..., wall.
    let marks = |count: usize, share: f64| {
        let mut marks = vec![0.0];
        for i in 0..count {
            let middle = (i as f64 + 0.5) / count as f64;
            marks.extend([middle - 0.5 * share / count as f64, middle + 0.5 * share / count as f64]);
        }
        marks.push(1.0);
        marks
    };
    let (us, vs) = (marks(openings.across, openings.share.x), marks(openings.up, openings.share.y));
    let (mut bottom, mut top) = (Vec::new(), Vec::new());
    for side in 0..n {
        let (from, to) = (corners[side], corners[(side + 1) % n]);
        let along = (to - from).normalize_or(DVec2::X);
        let inwards = DVec3::new(along.y, 0.0, -along.x) * openings.depth;
        let point = |u: f64, v: f64| {
            let p = from.lerp(to, u);
            DVec3::new(p.x, v * height, p.y)
        };
        for u in &us[..us.len() - 1] {
            bottom.push(point(*u, 0.0));
            top.push(point(*u, 1.0));
        }
        for j in 0..vs.len() - 1 {
            for i in 0..us.len() - 1 {
                let quad =
                    [(us[i], vs[j]), (us[i + 1], vs[j]), (us[i + 1], vs[j + 1]), (us[i], vs[j + 1])].map(|(u, v)| point(u, v));
                if i % 2 == 1 && j % 2 == 1 {
                    let back = quad.map(|p| p + inwards);
                    b.facet(&back);
                    for k in 0..4 {
                        b.facet(&[quad[k], quad[(k + 1) % 4], back[(k + 1) % 4], back[k]]);
                    }
                } else {
                    b.facet(&quad);
                }
            }
        }
    }
    bottom.reverse();
    b.fan(&top);
    b.fan(&bottom);
}

/// A regular plan of `n` corners, or a rectangle for 4, counter-clockwise from above.
fn plan(n: usize, half: DVec2) -> Vec<DVec2> {
    if n == 4 {
        return [(-1.0, 1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)].map(|(x, z)| half * DVec2::new(x, z)).to_vec();
    }
    (0..n).map(|i| half * DVec2::from_angle(-TAU * (i as f64 + 0.5) / n as f64)).collect()
}

choice! {
    /// What stands on a tower.
    Crown {
        /// A flat roof with machinery.
        Flat,
        /// A pyramid.
        Pyramid,
        /// A needle.
        Spire,
        /// A dome.
        Dome,
        /// Battlements.
        Battlements,
    }
}

family! {
    /// A tower with setbacks and recessed windows.
    shape Tower("architecture", Upright) |rng| {
        /// What stands on it.
        crown: Crown = Crown::draw(rng);
        /// Corners of the plan.
        corners: u32 [3, 12] = [4, 4, 4, 6, 8, 5, 12][rng.below(7) as usize];
        /// Stages, each narrower than the one below.
        stages: u32 [1, 5] = 1 + rng.below(4);
        /// Width of a stage over the one below.
        setback: f32 [0.4, 0.95] = rng.between(0.6, 0.9);
        /// Height over width.
        tall: f32 [0.8, 6] = rng.log(1.4, 4.0);
        /// Depth over width of the plan.
        deep: f32 [0.4, 1] = if rng.chance(0.5) { 1.0 } else { rng.between(0.5, 1.0) };
        /// Windows across a side of the lowest stage.
        windows: u32 [1, 10] = 2 + rng.below(6);
        /// Share of the wall that windows take, in each direction.
        glazing: f32 [0.2, 0.9] = rng.between(0.4, 0.8);
        /// Which details.
        seed: u32 = rng.below(1 << 30);
    }
}

impl Tower {
    fn build(&self) -> (Builder, f64) {
        let mut b = Builder::default();
        let mut dice = Dice::new(self.seed);
        let n = self.corners.max(3) as usize;
        let mut half = DVec2::new(0.5, 0.5 * f64::from(self.deep));
        let mut y = 0.0;
        let shares: Vec<f64> = (0..self.stages).map(|i| dice.between(0.6, 1.2) / (1.0 + 0.2 * f64::from(i))).collect();
        let total: f64 = shares.iter().sum();
        // A plinth.
        b.part(DAffine3::IDENTITY, |p| {
            storey(p, &plan(n, half * 1.12), 0.05, Openings { across: 0, up: 0, share: DVec2::ONE, depth: 0.0 })
        });
        let bay = 1.0 / f64::from(self.windows);
        let mut budget = 18_000;
        for share in shares {
            let height = f64::from(self.tall) * share / total;
            let side = if n == 4 { 2.0 * half.x } else { 2.0 * half.x * (TAU / 2.0 / n as f64).sin() };
            let across = ((side / bay * if n == 4 { 1.0 } else { 1.6 }).round() as usize).clamp(1, 10);
            let up = ((height / (1.4 * side / across as f64)).round() as usize).clamp(1, 14);
            let cost = n * (2 * across + 1) * (2 * up + 1) * 2 + n * across * up * 8;
            let (across, up) = if cost > budget { (1, 1) } else { (across, up) };
            budget -= cost.min(budget);
            let glazing = f64::from(self.glazing);
            let openings = Openings {
                across,
                up,
                share: DVec2::new(glazing, (glazing * 1.1).min(0.85)),
                depth: 0.12 * side / across as f64,
            };
            b.part(shift(0.0, y + 0.011, 0.0), |p| storey(p, &plan(n, half), height, openings));
            y += height;
            // A cornice hides the joint.
            let cornice = plan(n, half * 1.05);
            b.part(shift(0.0, y - 0.01, 0.0), |p| {
                storey(p, &cornice, 0.035, Openings { across: 0, up: 0, share: DVec2::ONE, depth: 0.0 })
            });
            half *= f64::from(self.setback);
        }
        half /= f64::from(self.setback);
        let top = y + 0.024;
        let r = half.min_element();
        let roof = |height: f64, wide: f64| {
            move |p: &mut Builder| {
                let ring: Vec<DVec3> = plan(n, half * wide).iter().map(|q| DVec3::new(q.x, 0.0, q.y)).collect();
                for i in 0..n {
                    p.facet(&[ring[i], ring[(i + 1) % n], DVec3::Y * height]);
                }
                let bottom: Vec<DVec3> = ring.iter().rev().copied().collect();
                p.fan(&bottom);
            }
        };
        match self.crown {
            Crown::Flat => {
                for _ in 0..2 + dice.below(4) {
                    let (x, z) = (dice.between(-0.5, 0.5) * half.x, dice.between(-0.5, 0.5) * half.y);
                    let (w, h, d) = (r * dice.between(0.1, 0.35), r * dice.between(0.15, 0.5), r * dice.between(0.1, 0.35));
                    b.cuboid(DVec3::new(x - w, top - 0.02, z - d), DVec3::new(x + w, top + h, z + d), 0.02 * r);
                }
                let x = dice.between(-0.4, 0.4) * half.x;
                b.bar(DVec3::new(x, top - 0.02, 0.0), DVec3::new(x, top + r * 1.2, 0.0), [0.03 * r, 0.015 * r], 8);
            }
            Crown::Pyramid => b.part(shift(0.0, top - 0.012, 0.0), roof(dice.between(0.6, 2.0) * r, 1.02)),
            Crown::Spire => {
                b.part(shift(0.0, top - 0.012, 0.0), roof(dice.between(2.5, 5.0) * r, 0.8));
                for _ in 0..1 {
                    b.bar(DVec3::Y * (top + r), DVec3::Y * (top + 6.0 * r), [0.04 * r, 0.01 * r], 8);
                }
            }
            Crown::Dome => {
                let points: Vec<(f64, f64)> = (0..=8)
                    .map(|i| TAU / 4.0 * f64::from(i) / 8.0)
                    .map(|a| (0.9 * r * a.cos(), 0.15 * r + 1.05 * r * a.sin()))
                    .map(|(x, y)| (x.max(0.06 * r), y))
                    .collect();
                let mut outline = vec![DVec2::ZERO, DVec2::new(0.9 * r, 0.0)];
                outline.extend(profile(&points, 2));
                outline.extend([DVec2::new(0.06 * r, 1.5 * r), DVec2::new(0.0, 1.6 * r)]);
                b.turned(shift(0.0, top - 0.012, 0.0), &outline, 40);
            }
            Crown::Battlements => {
                let ring = plan(n, half * 0.98);
                for side in 0..n {
                    let (from, to) = (ring[side], ring[(side + 1) % n]);
                    let count = ((from.distance(to) / (0.35 * r)).round() as usize).clamp(2, 7);
                    for i in 0..count {
                        let p = from.lerp(to, (i as f64 + 0.5) / count as f64);
                        let along = (to - from).normalize_or(DVec2::X);
                        let turn = DAffine3::from_rotation_y(-along.y.atan2(along.x));
                        let size = DVec3::new(0.5 * from.distance(to) / count as f64, 0.36 * r, 0.16 * r);
                        b.part(shift(p.x, top + 0.1 * r, p.y) * turn, |q| q.slab(size, 0.01 * r));
                    }
                }
            }
        }
        (b, 30.0)
    }
}

choice! {
    /// The roof of a house.
    Roof {
        /// Two slopes.
        Gable,
        /// Four slopes.
        Hip,
        /// One slope.
        Shed,
        /// A flat one with a rim.
        Flat,
    }
}

family! {
    /// A house with windows, a door, a roof, a chimney and perhaps a wing.
    shape House("architecture", Upright) |rng| {
        /// The roof.
        roof: Roof = Roof::draw(rng);
        /// Depth over width.
        deep: f32 [0.3, 1] = rng.between(0.5, 1.0);
        /// Height of the walls over the width.
        walls: f32 [0.2, 1.2] = rng.between(0.3, 0.8);
        /// Height of the roof over the depth.
        pitch: f32 [0.1, 1.2] = rng.between(0.25, 0.8);
        /// Overhang of the roof as a share of the width.
        eaves: f32 [0.01, 0.15] = rng.between(0.03, 0.1);
        /// Windows across the front.
        windows: u32 [1, 6] = 2 + rng.below(3);
        /// Storeys.
        storeys: u32 [1, 4] = 1 + rng.below(3);
        /// A wing to one side.
        wing: bool = rng.chance(0.45);
        /// Which details.
        seed: u32 = rng.below(1 << 30);
    }
}

impl House {
    fn body(&self, b: &mut Builder, half: DVec2, walls: f64, windows: usize, dice: &mut Dice) {
        let share = DVec2::new(dice.between(0.35, 0.55), dice.between(0.4, 0.55));
        let openings = Openings { across: windows, up: self.storeys as usize, share, depth: 0.03 };
        b.part(DAffine3::IDENTITY, |p| storey(p, &plan(4, half), walls, openings));
        let eaves = f64::from(self.eaves);
        let (x, z) = (half.x + eaves, half.y + eaves);
        let rise = f64::from(self.pitch) * 2.0 * half.y;
        let y = walls - 0.015;
        // A board of even thickness under a ridge: the hull of its corners, faces given from outside.
        let thick = 0.03;
        let ridge = match self.roof {
            Roof::Hip => (x - z).max(0.02),
            _ => x,
        };
        if self.roof == Roof::Flat {
            b.cuboid(DVec3::new(-x, y, -z), DVec3::new(x, y + 2.0 * thick, z), 0.006);
            return;
        }
        let top = if self.roof == Roof::Shed { -z } else { 0.0 };
        b.part(shift(0.0, y, 0.0), |p| {
            let low = |sx: f64, sz: f64, dy: f64| DVec3::new(sx * x, dy, sz * z);
            let (left, right) = (DVec3::new(-ridge, rise + thick, top), DVec3::new(ridge, rise + thick, top));
            let [a, c, d, e] = [low(-1.0, 1.0, 0.0), low(1.0, 1.0, 0.0), low(1.0, -1.0, 0.0), low(-1.0, -1.0, 0.0)];
            let [a1, c1, d1, e1] = [a, c, d, e].map(|q| q + DVec3::Y * thick);
            p.facet(&[a, e, d, c]);
            p.facet(&[a, c, c1, a1]);
            p.facet(&[c, d, d1, c1]);
            p.facet(&[d, e, e1, d1]);
            p.facet(&[e, a, a1, e1]);
            p.facet(&[a1, c1, right, left]);
            p.facet(&[d1, e1, left, right]);
            p.facet(&[c1, d1, right]);
            p.facet(&[e1, a1, left]);
        });
    }

    fn build(&self) -> (Builder, f64) {
        let mut b = Builder::default();
        let mut dice = Dice::new(self.seed);
        let half = DVec2::new(0.5, 0.5 * f64::from(self.deep));
        let walls = f64::from(self.walls);
        self.body(&mut b, half, walls, self.windows as usize, &mut dice);
        let rise = f64::from(self.pitch) * 2.0 * half.y;
        // The door stands a little proud of the wall, in a frame, on a step.
        let tall = 0.7 * walls / f64::from(self.storeys);
        let x = dice.between(-0.15, 0.15);
        b.cuboid(DVec3::new(x - 0.07, 0.004, half.y - 0.05), DVec3::new(x + 0.07, tall, half.y + 0.03), 0.006);
        b.cuboid(DVec3::new(x - 0.055, 0.01, half.y), DVec3::new(x + 0.055, tall - 0.02, half.y + 0.036), 0.004);
        b.ellipsoid(DVec3::new(x + 0.035, 0.5 * tall, half.y + 0.04), DVec3::splat(0.01), 4);
        b.cuboid(DVec3::new(x - 0.12, 0.0, half.y - 0.02), DVec3::new(x + 0.12, 0.02, half.y + 0.12), 0.003);
        if self.roof != Roof::Flat {
            let (cx, cz) = (dice.between(-0.3, 0.3), -0.3 * half.y);
            let top = walls + rise * if self.roof == Roof::Shed { 1.0 } else { 0.9 } + 0.12;
            b.cuboid(DVec3::new(cx - 0.045, 0.6 * walls, cz - 0.045), DVec3::new(cx + 0.045, top, cz + 0.045), 0.004);
            b.cuboid(DVec3::new(cx - 0.06, top - 0.03, cz - 0.06), DVec3::new(cx + 0.06, top - 0.005, cz + 0.06), 0.004);
        }
        if self.wing {
            let size = dice.between(0.45, 0.7);
            let place = shift(0.5 + 0.5 * size * 0.8 - 0.06, 0.0, dice.between(-0.1, 0.3) * half.y);
            let mut wing = Builder::default();
            self.body(&mut wing, half * size * 0.95, walls * dice.between(0.55, 0.8), 1 + self.windows as usize / 2, &mut dice);
            b.part(place, |p| p.absorb(wing));
        }
        (b, 25.0)
    }
}

choice! {
    /// The order of a column.
    Order {
        /// Plain cushions.
        Doric,
        /// Rings at the foot.
        Tuscan,
        /// A bell with leaves' volume.
        Bell,
        /// Twisted.
        Twisted,
    }
}

family! {
    /// A column with base, shaft and capital, whole or broken off.
    shape Column("architecture", Upright) |rng| {
        /// The order.
        order: Order = Order::draw(rng);
        /// Radius over height.
        slim: f32 [0.04, 0.3] = rng.between(0.07, 0.16);
        /// Flutes; below 3 none.
        flutes: u32 [0, 32] = if rng.chance(0.3) { 0 } else { 8 + rng.below(17) };
        /// Radius at the top over that at the foot.
        taper: f32 [0.5, 1] = rng.between(0.72, 0.95);
        /// Swelling in the middle as a share of the radius.
        swell: f32 [0, 0.3] = rng.between(0.0, 0.12);
        /// Share of the height that is left; 1 = whole.
        whole: f32 [0.2, 1] = if rng.chance(0.65) { 1.0 } else { rng.between(0.3, 0.85) };
        /// Which break.
        seed: u32 = rng.below(1 << 30);
    }
}

impl Column {
    fn build(&self) -> (Builder, f64) {
        let mut b = Builder::default();
        let r = f64::from(self.slim);
        let (base, capital) = (1.2 * r, 1.1 * r);
        let shaft = 1.0 - base - capital;
        let flutes = if self.flutes >= 3 { f64::from(self.flutes) } else { 0.0 };
        let sides = if self.flutes >= 3 { 6 * self.flutes as usize } else { 64 };
        let whole = self.whole > 0.97;
        let rows = if self.order == Order::Twisted { 60 } else { (18_000 / (2 * sides)).clamp(12, 40) };
        let turns = if self.order == Order::Twisted { 2.5 } else { 0.0 };
        let surface = |i: usize, j: usize| {
            let (u, v) = (TAU * (i % sides) as f64 / sides as f64, j as f64 / rows as f64);
            let width = r * (1.0 + (f64::from(self.taper) - 1.0) * v + f64::from(self.swell) * (TAU / 2.0 * v).sin());
            let a = u + TAU * turns * v;
            let fade = (12.0 * v.min(1.0 - v)).min(1.0);
            let cut = if flutes > 0.0 { 0.1 * (0.5 - 0.5 * (flutes * a).cos()).sqrt() * fade } else { 0.0 };
            let rope = if self.order == Order::Twisted { 0.16 * (2.0 * a).cos() } else { 0.0 };
            let width = width * (1.0 - cut + rope);
            let (mut y, (sin, cos)) = (base - 0.02 + (shaft + 0.04) * v, u.sin_cos());
            if !whole {
                let rough = crate::noise::fractal(DVec3::new(sin, cos, 0.3) * 1.7, 4, self.seed);
                let edge = base + shaft * (f64::from(self.whole) + 0.06 * rough).clamp(0.08, 0.97);
                y = base - 0.02 + (edge - base) * v;
            }
            DVec3::new(width * sin, y, width * cos)
        };
        b.part(DAffine3::IDENTITY, |p| {
            p.cells(sides, rows, [4.0, 6.0], surface);
            for (j, flip) in [(0, true), (rows, false)] {
                let mut ring: Vec<DVec3> = (0..sides).map(|i| surface(i, j)).collect();
                if flip {
                    ring.reverse();
                }
                p.fan(&ring);
            }
        });
        // A square plinth and cushions.
        b.cuboid(DVec3::new(-1.55 * r, 0.0, -1.55 * r), DVec3::new(1.55 * r, 0.45 * r, 1.55 * r), 0.04 * r);
        let cushions: &[(f64, f64)] = match self.order {
            Order::Doric => &[(1.35, 0.42), (1.35, 0.7), (1.1, 0.95), (1.05, 1.25)],
            Order::Tuscan => {
                &[(1.45, 0.42), (1.5, 0.58), (1.42, 0.72), (1.15, 0.78), (1.2, 0.9), (1.32, 1.0), (1.2, 1.1), (1.02, 1.25)]
            }
            Order::Bell | Order::Twisted => {
                &[(1.5, 0.42), (1.55, 0.55), (1.3, 0.7), (1.15, 0.8), (1.3, 0.95), (1.25, 1.1), (1.03, 1.25)]
            }
        };
        let turned = |points: &[(f64, f64)], lift: f64| {
            let scaled: Vec<(f64, f64)> = points.iter().map(|&(x, y)| (x * r, y * r + lift)).collect();
            let mut outline = vec![DVec2::new(0.0, scaled[0].1)];
            outline.extend(profile(&scaled, 5));
            outline.push(DVec2::new(0.0, scaled[scaled.len() - 1].1));
            outline
        };
        b.turned(DAffine3::IDENTITY, &turned(cushions, 0.0), 56);
        if whole {
            let t = f64::from(self.taper);
            let head: Vec<(f64, f64)> = match self.order {
                Order::Doric => vec![(1.02 * t, -0.15), (1.04 * t, 0.1), (1.3 * t, 0.4), (1.42, 0.62), (1.4, 0.72)],
                Order::Tuscan => {
                    vec![(1.05 * t, -0.15), (1.2 * t, 0.0), (1.05 * t, 0.12), (1.05 * t, 0.3), (1.4, 0.6), (1.4, 0.72)]
                }
                Order::Bell | Order::Twisted => {
                    vec![(1.1 * t, -0.15), (1.16 * t, 0.0), (1.0 * t, 0.1), (1.15 * t, 0.4), (1.6, 0.68), (1.55, 0.73)]
                }
            };
            let lift = 1.0 - capital;
            b.turned(DAffine3::IDENTITY, &turned(&head, lift), 56);
            b.cuboid(DVec3::new(-1.6 * r, lift + 0.68 * r, -1.6 * r), DVec3::new(1.6 * r, 1.0, 1.6 * r), 0.05 * r);
        }
        (b, 35.0)
    }
}
