//! Self-similar solids.

use super::outlines::plate;
use crate::draw::Draw;
use crate::family::{choice, family};
use crate::shapes::builder::Builder;
use crate::shapes::parts::{Dice, planar};
use glam::{DAffine3, DQuat, DVec2, DVec3};
use std::f64::consts::{FRAC_PI_2, TAU};

choice! {
    /// Which cells of a cube are kept, again and again.
    Holes {
        /// Menger's sponge: without the seven in the middles.
        Menger,
        /// The cross-shaped remainder of a Jerusalem-like cube: without the edges' middles.
        Jerusalem,
        /// Without the corners.
        Clipped,
        /// A seeded pattern with the symmetry of a cube.
        Symmetric,
        /// A seeded pattern without symmetry.
        Free,
    }
}

family! {
    /// A cube with cells taken out of its cells (Menger 1926, and relatives).
    shape Sponge("abstract", Any) |rng| {
        /// Which cells are kept.
        holes: Holes = Holes::draw(rng);
        /// Cells along an edge.
        cells: u32 [3, 5] = if rng.chance(0.7) { 3 } else { 4 + rng.below(2) };
        /// How often cells are divided.
        levels: u32 [1, 2] = 1 + u32::from(rng.chance(0.7));
        /// Width of the middle cells over that of the outer ones.
        middle: f32 [0.3, 3] = rng.log(0.6, 1.8);
        /// Extents along x, y, z over one another.
        stretch: [f32; 3] [0.3, 3] = [0; 3].map(|_| if rng.chance(0.6) { 1.0 } else { rng.between(0.6, 1.4) });
        /// Which pattern, of the seeded ones.
        seed: u32 = rng.below(1 << 30);
    }
}

impl Sponge {
    fn keeps(&self) -> Vec<bool> {
        let n = self.cells as usize;
        let mut dice = Dice::new(self.seed);
        let share = dice.between(0.55, 0.8);
        // A cell by its distances from the middle, sorted: the same for all cells that symmetry exchanges.
        let class: Vec<bool> = (0..125).map(|_| dice.chance(share)).collect();
        (0..n * n * n)
            .map(|i| {
                let (x, y, z) = (i % n, i / n % n, i / (n * n));
                let border = |c: usize| c == 0 || c == n - 1;
                let inner = [x, y, z].iter().filter(|&&c| !border(c)).count();
                match self.holes {
                    Holes::Menger => inner < 2,
                    Holes::Jerusalem => inner != 1,
                    Holes::Clipped => inner != 0,
                    Holes::Symmetric if inner == 3 || (inner == 2 && n % 2 == 1 && class[124]) => false,
                    Holes::Symmetric => {
                        let mut d = [x, y, z].map(|c| c.min(n - 1 - c));
                        d.sort_unstable();
                        class[d[0] * 25 + d[1] * 5 + d[2]] || (d[1] == 0 && d[2] == 1)
                    }
                    Holes::Free => (class[i] && inner < 3) || (border(x) && border(y) && border(z)),
                }
            })
            .collect()
    }

    fn build(&self) -> (Builder, f64) {
        let n = self.cells as usize;
        let keeps = self.keeps();
        let levels = if n > 4 { 1 } else { self.levels };
        let total = n.pow(levels);
        let mut solid = vec![false; total.pow(3)];
        for (i, cell) in solid.iter_mut().enumerate() {
            let mut c = [i % total, i / total % total, i / (total * total)];
            *cell = (0..levels).all(|_| {
                let kept = keeps[(c[2] % n * n + c[1] % n) * n + c[0] % n];
                c = c.map(|v| v / n);
                kept
            });
        }
        // Borders between cells: the division of the whole repeated in every part.
        let mut marks = vec![0.0, 1.0];
        for _ in 0..levels {
            let widths: Vec<f64> = (0..n).map(|i| if i == 0 || i == n - 1 { 1.0 } else { f64::from(self.middle) }).collect();
            let sum: f64 = widths.iter().sum();
            let mut next = vec![0.0];
            for pair in marks.windows(2) {
                let mut at = pair[0];
                for w in &widths {
                    at += (pair[1] - pair[0]) * w / sum;
                    next.push(at);
                }
            }
            marks = next;
        }
        let mut b = Builder::default();
        voxels(&mut b, total, &mut solid, |c| DVec3::from(c.map(|i| marks[i])) * DVec3::from(self.stretch.map(f64::from)));
        b.keep_largest();
        (b, 30.0)
    }
}

