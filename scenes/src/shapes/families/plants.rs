//! Small plants and fungi: cacti, rosettes, grass and mushrooms. Leaves and stems are closed and run into one another.

use crate::draw::Draw;
use crate::family::{choice, family};
use crate::noise;
use crate::shapes::builder::Builder;
use crate::shapes::parts::{Dice, frame, hollow, profile, spline};
use glam::{DAffine3, DQuat, DVec2, DVec3};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// A mound of earth of radius `r` about the origin, its top at `height`.
pub(super) fn mound(b: &mut Builder, r: f64, height: f64, seed: u32) {
    b.part(DAffine3::IDENTITY, |p| {
        p.ball(9, |d| {
            let bump = 1.0 + 0.2 * noise::fractal(d * 2.1, 3, seed);
            DVec3::new(d.x * r * bump, (d.y * height * bump).max(-0.25 * height), d.z * r * bump)
        });
    });
}

/// A pot of this width and height with earth in it, standing at 0.
pub(super) fn pot(b: &mut Builder, r: f64, height: f64) {
    let outline = [(0.7 * r, 0.0), (0.95 * r, 0.8 * height), (1.06 * r, 0.81 * height), (1.08 * r, height)];
    let outer: Vec<DVec2> = outline.iter().map(|&(x, y)| DVec2::new(x, y)).collect();
    b.turned(DAffine3::IDENTITY, &hollow(&outer, 0.09 * r, 0.1 * height), 48);
    let earth = [
        DVec2::new(0.0, 0.5 * height),
        DVec2::new(0.85 * r, 0.5 * height),
        DVec2::new(0.93 * r, 0.9 * height),
        DVec2::new(0.0, 0.94 * height),
    ];
    b.turned(DAffine3::IDENTITY, &earth, 40);
}

choice! {
    /// The kind of a cactus.
    CactusKind {
        /// A column with arms.
        Saguaro,
        /// A ribbed ball.
        Barrel,
        /// Flat pads on pads.
        Opuntia,
        /// A bundle of columns.
        Organ,
    }
}

family! {
    /// A cactus, in a pot or on a mound.
    shape Cactus("plant", Upright) |rng| {
        /// The kind.
        kind: CactusKind = CactusKind::draw(rng);
        /// Ribs.
        ribs: u32 [4, 24] = 7 + rng.below(12);
        /// Depth of the furrows.
        furrow: f32 [0, 0.5] = rng.between(0.1, 0.35);
        /// Arms, pads or columns.
        arms: u32 [0, 12] = 2 + rng.below(6);
        /// Radius over height.
        slim: f32 [0.06, 0.3] = rng.between(0.09, 0.17);
        /// In a pot.
        potted: bool = rng.chance(0.5);
        /// Which plant.
        seed: u32 = rng.below(1 << 30);
    }
}

impl Cactus {
    /// A ribbed column along `path` with round ends.
    fn column(&self, b: &mut Builder, path: &[DVec3], r: f64, ends: [bool; 2]) {
        let (n, ribs) = (path.len(), f64::from(self.ribs));
        let sides = (4 * self.ribs as usize).max(24);
        b.part(DAffine3::IDENTITY, |p| {
            p.tube(path, false, sides, [2.0, 6.0], |i, a| {
                let share = i as f64 / (n - 1) as f64;
                let rib = 1.0 - f64::from(self.furrow) * (0.5 * ribs * a).sin().abs().sqrt() * 0.5;
                let cap = |d: f64| (1.0 - (1.0 - (d / 0.12).min(1.0)).powi(2)).max(0.0).sqrt();
                let end = if ends[1] { cap(1.0 - share) } else { 1.0 } * if ends[0] { cap(share).max(0.35) } else { 1.0 };
                r * rib * end * DVec2::from_angle(a)
            });
        });
    }

