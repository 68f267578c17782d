//! Pictures that are taken while things move.

mod common;

use common::{camera, compile, compile_at, diffuse, plane, render_with, scene, sphere, sunny};
use glam::{Affine3A, Quat, Vec3};
use renderflow_frame::{Camera, Environment, Frame};
use renderflow_renderer::{Budget, RenderScene, Settings, Shutter, Stats, render_with_shutter};
use renderflow_scenes::description::Principled;
use renderflow_scenes::{LoadedScene, Material};
use std::f32::consts::FRAC_PI_2;
use std::sync::atomic::AtomicBool;

const WIDTH: usize = 96;

fn open(loaded: &LoadedScene, frame: usize, shutter: Shutter, settings: &Settings) -> (Frame, Stats) {
    let mut scene = RenderScene::compile_with_shutter(loaded, shutter).expect("the scene is consistent");
    scene.set_frame(frame);
    render_with_shutter(&mut scene, settings, &|_, _| (), &AtomicBool::new(false)).expect("renders")
}

/// A camera that looks along -z, `x` metres beside the middle.
fn beside(x: f32) -> Camera {
    camera([x, 0.0, 0.0], [x, 0.0, -1.0], 10.0, WIDTH, 8)
}

/// A wide black sheet before a white sky, one metre away, whose edge is at x = `edge` at each frame, seen by `cameras`.
fn sheet(edges: &[f32], cameras: Vec<Camera>) -> LoadedScene {
    let at = |x: f32| Affine3A::from_rotation_translation(Quat::from_rotation_x(FRAC_PI_2), Vec3::new(x - 500.0, 0.0, -1.0));
    let black = Material { double_sided: true, ..diffuse([0.0; 3]) };
    let mut loaded = scene(vec![(plane(1000.0), black, Affine3A::IDENTITY)], Environment::constant([1.0; 3]), cameras[0]);
    loaded.cameras = cameras;
    loaded.instances[0].transforms = edges.iter().map(|&x| at(x)).collect();
    loaded
}

/// Share of the sky in each column.
fn profile(frame: &Frame) -> Vec<f32> {
    let raw = frame.raw.as_ref().expect("a picture");
    (0..raw.width).map(|x| (0..raw.height).map(|y| raw.at(x, y)[0]).sum::<f32>() / raw.height as f32).collect()
}

/// Mean, over the time that the shutter is open, of the share of each column that is right of the edge. The edge is at
/// `from + (to - from) t` pixels for `t` in 0..1.
fn ramp(from: f32, to: f32) -> Vec<f32> {
    let steps = 4096;
    let at = |t: usize| from + (to - from) * (t as f32 + 0.5) / steps as f32;
    let column = |x: usize| (0..steps).map(|t| (x as f32 + 1.0 - at(t)).clamp(0.0, 1.0)).sum::<f32>() / steps as f32;
    (0..WIDTH).map(column).collect()
}

fn assert_near(got: &[f32], expected: &[f32], bound: f32) {
    for (x, (got, expected)) in got.iter().zip(expected).enumerate() {
        assert!((got - expected).abs() < bound, "column {x}: {got} for {expected}");
    }
}

/// An edge that crosses the picture evenly leaves a ramp as wide as its way, whether it moves itself or the camera does, within
/// the sequence and at both of its ends.
#[test]
fn an_edge_becomes_a_ramp_as_wide_as_its_way() {
    let pixel = 1.0 / beside(0.0).fl_x;
    let settings = Settings { spp: 256, ..Settings::default() };
    let middle = 0.5 * WIDTH as f32;
    // Pixels from frame to frame.
    let speed = 24.0;
    for share in [0.5, 1.0] {
        let shutter = Shutter { open: share, moments: 64 };
        for frame in 0..3 {
            let at = |f: usize| (f as f32 - frame as f32) * speed * pixel;
            let reach = 0.5 * share * speed;
            let expected = ramp(middle - reach, middle + reach);
            let moving = sheet(&[at(0), at(1), at(2)], vec![beside(0.0); 3]);
            assert_near(&profile(&open(&moving, frame, shutter, &settings).0), &expected, 0.02);
            // To the camera the edge moves the other way.
            let cameras = [at(0), at(1), at(2)].map(|x| beside(-x)).to_vec();
            let panned = sheet(&[0.0], cameras);
            assert_near(&profile(&open(&panned, frame, shutter, &settings).0), &expected, 0.02);
        }
    }
}

