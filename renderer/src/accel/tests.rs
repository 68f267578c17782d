//! All levels find the same hits, bit for bit; so do trees that were refitted.

use super::*;
use glam::{Affine3A, Quat, Vec3};

/// Numbers in 0..1 (PCG).
struct Random(u64);

impl Random {
    fn unit(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let x = (((self.0 >> 22) ^ self.0) >> ((self.0 >> 61) + 22)) as u32;
        (x >> 8) as f32 / (1 << 24) as f32
    }

    /// In -1..1 each.
    fn point(&mut self) -> Vec3A {
        Vec3A::new(self.unit(), self.unit(), self.unit()) * 2.0 - 1.0
    }
}

/// Scenes from single triangles to thousands, among them equal and coplanar ones, needles, and boxes within boxes.
fn scenes() -> Vec<(&'static str, Vec<[Vec3A; 3]>)> {
    let mut random = Random(5);
    let mut soup = |n: usize, size: f32| -> Vec<[Vec3A; 3]> {
        let mut corner = |at: Vec3A| at + size * random.point();
        (0..n)
            .map(|i| {
                let f = i as f32;
                let at = Vec3A::new((0.7 * f).sin(), (1.3 * f).sin(), (2.9 * f).cos());
                [corner(at), corner(at), corner(at)]
            })
            .collect()
    };
    let flat = |i: u16, j: u16| Vec3A::new(f32::from(i) / 16.0 - 1.0, 0.25, f32::from(j) / 16.0 - 1.0);
    let grid: Vec<[Vec3A; 3]> = (0..32)
        .flat_map(|i| (0..32).map(move |j| (i, j)))
        .flat_map(|(i, j)| {
            let [a, b, c, d] = [flat(i, j), flat(i + 1, j), flat(i, j + 1), flat(i + 1, j + 1)];
            [[a, b, d], [a, d, c]]
        })
        .collect();
    let twice: Vec<_> = grid.iter().chain(&grid).copied().collect();
    let one = soup(1, 1.0)[0];
    let mut all = vec![
        ("nothing", Vec::new()),
        ("one", vec![one]),
        ("nine equal", vec![one; 9]),
        ("many equal", vec![one; 3000]),
        ("a few", soup(13, 0.5)),
        ("many", soup(4000, 0.05)),
        ("large among small", soup(500, 0.02).into_iter().chain(soup(20, 2.0)).collect()),
        ("needles", soup(600, 1.0).into_iter().map(|[a, b, _]| [a, b, a + (b - a) * 0.5 + Vec3A::splat(1e-4)]).collect()),
        ("points and edges", soup(50, 0.5).into_iter().map(|[a, b, _]| [a, b, b]).collect()),
        ("a grid", grid),
        ("a grid twice", twice),
        ("nested", (0..6000u16).map(|i| one.map(|c| c * 0.999f32.powi(i.into()))).collect()),
    ];
    let far: Vec<[Vec3A; 3]> = all[5].1.iter().map(|t| t.map(|c| c * 1e-3 + Vec3A::new(100.0, 0.0, 3.0))).collect();
    all.push(("small and far", far));
    all
}

/// Rays that hit and miss, along axes, in planes of boxes, from corners, and what no ray should be.
fn rays(triangles: &[[Vec3A; 3]]) -> Vec<Ray> {
    let mut random = Random(9);
    let mut rays = Vec::new();
    let axes = [Vec3A::X, Vec3A::NEG_Y, Vec3A::Z, Vec3A::new(1.0, -0.0, 1e-30), Vec3A::new(0.0, -1.0, 1.0).normalize()];
    for i in 0..1500usize {
        let origin = 3.0 * random.point();
        let target = match triangles.get(i % triangles.len().max(1)) {
            Some([a, b, c]) => {
                let (u, v) = (random.unit(), random.unit());
                // Now and then a corner or a point of an edge.
                match i % 7 {
                    0 => *a,
                    1 => *a + (*b - *a) * u,
                    _ => *a + (*b - *a) * u + (*c - *a) * v * (1.0 - u),
                }
            }
            None => random.point(),
        };
        rays.push(Ray::new(origin, (target - origin).normalize_or(Vec3A::X)));
        let axis = axes[i % axes.len()];
        rays.push(Ray::new(target - axis * 2.0 * random.unit(), axis));
    }
    for bad in [f32::NAN, f32::INFINITY, 0.0, 1e-38, 1e30] {
        rays.push(Ray::new(Vec3A::splat(bad), Vec3A::Z));
        rays.push(Ray::new(Vec3A::ZERO, Vec3A::new(0.3, bad, 0.2)));
        rays.push(Ray::new(Vec3A::ZERO, Vec3A::splat(bad)));
    }
    rays
}

/// Bits of everything in a hit.
fn bits(hit: Option<Hit>) -> Option<([u32; 6], u8, u32)> {
    hit.map(|h| {
        let [u, v, w] = h.weights.map(f32::to_bits);
        ([h.t.to_bits(), u, v, w, h.primitive, h.leaf], h.lane, h.instance)
    })
}

