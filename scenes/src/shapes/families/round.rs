//! Round bodies: supertoroids and surfaces displaced by noise.

use crate::draw::Draw;
use crate::family::{choice, family};
use crate::noise;
use crate::shapes::builder::Builder;
use crate::shapes::parts::Dice;
use glam::{DVec2, DVec3};
use std::f64::consts::{PI, TAU};

/// A superellipse with exponent 2/n through angle `a`, n = 1 a circle.
pub(super) fn superellipse(a: f64, n: f64) -> DVec2 {
    let (sin, cos) = a.sin_cos();
    // Polar form: one division finds the curve, and points stay spread out for every exponent.
    let (x, y) = (cos, sin);
    DVec2::new(x, y) / (x.abs().powf(2.0 / n) + y.abs().powf(2.0 / n)).powf(0.5 * n)
}

family! {
    /// A supertoroid (Barr 1981): a ring whose outline and section are superellipses, lying flat, wavy if asked.
    shape Supertoroid("round", Any) |rng| {
        /// Half width of the section as a share of the ring's radius.
        tube: f32 [0.05, 0.7] = rng.between(0.2, 0.6);
        /// Exponent of the ring's outline: box-like below 1, round at 1, pinched above.
        around: f32 [0.2, 2.5] = rng.log(0.25, 2.0);
        /// Exponent of the section.
        section: f32 [0.2, 2.5] = rng.log(0.25, 2.0);
        /// Height of the section over its width.
        height: f32 [0.2, 4] = rng.log(0.4, 2.5);
        /// Full turns of the section on its way around times four.
        twist: u32 [0, 12] = if rng.chance(0.5) { 0 } else { 1 + rng.below(6) };
    }
}

impl Supertoroid {
    fn build(&self) -> (Builder, f64) {
        let mut b = Builder::default();
        let (tube, around, section) = (f64::from(self.tube), f64::from(self.around), f64::from(self.section));
        let height = f64::from(self.height);
        let (nu, nv) = (112, 48);
        b.cells(nu, nv, [4.0, 1.0], |i, j| {
            let (u, v) = (TAU * (i % nu) as f64 / nu as f64, TAU * (j % nv) as f64 / nv as f64);
            let mut s = superellipse(-v, section);
            s.y *= if self.twist == 0 { height } else { 1.0 };
            // A square-like section is the same after a quarter turn.
            let s = DVec2::from_angle(u * f64::from(self.twist) / 4.0).rotate(s) * tube;
            let ring = superellipse(u, around);
            let r = 1.0 + s.x;
            DVec3::new(ring.x * r, s.y, ring.y * r)
        });
        (b, 40.0)
    }
}

choice! {
    /// The body under the displacement.
    Base {
        /// A ball.
        Ball,
        /// A ring.
        Ring,
        /// A rounded cylinder.
        Barrel,
        /// A rounded cube.
        Cube,
        /// An egg, thick below.
        Egg,
    }
}

choice! {
    /// The kind of displacement.
    Relief {
        /// Sharp crests between valleys.
        Ridged,
        /// Round bumps between creases.
        Billow,
        /// Cobbles of a cellular (Worley) pattern.
        Cells,
        /// Pits of a cellular pattern.
        Pits,
        /// Smooth fractal noise.
        Fractal,
        /// Waves about the upright axis.
        Waves,
        /// Flat terraces of smooth noise.
        Terraces,
    }
}

/// A random point of the unit cell at `corner`, away from its border.
fn jitter(corner: DVec3, seed: u32) -> DVec3 {
    let mut h = seed ^ 0x9e37_79b9;
    for c in corner.to_array() {
        h = (h ^ c as i32 as u32).wrapping_mul(0x85eb_ca6b);
        h = (h ^ h >> 13).wrapping_mul(0xc2b2_ae35);
        h ^= h >> 16;
    }
    DVec3::from([0, 10, 20].map(|shift| 0.1 + 0.8 * f64::from(h.rotate_right(shift) & 1023) / 1023.0))
}

