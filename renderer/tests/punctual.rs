//! Lights of scene files, rendered: irradiance against closed forms, shadows, groups, motion, and the tree of lights against
//! drawing by power. (What one light without an area sends is checked by `renderflow_renderer::verify::analytic`.)

mod common;

use common::{camera, compile, diffuse, plane, render_with};
use glam::{Affine3A, DVec3, Mat3A, Vec3};
use renderflow_frame::{Environment, Frame, Light};
use renderflow_renderer::deferred::{LAMPS, LIGHTS, Lighting, Options, picture, shade, shadow_maps};
use renderflow_renderer::light::Selection;
use renderflow_renderer::{Channels, DirectLight, RenderScene, Settings};
use renderflow_scenes::loaded::{PunctualKind, PunctualLight};
use renderflow_scenes::shapes::{self, Shape};
use renderflow_scenes::{LoadedScene, Material, Scene, load};
use serde_json::{Value, json};
use std::f64::consts::PI;

/// A white floor under `lights` and a black sky, and a small part of it around the origin seen at a slant.
fn floor(lights: Value, objects: Value) -> LoadedScene {
    floor_seen(lights, objects, 1.0)
}

/// [`floor`] within a vertical angle of view, degrees.
fn floor_seen(lights: Value, objects: Value, angle: f32) -> LoadedScene {
    let mut all =
        vec![json!({ "name": "floor", "geometry": { "shape": { "family": "plane", "size": 8.0 } }, "material": "white" })];
    all.extend(objects.as_array().cloned().unwrap_or_default());
    let scene: Scene = serde_json::from_value(json!({
        "version": 1, "name": "floor", "resolution": [16, 16], "frames": 4,
        "camera": { "type": "poses", "poses": [{ "eye": [1.4, 1.5, 1.5], "target": [0, 0, 0] }], "vertical_fov": angle },
        "environment": { "source": { "constant": [0, 0, 0] } },
        "materials": [{ "name": "white", "base_color": [1, 1, 1], "roughness": 0.0, "specular": 0.0 }],
        "objects": all, "lights": lights,
    }))
    .expect("a scene");
    load::load(&scene, &renderflow_frame::reach::Reach::folder("")).expect("the scene loads")
}

fn settings(spp: u32) -> Settings {
    Settings { spp, channels: Channels { variance: true, ..Channels::BEAUTY }, max_bounces: 1, ..Settings::default() }
}

/// Mean of a channel over the picture, and its standard error.
fn mean(frame: &Frame, channel: usize) -> (f64, f64) {
    let (raw, variance) = (frame.raw.as_ref().unwrap(), frame.variance.as_ref().unwrap());
    let count = raw.pixels.len() as f64;
    let sum = |image: &renderflow_frame::image::Rgb| image.pixels.iter().map(|p| f64::from(p[channel])).sum::<f64>();
    (sum(raw) / count, sum(variance).sqrt() / count)
}

/// Radiance of the white floor times pi.
fn irradiance(scene: &LoadedScene) -> (f64, f64) {
    let (frame, stats) = render_with(&compile(scene), &settings(256));
    assert_eq!(stats.non_finite_samples, 0);
    let (mean, error) = mean(&frame, 0);
    (mean * PI, error * PI)
}

#[test]
fn surfaces_that_glow_light_the_floor_as_on_paper() {
    let lamp = |kind: Value| {
        let transform = json!({ "translation": [0, 2, 0], "rotation": [-90, 0, 0] });
        json!([{ "name": "lamp", "kind": kind, "transform": transform }])
    };
    // Above the origin at the height 2. A disk of radiance L = power / (pi area) makes pi L r^2 / (r^2 + h^2), a sphere
    // power / (4 pi h^2), a rectangle L times Howell's B-4.
    let disk = 30.0 / (PI * PI * 0.25) * PI * 0.25 / (0.25 + 4.0);
    let sphere = 30.0 / (4.0 * PI * 4.0);
    let panel = 30.0 / (PI * 1.5) * renderflow_renderer::verify::emitters::irradiance_under(3.0, 0.5, 2.0);
    for (kind, expected) in [
        (json!({ "disk": { "power": 30.0, "radius": 0.5 } }), disk),
        (json!({ "sphere": { "power": 30.0, "radius": 0.4 } }), sphere),
        (json!({ "rectangle": { "power": 30.0, "width": 3.0, "height": 0.5 } }), panel),
    ] {
        let (found, error) = irradiance(&floor(lamp(kind.clone()), json!([])));
        // The disk is a polygon, and the sphere a polyhedron.
        assert!((found - expected).abs() < 4.0 * error + 1e-3 * expected, "{kind}: {found} +- {error}, not {expected}");
    }
}

