//! Furniture: tables, seats, shelves and lamps from closed, bevelled parts that run into one another.

use crate::draw::Draw;
use crate::shapes::builder::Builder;
use crate::shapes::families::outlines::plate;
use crate::shapes::families::round::superellipse;
use crate::shapes::model::{choice, model};
use crate::shapes::parts::{Dice, at, hollow, profile, shift, spline};
use glam::{DAffine3, DQuat, DVec2, DVec3};
use std::f64::consts::TAU;

/// Insets that keep edges of neighbouring parts apart.
const NUDGE: f64 = 0.0037;

choice! {
    /// How legs look.
    Leg {
        /// Square and straight.
        Square,
        /// Square, thinner below.
        Tapered,
        /// Round and leaning outwards.
        Splayed,
        /// Turned with rings.
        Turned,
    }
}

/// A leg from under the top (`height`) to the floor at 0, about (x, z); `out` points away from the middle.
fn leg(b: &mut Builder, kind: Leg, x: f64, z: f64, height: f64, thick: f64) {
    let out = DVec3::new(x, 0.0, z).normalize_or(DVec3::X);
    match kind {
        Leg::Square => {
            b.cuboid(DVec3::new(x - thick, 0.0, z - thick), DVec3::new(x + thick, height + 0.011, z + thick), 0.2 * thick)
        }
        Leg::Tapered => {
            let narrow = |p: DVec3| {
                let s = 0.5 + 0.5 * p.y / height;
                DVec3::new(x + p.x * s, p.y, z + p.z * s)
            };
            b.bent(narrow, |p| p.cuboid(DVec3::new(-thick, 0.0, -thick), DVec3::new(thick, height + 0.011, thick), 0.2 * thick));
        }
        Leg::Splayed => {
            let top = DVec3::new(x, height + 0.011, z);
            b.bar(top + out * (0.22 * height) - DVec3::Y * (height + 0.011), top, [0.6 * thick, thick], 16);
        }
        Leg::Turned => {
            let h = height + 0.011;
            let rings = [
                (0.7, 0.0),
                (0.8, 0.04),
                (0.5, 0.1),
                (0.75, 0.3),
                (1.05, 0.55),
                (0.6, 0.68),
                (1.1, 0.74),
                (0.6, 0.8),
                (1.0, 0.86),
                (1.0, 1.0),
            ];
            let mut outline = vec![DVec2::ZERO];
            outline.extend(profile(&rings.map(|(r, y)| (r * thick, y * h)), 4));
            outline.push(DVec2::new(0.0, h));
            b.turned(shift(x, 0.0, z), &outline, 20);
        }
    }
}

choice! {
    /// What carries a table.
    Carrier {
        /// Four legs.
        Legs,
        /// A turned column on a foot.
        Pedestal,
        /// Two trestles and a beam.
        Trestle,
        /// Two side panels.
        Panels,
        /// Three legs.
        Tripod,
    }
}

model! {
    /// A table, desk or stool.
    Table("table", "furniture", Upright) |rng| {
        /// What carries it.
        carrier: Carrier = Carrier::draw(rng);
        /// The legs, where it has them.
        leg: Leg = Leg::draw(rng);
        /// Exponent of the top's outline: 0.1 a rectangle, 1 an ellipse.
        corner: f32 [0.1, 1] = if rng.chance(0.5) { 0.1 } else { rng.between(0.15, 1.0) };
        /// Depth over width of the top.
        depth: f32 [0.3, 1] = rng.between(0.45, 1.0);
        /// Height over width of the top.
        height: f32 [0.25, 1.6] = rng.log(0.4, 1.2);
        /// Thickness of top and legs, as a share of the width.
        thick: f32 [0.01, 0.06] = rng.between(0.02, 0.045);
        /// A frame under the top.
        apron: bool = rng.chance(0.5);
        /// A shelf between the legs.
        shelf: bool = rng.chance(0.3);
    }
}