/// Distances from `p` to the nearest and second nearest of one random point in each unit cell (Worley 1996).
pub(super) fn cellular(p: DVec3, seed: u32) -> [f64; 2] {
    let cell = p.floor();
    let mut nearest = [9.0f64; 2];
    for i in 0..27i32 {
        let corner = cell + DVec3::new(f64::from(i % 3 - 1), f64::from(i / 3 % 3 - 1), f64::from(i / 9 - 1));
        let d = p.distance(corner + jitter(corner, seed));
        if d < nearest[0] {
            nearest = [d, nearest[0]];
        } else if d < nearest[1] {
            nearest[1] = d;
        }
    }
    nearest
}

/// Height of a relief at `p`, about -1..=1.
pub(super) fn relief(kind: Relief, p: DVec3, seed: u32) -> f64 {
    match kind {
        Relief::Ridged => 1.0 - 2.6 * noise::fractal(p, 3, seed).abs(),
        Relief::Billow => 2.6 * noise::fractal(p, 3, seed).abs() - 0.6,
        Relief::Cells => {
            let [a, b] = cellular(p, seed);
            (1.6 * (b - a)).min(1.0).powf(0.6) * 2.0 - 1.0
        }
        Relief::Pits => 2.0 * (cellular(p, seed)[0] * 1.6).min(1.0).powi(2) - 1.0,
        Relief::Fractal => 1.4 * noise::fractal(p, 4, seed),
        Relief::Waves => (4.0 * p.y + 1.3 * noise::gradient(p * 0.6, seed)).sin(),
        Relief::Terraces => {
            let h = 3.0 * noise::fractal(p * 0.7, 2, seed);
            let step = h - h.floor();
            (h.floor() + (step * step * step * (step * (6.0 * step - 15.0) + 10.0)).powi(2)) / 2.0
        }
    }
}

family! {
    /// A simple body displaced along its normals by one of several kinds of seeded noise.
    shape Displaced("organic", Any) |rng| {
        /// The body.
        base: Base = Base::draw(rng);
        /// The noise.
        relief: Relief = Relief::draw(rng);
        /// Displacement as a share of the body's radius.
        depth: f32 [0, 0.35] = rng.between(0.05, 0.22);
        /// Features across the body's radius.
        frequency: f32 [0.3, 8] = rng.log(1.2, 4.0);
        /// Height over width.
        stretch: f32 [0.3, 3] = rng.log(0.6, 1.6);
        /// Which pattern.
        seed: u32 = rng.below(1 << 30);
    }
}

impl Displaced {
    fn build(&self) -> (Builder, f64) {
        let mut b = Builder::default();
        let offset = Dice::new(self.seed).direction() * 3.0;
        let (depth, frequency, stretch) = (f64::from(self.depth), f64::from(self.frequency), f64::from(self.stretch));
        let lift = |p: DVec3, normal: DVec3| {
            let h = relief(self.relief, p * frequency + offset, self.seed) * depth;
            let q = p + normal * h;
            DVec3::new(q.x, q.y * stretch, q.z)
        };
        if self.base == Base::Ring {
            let (nu, nv, tube) = (144, 56, 0.42);
            b.cells(nu, nv, [4.0, 1.0], |i, j| {
                let (u, v) = (TAU * (i % nu) as f64 / nu as f64, TAU * (j % nv) as f64 / nv as f64);
                let out = DVec3::new(u.sin(), 0.0, u.cos());
                let n = out * v.cos() + DVec3::Y * v.sin();
                lift(out + tube * n, n * (tube / 0.7))
            });
        } else {
            b.ball(34, |d| {
                let p = match self.base {
                    Base::Barrel => d / (DVec2::new(d.x, d.z).length().powi(8) + d.y.abs().powi(8)).powf(1.0 / 8.0),
                    Base::Cube => d / (d.x.powi(8) + d.y.powi(8) + d.z.powi(8)).powf(1.0 / 8.0),
                    Base::Egg => d * (1.0 - 0.25 * d.y + 0.06 * (PI * d.y).cos()),
                    _ => d,
                };
                lift(p, d)
            });
        }
        (b, 55.0)
    }
}
