//! How far samples of other frames hold, against closed forms.

mod light_scene;

use glam::{Affine3A, Quat, Vec3A};
use light_scene::{Surface, point, render};
use renderflow_frame::image::{Image, Rgb};
use renderflow_frame::warp::{held, logarithms, nearest};
use renderflow_frame::{Camera, Frame};

const SIZE: usize = 96;

fn camera(eye: Vec3A) -> Camera {
    Camera::look_at(eye, Vec3A::new(0.0, 0.3, 0.0), Vec3A::Y, 0.7, SIZE, SIZE)
}

fn scene() -> Vec<Surface> {
    vec![Surface::Plane(Vec3A::ZERO, Vec3A::Y), Surface::Sphere(Vec3A::new(-0.5, 0.4, 0.0), 0.4)]
}

/// The shares of `other` in `current`, whose pictures are `pictures`.
fn shares(current: &Frame, other: &Frame, [own, there]: [&Rgb; 2]) -> (Image<Option<u32>>, Image<f32>) {
    let sources = nearest(current, other, None);
    let share = held(current, other, None, &sources, [&logarithms(own, 2.0), &logarithms(there, 2.0)]);
    (sources, share)
}

fn flat(value: f32) -> Rgb {
    Rgb::filled(SIZE, SIZE, [value; 3])
}

#[test]
fn what_did_not_change_holds() {
    let view = camera(Vec3A::new(0.3, 1.1, 2.9));
    let frame = render(&scene(), &view);
    let (sources, share) = shares(&frame, &frame, [&flat(0.7), &flat(0.7)]);
    for (source, share) in sources.pixels.iter().zip(&share.pixels) {
        assert_eq!(*share, f32::from(u8::from(source.is_some())));
    }
    let empty = Frame { info: frame.info.clone(), ..Frame::default() };
    let none = Rgb::filled(0, 0, [0.0; 3]);
    assert!(held(&empty, &frame, None, &nearest(&empty, &frame, None), [&none, &flat(1.0)]).pixels.is_empty());
}

#[test]
fn other_light_does_not_hold() {
    let frame = render(&[Surface::Plane(Vec3A::ZERO, Vec3A::Y)], &camera(Vec3A::new(0.0, 2.5, 2.0)));
    // From column 48 on, the light of one channel is another.
    let there = Rgb::from_fn(SIZE, SIZE, |x, _| if x < 48 { [0.5; 3] } else { [0.5, 0.6, 0.5] });
    let (sources, share) = shares(&frame, &frame, [&flat(0.5), &there]);
    // log(1 + 8 * 2 * radiance), a third of its square, over .2 squared.
    let change = (1.0 + 16.0_f32 * 0.6).ln() - (1.0 + 16.0_f32 * 0.5).ln();
    let expected = |share: f32| (-(change * share).powi(2) / 3.0 / 0.04).exp();
    assert!(sources.pixels.iter().all(Option::is_some));
    for y in 0..SIZE {
        for (x, known) in [(20, 0.0), (43, 0.0), (44, 1.0 / 9.0), (47, 4.0 / 9.0), (48, 5.0 / 9.0), (52, 1.0), (90, 1.0)] {
            let found = share.pixels[y * SIZE + x];
            assert!((found - expected(known)).abs() < 1e-4, "column {x}: {found}, {}", expected(known));
        }
    }
    // Noise that is equally strong in both, and as often above as below, changes little.
    let noise = |seed: usize| {
        Rgb::from_fn(SIZE, SIZE, |x, y| {
            let hash = (x + 131 * y + 7919 * seed).wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40;
            [if hash.is_multiple_of(2) { 0.3 } else { 0.7 }; 3]
        })
    };
    let (_, share) = shares(&frame, &frame, [&noise(1), &noise(2)]);
    let mean = share.pixels.iter().sum::<f32>() / share.pixels.len() as f32;
    println!("mean share under noise: {mean}");
    assert!(mean > 0.75, "{mean}");
}