    fn build(&self) -> (Builder, f64) {
        let mut b = Builder::default();
        let mut dice = Dice::new(self.seed);
        let r = f64::from(self.slim);
        let line = |from: DVec3, to: DVec3| (0..=24).map(|i| from.lerp(to, f64::from(i) / 24.0)).collect::<Vec<_>>();
        let ground = if self.potted {
            let (wide, tall) = if self.kind == CactusKind::Barrel { (0.42, 0.4) } else { (2.2 * r, 0.35) };
            pot(&mut b, wide, tall);
            0.85 * tall
        } else {
            mound(
                &mut b,
                match self.kind {
                    CactusKind::Barrel => 0.42,
                    CactusKind::Opuntia => 0.2,
                    _ => 0.3,
                },
                0.06,
                self.seed,
            );
            0.0
        };
        let base = DVec3::Y * ground;
        match self.kind {
            CactusKind::Saguaro => {
                self.column(&mut b, &line(base, base + DVec3::Y), r, [false, true]);
                for i in 0..self.arms.min(6) {
                    let a = 2.399_963 * f64::from(i) + dice.between(-0.3, 0.3);
                    let out = DVec3::new(a.sin(), 0.0, a.cos());
                    let (y, length) = (ground + dice.between(0.3, 0.6), dice.between(0.18, 0.4));
                    let reach = r * dice.between(2.0, 2.8);
                    let points = [
                        out * (0.6 * r) + DVec3::Y * y,
                        out * (0.8 * reach) + DVec3::Y * (y + 0.01),
                        out * reach + DVec3::Y * (y + 0.1),
                        out * reach + DVec3::Y * (y + 0.1 + length),
                    ];
                    self.column(&mut b, &spline(&points, false, 8), 0.62 * r, [false, true]);
                }
            }
            CactusKind::Organ => {
                for i in 0..self.arms.max(2) {
                    let a = 2.399_963 * f64::from(i);
                    let d = 0.75 * r * f64::from(i).sqrt();
                    let foot = base + DVec3::new(a.sin(), 0.0, a.cos()) * d;
                    let lean = DVec3::new(a.sin(), 0.0, a.cos()) * dice.between(0.0, 0.12);
                    let tall = dice.between(0.45, 1.0);
                    self.column(&mut b, &line(foot, foot + lean + DVec3::Y * tall), r * dice.between(0.5, 0.8), [false, true]);
                }
            }
            CactusKind::Barrel => {
                let ribs = f64::from(self.ribs) + 6.0;
                b.part(DAffine3::from_translation(base + DVec3::Y * 0.33), |p| {
                    let sides = 4 * (self.ribs as usize + 6);
                    let point = |i: usize, j: usize| {
                        let (u, v) = (TAU * (i % sides) as f64 / sides as f64, PI * (j as f64 / 32.0 - 0.5));
                        let across = if j == 0 || j == 32 { 0.0 } else { v.cos() };
                        let rib = 1.0 - f64::from(self.furrow) * 0.6 * (0.5 * ribs * u).sin().abs().sqrt() * across;
                        0.38 * DVec3::new(
                            across * rib * u.sin(),
                            1.05 * v.sin() - 0.16 * (v.sin().max(0.0)).powi(8),
                            across * rib * u.cos(),
                        )
                    };
                    p.cells(sides, 32, [4.0, 2.0], point);
                });
                for i in 0..self.arms {
                    let a = 2.399_963 * f64::from(i);
                    let d = 0.03 + 0.035 * f64::from(i).sqrt();
                    b.ellipsoid(base + DVec3::new(d * a.sin(), 0.66, d * a.cos()), DVec3::new(0.03, 0.05, 0.03), 4);
                }
            }
            CactusKind::Opuntia => {
                let mut pads = vec![(base - DVec3::Y * 0.03, DVec3::Y, 0.3, dice.between(0.0, PI))];
                let mut made = 0;
                while let Some((from, axis, length, spin)) = pads.pop() {
                    made += 1;
                    let turn = frame(axis, DQuat::from_rotation_y(spin) * DVec3::Z);
                    let place = DAffine3::from_mat3_translation(turn, from);
                    b.part(place, |p| {
                        p.ball(10, |d| {
                            let wide = 0.36 * length * (1.0 + 0.25 * d.y);
                            DVec3::new(d.x * wide, (0.5 + 0.5 * d.y) * length, d.z * 0.11 * length)
                        });
                    });
                    if made > self.arms {
                        continue;
                    }
                    for side in [-1.0, 1.0] {
                        if made > 1 && dice.chance(0.35) {
                            continue;
                        }
                        let a = side * dice.between(0.2, 0.9);
                        let at = place.transform_point3(DVec3::new(0.3 * length * a.sin(), length * (0.55 + 0.4 * a.cos()), 0.0));
                        let up = (place.transform_vector3(DVec3::new(a.sin(), a.cos(), dice.between(-0.2, 0.2)))
                            + DVec3::Y * 0.55)
                            .normalize_or(DVec3::Y);
                        let smaller = length * dice.between(0.75, 0.95);
                        pads.insert(0, (at, up, smaller, spin + dice.between(-0.7, 0.7)));
                    }
                }
            }
        }
        (b, 50.0)
    }
}

