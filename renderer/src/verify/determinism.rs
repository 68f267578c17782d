//! The picture is a function of scene, seed and settings: bit for bit the same for any number of threads and order of tiles.

use super::scenes::{self, Part};
use super::{Check, Effort, Outcome, Ticker, Worst};
use crate::camera::Filter;
use crate::compile::RenderScene;
use crate::integrator;
use crate::schedule::with_shuffled_tiles;
use crate::settings::{Budget, Settings};
use crate::skips::Channels;
use glam::{Affine3A, Vec3};
use renderflow_frame::{Environment, Frame};
use renderflow_scenes::shapes::Shape;
use renderflow_scenes::{Material, Principled};

/// Checks of this file.
pub const CHECKS: &[Check] = &[
    Check {
        name: "determinism.threads",
        about: "every channel is bit-identical for 1, 2, 3, 7 and 16 threads, with every integrator, and of the scene compiled again",
        run: threads,
    },
    Check { name: "determinism.tiles", about: "every channel is bit-identical for any order of tiles", run: tiles },
];

/// The bits of every channel of a frame.
pub fn bits(frame: &Frame) -> Vec<u32> {
    let lit = [&frame.beauty, &frame.raw, &frame.variance, &frame.indirect, &frame.hidden, &frame.irradiance];
    let rgb = lit.into_iter().chain([&frame.guide_albedo, &frame.guide_normal]);
    let shown = rgb.chain(&frame.light).flatten().chain([&frame.albedo, &frame.normal, &frame.material]);
    let flow = [&frame.motion, &frame.motion_prev].into_iter().flatten();
    let numbers = shown.flat_map(|i| i.pixels.as_flattened()).chain(flow.flat_map(|i| i.pixels.as_flattened()));
    let numbers = numbers.chain(&frame.alpha.pixels).chain(&frame.depth.pixels).map(|v| v.to_bits());
    let counts = frame.samples.iter().flat_map(|i| i.pixels.iter().copied());
    numbers.chain(frame.object_id.pixels.iter().copied()).chain(frame.material_id.pixels.iter().copied()).chain(counts).collect()
}

/// Glossy and diffuse things under a sky with a sun, of odd size, so that tiles at both edges are partial.
fn scene(width: usize, height: usize) -> Result<RenderScene, String> {
    let glossy = Material::from(Principled { metallic: 1.0, roughness: 0.2, ..Principled::default() });
    let at = |x, z| Affine3A::from_translation(Vec3::new(x, 1.0, z));
    let parts = vec![
        Part::new(Shape::Plane { size: 6.0 }, scenes::diffuse([0.6, 0.5, 0.4]), Affine3A::IDENTITY),
        Part::new(Shape::Sphere { radius: 1.0 }, glossy, at(-0.8, 0.0)),
        Part::new(Shape::Torus { radius: 0.6, tube: 0.3 }, Material::default(), at(1.4, 0.3)),
    ];
    let environment = Environment { rotation: 0.4, ..scenes::sunny() };
    scenes::compile(parts, environment, scenes::camera([0.0, 2.0, 6.0], [0.0, 0.8, 0.0], 40.0, width, height))
}

/// Every channel.
const EVERY: Channels = Channels { paths: true, ..Channels::ALL };

/// Settings whose samples are spread by what the samples before them found, or by the G-buffer.
fn spread(spp: u32) -> [Settings; 3] {
    let budgets = [Budget::Average, Budget::Detail, Budget::Error { millionths: 20_000 }];
    budgets.map(|budget| Settings { spp: 4 * spp, budget, channels: EVERY, ..Settings::default() })
}

/// Renders with every integrator, one after the other.
fn everything(scene: &RenderScene, spp: u32, ticker: &Ticker<'_>) -> Result<Vec<u32>, String> {
    let mut all = Vec::new();
    for filter in [Filter::Box, Filter::BlackmanHarris] {
        let settings = Settings { spp, filter, irradiance: filter == Filter::Box, channels: EVERY, ..Settings::default() };
        let path = integrator::render(scene, &settings, &|_, _| (), ticker.cancel()).map_err(|e| e.to_string())?;
        all.extend(bits(&path));
        all.extend(bits(&integrator::ibl::render(scene, &settings).map_err(|e| e.to_string())?));
    }
    for settings in spread(spp) {
        let path = integrator::render(scene, &settings, &|_, _| (), ticker.cancel()).map_err(|e| e.to_string())?;
        all.extend(bits(&path));
    }
    Ok(all)
}

