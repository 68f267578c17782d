//! From the sea: shells and corals.

use crate::draw::Draw;
use crate::family::{choice, family};
use crate::shapes::builder::Builder;
use crate::shapes::parts::Dice;
use glam::{DQuat, DVec2, DVec3};
use std::f64::consts::TAU;

family! {
    /// A sea shell: a tube that grows by the same share every turn about an upright axis (logarithmic spiral, Moseley 1838).
    /// Whorls run into one another.
    shape Seashell("organic", Any) |rng| {
        /// Turns.
        turns: f32 [1, 9] = rng.between(3.0, 6.5);
        /// Size of a whorl over that of the one before.
        growth: f32 [1.1, 3.5] = rng.between(1.35, 2.4);
        /// Height of the spire over the width of a whorl: 0 = flat as an ammonite; no higher than whorls still touch.
        spire: f32 [0, 5] = if rng.chance(0.3) { rng.between(0.0, 0.3) } else { rng.between(0.8, 3.2) };
        /// Radius of the tube as a share of its distance from the axis.
        tube: f32 [0.3, 1.1] = rng.between(0.55, 0.95);
        /// Height over width of the opening.
        oval: f32 [0.5, 2.5] = rng.between(0.7, 1.8);
        /// Ribs a turn.
        ribs: u32 [0, 40] = if rng.chance(0.4) { 0 } else { 6 + rng.below(22) };
        /// Depth of ribs as a share of the tube.
        depth: f32 [0, 0.35] = rng.between(0.03, 0.2);
        /// Ridges along the tube.
        ridges: u32 [0, 16] = if rng.chance(0.5) { 0 } else { 3 + rng.below(9) };
    }
}

impl Seashell {
    fn build(&self) -> (Builder, f64) {
        let turns = f64::from(self.turns);
        let rate = f64::from(self.growth).ln() / TAU;
        let steps = ((turns * 56.0) as usize).clamp(32, 300);
        let (tube, oval) = (f64::from(self.tube), f64::from(self.oval));
        // Neighbouring whorls, of sizes 1 and 1 / growth, touch up to this height.
        let growth = f64::from(self.growth);
        let spire = f64::from(self.spire).min(0.9 * oval * tube * (growth + 1.0) / (growth - 1.0));
        let (ribs, ridges, depth) = (f64::from(self.ribs), f64::from(self.ridges), f64::from(self.depth));
        let sides = 36;
        let last = TAU * turns;
        let ring = |i: usize, k: usize| {
            let angle = last * i as f64 / steps as f64;
            // The largest whorl has radius 1.
            let scale = ((angle - last) * rate).exp();
            let a = TAU * (k % sides) as f64 / sides as f64;
            let rib = depth * (0.5 + 0.5 * (ribs * angle).cos()).powi(2) * if self.ribs > 0 { 1.0 } else { 0.0 };
            let ridge = if self.ridges > 0 { 0.4 * depth * (ridges * a).cos() } else { 0.0 };
            let r = tube * (1.0 + rib + ridge);
            // From the rim's outermost point upwards.
            let (across, up) = (1.0 + r * a.cos(), oval * r * a.sin() - spire);
            scale * DVec3::new(across * angle.sin(), up, across * angle.cos())
        };
        let mut b = Builder::default();
        let tip = |i: usize| (0..sides).map(|k| ring(i, k)).sum::<DVec3>() / sides as f64;
        b.cells(steps, sides, [6.0 * turns, 2.0], ring);
        // The tip is closed, and the opening is a bowl: a smaller ring pulled in along the tube, then its middle.
        let point = |k: usize| (ring(0, k), DVec2::ZERO);
        for k in 0..sides {
            b.triangle([(tip(0), DVec2::ZERO), point(k), point(k + 1)]);
        }
        let (mouth, back) = (tip(steps), tip(steps - 4));
        let inward = (back - mouth) * 1.2;
        let lip = |level: usize, k: usize| {
            let rim = ring(steps, k);
            let (shrink, pull) = [(1.0, 0.0), (0.86, 0.05), (0.7, 0.5), (0.4, 0.9), (0.0, 1.0)][level];
            mouth + (rim - mouth) * shrink + inward * pull
        };
        b.cells(4, sides, [1.0, 2.0], lip);
        (b, 50.0)
    }
}

