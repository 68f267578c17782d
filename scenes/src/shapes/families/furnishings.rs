//! Furnishings: shelves with things on them, and lamps, from closed parts that run into one another.

use super::furniture::NUDGE;
use crate::draw::Draw;
use crate::family::{choice, family};
use crate::shapes::builder::Builder;
use crate::shapes::parts::{Dice, at, hollow, profile, shift, spline};
use glam::{DAffine3, DQuat, DVec2, DVec3};
use std::f64::consts::TAU;

family! {
    /// Shelves with things on them, or a cabinet with doors.
    shape Shelf("furniture", Upright) |rng| {
        /// Columns.
        columns: u32 [1, 5] = 1 + rng.below(4);
        /// Rows.
        rows: u32 [1, 7] = 2 + rng.below(4);
        /// Height over width.
        tall: f32 [0.3, 3] = rng.log(0.6, 2.2);
        /// Depth over the larger of width and height.
        depth: f32 [0.15, 0.6] = rng.between(0.2, 0.4);
        /// Thickness of boards as a share of a column.
        thick: f32 [0.01, 0.1] = rng.between(0.03, 0.07);
        /// Share of compartments with books or boxes.
        filled: f32 [0, 1] = rng.between(0.2, 0.9);
        /// Share of compartments with doors.
        doors: f32 [0, 1] = if rng.chance(0.5) { 0.0 } else { rng.between(0.1, 0.6) };
        /// A back panel.
        back: bool = rng.chance(0.7);
        /// What stands where.
        seed: u32 = rng.below(1 << 30);
    }
}

impl Shelf {
    fn build(&self) -> (Builder, f64) {
        let mut b = Builder::default();
        let mut dice = Dice::new(self.seed);
        let (w, h) = (1.0f64, f64::from(self.tall));
        let d = f64::from(self.depth) * w.max(h);
        let t = f64::from(self.thick) * (w / f64::from(self.columns)).min(h / f64::from(self.rows));
        let feet = 0.05 * h;
        let column = |i: u32| -0.5 * w + w * f64::from(i) / f64::from(self.columns);
        let row = |j: u32| feet + (h - feet) * f64::from(j) / f64::from(self.rows);
        for i in 0..=self.columns {
            let x = column(i);
            let outer = i == 0 || i == self.columns;
            let low = if outer { 0.0 } else { feet };
            let out = if outer { 0.0 } else { NUDGE };
            b.cuboid(
                DVec3::new(x - 0.5 * t, low, -0.5 * d + out),
                DVec3::new(x + 0.5 * t, h + 0.5 * t - out, 0.5 * d - out),
                0.1 * t,
            );
        }
        for j in 0..=self.rows {
            let y = row(j);
            let (x, z) = (
                0.5 * w + if j == self.rows { 0.8 * t } else { 0.1 * t },
                0.5 * d - 2.0 * NUDGE + if j == self.rows { 0.02 } else { 0.0 },
            );
            b.cuboid(
                DVec3::new(-x, y - 0.45 * t, -z),
                DVec3::new(x, y + if j == self.rows { 0.7 * t } else { 0.45 * t }, z),
                0.1 * t,
            );
        }
        if self.back {
            let z = -0.5 * d + 0.25 * t;
            b.cuboid(DVec3::new(-0.5 * w, feet, z - 0.15 * t), DVec3::new(0.5 * w, h, z + 0.15 * t), 0.02 * t);
        }
        for j in 0..self.rows {
            for i in 0..self.columns {
                let (x0, x1) = (column(i) + 0.5 * t, column(i + 1) - 0.5 * t);
                let (y0, y1) = (row(j) + 0.45 * t - 0.0011, row(j + 1) - 0.45 * t);
                let (iw, ih) = (x1 - x0, y1 - y0);
                if dice.chance(f64::from(self.doors)) {
                    let z = 0.5 * d - 0.5 * t;
                    b.cuboid(
                        DVec3::new(x0 + 0.004, y0 + 0.005, z - 0.3 * t),
                        DVec3::new(x1 - 0.004, y1 - 0.004, z + 0.3 * t),
                        0.1 * t,
                    );
                    let at = DVec3::new(x1 - 0.12 * iw, 0.5 * (y0 + y1), z);
                    b.bar(at, at + DVec3::Z * (0.3 * t + 0.05 * ih), [0.03 * ih, 0.045 * ih], 12);
                } else if dice.chance(f64::from(self.filled)) {
                    match dice.below(3) {
                        0 => {
                            // Books, some leaning, up to a gap.
                            let mut x = x0 + 0.02 * iw;
                            let end = x0 + iw * dice.between(0.4, 0.95);
                            while x < end {
                                let thin = (iw * dice.between(0.04, 0.11)).max(0.004);
                                let (tall, deep) = (ih * dice.between(0.55, 0.9), d * dice.between(0.5, 0.75));
                                if x + thin > end {
                                    break;
                                }
                                let z = 0.5 * d - 0.06 * d;
                                b.cuboid(DVec3::new(x, y0, z - deep), DVec3::new(x + 0.94 * thin, y0 + tall, z), 0.08 * thin);
                                x += thin;
                            }
                        }
                        1 => {
                            let (bw, bh, bd) = (
                                0.5 * iw * dice.between(0.5, 0.85),
                                ih * dice.between(0.35, 0.8),
                                0.4 * d * dice.between(0.6, 0.9),
                            );
                            let m = 0.5 * (x0 + x1);
                            b.cuboid(DVec3::new(m - bw, y0, -bd), DVec3::new(m + bw, y0 + bh, bd), 0.05 * bw);
                        }
                        _ => {
                            let r = 0.45 * iw.min(0.9 * d) * dice.between(0.5, 0.85);
                            let tall = ih * dice.between(0.4, 0.8);
                            let outline = [
                                (0.5 * r, 0.0),
                                (r * dice.between(0.6, 1.0), 0.35 * tall),
                                (r * dice.between(0.3, 0.9), 0.75 * tall),
                                (r * dice.between(0.4, 0.8), tall),
                            ];
                            let turned = hollow(&profile(&outline, 5), 0.08 * r, 0.1 * r);
                            b.turned(shift(0.5 * (x0 + x1), y0, 0.0), &turned, 28);
                        }
                    }
                }
            }
        }
        (b, 30.0)
    }
}

