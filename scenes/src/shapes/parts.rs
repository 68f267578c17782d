//! Closed parts that the families are put together from. A part's points are its own, so parts may run into one another.

use super::builder::Builder;
use crate::seed::Seed;
use glam::{DAffine3, DMat3, DQuat, DVec2, DVec3};
use rand::RngExt;
use rand_pcg::Pcg64;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Draws of a body's details, in double precision.
pub(super) struct Dice(Pcg64);

impl Dice {
    pub fn new(seed: u32) -> Self {
        Self(Seed::root(u64::from(seed)).child("shape details", 0).rng())
    }

    /// Uniform in `low..high`.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.random::<f64>()
    }

    /// A whole number in `0..limit`.
    pub fn below(&mut self, limit: usize) -> usize {
        self.0.random_range(0..limit.max(1) as u32) as usize
    }

    pub fn chance(&mut self, probability: f64) -> bool {
        self.0.random::<f64>() < probability
    }

    /// Uniform on the unit sphere.
    pub fn direction(&mut self) -> DVec3 {
        let y = self.between(-1.0, 1.0);
        let (sin, cos) = self.between(0.0, TAU).sin_cos();
        let across = (1.0 - y * y).max(0.0).sqrt();
        DVec3::new(across * sin, y, across * cos)
    }

    /// A uniformly distributed turn.
    pub fn turn(&mut self) -> DQuat {
        let axis = self.direction();
        DQuat::from_rotation_arc(DVec3::Y, axis) * DQuat::from_rotation_y(self.between(0.0, TAU))
    }
}

/// The turn that takes +Y to `axis`.
pub(super) fn along(axis: DVec3) -> DQuat {
    DQuat::from_rotation_arc(DVec3::Y, axis.normalize_or(DVec3::Y))
}

/// Places a part: turned, then moved.
pub(super) fn at(position: DVec3, turn: DQuat) -> DAffine3 {
    DAffine3::from_rotation_translation(turn, position)
}

/// Moves a part.
pub(super) fn shift(x: f64, y: f64, z: f64) -> DAffine3 {
    DAffine3::from_translation(DVec3::new(x, y, z))
}

/// Texture coordinates of `p` on a plane with normal `n`: the two axes across its largest component.
pub(super) fn planar(p: DVec3, n: DVec3) -> DVec2 {
    let a = n.abs();
    if a.y >= a.x && a.y >= a.z {
        DVec2::new(p.x, p.z * n.y.signum())
    } else if a.x >= a.z {
        DVec2::new(-p.z * n.x.signum(), -p.y)
    } else {
        DVec2::new(p.x * n.z.signum(), -p.y)
    }
}

impl Builder {
    /// Adds what `make` makes, placed by `place`, as a part of its own.
    pub fn part(&mut self, place: DAffine3, make: impl FnOnce(&mut Self)) {
        self.bent(|p| place.transform_point3(p), make);
    }

    /// Adds what `make` makes, bent by `bend` (which must not mirror).
    pub fn bent(&mut self, bend: impl Fn(DVec3) -> DVec3, make: impl FnOnce(&mut Self)) {
        let mut part = Self::default();
        make(&mut part);
        part.map_points(bend);
        self.absorb(part);
    }

    /// A convex planar polygon, counter-clockwise from outside, with planar texture coordinates.
    pub fn facet(&mut self, points: &[DVec3]) {
        let n = points.len();
        if n < 3 {
            return;
        }
        let normal = (1..n - 1).map(|i| (points[i] - points[0]).cross(points[i + 1] - points[0])).sum::<DVec3>();
        let corner = |i: usize| (points[i], planar(points[i], normal));
        if n == 4 {
            return self.quad([corner(0), corner(1), corner(2), corner(3)]);
        }
        for i in 1..n - 1 {
            self.triangle([corner(0), corner(i), corner(i + 1)]);
        }
    }

    /// A polygon as a fan about its middle, for outlines that are not quite planar or convex.
    pub fn fan(&mut self, points: &[DVec3]) {
        let n = points.len();
        let middle = points.iter().sum::<DVec3>() / n.max(1) as f64;
        let normal = (0..n).map(|i| (points[i] - middle).cross(points[(i + 1) % n] - middle)).sum::<DVec3>();
        let corner = |p: DVec3| (p, planar(p, normal));
        for i in 0..n {
            self.triangle([corner(middle), corner(points[i]), corner(points[(i + 1) % n])]);
        }
    }