choice! {
    /// How a coral grows.
    Growth {
        /// Branches on all sides.
        Bush,
        /// Branches in one plane, a sea fan.
        Fan,
        /// Thick fingers upwards.
        Fingers,
        /// Thin tangled twigs.
        Twigs,
    }
}

family! {
    /// A branching coral on a foot. Branches are closed and run into one another.
    shape Coral("organic", Upright) |rng| {
        /// How it grows.
        growth: Growth = Growth::draw(rng);
        /// Forkings from foot to tip.
        levels: u32 [1, 5] = 3 + rng.below(2);
        /// Angle between a branch and what it grows from, degrees.
        spread: f32 [5, 80] = rng.between(22.0, 48.0);
        /// Length of a branch over that of what it grows from.
        shrink: f32 [0.5, 1] = rng.between(0.7, 0.92);
        /// Radius over length of the first branch.
        thickness: f32 [0.05, 0.5] = rng.between(0.14, 0.3);
        /// Which individual.
        seed: u32 = rng.below(1 << 30);
    }
}

impl Coral {
    fn build(&self) -> (Builder, f64) {
        let mut b = Builder::default();
        let mut dice = Dice::new(self.seed);
        let thickness = f64::from(self.thickness) * if self.growth == Growth::Twigs { 0.6 } else { 1.0 };
        let foot = 2.0 * thickness + 0.12;
        b.ellipsoid(DVec3::ZERO, DVec3::new(foot, 0.16, foot), 10);
        let mut stems = vec![(DVec3::ZERO, DVec3::Y, 1.0f64, thickness, 0u32)];
        if self.growth == Growth::Fingers {
            for _ in 0..4 {
                let lean = dice.direction() * DVec3::new(0.6, 0.0, 0.6);
                stems.push((lean * 0.3, (DVec3::Y + lean).normalize(), dice.between(0.6, 1.0), thickness, 1));
            }
        }
        let mut budget = 26_000;
        while let Some((base, axis, length, radius, level)) = stems.pop() {
            let sides = if level < 2 { 12 } else { 8 };
            let cost = 2 * sides * 10;
            if budget < cost {
                break;
            }
            budget -= cost;
            // A branch bends upwards a little on its way.
            let up = if self.growth == Growth::Fingers { 0.5 } else { 0.25 };
            let wobble =
                dice.direction() * 0.18 * if self.growth == Growth::Fan { DVec3::new(1.0, 1.0, 0.1) } else { DVec3::ONE };
            let mut path = Vec::new();
            let (mut p, mut t) = (base, axis);
            for _ in 0..=4 {
                path.push(p);
                p += t * length / 4.0;
                t = (t + (DVec3::Y * up + wobble) * 0.25).normalize_or(DVec3::Y);
            }
            let tip = path[4];
            let thinner = if self.growth == Growth::Fingers { 0.85 } else { 0.7 };
            let radii: Vec<f64> = (0..=4).map(|i| radius * (1.0 + (thinner - 1.0) * f64::from(i) / 4.0)).collect();
            b.rod(&path, &radii, sides, true);
            if level + 1 >= self.levels {
                continue;
            }
            let children = if self.growth == Growth::Bush { 3 } else { 2 } + usize::from(dice.chance(0.25));
            let start = dice.between(0.0, TAU);
            for c in 0..children {
                let spread = f64::from(self.spread).to_radians() * dice.between(0.7, 1.2);
                let side = if self.growth == Growth::Fan {
                    let sign = if c % 2 == 0 { 1.0 } else { -1.0 };
                    DQuat::from_rotation_z(sign * spread * if c == 2 { 0.1 } else { 1.0 }) * t
                } else {
                    let around = start + TAU * (c as f64 + dice.between(-0.2, 0.2)) / children as f64;
                    let across = t.any_orthonormal_vector();
                    let across = across * around.cos() + t.cross(across) * around.sin();
                    (t * spread.cos() + across * spread.sin()).normalize_or(t)
                };
                // Nothing grows down into the ground.
                let side = DVec3::new(side.x, side.y.max(0.05), side.z).normalize_or(DVec3::Y);
                let from = path[if c == 0 { 4 } else { 3 }].lerp(tip, 0.5);
                let next = length * f64::from(self.shrink) * dice.between(0.75, 1.1);
                stems.insert(0, (from, side, next, radius * thinner * 0.97, level + 1));
            }
        }
        (b, 60.0)
    }
}
