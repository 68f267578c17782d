//! Solids of functions: constructive geometry, metaballs and minimal surfaces.

use crate::draw::Draw;
use crate::family::{choice, family};
use crate::shapes::builder::Builder;
use crate::shapes::parts::Dice;
use crate::shapes::polygonise::polygonise;
use glam::{DQuat, DVec2, DVec3};
use std::f64::consts::TAU;

/// Smooth minimum (polynomial, of width `k`): the union of two distances with a fillet.
pub(super) fn smooth_min(a: f64, b: f64, k: f64) -> f64 {
    if k <= 0.0 {
        return a.min(b);
    }
    let h = (k - (a - b).abs()).max(0.0) / k;
    a.min(b) - 0.25 * h * h * k
}

/// Distance to a box of these half edges, rounded by `r`.
pub(super) fn box_distance(p: DVec3, half: DVec3, r: f64) -> f64 {
    let q = p.abs() - half + DVec3::splat(r);
    q.max(DVec3::ZERO).length() + q.max_element().min(0.0) - r
}

/// Distance to a segment.
pub(super) fn segment_distance(p: DVec3, a: DVec3, b: DVec3) -> f64 {
    let (pa, ba) = (p - a, b - a);
    (pa - ba * (pa.dot(ba) / ba.length_squared().max(1e-12)).clamp(0.0, 1.0)).length()
}

enum Primitive {
    Ball,
    Box(f64),
    Cylinder,
    Torus,
    Capsule,
    Hexagon,
    Cone,
}

struct Operand {
    primitive: Primitive,
    turn: DQuat,
    centre: DVec3,
    half: DVec3,
    /// 0 = joined, 1 = cut away, 2 = kept only inside.
    operation: u8,
}

impl Operand {
    fn random(dice: &mut Dice, scale: f64) -> Self {
        let primitive = match dice.below(7) {
            0 => Primitive::Ball,
            1 => Primitive::Box(if dice.chance(0.5) { 0.0 } else { dice.between(0.02, 0.1) * scale }),
            2 => Primitive::Cylinder,
            3 => Primitive::Torus,
            4 => Primitive::Capsule,
            5 => Primitive::Hexagon,
            _ => Primitive::Cone,
        };
        // Half of the parts line up, as made things do.
        let turn = if dice.chance(0.5) {
            [DQuat::IDENTITY, DQuat::from_rotation_x(TAU / 4.0), DQuat::from_rotation_z(TAU / 4.0)][dice.below(3)]
        } else {
            dice.turn()
        };
        let half = scale * DVec3::new(dice.between(0.5, 1.0), dice.between(0.5, 1.0), dice.between(0.5, 1.0));
        Self { primitive, turn, centre: DVec3::ZERO, half, operation: 0 }
    }

    fn distance(&self, p: DVec3) -> f64 {
        let p = self.turn.inverse() * (p - self.centre);
        let h = self.half;
        let across = DVec2::new(p.x, p.z).length();
        let cylinder = |d: f64| {
            let y = p.y.abs() - h.y;
            d.max(0.0).hypot(y.max(0.0)) + d.max(y).min(0.0)
        };
        match self.primitive {
            Primitive::Ball => p.length() - h.x,
            Primitive::Box(r) => box_distance(p, h, r),
            Primitive::Cylinder => cylinder(across - h.x),
            Primitive::Torus => (across - 0.75 * h.x).hypot(p.y) - 0.32 * h.y,
            Primitive::Capsule => segment_distance(p, DVec3::new(0.0, -h.y, 0.0), DVec3::new(0.0, h.y, 0.0)) - 0.5 * h.x,
            Primitive::Hexagon => cylinder(p.x.abs().max(0.5 * p.x.abs() + 0.866_025_403_784_438_6 * p.z.abs()) - h.x),
            Primitive::Cone => {
                // Slope of the side; the distance is short of the true one near the tip, never of the wrong sign.
                let (sin, cos) = h.x.atan2(2.0 * h.y).sin_cos();
                (across * cos + (p.y - h.y) * sin).max(-h.y - p.y)
            }
        }
    }
}

