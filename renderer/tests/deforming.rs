//! Meshes whose vertices move against each other: a picture of them is that of a still mesh which stands as they do, from
//! wherever the sequence was entered, and their motion is that of their own points.

mod common;

use common::{camera, check_frame, compile, compile_at, diffuse, plane, render, scene, sphere, sunny};
use glam::{Affine3A, DVec3, Quat, Vec2, Vec3, Vec3A};
use renderflow_renderer::{Builds, RenderScene, Settings, Sharing, render_gbuffer};
use renderflow_scenes::loaded::{Displacement, Influence, Poses, Rows, Shape};
use renderflow_scenes::{LoadedScene, Material, Mesh, Principled};
use std::sync::Arc;

const FRAMES: usize = 24;

/// A ball whose upper half a second joint turns, and that one morph target makes wider; `speed` of both.
fn soft(detail: u32, smooth: bool, speed: f32) -> Mesh {
    let mesh = sphere(detail, smooth);
    let rows = mesh.positions.len();
    let (mut influences, mut displacements) = (vec![], vec![]);
    for (row, p) in (0u32..).zip(&mesh.positions) {
        let upper = (0.5 + 0.5 * p.y).clamp(0.0, 1.0);
        for (joint, weight) in [(0, 1.0 - upper), (1, upper)] {
            if weight > 0.0 {
                influences.push((row, Influence { joint, weight }));
            }
        }
        let wider = Vec3::new(p.x, 0.0, p.z);
        displacements.push((row, Displacement { target: 0, position: wider, normal: Vec3::ZERO, tangent: Vec3::ZERO }));
    }
    let shape = Shape { displacements: Rows::new(rows, &displacements), influences: Rows::new(rows, &influences) };
    let joint = |frame: usize| {
        let angle = speed * frame as f32;
        [
            Affine3A::IDENTITY,
            Affine3A::from_quat(Quat::from_rotation_z(angle)) * Affine3A::from_translation(Vec3::Y * 0.3 * angle),
        ]
    };
    let weights = (0..FRAMES).map(|frame| 0.5 * speed * frame as f32).collect();
    mesh.deformed(&Arc::new(shape), Poses::new(FRAMES, weights, Arc::new((0..FRAMES).flat_map(joint).collect())))
}

/// Two soft balls, one of them a lamp and one that moves as a whole too, a still one, and a floor.
fn moving() -> LoadedScene {
    let metal = Material::from(Principled { metallic: 1.0, roughness: 0.2, ..Principled::default() });
    let lamp = Material { emissive: [3.0, 2.0, 1.0], ..Material::default() };
    let place = |x: f32, size: f32| Affine3A::from_translation(Vec3::new(x, 0.6, 0.0)) * Affine3A::from_scale(Vec3::splat(size));
    let parts = vec![
        (plane(10.0), diffuse([0.6; 3]), Affine3A::IDENTITY),
        (soft(8, true, 0.04), metal.clone(), place(-1.2, 0.5)),
        (soft(5, false, -0.05), lamp, place(1.2, 0.3)),
        (sphere(8, true), metal, place(0.0, 0.4)),
    ];
    let mut loaded = scene(parts, sunny(), camera([0.0, 2.0, 5.0], [0.0, 0.5, 0.0], 45.0, 32, 24));
    let slide = |frame: usize| Affine3A::from_translation(Vec3::new(0.0, 0.0, 0.02 * frame as f32)) * place(-1.2, 0.5);
    loaded.instances[1].transforms = (0..FRAMES).map(slide).collect();
    loaded.cameras = (0..FRAMES).map(|f| camera([0.05 * f as f32, 2.0, 5.0], [0.0, 0.5, 0.0], 45.0, 32, 24)).collect();
    loaded
}

/// The scene with everything as it stands at `frame`, for ever; its meshes do not deform.
fn frozen(loaded: &LoadedScene, frame: usize) -> LoadedScene {
    let mut still = loaded.clone();
    still.instances.iter_mut().for_each(|instance| instance.transforms = vec![instance.transform(frame)]);
    for mesh in &mut still.meshes {
        let posed = mesh.posed(frame);
        let (positions, normals, tangents) =
            (posed.positions.into_owned(), posed.normals.into_owned(), posed.tangents.into_owned());
        *mesh = Mesh { positions, normals, tangents, deformation: None, ..mesh.clone() };
    }
    still
}

