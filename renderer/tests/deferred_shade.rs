//! Deferred pictures of analytic scenes: reflections, bounced light, parts, keyframes, and input that says little.

#[path = "../frame/tests/light_scene/mod.rs"]
mod light_scene;

use glam::{Vec2, Vec3A};
use light_scene::{Surface, point, render, trace};
use renderflow_frame::image::{Image, Rgb};
use renderflow_frame::{Camera, Environment, Frame, Light};
use renderflow_renderer::deferred::{Deferred, Lighting, Options, ShadowMap, ShadowMode, Shadows, axes, picture, shade};

const SIZE: usize = 96;
const OFF: Options = Options::NONE;

/// A bright disc about `direction` before a dim sky.
fn sunny(direction: Vec3A, sky: f32) -> Environment {
    let plain = Environment { map: Rgb::filled(256, 128, [0.0; 3]), rotation: 0.0, intensity: 1.0 };
    let map =
        Rgb::from_fn(256, 128, |x, y| [if plain.texel_direction(x, y).angle_between(direction) < 0.08 { 200.0 } else { sky }; 3]);
    Environment { map, ..plain }
}

/// A block on the ground; every material its own.
fn block_on_ground() -> (Vec<Surface>, Camera, Frame) {
    let scene = vec![
        Surface::Plane(Vec3A::ZERO, Vec3A::Y),
        Surface::Block(Vec3A::new(-0.7, 0.0, -0.5), Vec3A::new(0.7, 1.0, 0.3)),
        Surface::Sphere(Vec3A::new(1.2, 0.4, 0.3), 0.4),
    ];
    let camera = Camera::look_at(Vec3A::new(0.3, 1.3, 4.0), Vec3A::new(0.0, 0.3, 0.0), Vec3A::Y, 0.7, SIZE, SIZE);
    let frame = render(&scene, &camera);
    (scene, camera, frame)
}

/// A map of every light and every cell of the sky, from rays through `scene`.
fn shadows(scene: &[Surface], lighting: &Lighting) -> Shadows {
    let map = |light: Vec3A, size: usize| {
        let [right, down, away] = axes(light);
        let at = |i: usize| 8.0 * ((i as f32 + 0.5) / size as f32 - 0.5);
        let depth = Image::from_fn(size, size, |x, y| {
            trace(scene, right * at(x) + down * at(y) - away * 20.0, away).map_or(f32::INFINITY, |hit| hit.0 - 20.0)
        });
        ShadowMap::new(light, [-4.0; 2], 8.0, depth)
    };
    Shadows {
        lights: lighting.lights.iter().map(|light| vec![map(light.direction, 256)]).collect(),
        sky: lighting.sky.iter().map(|cell| map(cell.direction, 64)).collect(),
        lamps: Vec::new(),
    }
}

fn pictures(made: &Deferred) -> Vec<&Rgb> {
    let terms = &made.terms;
    let mut all = vec![&made.image, &terms.ambient_diffuse, &terms.ambient_specular];
    all.extend(&terms.direct);
    all.extend(terms.reflections.iter().chain(&terms.indirect).chain(&made.bent_normal));
    all
}

fn assert_finite(made: &Deferred) {
    assert!(pictures(made).iter().all(|p| p.pixels.iter().flatten().all(|v| v.is_finite())));
    let planes = made.terms.visibility.iter().chain(&made.terms.occlusion).chain(&made.terms.sky);
    assert!(planes.flat_map(|p| &p.pixels).all(|v| (0.0..=1.0).contains(v)));
}

