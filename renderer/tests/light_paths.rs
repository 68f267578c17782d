//! Light paths find what paths from the camera find, with less noise, and are not traced where they would bring nothing.

mod common;

use common::{camera, compile, diffuse, plane, render_with, scene, sphere, sunny};
use glam::{Affine3A, Quat, Vec2, Vec3, Vec3A};
use renderflow_frame::{Environment, Frame, Image};
use renderflow_renderer::{DirectLight, Filter, Mode, Sampler, Settings};
use renderflow_scenes::loaded::{AlphaMask, Encoding, PunctualKind, PunctualLight, Texture, Wrap};
use renderflow_scenes::shapes::Shape;
use renderflow_scenes::{LoadedScene, Material, Mesh, Principled, TextureSlot};
use std::f32::consts::FRAC_PI_2;

const SIZE: [usize; 2] = [24, 16];
/// Pixels of a block along each axis.
const BLOCK: usize = 8;

fn metal(roughness: f32) -> Material {
    Material::from(Principled {
        metallic: 1.0,
        roughness,
        base_color: Vec3A::from_array([0.9, 0.8, 0.6]),
        ..Principled::default()
    })
}

fn place(x: f32, y: f32, z: f32, scale: Vec3) -> Affine3A {
    Affine3A::from_scale_rotation_translation(scale, Quat::from_rotation_z(0.3), Vec3::new(x, y, z))
}

/// A rough floor, shiny bodies that light each other and it, and `more`.
fn caustics(more: Vec<(renderflow_scenes::Mesh, Material, Affine3A)>) -> LoadedScene {
    let mut parts = vec![
        (plane(6.0), diffuse([0.7, 0.6, 0.5]), Affine3A::IDENTITY),
        (sphere(16, true), metal(0.15), place(-0.7, 0.6, 0.0, Vec3::splat(0.6))),
        // A glossy ellipsoid of facets whose normals do not follow them.
        (
            sphere(5, true),
            Material::from(Principled { roughness: 0.2, clearcoat: 0.5, ..Principled::default() }),
            place(0.8, 0.5, 0.3, Vec3::new(0.6, 0.5, 0.4)),
        ),
    ];
    parts.extend(more);
    scene(parts, sunny(), camera([0.4, 1.6, 3.4], [0.0, 0.3, 0.2], 40.0, SIZE[0], SIZE[1]))
}

/// Pictures by block, of many seeds: means and squared standard errors.
fn blocks(loaded: &mut LoadedScene, settings: &Settings, seeds: u64) -> Vec<(f64, f64)> {
    let pictures: Vec<Vec<f64>> = (0..seeds)
        .map(|seed| {
            loaded.seed = 100 + seed;
            let raw = render_with(&compile(loaded), settings).0.raw.expect("a picture");
            let mut sums = vec![0.0; SIZE[0] / BLOCK * (SIZE[1] / BLOCK)];
            for (i, pixel) in raw.pixels.iter().enumerate() {
                let at = i / SIZE[0] / BLOCK * (SIZE[0] / BLOCK) + i % SIZE[0] / BLOCK;
                sums[at] += pixel.iter().map(|&v| f64::from(v)).sum::<f64>() / (3 * BLOCK * BLOCK) as f64;
            }
            sums
        })
        .collect();
    let n = seeds as f64;
    (0..pictures[0].len())
        .map(|block| {
            let values = || pictures.iter().map(|picture| picture[block]);
            let mean = values().sum::<f64>() / n;
            (mean, values().map(|v| (v - mean).powi(2)).sum::<f64>() / (n * (n - 1.0)))
        })
        .collect()
}

