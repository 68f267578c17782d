//! Warping between cameras against exact reprojection of analytic scenes.

mod light_scene;

use glam::{Affine3A, Quat, Vec2, Vec3, Vec3A};
use light_scene::{Surface, point, render, trace};
use renderflow_frame::image::{Image, Rgb};
use renderflow_frame::tracks::{Movement, Tracks};
use renderflow_frame::warp::{
    Correspondence, FILLED, Keyframe, MAX_RATIO, Neighbour, age, carry, correspond, fetch, fill, held, logarithms, nearest,
    ratio_fetch,
};
use renderflow_frame::{Camera, Distortion, Frame};

const SIZE: usize = 96;

fn camera(eye: Vec3A) -> Camera {
    Camera::look_at(eye, Vec3A::new(0.0, 0.3, 0.0), Vec3A::Y, 0.7, SIZE, SIZE)
}

fn scene() -> Vec<Surface> {
    vec![
        Surface::Plane(Vec3A::ZERO, Vec3A::Y),
        Surface::Sphere(Vec3A::new(-0.5, 0.4, 0.0), 0.4),
        Surface::Block(Vec3A::new(0.2, 0.0, -0.3), Vec3A::new(0.6, 0.7, 0.4)),
    ]
}

/// The camera behind a lens that bends lines strongly; it shows nothing beyond 46 degrees.
fn bent(camera: Camera) -> Camera {
    Camera { distortion: Some(Distortion { k1: -0.3, ..Distortion::default() }), ..camera }
}

/// A smooth picture painted on the world.
fn paint(frame: &Frame, camera: &Camera) -> Rgb {
    Rgb::from_fn(frame.width, frame.height, |x, y| {
        let i = y * frame.width + x;
        if frame.depth.pixels[i].is_finite() { colour(point(frame, camera, i)) } else { [0.0; 3] }
    })
}

fn colour(p: Vec3A) -> [f32; 3] {
    [2.0 + (2.0 * p.x).sin(), 2.0 + (2.0 * p.y + 1.0).cos(), 2.0 + (1.5 * p.z).sin()]
}

fn share(correspondence: &Correspondence, frame: &Frame) -> f32 {
    let hit = frame.depth.pixels.iter().filter(|d| d.is_finite()).count();
    correspondence.valid.pixels.iter().sum::<f32>() / hit as f32
}

#[test]
fn a_still_camera_sees_itself_exactly() {
    let view = camera(Vec3A::new(0.5, 1.2, 3.0));
    let frame = render(&scene(), &view);
    let c = correspond(&frame, &frame, None);
    for (i, valid) in c.valid.pixels.iter().enumerate() {
        assert_eq!(*valid > 0.0, frame.depth.pixels[i].is_finite(), "pixel {i}");
    }
    let noise = Rgb::from_fn(SIZE, SIZE, |x, y| [((x * 7 + y * 13) % 11) as f32, 1.0, 0.0]);
    let start = Rgb::from_fn(SIZE, SIZE, |x, y| [((x * 5 + y * 3) % 7) as f32 + 1.0, 0.5, 2.0]);
    let (fetched, (ratio, trust)) = (fetch(&noise, &c), ratio_fetch(&noise, &start, &start, &c, 1.0));
    for i in 0..SIZE * SIZE {
        if c.valid.pixels[i] > 0.0 {
            assert_eq!(fetched.pixels[i], noise.pixels[i]);
            let (red, truth) = (ratio.pixels[i][0], noise.pixels[i][0]);
            let clamped = truth * MAX_RATIO < start.pixels[i][0];
            assert!(clamped || (red - truth).abs() < 1e-5 * (1.0 + truth), "{red} {truth}");
        } else {
            assert_eq!(fetched.pixels[i], [0.0; 3]);
        }
        assert_eq!(trust.pixels[i], if c.valid.pixels[i] > 0.0 { 1.0 } else { FILLED });
    }
}

