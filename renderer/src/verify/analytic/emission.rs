//! Scenes lit by their own surfaces, with the radiance known on paper.

use super::{ALBEDO, Case, EDGE, LIGHT, Paper, everywhere, flat, ground_of, nearly_flat, plain, rgb, sphere};
use crate::verify::scenes::{self, Part};
use glam::{Affine3A, DVec2, DVec3, Quat, Vec2, Vec3};
use renderflow_frame::Environment;
use renderflow_scenes::loaded::{AlphaMask, Encoding, Texture, Wrap};
use renderflow_scenes::shapes::Shape;
use renderflow_scenes::{Material, Mesh, TextureSlot};

/// A black surface that emits.
fn lamp(radiance: DVec3) -> Material {
    Material { emissive: rgb(radiance), ..scenes::diffuse([0.0; 3]) }
}

/// The rectangle of half lengths `half` in the plane y = `height`, facing down; u runs along x, v along z.
fn ceiling(half: DVec2, height: f64) -> Mesh {
    let corner = |x: f64, z: f64| DVec3::new(x * half.x, height, z * half.y).as_vec3();
    Mesh {
        name: "ceiling".into(),
        positions: vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)],
        uvs: vec![Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Mesh::default()
    }
}

/// Form factor from a patch of the plane y = 0 at `p` to the rectangle `low..high` of (x, z) at `height`, parallel to it: the sum
/// over its corners of Howell's configuration factor B-4.
fn rectangle_share(p: DVec3, low: DVec2, high: DVec2, height: f64) -> f64 {
    let corner = |a: f64, b: f64| {
        let (a, b) = (a / height, b / height);
        let (ra, rb) = ((1.0 + a * a).sqrt(), (1.0 + b * b).sqrt());
        (a / ra * (b / ra).atan() + b / rb * (a / rb).atan()) / std::f64::consts::TAU
    };
    let (x0, x1, z0, z1) = (low.x - p.x, high.x - p.x, low.y - p.z, high.y - p.z);
    corner(x1, z1) - corner(x0, z1) - corner(x1, z0) + corner(x0, z0)
}

/// Slot 0 with the coordinates of the mesh.
fn slot() -> Option<TextureSlot> {
    Some(TextureSlot::default())
}

