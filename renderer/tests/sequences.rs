//! What is kept from frame to frame does not show: every frame is the same from wherever the sequence was entered, and the same
//! as that of a scene which stands still where the frame has it.

mod common;

use common::{camera, compile, compile_at, diffuse, plane, render, scene, sphere, sunny};
use glam::{Affine3A, Quat, Vec3};
use renderflow_renderer::Builds;
use renderflow_scenes::{LoadedScene, Material, Principled};

const FRAMES: usize = 40;

/// Two balls that cross a plane of still ones, one of them tumbling and one a lamp; the camera turns.
fn moving() -> LoadedScene {
    let still = |x: f32, z: f32| Affine3A::from_translation(Vec3::new(x, 0.5, z)) * Affine3A::from_scale(Vec3::splat(0.5));
    let metal = Material::from(Principled { metallic: 1.0, roughness: 0.2, ..Principled::default() });
    let lamp = Material { emissive: [3.0, 2.0, 1.0], ..Material::default() };
    let mut parts = vec![(plane(10.0), diffuse([0.6; 3]), Affine3A::IDENTITY)];
    for i in 0..4u8 {
        parts.push((sphere(8, true), metal.clone(), still(f32::from(i) - 1.5, -1.0)));
    }
    parts.push((sphere(9, true), diffuse([0.8, 0.3, 0.2]), Affine3A::IDENTITY));
    parts.push((sphere(5, false), lamp, Affine3A::IDENTITY));
    let look = camera([0.0, 2.0, 5.0], [0.0, 0.5, 0.0], 45.0, 32, 24);
    let mut loaded = scene(parts, sunny(), look);
    let along = |step: f32, spin: f32, z: f32, size: f32| {
        let place = move |f: usize| {
            let f = f as f32;
            Affine3A::from_translation(Vec3::new(step * f - 2.0, 0.6, z))
                * Affine3A::from_quat(Quat::from_rotation_y(spin * f))
                * Affine3A::from_scale(Vec3::new(size, 0.6 * size, size))
        };
        (0..FRAMES).map(place).collect::<Vec<_>>()
    };
    loaded.instances[5].transforms = along(0.1, 0.3, 0.6, 0.5);
    loaded.instances[6].transforms = along(0.3, 0.0, 1.2, 0.2);
    loaded.cameras = (0..FRAMES).map(|f| camera([0.1 * f as f32, 2.0, 5.0], [0.0, 0.5, 0.0], 45.0, 32, 24)).collect();
    loaded
}

/// The scene with everything where it stands at `frame`, for ever.
fn frozen(loaded: &LoadedScene, frame: usize) -> LoadedScene {
    let mut still = loaded.clone();
    still.instances.iter_mut().for_each(|instance| instance.transforms = vec![instance.transform(frame)]);
    still
}

#[test]
fn frames_do_not_depend_on_where_a_sequence_was_entered() {
    let loaded = moving();
    let mut walked = compile(&loaded);
    // Forwards over the edge of an epoch, back, and far on.
    for frame in [0, 1, 2, 15, 16, 17, 3, 0, 31, 39, 100, 16] {
        walked.set_frame(frame);
        let (picture, stats) = render(&walked, 4);
        let (fresh, fresh_stats) = render(&compile_at(&loaded, frame), 4);
        assert!(picture == fresh && stats == fresh_stats, "frame {frame} depends on the frames before");
        // Motion apart, which a still scene does not have.
        let (mut still, _) = render(&compile_at(&frozen(&loaded, frame), frame), 4);
        (still.motion, still.motion_prev) = (picture.motion.clone(), picture.motion_prev.clone());
        assert!(picture == still, "frame {frame} differs from that of a still scene");
    }
    let builds = walked.builds();
    println!("{builds:?}");
    assert!(builds.refitted > 0 && builds.flattened < 12, "{builds:?}");
}

#[test]
fn nothing_is_built_for_what_stands_still() {
    let mut compiled = compile(&frozen(&moving(), 7));
    let (first, _) = render(&compiled, 1);
    for frame in [1, 2, 20, 39] {
        compiled.set_frame(frame);
        assert_ne!(render(&compiled, 1).0.depth, first.depth, "the camera turns");
    }
    assert_eq!(compiled.builds(), Builds { flattened: 1, ..Builds::default() });
}

/// Objects that scatter all over the place make a fitted tree bad: then a new one is built, whichever frames came before.
#[test]
fn outgrown_trees_are_built_again() {
    let mut loaded = moving();
    for (i, instance) in loaded.instances.iter_mut().enumerate().skip(1) {
        let (x, z) = ((i as f32 * 2.1).cos(), (i as f32 * 2.1).sin());
        let step = |f: usize| if f < 10 { 0.002 * f as f32 } else { f as f32 };
        let place = |f: usize| Affine3A::from_translation(Vec3::new(x, 0.0, z) * step(f)) * instance.transforms[0];
        instance.transforms = (0..FRAMES).map(place).collect();
    }
    let mut walked = compile(&loaded);
    for frame in [1, 2, 12, 13, 1] {
        let before = walked.builds().flattened;
        walked.set_frame(frame);
        assert_eq!(walked.builds().flattened - before, usize::from(frame > 2), "frame {frame}");
        assert!(render(&walked, 2) == render(&compile_at(&loaded, frame), 2), "frame {frame}");
    }
}

/// A ball that is a point at one frame has no triangles there; it has them again afterwards.
#[test]
fn triangles_may_vanish_and_come_back() {
    let mut loaded = moving();
    loaded.instances[5].transforms[4] = Affine3A::from_scale(Vec3::ZERO);
    let mut walked = compile(&loaded);
    let all = walked.triangle_count();
    for frame in [3, 4, 5, 4, 0] {
        walked.set_frame(frame);
        assert_eq!(walked.triangle_count() < all, frame == 4, "frame {frame}");
        assert_eq!(walked.triangle_count() + walked.dropped_triangles(), all);
        assert!(render(&walked, 2) == render(&compile_at(&loaded, frame), 2), "frame {frame}");
    }
}