/// A blade about the middle of the picture turns by an angle; what it covers of a ring is an arc as long as its way.
#[test]
fn what_turns_is_blurred_along_an_arc() {
    let look = camera([0.0, 0.0, 3.0], [0.0; 3], 40.0, 65, 65);
    let mut blade = plane(1.0);
    // A sector of 60 degrees about the x axis, facing the camera.
    blade.positions = vec![Vec3::ZERO, Vec3::new(2.0, -1.1547, 0.0), Vec3::new(2.0, 1.1547, 0.0), Vec3::ZERO];
    blade.triangles = vec![[0, 1, 2]];
    blade.normals.clear();
    let black = Material { double_sided: true, ..diffuse([0.0; 3]) };
    let mut loaded = scene(vec![(blade, black, Affine3A::IDENTITY)], Environment::constant([1.0; 3]), look);
    loaded.cameras = vec![look; 2];
    // From frame to frame it turns by 90 degrees.
    loaded.instances[0].transforms = vec![Affine3A::IDENTITY, Affine3A::from_rotation_z(FRAC_PI_2)];
    let shutter = Shutter { open: 1.0, moments: 64 };
    let frame = open(&loaded, 0, shutter, &Settings { spp: 256, ..Settings::default() }).0;
    let raw = frame.raw.as_ref().expect("a picture");
    let radius = 24.0_f32;
    for degrees in (-180..180).step_by(5) {
        let angle = (degrees as f32).to_radians();
        let (x, y) = (32.5 + radius * angle.cos(), 32.5 - radius * angle.sin());
        // The blade's middle is evenly anywhere in -45..45 degrees, and it reaches 30 degrees to each side.
        let overlap = (45.0_f32.min(degrees as f32 + 30.0) - (-45.0_f32).max(degrees as f32 - 30.0)).max(0.0);
        let (got, expected) = (raw.at(x as usize, y as usize)[0], 1.0 - overlap / 90.0);
        assert!((got - expected).abs() < 0.04, "{degrees} degrees: {got} for {expected}");
    }
}

/// A ball that moves over a floor beside one that rests, seen by a camera that moves.
fn busy(material: Material) -> LoadedScene {
    let look = |x: f32| camera([x, 1.0, 4.0], [0.0, 0.2, 0.0], 40.0, 48, 32);
    let place = |x: f32| Affine3A::from_translation(Vec3::new(x, 0.0, 0.0)) * Affine3A::from_scale(Vec3::splat(0.5));
    let parts = vec![
        (sphere(16, true), material.clone(), place(-1.0)),
        (sphere(16, true), material, place(1.2)),
        (plane(20.0), diffuse([0.5; 3]), Affine3A::from_translation(Vec3::new(0.0, -0.5, 0.0))),
    ];
    let mut loaded = scene(parts, sunny(), look(0.0));
    loaded.cameras = (0..4).map(|f| look(0.1 * f as f32)).collect();
    loaded.instances[0].transforms = (0..4).map(|f| place(-1.0 + 0.3 * f as f32)).collect();
    loaded
}

/// The G-buffer and the motion vectors are those of the frame; the scene stands there afterwards.
#[test]
fn the_gbuffer_stays_sharp() {
    let loaded = busy(diffuse([0.6; 3]));
    let settings = Settings { spp: 16, ..Settings::default() };
    for number in [0, 2, 3] {
        let (blurred, _) = open(&loaded, number, Shutter { open: 0.5, moments: 8 }, &settings);
        let sharp = render_with(&compile_at(&loaded, number), &settings).0;
        assert_ne!(blurred.raw, sharp.raw);
        assert_ne!(blurred.alpha, sharp.alpha);
        assert_eq!(blurred.info.shutter, "open 0.5 moments 8");
        let of = |frame: Frame| (frame.depth, frame.albedo, frame.normal, frame.material, frame.motion, frame.motion_prev);
        assert!(of(blurred.clone()) == of(sharp.clone()), "frame {number}");
        assert_eq!((blurred.object_id, blurred.info.camera), (sharp.object_id, sharp.info.camera));
    }
    let mut scene = RenderScene::compile_with_shutter(&loaded, Shutter { open: 0.5, moments: 8 }).unwrap();
    for number in [3, 0, 100] {
        scene.set_frame(number);
        let render =
            |scene: &mut RenderScene| render_with_shutter(scene, &settings, &|_, _| (), &AtomicBool::new(false)).unwrap().0;
        let first = render(&mut scene);
        assert_eq!(scene.frame(), number);
        // One picture after the other, and the frame itself.
        assert!(render(&mut scene) == first);
        assert!(render_with(&scene, &settings).0 == render_with(&compile_at(&loaded, number), &settings).0, "frame {number}");
    }
}

/// Where nothing moves, a shutter changes nothing but the header.
#[test]
fn what_rests_is_the_same_to_the_bit() {
    let mut loaded = busy(diffuse([0.6; 3]));
    loaded.instances[0].transforms.truncate(1);
    loaded.cameras = vec![loaded.cameras[0]; 4];
    let settings = Settings { spp: 64, light_samples: Some(2), ..Settings::default() };
    let (mut blurred, stats) = open(&loaded, 1, Shutter { open: 1.0, moments: 8 }, &settings);
    let (sharp, same) = render_with(&compile_at(&loaded, 1), &settings);
    assert_eq!(std::mem::take(&mut blurred.info.shutter), "open 1 moments 8");
    assert!(blurred == sharp);
    assert_eq!(stats.samples, same.samples);
}