#[test]
fn a_panel_is_seen_from_its_front_alone_and_has_ids() {
    let panel = |turn: f32| {
        let light = json!([{ "name": "panel", "kind": { "rectangle": { "power": 10.0, "width": 1.0, "height": 1.0 } },
            "transform": { "translation": [0.7, 0.75, 0.75], "rotation": [turn, 0, 0] } }]);
        let (frame, _) = render_with(&compile(&floor(light, json!([]))), &Settings { spp: 16, ..Settings::default() });
        let middle = frame.width * frame.height / 2 + frame.width / 2;
        (frame.object_id.pixels[middle], frame.material_id.pixels[middle], f64::from(frame.raw.unwrap().pixels[middle][1]))
    };
    // It lies between the camera and the floor, facing up: the camera sees it glow.
    let (object, material, radiance) = panel(90.0);
    assert_eq!((object, material), (2, 2));
    assert!((radiance - 10.0 / PI).abs() < 1e-4, "{radiance}");
    // Facing down, it is not there from above, and the floor below it is.
    let (object, _, radiance) = panel(-90.0);
    assert!(object == 1 && radiance > 0.1 && radiance < 2.0, "{object} {radiance}");
}

#[test]
fn points_cast_shadows_and_have_the_group_of_emitters() {
    let lights = json!([
        { "name": "bulb", "kind": { "point": { "intensity": 8.0 } }, "transform": { "translation": [0, 2, 0] } },
        { "name": "sun", "kind": { "directional": { "irradiance": 0.5 } }, "transform": { "rotation": [-90, 0, 0] } },
    ]);
    let near = |found: (f64, f64), expected: f64| {
        assert!((found.0 - expected).abs() < 4.0 * found.1 + 5e-4 * (expected + 0.01), "{found:?}, not {expected}");
    };
    near(irradiance(&floor(lights.clone(), json!([]))), 2.5);
    // A ball between the floor and both; one above the bulb, in the way of the sun; one beyond the bulb's other side.
    let ball = |y: f32| {
        let shape = json!({ "shape": { "family": "sphere", "radius": 0.3 } });
        json!([{ "name": "ball", "geometry": shape, "transform": { "translation": [0, y, 0] } }])
    };
    near(irradiance(&floor(lights.clone(), ball(1.0))), 0.0);
    near(irradiance(&floor(lights.clone(), ball(3.0))), 2.0);
    // All of the light is in the last group.
    let scene = compile(&floor(lights, json!([])));
    let channels = Channels { variance: true, ..Channels::BEAUTY };
    let (frame, _) = render_with(&scene, &Settings { light_groups: 2, channels, ..settings(16) });
    let sum = |k: usize| frame.light[k].iter().flat_map(|l| &l.pixels).flatten().map(|v| f64::from(*v)).sum::<f64>();
    assert!(sum(0) == 0.0 && sum(1) > 10.0, "{} {}", sum(0), sum(1));
}

#[test]
fn light_samples_alone_find_points_and_scattering_never_does() {
    let lights =
        json!([{ "name": "bulb", "kind": { "point": { "intensity": 8.0 } }, "transform": { "translation": [0, 2, 0] } }]);
    let scene = compile(&floor(lights, json!([])));
    let of = |direct| mean(&render_with(&scene, &Settings { direct, ..settings(64) }).0, 0).0 * PI;
    assert!((of(DirectLight::Lights) / of(DirectLight::Mis) - 1.0).abs() < 1e-6);
    assert_eq!(of(DirectLight::Scattering), 0.0);
}