    /// A box about the origin with flat bevels.
    pub fn slab(&mut self, size: DVec3, bevel: f64) {
        let half = 0.5 * size;
        let bevel = bevel.min(0.45 * size.min_element()).max(0.0);
        // The corner point with signs `s` on the face across `axis`.
        let corner = |axis: usize, s: DVec3| {
            let mut p = (half - DVec3::splat(bevel)) * s;
            p[axis] = half[axis] * s[axis];
            p
        };
        let signs = |axis: usize, a: f64, b: f64, c: f64| {
            let mut s = DVec3::ZERO;
            (s[axis], s[(axis + 1) % 3], s[(axis + 2) % 3]) = (a, b, c);
            s
        };
        let mut add = |mut points: Vec<DVec3>, out: DVec3| {
            if (points[1] - points[0]).cross(points[2] - points[0]).dot(out) < 0.0 {
                points.reverse();
            }
            self.facet(&points);
        };
        for axis in 0..3 {
            for a in [-1.0, 1.0] {
                let face = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
                add(face.map(|(b, c)| corner(axis, signs(axis, a, b, c))).to_vec(), signs(axis, a, 0.0, 0.0));
                if bevel > 0.0 {
                    for b in [-1.0, 1.0] {
                        let (s0, s1) = (signs(axis, a, b, -1.0), signs(axis, a, b, 1.0));
                        let next = (axis + 1) % 3;
                        add(vec![corner(axis, s0), corner(axis, s1), corner(next, s1), corner(next, s0)], signs(axis, a, b, 0.0));
                    }
                }
            }
        }
        if bevel > 0.0 {
            for i in 0..8u32 {
                let s = DVec3::from_array([0, 1, 2].map(|k| if i >> k & 1 == 1 { 1.0 } else { -1.0 }));
                add(vec![corner(0, s), corner(1, s), corner(2, s)], s);
            }
        }
    }

    /// A bevelled box from corner to corner, as a part.
    pub fn cuboid(&mut self, low: DVec3, high: DVec3, bevel: f64) {
        let (a, b) = (low.min(high), low.max(high));
        self.part(DAffine3::from_translation(0.5 * (a + b)), |p| p.slab(b - a, bevel));
    }

    /// A closed surface about the origin: `f` of directions, from six faces of `n x n` cells; texture coordinates 0..=1 a face.
    pub fn ball(&mut self, n: usize, f: impl Fn(DVec3) -> DVec3) {
        let axes = [DVec3::X, DVec3::Y, DVec3::Z];
        // Tangent steps sample the sphere evenly.
        let step = |i: usize| ((2.0 * i as f64 / n as f64 - 1.0) * PI / 4.0).tan();
        for axis in 0..3 {
            for side in [-1.0, 1.0] {
                let (right, up, out) = (axes[(axis + 1) % 3] * side, axes[(axis + 2) % 3], axes[axis] * side);
                let point = |i: usize, j: usize| f((right * step(i) + up * step(j) + out).normalize());
                self.cells(n, n, [1.0, 1.0], point);
            }
        }
    }

