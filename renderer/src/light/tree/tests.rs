//! The tree of lights against what it says of itself.

use super::*;
use crate::light::punctual::Lamp;
use crate::random::Random;
use glam::{Affine3A, Mat3A};
use renderflow_scenes::loaded::{PunctualKind, PunctualLight};

fn anywhere(random: &mut Random, size: f32) -> Vec3A {
    random.direction().as_vec3a() * (size * random.next())
}

/// A triangle and whether it has two sides, or a lamp.
type Shape = Result<([Vec3A; 3], bool), Lamp>;

/// Triangles of very different sizes and spots with very different strengths; the triangles' corners and sides with them.
fn mixed(count: u32, seed: u64) -> (Vec<TreeLight>, Vec<Shape>) {
    let mut random = Random::new(seed);
    let (mut lights, mut shapes) = (Vec::new(), Vec::new());
    for item in 0..count {
        let center = anywhere(&mut random, 10.0);
        let strength = 10.0_f32.powf(-6.0 * random.next());
        if item % 4 == 3 {
            let (x, y) = random.direction().as_vec3a().any_orthonormal_pair();
            let matrix3 = Mat3A::from_cols(x, y, x.cross(y));
            let inner = 1.2 * random.next();
            let outer = inner + 0.01 + 0.3 * random.next();
            let kind = if item % 8 == 3 {
                PunctualKind::Point { intensity: [strength; 3] }
            } else {
                PunctualKind::Spot { intensity: [strength; 3], inner, outer }
            };
            let transforms = vec![Affine3A { matrix3, translation: center }];
            let lamp = Lamp::new(&PunctualLight { name: String::new(), kind, profile: None, transforms }, 0).unwrap();
            let (axis, theta_o, theta_e) = lamp.spread();
            lights.push(TreeLight { item, low: center, high: center, axis, theta_o, theta_e, two_sided: false, strength });
            shapes.push(Err(lamp));
        } else {
            let size = 10.0_f32.powf(-5.0 * random.next());
            let corners = [(); 3].map(|()| center + anywhere(&mut random, size));
            let cross = (corners[1] - corners[0]).as_dvec3().cross((corners[2] - corners[0]).as_dvec3());
            let (low, high) = (corners[0].min(corners[1]).min(corners[2]), corners[0].max(corners[1]).max(corners[2]));
            let (axis, two_sided) = (cross.normalize_or(glam::DVec3::X).as_vec3a(), item % 5 == 0);
            lights.push(TreeLight { item, low, high, axis, theta_o: 0.0, theta_e: FRAC_PI_2, two_sided, strength });
            shapes.push(Ok((corners, two_sided)));
        }
    }
    (lights, shapes)
}

fn receivers(random: &mut Random) -> Receiver {
    let size = if random.next() < 0.3 { 100.0 } else { 10.0 };
    let n = if random.next() < 0.3 { Vec3A::ZERO } else { random.direction().as_vec3a() };
    Receiver { p: anywhere(random, size), n }
}

/// Random numbers that lead nowhere, and those that lead to the lights, are all there are. Each number leads to the light
/// that says so.
#[test]
fn shares_are_exact() {
    for (count, seed) in [(1, 1), (2, 2), (3, 3), (17, 4), (300, 5)] {
        let (lights, _) = mixed(count, seed);
        let range = 4000;
        let tree = LightTree::new(lights, range).unwrap();
        let mut random = Random::new(seed + 100);
        for _ in 0..40 {
            let at = receivers(&mut random);
            let mut led = vec![0; count as usize];
            for unit in 0..range {
                let Some((item, units)) = tree.pick(unit, &at) else { continue };
                assert_eq!(units, tree.units(item, &at), "{count} lights, {item}");
                led[item] += 1;
            }
            // Where numbers end before they reach a light, its units count those that would.
            for (item, led) in led.into_iter().enumerate() {
                assert_eq!(led, tree.units(item, &at), "{count} lights, {item}");
            }
        }
    }
}

/// How often lights are drawn with random numbers of 46 bits, against what is said: at most 4.5 standard errors off for each of
/// a thousand frequencies.
#[test]
fn lights_are_drawn_as_often_as_said() {
    let (lights, _) = mixed(60, 9);
    let range = 1_u64 << 46;
    let tree = LightTree::new(lights, range).unwrap();
    let mut random = Random::new(10);
    let draws = 200_000;
    for _ in 0..20 {
        let at = receivers(&mut random);
        let mut led = [0; 60];
        for _ in 0..draws {
            let unit = u64::from((random.next() * 8_388_608.0) as u32) << 23 | u64::from((random.next() * 8_388_608.0) as u32);
            if let Some((item, _)) = tree.pick(unit, &at) {
                led[item] += 1;
            }
        }
        for (item, led) in led.into_iter().enumerate() {
            let share = tree.units(item, &at) as f64 / range as f64;
            let mean = share * f64::from(draws);
            let error = (mean * (1.0 - share)).sqrt() + 1.0;
            assert!((f64::from(led) - mean).abs() < 4.5 * error, "{item}: {led}, not {mean}");
        }
    }
}

