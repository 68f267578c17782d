//! The environment against what can be worked out by hand: orientation, averages over the sphere, equal-area tiles.

use glam::{Mat3A, Vec2, Vec3A};
use renderflow_frame::Camera;
use renderflow_frame::color::luminance;
use renderflow_frame::environment::Environment;
use renderflow_frame::image::Rgb;
use std::f32::consts::PI;

/// A smooth map of known shape: radiance 2 + d.x + 0.5 d.y in red, 1 in green, 1 - d.z in blue (map space).
fn smooth(width: usize, height: usize) -> Environment {
    let plain = Environment { map: Rgb::filled(width, height, [0.0; 3]), rotation: 0.0, intensity: 1.0 };
    let map = Rgb::from_fn(width, height, |x, y| {
        let d = plain.texel_direction(x, y);
        [2.0 + d.x + 0.5 * d.y, 1.0, 1.0 - d.z]
    });
    Environment { map, ..plain }
}

/// A black map with one lit texel.
fn one_texel(width: usize, height: usize, column: usize, row: usize, value: f32) -> Environment {
    let mut map = Rgb::filled(width, height, [0.0; 3]);
    map.pixels[row * width + column] = [value; 3];
    Environment { map, rotation: 0.0, intensity: 1.0 }
}

/// Directions spread over the sphere, poles and axes among them.
fn directions() -> Vec<Vec3A> {
    let mut list = vec![Vec3A::X, Vec3A::Y, Vec3A::Z, -Vec3A::X, -Vec3A::Y, -Vec3A::Z];
    list.extend((0..500).map(|i| {
        let y = 1.0 - 2.0 * (i as f32 + 0.5) / 500.0;
        let phi = 2.399_963 * i as f32;
        let r = (1.0 - y * y).sqrt();
        Vec3A::new(r * phi.cos(), y, r * phi.sin())
    }));
    list
}

#[test]
fn axes_land_where_the_convention_says() {
    let env = smooth(64, 32);
    for (direction, u, v) in [(-Vec3A::Z, 0.0, 0.5), (Vec3A::X, 0.25, 0.5), (Vec3A::Z, 0.5, 0.5), (-Vec3A::X, 0.75, 0.5)] {
        let uv = env.uv(direction);
        let du = (uv.x - u + 0.5).rem_euclid(1.0) - 0.5;
        assert!(du.abs() < 1e-6 && (uv.y - v).abs() < 1e-6, "{direction} -> {uv}");
    }
    assert!(env.uv(Vec3A::Y).y.abs() < 1e-6);
    assert!((env.uv(-Vec3A::Y).y - 1.0).abs() < 1e-6);
}

#[test]
fn direction_inverts_uv_under_rotation() {
    for rotation in [0.0, 0.7, -2.5, 9.0] {
        let env = Environment { rotation, ..smooth(16, 8) };
        for d in directions() {
            let uv = env.uv(d);
            assert!((0.0..=1.0).contains(&uv.x) && (0.0..=1.0).contains(&uv.y));
            assert!(env.direction(uv).distance(d) < 2e-6, "{d} rotation {rotation}");
        }
    }
}

#[test]
fn rotation_turns_the_sky_about_y() {
    let still = smooth(128, 64);
    for angle in [0.3, 1.9, -4.0] {
        let turned = Environment { rotation: angle, ..still.clone() };
        let about_y = Mat3A::from_rotation_y(angle);
        for d in directions() {
            // The sky turns by +angle: what stood in direction d now stands in R d.
            let (a, b) = (still.radiance(d), turned.radiance(about_y * d));
            assert!((0..3).all(|i| (a[i] - b[i]).abs() < 1e-4), "{d}: {a:?} against {b:?}");
        }
    }
}