#[test]
fn a_plane_reprojects_exactly() {
    let plane = [Surface::Plane(Vec3A::ZERO, Vec3A::Y)];
    let (now, then) = (camera(Vec3A::new(0.3, 1.5, 2.5)), camera(Vec3A::new(-0.3, 1.4, 2.6)));
    let (current, key) = (render(&plane, &now), render(&plane, &then));
    let c = correspond(&current, &key, None);
    let picture = fetch(&paint(&key, &then), &c);
    let mut inside = 0;
    for i in 0..SIZE * SIZE {
        if !current.depth.pixels[i].is_finite() {
            assert_eq!(c.valid.pixels[i], 0.0);
            continue;
        }
        let p = point(&current, &now, i);
        let (expected, _) = then.project(p).expect("in front");
        let margin = expected.min_element().min((Vec2::splat(SIZE as f32) - expected).min_element());
        if margin < 0.0 {
            assert_eq!(c.valid.pixels[i], 0.0, "outside the keyframe");
        } else if margin > 1.0 {
            inside += 1;
            assert!(c.valid.pixels[i] > 0.0, "point {p} at {expected}");
            assert!((Vec2::from_array(c.source.pixels[i]) - expected).length() < 1e-3);
            // Far away a pixel covers more of the plane than the paint's period; bilinear colours hold near by.
            let truth = colour(p);
            let near = current.depth.pixels[i] < 4.5;
            assert!(!near || (0..3).all(|k| (picture.pixels[i][k] - truth[k]).abs() < 0.02), "{:?} {truth:?}", picture.pixels[i]);
        }
    }
    assert!(inside > 5000, "{inside}");
}

#[test]
fn what_the_keyframe_did_not_see_is_invalid() {
    let scene = scene();
    let (now, then) = (camera(Vec3A::new(0.9, 1.0, 2.8)), camera(Vec3A::new(-0.9, 1.0, 2.8)));
    let (current, key) = (render(&scene, &now), render(&scene, &then));
    let c = correspond(&current, &key, None);
    let picture = fetch(&paint(&key, &then), &c);
    let (mut hidden, mut beside, mut visible, mut kept) = (0, 0, 0, 0);
    for i in 0..SIZE * SIZE {
        if !current.depth.pixels[i].is_finite() {
            continue;
        }
        let p = point(&current, &now, i);
        let d = (p - then.position()).normalize();
        let (t, _, id) = trace(&scene, then.position(), d).expect("something is there");
        let seen = id == current.object_id.pixels[i] && (t - p.distance(then.position())).abs() < 1e-3;
        let inside = then.project(p).is_some_and(|(q, _)| q.min_element() > 1.0 && q.max_element() < SIZE as f32 - 1.0);
        if !seen {
            hidden += 1;
            // Beside a hidden point there may be pixels that show its surface, but never all around it.
            assert!(c.valid.pixels[i] < 1.0, "hidden point {p} passed as seen");
            beside += usize::from(c.valid.pixels[i] > 0.0);
        } else if inside {
            visible += 1;
            kept += usize::from(c.valid.pixels[i] > 0.0);
        }
        if c.valid.pixels[i] > 0.0 && current.depth.pixels[i] < 4.5 {
            let truth = colour(p);
            // Taps on one side alone are up to a pixel away.
            let near = if c.valid.pixels[i] < 1.0 { 0.3 } else { 0.08 };
            assert!((0..3).all(|k| (picture.pixels[i][k] - truth[k]).abs() < near), "{:?} {truth:?}", picture.pixels[i]);
        }
    }
    println!("{hidden} hidden, {beside} of them beside the surface, {kept} of {visible} visible points kept");
    assert!(hidden > 300 && beside * 10 < hidden, "{beside} of {hidden} beside the surface");
    assert!(kept as f32 > 0.97 * visible as f32, "{kept} of {visible} kept");
}

#[test]
fn depth_and_normal_tests_stand_on_their_own() {
    // All surfaces made one object: only depth and normals can tell them apart.
    let scene = scene();
    let (now, then) = (camera(Vec3A::new(0.9, 1.0, 2.8)), camera(Vec3A::new(-0.9, 1.0, 2.8)));
    let one_object = |view: &Camera| {
        let mut frame = render(&scene, view);
        frame.object_id.pixels.fill(1);
        frame
    };
    let (current, key) = (one_object(&now), one_object(&then));
    let c = correspond(&current, &key, None);
    let (mut hidden, mut passed) = (0, 0);
    for i in (0..SIZE * SIZE).filter(|i| current.depth.pixels[*i].is_finite()) {
        let p = point(&current, &now, i);
        let (t, _, _) = trace(&scene, then.position(), (p - then.position()).normalize()).expect("something is there");
        // Nearer than the tolerance of one per cent the depth buffer cannot tell.
        if (t / p.distance(then.position()) - 1.0).abs() > 0.03 {
            hidden += 1;
            passed += usize::from(c.valid.pixels[i] > 0.5);
        }
    }
    println!("{passed} of {hidden} hidden points pass");
    assert!(hidden > 300 && passed * 100 < hidden, "{passed} of {hidden} hidden points pass");

    // The same frame with its normals turned by an angle below and above the threshold of 30 degrees.
    for (angle, expected) in [(0.4_f32, true), (0.65, false)] {
        let mut turned = current.clone();
        for n in &mut turned.normal.pixels {
            let normal = Vec3A::from_array(*n);
            *n = normal.try_normalize().map_or(*n, |n| (n * angle.cos() + n.any_orthonormal_vector() * angle.sin()).to_array());
        }
        let c = correspond(&current, &turned, None);
        let hit = (0..SIZE * SIZE).filter(|i| current.depth.pixels[*i].is_finite());
        assert!(hit.into_iter().all(|i| (c.valid.pixels[i] > 0.0) == expected), "normals turned by {angle}");
    }
}

