//! Shared trees answer as flattened ones do, take far less memory, and stay when only placements move.

mod common;

use common::{camera, check_frame, diffuse, instance, plane, scene, sphere, sunny};
use glam::{Affine3A, EulerRot, Quat, Vec2, Vec3, Vec3A, Vec4};
use renderflow_frame::Frame;
use renderflow_renderer::accel::{Accel, Scratch};
use renderflow_renderer::ray::Ray;
use renderflow_renderer::verify::geometry::instanced_equals_flattened;
use renderflow_renderer::{RenderScene, Settings, Sharing, render_gbuffer};
use renderflow_scenes::loaded::{Encoding, Wrap};
use renderflow_scenes::{Instance, LoadedScene, Texture, TextureSlot};

fn compile(loaded: &LoadedScene, sharing: Sharing) -> RenderScene {
    RenderScene::compile_with(loaded, sharing).expect("the scene is consistent")
}

/// A ground, and forty turned, stretched and mirrored balls of two kinds that move.
fn balls() -> LoadedScene {
    let mut loaded = scene(
        vec![
            (plane(6.0), diffuse([0.5; 3]), Affine3A::IDENTITY),
            (
                sphere(12, true),
                diffuse([0.8, 0.4, 0.2]),
                Affine3A::from_translation(Vec3::new(0.0, 0.5, 0.0)) * Affine3A::from_scale(Vec3::splat(0.4)),
            ),
            (
                sphere(9, false),
                diffuse([0.2, 0.4, 0.8]),
                Affine3A::from_translation(Vec3::new(0.9, 0.3, 0.4)) * Affine3A::from_scale(Vec3::splat(0.3)),
            ),
        ],
        sunny(),
        camera([2.5, 2.0, 3.5], [0.0, 0.3, 0.0], 40.0, 48, 36),
    );
    for i in 0..40u8 {
        let f = f32::from(i);
        let at = |frame: f32| {
            let angle = 2.4 * f + 0.1 * frame;
            let side = if i % 3 == 0 { -1.0 } else { 1.0 };
            let stretch = Vec3::new(side, 0.6 + 0.3 * f.sin().abs(), 1.0) * (0.08 + 0.002 * f);
            let turn = Quat::from_euler(EulerRot::XYZ, f, 0.3 * f, 0.0);
            let place = Vec3::new(angle.cos(), 0.15, angle.sin()) * Vec3::new(0.4 + 0.05 * f, 1.0, 0.4 + 0.05 * f);
            Affine3A::from_scale_rotation_translation(stretch, turn, place)
        };
        let mesh = 1 + usize::from(i % 2);
        loaded.instances.push(Instance {
            transforms: vec![at(0.0), at(1.0), at(2.0)],
            object_id: 10 + u32::from(i),
            ..instance(mesh, mesh, at(0.0))
        });
    }
    loaded.cameras = vec![loaded.cameras[0]; 3];
    loaded
}

/// Pixels whose first hit is another object or lies elsewhere, and the largest differences in the others.
fn compare(a: &Frame, b: &Frame) -> (usize, f32, f32) {
    let (mut other, mut normal, mut depth) = (0, 0.0f32, 0.0f32);
    for i in 0..a.width * a.height {
        let (da, db) = (a.depth.pixels[i], b.depth.pixels[i]);
        if a.object_id.pixels[i] != b.object_id.pixels[i] || (da.is_finite() && (da - db).abs() > 1e-3 * da) {
            other += 1;
            continue;
        }
        normal = normal.max(Vec3A::from_array(a.normal.pixels[i]).distance(Vec3A::from_array(b.normal.pixels[i])));
        if da.is_finite() {
            depth = depth.max((da - db).abs() / da);
        }
    }
    (other, normal, depth)
}

#[test]
fn shared_trees_show_what_flattened_ones_do() {
    let loaded = balls();
    let (mut flattened, mut shared) = (compile(&loaded, Sharing::Never), compile(&loaded, Sharing::Always));
    assert_eq!(flattened.triangle_count(), shared.triangle_count());
    for frame in 0..3 {
        flattened.set_frame(frame);
        shared.set_frame(frame);
        let settings = Settings { spp: 64, ..Settings::default() };
        let [a, b] = [&flattened, &shared].map(|scene| common::render_with(scene, &settings).0);
        check_frame(&b);
        let (other, normal, depth) = compare(&a, &b);
        // The flat balls' normals jump at their edges.
        println!("frame {frame}: {other} pixels see something else, normals differ by {normal:e}, depths by {depth:e}");
        assert!(other <= 1 && normal < 2e-4 && depth < 2e-5);
        let mean = |f: &Frame| f.raw.as_ref().expect("rendered").pixels.iter().flatten().map(|&v| f64::from(v)).sum::<f64>();
        let ratio = mean(&b) / mean(&a);
        println!("  mean radiance {ratio:.6} of the flattened scene's");
        // The same random numbers: only paths that a rounding sends elsewhere differ.
        assert!((ratio - 1.0).abs() < 2e-4, "{ratio}");
        for (a, b) in [(&a.motion, &b.motion), (&a.motion_prev, &b.motion_prev)] {
            let (a, b) = (a.as_ref().expect("made"), b.as_ref().expect("made"));
            let apart =
                a.pixels.iter().zip(&b.pixels).filter(|(a, b)| Vec2::from_array(**a).distance(Vec2::from_array(**b)) > 1e-2);
            assert!(apart.count() <= 1);
        }
    }
}