impl Table {
    fn build(&self) -> (Builder, f64) {
        let mut b = Builder::default();
        let (depth, height, thick) = (f64::from(self.depth), f64::from(self.height), f64::from(self.thick));
        let half = DVec2::new(0.5, 0.5 * depth);
        let corner = f64::from(self.corner);
        if corner < 0.12 {
            b.cuboid(DVec3::new(-half.x, height - thick, -half.y), DVec3::new(half.x, height, half.y), 0.15 * thick);
        } else {
            let outline: Vec<DVec2> = (0..96).map(|i| superellipse(TAU * f64::from(i) / 96.0, corner) * half).collect();
            b.part(DAffine3::IDENTITY, |p| {
                let mut flat = Builder::default();
                plate(&mut flat, &outline, &[], thick, 0.15 * thick);
                flat.turn_z_to_y();
                flat.map_points(|p| p + DVec3::Y * (height - thick));
                p.absorb(flat);
            });
        }
        let under = height - thick;
        // Where legs stand: within round tops, too.
        let reach = half * (0.92 - 0.24 * corner) - DVec2::splat(thick);
        let thin = 0.8 * thick;
        match self.carrier {
            Carrier::Legs | Carrier::Tripod => {
                let spots: Vec<DVec2> = if self.carrier == Carrier::Legs {
                    [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, z)| reach * DVec2::new(x, z)).to_vec()
                } else {
                    (0..3).map(|i| DVec2::from_angle(TAU * f64::from(i) / 3.0 + 0.5) * reach * 0.9).collect()
                };
                for s in &spots {
                    leg(&mut b, self.leg, s.x, s.y, under, thin);
                }
                if self.apron && self.carrier == Carrier::Legs {
                    let drop = (0.12 * height).clamp(0.03, 0.1);
                    for side in [-1.0, 1.0] {
                        let (x, z) = (reach.x, side * reach.y);
                        b.cuboid(
                            DVec3::new(-x, under - drop, z - 0.4 * thick),
                            DVec3::new(x, under + 0.3 * thick, z + 0.4 * thick),
                            NUDGE,
                        );
                        let x = side * reach.x;
                        let z = reach.y;
                        let (low, high) = (under - drop + NUDGE, under + 0.3 * thick - NUDGE);
                        b.cuboid(DVec3::new(x - 0.4 * thick, low, -z), DVec3::new(x + 0.4 * thick, high, z), NUDGE);
                    }
                }
                if self.shelf && self.carrier == Carrier::Legs && self.leg != Leg::Splayed {
                    let y = 0.25 * height;
                    b.cuboid(DVec3::new(-reach.x, y, -reach.y), DVec3::new(reach.x, y + 0.7 * thick, reach.y), 0.1 * thick);
                }
            }
            Carrier::Pedestal => {
                let r = 0.7 * reach.min_element();
                let outline = [
                    (r, 0.0),
                    (r, 0.5 * thick),
                    (0.5 * r, 2.0 * thick),
                    (1.5 * thick, 0.3 * height),
                    (2.2 * thick, 0.5 * height),
                    (1.3 * thick, 0.75 * height),
                    (0.4 * r, under - 0.3 * thick),
                    (0.45 * r, under + 0.3 * thick),
                ];
                let mut turned = vec![DVec2::ZERO];
                turned.extend(profile(&outline, 5));
                turned.push(DVec2::new(0.0, turned[turned.len() - 1].y));
                b.turned(DAffine3::IDENTITY, &turned, 48);
            }
            Carrier::Trestle => {
                for side in [-1.0, 1.0] {
                    let x = side * 0.75 * reach.x;
                    for lean in [-1.0, 1.0] {
                        let (foot, top) =
                            (DVec3::new(x, 0.0, lean * reach.y), DVec3::new(x, under + 0.3 * thick, lean * 0.25 * reach.y));
                        let length = foot.distance(top);
                        let turn = DQuat::from_rotation_arc(DVec3::Y, (top - foot) / length);
                        b.part(at(0.5 * (foot + top), turn), |p| {
                            p.slab(DVec3::new(1.6 * thick, length, 1.3 * thick), 0.2 * thick)
                        });
                    }
                    let y = 0.35 * height + 0.01 * side;
                    let z = 0.7 * reach.y;
                    b.cuboid(DVec3::new(x - 0.5 * thick, y, -z), DVec3::new(x + 0.5 * thick, y + 1.6 * thick, z), NUDGE);
                }
                let (x, y) = (0.75 * reach.x, 0.4 * height);
                b.cuboid(DVec3::new(-x, y, -0.45 * thick), DVec3::new(x, y + thick, 0.45 * thick), NUDGE);
            }
            Carrier::Panels => {
                for side in [-1.0, 1.0] {
                    let x = side * reach.x;
                    let z = 0.9 * reach.y;
                    b.cuboid(
                        DVec3::new(x - 0.5 * thick, 0.0, -z),
                        DVec3::new(x + 0.5 * thick, under + 0.4 * thick, z),
                        0.1 * thick,
                    );
                }
                let (y, z) = (under - 0.35 * height, -0.6 * reach.y);
                b.cuboid(DVec3::new(-reach.x, y, z), DVec3::new(reach.x, y + 0.3 * height, z + 0.6 * thick), NUDGE);
                if self.shelf {
                    // A block of drawers with handles on the right.
                    for i in 0..3 {
                        let y = 0.06 * height + 0.28 * height * f64::from(i);
                        let (x0, x1) = (0.35 * reach.x, reach.x - 0.52 * thick);
                        b.cuboid(
                            DVec3::new(x0, y, -0.7 * reach.y),
                            DVec3::new(x1, y + 0.26 * height, 0.85 * reach.y),
                            0.15 * thick,
                        );
                        let m = DVec3::new(0.5 * (x0 + x1), y + 0.16 * height, 0.85 * reach.y);
                        b.bar(m - DVec3::Z * 0.01, m + DVec3::Z * 0.7 * thick, [0.35 * thick, 0.5 * thick], 12);
                    }
                    b.cuboid(
                        DVec3::new(0.35 * reach.x - NUDGE, 0.02 * height, -0.75 * reach.y),
                        DVec3::new(reach.x - 0.4 * thick, 0.1 * height, 0.7 * reach.y),
                        NUDGE,
                    );
                }
            }
        }
        (b, 30.0)
    }
}