choice! {
    /// The kind of a rosette.
    Leaves {
        /// Thick pointed leaves of an agave.
        Agave,
        /// Round leaves of a house leek.
        Leek,
        /// Long bent leaves of a dracaena.
        Strap,
        /// Fronds with leaflets, a fern.
        Fern,
        /// Wide leaves on stalks.
        Hosta,
        /// Petals of a flower on a stem.
        Flower,
    }
}

family! {
    /// Leaves about a middle at the golden angle, in a pot or on a mound.
    shape Rosette("plant", Upright) |rng| {
        /// The kind.
        leaves: Leaves = Leaves::draw(rng);
        /// Leaves.
        count: u32 [3, 80] = 10 + rng.below(30);
        /// Width of a leaf over its length, against the usual.
        width: f32 [0.4, 2] = rng.between(0.7, 1.4);
        /// How steeply leaves rise, degrees from the ground: the outermost.
        rise: f32 [0, 80] = rng.between(8.0, 45.0);
        /// How far leaves bend down along their length, degrees.
        bend: f32 [-60, 150] = rng.between(0.0, 80.0);
        /// In a pot.
        potted: bool = rng.chance(0.5);
        /// Which plant.
        seed: u32 = rng.below(1 << 30);
    }
}

impl Rosette {
    fn build(&self) -> (Builder, f64) {
        let mut b = Builder::default();
        let mut dice = Dice::new(self.seed);
        let stem = self.leaves == Leaves::Flower;
        let ground = if self.potted {
            pot(&mut b, 0.3, 0.34);
            0.3
        } else {
            mound(&mut b, 0.3, 0.06, self.seed);
            0.02
        };
        let mut heart = DVec3::Y * ground;
        if stem {
            let top = heart + DVec3::new(dice.between(-0.1, 0.1), 0.9, dice.between(-0.1, 0.1));
            let path = spline(&[heart - DVec3::Y * 0.03, heart.lerp(top, 0.5) + DVec3::X * 0.04, top], false, 8);
            b.rod(&path, &vec![0.022; path.len()], 10, true);
            b.ellipsoid(top, DVec3::new(0.1, 0.06, 0.1), 8);
            for _ in 0..3 {
                let at = path[3 + dice.below(8)];
                self.blade(&mut b, at, dice.between(0.0, TAU), [0.35, 0.06, 0.012], [0.5, 0.6]);
            }
            heart = top;
        }
        // (length, width, thickness) of the outermost leaf.
        let (length, wide, thick) = match self.leaves {
            Leaves::Agave => (0.8, 0.075, 0.06),
            Leaves::Leek => (0.45, 0.1, 0.05),
            Leaves::Strap => (1.0, 0.045, 0.01),
            Leaves::Fern => (0.9, 0.012, 0.016),
            Leaves::Hosta => (0.6, 0.17, 0.014),
            Leaves::Flower => (0.42, 0.075, 0.012),
        };
        let wide = wide * f64::from(self.width);
        let count = if self.leaves == Leaves::Fern { self.count.min(16) } else { self.count };
        let outer = f64::from(self.rise).to_radians();
        for i in 0..count {
            let share = if stem { f64::from(i % 3) / 6.0 } else { f64::from(i) / f64::from(count) };
            let around = 2.399_963 * f64::from(i);
            // The outer leaves are the first ones, long and low; the heart's are short and steep.
            let steep = outer + (FRAC_PI_2 * 0.95 - outer).max(0.0) * share.powf(1.3);
            let scale = (1.0 - 0.55 * share) * dice.between(0.88, 1.08);
            let bend = f64::from(self.bend).to_radians() * (1.0 - 0.6 * share);
            if self.leaves == Leaves::Fern {
                self.frond(&mut b, length * scale, Self::line(heart, around, length * scale, steep.max(0.5), bend.max(0.4)));
            } else {
                self.blade(&mut b, heart, around, [length * scale, wide * scale.sqrt(), thick], [steep, bend]);
            }
        }
        (b, 50.0)
    }