#[test]
fn a_mirror_shows_what_stands_on_it() {
    let (scene, camera, mut frame) = block_on_ground();
    for i in 0..SIZE * SIZE {
        match frame.object_id.pixels[i] {
            1 => (frame.albedo.pixels[i], frame.material.pixels[i]) = ([1.0; 3], [0.0, 1.0, 0.0]),
            // A constant colour, the same from everywhere.
            2 | 3 => (frame.albedo.pixels[i], frame.material.pixels[i]) = ([0.6, 0.2, 0.1], [0.0, 0.0, 0.0]),
            _ => {}
        }
    }
    let lighting = Lighting::new(Light::new(Environment::constant([1.0; 3])), 4);
    let made = shade(&frame, &lighting, &Shadows::default(), &Options { reflections: true, ..OFF });
    let (mut right, mut wrong, mut open) = (0, 0, 0);
    let world_to_camera = camera.world_to_camera();
    for i in (0..SIZE * SIZE).filter(|i| frame.object_id.pixels[*i] == 1) {
        let p = point(&frame, &camera, i);
        let d = (p - camera.position()).normalize();
        let mirrored = Vec3A::new(d.x, -d.y, d.z);
        let found = made.image.pixels[i];
        let close = |c: [f32; 3]| (0..3).all(|k| (found[k] - c[k]).abs() < 0.06);
        match trace(&scene, p, mirrored) {
            Some((t, n, _)) => {
                // Only what the camera sees too can be known: its own sight of the point, and not the picture's border.
                let q = p + mirrored * t;
                let eye = (q - camera.position()).normalize();
                let first = trace(&scene, camera.position(), eye).map_or(0.0, |hit| hit.0);
                let at = world_to_camera.transform_point3a(q);
                let x = (camera.cx - camera.fl_x * at.x / at.z) / SIZE as f32;
                let inside = (0.1..0.9).contains(&x) && (first - (q - camera.position()).length()).abs() < 1e-3;
                if inside && n.dot(eye) < -0.2 {
                    if close([0.6, 0.2, 0.1]) { right += 1 } else { wrong += 1 }
                }
            }
            None if close([1.0; 3]) => open += 1,
            None => wrong += 1,
        }
    }
    assert!(right > 150 && open > 1000, "{right} pixels mirror the block, {open} the sky");
    assert!(wrong * 20 < right + open, "{wrong} wrong, {right} and {open} right");
}

#[test]
fn a_lit_floor_lights_the_wall_beside_it() {
    // Perpendicular planes; the light shines straight down and misses the wall.
    let scene = [Surface::Plane(Vec3A::ZERO, Vec3A::Y), Surface::Plane(Vec3A::ZERO, Vec3A::X)];
    let camera = Camera::look_at(Vec3A::new(3.0, 1.5, 0.0), Vec3A::new(0.0, 0.6, 0.0), Vec3A::Y, 1.0, SIZE, SIZE);
    let mut frame = render(&scene, &camera);
    frame.material.pixels.fill([0.0; 3]);
    let lighting = Lighting::new(Light::new(sunny(Vec3A::Y, 0.0)), 1);
    let made = shade(&frame, &lighting, &Shadows::default(), &Options { indirect: true, ..OFF });
    let Some(indirect) = &made.terms.indirect else { panic!("no indirect light") };
    let floor = 0.5 * lighting.lights[0].irradiance[0] / std::f32::consts::PI;
    let mut checked = 0;
    for i in 0..SIZE * SIZE {
        let p = point(&frame, &camera, i);
        if frame.object_id.pixels[i] == 2 && p.y > 0.15 && p.y < 0.4 && p.z.abs() < 0.5 {
            // Of an infinite strip of floor, as wide as the search reaches.
            let reach = 0.7 * frame.depth.pixels[i];
            let factor = 0.5 * (1.0 - p.y / (p.y * p.y + reach * reach).sqrt());
            let found = indirect.pixels[i][0] / (0.5 * floor);
            assert!(found > 0.6 * factor && found < 1.15 * factor.max(0.4), "{found} for {factor} at {p}");
            checked += 1;
        }
        if frame.object_id.pixels[i] == 1 {
            assert!(indirect.pixels[i][0] < 0.05 * floor, "the unlit wall lights the floor");
        }
    }
    assert!(checked > 50, "{checked}");
}

#[test]
fn shadow_maps_darken_what_rays_say_is_dark() {
    let (scene, camera, frame) = block_on_ground();
    let sun = Vec3A::new(-0.6, 0.7, 0.3).normalize();
    let lighting = Lighting::new(Light::new(sunny(sun, 0.3)), 4);
    assert_eq!(lighting.lights.len(), 1);
    let made = shade(&frame, &lighting, &shadows(&scene, &lighting), &Options { shadows: ShadowMode::Map, ..OFF });
    let (mut same, mut all) = (0, 0);
    for i in (0..SIZE * SIZE).filter(|i| frame.depth.pixels[*i].is_finite()) {
        let p = point(&frame, &camera, i);
        let n = camera.camera_to_world.matrix3 * Vec3A::from_array(frame.normal.pixels[i]);
        if p.x.abs() < 2.5 && p.z.abs() < 2.5 {
            let lit =
                n.dot(lighting.lights[0].direction) > 0.0 && trace(&scene, p + n * 1e-3, lighting.lights[0].direction).is_none();
            all += 1;
            same += i32::from((made.terms.visibility[0].pixels[i] > 0.5) == lit);
        }
    }
    assert!(f64::from(same) > 0.985 * f64::from(all), "{same} of {all} pixels");
}