#[test]
fn frames_are_those_of_a_still_scene_from_wherever_one_comes() {
    let loaded = moving();
    let mut walked = compile(&loaded);
    for frame in [0, 1, 2, 15, 16, 17, 3, 0, 23, 40, 16, 0] {
        walked.set_frame(frame);
        let (picture, stats) = render(&walked, 4);
        check_frame(&picture);
        let (fresh, fresh_stats) = render(&compile_at(&loaded, frame), 4);
        assert!(picture == fresh && stats == fresh_stats, "frame {frame} depends on the frames before");
        // Motion apart, which a still scene does not have.
        let (mut still, _) = render(&compile_at(&frozen(&loaded, frame), frame), 4);
        (still.motion, still.motion_prev) = (picture.motion.clone(), picture.motion_prev.clone());
        assert!(picture == still, "frame {frame} differs from that of a still scene");
    }
    assert!(walked.builds().refitted > 0, "{:?}", walked.builds());
}

#[test]
fn one_thread_and_many_make_the_same_picture() {
    let compiled = compile_at(&moving(), 9);
    let many = render(&compiled, 4);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
    let one = pool.install(|| render(&compile_at(&moving(), 9), 4));
    assert!(one == many);
}

/// Asked to share every mesh, the renderer flattens those that deform and shares the others.
#[test]
fn what_deforms_is_never_shared() {
    let mut compiled = RenderScene::compile_with(&moving(), Sharing::Always).expect("consistent");
    assert_eq!(compiled.builds(), Builds { flattened: 1, objects: 2, instances: 1, ..Builds::default() });
    compiled.set_frame(9);
    let mut still = RenderScene::compile_with(&frozen(&moving(), 9), Sharing::Never).expect("consistent");
    still.set_frame(9);
    let (shared, flat) = (render(&compiled, 1).0, render(&still, 1).0);
    let same = shared.object_id.pixels.iter().zip(&flat.object_id.pixels).filter(|(a, b)| a == b).count();
    assert!(same as f64 >= 0.99 * shared.object_id.pixels.len() as f64, "{same}");
}

/// The point of a pixel, found again by its place in its triangle, lands in the other frame where the motion vector says.
#[test]
fn motion_is_that_of_the_points_of_the_mesh() {
    let loaded = moving();
    let mut compiled = compile(&loaded);
    let (mut worst, mut largest, mut count) = (0.0f32, 0.0f32, 0);
    for frame_index in [0, 7, FRAMES - 1] {
        compiled.set_frame(frame_index);
        let frame = render_gbuffer(&compiled, &Settings::default()).expect("settings in range");
        for (image, other) in [(&frame.motion, Some(frame_index + 1)), (&frame.motion_prev, frame_index.checked_sub(1))] {
            let image = image.as_ref().expect("filled");
            let Some(other) = other.filter(|&other| other < FRAMES) else { continue };
            for (x, y) in (0..24).flat_map(|y| (0..32).map(move |x| (x, y))) {
                let number = *frame.object_id.at(x, y) as usize;
                if number != 2 && number != 3 {
                    continue;
                }
                let instance = &loaded.instances[number - 1];
                let mesh = &loaded.meshes[instance.mesh];
                let corners = |frame: usize, triangle: &[u32; 3]| {
                    triangle.map(|v| instance.transform(frame).transform_point3(mesh.position_at(v as usize, frame)).as_dvec3())
                };
                let pixel = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
                let p = loaded.cameras[frame_index].unproject(pixel, *frame.depth.at(x, y)).as_dvec3();
                let (weights, triangle, distance) = mesh
                    .triangles
                    .iter()
                    .map(|triangle| {
                        let (weights, distance) = nearest(corners(frame_index, triangle), p);
                        (weights, triangle, distance)
                    })
                    .min_by(|a, b| a.2.total_cmp(&b.2))
                    .expect("triangles");
                assert!(distance < 1e-4, "{distance}");
                let there: DVec3 = corners(other, triangle).iter().zip(weights).map(|(&c, w)| c * w).sum();
                let (there, _) = loaded.cameras[other].project(Vec3A::from(there.as_vec3())).expect("in front");
                let motion = Vec2::from_array(*image.at(x, y));
                worst = worst.max((pixel + motion - there).length());
                largest = largest.max(motion.length());
                count += 1;
            }
        }
    }
    println!("motion of {count} points within {worst:.1e} pixels; at most {largest} pixels");
    assert!(count > 100 && largest > 0.1 && worst < 2e-3, "{worst}");
}

/// Weights of the corners for the point of a triangle nearest to `p` in its plane, and how far `p` is from the triangle.
fn nearest([a, b, c]: [DVec3; 3], p: DVec3) -> ([f64; 3], f64) {
    let n = (b - a).cross(c - a);
    let area = n.length_squared();
    let share = |from: DVec3, to: DVec3| (to - from).cross(p - from).dot(n) / area;
    let weights = [share(b, c), share(c, a), share(a, b)];
    let outside = weights.iter().fold(0.0, |worst, w| f64::max(worst, -w));
    (weights, (p - a).dot(n / area.sqrt()).abs() + outside)
}