/// With and without light paths the means of all blocks agree.
fn assert_same(name: &str, mut loaded: LoadedScene, settings: Settings) {
    let with = blocks(&mut loaded, &settings, 16);
    let without = blocks(&mut loaded, &Settings { light_paths: false, spp: 2 * settings.spp, ..settings }, 16);
    assert!(render_with(&compile(&loaded), &settings).1.light_paths > 0, "{name}: none");
    let mut worst = 0.0f64;
    for ((a, va), (b, vb)) in with.iter().zip(&without) {
        let error = (va + vb).sqrt();
        assert!(error < 0.02 * b, "{name}: too noisy to tell, {error} of {b}");
        worst = worst.max(((a - b) / error).abs());
    }
    let total = |blocks: &[(f64, f64)]| blocks.iter().fold((0.0, 0.0), |(m, v), b| (m + b.0, v + b.1));
    let ((a, va), (b, vb)) = (total(&with), total(&without));
    println!("{name}: {:+.5} +- {:.5} of the mean, worst block {worst:.1} standard errors", a / b - 1.0, (va + vb).sqrt() / b);
    assert!(worst < 4.5 && (a - b).abs() < 3.5 * (va + vb).sqrt(), "{name}: {with:?} against {without:?}");
}

#[test]
fn pictures_converge_to_the_same() {
    let settings = Settings { spp: 128, ..Settings::default() };
    assert_same("bodies", caustics(vec![]), settings);
    assert_same("bodies, two surfaces", caustics(vec![]), Settings { max_bounces: 2, ..settings });
    assert_same("published", caustics(vec![]), Settings { bsdf: Mode::Published, ..settings });
    assert_same("independent numbers", caustics(vec![]), Settings { sampler: Sampler::Independent, ..settings });
}

#[test]
fn so_they_do_with_emitters_holes_and_instances() {
    let settings = Settings { spp: 128, ..Settings::default() };
    let lamp = Material { emissive: [20.0, 15.0, 10.0], ..diffuse([0.0; 3]) };
    assert_same("a lamp", caustics(vec![(sphere(6, false), lamp, place(0.1, 1.6, 0.5, Vec3::splat(0.15)))]), settings);
    // Seen from above only, and where it is cut away nothing is.
    let one_sided = Material { double_sided: false, ..metal(0.3) };
    let sheet = Affine3A::from_rotation_translation(Quat::from_rotation_x(0.9), Vec3::new(0.2, 0.7, -1.0));
    assert_same("a one-sided sheet", caustics(vec![(plane(1.2), one_sided, sheet)]), settings);
    // Two of the same, one of them a mirror image, in trees of their own.
    let mut shared = caustics(vec![]);
    shared.instances.push(common::instance(1, 1, place(0.2, 0.3, 1.1, Vec3::new(-0.3, 0.3, 0.3))));
    let sharing = renderflow_renderer::Sharing::Always;
    let both = [renderflow_renderer::Sharing::Never, sharing].map(|sharing| {
        let scene = renderflow_renderer::RenderScene::compile_with(&shared, sharing).expect("consistent");
        let frame = render_with(&scene, &Settings { spp: 64, ..settings }).0;
        mean(&frame)
    });
    assert!((both[0] / both[1] - 1.0).abs() < 1e-3, "{both:?}");
    assert_same("a mirrored instance", shared, settings);
}

fn glass(roughness: f32) -> Material {
    Material::from(Principled { transmission: 1.0, roughness, base_color: Vec3A::ONE, ..Principled::default() })
}

