//! Glass, panes and blended surfaces against what is known on paper.

mod common;

use common::{camera, compile, diffuse, plane, scene, sphere};
use glam::{Affine3A, Quat, Vec3, Vec3A};
use renderflow_frame::{Environment, Frame, Image};
use renderflow_renderer::light::Sampling;
use renderflow_renderer::{DirectLight, RenderScene, Settings, render_gbuffer};
use renderflow_scenes::{LoadedScene, Material, Principled};

/// Specular of a dielectric with index of refraction `ior`.
fn specular(ior: f32) -> f32 {
    ((ior - 1.0) / (ior + 1.0)).powi(2) / 0.08
}

fn reflectance(ior: f64) -> f64 {
    ((ior - 1.0) / (ior + 1.0)).powi(2)
}

fn glass(ior: f32, roughness: f32) -> Material {
    Material::from(Principled {
        base_color: Vec3A::ONE,
        roughness,
        specular: specular(ior),
        transmission: 1.0,
        ..Principled::default()
    })
}

fn pane(ior: f32) -> Material {
    Material { thin_walled: true, ..glass(ior, 0.0) }
}

/// Radiance 1 from everywhere, but not flat, so that light samples are drawn.
fn white() -> Environment {
    let map = Image::from_fn(32, 16, |x, y| [if (x + y) % 2 == 0 { 1.00005 } else { 0.99995 }; 3]);
    Environment { map, rotation: 0.0, intensity: 1.0 }
}

/// Radiance 1 from below the horizon alone.
fn below() -> Environment {
    Environment { map: Image::from_fn(64, 32, |_, y| [if y < 16 { 0.0 } else { 1.0 }; 3]), rotation: 0.0, intensity: 1.0 }
}

fn render_with(scene: &RenderScene, settings: &Settings) -> Frame {
    common::render_with(scene, settings).0
}

fn mean(frame: &Frame) -> [f64; 3] {
    let pixels = &frame.beauty.as_ref().expect("a picture").pixels;
    [0, 1, 2].map(|c| pixels.iter().map(|p| f64::from(p[c])).sum::<f64>() / pixels.len() as f64)
}

fn settings(spp: u32) -> Settings {
    Settings { spp, max_bounces: 64, ..Settings::default() }
}

/// A camera that looks straight down at the origin through a narrow angle.
fn from_above() -> renderflow_frame::Camera {
    camera([0.0, 5.0, 0.0], [0.0; 3], 1.0, 8, 8)
}

fn level(size: f32, height: f32) -> (renderflow_scenes::Mesh, Affine3A) {
    (plane(size), Affine3A::from_translation(Vec3::Y * height))
}

fn turned(size: f32, height: f32) -> (renderflow_scenes::Mesh, Affine3A) {
    (plane(size), Affine3A::from_rotation_translation(Quat::from_rotation_x(std::f32::consts::PI), Vec3::Y * height))
}

/// Two parallel faces of a body.
fn slab(material: &Material, thickness: f32, environment: Environment) -> LoadedScene {
    let (top, bottom) = (level(100.0, 0.5 * thickness), turned(100.0, -0.5 * thickness));
    scene(vec![(top.0, material.clone(), top.1), (bottom.0, material.clone(), bottom.1)], environment, from_above())
}

#[test]
fn white_glass_under_a_white_sky_vanishes() {
    for (ior, roughness) in [(1.5, 0.0), (1.5, 0.3), (1.5, 0.6), (1.5, 1.0), (1.33, 0.5), (1.78, 0.7)] {
        let ball = vec![(sphere(48, true), glass(ior, roughness), Affine3A::IDENTITY)];
        let look = camera([0.0, 0.0, 4.0], [0.0; 3], 20.0, 12, 12);
        let frame = render_with(&compile(&scene(ball, white(), look)), &settings(256));
        let [r, ..] = mean(&frame);
        println!("ior {ior} roughness {roughness}: {r:.5}");
        assert!((r - 1.0).abs() < if roughness < 1.0 { 0.003 } else { 0.01 }, "ior {ior} roughness {roughness}: {r}");
    }
}