choice! {
    /// The kind of a seat.
    Seat {
        /// A plain chair.
        Chair,
        /// A chair with arms.
        Armchair,
        /// A bench with a back.
        Bench,
        /// A high stool with a low back.
        Stool,
        /// An upholstered sofa.
        Sofa,
    }
}

model! {
    /// A chair, armchair, bench, stool or sofa.
    Chair("chair", "furniture", Upright) |rng| {
        /// The kind.
        seat: Seat = Seat::draw(rng);
        /// The legs.
        leg: Leg = Leg::draw(rng);
        /// Height of the seat over its width, against the usual.
        height: f32 [0.6, 1.6] = rng.between(0.8, 1.2);
        /// Height of the back, against the usual.
        back: f32 [0.4, 1.6] = rng.between(0.7, 1.3);
        /// Lean of the back, degrees.
        lean: f32 [0, 30] = rng.between(2.0, 18.0);
        /// Slats of the back; 0 = a panel. Upright ones when odd.
        slats: u32 [0, 9] = rng.below(8);
        /// Thickness of parts as a share of the width.
        thick: f32 [0.03, 0.09] = rng.between(0.04, 0.075);
    }
}

impl Chair {
    fn build(&self) -> (Builder, f64) {
        let mut b = Builder::default();
        let (wide, usual_height, usual_back) = match self.seat {
            Seat::Bench => (1.6, 0.75, 0.7),
            Seat::Sofa => (1.9, 0.55, 0.75),
            Seat::Stool => (0.8, 1.5, 0.45),
            Seat::Chair | Seat::Armchair => (1.0, 0.9, 1.0),
        };
        let (height, back) = (usual_height * f64::from(self.height), usual_back * f64::from(self.back));
        let thick = f64::from(self.thick);
        let (x, z) = (0.5 * wide, 0.48);
        let soft = self.seat == Seat::Sofa;
        let pad = if soft { 0.22 } else { thick };
        let height = if soft { height.max(pad + 0.2) } else { height };
        if soft {
            let n = 2 + self.slats as usize % 2;
            for i in 0..n {
                let (x0, x1) = (-x + 2.0 * x * i as f64 / n as f64, -x + 2.0 * x * (i + 1) as f64 / n as f64);
                cushion(&mut b, DVec3::new(x0 + 0.012, height - pad, -z), DVec3::new(x1 - 0.012, height, z));
            }
            b.cuboid(DVec3::new(-x, height - pad - 0.16, -z + 0.01), DVec3::new(x, height - pad + 0.05, z - 0.02), 0.02);
        } else {
            b.cuboid(DVec3::new(-x, height - pad, -z), DVec3::new(x, height, z), 0.25 * thick);
        }
        let under = height - pad - if soft { 0.14 } else { 0.0 };
        for (sx, sz) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
            leg(&mut b, self.leg, sx * (x - 1.2 * thick), sz * (z - 1.2 * thick), under, 0.6 * thick);
        }
        if self.leg != Leg::Splayed && !soft {
            // Stretchers between the legs.
            let y = 0.3 * under;
            for s in [-1.0, 1.0] {
                let (px, pz) = (s * (x - 1.2 * thick), z - 1.2 * thick);
                b.bar(DVec3::new(px, y, -pz), DVec3::new(px, y + 0.005, pz), [0.3 * thick; 2], 10);
            }
            b.bar(DVec3::new(-x + 1.2 * thick, y, 0.0), DVec3::new(x - 1.2 * thick, y + 0.004, 0.0), [0.28 * thick; 2], 10);
        }
        // The back leans about the rear edge of the seat.
        let lean = DAffine3::from_translation(DVec3::new(0.0, height - 0.5 * pad, -z + 0.6 * thick))
            * DAffine3::from_rotation_x(-f64::from(self.lean).to_radians());
        let top = back + 0.5 * pad;
        let mut rest = Builder::default();
        if soft {
            let n = 2 + self.slats as usize % 2;
            for i in 0..n {
                let (x0, x1) = (-x + 2.0 * x * i as f64 / n as f64, -x + 2.0 * x * (i + 1) as f64 / n as f64);
                cushion(&mut rest, DVec3::new(x0 + 0.012, 0.05, -0.1), DVec3::new(x1 - 0.012, top, 0.14));
            }
            rest.cuboid(DVec3::new(-x + 0.003, -0.25, -0.2), DVec3::new(x - 0.003, top - 0.06, -0.05), 0.03);
        } else {
            let post = 0.45 * thick;
            for s in [-1.0, 1.0] {
                let px = s * (x - post - 0.013);
                rest.cuboid(DVec3::new(px - post, -0.3 * thick, -post), DVec3::new(px + post, top, post), 0.2 * post);
            }
            let px = x - 2.0 * post;
            let thin = 0.55 * post;
            rest.cuboid(DVec3::new(-px, top - 1.8 * thick, -thin), DVec3::new(px, top - 0.2 * thick, thin), 0.3 * thin);
            if self.slats == 0 {
                rest.cuboid(DVec3::new(-px, 0.25 * top, -0.8 * thin), DVec3::new(px, top - 1.0 * thick, 0.8 * thin), 0.2 * thin);
            } else if self.slats % 2 == 1 {
                let n = self.slats + 1;
                rest.cuboid(DVec3::new(-px, 0.15 * top, -0.9 * thin), DVec3::new(px, 0.15 * top + thick, 0.9 * thin), 0.2 * thin);
                for i in 1..=n {
                    let sx = -px + 2.0 * px * f64::from(i) / f64::from(n + 1);
                    let w = (0.3 * px / f64::from(n)).min(0.6 * thick);
                    rest.cuboid(
                        DVec3::new(sx - w, 0.15 * top + 0.3 * thick, -0.6 * thin),
                        DVec3::new(sx + w, top - thick, 0.6 * thin),
                        0.2 * thin,
                    );
                }
            } else {
                for i in 0..self.slats / 2 {
                    let y = (0.15 + 0.6 * f64::from(i) / f64::from(self.slats / 2)) * top;
                    let tall = (0.3 * top / f64::from(self.slats)).min(2.0 * thick);
                    rest.cuboid(DVec3::new(-px, y, -0.8 * thin), DVec3::new(px, y + tall, 0.8 * thin), 0.2 * thin);
                }
            }
        }
        b.part(lean, |p| p.absorb(rest));
        if matches!(self.seat, Seat::Armchair | Seat::Sofa) {
            for s in [-1.0, 1.0] {
                if soft {
                    let (x0, x1) = if s > 0.0 { (x - 0.02, x + 0.2) } else { (-x - 0.2, -x + 0.02) };
                    cushion(&mut b, DVec3::new(x0, 0.12 * height, -z - 0.03), DVec3::new(x1, height + 0.25, z + 0.03));
                } else {
                    let (px, y) = (s * (x - 0.4 * thick), height + 0.38);
                    b.cuboid(
                        DVec3::new(px - 0.7 * thick, y, -z),
                        DVec3::new(px + 0.7 * thick, y + 0.6 * thick, z - 0.1),
                        0.15 * thick,
                    );
                    b.bar(
                        DVec3::new(px, height - 0.5 * thick, z - 0.2),
                        DVec3::new(px, y + 0.2 * thick, z - 0.2),
                        [0.3 * thick; 2],
                        12,
                    );
                }
            }
        }
        (b, 30.0)
    }
}

/// A soft box from corner to corner.
fn cushion(b: &mut Builder, low: DVec3, high: DVec3) {
    let half = 0.5 * (high - low);
    b.part(DAffine3::from_translation(0.5 * (low + high)), |p| {
        p.ball(10, |d| d / (d.x.abs().powi(7) + d.y.abs().powi(7) + d.z.abs().powi(7)).powf(1.0 / 7.0) * half);
    });
}

model! {
    /// Shelves with things on them, or a cabinet with doors.
    Shelf("shelf", "furniture", Upright) |rng| {
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

model! {
    /// A lamp: foot, pole and a hollow shade with a bulb.
    Lamp("lamp", "furniture", Upright) |rng| {
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
