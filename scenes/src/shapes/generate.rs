//! From parameters to triangles, one function a group of families.

use super::Shape;
use super::builder::Builder;
use crate::{Mesh, noise};
use glam::{DVec2, DVec3, Vec3};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Faces meeting at less than this many degrees are shaded smoothly.
const CREASE: f64 = 40.0;

pub(super) fn mesh(shape: &Shape) -> Mesh {
    let (builder, crease) = build(shape);
    builder.finish(shape.family(), crease)
}

/// Positions of [`mesh`] without its faces and normals.
pub(super) fn points(shape: &Shape) -> Vec<Vec3> {
    build(shape).0.finish_points()
}

/// The surface of `shape` and the angle in degrees below which it is shaded smoothly.
fn build(shape: &Shape) -> (Builder, f64) {
    let mut b = Builder::default();
    let mut crease = CREASE;
    match shape {
        Shape::Plane { size } => plane(&mut b, f64::from(*size)),
        Shape::Disc { radius } => disc(&mut b, f64::from(*radius)),
        Shape::Box { size, bevel } => rounded_box(&mut b, DVec3::from(size.map(f64::from)), f64::from(*bevel)),
        Shape::Sphere { radius } => {
            let r = f64::from(*radius);
            b.grid(64, 32, [2.0, 1.0], |u, v| r * direction(u, v));
        }
        Shape::Cylinder { radius, height, bevel } => cylinder(&mut b, [*radius, *height, *bevel].map(f64::from)),
        Shape::Cone { radius, top_radius, height } => {
            let (r, top, h) = (f64::from(*radius), f64::from(*top_radius), f64::from(*height));
            let mut profile = vec![DVec2::ZERO, DVec2::new(r, 0.0)];
            // Rings along the side keep the triangles near the tip from becoming needles.
            profile.extend((1..=8).map(|i| DVec2::new(r + (top - r) * f64::from(i) / 8.0, h * f64::from(i) / 8.0)));
            profile.push(DVec2::new(0.0, h));
            b.lathe(&profile, 64);
        }
        Shape::Capsule { radius, height } => {
            let (r, straight) = (f64::from(*radius), (f64::from(*height) - 2.0 * f64::from(*radius)).max(0.0));
            let mut profile = arc(DVec2::new(0.0, -0.5 * straight), r, -FRAC_PI_2, 0.0, 12);
            profile.extend(arc(DVec2::new(0.0, 0.5 * straight), r, 0.0, FRAC_PI_2, 12));
            b.lathe(&profile, 48);
        }
        Shape::Torus { radius, tube } => {
            let (major, minor) = (f64::from(*radius), f64::from(*tube));
            b.lathe(&arc(DVec2::new(major, 0.0), minor, -PI, PI, 32), 80);
        }
        Shape::TorusKnot { p, q, radius, tube } => torus_knot(&mut b, *p, *q, f64::from(*radius), f64::from(*tube)),
        Shape::Superellipsoid { size, vertical, horizontal } => {
            let half = 0.5 * DVec3::from(size.map(f64::from));
            let (n, e) = (f64::from(*vertical), f64::from(*horizontal));
            b.grid(96, 48, [2.0, 1.0], |u, v| half * superellipsoid(direction(u, v), n, e));
        }
        Shape::Lathe { radii, height, wall } => lathe(&mut b, radii, f64::from(*height), f64::from(*wall)),
        Shape::Pipe { radius, inner_radius, height } => {
            let (outer, inner, h) = (f64::from(*radius), f64::from(*inner_radius), f64::from(*height));
            b.lathe(&[(inner, 0.0), (outer, 0.0), (outer, h), (inner, h), (inner, 0.0)].map(|(r, y)| DVec2::new(r, y)), 72);
        }
        Shape::Prism { sides, radius, height, star, twist, taper } => {
            let notch = star.map(f64::from);
            prism(&mut b, *sides, f64::from(*radius), notch, [*height, *twist, *taper].map(f64::from));
            crease = 30.0;
        }
        Shape::Gear { teeth, radius, depth, hole, height } => {
            gear(&mut b, *teeth, [*radius, *depth, *hole, *height].map(f64::from));
            crease = 20.0;
        }
        Shape::Spring { radius, tube, turns, height } => spring(&mut b, [*radius, *tube, *turns, *height].map(f64::from)),
        Shape::Rock { radius, roughness, frequency, seed, facets } => {
            rock(&mut b, [*radius, *roughness, *frequency].map(f64::from), *seed, *facets);
            crease = if *facets { 1.0 } else { 80.0 };
        }
        Shape::Arch { width, height, depth, thickness } => {
            arch(&mut b, [*width, *height, *depth, *thickness].map(f64::from));
            crease = 20.0;
        }
        Shape::Stairs { steps, size } => stairs(&mut b, *steps, size.map(f64::from)),
        Shape::Supershape { lobes, vertical_lobes, n, k, size } => {
            supershape(&mut b, *lobes, *vertical_lobes, [*n, *k, *size].map(f64::from));
            crease = 60.0;
        }
        other => {
            // Parameters out of range give nothing: the surfaces below may rely on theirs.
            if let Some(model) = other.model().filter(|_| other.validate().is_empty()) {
                (b, crease) = model.surface();
                b.fit(f64::from(model.size()));
            }
        }
    }
    (b, crease)
}

