//! Lights taken out of an environment, and what they give a surface, against integrals over the map itself.

#[path = "../frame/tests/light_scene/mod.rs"]
mod light_scene;

mod common;

use glam::{Affine3A, Quat, Vec3A};
use light_scene::{Surface, render};
use renderflow_frame::image::Rgb;
use renderflow_frame::{Camera, Environment, Light};
use renderflow_renderer::deferred::{LIGHTS, Lighting, Material, Options, Shadows, shade, shadow_maps};
use renderflow_scenes::Principled;
use renderflow_scenes::loaded::{PunctualKind, PunctualLight};
use std::f32::consts::PI;

const OFF: Options = Options::NONE;

/// Discs (direction, radius, radiance) before a sky of even radiance.
fn discs(list: &[(Vec3A, f32, [f32; 3])], sky: f32) -> Environment {
    let plain = Environment { map: Rgb::filled(1024, 512, [0.0; 3]), rotation: 0.3, intensity: 1.5 };
    let map = Rgb::from_fn(1024, 512, |x, y| {
        let direction = plain.texel_direction(x, y);
        list.iter().find(|(d, radius, _)| direction.angle_between(*d) < *radius).map_or([sky; 3], |disc| disc.2)
    });
    Environment { map, ..plain }
}

/// Sum over all texels of `f(direction) L dw`.
fn integral(environment: &Environment, f: impl Fn(Vec3A) -> Vec3A) -> [Vec3A; 3] {
    let mut sum = [Vec3A::ZERO; 3];
    for row in 0..environment.map.height {
        let weight = environment.texel_solid_angle(row) * environment.intensity;
        for column in 0..environment.map.width {
            let value = f(environment.texel_direction(column, row));
            (0..3).for_each(|c| sum[c] += value * (environment.map.at(column, row)[c] * weight));
        }
    }
    sum
}

fn three() -> Environment {
    let direction = |x, y, z| Vec3A::new(x, y, z).normalize();
    discs(
        &[
            (direction(0.3, 0.8, 0.2), 0.05, [300.0, 280.0, 200.0]),
            (direction(-0.9, 0.3, 0.1), 0.12, [30.0, 20.0, 10.0]),
            (direction(0.2, 0.4, -0.9), 0.08, [20.0, 30.0, 60.0]),
        ],
        0.2,
    )
}

#[test]
fn lights_and_rest_hold_all_of_the_light() {
    let environment = three();
    let (lights, rest) = environment.split_lights(4);
    assert_eq!(lights.len(), 3, "{lights:?}");
    assert_eq!(lights[0], environment.dominant_light());
    assert_eq!(environment.split_lights(1).1, environment.split_dominant().1);
    let first = |e: &Environment| integral(e, |d| d);
    let (whole, left) = (first(&environment), first(&rest));
    for c in 0..3 {
        // A light's irradiance times its direction is the first moment of its radiance.
        let taken: Vec3A = lights.iter().map(|light| light.direction * light.irradiance[c]).sum();
        let error = (whole[c] - left[c] - taken).length();
        assert!(error < 0.003 * whole[c].length(), "channel {c}: {error} of {}", whole[c]);
    }
    for (rest, all) in rest.map.pixels.iter().zip(&environment.map.pixels) {
        assert!((0..3).all(|c| rest[c] >= 0.0 && rest[c] <= all[c]));
    }
    // Even light has no lights, and weak ones stay in the rest.
    assert!(Environment::constant([2.0; 3]).split_lights(4).0.is_empty());
    let weak = discs(&[(Vec3A::Y, 0.05, [2.0; 3])], 1.0);
    assert!(weak.split_lights(4).0.is_empty(), "{:?}", weak.split_lights(4).0);
    assert!(environment.split_lights(0).0.is_empty());
}

#[test]
fn a_disc_lights_a_lambertian_plane_by_its_cosine() {
    // Without coat and roughness the base is Lambert's.
    for (sun, radius) in [(Vec3A::new(0.2, 1.0, 0.1), 0.02), (Vec3A::new(-0.8, 0.5, 0.3), 0.1), (Vec3A::new(0.9, 0.25, 0.0), 0.1)]
    {
        let environment = discs(&[(sun.normalize(), radius, [400.0, 200.0, 100.0])], 0.0);
        let lighting = Lighting::new(Light::new(environment.clone()), 4);
        let camera = Camera::look_at(Vec3A::new(0.0, 3.0, 2.0), Vec3A::ZERO, Vec3A::Y, 0.6, 8, 8);
        let mut frame = render(&[Surface::Plane(Vec3A::ZERO, Vec3A::Y)], &camera);
        frame.material.pixels.fill([0.0, 0.0, 0.0]);
        let made = shade(&frame, &lighting, &Shadows::default(), &OFF);
        let truth = integral(&environment, |d| Vec3A::splat(d.y.max(0.0)));
        for pixel in &made.image.pixels {
            for c in 0..3 {
                let expected = 0.5 * truth[c].x / PI;
                assert!((pixel[c] - expected).abs() < 0.01 * expected, "{} for {expected}, radius {radius}", pixel[c]);
            }
        }
    }
}