/// Light goes through bodies, one in the light of the other, and through what they absorb; panes and sheets stand before the
/// light, between the bodies and before the camera.
#[test]
fn so_they_do_through_glass() {
    let settings = Settings { spp: 128, ..Settings::default() };
    let ball = |material: Material, x: f32| (sphere(16, true), material, place(x, 0.45, 0.9, Vec3::splat(0.4)));
    assert_same("a ball", caustics(vec![ball(glass(0.3), 0.0)]), settings);
    let tinted = Material { absorption: [0.5, 2.0, 4.0], ..glass(0.2) };
    let half = Material { surface: Principled { transmission: 0.5, ..glass(0.25).surface }, ..Material::default() };
    assert_same("tinted balls", caustics(vec![ball(tinted.clone(), -0.3), ball(half, 0.6)]), settings);
    assert_same("published", caustics(vec![ball(tinted.clone(), 0.0)]), Settings { bsdf: Mode::Published, ..settings });
    // Facets whose normals lean, and a body that does not close.
    let coarse = (sphere(4, true), glass(0.25), place(0.1, 0.45, 0.9, Vec3::new(0.5, 0.4, 0.3)));
    let open = Affine3A::from_rotation_translation(Quat::from_rotation_x(0.5), Vec3::new(0.2, 0.5, 1.0));
    let more = Settings { spp: 512, ..settings };
    assert_same("coarse and open bodies", caustics(vec![coarse, (plane(0.7), tinted, open)]), more);
    let pane = |surface: Principled| Material { thin_walled: true, ..Material::from(surface) };
    let clear = pane(Principled { base_color: Vec3A::new(0.9, 0.6, 0.5), roughness: 0.0, ..glass(0.0).surface });
    let matt = pane(glass(0.4).surface);
    let panes = |before: Vec3, turn: f32| {
        let wall = |at: Vec3, turn: f32| Affine3A::from_rotation_translation(Quat::from_rotation_x(turn), at);
        vec![
            ball(glass(0.25), 0.0),
            (plane(8.0), clear.clone(), wall(before, turn)),
            (plane(0.6), clear.clone(), wall(Vec3::new(0.0, 0.2, 0.9), 0.1)),
            (plane(0.5), matt.clone(), wall(Vec3::new(0.7, 0.3, 0.9), 0.8)),
        ]
    };
    assert_same("a pane before the light", caustics(panes(Vec3::new(0.0, 3.0, 0.0), 0.0)), settings);
    assert_same("a pane before the camera", caustics(panes(Vec3::new(0.0, 1.0, 2.6), FRAC_PI_2)), settings);
}