#[test]
fn a_light_that_moves_is_where_it_is_in_each_frame() {
    let lights = json!([{ "name": "bulb", "kind": { "point": { "intensity": 8.0 } }, "transform": { "translation": [0, 1, 0] },
        "motion": { "translation": [0, 1, 0] } }]);
    let mut scene = compile(&floor(lights, json!([])));
    for frame in [2, 0, 3, 1] {
        scene.set_frame(frame);
        let found = mean(&render_with(&scene, &settings(16)).0, 0).0 * PI;
        let expected = 8.0 / (1.0 + frame as f64).powi(2);
        assert!((found / expected - 1.0).abs() < 1e-3, "{frame}: {found}, not {expected}");
    }
}

/// A room with boxes, glowing triangles of all sizes, and points and spots.
fn room() -> LoadedScene {
    let white = || diffuse([0.7; 3]);
    let lamp = |radiance: f32, double_sided| Material { emissive: [radiance; 3], double_sided, ..diffuse([0.0; 3]) };
    let at = |x: f32, y: f32, z: f32| Affine3A::from_translation(Vec3::new(x, y, z));
    let mut parts = vec![(plane(20.0), white(), Affine3A::IDENTITY)];
    for k in 0..24 {
        let (x, z) = ((k % 6) as f32 * 2.0 - 5.0, (k / 6) as f32 * 2.0 - 3.0);
        let size = 0.02 * (1 + k % 5) as f32;
        let ball = shapes::mesh(&Shape::Sphere { radius: size });
        let radiance = if k % 7 == 0 { 40.0 } else { 5.0 } / (size * 10.0);
        parts.push((ball, lamp(radiance, k % 2 == 0), at(x, 0.4 + 0.3 * (k % 3) as f32, z)));
        if k % 3 == 0 {
            let cube = shapes::mesh(&Shape::Box { size: [0.4, 0.9, 0.4], bevel: 0.0 });
            parts.push((cube, white(), at(x + 0.9, 0.45, z)));
        }
    }
    let look = camera([0.0, 4.0, 8.0], [0.0, 0.0, 0.0], 50.0, 32, 24);
    let mut scene = common::scene(parts, Environment::constant([0.0; 3]), look);
    for k in 0..12 {
        let place = at((k % 4) as f32 * 2.5 - 4.0, 1.0, (k / 4) as f32 * 2.0 - 2.0).translation;
        let kind = if k % 2 == 0 {
            PunctualKind::Point { intensity: [0.3; 3] }
        } else {
            PunctualKind::Spot { intensity: [2.0; 3], inner: 0.2, outer: 0.7 }
        };
        // Down.
        let matrix3 = Mat3A::from_rotation_x(-std::f32::consts::FRAC_PI_2);
        let transforms = vec![Affine3A { matrix3, translation: place }];
        scene.lights.push(PunctualLight { name: format!("{k}"), kind, profile: None, transforms });
    }
    scene
}

/// Means of the four quarters of the picture, with their standard errors.
fn quarters(frame: &Frame) -> [(f64, f64); 4] {
    let (raw, variance) = (frame.raw.as_ref().unwrap(), frame.variance.as_ref().unwrap());
    let mut sums = [(0.0, 0.0); 4];
    for (i, (value, variance)) in raw.pixels.iter().zip(&variance.pixels).enumerate() {
        let quarter = 2 * usize::from(i / frame.width >= frame.height / 2) + usize::from(i % frame.width >= frame.width / 2);
        sums[quarter].0 += f64::from(value[1]);
        sums[quarter].1 += f64::from(variance[1]);
    }
    sums.map(|(sum, variance)| (sum, variance.sqrt()))
}