/// Every scene with its answer.
pub(super) fn cases() -> Vec<Case> {
    let mut all = Vec::new();
    let floor = || Part::new(Shape::Plane { size: 10.0 }, scenes::diffuse(rgb(ALBEDO)), Affine3A::IDENTITY);
    let hung = |mesh, material| Part { mesh, material, transform: Affine3A::IDENTITY };
    let skies = [("black", flat(DVec3::ZERO), 0.0), ("flat", flat(LIGHT), 1.0), ("sampled", nearly_flat(LIGHT), 1.0)];
    let below = |height: f64| scenes::camera([0.1, 0.5 * height as f32, 0.4], [0.15, 0.0, 0.05], 8.0, EDGE, EDGE);

    // Inside a closed box whose walls all emit E and reflect the share a, n bounces give E (1 + a + ... + a^n).
    for (albedo, bounces) in [(0.5_f64, 1), (0.5, 4), (0.9, 8), (0.8, 1000)] {
        let factor = (1.0 - albedo.powi(bounces + 1)) / (1.0 - albedo);
        for (turned, double_sided) in [("out", true), ("in", false)] {
            let shape = Shape::Box { size: [2.0, 3.0, 1.5], bevel: 0.0 };
            let material = Material { emissive: rgb(LIGHT), double_sided, ..scenes::diffuse([albedo as f32; 3]) };
            let mut part = Part::new(shape, material, Affine3A::IDENTITY);
            if !double_sided {
                part.mesh.triangles.iter_mut().for_each(|t| t.reverse());
                part.mesh.normals.clear();
            }
            let look = scenes::camera([0.1, -0.2, 0.3], [0.4, -0.9, -0.2], 60.0, EDGE, EDGE);
            let name = format!("inside a glowing box facing {turned}, albedo {albedo}, {bounces} bounces");
            all.push(Case {
                max_bounces: bounces as u32,
                lights_alone: false,
                ..plain(&name, vec![part], flat(DVec3::ZERO), look, everywhere(LIGHT * factor))
            });
        }
    }

    // A bright rectangle above a floor takes the place of its share of the sky.
    for (half, height) in [(DVec2::new(1.0, 0.5), 1.0), (DVec2::new(0.2, 2.0), 0.7), (DVec2::splat(4.0), 2.0)] {
        let radiance = DVec3::new(3.0, 1.0, 0.5);
        for (sky, environment, light) in skies.clone() {
            let parts = vec![floor(), hung(ceiling(half, height), lamp(radiance))];
            let paper: Paper = Box::new(move |shot, x, y| {
                let share = rectangle_share(shot.point(x, y), -half, half, height);
                Some(ALBEDO * (radiance * share + LIGHT * light * (1.0 - share)))
            });
            let name = format!("floor below a lamp of {half} m at height {height}, {sky} sky");
            all.push(Case { bias: 3e-4, ..plain(&name, parts, environment, below(height), paper) });
        }
    }

    // The irradiance of a sphere is pi L (r / d)^2 times the cosine; that of a convex polyhedron far away has its mean section, a
    // quarter of its surface.
    for distance in [2.0_f64, 8.0] {
        let radiance = LIGHT * (50.0 * distance * distance);
        let transform = Affine3A::from_scale_rotation_translation(
            Vec3::splat(0.05),
            Quat::from_rotation_x(0.7),
            Vec3::new(0.4, distance as f32, 0.3),
        );
        let bulb = Part { transform, ..Part::new(sphere(), lamp(radiance), Affine3A::IDENTITY).flat() };
        let corners = |t: &[u32; 3]| t.map(|v| transform.transform_point3(bulb.mesh.positions[v as usize]).as_dvec3());
        let area = |[a, b, c]: [DVec3; 3]| 0.5 * (b - a).cross(c - a).length();
        let surface: f64 = bulb.mesh.triangles.iter().map(|t| area(corners(t))).sum();
        let section = 0.25 * surface;
        for (sky, environment, light) in skies.clone() {
            let centre = transform.translation.as_dvec3();
            let paper: Paper = Box::new(move |shot, x, y| {
                let to = centre - shot.point(x, y);
                let d2 = to.length_squared();
                // The sphere hides a little of the sky.
                let share = section / (std::f64::consts::PI * d2) * to.y / d2.sqrt();
                Some(ALBEDO * (radiance * share + LIGHT * light * (1.0 - share)))
            });
            let look = scenes::camera([0.0, 1.0, 2.0], [0.0; 3], 20.0, EDGE, EDGE);
            let name = format!("floor below a small bright sphere at height {distance}, {sky} sky");
            let parts = vec![ground_of(20.0, ALBEDO), bulb.clone()];
            all.push(Case { bias: 2e-3, scattering_alone: false, ..plain(&name, parts, environment.clone(), look, paper) });
        }
    }

    // A lamp with a red and a blue half, near enough that each half counts with its own form factor.
    let (half, height) = (DVec2::new(0.8, 0.6), 0.5);
    let texels = (0..64 * 2).map(|i| if i % 64 < 32 { [255, 51, 0, 255] } else { [0, 51, 255, 255] }).collect();
    let halves = Texture::from_rgba8("halves", [64, 2], texels, Encoding::Linear, [Wrap::Clamp; 2]);
    let lamp_of_halves = Material { emissive_texture: slot(), ..lamp(LIGHT) };
    let paper: Paper = Box::new(move |shot, x, y| {
        let p = shot.point(x, y);
        let left = rectangle_share(p, -half, DVec2::new(0.0, half.y), height);
        let right = rectangle_share(p, DVec2::new(0.0, -half.y), half, height);
        Some(ALBEDO * LIGHT * DVec3::new(left, 0.2 * (left + right), right))
    });
    let parts = vec![floor(), hung(ceiling(half, height), lamp_of_halves)];
    all.push(Case {
        bias: 1e-3,
        textures: vec![halves],
        ..plain("floor below a lamp with a red and a blue half", parts, flat(DVec3::ZERO), below(height), paper)
    });

    // A sheet of which half is cut out, in a fine pattern, hides half of what it covers: of a sky, and of a lamp above it.
    let checker = || {
        let texels = (0..128 * 128).map(|i| [255, 255, 255, if (i % 128 + i / 128) % 2 == 0 { 255 } else { 0 }]).collect();
        Texture::from_rgba8("checker", [128, 128], texels, Encoding::Linear, [Wrap::Repeat; 2])
    };
    let (half, height) = (DVec2::splat(1.0), 0.5);
    let alpha_mask = Some(AlphaMask { cutoff: 0.5, factor: 1.0 });
    let sheet = Material { base_color_texture: slot(), alpha_mask, ..scenes::diffuse([0.0; 3]) };
    for (sky, environment) in [("flat", flat(LIGHT)), ("sampled", nearly_flat(LIGHT))] {
        let paper: Paper = Box::new(move |shot, x, y| {
            Some(ALBEDO * LIGHT * (1.0 - 0.5 * rectangle_share(shot.point(x, y), -half, half, height)))
        });
        let parts = vec![floor(), hung(ceiling(half, height), sheet.clone())];
        let name = format!("floor below a sheet with holes, {sky} sky");
        // Each point sees some hundred holes, not evenly: a pattern of its own, found against ten times as fine a one.
        all.push(Case { bias: 2e-3, textures: vec![checker()], ..plain(&name, parts, environment, below(height), paper) });
    }
    // What is cut out of a lamp does not shine.
    let cut_lamp = Material { emissive: rgb(LIGHT), ..sheet.clone() };
    let paper: Paper =
        Box::new(move |shot, x, y| Some(ALBEDO * LIGHT * (0.5 * rectangle_share(shot.point(x, y), -half, half, height))));
    let parts = vec![floor(), hung(ceiling(half, height), cut_lamp)];
    let dark = Environment::constant([0.0; 3]);
    all.push(Case {
        bias: 2e-3,
        textures: vec![checker()],
        ..plain("floor below a lamp with holes", parts, dark.clone(), below(height), paper)
    });
    let gone = Material { alpha_mask: Some(AlphaMask { cutoff: 0.5, factor: 0.25 }), ..lamp(LIGHT) };
    let parts = vec![floor(), hung(ceiling(half, height), gone)];
    all.push(plain("floor below a lamp that is cut out altogether", parts, dark, below(height), everywhere(DVec3::ZERO)));
    all
}