family! {
    /// Constructive solid geometry: primitives joined, cut away and intersected, sharp or with fillets.
    shape Csg("mechanical", Any) |rng| {
        /// Operations after the first body.
        parts: u32 [1, 12] = 2 + rng.below(5);
        /// Share of operations that cut away.
        cuts: f32 [0, 1] = rng.between(0.2, 0.7);
        /// Radius of fillets as a share of the body; 0 = sharp.
        fillet: f32 [0, 0.5] = if rng.chance(0.5) { 0.0 } else { rng.between(0.03, 0.25) };
        /// Which composition.
        seed: u32 = rng.below(1 << 30);
    }
}

impl Csg {
    fn build(&self) -> (Builder, f64) {
        let mut dice = Dice::new(self.seed);
        let mut base = Operand::random(&mut dice, 0.62);
        // The first body is a bulky one.
        if matches!(base.primitive, Primitive::Torus | Primitive::Capsule | Primitive::Cone) {
            base.primitive = if dice.chance(0.5) { Primitive::Box(0.03) } else { Primitive::Cylinder };
        }
        let mut operands = vec![base];
        for index in 0..self.parts {
            let scale = dice.between(0.22, 0.5);
            let mut next = Operand::random(&mut dice, scale);
            next.centre = dice.direction() * dice.between(0.25, 0.6);
            next.operation = u8::from(dice.chance(f64::from(self.cuts)));
            // A through hole along an axis now and then; an intersection at most once.
            if next.operation == 1 && dice.chance(0.4) {
                next.centre *= 0.3;
                next.half.y = 1.2;
                next.half.x *= 0.7;
                next.primitive = if dice.chance(0.5) { Primitive::Cylinder } else { Primitive::Hexagon };
            }
            if index == 1 && dice.chance(0.25) {
                next.operation = 2;
                next.centre = DVec3::ZERO;
                next.half = DVec3::splat(dice.between(0.62, 0.8));
                next.primitive = if dice.chance(0.6) { Primitive::Ball } else { Primitive::Cylinder };
            }
            operands.push(next);
        }
        let k = f64::from(self.fillet);
        let field = |p: DVec3| {
            operands.iter().skip(1).fold(operands[0].distance(p), |d, o| match o.operation {
                0 => smooth_min(d, o.distance(p), k),
                1 => -smooth_min(-d, o.distance(p), k),
                _ => -smooth_min(-d, -o.distance(p), k),
            })
        };
        let mut b = Builder::default();
        polygonise(&mut b, DVec3::splat(-1.45), DVec3::splat(1.45), 56, true, field);
        b.keep_largest();
        (b, 32.0)
    }
}

family! {
    /// Metaballs: balls along wandering arms that melt into one another.
    shape Blobs("organic", Any) |rng| {
        /// Balls.
        count: u32 [2, 32] = 4 + rng.below(12);
        /// How far neighbours melt together, as a share of their size.
        melt: f32 [0.05, 1] = rng.between(0.2, 0.8);
        /// Largest ball over the smallest.
        contrast: f32 [1, 5] = rng.between(1.2, 3.5);
        /// How far the next ball is from the last, in radii of both.
        spacing: f32 [0.3, 1] = rng.between(0.5, 0.95);
        /// Which arrangement.
        seed: u32 = rng.below(1 << 30);
    }
}

impl Blobs {
    fn build(&self) -> (Builder, f64) {
        let mut dice = Dice::new(self.seed);
        let mut balls = vec![(DVec3::ZERO, 1.0f64)];
        for _ in 1..self.count {
            let (from, radius) = balls[dice.below(balls.len())];
            let next = f64::from(self.contrast).powf(-dice.between(0.0, 1.0));
            balls.push((from + dice.direction() * (radius + next) * f64::from(self.spacing), next));
        }
        let k = f64::from(self.melt);
        let field = |p: DVec3| balls.iter().fold(f64::INFINITY, |d, &(c, r)| smooth_min(d, p.distance(c) - r, k));
        let margin = DVec3::splat(0.4);
        let low = balls.iter().fold(DVec3::INFINITY, |l, &(c, r)| l.min(c - DVec3::splat(r))) - margin;
        let high = balls.iter().fold(DVec3::NEG_INFINITY, |h, &(c, r)| h.max(c + DVec3::splat(r))) + margin;
        let mut b = Builder::default();
        polygonise(&mut b, low, high, 48, false, field);
        b.keep_largest();
        (b, 75.0)
    }
}