#[test]
fn the_tree_of_lights_and_drawing_by_power_converge_to_the_same_picture() {
    let loaded = room();
    let rendered = |selection, direct, max_bounces| {
        let mut scene = compile(&loaded);
        scene.set_light_selection(selection);
        let (frame, stats) = render_with(&scene, &Settings { direct, max_bounces, ..settings(512) });
        assert_eq!(stats.non_finite_samples, 0);
        // The median: where lamps are seen, their edges are the noise.
        let mut noise: Vec<f32> = frame.variance.as_ref().unwrap().pixels.iter().map(|v| v[1]).collect();
        noise.sort_by(f32::total_cmp);
        (quarters(&frame), noise[noise.len() / 2])
    };
    for bounces in [1, 3] {
        let (power, noise) = rendered(Selection::Power, DirectLight::Mis, bounces);
        for direct in [DirectLight::Mis, DirectLight::Lights] {
            let (tree, less) = rendered(Selection::Tree, direct, bounces);
            for (a, b) in power.into_iter().zip(tree) {
                let error = a.1.hypot(b.1);
                assert!((a.0 - b.0).abs() < 4.0 * error, "{bounces} bounces, {direct:?}: {a:?} and {b:?}");
            }
            assert!(direct == DirectLight::Lights || less < 0.5 * noise, "{bounces} bounces: {less}, {noise} by power");
        }
    }
}

/// Objects and places far from the origin: what the tree keeps in single precision is enough.
#[test]
fn lights_far_out_light_as_near_ones_do() {
    let seen = |shift: DVec3, scale: f32| {
        let mut scene = room();
        let place = |t: Affine3A| Affine3A { matrix3: t.matrix3 * scale, translation: t.translation * scale + shift.as_vec3a() };
        for instance in &mut scene.instances {
            instance.transforms[0] = place(instance.transforms[0]);
        }
        for light in &mut scene.lights {
            light.transforms[0].translation = light.transforms[0].translation * scale + shift.as_vec3a();
            light.kind = match light.kind {
                PunctualKind::Point { intensity } => PunctualKind::Point { intensity: intensity.map(|v| v * scale * scale) },
                PunctualKind::Spot { intensity, inner, outer } => {
                    PunctualKind::Spot { intensity: intensity.map(|v| v * scale * scale), inner, outer }
                }
                other => other,
            };
        }
        let eye = Vec3::new(0.0, 4.0, 8.0) * scale + shift.as_vec3();
        scene.cameras = vec![camera(eye.to_array(), shift.as_vec3().to_array(), 50.0, 32, 24)];
        quarters(&render_with(&compile(&scene), &settings(256)).0)
    };
    let near = seen(DVec3::ZERO, 1.0);
    for (shift, scale) in [(DVec3::ZERO, 1e-3), (DVec3::ZERO, 1e4), (DVec3::new(512.0, 0.0, -256.0), 1.0)] {
        for (a, b) in near.into_iter().zip(seen(shift, scale)) {
            assert!((a.0 - b.0).abs() < 4.0 * a.1.hypot(b.1) + 2e-3 * a.0, "{shift} {scale}: {a:?} and {b:?}");
        }
    }
}

