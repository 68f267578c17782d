//! The split-sum picture: energy, coverage, borrowed values and filtered guides.

mod light_scene;

use glam::{Vec2, Vec3A};
use light_scene::{Surface, render};
use renderflow_frame::environment::Environment;
use renderflow_frame::ibl::{dielectric, environment_brdf, shade, shade_surfaces, surfaces};
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
    // One part for each pixel: what its centre reflects.
    let mut surfaces = surfaces(&frame, &light.environment);
    surfaces.bend.pixels.fill([[0.0; 3]; 2]);
    let shading = shade_surfaces(&camera(), surfaces, light.tables());
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

/// A curved, shiny surface reflects a small lamp as the mean over each pixel does, and not as the pixel's centre does. A flat one
/// has one part.
#[test]
fn curvature_widens_reflections() {
    const FINER: usize = 8;
    let mut map = Rgb::filled(512, 256, [0.2; 3]);
    (60..63).for_each(|row| (30..33).for_each(|column| map.pixels[row * 512 + column] = [2000.0; 3]));
    let light = Light::new(Environment { map, rotation: 2.6, intensity: 1.0 });
    let seen = |size: usize, curved: bool| {
        let camera = Camera::look_at(Vec3A::new(0.3, 0.8, 2.5), Vec3A::new(0.0, 0.1, 0.0), Vec3A::Y, 0.6, size, size);
        let mut frame = render(&[Surface::Sphere(Vec3A::ZERO, 0.5)], &camera);
        frame.albedo = Rgb::filled(size, size, [1.0; 3]);
        frame.material = Rgb::filled(size, size, [0.08, 1.0, 0.5]);
        let mut surfaces = surfaces(&frame, &light.environment);
        if !curved {
            surfaces.bend.pixels.fill([[0.0; 3]; 2]);
        }
        shade_surfaces(&camera, surfaces, light.tables())
    };
    let size = 24;
    let (fine, coarse) = (seen(size * FINER, false), [true, false].map(|curved| seen(size, curved)));
    let mut errors = [0.0; 2];
    for i in 0..size * size {
        let (x, y) = (i % size * FINER, i / size * FINER);
        let inside = |k: usize| (y + k / FINER) * size * FINER + x + k % FINER;
        if (0..FINER * FINER).all(|k| fine.surfaces.alpha.pixels[inside(k)] > 0.0) {
            let mean = (0..FINER * FINER).map(|k| fine.image.pixels[inside(k)][1]).sum::<f32>() / (FINER * FINER) as f32;
            for (error, coarse) in errors.iter_mut().zip(&coarse) {
                *error += ((coarse.image.pixels[i][1] - mean) / (mean + 0.1)).powi(2);
            }
        }
    }
    assert!(errors[0] < 0.5 * errors[1], "{errors:?}");
    let wall = render(&[Surface::Plane(Vec3A::ZERO, Vec3A::Z)], &camera());
    assert!(surfaces(&wall, &light.environment).bend.pixels.iter().flatten().flatten().all(|bend| bend.abs() < 1e-6));
}

