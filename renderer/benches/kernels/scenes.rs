//! Generated scenes and sets of rays that kernels are measured on.

use glam::{Affine3A, Quat, Vec3, Vec3A};
use renderflow_renderer::accel::{Accel, Scratch};
use renderflow_renderer::ray::Ray;

/// Name, triangles, eye and the point it looks at.
pub type Scene = (&'static str, Vec<[Vec3A; 3]>, Vec3A, Vec3A);

/// Numbers in 0..1 from a counter (PCG hash).
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    pub fn unit(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let x = (((self.0 >> 22) ^ self.0) >> ((self.0 >> 61) + 22)) as u32;
        (x >> 8) as f32 / (1 << 24) as f32
    }
}

/// A sphere of `2 rings^2` or so triangles, moved along its normals by waves of relative height `bumps`.
pub fn sphere(rings: u32, bumps: f32) -> Vec<[Vec3A; 3]> {
    let columns = 2 * rings;
    let point = |i: u32, j: u32| {
        let (theta, phi) =
            (std::f32::consts::PI * i as f32 / rings as f32, std::f32::consts::TAU * (j % columns) as f32 / columns as f32);
        let p = Vec3A::new(theta.sin() * phi.cos(), theta.cos(), theta.sin() * phi.sin());
        let wave = (9.0 * p.x).sin() * (8.0 * p.y).cos() + 0.5 * (23.0 * p.z + 11.0 * p.x).sin() + 0.2 * (71.0 * p.y).sin();
        p * (1.0 + bumps * wave)
    };
    let mut triangles = Vec::new();
    for i in 0..rings {
        for j in 0..columns {
            let [a, b, c, d] = [point(i, j), point(i, j + 1), point(i + 1, j), point(i + 1, j + 1)];
            if i > 0 {
                triangles.push([a, b, d]);
            }
            if i + 1 < rings {
                triangles.push([a, d, c]);
            }
        }
    }
    triangles
}

/// Two triangles.
fn quad(corner: Vec3A, u: Vec3A, v: Vec3A) -> [[Vec3A; 3]; 2] {
    [[corner, corner + u, corner + u + v], [corner, corner + u + v, corner + v]]
}

/// Trees of 12 x `leaves` thin triangles and a trunk each, scattered over a bumpy ground.
pub fn forest(trees: u32, leaves: u32) -> Vec<[Vec3A; 3]> {
    let mut random = Random::new(7);
    let mut triangles = Vec::new();
    let n = 64;
    let size = 20.0;
    let height = |x: f32, z: f32| 0.3 * (0.9 * x).sin() * (0.7 * z).cos();
    let ground = |i: u32, j: u32| {
        let (x, z) = (size * (i as f32 / n as f32 - 0.5), size * (j as f32 / n as f32 - 0.5));
        Vec3A::new(x, height(x, z), z)
    };
    for i in 0..n {
        for j in 0..n {
            let [a, b, c, d] = [ground(i, j), ground(i + 1, j), ground(i, j + 1), ground(i + 1, j + 1)];
            triangles.extend([[a, d, b], [a, c, d]]);
        }
    }
    for _ in 0..trees {
        let (x, z) = (size * (random.unit() - 0.5), size * (random.unit() - 0.5));
        let base = Vec3A::new(x, height(x, z), z);
        let tall = 0.8 + 1.2 * random.unit();
        for k in 0..8u8 {
            let around = |k: u8| {
                let a = f32::from(k) * std::f32::consts::TAU / 8.0;
                Vec3A::new(a.cos(), 0.0, a.sin()) * 0.04
            };
            triangles.extend(quad(base + around(k), around(k + 1) - around(k), Vec3A::Y * tall));
        }
        for _ in 0..leaves {
            // A crown shaped as a cone of leaves that hang any way.
            let up = random.unit();
            let reach = 0.45 * (1.0 - up) * random.unit().sqrt();
            let a = std::f32::consts::TAU * random.unit();
            let at = base + Vec3A::new(reach * a.cos(), tall * (0.3 + 0.8 * up), reach * a.sin());
            let turn = Quat::from_euler(glam::EulerRot::XYZ, 6.3 * random.unit(), 6.3 * random.unit(), 6.3 * random.unit());
            let place = Affine3A::from_scale_rotation_translation(Vec3::new(0.05, 0.02, 1.0), turn, at.into());
            let corner = |x: f32, y: f32| place.transform_point3a(Vec3A::new(x, y, 0.0));
            triangles.extend([
                [corner(-1.0, 0.0), corner(0.0, -1.0), corner(1.0, 0.0)],
                [corner(-1.0, 0.0), corner(1.0, 0.0), corner(0.0, 1.0)],
            ]);
        }
    }
    triangles
}