#[test]
fn moving_objects_are_followed() {
    let motion = Affine3A::from_rotation_translation(Quat::from_rotation_y(0.4), Vec3::new(0.25, 0.0, 0.1));
    let centre = Vec3A::new(-0.4, 0.4, 0.2);
    // The sphere stood at `centre` moved by `motion` when the keyframe was taken.
    let with_sphere = |c: Vec3A| vec![Surface::Plane(Vec3A::ZERO, Vec3A::Y), Surface::Sphere(c, 0.4)];
    let view = camera(Vec3A::new(0.2, 1.0, 3.0));
    let current = render(&with_sphere(centre), &view);
    let key = render(&with_sphere(motion.transform_point3a(centre)), &view);
    let follow = |id: u32| (id == 2).then_some(motion);
    let c = correspond(&current, &key, Some(&follow));
    let mut on_sphere = 0;
    for i in 0..SIZE * SIZE {
        if current.object_id.pixels[i] == 2 && c.valid.pixels[i] > 0.0 {
            on_sphere += 1;
            let (expected, _) = view.project(motion.transform_point3a(point(&current, &view, i))).expect("in front");
            assert!((Vec2::from_array(c.source.pixels[i]) - expected).length() < 1e-3);
        }
    }
    let all = current.object_id.pixels.iter().filter(|id| **id == 2).count();
    assert!(on_sphere as f32 > 0.75 * all as f32, "{on_sphere} of {all}");
    // Without the motion only the overlap of the two places could pass, and normals and depth rule it out.
    let still = correspond(&current, &key, None);
    let wrong = (0..SIZE * SIZE).filter(|i| current.object_id.pixels[*i] == 2 && still.valid.pixels[*i] > 0.0).count();
    assert!(wrong * 20 < all, "{wrong} of {all} pass without motion");
}

#[test]
fn samples_come_from_the_pixel_that_holds_the_point() {
    let scene = scene();
    let (now, then) = (camera(Vec3A::new(0.3, 1.1, 2.9)), camera(Vec3A::new(0.1, 1.15, 2.9)));
    let (current, other) = (render(&scene, &now), render(&scene, &then));
    let carried = nearest(&current, &other, None);
    let (mut hit, mut kept) = (0, 0);
    for i in 0..SIZE * SIZE {
        let expected = current.depth.pixels[i].is_finite().then(|| point(&current, &now, i)).and_then(|p| then.project(p));
        let Some((expected, _)) = expected else {
            assert_eq!(carried.pixels[i], None, "nothing is there to be carried");
            continue;
        };
        hit += 1;
        let Some(there) = carried.pixels[i].map(|there| there as usize) else { continue };
        kept += 1;
        let centre = Vec2::new((there % SIZE) as f32 + 0.5, (there / SIZE) as f32 + 0.5);
        assert!((centre - expected).abs().max_element() < 0.501, "{expected} falls into the pixel around {centre}");
        assert_eq!(other.object_id.pixels[there], current.object_id.pixels[i]);
    }
    println!("{kept} of {hit} carried");
    assert!(kept as f32 > 0.9 * hit as f32, "{kept} of {hit} carried");
    // A camera that stands still has every sample where it was.
    let still = nearest(&current, &current, None);
    for i in 0..SIZE * SIZE {
        assert_eq!(still.pixels[i], current.depth.pixels[i].is_finite().then_some(i as u32));
    }
}