/// Means of 4 x 3 blocks of pictures of a box on a floor, against Mitsuba's (`references/mitsuba_lights.py`).
#[test]
fn mitsuba_lights_the_same_scene() {
    let scene = |light: Value| -> LoadedScene {
        let scene: Scene = serde_json::from_value(json!({
            "version": 1, "name": "box", "resolution": [64, 48],
            "camera": { "type": "poses", "poses": [{ "eye": [0, 3, 5], "target": [0, 0.3, 0] }], "vertical_fov": 40.0 },
            "environment": { "source": { "constant": [0, 0, 0] } },
            "materials": [{ "name": "grey", "base_color": [0.5, 0.5, 0.5], "roughness": 0.0, "specular": 0.0 }],
            "objects": [
                { "name": "floor", "geometry": { "shape": { "family": "plane", "size": 8.0 } }, "material": "grey" },
                { "name": "box", "geometry": { "shape": { "family": "box", "size": [0.8, 1.0, 0.8] } }, "material": "grey",
                  "transform": { "translation": [0, 0.5, 0] } },
            ],
            "lights": [light],
        }))
        .expect("a scene");
        load::load(&scene, &renderflow_frame::reach::Reach::folder("")).expect("the scene loads")
    };
    let lights = [
        ("point", json!({ "name": "a", "kind": { "point": { "intensity": 8.0 } }, "transform": { "translation": [1, 2, 1] } })),
        ("directional", json!({ "name": "a", "kind": { "directional": { "irradiance": 3.0 } }, "target": [-1, -2, -0.5] })),
        (
            "rectangle",
            json!({ "name": "a", "kind": { "rectangle": { "power": 30.0, "width": 2.0, "height": 0.5 } },
                "transform": { "translation": [-1, 2.5, 0], "rotation": [-90, 0, 0] } }),
        ),
        (
            "sphere",
            json!({ "name": "a", "kind": { "sphere": { "power": 30.0, "radius": 0.25 } },
                "transform": { "translation": [1.5, 2.8, 2.5] } }),
        ),
    ];
    let table = include_str!("references/mitsuba_lights.csv");
    for (name, light) in lights {
        let line = table.lines().find_map(|line| line.strip_prefix(name)).expect("a line");
        let theirs: Vec<f64> = line.split(',').skip(1).map(|v| v.parse().unwrap()).collect();
        let (frame, _) = render_with(&compile(&scene(light)), &Settings { max_bounces: 3, ..settings(512) });
        let (raw, variance) = (frame.raw.unwrap(), frame.variance.unwrap());
        let mut differences = vec![];
        for (block, theirs) in theirs.iter().enumerate() {
            let pixels = (0..256).map(|k| (block / 4 * 16 + k / 16) * 64 + block % 4 * 16 + k % 16);
            let (sum, noise) = pixels.fold((0.0, 0.0), |(sum, noise), i| {
                (sum + f64::from(raw.pixels[i][0]), noise + f64::from(variance.pixels[i][0]))
            });
            let (ours, error) = (sum / 256.0, noise.sqrt() / 256.0);
            assert!(
                (ours - theirs).abs() < 4.0 * error + 5e-3 * theirs + 2e-5,
                "{name}, block {block}: {ours} +- {error}, {theirs}"
            );
            differences.push(ours - theirs);
        }
        let mean = theirs.iter().sum::<f64>() / 12.0;
        println!("{name}: mean difference {:.2e} of {mean:.5}", differences.iter().sum::<f64>() / 12.0 / mean);
    }
}

