//! Furniture: tables and seats from closed, bevelled parts that run into one another.

use crate::draw::Draw;
use crate::family::{choice, family};
use crate::shapes::builder::Builder;
use crate::shapes::families::outlines::plate;
use crate::shapes::families::round::superellipse;
use crate::shapes::parts::{at, profile, shift};
use glam::{DAffine3, DQuat, DVec2, DVec3};
use std::f64::consts::TAU;

/// Insets that keep edges of neighbouring parts apart.
pub(super) const NUDGE: f64 = 0.0037;

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

family! {
    /// A table, desk or stool.
    shape Table("furniture", Upright) |rng| {
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

family! {
    /// A chair, armchair, bench, stool or sofa.
    shape Chair("furniture", Upright) |rng| {
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