#[test]
fn a_lens_is_looked_through() {
    let view = bent(camera(Vec3A::new(0.5, 1.2, 3.0)));
    let frame = render(&scene(), &view);
    let (c, carried) = (correspond(&frame, &frame, None), nearest(&frame, &frame, None));
    for i in 0..SIZE * SIZE {
        let hit = frame.depth.pixels[i].is_finite();
        assert_eq!(carried.pixels[i], hit.then_some(i as u32));
        assert_eq!(c.valid.pixels[i] > 0.0, hit, "pixel {i}");
        let centre = Vec2::new((i % SIZE) as f32 + 0.5, (i / SIZE) as f32 + 0.5);
        assert!(!hit || (Vec2::from_array(c.source.pixels[i]) - centre).length() < 1e-3);
    }
    // From a lens to none, and back.
    let (plain, moved) = (camera(Vec3A::new(0.3, 1.1, 2.9)), camera(Vec3A::new(0.1, 1.15, 2.9)));
    for (now, then) in [(bent(plain), moved), (plain, bent(moved)), (bent(plain), bent(moved))] {
        let (current, key) = (render(&scene(), &now), render(&scene(), &then));
        let c = correspond(&current, &key, None);
        let shown = c.valid.pixels.iter().filter(|valid| **valid > 0.0).count();
        assert!(shown * 10 > 6 * SIZE * SIZE, "{shown} pixels");
        for i in (0..SIZE * SIZE).filter(|i| c.valid.pixels[*i] > 0.0) {
            let (expected, _) = then.project(point(&current, &now, i)).expect("in front");
            assert!((Vec2::from_array(c.source.pixels[i]) - expected).length() < 1e-3);
        }
    }
}

#[test]
fn what_a_lens_folds_into_the_picture_is_not_there() {
    let plane = [Surface::Plane(Vec3A::ZERO, Vec3A::Y)];
    let eye = Vec3A::new(0.0, 1.5, 2.5);
    let towards = |angle: f32| {
        let target = eye + Quat::from_rotation_y(angle) * Vec3A::new(0.0, -1.2, -2.5);
        bent(Camera::look_at(eye, target, Vec3A::Y, 0.7, SIZE, SIZE))
    };
    let (now, then) = (towards(0.0), towards(1.1));
    let (current, other) = (render(&plane, &now), render(&plane, &then));
    let (c, carried) = (correspond(&current, &other, None), nearest(&current, &other, None));
    let mut folded = 0;
    for i in (0..SIZE * SIZE).filter(|i| current.depth.pixels[*i].is_finite()) {
        let p = point(&current, &now, i);
        let p_cam = then.world_to_camera().transform_point3a(p);
        // Tangent of the angle from the view, of which 1 / sqrt(0.9) is the last that the lens shows.
        let off = p_cam.truncate().length() / -p_cam.z;
        let inside = then.project(p).is_some_and(|(at, _)| at.min_element() >= 0.0 && at.max_element() <= SIZE as f32);
        if inside && off > 1.06 {
            folded += 1;
            assert_eq!((carried.pixels[i], c.source.pixels[i]), (None, [0.0; 2]), "{off}");
        }
    }
    assert!(folded > 100, "{folded}");
}

#[test]
fn nothing_is_carried_for_an_object_that_moved_nobody_knows_how() {
    let view = camera(Vec3A::new(0.3, 1.1, 2.9));
    let frame = render(&scene(), &view);
    let tracks = Tracks { objects: [(2, vec![]), (3, vec![Affine3A::IDENTITY; 2])].into() };
    let movement = tracks.between(0, 1);
    let motion = |id| movement.of(id);
    let carried = nearest(&frame, &frame, Some(&motion));
    let flat = Rgb::filled(SIZE, SIZE, [0.5; 3]);
    let light = logarithms(&flat, 1.0);
    let share = held(&frame, &frame, Some(&motion), &carried, [&light, &light]);
    let key = Keyframe { frame: frame.clone(), truth: flat.clone(), start: Some(flat) };
    let c = Neighbour { key: &key, distance: 1.0, movement }.correspond(&frame);
    let mut lost = 0;
    for (i, &id) in frame.object_id.pixels.iter().enumerate() {
        let known = frame.depth.pixels[i].is_finite() && id != 2;
        assert_eq!(carried.pixels[i], known.then_some(i as u32), "object {id}");
        assert_eq!((share.pixels[i] > 0.0, c.valid.pixels[i] > 0.0), (known, known), "object {id}");
        lost += usize::from(id == 2);
    }
    assert!(lost > 300, "{lost}");
}