/// Lamps with and without an area, near bodies and within one, alone and beside the sky.
#[test]
fn so_they_do_under_lamps() {
    let settings = Settings { spp: 256, ..Settings::default() };
    // Rough enough that paths from the camera find what a small lamp sends.
    let ball = || (sphere(16, true), glass(0.45), place(0.1, 0.45, 0.9, Vec3::splat(0.4)));
    let glow = |double_sided: bool| Material { emissive: [30.0, 20.0, 10.0], double_sided, ..diffuse([0.0; 3]) };
    let rough = |mut loaded: LoadedScene| {
        loaded.materials[1].surface.roughness = 0.45;
        loaded.materials[2].surface = Principled { roughness: 0.45, clearcoat: 0.0, ..loaded.materials[2].surface };
        loaded
    };
    let night = |loaded| LoadedScene { environment: Environment::constant([0.05; 3]), ..rough(loaded) };
    let lamp = |at: Vec3, size: f32| (sphere(6, false), glow(true), place(at.x, at.y, at.z, Vec3::splat(size)));
    let above = Vec3::new(0.3, 1.9, 0.4);
    assert_same("a ball that glows", night(caustics(vec![ball(), lamp(above, 0.1)])), settings);
    assert_same("it beside a sky", caustics(vec![ball(), lamp(above, 0.1)]), settings);
    // What the pane takes away on the way to the camera.
    let tint = Principled { base_color: Vec3A::new(0.5, 0.3, 0.2), roughness: 0.0, ..glass(0.0).surface };
    let wall = Affine3A::from_rotation_translation(Quat::from_rotation_x(FRAC_PI_2), Vec3::new(0.0, 1.0, 2.6));
    let pane = (plane(8.0), Material { thin_walled: true, ..Material::from(tint) }, wall);
    assert_same("it behind a pane", night(caustics(vec![ball(), lamp(above, 0.1), pane])), settings);
    let more = Settings { spp: 1024, ..settings };
    assert_same("within glass", night(caustics(vec![ball(), lamp(Vec3::new(0.1, 0.45, 0.9), 0.1)])), more);
    // A small square that shines down, or both ways, and hides a part of the other lamp.
    let turn = Quat::from_rotation_x(std::f32::consts::PI);
    let square = |both: bool| (plane(0.3), glow(both), Affine3A::from_rotation_translation(turn, Vec3::new(0.0, 1.5, 0.5)));
    for both in [false, true] {
        assert_same("a square", night(caustics(vec![ball(), square(both), lamp(above, 0.05)])), settings);
    }
    let punctual = |kind, transform| PunctualLight { name: String::new(), kind, profile: None, transforms: vec![transform] };
    let down = |at: Vec3| Affine3A::from_rotation_translation(Quat::from_rotation_x(-FRAC_PI_2), at);
    let lights = [
        ("a point", PunctualKind::Point { intensity: [3.0, 2.0, 1.0] }, above),
        ("a point within glass", PunctualKind::Point { intensity: [1.0, 2.0, 3.0] }, Vec3::new(0.15, 0.4, 0.95)),
        ("a spot", PunctualKind::Spot { intensity: [9.0, 6.0, 3.0], inner: 0.2, outer: 0.7 }, above),
        // The middle of the ball is outside the cone.
        ("a spot on a side", PunctualKind::Spot { intensity: [30.0, 20.0, 10.0], inner: 0.2, outer: 0.3 }, above),
        ("one direction", PunctualKind::Directional { irradiance: [3.0, 2.0, 2.0] }, above),
    ];
    for (name, kind, at) in lights {
        let mut loaded = night(caustics(vec![ball()]));
        loaded.lights = vec![punctual(kind, down(at))];
        assert_same(name, loaded, if name.ends_with("glass") { more } else { settings });
    }
    // All of them, in groups: the groups add up, and each is the same with and without light paths.
    let mut loaded = rough(caustics(vec![ball(), lamp(above, 0.1), square(true)]));
    loaded.lights = lights.map(|(_, kind, at)| punctual(kind, down(at))).to_vec();
    let grouped = Settings { light_groups: 3, spp: 1024, ..settings };
    let group = |frame: &Frame, k: usize| {
        let pixels = &frame.light[k].as_ref().expect("a group").pixels;
        pixels.iter().map(|p| f64::from(p[0])).sum::<f64>() / pixels.len() as f64
    };
    let with = render_with(&compile(&loaded), &grouped).0;
    let without = render_with(&compile(&loaded), &Settings { light_paths: false, ..grouped }).0;
    for k in 0..3 {
        let (a, b) = (group(&with, k), group(&without, k));
        assert!((a / b - 1.0).abs() < 0.02, "group {k}: {a} {b}");
    }
    assert_same("all of them", loaded, more);
}

/// A cube about the origin with faces outwards, or inwards.
fn cube(edge: f32, outwards: bool) -> Mesh {
    let h = 0.5 * edge;
    let corner =
        |i: usize| Vec3::new(if i & 1 == 0 { -h } else { h }, if i & 2 == 0 { -h } else { h }, if i & 4 == 0 { -h } else { h });
    let sides = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let mut mesh = Mesh { positions: (0..8).map(corner).collect(), uvs: vec![Vec2::ZERO; 8], ..Mesh::default() };
    for [a, b, c, d] in sides {
        mesh.triangles.extend([[a, b, c], [a, c, d]]);
    }
    if !outwards {
        mesh.triangles.iter_mut().for_each(|t| t.swap(1, 2));
    }
    mesh
}