/// The surface of the solid cells of a cube of `n` cells along each edge. Where two solid cells meet in an edge alone, a further
/// one is filled, so that each edge of the surface belongs to two faces.
pub(in crate::shapes) fn voxels(b: &mut Builder, n: usize, solid: &mut [bool], place: impl Fn([usize; 3]) -> DVec3) {
    let index = |c: [usize; 3]| (c[2] * n + c[1]) * n + c[0];
    let cells = || (0..n * n * n).map(|i| [i % n, i / n % n, i / (n * n)]);
    for _ in 0..n {
        let mut changed = false;
        for c in cells() {
            for axis in 0..3 {
                let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                if c[u] + 1 >= n || c[v] + 1 >= n {
                    continue;
                }
                let step = |du: usize, dv: usize| {
                    let mut d = c;
                    (d[u], d[v]) = (d[u] + du, d[v] + dv);
                    index(d)
                };
                let [p, q, r, s] = [step(0, 0), step(1, 0), step(1, 1), step(0, 1)];
                if solid[p] == solid[r] && solid[q] == solid[s] && solid[p] != solid[q] {
                    solid[if solid[p] { q } else { p }] = true;
                    changed = true;
                }
            }
        }
        if !changed {
            break;
        }
    }
    for c in cells().filter(|&c| solid[index(c)]) {
        for axis in 0..3 {
            for side in 0..2 {
                let mut next = c;
                let out = if side == 0 { c[axis].checked_sub(1) } else { Some(c[axis] + 1).filter(|&i| i < n) };
                if let Some(i) = out {
                    next[axis] = i;
                    if solid[index(next)] {
                        continue;
                    }
                }
                let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                let corner = |du: usize, dv: usize| {
                    let mut d = c;
                    (d[axis], d[u], d[v]) = (d[axis] + side, d[u] + du, d[v] + dv);
                    place(d)
                };
                let mut face = [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)];
                if side == 0 {
                    face.reverse();
                }
                b.facet(&face);
            }
        }
    }
}

choice! {
    /// A self-similar construction.
    Recursion {
        /// Tetrahedra on the corners of tetrahedra.
        Sierpinski,
        /// Octahedra on the corners of octahedra.
        Octahedra,
        /// Smaller cubes on the faces of cubes.
        CubeTree,
        /// A plate with Koch's snowflake as outline.
        KochPlate,
        /// Pyramids on the faces of a solid, again and again.
        KochSolid,
        /// Balls on balls.
        BallTree,
        /// Turned boxes on one another, a Pythagoras tree.
        Pythagoras,
    }
}

family! {
    /// A fractal solid of a few levels. The pieces of the tree-like kinds are closed and run into one another.
    shape Fractal("abstract", Any) |rng| {
        /// The construction.
        kind: Recursion = Recursion::draw(rng);
        /// Levels.
        levels: u32 [1, 4] = 2 + rng.below(2);
        /// Size of a child over that of its parent.
        ratio: f32 [0.3, 0.62] = rng.between(0.42, 0.56);
        /// Turn of each child against its parent, degrees.
        turn: f32 [-90, 90] = if rng.chance(0.5) { 0.0 } else { rng.between(-50.0, 50.0) };
        /// Heights of pyramids, plates and branches.
        height: f32 [0.1, 1] = rng.between(0.3, 0.9);
    }
}

