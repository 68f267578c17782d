//! G-buffers whose values are known on paper, and a picture by another renderer. What the path tracer itself must show on paper
//! is checked by `renderflow_renderer::verify::analytic`.

mod common;

use common::{camera, check_frame, compile, diffuse, plane, render_with, scene, sphere};
use glam::{Affine3A, DVec3, Quat, Vec2, Vec3, Vec3A};
use renderflow_frame::{Camera, Environment, Image};
use renderflow_renderer::{Filter, Settings, render_gbuffer};
use renderflow_scenes::loaded::{Encoding, Texture, Wrap};
use renderflow_scenes::{LoadedScene, Material, Principled, TextureSlot};

#[test]
fn gbuffer_of_a_sphere() {
    let radius = 1.0;
    let camera = camera([0.3, 1.1, 4.0], [0.0; 3], 40.0, 64, 48);
    let parts = vec![(
        sphere(128, true),
        Material::from(Principled { base_color: Vec3A::from_array([0.1, 0.2, 0.9]), ..Principled::default() }),
        Affine3A::IDENTITY,
    )];
    let compiled = compile(&scene(parts, Environment::constant([1.0; 3]), camera));
    let frame = render_gbuffer(&compiled, &Settings::default()).expect("settings in range");
    check_frame(&frame);
    let to_camera = camera.camera_to_world.matrix3.transpose();
    let (mut hits, mut worst_depth, mut worst_normal) = (0, 0.0f32, 0.0f32);
    for y in 0..48 {
        for x in 0..64 {
            let pixel = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
            let d = camera.ray_direction(pixel);
            let b = camera.position().dot(d);
            let discriminant = b * b - camera.position().length_squared() + radius * radius;
            let depth = *frame.depth.at(x, y);
            // The mesh is inscribed; within its sagitta (7.5e-5 along each of its two directions) of the silhouette either answer
            // is right.
            if discriminant < 4e-4 {
                assert!(discriminant > -1e-4 || depth.is_infinite());
                continue;
            }
            let p = camera.position() + d * (-b - discriminant.sqrt());
            let expected = -camera.world_to_camera().transform_point3a(p).z;
            worst_depth = worst_depth.max((depth - expected).abs() * discriminant.sqrt());
            let normal = Vec3A::from_array(*frame.normal.at(x, y));
            worst_normal = worst_normal.max((normal - to_camera * p).length() * discriminant.sqrt());
            assert_eq!(*frame.albedo.at(x, y), [0.1, 0.2, 0.9]);
            assert_eq!(*frame.material.at(x, y), [0.5, 0.0, 0.5]);
            hits += 1;
        }
    }
    println!(
        "{hits} pixels: depth within {worst_depth:.1e} m, normal within {worst_normal:.1e} (both times the cosine at the surface)"
    );
    assert!(hits > 500);
    assert!(worst_depth < 2e-4 && worst_normal < 5e-4);
}

/// Planar depth of a wall square to the view is one number, everywhere in the picture.
#[test]
fn depth_is_planar() {
    let wall = Affine3A::from_rotation_x(std::f32::consts::FRAC_PI_2);
    let parts = vec![(plane(100.0), Material::default(), wall)];
    let compiled =
        compile(&scene(parts, Environment::constant([1.0; 3]), camera([1.0, 2.0, 7.25], [1.0, 2.0, 0.0], 80.0, 33, 21)));
    let frame = render_gbuffer(&compiled, &Settings::default()).expect("settings in range");
    for (&depth, normal) in frame.depth.pixels.iter().zip(&frame.normal.pixels) {
        assert!((depth / 7.25 - 1.0).abs() < 1e-6, "{depth}");
        assert!(Vec3A::from_array(*normal).distance(Vec3A::Z) < 1e-6);
    }
}

fn moving_scene() -> (LoadedScene, Vec<Camera>) {
    let mut loaded = scene(
        vec![(plane(6.0), Material::default(), Affine3A::IDENTITY), (sphere(16, true), Material::default(), Affine3A::IDENTITY)],
        Environment::constant([1.0; 3]),
        camera([0.0, 2.0, 6.0], [0.0, 0.5, 0.0], 40.0, 48, 36),
    );
    loaded.instances[1].transforms = (0..3)
        .map(|f| {
            let f = f as f32;
            Affine3A::from_rotation_translation(Quat::from_rotation_y(0.3 * f), Vec3::new(0.2 * f, 1.0 + 0.1 * f, 0.0))
        })
        .collect();
    loaded.cameras = (0..3).map(|f| camera([0.4 * f as f32, 2.0, 6.0], [0.0, 0.5, 0.0], 40.0, 48, 36)).collect();
    let cameras = loaded.cameras.clone();
    (loaded, cameras)
}