#[test]
fn bilinear_lookup_follows_a_smooth_map_across_the_seam_and_the_poles() {
    let env = Environment { intensity: 3.0, ..smooth(256, 128) };
    for d in directions() {
        let expected = [3.0 * (2.0 + d.x + 0.5 * d.y), 3.0, 3.0 * (1.0 - d.z)];
        let found = env.radiance(d);
        for i in 0..3 {
            assert!((found[i] - expected[i]).abs() < 2e-3, "{d}: {found:?} against {expected:?}");
        }
    }
    // Near a pole all azimuths agree.
    for phi in [0.0_f32, 1.0, 2.0, 4.0] {
        let near = Vec3A::new(1e-4 * phi.cos(), 1.0, 1e-4 * phi.sin()).normalize();
        assert!((env.radiance(near)[0] - 7.5).abs() < 2e-3);
    }
}

#[test]
fn odd_and_single_texel_maps_are_looked_up() {
    for (width, height) in [(1, 1), (1, 3), (3, 1), (5, 3), (2, 2)] {
        let env = Environment { map: Rgb::filled(width, height, [0.25, 1.0, 4.0]), rotation: 1.0, intensity: 2.0 };
        for d in directions() {
            let found = env.radiance(d);
            assert!((found[0] - 0.5).abs() < 1e-6 && (found[1] - 2.0).abs() < 1e-6 && (found[2] - 8.0).abs() < 1e-5);
        }
    }
    let empty = Environment { map: Rgb::default(), rotation: 0.0, intensity: 1.0 };
    assert_eq!(empty.radiance(Vec3A::X), [0.0; 3]);
}

#[test]
fn texels_cover_the_sphere() {
    for (width, height) in [(1, 1), (7, 5), (64, 32)] {
        let env = one_texel(width, height, 0, 0, 1.0);
        let total: f32 = (0..height).map(|row| width as f32 * env.texel_solid_angle(row)).sum();
        assert!((total - 4.0 * PI).abs() < 1e-4);
    }
}

#[test]
fn downsampling_keeps_energy_and_averages_by_area() {
    let energy = |env: &Environment| -> f64 {
        (0..env.map.pixels.len())
            .map(|i| f64::from(env.map.pixels[i][0]) * f64::from(env.texel_solid_angle(i / env.map.width)))
            .sum()
    };
    let source = one_texel(100, 50, 37, 3, 1e5);
    for (width, height) in [(100, 50), (64, 32), (33, 7), (1, 1), (200, 100), (128, 20)] {
        let small = source.downsampled(width, height);
        assert_eq!((small.map.width, small.map.height), (width, height));
        let ratio = energy(&small) / energy(&source);
        assert!((ratio - 1.0).abs() < 1e-5, "{width}x{height}: {ratio}");
    }
    // Mean over the sphere of 2 + x + y/2 is 2, of 1 - z is 1.
    let mean = smooth(512, 256).downsampled(1, 1).map.pixels[0];
    assert!((mean[0] - 2.0).abs() < 1e-4 && (mean[1] - 1.0).abs() < 1e-6 && (mean[2] - 1.0).abs() < 1e-4, "{mean:?}");
}

#[test]
fn dominant_light_is_found_and_split_off() {
    // A sky of 0.5 with a disc of radius 0.06 rad at 40 degrees of elevation.
    let direction = Vec3A::new(0.6, 0.643, -0.475).normalize();
    let plain = Environment { map: Rgb::filled(1024, 512, [0.0; 3]), rotation: 0.9, intensity: 1.5 };
    let map = Rgb::from_fn(1024, 512, |x, y| {
        let inside = plain.texel_direction(x, y).angle_between(direction) < 0.06;
        if inside { [2000.5, 1800.5, 1000.5] } else { [0.5; 3] }
    });
    let env = Environment { map, ..plain };
    let (light, rest) = env.split_dominant();
    assert!(light.direction.angle_between(direction) < 1e-3);
    assert!((light.angular_radius - 0.06).abs() < 2e-3, "{}", light.angular_radius);
    // Irradiance of a disc facing it: L pi sin^2; of the sky: L pi.
    let expected = 1.5 * 2000.0 * PI * 0.06_f32.sin().powi(2);
    assert!((light.irradiance[0] / expected - 1.0).abs() < 0.02, "{} {expected}", light.irradiance[0]);
    let bright = luminance(light.irradiance);
    assert!((light.share - bright / (bright + 1.5 * 0.5 * PI)).abs() < 5e-3, "{}", light.share);
    let brightest = rest.map.pixels.iter().map(|p| luminance(*p)).fold(0.0, f32::max);
    assert!(brightest < 0.6, "{brightest}");

    let constant = Environment::constant([3.0, 2.0, 1.0]).dominant_light();
    assert_eq!((constant.direction, constant.share), (Vec3A::Y, 0.0));
    let black = Environment { map: Rgb::filled(8, 4, [0.0; 3]), rotation: 0.0, intensity: 1.0 };
    assert_eq!(black.dominant_light().share, 0.0);
}