/// Unit direction of spherical coordinates: u turns about +Y from +Z, v climbs from the south to the north pole.
fn direction(u: f64, v: f64) -> DVec3 {
    let (sin, cos) = (TAU * u).sin_cos();
    let latitude = PI * (v - 0.5);
    // Exactly on the axis at both poles.
    let across = if v <= 0.0 || v >= 1.0 { 0.0 } else { latitude.cos() };
    DVec3::new(across * sin, latitude.sin(), across * cos)
}

/// Points of a circular arc from angle `from` to `to`, both included, in `steps` pieces; exact on the axis.
fn arc(centre: DVec2, radius: f64, from: f64, to: f64, steps: usize) -> Vec<DVec2> {
    (0..=steps)
        .map(|i| {
            let angle = from + (to - from) * i as f64 / steps as f64;
            let p = centre + radius * DVec2::new(angle.cos(), angle.sin());
            DVec2::new(if p.x.abs() < 1e-12 { 0.0 } else { p.x }, p.y)
        })
        .collect()
}

fn plane(b: &mut Builder, size: f64) {
    // Du x dv must be +y: u along z, v along x. Texture coordinates count metres, so that a pattern keeps its size.
    b.grid(4, 4, [size, size], |u, v| DVec3::new((v - 0.5) * size, 0.0, (u - 0.5) * size));
}

fn disc(b: &mut Builder, radius: f64) {
    let ring = |i: usize, share: f64| {
        let (sin, cos) = (TAU * i as f64 / 96.0).sin_cos();
        let p = radius * share * DVec2::new(cos, sin);
        (DVec3::new(p.x, 0.0, -p.y), DVec2::new(p.x, -p.y))
    };
    for i in 0..96 {
        b.triangle([ring(0, 0.0), ring(i, 0.5), ring(i + 1, 0.5)]);
        b.quad([ring(i, 0.5), ring(i, 1.0), ring(i + 1, 1.0), ring(i + 1, 0.5)]);
    }
}

fn rounded_box(b: &mut Builder, size: DVec3, bevel: f64) {
    let inner = 0.5 * size - DVec3::splat(bevel);
    // Positions along a face: rounded edge, flat middle, rounded edge. (sign of the corner, offset from its flat part).
    let steps = if bevel > 0.0 { 4 } else { 0 };
    let mut marks: Vec<(f64, f64)> = (0..=steps).rev().map(|i| (-1.0, -(i as f64) / steps.max(1) as f64)).collect();
    marks.extend((0..=steps).map(|i| (1.0, i as f64 / steps.max(1) as f64)));
    let axes = [DVec3::X, DVec3::Y, DVec3::Z];
    for axis in 0..3 {
        for side in [-1.0, 1.0] {
            // Right-handed (right, up, outward), so that cells are counter-clockwise from outside.
            let (right, up, out) = (axes[(axis + 1) % 3] * side, axes[(axis + 2) % 3], axes[axis] * side);
            let corner = |i: usize, j: usize| {
                let ((su, tu), (sv, tv)) = (marks[i], marks[j]);
                let centre = inner * (right * su + up * sv + out);
                // Tangent steps sample the quarter circle evenly.
                let (a, c) = ((tu * PI / 4.0).tan(), (tv * PI / 4.0).tan());
                let p = centre + bevel * (right * a + up * c + out).normalize();
                (p, DVec2::new(p.dot(right), -p.dot(up)))
            };
            for j in 0..marks.len() - 1 {
                for i in 0..marks.len() - 1 {
                    b.quad([corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)]);
                }
            }
        }
    }
}

