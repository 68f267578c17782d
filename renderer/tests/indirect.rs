//! What samples are made of: indirect light, and the direct light that shadows take.

mod common;

use common::{camera, compile, diffuse, plane, render_with, scene, sphere, sunny};
use glam::{Affine3A, Vec3};
use renderflow_frame::image::Rgb;
use renderflow_frame::{Environment, Frame};
use renderflow_renderer::{Budget, Channels, DirectLight, RenderScene, Settings, develop, expose};
use renderflow_scenes::{Material, Mesh, Principled};
use std::f32::consts::PI;
use std::sync::atomic::AtomicBool;

/// A floor under a sky with a sun, with or without a ball that hovers above it, outside of the picture.
fn floor(ball: bool, environment: Environment) -> RenderScene {
    under(Vec::new(), ball, environment)
}

/// A floor under a square lamp.
fn lamp_lit(ball: bool) -> RenderScene {
    let lamp = Material { emissive: [9.0, 7.0, 5.0], ..Material::default() };
    let place = Affine3A::from_translation(Vec3::new(0.5, 6.0, -0.5)) * Affine3A::from_rotation_x(PI);
    under(vec![(plane(2.0), lamp, place)], ball, Environment::constant([0.0; 3]))
}

fn under(mut parts: Vec<(Mesh, Material, Affine3A)>, ball: bool, environment: Environment) -> RenderScene {
    parts.push((plane(20.0), diffuse([0.6, 0.5, 0.4]), Affine3A::IDENTITY));
    if ball {
        parts.push((sphere(12, true), diffuse([0.8; 3]), Affine3A::from_translation(Vec3::new(0.0, 3.0, 0.0))));
    }
    compile(&scene(parts, environment, camera([0.0, 1.5, 3.0], [0.0, 0.0, 0.0], 45.0, 24, 20)))
}

fn settings(max_bounces: u32, direct: DirectLight) -> Settings {
    let channels = Channels { paths: true, ..Channels::ALL };
    Settings { spp: 16, max_bounces, direct, channels, ..Settings::default() }
}

fn of<'a>(picture: &'a Option<Rgb>, name: &str) -> &'a [[f32; 3]] {
    &picture.as_ref().unwrap_or_else(|| panic!("no {name}")).pixels
}

fn sum(picture: &[[f32; 3]]) -> f64 {
    picture.as_flattened().iter().map(|v| f64::from(*v)).sum()
}

/// With light samples alone, which do not depend on what hides the light, what a ball hides and what is left add up to the light
/// without a ball, in every pixel. Only one that casts a shadow hides anything.
#[test]
fn what_is_hidden_is_what_a_shadow_takes() {
    let settings = settings(1, DirectLight::Lights);
    let both = [true, false];
    for scenes in [both.map(|ball| floor(ball, sunny())), both.map(lamp_lit)] {
        let [shadowed, open] = scenes.map(|scene| render_with(&scene, &settings).0);
        assert_eq!(sum(of(&open.hidden, "hidden")), 0.0);
        let (hidden, all) = (sum(of(&shadowed.hidden, "hidden")), sum(of(&open.raw, "raw")));
        assert!(all > 0.0 && hidden > 0.02 * all, "{hidden} of {all}");
        let (raw, hidden) = (of(&shadowed.raw, "raw"), of(&shadowed.hidden, "hidden"));
        for (i, bare) in of(&open.raw, "raw").iter().enumerate() {
            for c in 0..3 {
                let together = raw[i][c] + hidden[i][c];
                assert!((together - bare[c]).abs() <= 1e-5 * bare[c], "pixel {i}: {together} and {}", bare[c]);
            }
        }
    }
}