choice! {
    /// A triply periodic surface.
    Minimal {
        /// Schoen's gyroid.
        Gyroid,
        /// Schwarz' primitive surface.
        Primitive,
        /// Schwarz' diamond surface.
        Diamond,
        /// Neovius' surface.
        Neovius,
    }
}

choice! {
    /// What a minimal surface is cut out of.
    Cut {
        /// A ball.
        Ball,
        /// A cube.
        Cube,
        /// An upright cylinder.
        Cylinder,
    }
}

family! {
    /// A sheet or one half of space along a triply periodic minimal surface, cut to a simple body.
    shape Gyroid("abstract", Any) |rng| {
        /// The surface.
        surface: Minimal = Minimal::draw(rng);
        /// The body it is cut to.
        cut: Cut = Cut::draw(rng);
        /// Periods across the body.
        periods: f32 [0.7, 3] = rng.between(1.0, 2.2);
        /// Thickness of the sheet as a share of a period; 0 = one half of space is solid.
        sheet: f32 [0, 0.3] = if rng.chance(0.4) { 0.0 } else { rng.between(0.12, 0.25) };
        /// Shift of the surface within its period, along the diagonal.
        phase: f32 [0, 1] = rng.between(0.0, 1.0);
        /// Shift of the level: thinner or thicker halves.
        level: f32 [-0.5, 0.5] = rng.between(-0.35, 0.35);
    }
}

impl Gyroid {
    fn build(&self) -> (Builder, f64) {
        let frequency = TAU * f64::from(self.periods) * 0.5;
        let shift = DVec3::splat(TAU * f64::from(self.phase));
        let (sheet, level) = (f64::from(self.sheet), f64::from(self.level));
        let field = |p: DVec3| {
            let q = p * frequency + shift;
            let (s, c) = (DVec3::new(q.x.sin(), q.y.sin(), q.z.sin()), DVec3::new(q.x.cos(), q.y.cos(), q.z.cos()));
            // Divided by about the gradient's length at the surface, so that values are distances.
            let value = match self.surface {
                Minimal::Gyroid => (s.x * c.y + s.y * c.z + s.z * c.x) / 1.5,
                Minimal::Primitive => (c.x + c.y + c.z) / 1.5,
                Minimal::Diamond => s.x * s.y * s.z + s.x * c.y * c.z + c.x * s.y * c.z + c.x * c.y * s.z,
                Minimal::Neovius => (3.0 * (c.x + c.y + c.z) + 4.0 * c.x * c.y * c.z) / 5.0,
            };
            let surface =
                if sheet > 0.0 { (value.abs() - 0.5 * TAU * sheet).min(value.abs()) } else { value - level } / frequency;
            let body = match self.cut {
                Cut::Ball => p.length() - 1.0,
                Cut::Cube => box_distance(p, DVec3::splat(0.85), 0.0),
                Cut::Cylinder => (p.x.hypot(p.z) - 0.8).max(p.y.abs() - 0.95),
            };
            surface.max(body)
        };
        // The area, and with it the count of triangles, grows with the periods and the square of the cells: about as many as
        // allowed.
        let mut cells = 48.0;
        loop {
            let mut b = Builder::default();
            polygonise(&mut b, DVec3::splat(-1.1), DVec3::splat(1.1), cells as usize, true, field);
            let count = b.triangles() as f64;
            if count <= 28_000.0 || cells < 20.0 {
                b.keep_largest();
                return (b, 40.0);
            }
            cells = (cells * (26_000.0 / count).sqrt()).floor();
        }
    }
}