#[test]
fn uv_never_leaves_the_map() {
    let env = Environment { rotation: -1e-9, ..one_texel(4, 2, 0, 0, 1.0) };
    for d in [Vec3A::new(-1e-12, 0.0, -1.0), Vec3A::new(0.0, 1.0, -0.0), Vec3A::ZERO, Vec3A::new(-0.0, -1.0, 0.0)] {
        let uv = env.uv(d);
        assert!((0.0..=1.0).contains(&uv.x) && (0.0..=1.0).contains(&uv.y), "{uv}");
        assert!(env.radiance_uv(uv).iter().all(|v| v.is_finite()));
    }
    assert!(env.radiance_uv(Vec2::new(1.0, 1.0)).iter().all(|v| v.is_finite()));
}

/// The mean over a pixel is the mean of 64 x 64 directions within it: to a rounding where radiance hardly changes, and to a few
/// per cent of a lamp whose edge lies in the pixel, where the centre of the pixel is off by far more.
#[test]
fn pixels_see_the_mean_of_their_directions() {
    let camera = Camera::look_at(Vec3A::ZERO, Vec3A::new(0.3, 0.1, -1.0), Vec3A::Y, 0.8, 24, 16);
    let places: Vec<(usize, usize)> = (0..16).flat_map(|y| (0..24).map(move |x| (x, y))).collect();
    let mean = |env: &Environment, (x, y): (usize, usize)| {
        let at = |i: usize, n: usize| n as f32 + (i as f32 + 0.5) / 64.0;
        let seen = |i: usize| env.radiance(camera.ray_direction(Vec2::new(at(i % 64, x), at(i / 64, y))));
        (0..64 * 64).map(|i| Vec3A::from_array(seen(i))).sum::<Vec3A>() / (64.0 * 64.0)
    };
    assert_eq!(Environment::constant([0.5, 2.0, 3.0]).over_pixel(&camera, (3, 4)), [0.5, 2.0, 3.0]);
    let sky = smooth(64, 32);
    for &place in &places {
        assert!((Vec3A::from_array(sky.over_pixel(&camera, place)) - mean(&sky, place)).abs().max_element() < 1e-4, "{place:?}");
    }
    // A texel covers about four pixels by four, so that its edge is steep within them.
    let mut map = Rgb::filled(256, 128, [0.1; 3]);
    (56..60).for_each(|row| (4..12).for_each(|column| map.pixels[row * 256 + column] = [10.0; 3]));
    let lamp = Environment { map, rotation: 0.0, intensity: 1.0 };
    let mut worst = [0.0_f32; 2];
    for &(x, y) in &places {
        let truth = mean(&lamp, (x, y));
        let centre = lamp.radiance(camera.ray_direction(Vec2::new(x as f32 + 0.5, y as f32 + 0.5)));
        for (worst, seen) in worst.iter_mut().zip([lamp.over_pixel(&camera, (x, y)), centre]) {
            *worst = worst.max((Vec3A::from_array(seen) - truth).abs().max_element());
        }
    }
    assert!(worst[0] < 0.3 && worst[1] > 4.0 * worst[0], "{worst:?}");
}
