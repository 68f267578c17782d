//! Polyhedra by Conway's operators, their frames, and clusters of crystals.

use crate::draw::Draw;
use crate::family::{choice, family};
use crate::shapes::builder::Builder;
use crate::shapes::conway::Polyhedron as Faces;
use crate::shapes::parts::{Dice, along, at};
use glam::{DAffine3, DQuat, DVec2, DVec3};
use std::f64::consts::TAU;

/// What a random polyhedron starts from, and the operators on it.
fn compose(seed: u32, operations: u32, amount: f64) -> Faces {
    let mut dice = Dice::new(seed);
    let mut p = match dice.below(7) {
        5 => Faces::prism(3 + dice.below(6), false),
        6 => Faces::prism(3 + dice.below(6), true),
        i => Faces::platonic([4, 6, 8, 12, 20][i]),
    };
    for _ in 0..operations {
        p = p.operate(dice.below(8), amount);
    }
    p
}

/// Adds the faces of `p`; triangles get no further points, others a middle one when not planar.
fn faces(b: &mut Builder, p: &Faces) {
    for face in &p.faces {
        let points: Vec<DVec3> = face.iter().map(|&i| p.points[i]).collect();
        if points.len() < 5 { b.facet(&points) } else { b.fan(&points) }
    }
}

choice! {
    /// How a polyhedron is finished.
    Finish {
        /// Flat faces.
        Facets,
        /// Pyramids on the faces, like a star.
        Stellated,
        /// Dents in the faces.
        Dented,
        /// A smooth body about the faces.
        Smooth,
        /// A smooth body about a star.
        Spiky,
    }
}

family! {
    /// A Platonic solid, prism or antiprism under Conway's operators (kis, ambo, truncate, dual, gyro, snub, expand, join).
    shape Polyhedron("abstract", Any) |rng| {
        /// How it is finished.
        finish: Finish = Finish::draw(rng);
        /// Operators.
        operations: u32 [0, 4] = rng.below(4);
        /// Depth of truncations.
        amount: f32 [0, 1] = rng.between(0.0, 1.0);
        /// Height of pyramids, or depth of dents, in radii of a face.
        height: f32 [0.05, 2] = rng.between(0.25, 1.1);
        /// Extents along x, y, z over one another.
        stretch: [f32; 3] [0.3, 3] = [0; 3].map(|_| if rng.chance(0.6) { 1.0 } else { rng.between(0.6, 1.3) });
        /// Which start and operators.
        seed: u32 = rng.below(1 << 30);
    }
}

impl Polyhedron {
    fn build(&self) -> (Builder, f64) {
        let mut b = Builder::default();
        let p = compose(self.seed, self.operations, f64::from(self.amount));
        let height = f64::from(self.height);
        let (p, crease) = match self.finish {
            Finish::Facets => (p.planar(), 8.0),
            Finish::Stellated => (p.planar().kis(height), 8.0),
            Finish::Dented => (p.planar().kis(-0.4 * height), 8.0),
            Finish::Smooth | Finish::Spiky => {
                let mut p = if self.finish == Finish::Spiky { p.kis(1.4 * height) } else { p.kis(-0.3 * height) };
                while p.edges() < 2400 {
                    p = p.smooth();
                }
                (p, 50.0)
            }
        };
        faces(&mut b, &p);
        let stretch = DVec3::from(self.stretch.map(f64::from));
        b.map_points(|p| p * stretch);
        (b, crease)
    }
}

choice! {
    /// How the frame of a polyhedron is made.
    Frame {
        /// Flat bars of a shell with windows (after Leonardo's drawings for Pacioli).
        Leonardo,
        /// The same, smoothed into a flowing body.
        Flowing,
        /// Round struts with balls at the corners.
        Struts,
        /// Square struts.
        Beams,
    }
}

family! {
    /// The open frame of a polyhedron. Struts and balls are closed and run into one another.
    shape Lattice("abstract", Any) |rng| {
        /// How it is made.
        frame: Frame = Frame::draw(rng);
        /// Operators on the solid it starts from.
        operations: u32 [0, 3] = rng.below(3);
        /// Depth of truncations.
        amount: f32 [0, 1] = rng.between(0.0, 1.0);
        /// Width of bars: a share of the faces, or of twice the shortest edge.
        width: f32 [0.05, 0.5] = rng.between(0.12, 0.4);
        /// Thickness of shells as a share of the radius; size of balls at corners.
        depth: f32 [0.03, 0.5] = rng.between(0.08, 0.3);
        /// Which solid and operators.
        seed: u32 = rng.below(1 << 30);
    }
}