/// Deferred shading and path tracing of one bounce agree about points, spots and light from one direction, in the light and in
/// the shadow of a ball.
#[test]
fn deferred_shading_has_lamps_with_their_shadows() {
    let at = |x: f32, y: f32, z: f32| json!({ "translation": [x, y, z], "rotation": [-90, 0, 0] });
    let bulb = json!({ "name": "bulb", "kind": { "point": { "intensity": 8.0 } }, "transform": at(0.2, 2.0, 0.0) });
    let spot = json!({ "name": "spot", "kind": { "spot": { "intensity": 9.0, "inner_angle": 5.0, "outer_angle": 20.0 } },
        "transform": at(-0.5, 2.0, 0.1), "color": [1.0, 0.5, 0.2] });
    let sun =
        json!({ "name": "sun", "kind": { "directional": { "irradiance": 1.5 } }, "transform": { "rotation": [-60, 30, 0] } });
    let ball = json!([{ "name": "ball", "geometry": { "shape": { "family": "sphere", "radius": 0.25 } },
        "transform": { "translation": [0.0, 0.6, 0.0] } }]);
    let black = Environment::constant([0.0; 3]);
    let lighting = Lighting::new(Light::with_exposure(black, 1.0), LIGHTS);
    for (name, lights) in
        [("bulb", json!([bulb])), ("spot", json!([spot])), ("sun", json!([sun])), ("all", json!([bulb, spot, sun]))]
    {
        let scene = compile(&floor_seen(lights, ball.clone(), 40.0));
        let (frame, _) = render_with(&scene, &Settings { spp: 64, max_bounces: 1, ..Settings::default() });
        let truth = frame.raw.as_ref().expect("a picture");
        let shadows = shadow_maps(&scene, &lighting, &frame);
        let made = picture(&frame, &lighting, &shadows, &Options::NONE);
        let pairs = || made.pixels.iter().zip(&truth.pixels);
        let close = |(a, b): (&[f32; 3], &[f32; 3])| (0..3).all(|c| (a[c] - b[c]).abs() < 0.02 + 0.03 * b[c]);
        let far = pairs().filter(|pair| !close(*pair)).count();
        let sum = |picture: &renderflow_frame::image::Rgb| picture.pixels.iter().flatten().sum::<f32>();
        let (dark, lit) =
            (truth.pixels.iter().filter(|p| p[0] < 0.01).count(), truth.pixels.iter().filter(|p| p[0] > 0.3).count());
        println!(
            "{name}: {far} of {} pixels differ, {:.4} of {:.4}; {dark} dark, {lit} lit",
            made.pixels.len(),
            sum(&made),
            sum(truth)
        );
        // Edges of shadows and of cones differ: a pixel has one ray.
        assert!(far * 5 < made.pixels.len(), "{name}: {far} pixels differ");
        assert!((sum(&made) / sum(truth) - 1.0).abs() < 0.03, "{name}: {} of {}", sum(&made), sum(truth));
        assert!(lit > 20, "{name}: {lit}");
        let terms = shade(&frame, &lighting, &shadows, &Options::NONE).terms;
        assert_eq!(terms.direct.len(), 1);
    }
    // Of many lamps the strongest count.
    let many: Vec<Value> = (0..3 * LAMPS)
        .map(|i| {
            let intensity = if i % 3 == 0 { 4.0 } else { 0.001 };
            json!({ "name": format!("lamp {i}"), "kind": { "point": { "intensity": intensity } }, "transform": at(0.1 * i as f32, 2.0, 0.0) })
        })
        .collect();
    let scene = compile(&floor_seen(Value::Array(many), json!([]), 40.0));
    let (frame, _) = render_with(&scene, &Settings { spp: 16, max_bounces: 1, ..Settings::default() });
    let shadows = shadow_maps(&scene, &lighting, &frame);
    assert_eq!(shadows.lamps.len(), LAMPS);
    let made = picture(&frame, &lighting, &shadows, &Options::NONE);
    let sum = |picture: &renderflow_frame::image::Rgb| picture.pixels.iter().flatten().sum::<f32>();
    let share = sum(&made) / sum(frame.raw.as_ref().expect("a picture"));
    assert!((0.97..1.03).contains(&share), "{share}");
}

#[test]
fn broken_lights_are_refused() {
    let good = PunctualLight {
        name: "bulb".into(),
        kind: PunctualKind::Point { intensity: [1.0; 3] },
        profile: None,
        transforms: vec![Affine3A::IDENTITY],
    };
    let refused = |light: PunctualLight| {
        let scene = LoadedScene { lights: vec![light], ..room() };
        RenderScene::compile(&scene).err().map(|e| e.to_string())
    };
    assert_eq!(refused(good.clone()), None);
    for light in [
        PunctualLight { transforms: vec![], ..good.clone() },
        PunctualLight { transforms: vec![Affine3A::from_translation(Vec3::NAN)], ..good.clone() },
        PunctualLight { kind: PunctualKind::Point { intensity: [-1.0, 0.0, 0.0] }, ..good.clone() },
        PunctualLight { kind: PunctualKind::Directional { irradiance: [f32::INFINITY; 3] }, ..good.clone() },
    ] {
        assert!(refused(light).is_some_and(|reason| reason.contains("lights/0")));
    }
    // A black one is a light, too: it lights nothing.
    let black = PunctualLight { kind: PunctualKind::Point { intensity: [0.0; 3] }, ..good };
    let scene = LoadedScene { lights: vec![black], ..floor(json!([]), json!([])) };
    assert_eq!(irradiance(&scene).0, 0.0);
}