#[test]
fn hits_agree_with_flattened_geometry() {
    let found = instanced_equals_flattened(200_000, 7);
    println!("{found:?}");
    assert!(found.rays == 200_000 && found.decided_otherwise + found.other_triangle <= 2);
    assert!(found.largest_distance < 1e-3 && found.largest_normal < 1e-4);
}

#[test]
fn trees_of_shared_meshes_stay_when_instances_move() {
    let mut shared = compile(&balls(), Sharing::Always);
    let first = shared.builds();
    assert_eq!((first.flattened, first.objects, first.instances), (1, 3, 1));
    shared.set_frame(0);
    assert_eq!(shared.builds(), first);
    shared.set_frame(1);
    shared.set_frame(2);
    let last = shared.builds();
    assert_eq!((last.flattened, last.objects, last.instances), (1, 3, 3));
    // Moved and compiled there are the same.
    let mut loaded = balls();
    for instance in &mut loaded.instances {
        instance.transforms = vec![instance.transform(2)];
    }
    let moved = render_gbuffer(&shared, &Settings::default()).expect("settings in range");
    let placed = render_gbuffer(&compile(&loaded, Sharing::Always), &Settings::default()).expect("settings in range");
    assert_eq!(moved.depth.pixels, placed.depth.pixels);
    assert_eq!(moved.normal.pixels, placed.normal.pixels);
}

#[test]
fn a_thousand_instances_take_little_memory() {
    let ball = sphere(51, true);
    assert!(ball.triangles.len() > 10_000);
    let camera = camera([0.0, 0.0, 30.0], [0.0; 3], 40.0, 16, 16);
    let mut loaded = scene(vec![(ball, diffuse([0.5; 3]), Affine3A::IDENTITY)], sunny(), camera);
    let flattened = compile(&loaded, Sharing::Never).geometry_memory();
    let place = |i: u16| Affine3A::from_translation(Vec3::new(f32::from(i % 32), f32::from(i / 32), 0.0) - 16.0);
    loaded.instances = (0..1000).map(|i| instance(0, 0, place(i))).collect();
    // Shared without being told to.
    let shared = RenderScene::compile(&loaded).expect("the scene is consistent");
    assert_eq!(shared.triangle_count(), 1000 * loaded.meshes[0].triangles.len());
    assert_eq!(shared.builds().objects, 1);
    let share = shared.geometry_memory() as f64 / (1000.0 * flattened as f64);
    println!("1000 instances take 1/{:.0} of their flattened triangles", 1.0 / share);
    assert!(share < 1.0 / 50.0);
}

/// Few triangles are flattened; what cannot be taken to object space is, too.
#[test]
fn what_is_shared_follows_the_rule() {
    let loaded = balls();
    assert_eq!(compile(&loaded, Sharing::Automatic).builds().objects, 0);
    for bad in [Vec3::new(1.0, 0.0, 1.0), Vec3::new(f32::NAN, 1.0, 1.0), Vec3::new(1e6, 1.0, 1.0), Vec3::splat(1e30)] {
        let mut loaded = balls();
        loaded.instances[3].transforms = vec![Affine3A::from_scale(bad)];
        let scenes = [Sharing::Never, Sharing::Always].map(|sharing| compile(&loaded, sharing));
        let [a, b] = scenes.each_ref().map(|scene| render_gbuffer(scene, &Settings::default()).expect("settings in range"));
        check_frame(&b);
        assert!(compare(&a, &b).0 <= 1, "{bad}");
        assert_eq!(scenes[0].dropped_triangles(), scenes[1].dropped_triangles());
    }
}

