//! Trees and bushes. Trunk, branches, leaves and crowns are closed and run into one another.

use super::plants::{mound, pot};
use crate::draw::Draw;
use crate::family::{choice, family};
use crate::noise;
use crate::shapes::builder::Builder;
use crate::shapes::parts::{Dice, spline};
use glam::{DAffine3, DQuat, DVec2, DVec3};
use std::f64::consts::TAU;

choice! {
    /// The kind of a tree.
    Habit {
        /// Clouds of foliage on branches.
        Clouds,
        /// Single leaves on twigs.
        Leafy,
        /// Skirts of a conifer.
        Conifer,
        /// A palm.
        Palm,
        /// Without leaves.
        Bare,
        /// Clipped into balls or cones.
        Topiary,
        /// A bush of leaves from the ground.
        Bush,
    }
}

family! {
    /// A tree or bush on a foot of earth or in a pot.
    shape Tree("plant", Upright) |rng| {
        /// The kind.
        habit: Habit = Habit::draw(rng);
        /// Angle between a branch and what it grows from, degrees.
        spread: f32 [10, 75] = rng.between(22.0, 50.0);
        /// Height of the trunk below the crown, as a share.
        trunk: f32 [0.1, 0.7] = rng.between(0.2, 0.5);
        /// Radius of the trunk over the height.
        thick: f32 [0.015, 0.1] = rng.between(0.03, 0.06);
        /// Width of the crown over the height.
        crown: f32 [0.15, 1] = rng.between(0.3, 0.7);
        /// Amount of foliage.
        leaves: f32 [0.1, 1] = rng.between(0.4, 1.0);
        /// In a pot.
        potted: bool = rng.chance(0.25);
        /// Which tree.
        seed: u32 = rng.below(1 << 30);
    }
}

/// A ragged ball of foliage.
fn cloud(b: &mut Builder, centre: DVec3, half: DVec3, n: usize, seed: u32) {
    b.part(DAffine3::from_translation(centre), |p| {
        p.ball(n, |d| d * half * (1.0 + 0.35 * noise::fractal(d * 2.2 + centre * 3.0, 3, seed)));
    });
}

/// A single leaf from `at` towards `axis`.
fn leaf(b: &mut Builder, at: DVec3, axis: DVec3, length: f64, roll: f64) {
    let side = DQuat::from_axis_angle(axis, roll) * axis.any_orthonormal_vector();
    let normal = axis.cross(side);
    let width = |s: f64| 0.32 * length * (s * (1.0 - s) * 4.0).max(0.0).powf(0.7);
    b.leaf(4, 2, 0.05 * length, width, |s, across, up| {
        at + axis * (s * length) + side * across + normal * (up - 0.2 * length * s * s)
    });
}