/// Of two smooth interfaces with all reflections between them, (1 - R) / (1 + R) passes; with absorption a over the thickness
/// it is (1 - R)^2 a / (1 - R^2 a^2).
#[test]
fn a_slab_passes_what_fresnel_and_beer_say() {
    for ior in [1.33_f32, 1.5, 1.7] {
        let r = reflectance(f64::from(ior));
        for absorption in [[0.0; 3], [0.0, 0.7, 2.0]] {
            let material = Material { absorption, ..glass(ior, 0.0) };
            let frame = render_with(&compile(&slab(&material, 0.5, below())), &settings(4096));
            for (got, sigma) in mean(&frame).into_iter().zip(absorption) {
                let a = (-0.5 * f64::from(sigma)).exp();
                let expected = (1.0 - r).powi(2) * a / (1.0 - r * r * a * a);
                assert!((got / expected - 1.0).abs() < 0.004, "ior {ior}, absorption {sigma}: {got} for {expected}");
            }
        }
    }
}

#[test]
fn panes_and_rough_sheets_pass_what_a_slab_does() {
    for ior in [1.33_f32, 1.5, 1.7] {
        let r = reflectance(f64::from(ior));
        let expected = (1.0 - r) / (1.0 + r);
        for (material, tolerance) in [(pane(ior), 0.003), (Material { thin_walled: true, ..glass(ior, 0.1) }, 0.003)] {
            let sheet = level(100.0, 0.0);
            let scene = scene(vec![(sheet.0, material, sheet.1)], below(), from_above());
            let [got, ..] = mean(&render_with(&compile(&scene), &settings(4096)));
            assert!((got / expected - 1.0).abs() < tolerance, "ior {ior}: {got} for {expected}");
        }
    }
}

/// Panes of index 1.01 mirror 2.5e-5 of the light each: behind 64 of them nearly all of it is left, however it is found.
#[test]
fn light_passes_any_number_of_panes() {
    for count in [1, 40, 64] {
        let parts = (0..count).map(|i| {
            let sheet = level(100.0, 0.01 * i as f32);
            (sheet.0, pane(1.01), sheet.1)
        });
        let scene = scene(parts.collect(), below(), from_above());
        let [got, ..] = mean(&render_with(&compile(&scene), &settings(64)));
        assert!((got - 1.0).abs() < 0.01, "{count} panes: {got}");
    }
}

/// A white diffuse floor below a pane, under a white sky. The pane stands so far away that the light reflected between both is
/// lost: the floor sees the sky through it, and the camera the floor.
#[test]
fn light_goes_straight_through_panes_in_every_way_it_is_found() {
    let sun = Vec3A::new(0.3, 0.9, 0.2).normalize();
    let sky = || {
        let blank = Environment { map: Image::filled(256, 128, [0.0; 3]), rotation: 0.0, intensity: 1.0 };
        let map =
            Image::from_fn(256, 128, |x, y| if blank.texel_direction(x, y).dot(sun) > 0.999 { [500.0; 3] } else { [0.05; 3] });
        blank.with_map(map)
    };
    let shade = |panes: usize, direct: DirectLight| {
        let floor = level(4.0, 0.0);
        let mut parts = vec![(floor.0, diffuse([0.5; 3]), floor.1)];
        for i in 0..panes {
            let sheet = level(40.0, 1.0 + 0.5 * i as f32);
            parts.push((
                sheet.0,
                Material { surface: Principled { base_color: Vec3A::new(1.0, 0.8, 0.5), ..pane(1.5).surface }, ..pane(1.5) },
                sheet.1,
            ));
        }
        let look = camera([0.0, 0.4, 0.9], [0.0, 0.0, 0.0], 20.0, 8, 8);
        let settings = Settings { spp: 4096, max_bounces: 1, direct, ..Settings::default() };
        let mut scene = compile(&scene(parts, sky(), look));
        scene.set_environment_sampling(Sampling::Plain).unwrap();
        mean(&render_with(&scene, &settings))
    };
    let bare = shade(0, DirectLight::Mis);
    let cos = f64::from(sun.y);
    // Fresnel's equations at the angle of the sun.
    let sin_t = (1.0 - cos * cos).sqrt() / 1.5;
    let cos_t = (1.0 - sin_t * sin_t).sqrt();
    let (s, p) = ((cos - 1.5 * cos_t) / (cos + 1.5 * cos_t), (1.5 * cos - cos_t) / (1.5 * cos + cos_t));
    let r = 0.5 * (s * s + p * p);
    let through = (1.0 - r) / (1.0 + r);
    for panes in [1, 2] {
        let [mis, lights, scattering] = [DirectLight::Mis, DirectLight::Lights, DirectLight::Scattering].map(|d| shade(panes, d));
        println!("{panes} panes: {mis:?} {lights:?} {scattering:?} of {bare:?}");
        for (channel, color) in [1.0_f64, 0.8, 0.5].into_iter().enumerate() {
            let expected = bare[channel] * (through * color).powi(panes as i32);
            // The even part of the sky, a tenth of all light, comes at all angles.
            assert!((lights[channel] / expected - 1.0).abs() < 0.03, "{lights:?} for {expected}");
            assert!((mis[channel] / lights[channel] - 1.0).abs() < 0.01, "{mis:?} and {lights:?}");
            assert!((scattering[channel] / lights[channel] - 1.0).abs() < 0.1, "{scattering:?} and {lights:?}");
        }
    }
}