impl Lattice {
    fn build(&self) -> (Builder, f64) {
        let mut b = Builder::default();
        let mut p = compose(self.seed, self.operations, f64::from(self.amount));
        if p.edges() > 400 {
            p = compose(self.seed, 1, f64::from(self.amount));
        }
        let (width, depth) = (f64::from(self.width), f64::from(self.depth));
        match self.frame {
            Frame::Leonardo | Frame::Flowing => {
                p = p.planar().leonardo(1.0 - width, 1.0 - depth);
                if self.frame == Frame::Leonardo {
                    faces(&mut b, &p);
                    return (b, 8.0);
                }
                while p.edges() < 3200 {
                    p = p.smooth();
                }
                faces(&mut b, &p);
                (b, 60.0)
            }
            Frame::Struts | Frame::Beams => {
                let mut pairs: Vec<(usize, usize)> = p
                    .faces
                    .iter()
                    .flat_map(|f| (0..f.len()).map(|k| (f[k], f[(k + 1) % f.len()])))
                    .filter(|(a, c)| a < c)
                    .collect();
                pairs.sort_unstable();
                let shortest = pairs.iter().map(|&(a, c)| p.points[a].distance(p.points[c])).fold(f64::INFINITY, f64::min);
                let r = (0.35 * width * shortest).clamp(0.012, 0.12);
                let sides = if self.frame == Frame::Beams {
                    4
                } else if pairs.len() > 150 {
                    8
                } else {
                    12
                };
                for &(a, c) in &pairs {
                    // Ends stop short of the corner, so that no two bars share an edge there; the ball covers it.
                    let short = (p.points[c] - p.points[a]).normalize_or_zero() * 0.3 * r;
                    b.bar(p.points[a] + short, p.points[c] - short, [r; 2], sides);
                }
                let ball = r * (1.25 + 2.0 * depth);
                for &c in &p.points {
                    if self.frame == Frame::Beams {
                        b.part(at(c, along(c)), |part| part.slab(DVec3::splat(2.1 * ball), 0.2 * ball));
                    } else {
                        b.ellipsoid(
                            c,
                            DVec3::splat(ball),
                            match pairs.len() {
                                0..=60 => 6,
                                61..=150 => 4,
                                151..=250 => 3,
                                _ => 2,
                            },
                        );
                    }
                }
                (b, if self.frame == Frame::Beams { 25.0 } else { 50.0 })
            }
        }
    }
}

family! {
    /// A druse: pointed columns of crystal growing out of a common foot.
    shape Crystals("mineral", Upright) |rng| {
        /// Crystals.
        count: u32 [1, 64] = 5 + rng.below(28);
        /// Sides of a column.
        sides: u32 [3, 8] = [4, 6, 6, 6, 5, 8][rng.below(6) as usize];
        /// Radius over height.
        slim: f32 [0.05, 0.5] = rng.log(0.09, 0.28);
        /// Height of the tip over the radius.
        point: f32 [0.1, 4] = rng.log(0.5, 2.2);
        /// How far the outermost lean, degrees.
        spread: f32 [0, 85] = rng.between(25.0, 65.0);
        /// Bevelled or unequal sides: how much their radii differ.
        ragged: f32 [0, 0.5] = rng.between(0.05, 0.35);
        /// Which druse.
        seed: u32 = rng.below(1 << 30);
    }
}

impl Crystals {
    fn build(&self) -> (Builder, f64) {
        let mut b = Builder::default();
        let mut dice = Dice::new(self.seed);
        let (slim, ragged) = (f64::from(self.slim), f64::from(self.ragged));
        let n = self.sides as usize;
        let foot = 0.12 + 0.035 * f64::from(self.count).sqrt() + 0.8 * slim;
        for index in 0..self.count {
            let share = (f64::from(index) / f64::from(self.count)).sqrt();
            let lean = f64::from(self.spread).to_radians() * share * dice.between(0.7, 1.1);
            let around = 2.399_963 * f64::from(index) + dice.between(-0.4, 0.4);
            let axis = DQuat::from_rotation_y(around) * DVec3::new(0.0, lean.cos(), lean.sin());
            let height = (1.0 - 0.5 * share) * dice.between(0.55, 1.0);
            let radius = slim * dice.between(0.5, 1.0) * (0.4 + 0.6 * height);
            let place = at(
                DQuat::from_rotation_y(around) * DVec3::Z * (0.6 * foot * share),
                along(axis) * DQuat::from_rotation_y(dice.between(0.0, TAU)),
            );
            let ring: Vec<DVec2> = (0..n)
                .map(|i| DVec2::from_angle(-TAU * i as f64 / n as f64) * radius * (1.0 + ragged * dice.between(-1.0, 1.0)))
                .collect();
            let tip_height = (f64::from(self.point) * radius).min(0.6 * height);
            let tip = DVec3::new(dice.between(-0.2, 0.2) * radius, height, dice.between(-0.2, 0.2) * radius);
            b.part(place, |p| {
                let corner = |i: usize, y: f64, s: f64| DVec3::new(ring[i % n].x * s, y, ring[i % n].y * s);
                // Unequal heights of the shoulders make unequal facets of the tip.
                let shoulder = |i: usize| corner(i, height - tip_height * (1.0 + 0.25 * (3.0 * (i % n) as f64).sin()), 1.0);
                for i in 0..n {
                    p.facet(&[corner(i, -0.08, 0.9), corner(i + 1, -0.08, 0.9), shoulder(i + 1), shoulder(i)]);
                    p.facet(&[shoulder(i), shoulder(i + 1), tip]);
                }
                let bottom: Vec<DVec3> = (0..n).rev().map(|i| corner(i, -0.08, 0.9)).collect();
                p.fan(&bottom);
            });
        }
        b.part(DAffine3::IDENTITY, |p| {
            p.ball(10, |d| {
                let bump = 1.0 + 0.3 * crate::noise::fractal(d * 2.3, 3, self.seed);
                DVec3::new(d.x * foot * bump * 1.25, (d.y * 0.13 * bump).max(-0.1), d.z * foot * bump * 1.25)
            });
        });
        (b, 12.0)
    }
}
