//! Light groups are parts of the beauty, and films of parts of the samples are parts of the whole.

mod common;

use common::{camera, compile, diffuse, plane, render_with, scene, sphere, sunny};
use glam::{Affine3A, Quat, Vec3};
use renderflow_frame::{Environment, Frame, Image};
use renderflow_renderer::{DirectLight, Error, Film, Mode, RenderScene, Sampler, Settings, develop, expose};
use renderflow_scenes::{LoadedScene, Material, Principled};
use std::ops::Range;
use std::sync::atomic::AtomicBool;

/// A floor, something glossy and something bumpy by its flat facets under a sky with a sun, and a lamp where asked for.
fn room(lamp: bool) -> LoadedScene {
    let place = |x: f32, y: f32, size: f32| {
        Affine3A::from_scale_rotation_translation(Vec3::splat(size), Quat::IDENTITY, Vec3::new(x, y, 0.0))
    };
    let mut parts = vec![
        (plane(8.0), diffuse([0.7, 0.5, 0.3]), Affine3A::IDENTITY),
        (
            sphere(12, true),
            Material::from(Principled { roughness: 0.3, metallic: 1.0, ..Principled::default() }),
            place(-0.8, 0.7, 0.7),
        ),
        (sphere(6, false), Material::from(Principled { roughness: 0.4, ..Principled::default() }), place(0.9, 0.6, 0.6)),
    ];
    if lamp {
        parts.push((sphere(4, false), Material { emissive: [4.0, 2.0, 1.0], ..diffuse([0.1; 3]) }, place(0.1, 1.4, 0.15)));
    }
    let mut scene = scene(parts, sunny(), camera([0.3, 1.6, 3.6], [0.0, 0.6, 0.0], 45.0, 20, 15));
    scene.hash = "room".into();
    scene
}

fn pixels(image: &Option<Image<[f32; 3]>>) -> &[[f32; 3]] {
    image.as_ref().map_or(&[], |i| &i.pixels)
}

fn bits(image: &Option<Image<[f32; 3]>>) -> Vec<u32> {
    pixels(image).iter().flatten().map(|v| v.to_bits()).collect()
}

fn mean(image: &Option<Image<[f32; 3]>>) -> f64 {
    let values = pixels(image);
    values.iter().flatten().map(|&v| f64::from(v)).sum::<f64>() / (3 * values.len()) as f64
}

#[test]
fn groups_add_up_to_the_beauty_and_change_nothing() {
    for lamp in [false, true] {
        let scene = compile(&room(lamp));
        for sampler in [Sampler::Sobol, Sampler::Independent] {
            let settings = Settings { spp: 16, sampler, ..Settings::default() };
            let (without, _) = render_with(&scene, &settings);
            assert!(without.light.iter().all(Option::is_none));
            for groups in 1..=8usize {
                let (frame, _) = render_with(&scene, &Settings { light_groups: groups as u32, ..settings });
                assert_eq!(bits(&frame.beauty), bits(&without.beauty), "{groups} groups change the beauty");
                assert_eq!(bits(&frame.variance), bits(&without.variance));
                assert_eq!(frame.light.iter().filter(|l| l.is_some()).count(), groups);
                assert!(frame.light[groups..].iter().all(Option::is_none));
                let raw = pixels(&frame.raw);
                for (i, expected) in raw.iter().enumerate() {
                    for (c, expected) in expected.iter().enumerate() {
                        let sum: f64 = frame.light[..groups].iter().map(|l| f64::from(pixels(l)[i][c])).sum();
                        let error = (sum - f64::from(*expected)).abs();
                        // Contributions are added in single precision, in another order.
                        assert!(error <= 1e-6 * f64::from(*expected), "{groups} groups, pixel {i}: {sum} of {}", expected);
                    }
                }
            }
        }
    }
}