fn cylinder(b: &mut Builder, [r, h, bevel]: [f64; 3]) {
    let mut profile = vec![DVec2::ZERO];
    if bevel > 0.0 {
        profile.extend(arc(DVec2::new(r - bevel, bevel), bevel, -FRAC_PI_2, 0.0, 6));
        profile.extend(arc(DVec2::new(r - bevel, h - bevel), bevel, 0.0, FRAC_PI_2, 6));
    } else {
        profile.extend([DVec2::new(r, 0.0), DVec2::new(r, h)]);
    }
    profile.push(DVec2::new(0.0, h));
    b.lathe(&profile, 64);
}

fn torus_knot(b: &mut Builder, p: u32, q: u32, radius: f64, tube: f64) {
    let turns = (p.clamp(1, 7), q.clamp(1, 7));
    let n = 80 * turns.0.max(turns.1) as usize;
    let path: Vec<DVec3> = (0..n)
        .map(|i| {
            let t = TAU * i as f64 / n as f64;
            let (around, through) = (t * f64::from(turns.0), t * f64::from(turns.1));
            let r = radius * (1.0 + 0.4 * through.cos());
            DVec3::new(r * around.sin(), 0.4 * radius * through.sin(), r * around.cos())
        })
        .collect();
    b.sweep(&path, true, tube, 16, 12.0);
}

/// The point of the unit superellipsoid in direction `d` (its implicit function is homogeneous, so one division finds it).
fn superellipsoid(d: DVec3, n: f64, e: f64) -> DVec3 {
    let across = (d.x.abs().powf(2.0 / e) + d.z.abs().powf(2.0 / e)).powf(e / n);
    let f = across + d.y.abs().powf(2.0 / n);
    d * f.powf(-0.5 * n)
}

fn lathe(b: &mut Builder, radii: &[f32], height: f64, wall: f64) {
    let Some(last) = radii.len().checked_sub(1).filter(|&l| l > 0) else { return };
    let at = |i: isize| f64::from(radii[i.clamp(0, last as isize) as usize]);
    let steps = (6 * last).clamp(12, 48);
    let radius = |share: f64| {
        let x = share * last as f64;
        let i = (x.floor() as isize).min(last as isize - 1);
        let t = x - i as f64;
        let (p0, p1, p2, p3) = (at(i - 1), at(i), at(i + 1), at(i + 2));
        // Catmull-Rom; kept inside the neighbours' range so that it never reaches the axis.
        let curve = p1 + 0.5 * t * (p2 - p0 + t * (2.0 * p0 - 5.0 * p1 + 4.0 * p2 - p3 + t * (3.0 * (p1 - p2) + p3 - p0)));
        curve.clamp(0.8 * p1.min(p2), 1.2 * p1.max(p2))
    };
    let outer = (0..=steps).map(|i| i as f64 / steps as f64).map(|s| DVec2::new(radius(s), s * height));
    let mut profile = vec![DVec2::ZERO];
    profile.extend(outer);
    if wall > 0.0 {
        // The inside starts at the rim and stops a wall's thickness above the bottom.
        let floor = wall / height;
        let inner = (0..=steps).map(|i| 1.0 - (1.0 - floor) * i as f64 / steps as f64);
        profile.extend(inner.map(|s| DVec2::new(radius(s) - wall, s * height)));
        profile.push(DVec2::new(0.0, wall));
    } else {
        profile.push(DVec2::new(0.0, height));
    }
    b.lathe(&profile, 64);
}

/// Rotates the builder's extrusion axis z to +Y.
fn upright(mut b: Builder, target: &mut Builder) {
    b.turn_z_to_y();
    target.absorb(b);
}