impl Tree {
    fn build(&self) -> (Builder, f64) {
        let mut b = Builder::default();
        let mut dice = Dice::new(self.seed);
        let ground = if self.potted {
            pot(&mut b, 0.15, 0.2);
            0.17
        } else {
            mound(&mut b, 0.1 + 3.0 * f64::from(self.thick), 0.035, self.seed);
            0.0
        };
        let base = DVec3::Y * ground;
        let (thick, trunk, crown) = (f64::from(self.thick), f64::from(self.trunk), f64::from(self.crown));
        match self.habit {
            Habit::Conifer => {
                b.bar(base, base + DVec3::Y * 0.97, [thick, 0.2 * thick], 14);
                let skirts = 4 + (5.0 * f64::from(self.leaves)) as usize;
                for i in 0..skirts {
                    let s = i as f64 / skirts as f64;
                    let r = 0.5 * crown * (1.0 - s).powf(0.85) + 0.02;
                    let y = ground + 0.6 * trunk + (1.0 - 0.6 * trunk) * s;
                    let tall = 1.7 * (1.0 - 0.6 * trunk) / skirts as f64;
                    let turn = dice.between(0.0, TAU);
                    let spikes = 9.0 + (14.0 * (1.0 - s)).round();
                    let ragged = |p: DVec3| {
                        let reach = (p.x.hypot(p.z) / r).min(1.0);
                        let wave = (spikes * p.x.atan2(p.z) + turn).cos();
                        let scale = 1.0 + 0.16 * wave * reach;
                        DVec3::new(p.x * scale, y + p.y - 0.25 * tall * reach * reach * (1.0 + 0.5 * wave), p.z * scale)
                    };
                    let outline = [(0.0, 0.12), (0.5, 0.1), (1.0, 0.0), (0.96, 0.06), (0.6, 0.35), (0.28, 0.7), (0.0, 1.0)];
                    let outline: Vec<DVec2> = outline.iter().map(|&(x, v)| DVec2::new(x * r, v * tall)).collect();
                    b.bent(ragged, |p| p.lathe(&outline, 72));
                }
            }
            Habit::Palm => {
                let lean = DVec3::new(dice.between(-0.15, 0.15), 0.0, dice.between(-0.15, 0.15));
                let top = base + DVec3::Y * 0.75 + lean;
                let path = spline(&[base, base.lerp(top, 0.5) - lean * 0.4, top], false, 16);
                let n = path.len();
                // Rings of old leaves along the trunk.
                let radii: Vec<f64> =
                    (0..n).map(|i| 0.8 * thick * (1.15 - 0.5 * i as f64 / n as f64) * (1.0 + 0.12 * (i % 2) as f64)).collect();
                b.rod(&path, &radii, 14, false);
                b.ellipsoid(top, DVec3::splat(0.9 * thick), 6);
                let fronds = 7 + (9.0 * f64::from(self.leaves)) as u32;
                for i in 0..fronds {
                    let a = 2.399_963 * f64::from(i);
                    let out = DVec3::new(a.sin(), 0.0, a.cos());
                    let (reach, rise) = (0.75 * crown * dice.between(0.85, 1.1), dice.between(0.05, 0.9));
                    let line = |s: f64| {
                        top + out * (reach * s * (1.0 - 0.2 * s)) + DVec3::Y * (reach * (rise * s - (0.75 + 0.4 * rise) * s * s))
                    };
                    let along = |s: f64| (line(s + 0.03) - line(s - 0.03)).normalize_or(out);
                    let side = DVec3::Y.cross(out);
                    b.leaf(
                        12,
                        2,
                        0.015,
                        |s| 0.02 * (1.0 - s).sqrt() + 0.006,
                        |s, across, up| line(s) + side * across + along(s).cross(side) * up,
                    );
                    for k in 1..10 {
                        let s = 0.12 + 0.085 * f64::from(k);
                        for sign in [-1.0, 1.0] {
                            let axis = (side * sign + along(s) * 0.7 - DVec3::Y * 0.35).normalize_or(side);
                            leaf(&mut b, line(s), axis, 0.3 * reach * (1.05 - s).sqrt() * (2.5 * s).min(1.0), 0.0);
                        }
                    }
                }
            }
            Habit::Topiary => {
                b.bar(base, base + DVec3::Y * 0.9, [thick, 0.8 * thick], 14);
                let balls = 1 + (3.0 * f64::from(self.leaves)) as usize % 3;
                let cone = dice.chance(0.4);
                for i in 0..balls {
                    let s = (i as f64 + 0.5) / balls as f64;
                    let y = ground + trunk + (1.0 - trunk) * s;
                    let r = (0.5 * crown).min(0.62 * (1.0 - trunk) / balls as f64) * (1.0 - 0.25 * i as f64 / balls as f64);
                    let rough = |d: DVec3| 1.0 + 0.05 * noise::fractal(d * 7.0, 2, self.seed);
                    b.part(DAffine3::from_translation(DVec3::Y * y), |p| {
                        p.ball(if balls == 1 { 30 } else { 20 }, |d| {
                            let taper = if cone { 1.0 - 0.62 * (0.5 + 0.5 * d.y) } else { 1.0 };
                            let tall = if cone { 0.55 * (1.0 - trunk) / balls as f64 } else { r };
                            DVec3::new(d.x * r * taper, d.y * tall, d.z * r * taper) * rough(d)
                        });
                    });
                }
            }
            Habit::Clouds | Habit::Leafy | Habit::Bare | Habit::Bush => self.branches(&mut b, &mut dice, base),
        }
        (b, 50.0)
    }