#[test]
fn samples_of_other_surfaces_are_not_taken() {
    let view = camera(Vec3A::new(0.3, 1.1, 2.9));
    let current = render(&scene(), &view);
    let hits = current.depth.pixels.iter().filter(|depth| depth.is_finite()).count();
    let carried = |other: &Frame| nearest(&current, other, None).pixels.iter().flatten().count();
    // A small difference of albedo is the pixel's own detail, a large one another texture's.
    let painted = |change: f32| {
        let mut other = current.clone();
        other.albedo.pixels.iter_mut().for_each(|albedo| albedo[1] += change);
        carried(&other)
    };
    assert_eq!([painted(0.04), painted(-0.04), painted(0.3), painted(-0.3)], [hits, hits, 0, 0]);
    let mut named = current.clone();
    named.object_id.pixels.iter_mut().for_each(|id| *id += u32::from(*id == 2));
    assert_eq!(carried(&named), hits - current.object_id.pixels.iter().filter(|id| **id == 2).count());
    // Frames without pixels, without surfaces.
    let empty = Frame { info: current.info.clone(), ..Frame::default() };
    let sky = render(&[], &view);
    assert_eq!([carried(&empty), carried(&sky)], [0; 2]);
    assert!(nearest(&empty, &current, None).pixels.is_empty());
}

#[test]
fn samples_follow_their_object() {
    let motion = Affine3A::from_rotation_translation(Quat::from_rotation_y(0.4), Vec3::new(0.25, 0.0, 0.1));
    let centre = Vec3A::new(-0.4, 0.4, 0.2);
    let with_sphere = |c: Vec3A| vec![Surface::Plane(Vec3A::ZERO, Vec3A::Y), Surface::Sphere(c, 0.4)];
    let view = camera(Vec3A::new(0.2, 1.0, 3.0));
    let current = render(&with_sphere(centre), &view);
    let other = render(&with_sphere(motion.transform_point3a(centre)), &view);
    let carried = nearest(&current, &other, Some(&|id| (id == 2).then_some(motion)));
    let mut followed = 0;
    for i in (0..SIZE * SIZE).filter(|i| current.object_id.pixels[*i] == 2) {
        let Some(there) = carried.pixels[i].map(|there| there as usize) else { continue };
        followed += 1;
        let (expected, _) = view.project(motion.transform_point3a(point(&current, &view, i))).expect("in front");
        assert_eq!(there, expected.y as usize * SIZE + expected.x as usize);
    }
    let all = current.object_id.pixels.iter().filter(|id| **id == 2).count();
    assert!(followed as f32 > 0.75 * all as f32, "{followed} of {all}");
}

#[test]
fn ratios_keep_texture_sharp() {
    // Truth = texture x light; start = texture. The texture is finer than a warp could carry, the light is smooth.
    let (now, then) = (camera(Vec3A::new(0.3, 1.2, 2.8)), camera(Vec3A::new(-0.1, 1.2, 2.9)));
    let plane = [Surface::Plane(Vec3A::ZERO, Vec3A::Y)];
    let (current, key) = (render(&plane, &now), render(&plane, &then));
    let texture = |frame: &Frame, view: &Camera| {
        Rgb::from_fn(SIZE, SIZE, |x, y| {
            let i = y * SIZE + x;
            let p = if frame.depth.pixels[i].is_finite() { point(frame, view, i) } else { Vec3A::ZERO };
            [if (p.x * 40.0).sin() > 0.0 { 0.9 } else { 0.2 }; 3]
        })
    };
    let lit = |frame: &Frame, view: &Camera, texture: &Rgb| {
        Rgb::from_fn(SIZE, SIZE, |x, y| {
            let i = y * SIZE + x;
            let p = if frame.depth.pixels[i].is_finite() { point(frame, view, i) } else { Vec3A::ZERO };
            texture.pixels[i].map(|t| t * (0.6 + 0.3 * p.x.sin()))
        })
    };
    let (start_now, start_then) = (texture(&current, &now), texture(&key, &then));
    let (truth_now, truth_then) = (lit(&current, &now, &start_now), lit(&key, &then, &start_then));
    let c = correspond(&current, &key, None);
    let (by_ratio, direct) = (ratio_fetch(&truth_then, &start_then, &start_now, &c, 1.0).0, fetch(&truth_then, &c));
    let error = |picture: &Rgb| -> f32 {
        let squares = (0..SIZE * SIZE).filter(|i| c.valid.pixels[*i] >= 1.0);
        squares.map(|i| (picture.pixels[i][0] - truth_now.pixels[i][0]).powi(2)).sum::<f32>().sqrt()
    };
    assert!(share(&c, &current) > 0.8);
    println!("root of the squared error: ratio {}, direct {}", error(&by_ratio), error(&direct));
    assert!(error(&by_ratio) < 0.1 * error(&direct), "{} {}", error(&by_ratio), error(&direct));
}