/// Slow and plain: every triangle in double precision.
fn nearest_of_all(triangles: &[[Vec3A; 3]], ray: &Ray) -> Option<f64> {
    let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
    let hits = triangles.iter().filter_map(|t| {
        let [a, b, c] = t.map(|p| p.as_dvec3() - o);
        let [u, v, w] = [c.cross(b).dot(d), a.cross(c).dot(d), b.cross(a).dot(d)];
        // Well inside: rays that pass near an edge may take the one or the other side.
        let inside = u.min(v).min(w) > 1e-3 * (u + v + w).abs() || u.max(v).max(w) < -1e-3 * (u + v + w).abs();
        let t = (a * u + b * v + c * w).dot(d) / ((u + v + w) * d.dot(d));
        (inside && t > 0.0).then_some(t)
    });
    hits.reduce(f64::min)
}

#[test]
fn levels_agree_bit_for_bit() {
    let mut scratch = Scratch::default();
    println!("{:?}", Level::available());
    for (name, triangles) in scenes() {
        let plain = Accel::build_for(&triangles, Level::PORTABLE);
        let trees: Vec<Accel> = Level::available().iter().map(|&level| Accel::build_for(&triangles, level)).collect();
        let (mut hits, mut wrong) = (0, 0);
        let odd = |c: &Candidate| c.hit.primitive % 2 == 1 && c.front;
        for ray in rays(&triangles) {
            let expected = plain.closest(&ray, &mut scratch);
            let filtered = plain.closest_where(&ray, &mut scratch, odd);
            hits += usize::from(expected.is_some());
            assert_eq!(expected.is_some(), plain.occluded(&ray, &mut scratch), "{name}: {ray:?}");
            assert_eq!(filtered.is_some(), plain.occluded_where(&ray, &mut scratch, odd), "{name}: {ray:?}");
            if let Some(hit) = expected {
                assert!(hit.t > 0.0 && hit.t.is_finite() && hit.weights.iter().all(|w| w.is_finite()), "{name}: {ray:?}");
                assert_eq!(plain.corners(&hit), triangles[hit.primitive as usize]);
            }
            if ray.direction.is_normalized() && ray.origin.is_finite() && triangles.len() < 700 {
                let found = expected.map_or(f64::INFINITY, |h| h.t.into());
                wrong += usize::from(nearest_of_all(&triangles, &ray).is_some_and(|t| found > t + 1e-4 * (1.0 + t)));
            }
            for tree in &trees {
                let what = || format!("{name}, {}: {ray:?}", tree.level.name());
                assert_eq!(bits(expected), bits(tree.closest(&ray, &mut scratch)), "{}", what());
                assert_eq!(bits(filtered), bits(tree.closest_where(&ray, &mut scratch, odd)), "{}", what());
                assert_eq!(expected.is_some(), tree.occluded(&ray, &mut scratch), "{}", what());
                assert_eq!(filtered.is_some(), tree.occluded_where(&ray, &mut scratch, odd), "{}", what());
            }
        }
        println!("{name}: {hits} hits, {:.1} bytes a triangle", plain.memory() as f64 / triangles.len().max(1) as f64);
        assert!(hits > 100 || triangles.is_empty() || name == "points and edges", "{name}: {hits}");
        // Needles are thinner than the roundings of rays.
        assert!(wrong == 0 || name == "needles", "{name}: {wrong}");
    }
}

/// Bits of a whole tree.
fn tree_bits(tree: &Accel) -> Vec<u32> {
    let nodes = tree.nodes.iter().flat_map(|n| n.bounds.iter().flatten().map(|b| b.to_bits()).chain(n.children));
    let leaves = tree.triangles().flatten().flat_map(|c| c.to_array()).map(f32::to_bits);
    nodes.chain(leaves).collect()
}

#[test]
fn refitted_trees_find_what_new_ones_do() {
    let turn = Affine3A::from_scale_rotation_translation(Vec3::new(1.5, 0.7, 1.0), Quat::from_rotation_y(1.0), Vec3::X);
    let mut scratch = Scratch::default();
    for (name, triangles) in scenes() {
        let mut tree = Accel::build(&triangles);
        let before = tree_bits(&tree);
        assert_eq!(tree.quality(), 1.0);
        let moved: Vec<_> = triangles
            .iter()
            .enumerate()
            // Every third triangle goes another way.
            .map(|(i, t)| t.map(|c| if i % 3 == 0 { c + Vec3A::new(0.3, 0.1, 0.0) } else { turn.transform_point3a(c) }))
            .collect();
        tree.refit(&moved);
        let new = Accel::build(&moved);
        println!("{name}: cost {:.2} of that when built", tree.quality());
        assert!(tree.quality() > 0.0 && (name != "many" || tree.quality() > 1.5), "{name}: {}", tree.quality());
        for ray in rays(&moved) {
            let [a, b] = [&tree, &new].map(|t| t.closest(&ray, &mut scratch));
            // The name of the leaf is the tree's own.
            assert_eq!(a.map(|h| (h.t, h.primitive, h.weights)), b.map(|h| (h.t, h.primitive, h.weights)), "{name}: {ray:?}");
            assert_eq!(a.is_some(), tree.occluded(&ray, &mut scratch), "{name}: {ray:?}");
        }
        tree.refit(&triangles);
        assert_eq!(tree.quality(), 1.0);
        assert!(before == tree_bits(&tree), "{name}: moving there and back changes the tree");
    }
}