    /// Middle line of a leaf: from the heart outwards, rising at first and bending down.
    fn line(heart: DVec3, around: f64, length: f64, steep: f64, bend: f64) -> impl Fn(f64) -> (DVec3, DVec3, DVec3) {
        let out = DVec3::new(around.sin(), 0.0, around.cos());
        // Sums of the directions along the way, in 16 steps.
        let mut points = vec![heart];
        for i in 0..16 {
            let a = steep - bend * (f64::from(i) + 0.5) / 16.0;
            let last = points[points.len() - 1];
            let next = last + (out * a.cos() + DVec3::Y * a.sin()) * length / 16.0;
            // No leaf goes into the ground.
            points.push(DVec3::new(next.x, next.y.max(0.012), next.z));
        }
        move |s: f64| {
            let x = (s * 16.0).clamp(0.0, 15.999);
            let (i, t) = (x as usize, x.fract());
            let p = points[i].lerp(points[i + 1], t);
            let along = (points[(i + 2).min(16)] - points[i.saturating_sub(1)]).normalize_or(DVec3::Y);
            (p, along, out)
        }
    }

    /// A leaf from the heart; `[length, half width, thickness]`, `[steepness, bend]` in radians.
    fn blade(&self, b: &mut Builder, heart: DVec3, around: f64, [length, wide, thick]: [f64; 3], [steep, bend]: [f64; 2]) {
        let line = Self::line(heart, around, length, steep, bend);
        let shape = self.leaves;
        let width = move |s: f64| {
            wide * match shape {
                Leaves::Agave => (1.0 - s).powf(0.7) * (0.55 + 1.3 * s * (1.0 - s) * 1.6),
                Leaves::Leek => (s * 1.1).min(1.0).powf(0.7) * (1.0 - s.powi(5)).max(0.0) * 1.1,
                Leaves::Strap => (1.0 - s).powf(0.45) * (0.4 + 0.6 * (4.0 * s).min(1.0)),
                Leaves::Hosta => {
                    let t = ((s - 0.3) / 0.7).max(0.0);
                    0.06 + (t * (1.0 - t) * 4.0).powf(0.75) * (1.15 - 0.4 * t)
                }
                _ => (s * (1.0 - s) * 4.0).max(0.0).powf(0.6),
            }
        };
        let channel = if matches!(shape, Leaves::Agave | Leaves::Strap | Leaves::Hosta) { 0.25 } else { 0.1 };
        let rows = if self.count > 40 { 10 } else { 14 };
        b.leaf(rows, 6, thick, width, |s, across, up| {
            let (p, along, out) = line(s);
            let side = DVec3::Y.cross(out).normalize_or(DVec3::X);
            let normal = along.cross(side).normalize_or(DVec3::Y);
            // A leaf is a shallow gutter.
            p + side * across + normal * (up + channel * across * across / wide.max(1e-6))
        });
    }