#[test]
fn holes_take_the_ratio_of_what_is_around() {
    let scene = scene();
    let (now, then) = (camera(Vec3A::new(0.9, 1.0, 2.8)), camera(Vec3A::new(-0.9, 1.0, 2.8)));
    let (current, key) = (render(&scene, &now), render(&scene, &then));
    let c = correspond(&current, &key, None);
    let holes: Vec<usize> = (0..SIZE * SIZE).filter(|i| c.valid.pixels[*i] == 0.0).collect();
    assert!(holes.len() > 300, "{}", holes.len());
    // The truth is brighter than the start by a factor (with the floor of .01 on both sides), redder on the left.
    let start = Rgb::from_fn(SIZE, SIZE, |x, y| [0.2 + 0.1 * ((x * 7 + y * 3) % 5) as f32, 0.5, 0.4]);
    let by = |factors: &dyn Fn(usize) -> [f32; 3]| {
        Rgb::from_fn(SIZE, SIZE, |x, y| {
            let (factors, start) = (factors(x), start.pixels[y * SIZE + x]);
            std::array::from_fn(|k| (start[k] + 0.01) * factors[k] - 0.01)
        })
    };
    let (filled, trust) = ratio_fetch(&by(&|_| [2.0, 1.5, 0.5]), &start, &start, &c, 1.0);
    for &i in &holes {
        assert_eq!(trust.pixels[i], FILLED);
        for (k, factor) in [2.0, 1.5, 0.5].into_iter().enumerate() {
            let expected = (start.pixels[i][k] + 0.01) * factor - 0.01;
            assert!((filled.pixels[i][k] - expected).abs() < 1e-4, "{:?} {expected}", filled.pixels[i]);
        }
    }
    // Factors of 1 to 4: fills stay among them, and one bad pixel of the truth spoils no other.
    let mut truth = by(&|x| [1.0 + 3.0 * x as f32 / SIZE as f32, 1.0, 1.0]);
    truth.pixels[SIZE * SIZE / 2 + 10] = [f32::NAN; 3];
    let (filled, _) = ratio_fetch(&truth, &start, &start, &c, 1.0);
    for i in 0..SIZE * SIZE {
        let factor = (filled.pixels[i][0] + 0.01) / (start.pixels[i][0] + 0.01);
        assert!((0.999..4.001).contains(&factor), "pixel {i}: {factor}");
    }
    // A keyframe that shows nothing of the frame says nothing.
    let elsewhere = render(&scene, &camera(Vec3A::new(0.0, 40.0, 60.0)));
    let mut none = correspond(&current, &Frame { depth: Image::filled(SIZE, SIZE, f32::INFINITY), ..elsewhere }, None);
    none.source.pixels.fill([3.0; 2]);
    let (picture, trust) = ratio_fetch(&truth, &start, &start, &none, 1.0);
    assert!(trust.pixels.iter().all(|trust| *trust == 0.0) && picture == start);
}

#[test]
fn odd_input_is_invalid_not_a_crash() {
    let view = camera(Vec3A::new(0.0, 1.0, 3.0));
    let frame = render(&scene(), &view);
    let empty = Frame { info: frame.info.clone(), ..Frame::default() };
    assert!(correspond(&frame, &empty, None).valid.pixels.iter().all(|v| *v == 0.0));
    assert!(correspond(&empty, &frame, None).valid.pixels.is_empty());
    // A keyframe behind the scene; a degenerate motion.
    let behind = render(&scene(), &camera(Vec3A::new(0.0, 1.0, -3.0)));
    let flat = |_: u32| Some(Affine3A::from_scale(Vec3::ZERO));
    let c = correspond(&frame, &behind, Some(&flat));
    assert!(c.source.pixels.iter().flatten().all(|v| v.is_finite()));
    let zero = Image::filled(SIZE, SIZE, [0.0; 3]);
    let c = correspond(&frame, &frame, None);
    for exposure in [0.0, 1.0, f32::NAN, f32::INFINITY] {
        assert!(ratio_fetch(&zero, &zero, &zero, &c, exposure).0.pixels.iter().flatten().all(|v| *v == 0.0));
    }
}

