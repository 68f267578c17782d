//! Emissive triangles as lights: samples follow the density claimed for them, and estimates have the mean known on paper.

use super::chi_square::{Counts, DirectionGrid, Random, judge};
use super::lights::{estimate, standard_errors};
use super::{Check, Effort, Outcome, Ticker, Worst};
use crate::light::{
    EmissiveTriangle, EmitterLight, EnvironmentLight, LightSample, LightSampler, Lights, Receiver, Selection, Source,
};
use glam::{DVec3, Vec3A};
use renderflow_frame::Environment;
use std::f64::consts::PI;

/// The checks of this file.
pub const CHECKS: &[Check] = &[
    Check {
        name: "lights.emitter_draws",
        about: "directions drawn towards emissive triangles against their density (chi-square)",
        run: emitter_draws,
    },
    Check {
        name: "lights.emitter_irradiance",
        about: "irradiance under a rectangle against its form factor, at scales from 1e-6 to 1e6",
        run: emitter_irradiance,
    },
    Check {
        name: "lights.emitter_choice",
        about: "each of a million triangles is drawn exactly as often as its density says, and the points of a triangle evenly",
        run: emitter_choice,
    },
    Check {
        name: "lights.emitter_limits",
        about: "points on, beside and far from emitters of every size: samples are finite and agree with the density of a hit",
        run: emitter_limits,
    },
];