#[test]
fn a_setting_disc_fades_as_its_visible_part() {
    let environment = |height: f32| discs(&[(Vec3A::new(height.cos(), height.sin(), 0.0), 0.15, [100.0; 3])], 0.0);
    let camera = Camera::look_at(Vec3A::new(0.0, 3.0, 2.0), Vec3A::ZERO, Vec3A::Y, 0.6, 4, 4);
    let mut frame = render(&[Surface::Plane(Vec3A::ZERO, Vec3A::Y)], &camera);
    frame.material.pixels.fill([0.0, 0.0, 0.0]);
    let full = 100.0 * 1.5 * PI * 0.15 * 0.15;
    for height in [-0.2, -0.1, 0.0, 0.1, 0.2] {
        let environment = environment(height);
        let made = shade(&frame, &Lighting::new(Light::new(environment.clone()), 1), &Shadows::default(), &OFF);
        let expected = 0.5 * integral(&environment, |d| Vec3A::splat(d.y.max(0.0)))[0].x / PI;
        let found = made.image.pixels[5][0];
        assert!((found - expected).abs() < 0.01 * full / PI, "height {height}: {found} for {expected}");
    }
}

#[test]
fn a_lamp_lights_the_rim_of_a_surface_like_the_rest() {
    // A square that faces the camera and a light from one direction, turned so that its edges cross pixels everywhere.
    let facing = Affine3A::from_quat(Quat::from_rotation_z(0.3) * Quat::from_rotation_x(0.5 * PI));
    let look = common::camera([0.0, 0.0, 4.0], [0.0; 3], 30.0, 48, 48);
    let black = Environment::constant([0.0; 3]);
    let parts = vec![(common::plane(1.3), common::diffuse([0.8; 3]), facing)];
    let mut loaded = common::scene(parts, black.clone(), look);
    loaded.lights.push(PunctualLight {
        name: "sun".into(),
        kind: PunctualKind::Directional { irradiance: [2.0; 3] },
        profile: None,
        transforms: vec![Affine3A::IDENTITY],
    });
    let scene = common::compile(&loaded);
    let (frame, _) = common::render(&scene, 16);
    let lighting = Lighting::new(Light::with_exposure(black, 1.0), LIGHTS);
    let made = shade(&frame, &lighting, &shadow_maps(&scene, &lighting, &frame), &OFF);
    let [direct] = &made.terms.direct[..] else { panic!("{} parts", made.terms.direct.len()) };
    let expected = 0.8 * 2.0 / PI;
    let (mut inner, mut rim) = (0, 0);
    for (i, found) in direct.pixels.iter().enumerate().filter(|(i, _)| frame.alpha.pixels[*i] > 0.0) {
        let hit = frame.depth.pixels[i].is_finite();
        (inner, rim) = if hit { (inner + 1, rim) } else { (inner, rim + 1) };
        assert!((found[0] - expected).abs() < 0.02 * expected, "pixel {i}, centre hit {hit}: {} for {expected}", found[0]);
    }
    assert!(inner > 500 && rim > 20, "{inner} centres hit, {rim} missed");
}

#[test]
fn materials_close_a_white_furnace() {
    let n = Vec3A::Z;
    for roughness in [0.3, 0.6, 1.0] {
        for (metallic, specular) in [(0.0, 0.5), (0.0, 0.0), (1.0, 0.5), (0.5, 1.0)] {
            for n_dot_v in [1.0, 0.7, 0.3_f32] {
                let v = Vec3A::new((1.0 - n_dot_v * n_dot_v).sqrt(), 0.0, n_dot_v);
                let surface = Principled { base_color: Vec3A::ONE, roughness, metallic, specular, ..Principled::default() };
                let material = Material::new(&surface, n_dot_v);
                const STEPS: usize = 192;
                let mut sum = 0.0_f64;
                for i in 0..STEPS * STEPS {
                    // Even in the cosine's square and azimuth: dw cos = pi du dv, and a response holds the cosine.
                    let c = ((i / STEPS) as f32 + 0.5) / STEPS as f32;
                    let cosine = c.sqrt();
                    let (sin, cos) = (2.0 * PI * ((i % STEPS) as f32 + 0.5) / STEPS as f32).sin_cos();
                    let r = (1.0 - c).sqrt();
                    let response = material.respond(n, v, Vec3A::new(r * cos, r * sin, cosine), cosine, 0.0);
                    sum += f64::from((response.diffuse + response.specular).x / cosine);
                }
                let albedo = sum * f64::from(PI) / (STEPS * STEPS) as f64;
                assert!(
                    (albedo - 1.0).abs() < 0.015,
                    "{albedo} at roughness {roughness}, metallic {metallic}, specular {specular}, n.v {n_dot_v}"
                );
            }
        }
    }
}