/// The ground and a ball from three places: the frame's, then those of the keyframes before and after it.
fn three_views() -> [(Frame, Camera); 3] {
    [0.0, -0.25, 0.25].map(|x| {
        let view = camera(Vec3A::new(x, 1.3, 3.5));
        (render(&scene()[..2], &view), view)
    })
}

/// A light at each point as seen from a view: 0 for the frame, 1 and 2 for the keyframes.
type Shine<'a> = &'a dyn Fn(usize, Vec3A) -> f32;

/// Differences from the light of the frame where both keyframes show the surface: of what [`carry`] makes of the keyframe before
/// the frame, of its ratio and of its tint.
fn differences(truth: Shine, start: Shine) -> [Vec<f32>; 3] {
    let views = three_views();
    let lit = |view: usize, light: Shine| {
        let (frame, camera) = &views[view];
        let pixel = |i: usize| if frame.alpha.pixels[i] > 0.0 { light(view, point(frame, camera, i)) } else { 0.0 };
        Rgb::from_fn(SIZE, SIZE, |x, y| [pixel(y * SIZE + x); 3])
    };
    let [before, after] =
        [1, 2].map(|view| Keyframe { frame: views[view].0.clone(), truth: lit(view, truth), start: Some(lit(view, start)) });
    let seen = [(&before, -8.0), (&after, 8.0)].map(|(key, distance)| Neighbour { key, distance, movement: Movement::default() });
    let (frame, wanted, start) = (&views[0].0, lit(0, truth), lit(0, start));
    let carried = carry(frame, Some(&start), seen.each_ref().map(Some), 1.0);
    let [Some(first), Some(second)] = &carried else { panic!("both keyframes are carried") };
    let known: Vec<usize> =
        (0..SIZE * SIZE).filter(|i| first.valid.pixels[*i] >= 1.0 && second.valid.pixels[*i] >= 1.0).collect();
    assert!(known.len() > SIZE * SIZE / 3, "{}", known.len());
    let [alone, none] = carry(frame, Some(&start), [Some(&seen[0]), None], 1.0);
    assert!(none.is_none());
    let pictures = [&first.shaded, &alone.expect("a keyframe").shaded].map(|shaded| shaded.clone().expect("it has starts").0);
    [&pictures[0], &pictures[1], &first.tinted]
        .map(|picture| known.iter().map(|i| picture.pixels[*i][0] - wanted.pixels[*i][0]).collect())
}

/// The roots of the mean squares of [`differences`].
fn errors(truth: Shine, start: Shine) -> [f32; 3] {
    differences(truth, start).map(|all| (all.iter().map(|d| d * d).sum::<f32>() / all.len() as f32).sqrt())
}

#[test]
fn two_keyframes_tell_how_light_changes() {
    let still = |p: Vec3A| 0.6 + 0.3 * (2.0 * p.x).sin();
    let gain = |view: usize, p: Vec3A| 1.0 + [0.3, 0.7, -0.2][view] * (1.5 * p.x + p.z).cos();
    // The light stays, and the starts change for no reason.
    let [made, ratio, tint] = errors(&|_, p| still(p), &|view, p| still(p) * gain(view, p));
    println!("still light: {made}, by the ratio {ratio}, by the tint {tint}");
    assert!(made < 0.1 * ratio && made < 0.01, "{made} {ratio} {tint}");
    // The light changes as the starts do.
    let [made, ratio, tint] = errors(&|view, p| 2.0 * still(p) * gain(view, p), &|view, p| still(p) * gain(view, p));
    println!("light that follows: {made}, by the ratio {ratio}, by the tint {tint}");
    assert!(made < 0.1 * tint && made < 1.5 * ratio, "{made} {ratio} {tint}");
    // Each on one side.
    let right = |p: Vec3A| p.x > 0.0;
    let [made, ratio, tint] =
        errors(&|view, p| still(p) * if right(p) { gain(view, p) } else { 1.0 }, &|view, p| still(p) * gain(view, p));
    println!("each on one side: {made}, by the ratio {ratio}, by the tint {tint}");
    assert!(made < 0.4 * ratio.min(tint), "{made} {ratio} {tint}");
    // A highlight that only the frame itself shows. What the keyframes show of the starts is wrong, but by little: the highlight
    // is believed.
    let shine = |view: usize, p: Vec3A| if view == 0 { 4.0 * (-(p - Vec3A::X).length_squared() / 0.02).exp() } else { 0.0 };
    let nearly = |view: usize, p: Vec3A| still(p) * (0.95 + 0.05 * gain(view, p));
    let [made, _, tint] = errors(&|view, p| still(p) + shine(view, p), &|view, p| nearly(view, p) + shine(view, p));
    println!("a passing highlight: {made}, by the tint {tint}");
    assert!(made < 0.1 * tint, "{made} {tint}");
}