/// Which rays a single-sided surface stops is one rule for paths from both ends: whatever stands between body, floor and light,
/// the picture is that of camera paths alone.
#[test]
fn single_sided_surfaces_are_the_same_from_both_ends() {
    let settings = Settings { spp: 128, ..Settings::default() };
    let one_sided = |material: Material| Material { double_sided: false, ..material };
    let dull = || one_sided(diffuse([0.4, 0.5, 0.6]));
    let at = |height: f32, turned: bool| {
        let turn = Quat::from_rotation_x(if turned { std::f32::consts::PI } else { 0.0 });
        Affine3A::from_rotation_translation(turn, Vec3::new(0.0, height, 0.3))
    };
    // The bodies of `caustics` stand on the floor, and a ring of metal hangs above what is put in between.
    let ring = || renderflow_scenes::shapes::mesh(&Shape::Torus { radius: 0.5, tube: 0.15 });
    let over = |between: (Mesh, Material, Affine3A)| {
        let hung = Affine3A::from_translation(Vec3::new(0.0, 1.1, 0.3));
        let mut loaded = caustics(vec![between, (ring(), metal(0.1), hung)]);
        loaded.cameras = vec![camera([0.4, 0.7, 3.4], [0.0, 0.3, 0.2], 40.0, SIZE[0], SIZE[1])];
        loaded
    };
    assert_same("a lid that faces down", over((plane(2.0), dull(), at(0.7, true))), settings);
    assert_same("a lid that faces up", over((plane(2.0), dull(), at(0.7, false))), settings);
    assert_same("a metal lid that faces up", over((plane(2.0), one_sided(metal(0.2)), at(0.7, false))), settings);
    assert_same(
        "a box around a body, faces outwards",
        over((cube(1.4, true), dull(), place(-0.7, 0.75, 0.0, Vec3::ONE))),
        settings,
    );
    assert_same(
        "a box around a body, faces inwards",
        over((cube(1.4, false), dull(), place(-0.7, 0.75, 0.0, Vec3::ONE))),
        settings,
    );
    let lamp = one_sided(Material { emissive: [4.0, 3.0, 2.0], ..diffuse([0.2; 3]) });
    assert_same("a lamp that faces down", over((plane(0.8), lamp.clone(), at(0.7, true))), settings);
    assert_same("a lamp that faces up", over((plane(0.8), lamp, at(0.7, false))), settings);
    // Two sheets at one place make a double-sided one.
    let mut sheets = over((plane(1.2), dull(), at(0.7, true)));
    let other = common::instance(3, 3, at(0.7, false));
    sheets.instances.push(other);
    assert_same("two sheets at one place", sheets, settings);
    // Every other column of the lid is cut away.
    let texels = (0..64).flat_map(|i| [255, 255, 255, if i % 2 == 0 { 0 } else { 255 }]).collect::<Vec<u8>>();
    let texels = texels.chunks_exact(4).map(|t| [t[0], t[1], t[2], t[3]]).collect();
    let texture = Texture::from_rgba8("columns", [8, 8], texels, Encoding::Linear, [Wrap::Clamp; 2]);
    let slot = Some(TextureSlot::default());
    let masked = Material { base_color_texture: slot, alpha_mask: Some(AlphaMask { cutoff: 0.5, factor: 1.0 }), ..dull() };
    for (name, turned) in [("a lid with holes that faces down", true), ("a lid with holes that faces up", false)] {
        let mut lid = over((plane(2.0), masked.clone(), at(0.7, turned)));
        lid.textures.push(texture.clone());
        assert_same(name, lid, settings);
    }
}