    /// A frond of `length` along `line`, which gives point, direction and outward direction at a share of it.
    fn frond(&self, b: &mut Builder, length: f64, line: impl Fn(f64) -> (DVec3, DVec3, DVec3)) {
        let path: Vec<DVec3> = (0..=10).map(|i| line(f64::from(i) / 10.0).0).collect();
        let radii: Vec<f64> = (0..=10).map(|i| 0.011 * (1.0 - 0.08 * f64::from(i))).collect();
        b.rod(&path, &radii, 6, true);
        let pairs = 9;
        for i in 0..pairs {
            let s = 0.2 + 0.78 * f64::from(i) / f64::from(pairs);
            let (p, along, out) = line(s);
            let side = DVec3::Y.cross(out).normalize_or(DVec3::X);
            let normal = along.cross(side).normalize_or(DVec3::Y);
            let reach = 0.26 * length * f64::from(self.width).sqrt() * (1.0 - s).powf(0.6) * (3.0 * s).min(1.0) + 0.02;
            for sign in [-1.0, 1.0] {
                let direction = (side * sign + along * 0.45).normalize_or(side);
                let flank = normal.cross(direction);
                let width = |t: f64| 0.16 * reach.max(0.05) * (t * (1.0 - t) * 4.0).max(0.0).powf(0.6);
                b.leaf(4, 2, 0.006, width, |t, across, up| {
                    p + direction * (t * reach) + flank * across + normal * (up - 0.15 * reach * t * t)
                });
            }
        }
    }
}

family! {
    /// A tuft of grass blades on a mound.
    shape Grass("plant", Upright) |rng| {
        /// Blades.
        blades: u32 [8, 240] = 50 + rng.below(130);
        /// Width of a blade over its length.
        width: f32 [0.005, 0.06] = rng.log(0.012, 0.035);
        /// How far blades bend outwards.
        bend: f32 [0, 1.5] = rng.between(0.2, 1.1);
        /// Width of the tuft over its height.
        spread: f32 [0.05, 1] = rng.between(0.12, 0.5);
        /// Share of stalks with ears.
        ears: f32 [0, 0.5] = if rng.chance(0.5) { 0.0 } else { rng.between(0.05, 0.25) };
        /// Which tuft.
        seed: u32 = rng.below(1 << 30);
    }
}

impl Grass {
    fn build(&self) -> (Builder, f64) {
        let mut b = Builder::default();
        let mut dice = Dice::new(self.seed);
        let spread = f64::from(self.spread);
        mound(&mut b, 0.1 + 0.75 * spread, 0.05, self.seed);
        for i in 0..self.blades {
            let around = 2.399_963 * f64::from(i) + dice.between(-0.5, 0.5);
            let out = DVec3::new(around.sin(), 0.0, around.cos());
            let share = (f64::from(i) / f64::from(self.blades)).sqrt();
            let length = dice.between(0.5, 1.0);
            let foot = out * (0.7 * spread * share) + DVec3::Y * 0.005;
            let lean = (0.15 + 0.5 * share) * f64::from(self.bend) * dice.between(0.5, 1.3);
            let curl = f64::from(self.bend) * dice.between(0.2, 1.0);
            let at = move |s: f64| {
                let angle = FRAC_PI_2 - lean * 0.6 - curl * s * s;
                foot + (out * angle.cos() + DVec3::Y * angle.sin().max(0.02)) * (length * s)
            };
            let twist = DQuat::from_rotation_y(dice.between(-0.6, 0.6));
            let side = twist * DVec3::Y.cross(out).normalize_or(DVec3::X);
            if dice.chance(f64::from(self.ears)) {
                let path: Vec<DVec3> = (0..=6).map(|k| at(f64::from(k) / 6.0)).collect();
                b.rod(&path, &[0.006; 7], 5, true);
                let (tip, before) = (path[6], path[5]);
                let turn = crate::shapes::parts::along(tip - before);
                b.part(crate::shapes::parts::at(tip, turn), |p| p.ball(4, |d| d * DVec3::new(0.016, 0.07, 0.016)));
                continue;
            }
            let wide = 0.5 * f64::from(self.width) * length * 1.6;
            let width = |s: f64| wide * (1.0 - s).powf(0.6) * (0.5 + 0.5 * (6.0 * s).min(1.0));
            b.leaf(7, 2, 0.5 * wide, width, |s, across, up| {
                let along = (at(s + 0.05) - at(s - 0.05)).normalize_or(DVec3::Y);
                let normal = along.cross(side).normalize_or(DVec3::Z);
                at(s) + side * across + normal * (up + 0.3 * across.abs())
            });
        }
        (b, 40.0)
    }
}