/// A rectangle of `width` x `depth` centred above the origin at `height`, emitting downwards.
fn rectangle(width: f32, depth: f32, height: f32, radiance: f32, two_sided: bool) -> [EmissiveTriangle; 2] {
    let corner = |x: f32, z: f32| Vec3A::new(0.5 * x * width, height, 0.5 * z * depth);
    let [a, b, c, d] = [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
    let triangle = |corners, id| EmissiveTriangle { corners, radiance: Vec3A::splat(radiance), two_sided, id };
    [triangle([a, b, c], 7), triangle([a, c, d], 9)]
}

/// Receives light from all sides.
fn open(p: Vec3A) -> Receiver {
    Receiver { p, n: Vec3A::ZERO }
}

/// Number of the triangle that a sample leads to, weights of its corners, and its normal.
fn met(sample: &LightSample) -> Option<(u32, [f32; 3], Vec3A)> {
    match sample.source {
        Source::Emitter { id, barycentrics, n } => Some((id, barycentrics, n)),
        _ => None,
    }
}

/// Integrals of a light's density over cells of directions from `at`, through points spread evenly over each triangle, `side`
/// times `side`; a cell beyond those of the grid has the rest. (Cubature over the cells would have to find the edges of the
/// triangles.)
fn emitter_integrals(
    light: &EmitterLight,
    triangles: &[EmissiveTriangle],
    at: &Receiver,
    grid: &DirectionGrid,
    side: usize,
) -> Vec<f64> {
    let mut integrals = vec![0.0; grid.cells() + 1];
    for triangle in triangles {
        let [a, b, c] = triangle.corners.map(|v| v.as_dvec3());
        let cross = (b - a).cross(c - a);
        let (n, area) = (cross.normalize(), 0.5 * cross.length() / (side * side) as f64);
        // Each of side^2 equal triangles by its centroid: those that point up, and those that point down.
        let third = |i: usize, k: f64| (i as f64 + k / 3.0) / side as f64;
        let points = (0..side).flat_map(|i| {
            let up = (0..side - i).map(move |j| (third(i, 1.0), third(j, 1.0)));
            up.chain((0..side - i - 1).map(move |j| (third(i, 2.0), third(j, 2.0))))
        });
        for (x, y) in points {
            let towards = a + (b - a) * x + (c - a) * y - at.p.as_dvec3();
            let (distance, wi) = (towards.length(), towards.normalize());
            let cos = -n.dot(wi);
            let pdf = f64::from(light.pdf(at, triangle.id, distance as f32, cos as f32));
            integrals[grid.cell(wi)] += pdf * cos.abs() / (distance * distance) * area;
        }
    }
    let total: f64 = integrals.iter().sum();
    integrals[grid.cells()] = (1.0 - total).max(0.0);
    integrals
}

fn emitter_draws(effort: Effort, ticker: &Ticker<'_>) -> Vec<Outcome> {
    let draws = effort.pick(50_000, 1_000_000);
    let needle = |id| EmissiveTriangle {
        corners: [Vec3A::new(3.0, 0.5, 0.0), Vec3A::new(3.0, 0.5, 4.0), Vec3A::new(3.0, 0.7, 0.0)],
        radiance: Vec3A::new(0.0, 4.0, 30.0),
        two_sided: true,
        id,
    };
    let room = |two_sided| {
        let mut all = rectangle(2.0, 1.0, 2.0, 5.0, two_sided).to_vec();
        all.push(needle(2));
        all.push(needle(400_000_000));
        all
    };
    let points = [DVec3::ZERO, DVec3::new(0.4, 1.9, 0.2), DVec3::new(2.0, 0.1, -3.0), DVec3::new(-30.0, -5.0, 10.0)];
    let ways = [
        (Selection::Power, Vec3A::ZERO),
        (Selection::Tree, Vec3A::ZERO),
        (Selection::Tree, Vec3A::new(0.6, 0.8, 0.0)),
        (Selection::Tree, Vec3A::new(0.0, -0.8, 0.6)),
    ];
    ticker.expect((2 * ways.len() * points.len()) as u64);
    let mut experiments = Vec::new();
    for (two_sided, (selection, n)) in [false, true].into_iter().flat_map(|sides| ways.map(|way| (sides, way))) {
        let triangles = room(two_sided);
        let Some(light) = EmitterLight::new(triangles.iter().copied(), selection) else { continue };
        for p in points {
            if ticker.cancelled() {
                break;
            }
            let distance = p.distance(DVec3::new(0.0, 2.0, 0.0));
            let grid = DirectionGrid::new(DVec3::new(0.0, 2.0, 0.0) - p, (1.0 / (distance * distance)).min(1.0), 16, 16);
            let at = Receiver { p: p.as_vec3a(), n };
            let expected = emitter_integrals(&light, &triangles, &at, &grid, effort.pick(700, 2500));
            let mut counts = Counts::new(format!("from {p}, {selection:?}, facing {n}, two-sided {two_sided}"), expected);
            let mut random = Random::new(experiments.len() as u64);
            for _ in 0..draws {
                let drawn = light.sample(&at, [random.next(), random.next()], [random.next(), random.next()]);
                counts.add(drawn.map_or(grid.cells(), |drawn| grid.cell(drawn.wi.as_dvec3())));
            }
            experiments.push(counts);
            ticker.add(1);
        }
    }
    vec![judge("draws follow the density", &experiments)]
}

/// A right triangle of two edges of `size`, facing +z.
fn right_triangle(id: u32, size: f32) -> EmissiveTriangle {
    let corners = [Vec3A::ZERO, Vec3A::new(size, 0.0, 0.0), Vec3A::new(0.0, size, 0.0)];
    EmissiveTriangle { corners, radiance: Vec3A::ONE, two_sided: false, id }
}

fn emitter_choice(effort: Effort, ticker: &Ticker<'_>) -> Vec<Outcome> {
    ticker.expect(2);
    let (mut choices, mut points) = (Worst::default(), Worst::default());
    // A thousand different powers.
    let count = 1_000_000;
    let size = |id: u32| 1e-3 * (1.0 + (id % 1000) as f32);
    if let Some(light) = EmitterLight::new((0..count).map(|id| right_triangle(id, size(id))), Selection::Power) {
        // All 2^23 random numbers that a generator of 23 bits has.
        let units = 1_u32 << 23;
        let above = open(Vec3A::new(0.1, 0.1, 2.0));
        let mut drawn = vec![0_u32; count as usize];
        for unit in 0..units {
            let sample = light.sample(&above, [unit as f32 / units as f32, 0.0], [0.3, 0.4]);
            if let Some((id, ..)) = sample.as_ref().and_then(met) {
                drawn[id as usize] += 1;
            }
        }
        let mut total = 0.0;
        for (id, drawn) in (0..count).zip(drawn) {
            let expected = f64::from(light.pdf(&above, id, 1.0, 1.0)) * 0.5 * f64::from(size(id)).powi(2);
            total += expected;
            let difference = (f64::from(drawn) / f64::from(units) - expected).abs();
            choices.see(difference / (1e-6 * expected + 1e-12), || format!("{id}: drawn {drawn} times, claimed {expected}"));
        }
        choices.see((total - 1.0).abs() / 1e-6, || format!("all together {total}"));
    }
    ticker.add(1);
    if let Some(light) = EmitterLight::new([right_triangle(0, 1.0)], Selection::Tree) {
        let draws = effort.pick(100_000, 1_000_000);
        let mut random = Random::new(2);
        let mut sums = [0.0; 3];
        for _ in 0..draws {
            let drawn = light.sample(&open(Vec3A::new(0.2, 0.2, 3.0)), [0.0; 2], [random.next(), random.next()]);
            let shares = drawn.as_ref().and_then(met).map_or([f32::NAN; 3], |(_, barycentrics, _)| barycentrics);
            sums.iter_mut().zip(shares).for_each(|(sum, share)| *sum += f64::from(share * share));
        }
        // The mean of a squared barycentric coordinate is 1/6, its variance 7/180.
        let error = (7.0_f64 / 180.0 / f64::from(draws)).sqrt();
        for (corner, sum) in sums.into_iter().enumerate() {
            let mean = sum / f64::from(draws);
            points.see((mean - 1.0 / 6.0).abs() / error, || format!("corner {corner}: {mean}"));
        }
    }
    ticker.add(1);
    vec![
        choices.at_most("times drawn, share of the tolerance of a millionth", 1.0),
        points.at_most("means of squared barycentric coordinates, standard errors", 4.0),
    ]
}

/// Irradiance over radiance under the centre of a rectangle parallel to the surface (Howell, "Radiation Heat Transfer
/// Configuration Factors", B-4, four times).
pub fn irradiance_under(width: f64, depth: f64, height: f64) -> f64 {
    let (a, b) = (0.5 * width / height, 0.5 * depth / height);
    let part = |a: f64, b: f64| a / a.hypot(1.0) * (b / a.hypot(1.0)).atan();
    2.0 * (part(a, b) + part(b, a))
}

fn emitter_irradiance(effort: Effort, ticker: &Ticker<'_>) -> Vec<Outcome> {
    let draws = effort.pick(100_000, 1_000_000);
    let shapes = [(2.0, 1.0, 1.0), (1.0, 1.0, 30.0), (5.0, 0.01, 0.3), (1.0, 1.0, 0.1)];
    let scales = [1e-6, 1e-3, 1.0, 1e3, 1e6];
    ticker.expect((shapes.len() * scales.len()) as u64);
    let (mut alone, mut with_sky) = (Worst::default(), Worst::default());
    for (width, depth, height) in shapes {
        for scale in scales {
            if ticker.cancelled() {
                break;
            }
            let triangles = rectangle(width * scale, depth * scale, height * scale, 3.0, false);
            let place = || format!("{width} x {depth} at {height}, scale {scale}");
            let truth = 3.0 * irradiance_under(width.into(), depth.into(), height.into());
            let mut random = Random::new(1);
            let at = Receiver { p: Vec3A::ZERO, n: Vec3A::Y };
            let Some(light) = EmitterLight::new(triangles, Selection::Tree) else { continue };
            let found = estimate(draws, || {
                let drawn = light.sample(&at, [random.next(), random.next()], [random.next(), random.next()]);
                drawn.map_or(0.0, |drawn| 3.0 * f64::from(drawn.wi.y.max(0.0)) / f64::from(drawn.pdf))
            });
            alone.see(standard_errors(found, truth), place);
            // Under a sky of radiance 2 that the rectangle does not hide.
            let Ok(sky) = EnvironmentLight::new(&Environment::constant([2.0; 3])) else { continue };
            let sampler = LightSampler::new(sky, Lights::of(triangles));
            let found = estimate(draws, || {
                let choice = [random.next(), random.next()];
                let Some(drawn) = sampler.sample(&at, choice, [random.next(), random.next()]) else { return 0.0 };
                let radiance = match drawn.source {
                    Source::Environment { radiance } => f64::from(radiance.x),
                    _ => 3.0,
                };
                radiance * f64::from(drawn.wi.y.max(0.0)) / f64::from(drawn.pdf)
            });
            with_sky.see(standard_errors(found, truth + 2.0 * PI), place);
            ticker.add(1);
        }
    }
    vec![alone.at_most("rectangle alone, standard errors", 4.0), with_sky.at_most("rectangle and sky, standard errors", 4.0)]
}

/// Normal of the front, of no particular length; in f64, where that of a needle points the right way.
fn front(triangle: &EmissiveTriangle) -> DVec3 {
    let [a, b, c] = triangle.corners.map(|v| v.as_dvec3());
    (b - a).cross(c - a)
}

fn emitter_limits(effort: Effort, ticker: &Ticker<'_>) -> Vec<Outcome> {
    let cases = effort.pick(100_000_u64, 5_000_000);
    ticker.expect(cases);
    let (mut broken, mut differing) = (Worst::default(), Worst::default());
    let mut random = Random::new(3);
    for i in 0..cases {
        if ticker.cancelled() {
            break;
        }
        let mut any = |exponents: f32| {
            let size = 10.0_f32.powf(exponents * (2.0 * random.next() - 1.0));
            random.direction().as_vec3a() * size
        };
        let mut corners = [any(6.0), any(6.0), any(6.0)];
        if i % 3 == 0 {
            // A needle.
            corners[2] = corners[0] + (corners[1] - corners[0]) * 0.3 + any(0.0) * 1e-4;
        }
        let far = any(8.0);
        // Of another triangle, so that there is a choice.
        let others = [any(6.0), any(6.0), any(6.0)];
        let radiance = Vec3A::splat(10.0_f32.powf(60.0 * random.next() - 30.0));
        let triangle = EmissiveTriangle { corners, radiance, two_sided: i % 2 == 0, id: 5 };
        let other = EmissiveTriangle { corners: others, id: 6, ..triangle };
        let selection = if i % 7 < 5 { Selection::Tree } else { Selection::Power };
        let Some(light) = EmitterLight::new([triangle, other], selection) else { continue };
        let [s, t] = [random.next(), random.next()];
        let inside = corners[0] * (1.0 - s) + (corners[1] * (1.0 - t) + corners[2] * t) * s;
        let p = match i % 5 {
            0 => corners[0],
            1 => inside,
            2 => inside + (far * 1e-12),
            3 => corners[0] + (corners[1] - corners[0]) * 3.0,
            _ => far,
        };
        let n = if i % 2 == 0 { Vec3A::ZERO } else { random.direction().as_vec3a() };
        let at = Receiver { p, n };
        let choice = [random.next(), random.next()];
        let Some(drawn) = light.sample(&at, choice, [random.next(), random.next()]) else { continue };
        let Some((id, barycentrics, n)) = met(&drawn) else { continue };
        let triangle = if id == 5 { triangle } else { other };
        let unit = (drawn.wi.length() - 1.0).abs() < 1e-5 && (n.length() - 1.0).abs() < 1e-5;
        let sound = unit
            && drawn.pdf > 0.0
            && drawn.pdf.is_finite()
            && drawn.distance > 0.0
            && drawn.distance.is_finite()
            && barycentrics.iter().all(|b| (0.0..=1.0).contains(b));
        broken.see(f64::from(u8::from(!sound)), || format!("{triangle:?} from {p}: {drawn:?}"));
        let towards = -n.dot(drawn.wi);
        let cos = if triangle.two_sided || front(&triangle).dot(n.as_dvec3()) >= 0.0 { towards } else { -towards };
        let claimed = light.pdf(&at, id, drawn.distance, cos);
        differing.see(f64::from((claimed / drawn.pdf - 1.0).abs()), || format!("{triangle:?} from {p}: {claimed}, {drawn:?}"));
        if i % 1024 == 1023 {
            ticker.add(1024);
        }
    }
    vec![
        broken.at_most("samples that are not finite, unit and positive", 0.0),
        differing.at_most("relative difference to the density of a hit", 1e-5),
    ]
}