fn prism(b: &mut Builder, sides: u32, radius: f64, star: Option<f64>, [height, twist, taper]: [f64; 3]) {
    let sides = sides.clamp(3, 24) as usize;
    let count = if star.is_some() { 2 * sides } else { sides };
    let outline: Vec<DVec2> = (0..count)
        .map(|i| {
            let (sin, cos) = (TAU * i as f64 / count as f64).sin_cos();
            let r = if i % 2 == 1 { star.unwrap_or(1.0) * radius } else { radius };
            r * DVec2::new(cos, sin)
        })
        .collect();
    let region: Vec<_> = (0..count).map(|i| [DVec2::ZERO, outline[i], outline[(i + 1) % count]]).collect();
    let layers = if twist == 0.0 && taper == 1.0 { 1 } else { 24 };
    let maps: Vec<Box<dyn Fn(DVec2) -> DVec2>> = (0..=layers)
        .map(|i| {
            let share = f64::from(i) / f64::from(layers);
            let (scale, turn) = (1.0 + (taper - 1.0) * share, DVec2::from_angle(twist.to_radians() * share));
            Box::new(move |p: DVec2| turn.rotate(p) * scale) as Box<dyn Fn(DVec2) -> DVec2>
        })
        .collect();
    let heights: Vec<(f64, &dyn Fn(DVec2) -> DVec2)> =
        maps.iter().enumerate().map(|(i, map)| (height * i as f64 / f64::from(layers), map.as_ref())).collect();
    let mut flat = Builder::default();
    flat.extrude(&region, &heights);
    upright(flat, b);
}

/// Triangles between two closed outlines with equally many points, `inner` inside `outer`, both counter-clockwise.
fn annulus(inner: &[DVec2], outer: &[DVec2], closed: bool) -> Vec<[DVec2; 3]> {
    let n = outer.len();
    let cells = if closed { n } else { n - 1 };
    (0..cells)
        .flat_map(|i| {
            let j = (i + 1) % n;
            [[inner[i], outer[i], outer[j]], [inner[i], outer[j], inner[j]]]
        })
        .collect()
}

fn gear(b: &mut Builder, teeth: u32, [radius, depth, hole, height]: [f64; 4]) {
    let teeth = teeth.clamp(5, 48) as usize;
    // Shares of a tooth's pitch at which the outline changes: root, flank up, tip, flank down; arcs in between get extra points.
    let marks = [(0.0, 0.0), (0.15, 0.0), (0.3, 0.0), (0.42, 1.0), (0.6, 1.0), (0.78, 1.0), (0.9, 0.0)];
    let (mut outer, mut inner) = (Vec::new(), Vec::new());
    for tooth in 0..teeth {
        for (share, tip) in marks {
            let turn = DVec2::from_angle(TAU * (tooth as f64 + share) / teeth as f64);
            outer.push(turn * radius * (1.0 - depth * (1.0 - tip)));
            inner.push(turn * radius * hole);
        }
    }
    let same = |p: DVec2| p;
    let mut flat = Builder::default();
    flat.extrude(&annulus(&inner, &outer, true), &[(0.0, &same), (height, &same)]);
    upright(flat, b);
}

fn spring(b: &mut Builder, [radius, tube, turns, height]: [f64; 4]) {
    let n = (turns.clamp(0.5, 12.0) * 48.0) as usize + 1;
    let path: Vec<DVec3> = (0..n)
        .map(|i| {
            let share = i as f64 / (n - 1) as f64;
            let (sin, cos) = (TAU * turns * share).sin_cos();
            DVec3::new(radius * sin, height * share, radius * cos)
        })
        .collect();
    b.sweep(&path, false, tube, 16, 4.0 * turns);
}

fn rock(b: &mut Builder, [radius, roughness, frequency]: [f64; 3], seed: u32, facets: bool) {
    // A boulder with visible facets needs few of them.
    let levels = if facets { 3 } else { 4 };
    let octaves = if facets { 2 } else { 4 };
    let surface = |d: DVec3| {
        let bump = noise::fractal(d * frequency, octaves, seed);
        // Negative displacement is tamed: noise must not reach the centre.
        d * radius * (1.0 + roughness * bump).max(0.2)
    };
    for face in icosahedron(levels) {
        let uv = |d: DVec3| DVec2::new(2.0 * (d.x.atan2(d.z) / TAU + 0.5), d.y.clamp(-1.0, 1.0).acos() / PI);
        let mut uvs = face.map(uv);
        // Across the seam the coordinate runs on instead of jumping back.
        for k in 1..3 {
            uvs[k].x -= 2.0 * ((uvs[k].x - uvs[0].x) / 2.0).round();
        }
        b.triangle([0, 1, 2].map(|k| (surface(face[k]), uvs[k])));
    }
}