    /// As [`Self::grid`] of whole numbers, with each point found once.
    pub fn cells(&mut self, nu: usize, nv: usize, repeat: [f64; 2], f: impl Fn(usize, usize) -> DVec3) {
        let points: Vec<DVec3> = (0..=nv).flat_map(|j| (0..=nu).map(move |i| (i, j))).map(|(i, j)| f(i, j)).collect();
        let corner = |i: usize, j: usize| {
            let uv = DVec2::new(i as f64 / nu as f64 * repeat[0], (1.0 - j as f64 / nv as f64) * repeat[1]);
            (points[j * (nu + 1) + i], uv)
        };
        for j in 0..nv {
            for i in 0..nu {
                self.quad([corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)]);
            }
        }
    }

    /// An ellipsoid of these half axes about `centre`, as a part.
    pub fn ellipsoid(&mut self, centre: DVec3, half: DVec3, n: usize) {
        self.part(DAffine3::from_translation(centre), |p| p.ball(n, |d| d * half));
    }

    /// A tube about `path` with the section `ring(point index, angle)` in the plane across it; open ends are flat.
    pub fn tube(&mut self, path: &[DVec3], closed: bool, sides: usize, repeat: [f64; 2], ring: impl Fn(usize, f64) -> DVec2) {
        let n = path.len();
        if n < 2 {
            return;
        }
        let rings = if closed { n + 1 } else { n };
        let tangent = |i: usize| {
            let (before, after) = if closed { ((i + n - 1) % n, (i + 1) % n) } else { (i.saturating_sub(1), (i + 1).min(n - 1)) };
            (path[after] - path[before]).normalize_or(DVec3::Y)
        };
        let mut normals = vec![tangent(0).any_orthonormal_vector()];
        for i in 1..rings {
            // Turning with the tangent is parallel transport, to second order in the step.
            normals.push(DQuat::from_rotation_arc(tangent((i - 1) % n), tangent(i % n)) * normals[i - 1]);
        }
        // A closed path comes back turned; that turn is spread over its length.
        let turn = if closed {
            let (a, b, t) = (normals[0], normals[n], tangent(0));
            b.cross(a).dot(t).atan2(b.dot(a))
        } else {
            0.0
        };
        let place = |i: usize, k: usize| {
            let (t, i0) = (tangent(i % n), i % n);
            let spin = turn * i as f64 / n as f64;
            let (a, b) = (normals[i], t.cross(normals[i]));
            let (sin, cos) = spin.sin_cos();
            let (a, b) = (a * cos + b * sin, b * cos - a * sin);
            let p = ring(i0, TAU * (k % sides) as f64 / sides as f64);
            path[i0] + a * p.x + b * p.y
        };
        // The ring after the last of a closed path is the first one, bit for bit.
        self.cells(sides, rings - 1, repeat, |k, i| if closed && i == n { place(0, k) } else { place(i, k) });
        if !closed {
            for (end, order) in [(0, [1, 0]), (n - 1, [0, 1])] {
                for k in 0..sides {
                    let flat = |k: usize| {
                        let (sin, cos) = (TAU * k as f64 / sides as f64).sin_cos();
                        DVec2::new(0.5 + 0.5 * cos, 0.5 + 0.5 * sin)
                    };
                    let corner = |k: usize| (place(end, k), flat(k));
                    self.triangle([(path[end], DVec2::splat(0.5)), corner(k + order[0]), corner(k + order[1])]);
                }
            }
        }
    }

    /// A round rod through `path` with a radius at each point; round ends when `round`, as a part.
    pub fn rod(&mut self, path: &[DVec3], radii: &[f64], sides: usize, round: bool) {
        let n = path.len();
        if n < 2 || radii.len() != n {
            return;
        }
        let length: f64 = path.windows(2).map(|w| w[0].distance(w[1])).sum();
        let steps = if !round {
            0
        } else if sides > 8 {
            4
        } else {
            2
        };
        // Rings of a quarter circle beyond an end, from the rim to the tip.
        let cap = |end: DVec3, back: DVec3, radius: f64| {
            let out = (end - back).normalize_or(DVec3::Y);
            (1..=steps).map(move |i| {
                let (sin, cos) = (FRAC_PI_2 * f64::from(i) / f64::from(steps)).sin_cos();
                (end + out * radius * sin, if i == steps { 0.0 } else { radius * cos })
            })
        };
        let body = path.iter().copied().zip(radii.iter().copied());
        let rings = cap(path[0], path[1], radii[0]).rev().chain(body).chain(cap(path[n - 1], path[n - 2], radii[n - 1]));
        let (path, radii): (Vec<DVec3>, Vec<f64>) = rings.unzip();
        let widest = radii.iter().copied().fold(1e-6, f64::max);
        let repeat = [1.0, (length / (TAU * widest)).clamp(1.0, 12.0).round()];
        self.part(DAffine3::IDENTITY, |p| {
            p.tube(&path, false, sides, repeat, |i, a| radii[i] * DVec2::new(a.cos(), a.sin()));
        });
    }

    /// A straight rod from `a` to `b`, as a part.
    pub fn bar(&mut self, a: DVec3, b: DVec3, radii: [f64; 2], sides: usize) {
        self.rod(&[a, b], &radii, sides, false);
    }

    /// A turned body as a part; see [`Self::lathe`].
    pub fn turned(&mut self, place: DAffine3, profile: &[DVec2], segments: usize) {
        self.part(place, |p| p.lathe(profile, segments));
    }

    /// A thin closed leaf: `width` at shares 0..=1 of its length (0 at both ends), `thick` in its middle;
    /// `place(share, across, up)` with across, up and along right-handed.
    pub fn leaf(
        &mut self,
        rows: usize,
        columns: usize,
        thick: f64,
        width: impl Fn(f64) -> f64,
        place: impl Fn(f64, f64, f64) -> DVec3,
    ) {
        let mut part = Self::default();
        let widest = (0..=rows).map(|i| width(i as f64 / rows as f64)).fold(1e-9, f64::max);
        let point = |i: usize, j: usize, side: f64| {
            let share = i as f64 / rows as f64;
            let w = if i == 0 || i == rows { 0.0 } else { width(share) };
            let t = 2.0 * j as f64 / columns as f64 - 1.0;
            let body = if j == 0 || j == columns { 0.0 } else { 1.0 - t * t };
            place(share, w * t, side * 0.5 * thick * body * (w / widest).min(1.0))
        };
        part.cells(rows, columns, [2.0, 1.0], |i, j| point(i, j, 1.0));
        let mut below = Self::default();
        below.cells(columns, rows, [1.0, 2.0], |j, i| point(i, j, -1.0));
        part.weld(below);
        self.absorb(part);
    }
}

