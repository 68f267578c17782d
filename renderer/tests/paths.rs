//! The compiled sets of features agree, and all ways to find light find all of it.

mod common;

use common::{camera, compile, diffuse, plane, render_with, scene, sphere, sunny};
use glam::{Affine3A, Vec3};
use renderflow_frame::{Environment, Frame};
use renderflow_renderer::light::Selection;
use renderflow_renderer::{DirectLight, RenderScene, Sampler, Settings, Sharing};
use renderflow_scenes::loaded::{Encoding, Texture, Wrap};
use renderflow_scenes::{LoadedScene, Material, Mesh, Principled, TextureSlot};

const WAYS: [DirectLight; 3] = [DirectLight::Mis, DirectLight::Scattering, DirectLight::Lights];

fn beauty(frame: &Frame) -> &[[f32; 3]] {
    frame.beauty.as_ref().map_or(&[], |i| &i.pixels)
}

fn mean(frame: &Frame) -> f64 {
    beauty(frame).iter().flatten().map(|&v| f64::from(v)).sum::<f64>() / (3 * beauty(frame).len()) as f64
}

fn at(x: f32, y: f32, z: f32, size: f32) -> Affine3A {
    Affine3A::from_scale_rotation_translation(Vec3::splat(size), glam::Quat::IDENTITY, Vec3::new(x, y, z))
}

/// Plain materials of every kind.
fn room(environment: Environment) -> LoadedScene {
    let parts = vec![
        (plane(8.0), diffuse([0.7, 0.5, 0.3]), Affine3A::IDENTITY),
        (
            sphere(12, true),
            Material::from(Principled { roughness: 0.3, metallic: 1.0, ..Principled::default() }),
            at(-0.8, 0.7, 0.0, 0.7),
        ),
        (sphere(6, false), Material::from(Principled { roughness: 0.6, ..Principled::default() }), at(0.9, 0.6, 0.0, 0.6)),
        (
            sphere(8, true),
            Material::from(Principled { roughness: 0.05, metallic: 0.5, specular: 1.0, ..Principled::default() }),
            at(0.1, 0.3, 0.9, 0.3),
        ),
    ];
    scene(parts, environment, camera([0.3, 1.6, 3.6], [0.0, 0.5, 0.0], 45.0, 24, 18))
}

/// Largest difference of two pictures, relative to the larger value or a hundredth.
fn difference(a: &Frame, b: &Frame) -> f32 {
    let values = beauty(a).as_flattened().iter().zip(beauty(b).as_flattened());
    values.map(|(a, b)| (a - b).abs() / a.max(*b).max(0.01)).fold(0.0, f32::max)
}

#[test]
fn plain_scenes_use_the_smallest_set_and_larger_ones_agree() {
    for (sky, environment) in [("flat", Environment::constant([0.5, 0.7, 1.0])), ("sunny", sunny())] {
        let plain = room(environment);
        let compiled = compile(&plain);
        let features = compiled.features();
        assert!(!features.full() && !features.textures && !features.normal_maps && !features.dark());
        assert_eq!(features.flat_environment, sky == "flat");
        // A triangle far behind the camera that needs something more, seen by next to nothing.
        let speck = |material: Material, uv_texture: bool| {
            let mut larger = plain.clone();
            larger.meshes.push(Mesh {
                positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y],
                uvs: vec![glam::Vec2::ZERO; 3],
                triangles: vec![[0, 1, 2]],
                ..Mesh::default()
            });
            larger.materials.push(material);
            let place = at(0.0, 500.0, 500.0, 1e-3);
            larger.instances.push(common::instance(4, 4, place));
            if uv_texture {
                larger.textures.push(Texture::from_rgba8("white", [1, 1], vec![[255; 4]], Encoding::Srgb, [Wrap::Repeat; 2]));
            }
            compile(&larger)
        };
        let slot = || Some(TextureSlot::default());
        let textured = Material { base_color_texture: slot(), ..Material::default() };
        let layered = Material::from(Principled { clearcoat: 1.0, ..Principled::default() });
        let single = Material { double_sided: false, ..Material::default() };
        let both = Material { base_color_texture: slot(), ..single.clone() };
        for sampler in [Sampler::Sobol, Sampler::Independent] {
            let settings = Settings { spp: 16, sampler, ..Settings::default() };
            let (expected, _) = render_with(&compiled, &settings);
            for (name, scene, full) in [
                ("textures", speck(textured.clone(), true), false),
                ("layers", speck(layered.clone(), false), true),
                ("sides", speck(single.clone(), false), true),
                ("textures and sides", speck(both.clone(), true), true),
            ] {
                assert_eq!(scene.features().full(), full, "{name}");
                assert_eq!(scene.features().textures, name.contains("textures"));
                let (frame, _) = render_with(&scene, &settings);
                let worst = difference(&frame, &expected);
                let bits = beauty(&frame) == beauty(&expected);
                println!("{sky} sky, {sampler:?}, compiled for {name} as well: largest difference {worst:.1e}, same bits {bits}");
                assert!(worst < 1e-5, "{name}");
            }
        }
    }
}