/// Uv, tangent and material of what is hit: a textured, normal-mapped, mirrored ball looks the same shared.
#[test]
fn attributes_of_shared_meshes_reach_the_picture() {
    let mut ball = sphere(16, true);
    ball.tangents = ball.positions.iter().map(|p| Vec3::Y.cross(*p).normalize_or(Vec3::X).extend(1.0)).collect::<Vec<Vec4>>();
    let mut material = diffuse([1.0; 3]);
    material.base_color_texture = Some(slot(0));
    material.normal_texture = Some((slot(1), 1.0));
    let place = Affine3A::from_scale_rotation_translation(
        Vec3::new(-0.8, 0.7, 0.9),
        Quat::from_rotation_x(0.4),
        Vec3::new(0.1, 0.2, 0.0),
    );
    let mut loaded = scene(vec![(ball, material, place)], sunny(), camera([0.0, 0.5, 3.0], [0.0; 3], 40.0, 32, 32));
    loaded.textures = vec![
        checks("colours", [[200, 30, 90, 255], [20, 220, 160, 255]], Encoding::Linear),
        checks("dents", [[168, 128, 220, 255], [100, 150, 230, 255]], Encoding::Normal),
    ];
    let [a, b] = [Sharing::Never, Sharing::Always]
        .map(|sharing| render_gbuffer(&compile(&loaded, sharing), &Settings::default()).expect("settings in range"));
    let (other, normal, _) = compare(&a, &b);
    let albedo = a.albedo.pixels.iter().zip(&b.albedo.pixels).map(|(a, b)| Vec3::from_array(*a).distance(Vec3::from_array(*b)));
    let albedo = albedo.fold(0.0, f32::max);
    println!("{other} pixels see something else, normals differ by {normal:e}, albedo by {albedo:e}");
    assert!(other == 0 && normal < 1e-3 && albedo < 1e-2);
    // And the texture is there at all.
    let first = a.albedo.pixels.iter().find(|p| p[0] > 0.0).expect("the ball is seen");
    assert!(a.albedo.pixels.iter().any(|p| p[0] > 0.0 && Vec3::from_array(*p).distance(Vec3::from_array(*first)) > 0.1));
}

fn slot(texture: usize) -> TextureSlot {
    TextureSlot { texture, ..TextureSlot::default() }
}

/// The side that a filter is told: against the geometry, under turns and mirrors.
#[test]
fn filters_are_told_the_side() {
    let triangle = |turn: Quat, mirror: f32| {
        [Vec3::new(-1.0, -1.0, 0.0), Vec3::new(1.0, -1.0, 0.0), Vec3::new(0.0, 1.0, 0.0)]
            .map(|p| Vec3A::from(turn * (p * Vec3::new(mirror, 1.0, 1.0))))
    };
    let mut scratch = Scratch::default();
    let mut seen = [0; 2];
    for i in 0..200u8 {
        let f = f32::from(i);
        let corners = triangle(Quat::from_euler(EulerRot::XYZ, f, 0.7 * f, 0.0), if i % 2 == 0 { 1.0 } else { -1.0 });
        let accel = Accel::build(&[corners]);
        let origin = Vec3A::new((1.3 * f).sin(), (0.9 * f).cos(), (2.1 * f).sin()) * 3.0;
        let ray = Ray::new(origin, -origin.normalize());
        let n = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
        let front = n.dot(ray.direction) < 0.0;
        if accel.closest(&ray, &mut scratch).is_none() {
            continue;
        }
        seen[usize::from(front)] += 1;
        assert_eq!(accel.closest_where(&ray, &mut scratch, |c| c.front).is_some(), front);
        assert_eq!(accel.occluded_where(&ray, &mut scratch, |c| !c.front), !front);
    }
    assert!(seen.iter().all(|&n| n > 50), "{seen:?}");
}

/// A filter that accepts everything changes nothing; one that rejects the nearest finds the next.
#[test]
fn filters_let_rays_pass() {
    let layers: Vec<[Vec3A; 3]> = (0..50u8)
        .map(|k| {
            [Vec3A::new(-9.0, -9.0, 0.0), Vec3A::new(9.0, -9.0, 0.0), Vec3A::new(0.0, 9.0, 0.0)]
                .map(|p| p - Vec3A::Z * f32::from(k))
        })
        .collect();
    let accel = Accel::build(&layers);
    let mut scratch = Scratch::default();
    let ray = Ray::new(Vec3A::new(0.1, 0.2, 1.0), Vec3A::NEG_Z);
    assert_eq!(accel.closest(&ray, &mut scratch), accel.closest_where(&ray, &mut scratch, |_| true));
    for behind in 0..50 {
        let hit = accel.closest_where(&ray, &mut scratch, |c| c.hit.primitive >= behind).expect("a layer is left");
        assert_eq!((hit.primitive, hit.t), (behind, 1.0 + behind as f32));
        assert!(accel.occluded_where(&ray, &mut scratch, |c| c.hit.primitive == behind));
    }
    assert!(accel.closest_where(&ray, &mut scratch, |_| false).is_none() && !accel.occluded_where(&ray, &mut scratch, |_| false));
}

fn checks(name: &str, colours: [[u8; 4]; 2], encoding: Encoding) -> Texture {
    let texels = (0..64).map(|i| colours[(i / 8 + i % 8) % 2]).collect();
    Texture::from_rgba8(name, [8, 8], texels, encoding, [Wrap::Repeat; 2])
}