#[test]
fn emitters_have_the_last_group() {
    let settings = Settings { spp: 16, light_groups: 4, ..Settings::default() };
    let mut dark = room(true);
    dark.environment = Environment::constant([0.0; 3]);
    let (frame, _) = render_with(&compile(&dark), &settings);
    assert!(mean(&frame.light[3]) > 0.01);
    assert!(frame.light[..3].iter().all(|l| mean(l) == 0.0));
    assert_eq!(bits(&frame.light[3]), bits(&frame.raw));
    // Without a lamp the last group is one of the sky's.
    let (frame, _) = render_with(&compile(&room(false)), &settings);
    assert!(frame.light[..4].iter().all(|l| mean(l) > 1e-3));
    // A single group is that of all light.
    let (frame, _) = render_with(&compile(&room(true)), &Settings { light_groups: 1, ..settings });
    assert_eq!(bits(&frame.light[0]), bits(&frame.raw));
}

/// Lit from one texel, all light is in the group that holds it, however the environment is turned.
#[test]
fn groups_turn_with_the_environment() {
    for (x, y) in [(2, 3), (12, 3), (20, 3), (28, 3), (4, 12), (12, 12), (20, 12), (28, 12)] {
        for rotation in [0.0, 1.0, -2.5] {
            let mut loaded = room(false);
            let mut map = Image::filled(32, 16, [0.0; 3]);
            map.pixels[y * 32 + x] = [50.0; 3];
            loaded.environment = Environment { map, rotation, intensity: 1.0 };
            // Floor and spheres are lit from above, the spheres' undersides from below.
            let (frame, _) =
                render_with(&compile(&loaded), &Settings { spp: 4, light_groups: 8, max_bounces: 2, ..Settings::default() });
            let lit: Vec<usize> = (0..8).filter(|&g| mean(&frame.light[g]) > 0.0).collect();
            let expected = x / 8 + if y < 8 { 0 } else { 4 };
            assert!(lit.is_empty() && y >= 8 || lit == [expected], "texel {x} {y} turned by {rotation} lights {lit:?}");
        }
    }
}

/// The sum of the groups with a factor for each is the picture under the environment whose groups have these factors.
#[test]
fn groups_with_factors_are_the_picture_under_other_light() {
    let factors: [[f32; 3]; 8] = std::array::from_fn(|g| [0, 1, 2].map(|c| ((g * 3 + c * 5) % 9) as f32 * 0.5));
    for (constant, lamp, rotation) in [(false, false, 0.0), (false, true, 2.1), (true, false, -1.0)] {
        let mut loaded = room(lamp);
        loaded.environment.rotation = rotation;
        if constant {
            loaded.environment = Environment { rotation, ..Environment::constant([0.8, 0.5, 0.3]) };
        }
        let settings = Settings { spp: 4096, light_groups: 8, ..Settings::default() };
        let scene = compile(&loaded);
        let groups = settings.groups(&scene).unwrap();
        let mut factors = factors;
        if lamp {
            factors[groups.emitters()] = [1.0; 3];
        }
        let (frame, _) = render_with(&scene, &settings);
        loaded.environment = groups.weighed(&loaded.environment, &factors);
        let (other, _) = render_with(&compile(&loaded), &Settings { light_groups: 0, ..settings });
        let (mut difference, mut whole) = ([0.0f64; 3], [0.0f64; 3]);
        for (i, expected) in pixels(&other.raw).iter().enumerate() {
            for c in 0..3 {
                let sum: f32 = frame.light.iter().zip(&factors).map(|(light, factors)| pixels(light)[i][c] * factors[c]).sum();
                difference[c] += f64::from(sum - expected[c]);
                whole[c] += f64::from(expected[c]);
            }
        }
        let error: Vec<f64> = (0..3).map(|c| difference[c] / whole[c]).collect();
        println!("constant {constant}, lamp {lamp}: {error:?}");
        assert!(error.iter().all(|error| error.abs() < 0.01), "{error:?}");
    }
}

fn part(scene: &RenderScene, settings: &Settings, samples: Range<u32>) -> Film {
    expose(scene, settings, samples, &|_, _| (), &AtomicBool::new(false)).expect("in range").0
}