#[test]
fn odd_light_of_a_keyframe_stays_where_it_is() {
    for odd in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, -1e30] {
        // A spot at the back, so that sums over the picture would carry it to the front.
        let light =
            |view: usize, p: Vec3A| if view == 1 && p.z < -1.5 && p.x < -0.5 { odd } else { 0.6 + 0.3 * (2.0 * p.x).sin() };
        let start = |view: usize, p: Vec3A| 1.0 + [0.3, 0.7, -0.2][view] * (1.5 * p.x + p.z).cos();
        let [made, ratio, _] = differences(&light, &start);
        let far = |all: &[f32]| all.iter().filter(|d| d.is_nan() || d.abs() > 0.05).count();
        println!("{odd}: {} pixels, {} by the ratio, of {}", far(&made), far(&ratio), made.len());
        assert!(far(&made) < made.len() / 4 && far(&ratio) > made.len() / 2, "{odd}");
    }
}

#[test]
fn keyframes_are_warped_and_holes_filled() {
    let (eye, aside) = (camera(Vec3A::new(0.3, 1.3, 4.0)), camera(Vec3A::new(0.7, 1.3, 3.9)));
    let (frame, key_frame) = (render(&scene(), &eye), render(&scene(), &aside));
    // A truth that is a function of the place, and start pictures that are wrong by a factor.
    let (truth, wanted) = (paint(&key_frame, &aside), paint(&frame, &eye));
    let halved = |picture: &Rgb| picture.map(|p| p.map(|v| 0.5 * v));
    let (key_start, start) = (halved(&truth), halved(&wanted));
    let key = Keyframe { frame: key_frame, truth, start: Some(key_start) };
    let at = |key, distance| Neighbour { key, distance, movement: Movement::default() };
    let made = fill(&frame, &start, &[at(&key, -4.0)], 1.0);
    let (mut warped, mut filled) = (0, 0);
    for i in (0..SIZE * SIZE).filter(|i| frame.alpha.pixels[*i] > 0.0) {
        let good = (0..3).all(|c| (made.pixels[i][c] - wanted.pixels[i][c]).abs() < 0.05);
        // Holes are filled by a mixture of the start and of what the keyframe says about the pixels around.
        let between = (0..3).all(|c| (start.pixels[i][c]..=wanted.pixels[i][c]).contains(&made.pixels[i][c]));
        assert!(good || between, "{:?} at {i}, wanted {:?}", made.pixels[i], wanted.pixels[i]);
        (warped, filled) = (warped + i32::from(good), filled + i32::from(!good));
    }
    assert!(warped > 3 * filled && filled > 20, "{warped} warped, {filled} filled");
    // Of two keyframes the nearer one counts more; one at no distance counts alone; one of another size or without a start not at
    // all.
    let dark = Keyframe { truth: key.truth.map(|_| [0.0; 3]), ..key.clone() };
    let both = fill(&frame, &start, &[at(&key, -4.0), at(&dark, 16.0)], 1.0);
    assert!(both.pixels.iter().zip(&made.pixels).all(|(b, m)| b[0] <= m[0] + 1e-5 && b[0] > 0.4 * m[0] - 0.3));
    assert_eq!(fill(&frame, &start, &[at(&key, -4.0), at(&key, 0.0)], 1.0), key.truth);
    let small = Keyframe { truth: Rgb::filled(2, 2, [9.0; 3]), ..key.clone() };
    let bare = Keyframe { start: None, ..key.clone() };
    for useless in [&[at(&small, -4.0)][..], &[at(&bare, -4.0)], &[]] {
        assert_eq!(fill(&frame, &start, useless, 1.0), start);
    }
}

#[test]
fn keyframes_age_with_their_distance_to_a_limit() {
    assert_eq!([0.0, 8.0, -16.0, 32.0, -90.0].map(age), [0.0, 0.5, 1.0, 2.0, 2.0]);
}