/// A material that changes is taken as it is at each moment: under an even sky a floor that brightens evenly is as bright as in
/// the middle of the time, and one that stops changing while the shutter is open is as bright as on average.
#[test]
fn materials_change_while_the_shutter_is_open() {
    let mut floor = diffuse([0.2; 3]);
    floor.change = Some(Principled { base_color: [0.8; 3].into(), ..floor.surface });
    let from_above = camera([0.0, 2.0, 0.01], [0.0; 3], 40.0, 16, 16);
    let mut loaded = scene(vec![(plane(50.0), floor, Affine3A::IDENTITY)], Environment::constant([1.0; 3]), from_above);
    loaded.cameras = vec![loaded.cameras[0]; 3];
    let settings = Settings { spp: 256, ..Settings::default() };
    let brightness = |loaded: &LoadedScene, frame: usize| {
        let raw = open(loaded, frame, Shutter { open: 1.0, moments: 32 }, &settings).0.raw.expect("a picture");
        raw.pixels.iter().map(|p| p[0]).sum::<f32>() / raw.pixels.len() as f32
    };
    // Frames are at .2, .5 and .8; the last is held for the second half of its time.
    for (frame, color) in [(1, 0.5), (2, 0.7625)] {
        let mut even = loaded.clone();
        even.materials = vec![diffuse([color; 3])];
        let (got, expected) = (brightness(&loaded, frame), brightness(&even, frame));
        assert!((got / expected - 1.0).abs() < 0.01, "frame {frame}: {got} for {expected}");
    }
}

/// Light paths and changing materials go with the moments: with and without light paths the picture has the same mean.
#[test]
fn caustics_move_with_what_casts_them() {
    let metal = Material {
        surface: Principled { metallic: 1.0, roughness: 0.1, ..Principled::default() },
        change: Some(Principled { metallic: 1.0, roughness: 0.3, ..Principled::default() }),
        ..Material::default()
    };
    let loaded = busy(metal);
    let shutter = Shutter { open: 1.0, moments: 16 };
    let settings = Settings { spp: 1024, ..Settings::default() };
    let (both, stats) = open(&loaded, 1, shutter, &settings);
    assert!(stats.light_paths > 0 && both.info.light_paths);
    let (camera_only, _) = open(&loaded, 1, shutter, &Settings { light_paths: false, ..settings });
    let mean = |frame: &Frame| {
        let raw = frame.raw.as_ref().expect("a picture");
        raw.pixels.iter().map(|p| f64::from(p[0])).sum::<f64>() / raw.pixels.len() as f64
    };
    let (a, b) = (mean(&both), mean(&camera_only));
    assert!((a / b - 1.0).abs() < 0.01, "{a} {b}");
}

#[test]
fn wrong_shutters_are_refused() {
    let loaded = busy(diffuse([0.6; 3]));
    for (share, moments, place) in [
        (0.0, 8, "shutter/open"),
        (1.5, 8, "shutter/open"),
        (f32::NAN, 8, "shutter/open"),
        (0.5, 0, "shutter.moments"),
        (0.5, 257, "shutter.moments"),
    ] {
        let error =
            RenderScene::compile_with_shutter(&loaded, Shutter { open: share, moments }).err().expect("refused").to_string();
        assert!(error.contains(place), "{error}");
    }
    let mut scene = RenderScene::compile_with_shutter(&loaded, Shutter { open: 0.5, moments: 16 }).unwrap();
    let refused = |scene: &mut RenderScene, settings: &Settings| {
        render_with_shutter(scene, settings, &|_, _| (), &AtomicBool::new(false)).unwrap_err().to_string()
    };
    let few = refused(&mut scene, &Settings { spp: 8, ..Settings::default() });
    assert!(few.contains("moments"), "{few}");
    let spread = refused(&mut scene, &Settings { budget: Budget::Average, ..Settings::default() });
    assert!(spread.contains("budget"), "{spread}");
    let none = refused(&mut compile(&loaded), &Settings::default());
    assert!(none.contains("shutter"), "{none}");
}

/// More moments than camera rays bring nothing, and some tens are enough.
#[test]
fn moments_follow_the_samples() {
    let moments = |spp: u32| Shutter::new(0.5, Settings { spp, ..Settings::default() }.camera_samples()).moments;
    assert_eq!([1, 4, 16, 256, 4096].map(moments), [1, 4, 8, 32, 32]);
}