fn developed(scene: &RenderScene, settings: &Settings, film: &Film) -> Frame {
    develop(scene, settings, film).expect("of this scene").0
}

/// The bits of everything that samples add up to.
fn sums(frame: &Frame) -> Vec<u32> {
    let images = [&frame.beauty, &frame.raw, &frame.variance, &frame.guide_albedo, &frame.guide_normal];
    let colours = images.into_iter().chain(&frame.light).flat_map(bits);
    colours.chain(frame.alpha.pixels.iter().map(|v| v.to_bits())).collect()
}

#[test]
fn parts_in_any_order_equal_the_whole_bit_for_bit() {
    let flat = {
        let mut flat = room(false);
        // Pixels of the floor and of the sky have no variance at all: any rounding would show.
        flat.environment = Environment::constant([0.3, 0.7, 1.1]);
        flat
    };
    for (name, loaded) in [("sun and lamp", room(true)), ("flat sky", flat)] {
        let scene = compile(&loaded);
        for (sampler, groups) in [(Sampler::Sobol, 5), (Sampler::Independent, 0)] {
            let settings = Settings { spp: 61, light_groups: groups, sampler, ..Settings::default() };
            let whole = part(&scene, &settings, 0..61);
            let expected = developed(&scene, &settings, &whole);
            assert_eq!(expected.info.spp, 61);
            assert_eq!(sums(&expected), sums(&render_with(&scene, &settings).0));
            let cuts = [0..1, 1..2, 2..7, 7..32, 32..33, 33..61];
            for order in [[0, 1, 2, 3, 4, 5], [5, 4, 3, 2, 1, 0], [3, 0, 5, 2, 4, 1]] {
                let mut film = part(&scene, &settings, cuts[order[0]].clone());
                for &i in &order[1..] {
                    film.merge(&part(&scene, &settings, cuts[i].clone())).expect("disjoint");
                }
                assert_eq!(film.ranges(), std::slice::from_ref(&(0..61)));
                assert_eq!(film.samples(), 61);
                let differing =
                    sums(&developed(&scene, &settings, &film)).iter().zip(sums(&expected)).filter(|(a, b)| **a != *b).count();
                assert_eq!(differing, 0, "{name}, {order:?}: numbers that differ");
            }
            // Pairs of pairs.
            let join = |a: usize, b: usize| {
                let mut film = part(&scene, &settings, cuts[a].clone());
                film.merge(&part(&scene, &settings, cuts[b].clone())).expect("disjoint");
                film
            };
            let mut film = join(4, 1);
            film.merge(&join(0, 5)).expect("disjoint");
            film.merge(&join(3, 2)).expect("disjoint");
            assert_eq!(sums(&developed(&scene, &settings, &film)), sums(&expected), "{name}: pairs of pairs");
            assert_eq!(film, whole, "{name}: the film itself");
        }
    }
}