/// A lamp so faint beside another that it is never drawn as a light is found by scattering, whatever the way to find light.
#[test]
fn lamps_too_faint_to_be_drawn_are_not_lost() {
    let lamp = |radiance: f32| Material { emissive: [radiance; 3], ..diffuse([0.0; 3]) };
    let parts = vec![
        (plane(10.0), diffuse([0.5; 3]), Affine3A::IDENTITY),
        (sphere(12, false), lamp(1.0), at(0.0, 2.0, 0.0, 1.0)),
        // Bright, but walled in.
        (sphere(4, false), lamp(1e9), at(100.0, 100.0, 0.0, 1.0)),
        (sphere(8, false), diffuse([0.0; 3]), at(100.0, 100.0, 0.0, 3.0)),
    ];
    let mut compiled =
        compile(&scene(parts, Environment::constant([0.0; 3]), camera([0.5, 0.4, 3.0], [0.5, 0.0, 0.5], 10.0, 12, 12)));
    let way =
        |compiled: &RenderScene, direct| mean(&render_with(compiled, &Settings { spp: 256, direct, ..Settings::default() }).0);
    // The tree draws it so seldom that light samples alone seldom find it.
    let by_tree = way(&compiled, DirectLight::Mis);
    compiled.set_light_selection(Selection::Power);
    let light = WAYS.map(|direct| way(&compiled, direct));
    println!("floor below the faint lamp, by the tree {by_tree:.5}, three ways: {light:.5?}");
    assert!((by_tree / light[1] - 1.0).abs() < 0.01);
    assert!(light[0] > 0.05 && light.iter().all(|v| (v / light[1] - 1.0).abs() < 0.01));
}

/// Lamps placed more than once, shared or flattened, and moved between frames, give the light of lamps modelled where they are.
#[test]
fn placed_lamps_shine_where_they_are() {
    let lamp = Material { emissive: [5.0, 3.0, 1.0], ..diffuse([0.2; 3]) };
    let floor = || (plane(10.0), diffuse([0.5; 3]), Affine3A::IDENTITY);
    // The floor below them alone.
    let look = camera([0.0, 0.4, 1.2], [0.0, 0.0, 0.3], 20.0, 16, 12);
    let places = [at(-1.0, 0.8, 0.0, 0.2), at(0.8, 0.6, -0.3, 0.3), at(0.2, 1.5, 0.4, 0.1)];
    // One is brighter, so that its triangles are drawn more often than the others for their size.
    let bright = || Material { emissive: [90.0, 30.0, 60.0], ..lamp.clone() };
    let apart = {
        let kinds = [lamp.clone(), bright(), lamp.clone()];
        let lamps = places.iter().zip(kinds).map(|(place, lamp)| (sphere(5, false), lamp, *place));
        scene(std::iter::once(floor()).chain(lamps).collect(), Environment::constant([0.0; 3]), look)
    };
    let together = {
        let mut loaded = scene(vec![floor(), (sphere(5, false), lamp.clone(), places[0])], Environment::constant([0.0; 3]), look);
        loaded.materials.push(bright());
        loaded.instances.extend([common::instance(1, 2, places[1]), common::instance(1, 1, places[2])]);
        loaded
    };
    let moving = {
        let mut loaded = together.clone();
        for instance in &mut loaded.instances[1..] {
            let end = instance.transforms[0];
            instance.transforms.insert(0, at(0.0, 50.0, 0.0, 1.0) * end);
        }
        loaded.cameras.push(look);
        loaded
    };
    let compiled = |loaded: &LoadedScene, sharing| {
        let mut scene = RenderScene::compile_with(loaded, sharing).expect("consistent");
        scene.set_frame(loaded.cameras.len() - 1);
        scene
    };
    let render = |loaded, sharing, direct| {
        mean(&render_with(&compiled(loaded, sharing), &Settings { spp: 256, direct, ..Settings::default() }).0)
    };
    let expected = render(&apart, Sharing::Never, DirectLight::Lights);
    for direct in WAYS {
        for (name, loaded) in [("apart", &apart), ("together", &together), ("moving", &moving)] {
            for sharing in [Sharing::Never, Sharing::Always] {
                let found = render(loaded, sharing, direct);
                println!("{name}, {sharing:?}, {direct:?}: {found:.4}, off by {:+.4}", found / expected - 1.0);
                // Scattering alone is off by 0.7 %.
                assert!((found / expected - 1.0).abs() < 0.015);
            }
        }
    }
}