/// Depth says where a pixel's point is; carried along with its object and projected by the other camera, it must land where the
/// motion vector says.
#[test]
fn motion_reprojects() {
    let (loaded, cameras) = moving_scene();
    let mut compiled = compile(&loaded);
    let mut worst = 0.0f32;
    for frame_index in 0..3usize {
        compiled.set_frame(frame_index);
        let frame = render_gbuffer(&compiled, &Settings::default()).expect("settings in range");
        check_frame(&frame);
        for (image, other) in [(&frame.motion, Some(frame_index + 1)), (&frame.motion_prev, frame_index.checked_sub(1))] {
            let image = image.as_ref().expect("filled");
            let Some(other) = other.filter(|&o| o < 3) else {
                assert!(image.pixels.iter().all(|m| *m == [0.0; 2]), "no neighbour, no motion");
                continue;
            };
            for y in 0..36 {
                for x in 0..48 {
                    let depth = *frame.depth.at(x, y);
                    if depth.is_infinite() {
                        assert_eq!(*image.at(x, y), [0.0; 2]);
                        continue;
                    }
                    let pixel = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
                    let p = cameras[frame_index].unproject(pixel, depth);
                    let instance = &loaded.instances[*frame.object_id.at(x, y) as usize - 1];
                    let carried = instance.transform(other) * instance.transform(frame_index).inverse();
                    let (there, _) = cameras[other].project(carried.transform_point3a(p)).expect("in front");
                    worst = worst.max((pixel + Vec2::from_array(*image.at(x, y)) - there).length());
                }
            }
        }
    }
    println!("motion within {worst:.1e} pixels");
    assert!(worst < 1e-3, "{worst}");
}

#[test]
fn nothing_moving_means_exactly_no_motion() {
    let (mut loaded, cameras) = moving_scene();
    loaded.cameras = vec![cameras[0]; 3];
    loaded.instances[1].transforms.truncate(1);
    let mut compiled = compile(&loaded);
    compiled.set_frame(1);
    let frame = render_gbuffer(&compiled, &Settings::default()).expect("settings in range");
    for image in [frame.motion, frame.motion_prev] {
        assert!(image.expect("filled").pixels.iter().all(|m| *m == [0.0; 2]));
    }
}

/// What no ray hits shows the environment, averaged over the pixel.
#[test]
fn background_is_the_environment() {
    let environment = common::sunny();
    let view = camera([0.0, 1.0, 4.0], [0.0, 2.5, 0.0], 60.0, 24, 16);
    let parts = vec![(plane(2.0), Material::default(), Affine3A::IDENTITY)];
    for filter in [Filter::Box, Filter::BlackmanHarris] {
        let compiled = compile(&scene(parts.clone(), environment.clone(), view));
        let (frame, stats) = render_with(&compiled, &Settings { spp: 64, filter, ..Settings::default() });
        assert!(stats.skipped_rays > 0, "the sky needs no rays");
        let beauty = frame.beauty.as_ref().expect("rendered");
        let mut sky = 0;
        for y in 0..16 {
            for x in 0..24 {
                if *frame.alpha.at(x, y) > 0.0 {
                    continue;
                }
                sky += 1;
                let mut expected = DVec3::ZERO;
                for i in 0..256 {
                    let u = [(i % 16) as f32 / 16.0 + 1.0 / 32.0, (i / 16) as f32 / 16.0 + 1.0 / 32.0];
                    let point = Vec2::new(x as f32 + 0.5, y as f32 + 0.5) + filter.sample(u);
                    expected += Vec3::from_array(environment.radiance(view.ray_direction(point))).as_dvec3() / 256.0;
                }
                let found = Vec3::from_array(*beauty.at(x, y)).as_dvec3();
                assert!(((found - expected) / expected).abs().max_element() < 0.02, "{x} {y}: {found} {expected}");
            }
        }
        assert!(sky > 100);
    }
}