/// Smooth curve through `points` (Catmull-Rom), `steps` pieces between neighbours.
pub(super) fn spline(points: &[DVec3], closed: bool, steps: usize) -> Vec<DVec3> {
    let n = points.len() as isize;
    if n < 2 {
        return points.to_vec();
    }
    let get = |i: isize| points[if closed { i.rem_euclid(n) } else { i.clamp(0, n - 1) } as usize];
    let pieces = if closed { n } else { n - 1 };
    let mut path = Vec::new();
    for i in 0..pieces {
        let (p0, p1, p2, p3) = (get(i - 1), get(i), get(i + 1), get(i + 2));
        for k in 0..steps {
            let t = k as f64 / steps as f64;
            path.push(p1 + 0.5 * t * (p2 - p0 + t * (2.0 * p0 - 5.0 * p1 + 4.0 * p2 - p3 + t * (3.0 * (p1 - p2) + p3 - p0))));
        }
    }
    if !closed {
        path.push(points[n as usize - 1]);
    }
    path
}

/// As [`spline`] in the plane, for profiles; never left of the axis.
pub(super) fn profile(points: &[(f64, f64)], steps: usize) -> Vec<DVec2> {
    let lifted: Vec<DVec3> = points.iter().map(|&(x, y)| DVec3::new(x, y, 0.0)).collect();
    spline(&lifted, false, steps).iter().map(|p| DVec2::new(p.x.max(0.0), p.y)).collect()
}

/// A wall of even thickness inside the profile `outer` (from the foot's rim up to the lip), closed on the axis: a hollow vessel
/// with a floor `floor` above the bottom.
pub(super) fn hollow(outer: &[DVec2], wall: f64, floor: f64) -> Vec<DVec2> {
    let mut closed = vec![DVec2::new(0.0, outer[0].y)];
    closed.extend(outer);
    let n = outer.len();
    let bottom = outer[0].y + floor;
    for i in (0..n).rev() {
        let (a, b) = (outer[i.saturating_sub(1)], outer[(i + 1).min(n - 1)]);
        let t = (b - a).normalize_or(DVec2::Y);
        // Left of the way up is inwards; the lip stays level.
        let inner = if i == n - 1 { outer[i] - DVec2::new(wall, 0.0) } else { outer[i] + wall * DVec2::new(-t.y, t.x) };
        let last = closed[closed.len() - 1];
        if inner.y > bottom && inner.x > 0.15 * wall && (i == n - 1 || inner.y < last.y - 1e-4) {
            closed.push(inner);
        }
    }
    let last = closed[closed.len() - 1];
    if last.y > bottom + 0.02 {
        closed.push(DVec2::new(last.x * 0.96, bottom + 0.2 * (last.y - bottom)));
        closed.push(DVec2::new(last.x * 0.85, bottom));
    }
    closed.push(DVec2::new(0.0, closed[closed.len() - 1].y.min(bottom)));
    closed
}

/// A frame with +Y along `y` and +Z as near to `z` as possible.
pub(super) fn frame(y: DVec3, z: DVec3) -> DMat3 {
    let y = y.normalize_or(DVec3::Y);
    let x = y.cross(z).normalize_or(y.any_orthonormal_vector());
    DMat3::from_cols(x, y, x.cross(y))
}