#[test]
fn blended_surfaces_cover_their_share() {
    let shown = |opacity: f32| {
        let sheet = level(100.0, 0.0);
        let lamp = Material { emissive: [2.0; 3], opacity: Some(opacity), ..diffuse([0.0; 3]) };
        let scene: RenderScene = compile(&scene(vec![(sheet.0, lamp, sheet.1)], below(), from_above()));
        let frame = render_with(&scene, &settings(1024));
        (mean(&frame)[0], frame)
    };
    for opacity in [0.0_f32, 0.3, 0.7, 1.0] {
        let (got, frame) = shown(opacity);
        let expected = f64::from(2.0 * opacity + (1.0 - opacity));
        assert!((got - expected).abs() < 0.01, "{opacity}: {got} for {expected}");
        // The G-buffer holds the first surface that covers at least one half.
        assert!(frame.depth.pixels.iter().all(|d| d.is_finite() == (opacity >= 0.5)), "{opacity}: {:?}", frame.depth.pixels);
        let coverage = frame.alpha.pixels.iter().map(|&a| f64::from(a)).sum::<f64>() / frame.alpha.pixels.len() as f64;
        assert!((coverage - f64::from(opacity)).abs() < 0.01, "{opacity}: {coverage}");
    }
}

/// Guides show what is behind smooth glass, and the G-buffer the glass.
#[test]
fn guides_look_through_clear_glass() {
    let floor = level(100.0, 0.0);
    let ball = |material: Material| (sphere(48, true), material, Affine3A::from_translation(Vec3::Y * 2.0));
    for (material, behind) in [
        (glass(1.5, 0.0), [0.1, 0.6, 0.3]),
        (glass(1.5, 0.6), [1.0; 3]),
        (pane(1.5), [0.1, 0.6, 0.3]),
        (diffuse([0.3; 3]), [0.3; 3]),
    ] {
        let parts = vec![(floor.0.clone(), diffuse([0.1, 0.6, 0.3]), floor.1), ball(material)];
        let look = camera([0.0, 6.0, 0.0], [0.0; 3], 5.0, 8, 8);
        let compiled = compile(&scene(parts, white(), look));
        for frame in [render_gbuffer(&compiled, &Settings::default()).unwrap(), render_with(&compiled, &settings(64))] {
            let guide = frame.guide_albedo.as_ref().expect("guides").pixels[27];
            assert!(guide.iter().zip(behind).all(|(g, b)| (g - b).abs() < 0.01), "{guide:?} for {behind:?}");
            assert_eq!((frame.object_id.pixels[27], frame.alpha.pixels[27]), (2, 1.0));
            assert!((frame.depth.pixels[27] - 3.0).abs() < 0.05, "{}", frame.depth.pixels[27]);
        }
    }
}
