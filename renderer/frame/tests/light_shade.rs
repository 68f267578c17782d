//! The split-sum picture: energy, coverage, borrowed values and filtered guides.

mod light_scene;

use glam::{Vec2, Vec3A};
use light_scene::{Surface, render};
use renderflow_frame::environment::Environment;
use renderflow_frame::ibl::{dielectric, environment_brdf, shade};
use renderflow_frame::image::Rgb;
use renderflow_frame::{Camera, Frame, Light};

const SIZE: usize = 64;

fn camera() -> Camera {
    Camera::look_at(Vec3A::new(0.3, 0.8, 2.5), Vec3A::new(0.0, 0.1, 0.0), Vec3A::Y, 0.6, SIZE, SIZE)
}

fn sphere() -> Frame {
    render(&[Surface::Sphere(Vec3A::ZERO, 0.5)], &camera())
}

/// Radiance 2 + d.x, 1 + 0.5 d.y, 1.
fn sky() -> Environment {
    let plain = Environment { map: Rgb::filled(256, 128, [0.0; 3]), rotation: 0.0, intensity: 1.0 };
    let map = Rgb::from_fn(256, 128, |x, y| {
        let d = plain.texel_direction(x, y);
        [2.0 + d.x, 1.0 + 0.5 * d.y, 1.0]
    });
    Environment { map, ..plain }
}

#[test]
fn uniform_light_gives_albedo_plus_reflection() {
    let light = Light::new(Environment::constant([2.0, 1.0, 0.5]));
    for (metallic, roughness) in [(0.0, 0.0), (0.0, 0.7), (1.0, 0.3), (0.4, 1.0)] {
        let mut frame = sphere();
        for material in &mut frame.material.pixels {
            *material = [roughness, metallic, 0.5];
        }
        let shading = shade(&frame, &light);
        for (i, alpha) in frame.alpha.pixels.iter().enumerate() {
            let expected = if *alpha == 0.0 {
                [2.0, 1.0, 0.5]
            } else {
                let pixel = Vec2::new((i % SIZE) as f32 + 0.5, (i / SIZE) as f32 + 0.5);
                let v = -camera().direction_cam(pixel).normalize();
                let brdf = environment_brdf(v.dot(Vec3A::from_array(frame.normal.pixels[i])).max(1e-3), roughness);
                let (metal, coat) = (brdf.conductor(Vec3A::splat(0.5)).x, brdf.dielectric(&dielectric(0.5)));
                [2.0, 1.0, 0.5].map(|light| light * (metal * metallic + (0.5 + coat) * (1.0 - metallic)))
            };
            for k in 0..3 {
                let found = shading.image.pixels[i][k];
                assert!((found - expected[k]).abs() < 1e-4, "pixel {i}: {:?} against {expected:?}", shading.image.pixels[i]);
            }
        }
    }
}

#[test]
fn a_mirror_shows_the_sky_behind_the_camera() {
    let light = Light::new(Environment { rotation: 0.6, intensity: 1.5, ..sky() });
    let mut frame = sphere();
    frame.albedo = Rgb::filled(SIZE, SIZE, [1.0; 3]);
    frame.material = Rgb::filled(SIZE, SIZE, [0.0, 1.0, 0.5]);
    let shading = shade(&frame, &light);
    let mut checked = 0;
    for i in (0..SIZE * SIZE).filter(|i| frame.alpha.pixels[*i] > 0.0) {
        let ray = camera().ray_direction(Vec2::new((i % SIZE) as f32 + 0.5, (i / SIZE) as f32 + 0.5));
        let n = camera().camera_to_world.matrix3 * Vec3A::from_array(frame.normal.pixels[i]);
        let expected = light.environment.radiance(ray - n * (2.0 * ray.dot(n)));
        // F0 = 1 and no masking: everything is reflected.
        for k in 0..3 {
            assert!((shading.image.pixels[i][k] - expected[k]).abs() < 3e-3, "{:?} {expected:?}", shading.image.pixels[i]);
        }
        assert_eq!(shading.diffuse.pixels[i], [0.0; 3]);
        checked += 1;
    }
    assert!(checked > 500);
}