/// A closed room with `count` bumpy objects and tables of boxes in it.
pub fn room(count: u32, rings: u32) -> Vec<[Vec3A; 3]> {
    let mut random = Random::new(11);
    let mut triangles = Vec::new();
    let mut block = |low: Vec3A, high: Vec3A| {
        let s = high - low;
        let (x, y, z) = (Vec3A::X * s.x, Vec3A::Y * s.y, Vec3A::Z * s.z);
        for side in
            [quad(low, x, y), quad(low, y, z), quad(low, z, x), quad(high, -y, -x), quad(high, -z, -y), quad(high, -x, -z)]
        {
            triangles.extend(side);
        }
    };
    block(Vec3A::new(-3.0, 0.0, -4.0), Vec3A::new(3.0, 2.6, 4.0));
    let mut objects = Vec::new();
    for i in 0..count {
        let (x, z) = (5.0 * random.unit() - 2.5, 7.0 * random.unit() - 3.5);
        let top = 0.3 + 0.6 * random.unit();
        block(Vec3A::new(x - 0.3, top - 0.04, z - 0.3), Vec3A::new(x + 0.3, top, z + 0.3));
        for (dx, dz) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
            let leg = Vec3A::new(x + 0.27 * dx, 0.0, z + 0.27 * dz);
            block(leg - Vec3A::new(0.02, 0.0, 0.02), leg + Vec3A::new(0.02, top - 0.04, 0.02));
        }
        let size = 0.1 + 0.15 * random.unit();
        objects.push((size, Vec3A::new(x, top + 1.3 * size, z), 0.02 * (i % 4) as f32));
    }
    for (size, at, bumps) in objects {
        triangles.extend(sphere(rings, bumps).into_iter().map(|t| t.map(|p| at + p * size)));
    }
    triangles
}

/// The scenes.
pub fn all() -> Vec<Scene> {
    vec![
        ("forest", forest(200, 740), Vec3A::new(7.0, 2.5, 8.0), Vec3A::new(0.0, 0.6, 0.0)),
        ("room", room(24, 64), Vec3A::new(-2.5, 1.7, -3.5), Vec3A::new(0.5, 0.7, 1.0)),
        ("sphere", sphere(370, 0.05), Vec3A::new(0.3, 0.8, 2.4), Vec3A::ZERO),
        ("sphere-1m", sphere(720, 0.05), Vec3A::new(0.3, 0.8, 2.4), Vec3A::ZERO),
    ]
}

/// `n` x `n` camera rays in 4 x 4 tiles; bounces from what they hit, cosine-distributed, in that order and shuffled; the bounces
/// again, as shadow rays.
pub fn rays(tree: &Accel, eye: Vec3A, at: Vec3A, n: u32) -> [(&'static str, Vec<Ray>); 4] {
    let mut random = Random::new(3);
    let forward = (at - eye).normalize();
    let right = forward.cross(Vec3A::Y).normalize();
    let up = right.cross(forward);
    let mut scratch = Scratch::default();
    let (mut primary, mut diffuse) = (Vec::new(), Vec::new());
    for tile in 0..n * n / 16 {
        for k in 0..16 {
            let (x, y) = (tile % (n / 4) * 4 + k % 4, tile / (n / 4) * 4 + k / 4);
            let offset = |p: u32| (p as f32 + 0.5) / n as f32 * 2.0 - 1.0;
            let ray = Ray::new(eye, (forward + 0.45 * offset(x) * right - 0.45 * offset(y) * up).normalize());
            primary.push(ray);
            let Some(hit) = tree.closest(&ray, &mut scratch) else { continue };
            let [a, b, c] = tree.corners(&hit);
            let n = (b - a).cross(c - a).normalize_or_zero();
            let n = if n.dot(ray.direction) > 0.0 { -n } else { n };
            let (u, v) = (random.unit(), std::f32::consts::TAU * random.unit());
            let (t, s) = n.any_orthonormal_pair();
            let d = t * (u.sqrt() * v.cos()) + s * (u.sqrt() * v.sin()) + n * (1.0 - u).sqrt();
            diffuse.push(Ray::new(ray.at(hit.t) + n * 1e-3, d.normalize()));
        }
    }
    let mut shuffled = diffuse.clone();
    for i in (1..shuffled.len()).rev() {
        shuffled.swap(i, (random.unit() * i as f32) as usize);
    }
    [("primary", primary), ("diffuse", diffuse.clone()), ("shuffled", shuffled), ("shadow", diffuse)]
}