choice! {
    /// The kind of a lamp.
    LampKind {
        /// On a table.
        Table,
        /// On a tall pole.
        Floor,
        /// On a bent arm.
        Arc,
        /// With two straight arms and joints.
        Desk,
        /// A street lantern.
        Lantern,
    }
}

family! {
    /// A lamp: foot, pole and a hollow shade with a bulb.
    shape Lamp("furniture", Upright) |rng| {
        /// The kind.
        kind: LampKind = LampKind::draw(rng);
        /// Width of the shade, against the usual.
        shade: f32 [0.5, 1.6] = rng.between(0.7, 1.4);
        /// Width of the shade's upper end over the lower.
        taper: f32 [0.1, 1.2] = rng.between(0.25, 1.0);
        /// Height of the pole, against the usual.
        pole: f32 [0.5, 1.6] = rng.between(0.75, 1.3);
        /// Belly of the foot.
        belly: f32 [0.3, 2] = rng.between(0.5, 1.5);
        /// Sides of the shade; above 24 round.
        sides: u32 [3, 48] = if rng.chance(0.7) { 48 } else { 4 + rng.below(6) };
    }
}

impl Lamp {
    fn build(&self) -> (Builder, f64) {
        let mut b = Builder::default();
        let (pole, belly) = (f64::from(self.pole), f64::from(self.belly));
        let (foot, height, thin) = match self.kind {
            LampKind::Table => (0.2, 0.55, 0.02),
            LampKind::Floor => (0.22, 1.5, 0.018),
            LampKind::Arc => (0.28, 1.3, 0.018),
            LampKind::Desk => (0.2, 0.5, 0.018),
            LampKind::Lantern => (0.16, 1.6, 0.04),
        };
        let height = height * pole;
        let mut outline = vec![DVec2::ZERO];
        let bulge = if self.kind == LampKind::Table { 0.2 * belly } else { thin * 1.4 };
        outline.extend(profile(
            &[
                (foot, 0.0),
                (foot, 0.02),
                (0.4 * foot, 0.06),
                (bulge.min(0.3), 0.25 * height),
                (thin * 1.5, 0.6 * height),
                (thin, 0.7 * height),
            ],
            6,
        ));
        outline.push(DVec2::new(0.0, 0.7 * height));
        let low = matches!(self.kind, LampKind::Desk);
        if low {
            b.turned(
                DAffine3::IDENTITY,
                &[
                    DVec2::ZERO,
                    DVec2::new(foot, 0.0),
                    DVec2::new(foot, 0.03),
                    DVec2::new(0.8 * foot, 0.045),
                    DVec2::new(0.0, 0.045),
                ],
                48,
            );
        } else {
            b.turned(DAffine3::IDENTITY, &outline, 40);
        }
        let shade = f64::from(self.shade);
        // The way from the foot to the shade's holder, and where the shade looks.
        let (path, axis) = match self.kind {
            LampKind::Arc => {
                let p = [
                    (0.0, 0.6 * height),
                    (0.02, 0.85 * height),
                    (0.2, 1.05 * height),
                    (0.5, 1.08 * height),
                    (0.68, 0.97 * height),
                ];
                (spline(&p.map(|(x, y)| DVec3::new(x, y, 0.0)), false, 8), DVec3::Y)
            }
            LampKind::Desk => {
                let (elbow, head) = (DVec3::new(-0.22, 0.62 * height, 0.0), DVec3::new(0.2, 1.1 * height, 0.0));
                b.ellipsoid(elbow, DVec3::splat(0.032), 6);
                b.ellipsoid(head, DVec3::splat(0.03), 6);
                (vec![DVec3::new(0.0, 0.03, 0.0), elbow, head], DVec3::new(-0.5, 0.85, 0.0).normalize())
            }
            _ => (vec![DVec3::new(0.0, 0.65 * height, 0.0), DVec3::new(0.0, height, 0.0)], DVec3::Y),
        };
        for pair in path.windows(2).filter(|_| low) {
            b.bar(pair[0], pair[1], [thin, thin], 12);
        }
        if !low {
            b.rod(&path, &vec![thin; path.len()], 12, false);
        }
        let end = path[path.len() - 1];
        let turn = DQuat::from_rotation_arc(DVec3::Y, axis);
        let hangs = low || self.kind == LampKind::Arc;
        let (wide, tall) = match self.kind {
            LampKind::Desk => (0.13 * shade, 0.2),
            LampKind::Lantern => (0.16 * shade, 0.4),
            _ => (0.26 * shade, 0.32),
        };
        let place = at(end, turn) * shift(0.0, if hangs { -tall + 0.02 } else { -0.35 * tall }, 0.0);
        let top = wide * f64::from(self.taper);
        let wall = 0.012;
        // A thin shell: up outside, down inside.
        let shell = [(wide, 0.0), (top.max(0.05), tall), (top.max(0.05) - wall, tall), (wide - wall, 0.0), (wide, 0.0)]
            .map(|(r, y)| DVec2::new(r, y));
        let sides = if self.sides > 24 { 48 } else { self.sides.max(3) as usize };
        b.part(place, |p| {
            p.lathe(&shell, sides);
            // A bulb, and three spokes that hold the shade.
            let level = 0.55 * tall;
            p.ellipsoid(DVec3::new(0.0, level, 0.0), DVec3::new(0.05, 0.065, 0.05), 8);
            p.bar(DVec3::new(0.0, if hangs { tall } else { -0.1 * tall }, 0.0), DVec3::new(0.0, level, 0.0), [0.022; 2], 12);
            let ring = if hangs { 0.93 * tall } else { 0.3 * tall };
            let r = wide + (top.max(0.05) - wide) * ring / tall - 0.5 * wall;
            let r = r * if sides < 24 { (TAU / 2.0 / sides as f64).cos() } else { 1.0 };
            for i in 0..3 {
                let (sin, cos) = (TAU * f64::from(i) / 3.0 + 0.03).sin_cos();
                p.bar(DVec3::new(0.004 * sin, ring, 0.004 * cos), DVec3::new(r * sin, ring, r * cos), [0.006; 2], 6);
            }
        });
        if self.kind == LampKind::Lantern {
            let roof = [
                DVec2::new(0.0, 0.0),
                DVec2::new(1.15 * top.max(0.08), 0.0),
                DVec2::new(0.05, 0.13),
                DVec2::new(0.03, 0.2),
                DVec2::new(0.0, 0.2),
            ];
            b.turned(place * shift(0.0, tall - 0.013, 0.0), &roof, 12);
        }
        (b, 30.0)
    }
}
