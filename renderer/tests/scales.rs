//! A scene a million times smaller or larger, or standing away from the origin, looks the same.

mod common;

use common::{diffuse, instance, plane, scene, sphere, sunny};
use glam::{Affine3A, Quat, Vec3, Vec3A};
use renderflow_frame::{Camera, Frame};
use renderflow_renderer::{RenderScene, Settings, Sharing};

fn picture(scale: f32, offset: Vec3, sharing: Sharing) -> Frame {
    let place = Affine3A::from_scale_rotation_translation(Vec3::splat(scale), Quat::IDENTITY, offset * scale);
    let ball = Affine3A::from_scale_rotation_translation(
        Vec3::new(0.5, 0.5, -0.5),
        Quat::from_rotation_x(0.4),
        Vec3::new(0.0, 0.5, 0.0),
    );
    let parts = vec![(plane(40.0), diffuse([0.6; 3]), place), (sphere(16, true), diffuse([0.8, 0.4, 0.2]), place * ball)];
    let at = |p: [f32; 3]| (Vec3A::from_array(p) + Vec3A::from(offset)) * scale;
    let camera = Camera::look_at(at([2.0, 1.4, 3.0]), at([0.0, 0.4, 0.0]), Vec3A::Y, 0.7, 48, 36);
    let mut loaded = scene(parts, sunny(), camera);
    for k in 0..6u8 {
        let small = Affine3A::from_scale_rotation_translation(
            Vec3::splat(0.1),
            Quat::from_rotation_z(f32::from(k)),
            Vec3::new(0.4 * f32::from(k) - 1.0, 0.1, 0.8),
        );
        loaded.instances.push(instance(1, 1, place * small));
    }
    let compiled = RenderScene::compile_with(&loaded, sharing).expect("the scene is consistent");
    let (frame, stats) = common::render_with(&compiled, &Settings { spp: 64, ..Settings::default() });
    common::check_frame(&frame);
    assert_eq!(stats.non_finite_samples, 0);
    frame
}

/// Of pixels on the same object: how many differ by more than noise allows, and the ratio of the means.
fn compare(a: &Frame, b: &Frame, scale: f32) -> (usize, f64) {
    let raw = |f: &Frame| f.raw.clone().expect("rendered").pixels;
    let variance = |f: &Frame| f.variance.clone().expect("rendered").pixels;
    let (ra, rb, va, vb) = (raw(a), raw(b), variance(a), variance(b));
    let mut apart = 0;
    let (mut sum_a, mut sum_b) = (0.0f64, 0.0f64);
    for i in 0..ra.len() {
        let (da, db) = (a.depth.pixels[i] * scale, b.depth.pixels[i]);
        if a.object_id.pixels[i] != b.object_id.pixels[i] || (da.is_finite() && (da - db).abs() > 1e-3 * da) {
            apart += 1;
            continue;
        }
        let noise = 5.0 * (va[i][1] + vb[i][1]).max(0.0).sqrt() + 1e-3;
        apart += usize::from((ra[i][1] - rb[i][1]).abs() > noise);
        sum_a += f64::from(ra[i][1]);
        sum_b += f64::from(rb[i][1]);
    }
    (apart, sum_b / sum_a)
}

#[test]
fn pictures_do_not_depend_on_scale_or_place() {
    let unit = picture(1.0, Vec3::ZERO, Sharing::Never);
    for sharing in [Sharing::Never, Sharing::Always] {
        for scale in [1e-6, 1.0, 1e6] {
            for offset in [Vec3::ZERO, Vec3::new(100.0, -60.0, 80.0)] {
                let (apart, ratio) = compare(&unit, &picture(scale, offset, sharing), scale);
                println!("{sharing:?}, scale {scale:e}, offset {offset}: {apart} pixels differ, mean radiance {ratio:.5}");
                // Offsets cost 100 of the numbers' digits; outlines move by that much.
                assert!(apart <= if offset == Vec3::ZERO { 2 } else { 8 } && (ratio - 1.0).abs() < 2e-3);
            }
        }
    }
}

/// A ground two thousand times larger than what stands on it keeps the contact: rays that leave it meet a plate 1 mm above. (They
/// start half a millionth of the triangle's size above it: beyond a ground of 2 km they would start above the plate.)
#[test]
fn contact_shadows_on_large_grounds() {
    for size in [1.0f32, 100.0, 1e3] {
        // Seen from between the two.
        let plate =
            Affine3A::from_scale_rotation_translation(Vec3::new(1.0, 1.0, 1.0), Quat::IDENTITY, Vec3::new(0.0, 1e-3, 0.0));
        let parts = vec![(plane(size), diffuse([0.5; 3]), Affine3A::IDENTITY), (plane(0.5), diffuse([0.0; 3]), plate)];
        let camera = Camera::look_at(Vec3A::new(0.0, 5e-4, 0.2), Vec3A::new(0.0, 0.0, 0.195), Vec3A::Y, 0.3, 9, 9);
        let (frame, _) = common::render(&common::compile(&scene(parts, sunny(), camera)), 64);
        let raw = frame.raw.expect("rendered");
        let brightest =
            raw.pixels.iter().zip(&frame.object_id.pixels).filter(|(_, id)| **id == 1).map(|(p, _)| p[1]).fold(0.0, f32::max);
        println!("ground of {size} m: {brightest:e} under the plate");
        assert!(frame.object_id.pixels.contains(&1));
        // 0.2 m inside, the sky is seen through a slit of 1 mm at 5 cm: less than a hundredth of it.
        assert!(brightest < 0.05, "{size}: {brightest}");
    }
}