/// A blended surface stops a light path by chance where that lands, once: the ray that joins it to the camera stops there too.
#[test]
fn blended_surfaces_stop_light_paths_once() {
    let at = |x: f32, y: f32, scale: Vec3| Affine3A::from_scale_rotation_translation(scale, Quat::IDENTITY, Vec3::new(x, y, 0.0));
    let ball = (sphere(16, true), glass(0.45), at(-0.3, 0.8, Vec3::splat(0.4)));
    let faint = (ball.0.clone(), Material { opacity: Some(0.7), ..ball.1.clone() }, ball.2);
    let wall = (cube(1.0, true), metal(0.3), at(-0.5, 0.5, Vec3::new(0.1, 1.0, 1.0)));
    // Between the camera and the floor, out of the lamp's way.
    let before = at(1.2, 1.5, Vec3::ONE);
    let tint = Principled { base_color: Vec3A::new(0.9, 0.6, 0.5), roughness: 0.0, ..glass(0.0).surface };
    let pane = (plane(1.5), Material { thin_walled: true, ..Material::from(tint) }, before);
    let veil = (plane(1.5), Material { opacity: Some(0.5), ..diffuse([0.0; 3]) }, before);
    let (above, aside) = (Vec3::new(-0.8, 2.0, 0.0), Vec3::new(1.0, 1.2, 0.0));
    // A second chance leaves .4 of the light below the balls, and .95 of that beside the wall.
    let cases = [
        ("glass", vec![ball.clone()], above, 0.08),
        ("faint glass", vec![faint], above, 0.08),
        ("behind a pane", vec![ball.clone(), pane], above, 0.08),
        ("behind a veil", vec![ball, veil], above, 0.08),
        ("metal", vec![wall], aside, 0.02),
    ];
    for (name, mut parts, lamp, tolerance) in cases {
        parts.push((plane(14.0), Material { opacity: Some(0.3), ..diffuse([0.8; 3]) }, Affine3A::IDENTITY));
        let look = camera([1.6, 2.2, 0.0], [0.3, 0.0, 0.0], 20.0, 16, 16);
        let mut loaded = scene(parts, Environment::constant([0.0; 3]), look);
        let kind = PunctualKind::Point { intensity: [10.0; 3] };
        let transforms = vec![Affine3A::from_translation(lamp)];
        loaded.lights = vec![PunctualLight { name: String::new(), kind, profile: None, transforms }];
        let compiled = compile(&loaded);
        let render = |light_paths, spp| render_with(&compiled, &Settings { light_paths, spp, ..Settings::default() });
        let ((with, stats), (without, _)) = (render(true, 4096), render(false, 8192));
        let ratio = mean(&with) / mean(&without);
        println!("{name}: {ratio}");
        assert!(stats.light_paths > 0 && (ratio - 1.0).abs() < tolerance, "{name}: {ratio}");
    }
}

fn mean(frame: &Frame) -> f64 {
    let raw = frame.raw.as_ref().expect("a picture");
    raw.pixels.iter().flatten().map(|&v| f64::from(v)).sum::<f64>() / (3 * raw.pixels.len()) as f64
}

/// A white wall behind a mirror on the ground: it gets the sun twice, and the second time paths from the camera hardly find it.
#[test]
fn a_mirror_doubles_the_sun() {
    let mut environment = Environment::constant([0.0; 3]);
    // 45 degrees high, in the direction +z.
    environment.map = Image::from_fn(256, 128, |x, y| {
        let (azimuth, polar) = ((x as f32 + 0.5) / 256.0, (y as f32 + 0.5) / 128.0);
        let sun = (azimuth - 0.5).abs() < 0.01 && (polar - 0.25).abs() < 0.02;
        if sun { [300.0, 200.0, 100.0] } else { [0.0; 3] }
    });
    let sun = Vec3A::new(0.0, 1.0, 1.0).normalize();
    assert!(environment.radiance(sun)[0] > 100.0, "the sun stands elsewhere");
    let wall = Affine3A::from_rotation_translation(Quat::from_rotation_x(std::f32::consts::FRAC_PI_2), Vec3::new(0.0, 0.8, -1.2));
    let mirror = Material::from(Principled {
        metallic: 1.0,
        roughness: 0.0,
        base_color: Vec3A::from_array([1.0; 3]),
        ..Principled::default()
    });
    let parts = vec![(plane(0.8), diffuse([0.5; 3]), wall), (plane(2.4), mirror, Affine3A::IDENTITY)];
    // The wall alone is in the picture.
    let loaded = scene(parts, environment.clone(), camera([0.0, 0.8, 3.0], [0.0, 0.8, -1.2], 6.0, 16, 16));
    let settings = Settings { spp: 8192, max_bounces: 2, ..Settings::default() };
    let (frame, stats) = render_with(&compile(&loaded), &settings);
    assert!(stats.light_paths > 0);
    // Irradiance of the wall, facing +z, by a sum over directions.
    let (n, mut irradiance) = (1024, 0.0f64);
    for i in 0..n * n / 2 {
        let (theta, phi) =
            (((i / n) as f64 + 0.5) / (n / 2) as f64 * std::f64::consts::PI, (i % n) as f64 / n as f64 * std::f64::consts::TAU);
        let wi = glam::DVec3::new(theta.sin() * phi.cos(), theta.cos(), theta.sin() * phi.sin());
        let step = std::f64::consts::PI / (n / 2) as f64 * std::f64::consts::TAU / n as f64 * theta.sin();
        irradiance += f64::from(environment.radiance(wi.as_vec3a())[1]) * wi.z.max(0.0) * step;
    }
    let expected = 2.0 * 0.5 / std::f64::consts::PI * irradiance;
    let raw = frame.raw.expect("a picture");
    let found = raw.pixels.iter().map(|p| f64::from(p[1])).sum::<f64>() / raw.pixels.len() as f64;
    println!("{found} of {expected}");
    assert!((found / expected - 1.0).abs() < 0.01, "{found} of {expected}");
}