/// Texture lookups reach the picture: a checker of two colours, the normal map's lean, and roughness and metal from their
/// channels.
#[test]
fn textures_and_normal_maps_reach_the_gbuffer() {
    let mut mesh = plane(2.0);
    // u runs along +x, v along +z: the tangent is +x; bitangent n x t = -z, which is -v: handedness -1 for v growing along +z.
    mesh.tangents = vec![glam::Vec4::new(1.0, 0.0, 0.0, 1.0); 4];
    let slot = |texture| Some(TextureSlot { texture, ..TextureSlot::default() });
    let lean = Vec3::new(0.6, 0.0, 0.8);
    let material = Material {
        base_color_texture: slot(0),
        metallic_roughness_texture: slot(1),
        normal_texture: slot(2).map(|s| (s, 1.0)),
        surface: Principled {
            base_color: Vec3A::from_array([0.5, 1.0, 1.0]),
            roughness: 0.8,
            metallic: 1.0,
            ..Principled::default()
        },
        ..Material::default()
    };
    let mut loaded = scene(
        vec![(mesh, material, Affine3A::IDENTITY)],
        Environment::constant([1.0; 3]),
        camera([0.0, 4.0, 0.001], [0.0; 3], 20.0, 16, 16),
    );
    // Sixteen bits: values are within 1e-5 of those asked for.
    let texture = |name: &str, pixels: Vec<[f32; 3]>, encoding| {
        let stored = |v: f32| if encoding == Encoding::Normal { 0.5 * v + 0.5 } else { v };
        let texels: Vec<_> =
            pixels.iter().map(|[r, g, b]| [*r, *g, *b, 1.0].map(|v| (stored(v) * 65535.0).round() as u16)).collect();
        Texture::from_rgba16(name, [pixels.len(), 1], texels, encoding, [Wrap::Clamp; 2])
    };
    loaded.textures = vec![
        texture("two colours", vec![[1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.5, 0.0]], Encoding::Linear),
        texture("rough metal", vec![[0.0, 0.5, 0.25]], Encoding::Linear),
        texture("lean", vec![lean.to_array()], Encoding::Normal),
    ];
    let compiled = compile(&loaded);
    assert!(compiled.features().textures && compiled.features().normal_maps);
    let frame = render_gbuffer(&compiled, &Settings::default()).expect("settings in range");
    check_frame(&frame);
    let near = |a: &[f32; 3], b: [f32; 3]| Vec3A::from(*a).distance(b.into()) < 2e-5;
    assert!(near(frame.albedo.at(0, 8), [0.5, 0.0, 0.0]));
    assert!(near(frame.albedo.at(15, 8), [0.0, 0.5, 0.0]));
    let material = frame.material.at(8, 8);
    assert!((material[0] - 0.4).abs() < 2e-5 && (material[1] - 0.25).abs() < 2e-5);
    let world = loaded.cameras[0].camera_to_world.matrix3 * Vec3A::from_array(*frame.normal.at(8, 8));
    assert!(world.distance(Vec3A::new(0.6, 0.8, 0.0)) < 1e-4, "{world}");
}

/// A picture by another renderer: diffuse surfaces that light each other, six scattering events, a smooth sky with a sun.
/// Made by `references/mitsuba_diffuse.py` (Mitsuba 3, 4096 samples).
#[test]
fn interreflection_agrees_with_mitsuba() {
    let mut environment = Environment::constant([0.0; 3]);
    let texels = Environment { map: Image::filled(1024, 512, [0.0; 3]), ..environment.clone() };
    environment.map = Image::from_fn(1024, 512, |x, y| {
        let d = texels.direction(Vec2::new((x as f32 + 0.5) / 1024.0, (y as f32 + 0.5) / 512.0));
        let up = 0.5 + 0.5 * d.y;
        let sun = 60.0 * ((d.dot(Vec3A::new(0.6, 0.64, 0.48)) - 1.0) / 0.01).exp();
        [0.3 + 0.2 * up + sun, 0.4 + 0.4 * up + 0.9 * sun, 0.5 + 0.7 * up + 0.7 * sun]
    });
    let at = |x, y, z| Affine3A::from_translation(Vec3::new(x, y, z));
    let parts = vec![
        (plane(6.0), diffuse([0.7, 0.6, 0.5]), Affine3A::IDENTITY),
        (sphere(16, false), diffuse([0.8, 0.3, 0.2]), at(-0.95, 1.0, 0.0)),
        (sphere(16, false), diffuse([0.4, 0.5, 0.9]), at(1.05, 1.0, 0.2)),
    ];
    let compiled = compile(&scene(parts, environment, camera([0.0, 2.5, 5.0], [0.0, 0.6, 0.0], 40.0, 64, 64)));
    let (frame, _) = render_with(&compiled, &Settings { spp: 256, max_bounces: 6, ..Settings::default() });
    let beauty = frame.beauty.expect("rendered");
    let (mut worst, mut sums) = (0.0f64, (DVec3::ZERO, DVec3::ZERO));
    for line in include_str!("references/mitsuba_diffuse.csv").lines() {
        let values: Vec<f64> = line.split(',').map(|v| v.parse().expect("a number")).collect();
        let (y, x) = (8 * values[0] as usize, 8 * values[1] as usize);
        let expected = DVec3::new(values[2], values[3], values[4]);
        let block = beauty.crop(x, y, 8, 8);
        let found = block.pixels.iter().fold(DVec3::ZERO, |s, &p| s + Vec3::from_array(p).as_dvec3()) / 64.0;
        worst = worst.max((found / expected - 1.0).abs().max_element());
        sums = (sums.0 + found, sums.1 + expected);
    }
    let mean = sums.0 / sums.1 - 1.0;
    println!("against Mitsuba: mean {mean:.5}, worst block {worst:.5}");
    assert!(mean.abs().max_element() < 0.002, "{mean}");
    // Mitsuba's map runs from pole to pole in one row less, which turns the sun by up to a third of a degree.
    assert!(worst < 0.015, "{worst}");
}