/// One pixel that looks at a floor under a sun of 1e7: samples one by one, added up here, against the film of all.
#[test]
fn many_samples_with_a_bright_one_among_them_keep_their_digits() {
    let mut loaded = room(false);
    let mut map = Image::filled(64, 32, [0.25, 0.5, 1.0]);
    map.pixels[6 * 64 + 21] = [1e7; 3];
    loaded.environment = Environment { map, rotation: 0.0, intensity: 1.0 };
    loaded.cameras = vec![camera([0.3, 1.6, 3.6], [0.0, 0.0, 1.5], 1.0, 1, 1)];
    let scene = compile(&loaded);
    // Scattering alone meets the sun rarely.
    let settings = Settings { spp: 100_000, direct: DirectLight::Scattering, max_bounces: 2, branches: 1, ..Settings::default() };
    let few = 4096;
    let samples: Vec<f64> = (0..few)
        .map(|i| f64::from(pixels(&developed(&scene, &settings, &part(&scene, &settings, i..i + 1)).raw)[0][2]))
        .collect();
    let largest = samples.iter().copied().fold(0.0, f64::max);
    let dim = samples.iter().filter(|&&v| v < 10.0).count();
    println!("brightest sample {largest:.1e}, {dim} of {few} below 10");
    assert!(largest > 1e6 && dim > 4000);
    let expected = samples.iter().sum::<f64>() / f64::from(few);
    let squares: f64 = samples.iter().map(|v| (v - expected) * (v - expected)).sum();
    let frame = developed(&scene, &settings, &part(&scene, &settings, 0..few));
    let (mean, variance) = (pixels(&frame.raw)[0][2], pixels(&frame.variance)[0][2]);
    assert!((f64::from(mean) / expected - 1.0).abs() < 1e-7, "{mean} for {expected}");
    assert!((f64::from(variance) / (squares / f64::from(few) / f64::from(few - 1)) - 1.0).abs() < 1e-6);
    // All of them, and in ten parts from the last to the first.
    let whole = developed(&scene, &settings, &part(&scene, &settings, 0..100_000));
    let mut film = part(&scene, &settings, 90_000..100_000);
    for i in (0..9).rev() {
        film.merge(&part(&scene, &settings, 10_000 * i..10_000 * (i + 1))).expect("disjoint");
    }
    assert_eq!(sums(&developed(&scene, &settings, &film)), sums(&whole));
}

#[test]
fn gaps_are_kept_in_mind() {
    let scene = compile(&room(false));
    let settings = Settings { spp: 16, ..Settings::default() };
    let mut film = part(&scene, &settings, 0..4);
    film.merge(&part(&scene, &settings, 8..12)).expect("disjoint");
    assert_eq!(film.ranges(), [0..4, 8..12]);
    assert_eq!(developed(&scene, &settings, &film).info.spp, 8);
    film.merge(&part(&scene, &settings, 4..8)).expect("fills the gap");
    assert_eq!(film.ranges(), std::slice::from_ref(&(0..12)));
}

#[test]
fn what_does_not_belong_together_is_refused() {
    let scene = compile(&room(false));
    let settings = Settings { spp: 16, branches: 1, ..Settings::default() };
    let film = part(&scene, &settings, 4..8);
    let refused = |other: &Film| {
        let mut merged = film.clone();
        assert!(matches!(merged.merge(other), Err(Error::Merge(_))));
        assert_eq!(merged, film, "a refused film leaves traces");
    };
    for range in [4..8, 0..5, 7..9, 5..6, 0..16] {
        refused(&part(&scene, &settings, range));
    }
    let mut turned = room(false);
    turned.hash = "turned".into();
    refused(&part(&compile(&turned), &settings, 8..12));
    let mut seeded = room(false);
    seeded.seed += 1;
    refused(&part(&compile(&seeded), &settings, 8..12));
    let mut larger = compile(&room(false));
    larger.set_resolution(21, 15);
    refused(&part(&larger, &settings, 8..12));
    let others = [
        Settings { max_bounces: 2, ..settings },
        Settings { bsdf: Mode::Published, ..settings },
        Settings { sampler: Sampler::Independent, ..settings },
        Settings { light_groups: 2, ..settings },
        Settings { spp: 32, ..settings },
    ];
    for other in &others {
        refused(&part(&scene, other, 8..12));
        assert!(matches!(develop(&scene, other, &film), Err(Error::Merge(_))));
    }
    assert!(matches!(develop(&larger, &settings, &film), Err(Error::Merge(_))));
    // What does not enter the samples may differ.
    assert!(develop(&scene, &Settings { irradiance: true, guide_samples: 3, ..settings }, &film).is_ok());
    for range in [Range { start: 3, end: 3 }, Range { start: 5, end: 3 }, 0..17, 16..17] {
        assert!(expose(&scene, &settings, range, &|_, _| (), &AtomicBool::new(false)).is_err());
    }
    // Four share a camera ray, and stay together.
    for range in [2..8, 4..9] {
        assert!(expose(&scene, &Settings { branches: 4, ..settings }, range, &|_, _| (), &AtomicBool::new(false)).is_err());
    }
}