#[test]
fn what_is_off_is_absent() {
    let (scene, _, frame) = block_on_ground();
    let lighting = Lighting::new(Light::new(sunny(Vec3A::new(-0.6, 0.7, 0.3).normalize(), 0.3)), 4);
    let shadows = shadows(&scene, &lighting);
    let off = shade(&frame, &lighting, &shadows, &OFF);
    assert!(
        off.terms.visibility.is_empty() && off.terms.occlusion.is_none() && off.bent_normal.is_none() && off.terms.sky.is_none()
    );
    assert!(off.terms.reflections.is_none() && off.terms.indirect.is_none());
    let all = shade(&frame, &lighting, &shadows, &Options::default());
    assert!(
        all.terms.visibility.len() == 1 && all.terms.occlusion.is_some() && all.bent_normal.is_some() && all.terms.sky.is_some()
    );
    assert_finite(&all);
    // The parts add up to the picture.
    for made in [&off, &all] {
        let parts = &pictures(made)[1..];
        let parts: Vec<_> =
            parts.iter().filter(|p| made.bent_normal.as_ref().is_none_or(|bent| !std::ptr::eq(**p, bent))).collect();
        for i in (0..SIZE * SIZE).filter(|i| frame.alpha.pixels[*i] == 1.0) {
            let sum: f32 = parts.iter().map(|p| p.pixels[i][1]).sum();
            assert!((sum - made.image.pixels[i][1]).abs() < 1e-4 * (1.0 + sum), "{sum} {}", made.image.pixels[i][1]);
        }
    }
    // Each feature alone changes the picture.
    let alone = [
        Options { shadows: ShadowMode::Map, ..OFF },
        Options { shadows: ShadowMode::ScreenSpace, ..OFF },
        Options { sky: true, ..OFF },
        Options { occlusion: true, ..OFF },
        Options { reflections: true, ..OFF },
        Options { indirect: true, ..OFF },
    ];
    for options in alone {
        let made = shade(&frame, &lighting, &shadows, &options);
        assert_ne!(made.image, off.image, "{options:?}");
        // The picture alone is the same picture.
        assert_eq!(picture(&frame, &lighting, &shadows, &options), made.image, "{options:?}");
    }
}

#[test]
fn threads_do_not_matter() {
    let (scene, _, frame) = block_on_ground();
    let lighting = Lighting::new(Light::new(sunny(Vec3A::new(-0.6, 0.7, 0.3).normalize(), 0.3)), 4);
    let shadows = shadows(&scene, &lighting);
    let made = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| shade(&frame, &lighting, &shadows, &Options::default()))
    };
    let (one, three) = (made(1), made(3));
    assert_eq!(one.image, three.image);
    assert_eq!(one.terms.direct, three.terms.direct);
    assert_eq!(one.terms.visibility, three.terms.visibility);
}

#[test]
fn any_input_gives_numbers() {
    let (scene, camera, good) = block_on_ground();
    let environments = [
        Environment::constant([0.0; 3]),
        Environment::constant([1.0; 3]),
        sunny(Vec3A::Y, 0.0),
        Environment { map: Rgb::from_fn(8, 4, |x, _| [if x == 3 { 1e7 } else { 0.0 }; 3]), rotation: 1.0, intensity: 10.0 },
    ];
    let mut zero_normals = good.clone();
    zero_normals.normal.pixels.fill([0.0; 3]);
    let mut nothing = good.clone();
    nothing.alpha.pixels.fill(0.0);
    nothing.depth.pixels.fill(f32::INFINITY);
    let mut thin = nothing.clone();
    thin.alpha.pixels.fill(0.5);
    let mut smooth = good.clone();
    smooth.material.pixels.fill([0.0, 1.0, 0.0]);
    smooth.albedo.pixels.fill([1.0; 3]);
    let mut black = good.clone();
    black.albedo.pixels.fill([0.0; 3]);
    black.material.pixels.fill([1.0, 1.0, 1.0]);
    for environment in &environments {
        let lighting = Lighting::new(Light::new(environment.clone()), 4);
        let shadows = shadows(&scene, &lighting);
        for frame in [&good, &zero_normals, &nothing, &thin, &smooth, &black] {
            assert_finite(&shade(frame, &lighting, &shadows, &Options::default()));
        }
        // Fewer maps than lights and cells.
        assert_finite(&shade(
            &good,
            &lighting,
            &Shadows { sky: shadows.sky[..shadows.sky.len() / 2].to_vec(), ..Shadows::default() },
            &Options::default(),
        ));
        let background = shade(&nothing, &lighting, &shadows, &Options::default()).image;
        let seen = environment.radiance(camera.ray_direction(Vec2::new(3.5, 5.5)));
        assert_eq!(*background.at(3, 5), seen);
        for size in [1, 2] {
            let camera = camera.resized(size, size);
            assert_finite(&shade(&render(&scene, &camera), &lighting, &shadows, &Options::default()));
        }
    }
}