const TETRAHEDRON: [[f64; 3]; 4] = [[1.0, 1.0, 1.0], [-1.0, -1.0, 1.0], [-1.0, 1.0, -1.0], [1.0, -1.0, -1.0]];
const TETRAHEDRON_FACES: [[usize; 3]; 4] = [[0, 1, 3], [0, 3, 2], [0, 2, 1], [1, 2, 3]];

fn octahedron_faces() -> Vec<[DVec3; 3]> {
    let mut faces = Vec::new();
    for i in 0..8u32 {
        let sign = [0, 1, 2].map(|k| if i >> k & 1 == 1 { -1.0 } else { 1.0 });
        let [x, y, z] = [DVec3::X * sign[0], DVec3::Y * sign[1], DVec3::Z * sign[2]];
        faces.push(if i.count_ones() % 2 == 0 { [x, y, z] } else { [y, x, z] });
    }
    faces
}

impl Fractal {
    fn build(&self) -> (Builder, f64) {
        let mut b = Builder::default();
        let (ratio, height) = (f64::from(self.ratio), f64::from(self.height));
        let turn = f64::from(self.turn).to_radians();
        let tetrahedron =
            || TETRAHEDRON_FACES.iter().map(|f| f.map(|i| DVec3::from(TETRAHEDRON[i]).normalize())).collect::<Vec<_>>();
        let mut crease = 25.0;
        match self.kind {
            Recursion::Sierpinski => {
                let corners: Vec<DVec3> = TETRAHEDRON.iter().map(|&c| DVec3::from(c).normalize()).collect();
                // A hair larger than half: pieces that only touch would fall apart.
                scatter(&mut b, self.levels.min(4), &corners, ratio.max(0.505), turn, &|p| {
                    tetrahedron().iter().for_each(|f| p.facet(f))
                });
            }
            Recursion::Octahedra => {
                let corners = [DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y, DVec3::Z, DVec3::NEG_Z];
                scatter(&mut b, self.levels.min(3), &corners, ratio.max(0.505), turn, &|p| {
                    octahedron_faces().iter().for_each(|f| p.facet(f))
                });
            }
            Recursion::CubeTree => {
                let make = |p: &mut Builder, _: u32| p.slab(DVec3::splat(2.0), 0.06);
                tree(&mut b, self.levels.min(3), ratio.min(0.52), turn, &make);
            }
            Recursion::BallTree => {
                crease = 60.0;
                tree(&mut b, self.levels.min(3), ratio.min(0.5), turn, &|p, level| {
                    p.ball([9, 7, 5, 3][level.min(3) as usize], |d| d)
                });
            }
            Recursion::KochPlate => {
                let mut outline: Vec<DVec2> = (0..3).map(|i| DVec2::from_angle(FRAC_PI_2 + TAU * f64::from(i) / 3.0)).collect();
                for _ in 0..self.levels.min(4) {
                    outline = (0..outline.len())
                        .flat_map(|i| {
                            let (a, c) = (outline[i], outline[(i + 1) % outline.len()]);
                            // Bumps of the snowflake, higher or lower with the ratio.
                            let tip = 0.5 * (a + c) - (c - a).perp() / 3.0 * (1.732 * ratio).min(0.9);
                            [a, a.lerp(c, 1.0 / 3.0), tip, a.lerp(c, 2.0 / 3.0)]
                        })
                        .collect();
                }
                let mut flat = Builder::default();
                plate(&mut flat, &outline, &[], 0.6 * height, 0.0);
                flat.turn_z_to_y();
                b.absorb(flat);
            }
            Recursion::KochSolid => {
                let mut faces = if self.turn > 0.0 { octahedron_faces() } else { tetrahedron() };
                for _ in 0..self.levels.min(4) {
                    faces = faces.iter().flat_map(|f| raise(f, 0.8 * height)).collect();
                }
                for f in faces {
                    let n = (f[1] - f[0]).cross(f[2] - f[0]);
                    b.triangle(f.map(|p| (p, planar(p, n))));
                }
            }
            Recursion::Pythagoras => pythagoras(&mut b, self.levels + 3, ratio, height, turn),
        }
        (b, crease)
    }
}