family! {
    /// Mushrooms on a mound.
    shape Mushroom("plant", Upright) |rng| {
        /// How many.
        count: u32 [1, 12] = 1 + rng.below(5);
        /// Width of the cap over the height.
        cap: f32 [0.15, 0.9] = rng.between(0.3, 0.7);
        /// Height of the cap over its radius: below 0.1 flat, above 1 a bell.
        dome: f32 [0.05, 1.6] = rng.log(0.2, 1.3);
        /// Radius of the stem over that of the cap.
        stem: f32 [0.05, 0.6] = rng.between(0.12, 0.4);
        /// Warts on the cap.
        warts: u32 [0, 40] = if rng.chance(0.5) { 0 } else { 8 + rng.below(24) };
        /// Waviness of the brim.
        wave: f32 [0, 0.3] = rng.between(0.0, 0.15);
        /// Which group.
        seed: u32 = rng.below(1 << 30);
    }
}

impl Mushroom {
    fn build(&self) -> (Builder, f64) {
        let mut b = Builder::default();
        let mut dice = Dice::new(self.seed);
        mound(&mut b, 0.1 + 0.15 * f64::from(self.count - 1).sqrt(), 0.06, self.seed);
        for i in 0..self.count {
            let size = if i == 0 { 1.0 } else { dice.between(0.35, 0.8) };
            let around = 2.399_963 * f64::from(i) + dice.between(-0.4, 0.4);
            let d = 0.17 * f64::from(i).sqrt();
            let out = DVec3::new(around.sin(), 0.0, around.cos());
            let lean = if i == 0 { 0.05 } else { dice.between(0.1, 0.5) };
            let foot = out * d;
            let top = foot + (DVec3::Y + out * lean) * (0.75 * size);
            let r = 0.5 * f64::from(self.cap) * size;
            let stem = r * f64::from(self.stem);
            let path = spline(&[foot, foot + DVec3::Y * (0.3 * size), top], false, 6);
            let radii: Vec<f64> = (0..path.len()).map(|k| stem * (1.25 - 0.4 * (k as f64 / path.len() as f64).sqrt())).collect();
            b.rod(&path, &radii, 16, true);
            // The cap: up over the brim and back below to the stem.
            let h = r * f64::from(self.dome);
            let outline = [
                (0.5 * stem, -0.02 * r),
                (0.6 * r, -0.03 * r),
                (0.95 * r, -0.12 * r),
                (r, -0.06 * r),
                (0.93 * r, 0.22 * h),
                (0.65 * r, 0.72 * h),
                (0.3 * r, 0.96 * h),
                (0.0, h),
            ];
            let mut turned = vec![DVec2::new(0.0, 0.0)];
            turned.extend(profile(&outline, 5));
            let phase = dice.between(0.0, TAU);
            let wave = f64::from(self.wave);
            let tilt = DQuat::from_rotation_arc(DVec3::Y, (DVec3::Y + out * lean * 1.4).normalize());
            let place = crate::shapes::parts::at(top - DVec3::Y * (0.02 * size), tilt);
            let bend = |p: DVec3| {
                let reach = p.x.hypot(p.z) / r;
                let a = p.x.atan2(p.z);
                place.transform_point3(p + DVec3::Y * (wave * r * reach.powi(3) * (5.0 * a + phase).sin()))
            };
            b.bent(bend, |p| p.lathe(&turned, if self.count > 5 { 24 } else { 40 }));
            for k in 0..self.warts.min(70 / self.count) {
                let (a, s) =
                    (2.399_963 * f64::from(k), ((f64::from(k) + 0.5) / f64::from(self.warts.min(70 / self.count))).sqrt() * 0.85);
                let y = h * (1.0 - s * s).max(0.0).powf(0.62);
                let q = DVec3::new(r * s * a.sin(), y * 0.98, r * s * a.cos());
                let w = 0.05 * r * dice.between(0.6, 1.5);
                b.ellipsoid(bend(q), DVec3::new(w, 0.7 * w, w), 3);
            }
        }
        (b, 50.0)
    }
}