#[test]
fn packets_find_what_single_rays_do() {
    let mut random = Random(17);
    let mut scratch = Scratch::default();
    for (name, triangles) in scenes() {
        let trees: Vec<Accel> = Level::available().iter().map(|&level| Accel::build_for(&triangles, level)).collect();
        let (mut hits, mut together) = (0, 0);
        for k in 0..200 {
            let eye = 3.0 * random.point();
            let at = triangles.get(k * 7919 % triangles.len().max(1)).map_or(Vec3A::ZERO, |t| (t[0] + t[1] + t[2]) / 3.0);
            // From rays hardly apart to rays all over the place; now and then from origins of their own, and fewer than sixteen.
            let (spread, apart) = (10f32.powf(-4.0 * random.unit()), if k % 3 == 0 { 0.05 } else { 0.0 });
            let mut rays: Vec<Ray> = (0..if k % 5 == 0 { 21 } else { 16 })
                .map(|_| Ray::new(eye + apart * random.point(), (at - eye + spread * random.point()).normalize_or(Vec3A::Y)))
                .collect();
            match k % 17 {
                0 => rays[3] = Ray::new(Vec3A::NAN, Vec3A::X),
                1 => rays.iter_mut().for_each(|r| r.direction = Vec3A::new(0.0, -0.0, 1.0)),
                _ => {
                    let mut all = [None; 16];
                    let query = PacketQuery { tree: &trees[0], rays: &rays[..16], hits: &mut all, scratch: &mut scratch };
                    together += usize::from(simd::run(Level::best(), query));
                }
            }
            let expected: Vec<_> = rays.iter().map(|ray| bits(trees[0].closest(ray, &mut scratch))).collect();
            hits += expected.iter().flatten().count();
            for tree in &trees {
                let mut found = vec![None; rays.len()];
                tree.closest_packet(&rays, &mut found, &mut scratch);
                let found: Vec<_> = found.into_iter().map(bits).collect();
                assert_eq!(expected, found, "{name}, {}: {rays:?}", tree.level.name());
            }
        }
        println!("{name}: {hits} hits, {together} packets traced as one");
        assert!(together > 50, "{name}: {together}");
        assert!(hits > 100 || triangles.is_empty() || name == "points and edges", "{name}: {hits}");
    }
}

/// Trees over instances find the same with every level, and whether meshes are shared or not the first of coincident instances.
#[test]
fn instances_agree_bit_for_bit() {
    let (name, mesh) = scenes().swap_remove(6);
    let mut random = Random(3);
    let mut placements: Vec<Placement> = (0..60)
        .filter_map(|i| {
            let turn = Quat::from_rotation_z(6.0 * random.unit());
            let scale = Vec3::new(0.2 + 0.2 * random.unit(), -0.3, 0.3);
            Placement::new(i, 0, Affine3A::from_scale_rotation_translation(scale, turn, (2.0 * random.point()).into()))
        })
        .collect();
    let again: Vec<Placement> = (60..).zip(&placements).filter_map(|(i, p)| Placement::new(i, 0, p.transform)).collect();
    placements.extend(again);
    let mut scratch = Scratch::default();
    let all = Level::available().iter().map(|&level| {
        let mut instances = Instances::new(vec![Accel::build_for(&mesh, level)], placements.clone());
        instances.set_level(level);
        instances
    });
    let all: Vec<Instances> = all.collect();
    let mut hits = 0;
    for ray in rays(&mesh) {
        let odd = |c: &Candidate| c.hit.primitive % 2 == 1 && c.front;
        let find = |i: &Instances, scratch: &mut Scratch| {
            let hit = i.closest(&ray, scratch, f32::INFINITY, 0);
            assert_eq!(hit.is_some(), i.occluded(&ray, scratch));
            let filtered = i.closest_where(&ray, scratch, f32::INFINITY, 0, odd);
            assert_eq!(filtered.is_some(), i.occluded_where(&ray, scratch, odd));
            (hit, bits(hit), bits(filtered))
        };
        let expected = find(&all[0], &mut scratch);
        if let Some(hit) = expected.0 {
            hits += 1;
            assert!(all[0].of(&hit).0.instance < 60, "{name}: of two at one place the first is hit");
        }
        for instances in &all[1..] {
            assert_eq!(expected, find(instances, &mut scratch), "{ray:?}");
        }
    }
    assert!(hits > 300, "{hits}");
}