/// Clear surfaces mirror along their own normals, whatever lies behind them. What lies behind is lit along the normals of the
/// guides.
#[test]
fn clear_surfaces_mirror_for_themselves() {
    let light = Light::new(sky());
    let mut own = sphere();
    own.material.pixels.fill([0.3, 0.0, 0.5]);
    let guided = Frame {
        guide_albedo: Some(Rgb { pixels: own.alpha.pixels.iter().map(|alpha| [0.4 * alpha; 3]).collect(), ..own.albedo.clone() }),
        guide_normal: Some(Rgb {
            pixels: own.alpha.pixels.iter().map(|alpha| [0.0, *alpha, 0.0]).collect(),
            ..own.normal.clone()
        }),
        ..own.clone()
    };
    let mut half = guided.clone();
    half.transmittance = Some(Rgb::from_fn(SIZE, SIZE, |x, _| if x < SIZE / 2 { [0.5; 3] } else { [0.0; 3] }));
    let [own, guided, half] = [own, guided, half].map(|frame| shade(&frame, &light));
    let mut apart = 0;
    for i in (0..SIZE * SIZE).filter(|i| own.surfaces.alpha.pixels[*i] > 0.0) {
        let front = if i % SIZE < SIZE / 2 { &own } else { &guided };
        assert_eq!(half.prefiltered.pixels[i], front.prefiltered.pixels[i], "pixel {i}");
        assert_eq!(half.surfaces.brdf.pixels[i], front.surfaces.brdf.pixels[i], "pixel {i}");
        assert_eq!(half.irradiance.pixels[i], guided.irradiance.pixels[i], "pixel {i}");
        apart += usize::from(own.prefiltered.pixels[i] != guided.prefiltered.pixels[i]);
    }
    assert!(apart > 500, "{apart} pixels");
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
    let background = light.environment.over_pixel(&camera(), (i % SIZE, i / SIZE));
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

/// A wall whose left half is metal that leans left, and whose right half is grey and leans right. In the first column of the
/// right half, guides have a share of the left half.
fn halves(share: f32) -> Frame {
    let mut frame = sphere();
    let left = |i: usize| i % SIZE < SIZE / 2;
    let [leans_left, leans_right] = [-0.6f32, 0.6].map(|x| Vec3A::new(x, 0.0, 0.8));
    for i in 0..SIZE * SIZE {
        (frame.alpha.pixels[i], frame.depth.pixels[i]) = (1.0, 2.0);
        let (normal, albedo, material) =
            if left(i) { (leans_left, [0.9, 0.7, 0.1], [0.1, 1.0, 0.5]) } else { (leans_right, [0.4; 3], [0.8, 0.0, 0.5]) };
        frame.normal.pixels[i] = normal.to_array();
        (frame.albedo.pixels[i], frame.material.pixels[i]) = (albedo, material);
    }
    let (mut albedo, mut normal) = (frame.albedo.clone(), frame.normal.clone());
    for i in (0..SIZE * SIZE).filter(|i| i % SIZE == SIZE / 2) {
        for picture in [&mut albedo, &mut normal] {
            let [a, b] = [picture.pixels[i - 1], picture.pixels[i]];
            picture.pixels[i] = [0, 1, 2].map(|c| share * a[c] + (1.0 - share) * b[c]);
        }
    }
    (frame.guide_albedo, frame.guide_normal) = (Some(albedo), Some(normal));
    frame
}

/// A pixel that two surfaces share looks as the mean of both, and not as their mean would.
#[test]
fn surfaces_that_meet_in_a_pixel_are_shaded_apart() {
    let light = Light::new(sky());
    let (pure, mixed) = (shade(&halves(0.0), &light), shade(&halves(0.3), &light));
    assert!(pure.surfaces.edges.is_empty());
    assert_eq!(mixed.surfaces.edges.len(), SIZE);
    for edge in &mixed.surfaces.edges {
        assert_eq!((edge.at % SIZE, edge.other % SIZE), (SIZE / 2, SIZE / 2 - 1));
        assert!((edge.share - 0.3).abs() < 1e-4, "{}", edge.share);
        let pictures = [(&mixed.image, &pure.image), (&mixed.specular, &pure.specular), (&mixed.irradiance, &pure.irradiance)];
        for (found, alone) in pictures {
            let expected = [0, 1, 2].map(|c| 0.3 * alone.pixels[edge.other][c] + 0.7 * alone.pixels[edge.at][c]);
            let found = found.pixels[edge.at];
            assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-3), "{found:?} and {expected:?}");
        }
        // Whoever reads the surfaces finds the means of the pixel.
        let guide = halves(0.3).guide_albedo.expect("a guide").pixels[edge.at];
        assert_eq!(mixed.surfaces.albedo.pixels[edge.at], guide);
    }
    let others = (0..SIZE * SIZE).filter(|i| i % SIZE != SIZE / 2);
    assert!(others.into_iter().all(|i| mixed.image.pixels[i] == pure.image.pixels[i]));
}

#[test]
fn only_what_two_surfaces_explain_is_an_edge() {
    let light = Light::new(sky());
    let edges = |change: &dyn Fn(&mut Frame)| {
        let mut frame = halves(0.3);
        change(&mut frame);
        shade(&frame, &light).surfaces.edges.len()
    };
    let here = |i: &usize| i % SIZE == SIZE / 2;
    assert_eq!(edges(&|_| ()), SIZE);
    assert_eq!(edges(&|frame| frame.guide_normal = None), 0);
    assert_eq!(edges(&|frame| frame.alpha.pixels.fill(0.9)), 0);
    // A third surface that no neighbour shows.
    let third = |frame: &mut Frame| {
        let albedo = frame.guide_albedo.as_mut().expect("a guide");
        (0..SIZE * SIZE).filter(here).for_each(|i| albedo.pixels[i] = [0.0, 0.0, 1.0]);
    };
    assert_eq!(edges(&third), 0);
    // A pattern on one surface: its mean is what the pixel shows.
    let flat = |frame: &mut Frame| {
        frame.normal.pixels.fill([0.0, 0.0, 1.0]);
        frame.guide_normal = Some(frame.normal.clone());
        frame.material.pixels.fill([0.5, 0.0, 0.5]);
    };
    assert_eq!(edges(&flat), 0);
    // A clear surface is no part of one, and nonsense is none.
    assert_eq!(edges(&|frame| frame.through = Some(Rgb::filled(SIZE, SIZE, [0.0, 0.0, -1.0]))), 0);
    for nonsense in [f32::NAN, f32::INFINITY, -f32::MAX] {
        let broken = |frame: &mut Frame| {
            let albedo = frame.guide_albedo.as_mut().expect("a guide");
            (0..SIZE * SIZE).filter(here).for_each(|i| albedo.pixels[i] = [nonsense; 3]);
        };
        assert_eq!(edges(&broken), 0, "{nonsense}");
    }
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