/// Copies of `make` at the corners of copies, `ratio` as large, `levels` deep.
fn scatter(b: &mut Builder, levels: u32, corners: &[DVec3], ratio: f64, turn: f64, make: &dyn Fn(&mut Builder)) {
    let mut places = vec![DAffine3::IDENTITY];
    let spin = DQuat::from_rotation_y(turn);
    for _ in 0..levels {
        places = places
            .iter()
            .flat_map(|m| {
                let child =
                    |c: &DVec3| *m * DAffine3::from_scale_rotation_translation(DVec3::splat(ratio), spin, *c * (1.0 - ratio));
                corners.iter().map(child).collect::<Vec<_>>()
            })
            .collect();
    }
    for place in places {
        b.part(place, make);
    }
}

/// `make`, half a side long, with smaller copies on its faces, and so on.
fn tree(b: &mut Builder, levels: u32, ratio: f64, turn: f64, make: &dyn Fn(&mut Builder, u32)) {
    let mut front = vec![(DAffine3::IDENTITY, DVec3::ZERO)];
    for level in 0..=levels {
        let mut next = Vec::new();
        for (place, from) in front {
            b.part(place, |p| make(p, level));
            if level == levels {
                continue;
            }
            for axis in [DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y, DVec3::Z, DVec3::NEG_Z] {
                if axis == -from {
                    continue;
                }
                let spin = DQuat::from_axis_angle(axis, turn);
                // Sunk in a little, so that no two faces lie in one plane.
                let m = DAffine3::from_scale_rotation_translation(DVec3::splat(ratio), spin, axis * (1.0 + 0.93 * ratio));
                next.push((place * m, axis));
            }
        }
        front = next;
    }
}

/// A triangle with a pyramid on its middle.
fn raise(&[a, b, c]: &[DVec3; 3], height: f64) -> Vec<[DVec3; 3]> {
    let (ab, bc, ca) = (0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a));
    let n = (b - a).cross(c - a).normalize_or_zero();
    let tip = (a + b + c) / 3.0 + n * (0.408 * height * a.distance(b));
    vec![[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, tip], [bc, ca, tip], [ca, ab, tip]]
}

/// Boxes that fork: each carries two smaller ones, turned about the way up.
fn pythagoras(b: &mut Builder, levels: u32, ratio: f64, height: f64, turn: f64) {
    let lean = (0.35 + 0.9 * (ratio - 0.3)).clamp(0.2, 0.8);
    let tall = 0.8 + 1.2 * height;
    let shrink = 0.6 + 0.4 * ratio;
    let mut front = vec![DAffine3::IDENTITY];
    for level in 0..levels.min(7) {
        let mut next = Vec::new();
        for place in front {
            let lift = DAffine3::from_translation(DVec3::Y * 0.5 * tall);
            b.part(place * lift, |p| p.slab(DVec3::new(1.0, tall, 1.0), 0.05));
            if level > 4 && next.len() > 100 {
                continue;
            }
            for side in [-1.0, 1.0] {
                let q =
                    DQuat::from_rotation_y(FRAC_PI_2 * f64::from(level % 2) + turn * 0.5) * DQuat::from_rotation_z(-side * lean);
                let at = DVec3::Y * (tall - 0.25)
                    + DQuat::from_rotation_y(FRAC_PI_2 * f64::from(level % 2) + turn * 0.5) * DVec3::X * (0.22 * side);
                next.push(place * DAffine3::from_scale_rotation_translation(DVec3::splat(shrink), q, at));
            }
        }
        front = next;
    }
}