#[test]
fn mirrors_turn_with_the_camera() {
    let plane = [Surface::Plane(Vec3A::ZERO, Vec3A::Y)];
    let (now, then) = (camera(Vec3A::new(0.0, 1.5, 2.5)), camera(Vec3A::new(0.1, 1.5, 2.5)));
    let share_of = |material: [f32; 3], albedo: f32, transmittance: Option<f32>| {
        let drawn = |view: &Camera| {
            let mut frame = render(&plane, view);
            frame.material.pixels.fill(material);
            frame.albedo.pixels.fill([albedo; 3]);
            frame.transmittance = transmittance.map(|share| Rgb::filled(SIZE, SIZE, [share; 3]));
            frame
        };
        let (current, other) = (drawn(&now), drawn(&then));
        (shares(&current, &other, [&flat(1.0), &flat(1.0)]), current)
    };
    // Directions to the cameras differ by as much as the mirrored ones.
    let turn = |frame: &Frame, i: usize| {
        let p = point(frame, &now, i);
        let [a, b] = [&now, &then].map(|view| (view.position() - p).normalize());
        (a.dot(Vec3A::Y), (a - b).length_squared())
    };
    let check = |material: [f32; 3], albedo: f32, transmittance: Option<f32>| {
        let ((sources, share), frame) = share_of(material, albedo, transmittance);
        let [roughness, metallic, specular] = material;
        let mut checked = 0;
        for i in (0..SIZE * SIZE).filter(|i| sources.pixels[*i].is_some()) {
            let (cos, turn) = turn(&frame, i);
            let f0 = 0.08 * specular * (1.0 - metallic) + albedo * metallic;
            let fresnel = f0 + (1.0 - f0) * (1.0 - cos).powi(5);
            let mirrored = fresnel / (fresnel + (1.0 - metallic) * albedo);
            let lobe = roughness.max(0.05).powi(2) + 0.003;
            let through = transmittance.unwrap_or(0.0) * (1.0 - (-turn / 0.003_f32.powi(2)).exp());
            let expected = (1.0 - mirrored * (1.0 - (-turn / lobe.powi(2)).exp()) - through).max(0.0);
            assert!((share.pixels[i] - expected).abs() < 2e-3, "{material:?}: {} {expected}", share.pixels[i]);
            checked += 1;
        }
        assert!(checked > 2000, "{checked}");
        share.pixels[SIZE * SIZE / 2 + SIZE / 2]
    };
    let mirror = check([0.02, 1.0, 0.5], 0.9, None);
    let brushed = check([0.3, 1.0, 0.5], 0.9, None);
    let painted = check([0.6, 0.0, 0.5], 0.6, None);
    let gloss = check([0.02, 0.0, 0.5], 0.6, None);
    let glass = check([0.6, 0.0, 0.5], 0.6, Some(0.8));
    println!("mirror {mirror}, brushed metal {brushed}, paint {painted}, glossy paint {gloss}, glass {glass}");
    assert!(mirror < 1e-3 && brushed > 0.5 && painted > 0.98 && glass < 0.25);
    assert!(gloss > 0.7 && gloss < 0.97, "the light below the gloss stays: {gloss}");
}

#[test]
fn a_mirror_that_turns_shows_something_else() {
    // The sphere turns about its own axis: neither its points' normals nor the directions that they mirror stay.
    let scene = |c: Vec3A| vec![Surface::Sphere(c, 0.4)];
    let view = camera(Vec3A::new(0.2, 1.0, 3.0));
    let centre = Vec3A::new(0.0, 0.4, 0.2);
    let drawn = |metallic: f32| {
        let mut frame = render(&scene(centre), &view);
        frame.material.pixels.fill([0.1, metallic, 0.0]);
        frame
    };
    let about = |angle: f32| {
        let turn = Affine3A::from_quat(Quat::from_rotation_y(angle));
        Affine3A::from_translation(centre.into()) * turn * Affine3A::from_translation((-centre).into())
    };
    let mean = |metallic: f32, angle: f32| {
        let (frame, motion) = (drawn(metallic), about(angle));
        let motion = |_: u32| Some(motion);
        let sources = nearest(&frame, &frame, Some(&motion));
        let light = logarithms(&flat(1.0), 1.0);
        let share = held(&frame, &frame, Some(&motion), &sources, [&light, &light]);
        let kept = sources.pixels.iter().flatten().count();
        assert!(kept > 300, "{kept}");
        share.pixels.iter().sum::<f32>() / kept as f32
    };
    let [still, turned, matt] = [mean(1.0, 0.0), mean(1.0, 0.05), mean(0.0, 0.05)];
    println!("metal that stands still {still}, metal that turns {turned}, matt {matt}");
    assert!((still - 1.0).abs() < 1e-5 && turned < 0.2 && matt > 0.9, "{still} {turned} {matt}");
}

#[test]
fn broken_samples_do_not_hold() {
    let view = camera(Vec3A::new(0.3, 1.1, 2.9));
    let frame = render(&scene(), &view);
    let mut broken = flat(0.5);
    for (i, value) in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -1.0, 1e30].into_iter().enumerate() {
        broken.pixels[SIZE * (SIZE - 1) + 8 + 16 * i] = [0.5, value, 0.5];
    }
    for pictures in [[&broken, &flat(0.5)], [&flat(0.5), &broken]] {
        let (sources, share) = shares(&frame, &frame, pictures);
        assert!(share.pixels.iter().all(|share| (0.0..=1.0).contains(share)));
        let at = |i: usize| (sources.pixels[SIZE * (SIZE - 1) + 8 + 16 * i], share.pixels[SIZE * (SIZE - 1) + 8 + 16 * i]);
        assert!((0..5).all(|i| at(i).0.is_some()));
        assert_eq!([at(0).1, at(1).1], [0.0; 2]);
        // Values below 0 count as 0, and huge ones as what they are.
        assert!((2..5).all(|i| at(i).1 < 1.0));
    }
}