    /// Trunk and branches, each forking `levels` times, with what its habit carries at the tips.
    fn branches(&self, b: &mut Builder, dice: &mut Dice, base: DVec3) {
        let spread = f64::from(self.spread).to_radians();
        let bush = self.habit == Habit::Bush;
        let levels = match self.habit {
            Habit::Bare => 5,
            Habit::Clouds => 2,
            _ => 3,
        };
        let length = if bush { 0.3 } else { f64::from(self.trunk).max(0.2) };
        let mut stems = Vec::new();
        let stalks = if bush { 6 } else { 1 };
        for i in 0..stalks {
            let a = 2.399_963 * f64::from(i) + dice.between(0.0, 0.6);
            let lean = if bush { DVec3::new(a.sin(), 0.0, a.cos()) * dice.between(0.2, 0.9) } else { DVec3::ZERO };
            let thick = f64::from(self.thick) * if bush { 0.4 } else { 1.0 };
            stems.push((base + lean * 0.06, (DVec3::Y + lean).normalize(), length, thick, 0));
        }
        let mut budget = 25_000;
        let mut tips: Vec<(DVec3, DVec3, f64)> = Vec::new();
        while let Some((from, axis, length, radius, level)) = stems.pop() {
            let sides = [14, 10, 8, 6, 5, 5][level.min(5)];
            let cost = 2 * sides * 8;
            if budget < cost {
                break;
            }
            budget -= cost;
            let wobble = dice.direction() * 0.22;
            let (mut path, mut p, mut t) = (Vec::new(), from, axis);
            for _ in 0..=4 {
                path.push(p);
                p += t * length / 4.0;
                t = (t + (DVec3::Y * 0.15 + wobble) * 0.3).normalize_or(DVec3::Y);
            }
            let flare = if level == 0 && !bush { 1.5 } else { 1.0 };
            let radii: Vec<f64> = [flare, 1.08, 0.95, 0.85, 0.75].iter().map(|s| radius * s).collect();
            b.rod(&path, &radii, sides, true);
            if level >= 1 {
                tips.push((path[4], t, length));
                tips.push((path[2], t, length));
            }
            if level + 1 > levels {
                continue;
            }
            let children = if level == 0 && !bush { 3 + dice.below(2) } else { 2 + usize::from(dice.chance(0.3)) };
            let start = dice.between(0.0, TAU);
            for c in 0..children {
                let a = start + TAU * (c as f64 + dice.between(-0.2, 0.2)) / children as f64;
                let open = spread * dice.between(0.6, 1.2);
                let side = t.any_orthonormal_vector();
                let side = side * a.cos() + t.cross(side) * a.sin();
                let axis = (t * open.cos() + side * open.sin() + DVec3::Y * 0.12).normalize_or(t);
                let axis = DVec3::new(axis.x, axis.y.max(0.05), axis.z).normalize_or(DVec3::Y);
                let at = if c == 0 { path[4] } else { path[3].lerp(path[4], dice.between(0.0, 0.9)) };
                let grown = if level == 0 { (0.55 * f64::from(self.crown)).max(0.2) } else { length * dice.between(0.65, 0.85) };
                stems.insert(0, (at, axis, grown, radius * 0.66, level + 1));
            }
        }
        let amount = f64::from(self.leaves);
        match self.habit {
            Habit::Clouds => {
                for (k, &(at, axis, length)) in tips.iter().enumerate() {
                    if budget < 900 || (k % 2 == 1 && dice.chance(1.0 - amount)) {
                        continue;
                    }
                    budget -= 900;
                    let r = length * dice.between(0.5, 0.8);
                    cloud(b, at + axis * (0.3 * r), DVec3::new(r, 0.75 * r, r), 8, self.seed);
                }
            }
            Habit::Leafy | Habit::Bush => {
                let each = ((amount * 0.9 * budget as f64 / (32.0 * tips.len().max(1) as f64)) as usize).clamp(3, 14);
                for &(at, axis, length) in &tips {
                    for _ in 0..each {
                        if budget < 32 {
                            return;
                        }
                        budget -= 32;
                        let from = at - axis * (dice.between(0.0, 0.5) * length);
                        let out = (dice.direction() + axis * 0.5 + DVec3::Y * 0.15).normalize_or(DVec3::Y);
                        leaf(b, from, out, (0.28 * length).clamp(0.05, 0.12) * dice.between(0.8, 1.3), dice.between(0.0, TAU));
                    }
                }
            }
            _ => (),
        }
    }
}