/// No light that sends anything to a point is left out there.
#[test]
fn whatever_contributes_may_be_drawn() {
    let (lights, shapes) = mixed(2000, 20);
    let tree = LightTree::new(lights, 1 << 46).unwrap();
    let mut random = Random::new(21);
    let mut contributing = 0;
    for _ in 0..400 {
        let at = receivers(&mut random);
        for (item, shape) in shapes.iter().enumerate() {
            let wi = match shape {
                Err(lamp) => lamp.arriving(at.p).map(|arriving| arriving.wi),
                Ok((corners, two_sided)) => {
                    // A point inside, as seen from the receiver.
                    let [s, t] = [random.next(), random.next()];
                    let q = corners[0] * (1.0 - s) + (corners[1] * (1.0 - t) + corners[2] * t) * s;
                    let cross = (corners[1] - corners[0]).as_dvec3().cross((corners[2] - corners[0]).as_dvec3());
                    let wi = (q - at.p).normalize();
                    (*two_sided || cross.dot(-wi.as_dvec3()) > 0.0).then_some(wi)
                }
            };
            let Some(wi) = wi.filter(|wi| at.n == Vec3A::ZERO || at.n.dot(*wi) > 0.0) else { continue };
            contributing += 1;
            assert!(tree.units(item, &at) > 0, "{item} along {wi} at {at:?}: {shape:?}");
        }
    }
    assert!(contributing > 100_000, "{contributing}");
}

/// Lights that a tree does not like: all at one place, in a line, of no strength, far out, and a list so skewed that cutting
/// by cost would make it too deep.
#[test]
fn odd_lists_make_trees() {
    let light = |item: u32, p: Vec3A, size: f32, strength: f32| TreeLight {
        item,
        low: p - size,
        high: p + size,
        axis: Vec3A::Y,
        theta_o: 0.0,
        theta_e: FRAC_PI_2,
        two_sided: item.is_multiple_of(2),
        strength,
    };
    type List<'a> = (&'static str, Box<dyn Fn(u32) -> TreeLight + 'a>);
    let lists: [List<'_>; 6] = [
        ("one place", Box::new(|i| light(i, Vec3A::ONE, 0.0, 1.0))),
        ("a line", Box::new(|i| light(i, Vec3A::X * i as f32, 0.1, 1.0))),
        ("no strength", Box::new(|i| light(i, Vec3A::X * i as f32, 0.1, 0.0))),
        ("far out", Box::new(|i| light(i, Vec3A::new(1e12, i as f32 * 1e6, -1e12), 1e3, 1e-30))),
        ("skewed", Box::new(|i| light(i, Vec3A::Y * 1.5_f32.powi(i as i32 % 200), 0.0, 1.0))),
        ("huge", Box::new(|i| light(i, Vec3A::X, 1e12, 1.0 / (1 + i) as f32))),
    ];
    for (name, make) in lists {
        for count in [1, 2, 3, 1000, 9000] {
            let tree = LightTree::new((0..count).map(&make).collect(), 1 << 46).unwrap();
            for p in [Vec3A::ZERO, Vec3A::ONE, Vec3A::splat(-1e12), Vec3A::new(3.0, -50.0, 1.0)] {
                let at = Receiver { p, n: Vec3A::ZERO };
                let total: u64 = (0..count as usize).map(|item| tree.units(item, &at)).sum();
                assert!(total <= 1 << 46, "{name}, {count}");
                for k in 0..64 {
                    if let Some((item, units)) = tree.pick(k << 40, &at) {
                        assert!(units > 0 && units == tree.units(item, &at), "{name}, {count}");
                    }
                }
            }
        }
    }
    assert!(LightTree::new(Vec::new(), 1 << 46).is_none());
}

/// A near light is drawn more often than a far one, one that shines here more often than one that shines elsewhere, and what
/// lies below the horizon never.
#[test]
fn importance_follows_the_light() {
    let light = |item: u32, p: Vec3A, axis: Vec3A| TreeLight {
        item,
        low: p - 0.01,
        high: p + 0.01,
        axis,
        theta_o: 0.0,
        theta_e: FRAC_PI_2,
        two_sided: false,
        strength: 1.0,
    };
    let near = light(0, Vec3A::new(0.0, 1.0, 0.0), Vec3A::NEG_Y);
    let far = light(1, Vec3A::new(0.0, 10.0, 0.0), Vec3A::NEG_Y);
    let slanted = light(2, Vec3A::new(1.0, 1.0, 0.0), Vec3A::NEG_Y);
    let away = light(3, Vec3A::new(0.0, 1.1, 0.0), Vec3A::Y);
    let below = light(4, Vec3A::new(0.0, -1.0, 0.0), Vec3A::Y);
    let tree = LightTree::new(vec![near, far, slanted, away, below], 1 << 46).unwrap();
    let at = Receiver { p: Vec3A::ZERO, n: Vec3A::Y };
    let share = |item| tree.units(item, &at) as f64 / (1_u64 << 46) as f64;
    assert!(share(0) > 20.0 * share(1) && share(1) > 0.0, "{} {}", share(0), share(1));
    assert!(share(0) > 2.0 * share(2), "{} {}", share(0), share(2));
    assert_eq!((share(3), share(4)), (0.0, 0.0));
}