/// A dull wall before metal bodies that face each other: much of its light comes over two or more of them.
#[test]
fn light_over_several_bodies_is_counted_once() {
    let wall = Affine3A::from_rotation_translation(Quat::from_rotation_x(std::f32::consts::FRAC_PI_2), Vec3::new(0.0, 0.6, -1.2));
    let mut parts = vec![(plane(2.0), diffuse([0.8; 3]), wall), (plane(6.0), metal(0.25), Affine3A::IDENTITY)];
    for x in [-0.9, -0.3, 0.3, 0.9] {
        parts.push((sphere(12, true), metal(0.25), place(x, 0.3, -0.6, Vec3::splat(0.28))));
    }
    // The upper part of the wall alone is in the picture.
    let mut loaded = scene(parts, sunny(), camera([0.0, 2.2, 4.0], [0.0, 1.0, -1.2], 7.0, SIZE[0], SIZE[1]));
    for max_bounces in [2, 3, 6] {
        let settings = Settings { spp: 512, max_bounces, ..Settings::default() };
        let over_seeds = |light_paths: bool, loaded: &mut LoadedScene| {
            let all = blocks(loaded, &Settings { light_paths, ..settings }, 12);
            all.iter().fold((0.0, 0.0), |(m, v), b| (m + b.0, v + b.1))
        };
        let ((a, va), (b, vb)) = (over_seeds(true, &mut loaded), over_seeds(false, &mut loaded));
        let error = (va + vb).sqrt() / b;
        println!("{max_bounces} surfaces: {:+.5} +- {error:.5}", a / b - 1.0);
        assert!(error < 0.002 && (a / b - 1.0).abs() < 3.5 * error, "{max_bounces} surfaces: {a} of {b}, {error}");
    }
}

/// relMSE of pictures against `truth`.
fn error(loaded: &mut LoadedScene, settings: &Settings, truth: &Frame) -> (f64, f64) {
    let (mut error, mut predicted) = (0.0, 0.0);
    let seeds = 8;
    for seed in 0..seeds {
        loaded.seed = 500 + seed;
        let frame = render_with(&compile(loaded), settings).0;
        let (raw, variance, truth) =
            (frame.raw.expect("a picture"), frame.variance.expect("its variance"), truth.raw.as_ref().expect("a picture"));
        for ((a, v), b) in raw.pixels.iter().zip(&variance.pixels).zip(&truth.pixels) {
            for c in 0..3 {
                let scale = 1.0 / (f64::from(b[c]).powi(2) + 0.01) / (3 * raw.pixels.len()) as f64 / seeds as f64;
                error += (f64::from(a[c]) - f64::from(b[c])).powi(2) * scale;
                predicted += f64::from(v[c]) * scale;
            }
        }
    }
    (error, predicted)
}