#[test]
fn coverage_mixes_with_the_background_and_borrows_at_the_rim() {
    let light = Light::new(sky());
    let mut frame = sphere();
    // A rim pixel: half covered, its centre missed, its left neighbour hit.
    let i = (0..SIZE * SIZE)
        .find(|i| i % SIZE > 0 && !frame.depth.pixels[*i].is_finite() && frame.depth.pixels[i - 1].is_finite())
        .expect("a rim");
    frame.alpha.pixels[i] = 0.25;
    frame.material.pixels[i - 1] = [0.31, 0.0, 0.5];
    let mut guide_albedo = frame.albedo.clone();
    let mut guide_normal = frame.normal.clone();
    let n = Vec3A::new(0.3, 0.1, 0.9).normalize();
    guide_albedo.pixels[i] = [0.2, 0.1, 0.05];
    guide_normal.pixels[i] = (n * 0.2).to_array();
    frame.guide_albedo = Some(guide_albedo);
    frame.guide_normal = Some(guide_normal);
    let shading = shade(&frame, &light);
    assert!((shading.surfaces.material.pixels[i][0] - 0.31).abs() < 1e-6);
    assert_eq!(shading.surfaces.depth.pixels[i], frame.depth.pixels[i - 1]);
    assert!(Vec3A::from_array(shading.surfaces.normal.pixels[i]).distance(n) < 1e-6);
    let albedo = shading.surfaces.albedo.pixels[i];
    assert!((albedo[0] - 0.8).abs() < 1e-6 && (albedo[2] - 0.2).abs() < 1e-6, "{albedo:?}");
    let ray = camera().ray_direction(Vec2::new((i % SIZE) as f32 + 0.5, (i / SIZE) as f32 + 0.5));
    let background = light.environment.radiance(ray);
    for (k, behind) in background.iter().enumerate() {
        let surface = shading.diffuse.pixels[i][k] * shading.irradiance.pixels[i][k] + shading.specular.pixels[i][k];
        assert!((shading.image.pixels[i][k] - 0.25 * surface - 0.75 * behind).abs() < 1e-5);
    }
    assert_eq!(shading.surfaces.background.pixels[i], background);
    // Open pixels show the background alone.
    assert_eq!(shading.surfaces.alpha.pixels[0], 0.0);
    assert_eq!(shading.image.pixels[0], shading.surfaces.background.pixels[0]);
    assert!(shading.surfaces.depth.pixels[0].is_infinite() && shading.surfaces.normal.pixels[0] == [0.0; 3]);
}

#[test]
fn normals_facing_away_and_lone_coverage_stay_finite() {
    let light = Light::new(sky());
    let mut frame = sphere();
    for i in 0..SIZE * SIZE {
        frame.normal.pixels[i] = [[0.0, 0.0, -1.0], [0.0; 3], [1.0, 0.0, 0.0]][i % 3];
        frame.alpha.pixels[i] = [1.0, 0.5, 1e-30, 0.0][i % 4];
    }
    let shading = shade(&frame, &light);
    for picture in [
        &shading.image,
        &shading.specular,
        &shading.irradiance,
        &shading.prefiltered,
        &shading.surfaces.normal,
        &shading.surfaces.albedo,
    ] {
        assert!(picture.pixels.iter().flatten().all(|v| v.is_finite()));
    }
    // Covered with nothing hit anywhere near: an unknown rough dielectric, no depth.
    let corner = SIZE + 1;
    assert!(shading.surfaces.depth.pixels[corner].is_infinite());
    assert_eq!(shading.surfaces.material.pixels[corner], [1.0, 0.0, 0.5]);
    assert!(shade(&Frame::default(), &light).image.pixels.is_empty());
}