/// Faces of an icosahedron on the unit sphere, each split into four `levels` times.
pub(super) fn icosahedron(levels: u32) -> Vec<[DVec3; 3]> {
    let g = 0.5 * (1.0 + 5.0f64.sqrt());
    let v = [
        (-1.0, g, 0.0),
        (1.0, g, 0.0),
        (-1.0, -g, 0.0),
        (1.0, -g, 0.0),
        (0.0, -1.0, g),
        (0.0, 1.0, g),
        (0.0, -1.0, -g),
        (0.0, 1.0, -g),
        (g, 0.0, -1.0),
        (g, 0.0, 1.0),
        (-g, 0.0, -1.0),
        (-g, 0.0, 1.0),
    ]
    .map(|(x, y, z)| DVec3::new(x, y, z).normalize());
    let f = [
        [0, 11, 5],
        [0, 5, 1],
        [0, 1, 7],
        [0, 7, 10],
        [0, 10, 11],
        [1, 5, 9],
        [5, 11, 4],
        [11, 10, 2],
        [10, 7, 6],
        [7, 1, 8],
        [3, 9, 4],
        [3, 4, 2],
        [3, 2, 6],
        [3, 6, 8],
        [3, 8, 9],
        [4, 9, 5],
        [2, 4, 11],
        [6, 2, 10],
        [8, 6, 7],
        [9, 8, 1],
    ];
    let mut faces: Vec<[DVec3; 3]> = f.iter().map(|t| t.map(|i: usize| v[i])).collect();
    for _ in 0..levels {
        let split = |&[a, b, c]: &[DVec3; 3]| {
            let (ab, bc, ca) = ((a + b).normalize(), (b + c).normalize(), (c + a).normalize());
            [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
        };
        faces = faces.iter().flat_map(split).collect();
    }
    faces
}

fn arch(b: &mut Builder, [width, height, depth, thickness]: [f64; 4]) {
    let (outer_r, inner_r) = (0.5 * width, 0.5 * width - thickness);
    let spring_line = (height - outer_r).max(0.0);
    // From the right foot over the vault to the left foot: counter-clockwise with the outer line outside.
    let line = |r: f64| {
        let mut points = Vec::new();
        if spring_line > 1e-6 {
            points.extend((0..4).map(|i| DVec2::new(r, spring_line * f64::from(i) / 4.0)));
        }
        points.extend(arc(DVec2::new(0.0, spring_line), r, 0.0, PI, 40));
        if spring_line > 1e-6 {
            points.extend((0..4).map(|i| DVec2::new(-r, spring_line * f64::from(3 - i) / 4.0)));
        }
        points
    };
    let same = |p: DVec2| p;
    b.extrude(&annulus(&line(inner_r), &line(outer_r), false), &[(-0.5 * depth, &same), (0.5 * depth, &same)]);
}

fn stairs(b: &mut Builder, steps: u32, [length, height, width]: [f64; 3]) {
    let steps = steps.clamp(2, 24);
    let at = |i: u32, j: u32| DVec2::new(length * f64::from(i), height * f64::from(j)) / f64::from(steps);
    let cells = (0..steps).flat_map(|i| (0..=i).map(move |j| (i, j)));
    let region: Vec<_> = cells
        .flat_map(|(i, j)| {
            let (a, b, c, d) = (at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1));
            [[a, b, c], [a, c, d]]
        })
        .collect();
    let same = |p: DVec2| p;
    b.extrude(&region, &[(-0.5 * width, &same), (0.5 * width, &same)]);
}

fn supershape(b: &mut Builder, lobes: u32, vertical_lobes: u32, [n, k, size]: [f64; 3]) {
    let radius = |m: f64, angle: f64| {
        let a = 0.25 * m * angle;
        let sum = a.cos().abs().powf(k) + a.sin().abs().powf(k);
        // The published curve diverges where n is small; a bounded radius keeps the body in one piece.
        sum.powf(-1.0 / n).clamp(0.15, 4.0)
    };
    let point = |u: f64, v: f64| {
        let (longitude, latitude) = (TAU * u, PI * (v - 0.5));
        let across = radius(f64::from(lobes), longitude);
        let upright = radius(f64::from(vertical_lobes), latitude);
        let d = direction(u, v);
        DVec3::new(d.x * across, d.y, d.z * across) * upright
    };
    // Both extents are found on the same grid that is meshed.
    let (nu, nv) = (128, 64);
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for j in 0..=nv {
        for i in 0..nu {
            let p = point(i as f64 / nu as f64, j as f64 / nv as f64);
            (low, high) = (low.min(p), high.max(p));
        }
    }
    let scale = size / (high - low).max_element().max(1e-9);
    b.grid(nu, nv, [2.0, 1.0], |u, v| scale * point(u, v));
}