#[test]
fn they_lower_the_error_and_tell_what_is_left() {
    let mut loaded = caustics(vec![]);
    let settings = Settings { spp: 64, sampler: Sampler::Independent, ..Settings::default() };
    let truth = render_with(&compile(&loaded), &Settings { spp: 16384, sampler: Sampler::Sobol, ..settings }).0;
    let (with, predicted) = error(&mut loaded, &settings, &truth);
    let (without, _) = error(&mut loaded, &Settings { light_paths: false, ..settings }, &truth);
    println!("relMSE {with:.5} in place of {without:.5}, {predicted:.5} by the variance");
    assert!(with < 0.7 * without, "{with} of {without}");
    assert!((predicted / with - 1.0).abs() < 0.25, "{predicted} for {with}");
    // Of glass.
    loaded.materials[1] = glass(0.15);
    let truth = render_with(&compile(&loaded), &Settings { spp: 16384, sampler: Sampler::Sobol, ..settings }).0;
    let (with, _) = error(&mut loaded, &settings, &truth);
    let (without, _) = error(&mut loaded, &Settings { light_paths: false, ..settings }, &truth);
    println!("glass: relMSE {with:.5} in place of {without:.5}");
    assert!(with < 0.7 * without, "glass: {with} of {without}");
    // Under a lamp alone.
    loaded.environment = Environment::constant([0.05; 3]);
    let kind = PunctualKind::Point { intensity: [3.0; 3] };
    let transforms = vec![Affine3A::from_translation(Vec3::new(0.3, 1.9, 0.4))];
    loaded.lights = vec![PunctualLight { name: String::new(), kind, profile: None, transforms }];
    let truth = render_with(&compile(&loaded), &Settings { spp: 16384, sampler: Sampler::Sobol, ..settings }).0;
    let (with, _) = error(&mut loaded, &settings, &truth);
    let (without, _) = error(&mut loaded, &Settings { light_paths: false, ..settings }, &truth);
    println!("a lamp: relMSE {with:.5} in place of {without:.5}");
    assert!(with < 0.7 * without, "a lamp: {with} of {without}");
}

#[test]
fn none_are_traced_where_they_bring_nothing() {
    let count = |loaded: &LoadedScene, settings: Settings| render_with(&compile(loaded), &settings).1.light_paths;
    let settings = Settings { spp: 4, ..Settings::default() };
    let shiny = caustics(vec![]);
    assert!(count(&shiny, settings) > 0);
    let off = [
        Settings { light_paths: false, ..settings },
        Settings { max_bounces: 1, ..settings },
        Settings { filter: Filter::BlackmanHarris, ..settings },
        Settings { clamp_indirect: Some(10.0), ..settings },
        Settings { direct: DirectLight::Lights, ..settings },
        Settings { direct: DirectLight::Scattering, ..settings },
    ];
    for settings in off {
        assert_eq!(count(&shiny, settings), 0, "{settings:?}");
    }
    // Panes and sheets spread light, but do not gather it.
    let thin = [0.0, 0.3].map(|roughness| Material { thin_walled: true, ..glass(roughness) });
    let mut sheets = caustics(vec![]);
    sheets.materials[1..3].clone_from_slice(&thin);
    assert_eq!(count(&sheets, settings), 0);
    let dull = scene(
        vec![
            (plane(6.0), diffuse([0.7; 3]), Affine3A::IDENTITY),
            (sphere(16, true), metal(0.8), place(0.0, 0.6, 0.0, Vec3::splat(0.6))),
        ],
        sunny(),
        camera([0.4, 1.6, 3.4], [0.0, 0.3, 0.2], 40.0, SIZE[0], SIZE[1]),
    );
    assert_eq!(count(&dull, settings), 0);
    for sky in [Environment::constant([1.0; 3]), Environment::constant([0.0; 3])] {
        assert_eq!(count(&LoadedScene { environment: sky, ..caustics(vec![]) }, settings), 0);
    }
    let mut smooth = Environment::constant([0.0; 3]);
    smooth.map = Image::from_fn(64, 32, |_, y| [1.0 + y as f32 / 32.0; 3]);
    assert_eq!(count(&LoadedScene { environment: smooth, ..caustics(vec![]) }, settings), 0);
}