/// How many numbers of two renders differ; all of them where one failed or has another length.
fn differing(a: &[u32], b: &Result<Vec<u32>, String>) -> f64 {
    match b {
        Ok(b) if a.len() == b.len() => a.iter().zip(b).filter(|(x, y)| x != y).count() as f64,
        _ => a.len().max(1) as f64,
    }
}

fn pool(threads: usize) -> Result<rayon::ThreadPool, String> {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().map_err(|e| format!("{threads} threads: {e}"))
}

fn threads(effort: Effort, ticker: &Ticker<'_>) -> Vec<Outcome> {
    let name = "numbers that differ from those of one thread";
    let spp = effort.pick(4, 64);
    let run = || -> Result<Worst, String> {
        let compile = || scene(effort.pick(93, 251), effort.pick(77, 173));
        let scene = compile()?;
        let counts = [2, 3, 7, 16];
        ticker.expect(2 + counts.len() as u64);
        let one = pool(1)?.install(|| everything(&scene, spp, ticker))?;
        ticker.add(1);
        let mut worst = Worst::default();
        for count in counts {
            let other = pool(count)?.install(|| everything(&scene, spp, ticker));
            worst.see(differing(&one, &other), || format!("{count} threads, {} numbers", one.len()));
            ticker.add(1);
        }
        let again = compile()?;
        let other = pool(3)?.install(|| everything(&again, spp, ticker));
        worst.see(differing(&one, &other), || format!("compiled again, {} numbers", one.len()));
        ticker.add(1);
        Ok(worst)
    };
    vec![finish(run(), name)]
}

fn tiles(effort: Effort, ticker: &Ticker<'_>) -> Vec<Outcome> {
    let name = "numbers that differ from those of tiles in reading order";
    let orders = effort.pick(3_u64, 12);
    let run = || -> Result<Worst, String> {
        let scene = scene(effort.pick(93, 251), effort.pick(77, 173))?;
        ticker.expect(1 + orders);
        let settings = Settings { spp: effort.pick(4, 32), irradiance: true, channels: EVERY, ..Settings::default() };
        let render = || -> Result<Vec<u32>, String> {
            let mut all = Vec::new();
            for settings in [&[settings][..], &spread(settings.spp)].concat() {
                let frame = integrator::render(&scene, &settings, &|_, _| (), ticker.cancel()).map_err(|e| e.to_string())?;
                all.extend(bits(&frame));
            }
            Ok(all)
        };
        let straight = render()?;
        ticker.add(1);
        let mut worst = Worst::default();
        for order in 0..orders {
            let other = pool(3)?.install(|| with_shuffled_tiles(order, render));
            worst.see(differing(&straight, &other), || format!("order {order}, {} numbers", straight.len()));
            ticker.add(1);
        }
        Ok(worst)
    };
    vec![finish(run(), name)]
}

/// The claim that nothing differs; what could not be run failed.
fn finish(worst: Result<Worst, String>, name: &str) -> Outcome {
    match worst {
        Ok(worst) => worst.at_most(name, 0.0),
        Err(reason) => Outcome { passed: false, ..Outcome::at_most(name, 0, 0.0, 0.0, reason) },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use renderflow_frame::Image;

    #[test]
    fn one_changed_bit_is_seen() {
        let image = |value: f32| Some(Image::filled(1, 1, [0.5, value, 0.5]));
        let scene = scene(9, 7).expect("consistent");
        let frame = integrator::render_gbuffer(&scene, &Settings::default()).expect("in range");
        let with = |value| bits(&Frame { irradiance: image(value), ..frame.clone() });
        assert_eq!(differing(&with(0.5), &Ok(with(0.5))), 0.0);
        assert_eq!(differing(&with(0.5), &Ok(with(0.5_f32.next_up()))), 1.0);
        assert!(differing(&with(0.5), &Ok(bits(&frame))) > 0.0);
    }
}