/// Paths of one scattering have no indirect light. With more, it is what they add to the same paths.
#[test]
fn indirect_light_is_what_further_bounces_add() {
    let scene = floor(true, sunny());
    let [once, often] = [1, 4].map(|bounces| render_with(&scene, &settings(bounces, DirectLight::Lights)).0);
    assert_eq!(sum(of(&once.indirect, "indirect")), 0.0);
    let (raw, indirect) = (of(&often.raw, "raw"), of(&often.indirect, "indirect"));
    assert!(sum(indirect) > 0.0 && sum(indirect) < sum(raw));
    for (i, direct) in of(&once.raw, "raw").iter().enumerate() {
        for c in 0..3 {
            let rest = raw[i][c] - indirect[i][c];
            assert!((rest - direct[c]).abs() <= 1e-5 * raw[i][c], "pixel {i}: {rest} and {}", direct[c]);
        }
    }
    assert_eq!(of(&once.hidden, "hidden"), of(&often.hidden, "hidden"));
}

/// Asking for them changes no other channel, and an even sky, of which no light samples are drawn, hides nothing.
#[test]
fn indirect_and_hidden_light_cost_no_other_channel() {
    let without = |frame: Frame| Frame { indirect: None, hidden: None, ..frame };
    let budgets = [Budget::Uniform, Budget::Average, Budget::Detail];
    for (environment, budget) in [sunny(), Environment::constant([0.7, 0.8, 0.9])].iter().flat_map(|e| budgets.map(|b| (e, b))) {
        let scene = floor(true, environment.clone());
        for light_groups in [0, 3] {
            let settings = Settings { light_groups, budget, ..settings(4, DirectLight::Mis) };
            let (all, _) = render_with(&scene, &settings);
            let (bare, _) = render_with(&scene, &Settings { channels: Channels::ALL, ..settings });
            assert!(bare.indirect.is_none() && bare.hidden.is_none());
            assert_eq!(sum(of(&all.hidden, "hidden")) == 0.0, environment.is_constant(), "{budget:?}");
            assert!(sum(of(&all.indirect, "indirect")) > 0.0);
            assert!(without(all) == bare, "{budget:?} {light_groups}");
        }
    }
}

/// Light paths bring indirect light alone: a picture has as much direct light with them as without.
#[test]
fn caustics_are_indirect_light() {
    let gold = Material::from(Principled { metallic: 1.0, roughness: 0.05, ..Principled::default() });
    let place = Affine3A::from_translation(Vec3::new(0.3, 1.0, -0.8));
    let scene = under(vec![(sphere(24, true), gold, place)], false, sunny());
    let settings = Settings { spp: 256, ..settings(4, DirectLight::Mis) };
    assert!(scene.has_light_paths(&settings));
    let [with, without] = [true, false].map(|light_paths| render_with(&scene, &Settings { light_paths, ..settings }).0);
    let direct = |frame: &Frame| sum(of(&frame.raw, "raw")) - sum(of(&frame.indirect, "indirect"));
    assert!((direct(&with) / direct(&without) - 1.0).abs() < 0.01, "{} and {}", direct(&with), direct(&without));
}

/// Films in parts have the sums of the whole, and films without them neither merge with others nor show them.
#[test]
fn parts_of_a_film_add_up() {
    let scene = floor(true, sunny());
    let settings = settings(4, DirectLight::Mis);
    let bare = Settings { channels: Channels::ALL, ..settings };
    let part = |settings: &Settings, range| expose(&scene, settings, range, &|_, _| (), &AtomicBool::new(false)).unwrap().0;
    let [mut first, second] = [part(&settings, 0..8), part(&settings, 8..16)];
    let mut other = part(&bare, 0..8);
    assert!(other.merge(&second).unwrap_err().to_string().contains("only one of the films"));
    first.merge(&second).unwrap();
    let (together, _) = develop(&scene, &settings, &first).unwrap();
    let (whole, _) = render_with(&scene, &settings);
    assert!(together.indirect == whole.indirect && together.hidden == whole.hidden);
    other.merge(&part(&bare, 8..16)).unwrap();
    let error = develop(&scene, &settings, &other).unwrap_err().to_string();
    assert!(error.contains("no indirect"), "{error}");
}
