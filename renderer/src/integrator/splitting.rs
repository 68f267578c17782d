//! How many light samples the first surface of a path gets, by what they bring in this picture.
//!
//! What a camera ray brings is the mean of `l` light samples at what it hits, plus the mean of `b` paths that go on from there.
//! With `v_x` the variance between camera rays, `v_l` of a light sample and `v_s` of a path, and `c_x`, `c_l`, `c_s` what each
//! costs, the picture's error in a given time is in proportion to
//!
//! `(v_x + v_l / l + v_s / b) (c_x + l c_l + b c_s)`,
//!
//! whose least value over `l` is sought (splitting: Arvo and Kirk 1990; Pharr, Jakob and Humphreys 2023, section 2.2.5). Under a
//! smooth sky that scattering finds anyway the answer is few, where half-shadows are the noise it is many. Pilot paths of a few
//! pixels tell the variances; their random numbers are their own, so that the picture has no bias.

use super::light_paths::CausticCasters;
use super::tracer::{Probe, Shot, Tracer};
use super::visible::Visible;
use crate::compile::RenderScene;
use crate::features::{Features, with_features};
use crate::sampler::{PixelSampler, hash};
use crate::settings::{DirectLight, Settings};
use glam::Vec3A;
use rayon::prelude::*;

/// Light samples of a camera ray that are tried.
const CHOICES: [u32; 4] = [1, 2, 4, 8];
/// Pixels that are asked: fewer say too little, more say nothing new.
const FEWEST: usize = 256;
const MOST: usize = 1024;
/// Light samples of pictures with too few samples for a pilot. Most of them are for denoisers
/// (docs/measurements/renderer-notes.md, light-samples).
const UNASKED: u32 = 4;
/// Camera rays of each.
const RAYS: u32 = 4;
/// Samples of the picture for each of the pilot, at least.
const SHARE: u64 = 32;
/// Share of the pixels that count, those with least variance: a few bright dots must not decide.
const TRIMMED: f64 = 0.98;
/// What relative errors are relative to, besides the squared mean: that of relMSE.
const DARK: f32 = 0.01;

/// Costs, in some 100 ns: of a camera ray with the surface it meets, of drawing a light sample and asking the BSDF, of a ray
/// with what follows it.
const CAMERA: f64 = 3.0;
const LIGHT: f64 = 0.5;
const RAY: f64 = 1.0;

/// Tells the random numbers of the pilot from those of the picture.
const STREAM: u64 = 0x5350_4c49;

/// Light samples at the first surface behind a camera ray: `settings.light_samples`, or else what suits the picture.
pub(super) fn light_samples(
    scene: &RenderScene,
    settings: &Settings,
    visible: &Visible,
    casters: Option<&CausticCasters>,
) -> u32 {
    if let Some(count) = settings.light_samples {
        return count;
    }
    with_features!(settings.needed(scene), settings.full(), choose(scene, settings, visible, casters))
}

fn choose<F: Features>(scene: &RenderScene, settings: &Settings, visible: &Visible, casters: Option<&CausticCasters>) -> u32 {
    let (width, height) = (scene.camera().width, scene.camera().height);
    let samples = (width * height) as u64 * u64::from(settings.spp);
    let count = ((samples / (SHARE * 2 * u64::from(RAYS))) as usize).min(MOST);
    if !scene.samples_lights::<F>() || settings.direct != DirectLight::Mis {
        return 1;
    }
    if count < FEWEST {
        return UNASKED;
    }
    let seed = hash::child(scene.seed, STREAM);
    // Evenly over the picture, in reading order.
    let pixels: Vec<usize> = (0..count).map(|k| (2 * k + 1) * width * height / (2 * count)).collect();
    let ask = |pixels: &[usize]| -> Vec<Pixel> {
        let mut tracer = Tracer::<F>::new(scene, settings, casters, 1);
        let mut asked = Vec::new();
        for &at in pixels {
            let pixel = (at % width, at / width);
            if visible.at(pixel.0, pixel.1) {
                let sampler = PixelSampler::of_kind(settings.sampler, seed, scene.frame() as u64, at as u64);
                let shots: [Shot; RAYS as usize] =
                    std::array::from_fn(|k| Shot { sampler, pixel, index: k as u32, count: RAYS, seen: true });
                asked.extend(Pixel::of(&tracer.probe(&shots)));
            }
        }
        asked
    };
    let mut asked: Vec<Pixel> = pixels.par_chunks(16).flat_map_iter(ask).collect();
    asked.sort_by(|a, b| a.total().total_cmp(&b.total()));
    asked.truncate((asked.len() as f64 * TRIMMED).ceil() as usize);
    let sum = |value: fn(&Pixel) -> f64| asked.iter().map(value).sum::<f64>();
    let (camera, light, path) = (sum(|p| p.camera).max(0.0), sum(|p| p.light), sum(|p| p.path));
    let rays = asked.len().max(1) as f64;
    let (cost_of_light, cost_of_path) = (LIGHT + RAY * sum(|p| p.light_rays) / rays, RAY * sum(|p| p.path_rays) / rays);
    let branches = f64::from(settings.branches());
    // Camera rays are spread evenly over a pixel, which independent ones are not.
    let camera = camera / f64::from(settings.camera_samples()).sqrt();
    let price = |count: u32| {
        let count = f64::from(count);
        (camera + light / count + path / branches) * (CAMERA + count * cost_of_light + branches * cost_of_path)
    };
    CHOICES.into_iter().min_by(|a, b| price(*a).total_cmp(&price(*b))).unwrap_or(1)
}

/// What the pilot says of a pixel: variances of one camera ray, light sample and path, relative to the squared mean, and rays
/// that the latter two take.
struct Pixel {
    camera: f64,
    light: f64,
    path: f64,
    light_rays: f64,
    path_rays: f64,
}

impl Pixel {
    /// `None` where nothing was met.
    fn of(probes: &[Probe]) -> Option<Self> {
        let count = probes.len() as f32;
        if probes.is_empty() {
            return None;
        }
        let square = |v: Vec3A| v * v;
        let half = |pair: &[Vec3A; 2]| square(pair[0] - pair[1]) * 0.5;
        let mean_of = |f: &dyn Fn(&Probe) -> Vec3A| probes.iter().map(f).sum::<Vec3A>() / count;
        let (light, path) = (mean_of(&|p| half(&p.light)), mean_of(&|p| half(&p.path)));
        let whole = |p: &Probe| (p.light[0] + p.light[1] + p.path[0] + p.path[1]) * 0.5;
        let mean = mean_of(&whole);
        let spread = probes.iter().map(|p| square(whole(p) - mean)).sum::<Vec3A>() / (count - 1.0).max(1.0);
        // The mean of two light samples and two paths has half of their variance.
        let camera = spread - 0.5 * (light + path);
        let relative = |v: Vec3A| f64::from((v / (mean * mean + DARK)).element_sum());
        let rays = |f: fn(&Probe) -> u64| probes.iter().map(|p| f(p) as f64).sum::<f64>() / (2.0 * f64::from(count));
        let pixel = Self {
            camera: relative(camera),
            light: relative(light),
            path: relative(path),
            light_rays: rays(|p| p.light_rays),
            path_rays: rays(|p| p.path_rays),
        };
        pixel.total().is_finite().then_some(pixel)
    }

    fn total(&self) -> f64 {
        self.camera.abs() + self.light + self.path
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::verify::scenes::{Part, camera, compile, diffuse, environment, metal, sunny};
    use crate::{Channels, render};
    use glam::Affine3A;
    use renderflow_scenes::shapes::Shape;
    use std::sync::atomic::AtomicBool;

    /// However many light samples there are, the picture converges to the same one, and has less noise with more.
    #[test]
    fn light_samples_change_the_noise_alone() {
        let at = |x, y, z| Affine3A::from_translation(glam::Vec3::new(x, y, z));
        let parts = vec![
            Part::new(Shape::Sphere { radius: 0.7 }, diffuse([0.8, 0.5, 0.2]), at(-0.6, 0.7, 0.0)),
            Part::new(Shape::Sphere { radius: 0.5 }, metal([0.9; 3], 0.3), at(0.7, 0.5, 0.3)),
            Part::new(Shape::Plane { size: 20.0 }, diffuse([0.5; 3]), at(0.0, 0.0, 0.0)),
        ];
        let scene = compile(parts, sunny(), camera([0.2, 1.5, 4.0], [0.0, 0.4, 0.0], 45.0, 48, 32)).unwrap();
        // Sums of the picture, of its variance, and of the variance without the noisiest tenth, where few paths that meet the sun
        // decide.
        let render = |light_samples, branches| {
            let channels = Channels { variance: true, ..Channels::BEAUTY };
            let settings = Settings { spp: 64, light_samples, branches, channels, light_paths: false, ..Settings::default() };
            let frame = render(&scene, &settings, &|_, _| (), &AtomicBool::new(false)).unwrap();
            let sum = |image: &renderflow_frame::image::Rgb| image.pixels.iter().flatten().map(|v| f64::from(*v)).sum::<f64>();
            let variance = frame.variance.as_ref().unwrap();
            let mut sorted: Vec<f64> = variance.pixels.iter().flatten().map(|v| f64::from(*v)).collect();
            sorted.sort_by(f64::total_cmp);
            sorted.truncate(sorted.len() * 9 / 10);
            (sum(frame.raw.as_ref().unwrap()), sum(variance), sorted.into_iter().sum::<f64>())
        };
        let (mean, variance, usual) = render(Some(1), 2);
        for (light_samples, branches) in [(Some(4), 2), (Some(3), 1), (Some(8), 4), (None, 2)] {
            let (other, others, less) = render(light_samples, branches);
            let error = (variance + others).sqrt();
            assert!((other - mean).abs() < 4.0 * error, "{light_samples:?}, {branches}: {mean} and {other}, error {error}");
            assert!(branches != 2 || light_samples.is_none() || less < usual, "{light_samples:?}: {less}, {usual}");
        }
        for light_samples in [Some(0), Some(65)] {
            let settings = Settings { light_samples, ..Settings::default() };
            assert!(crate::render(&scene, &settings, &|_, _| (), &AtomicBool::new(false)).is_err());
        }
    }

    /// A lamp overhead makes half-shadows of 25 balls, an almost even sky makes none.
    #[test]
    fn half_shadows_get_more_light_samples_than_an_even_sky() {
        let at = |x, y, z| Affine3A::from_translation(glam::Vec3::new(x, y, z));
        let chosen = |lamp: f32| {
            let mut parts = vec![Part::new(Shape::Plane { size: 20.0 }, diffuse([0.1; 3]), at(0.0, 0.0, 0.0))];
            parts.extend((0..25).map(|k| {
                let (x, z) = ((k % 5) as f32 * 0.5 - 1.0, (k / 5) as f32 * 0.5 - 1.0);
                Part::new(Shape::Sphere { radius: 0.15 }, diffuse([0.1; 3]), at(x, 0.3, z))
            }));
            let sky = environment(128, 64, |d| [if d.y > 0.8 { lamp } else { 1.0 }; 3]);
            let scene = compile(parts, sky, camera([0.0, 2.0, 3.0], [0.0, 0.2, 0.0], 40.0, 48, 32)).unwrap();
            let settings = Settings { spp: 64, light_paths: false, ..Settings::default() };
            light_samples(&scene, &settings, &Visible::new(&scene, &settings), None)
        };
        let (even, lamp) = (chosen(1.05), chosen(40.0));
        assert!(lamp >= 4 * even, "{even} under the sky, {lamp} under the lamp");
    }

    /// Pictures of one or two samples are as bright as those of many, however many light samples each has.
    #[test]
    fn few_samples_are_as_bright_as_many() {
        let ground = Part::new(Shape::Plane { size: 20.0 }, diffuse([0.5; 3]), Affine3A::IDENTITY);
        let scene = compile(vec![ground], sunny(), camera([0.0, 1.5, 4.0], [0.0, 0.0, 0.0], 45.0, 48, 32)).unwrap();
        let mean = |spp, light_samples| {
            let settings =
                Settings { spp, light_samples: Some(light_samples), channels: Channels::BEAUTY, ..Settings::default() };
            let frame = render(&scene, &settings, &|_, _| (), &AtomicBool::new(false)).unwrap();
            let raw = frame.raw.unwrap();
            raw.pixels.iter().flatten().map(|v| f64::from(*v)).sum::<f64>() / raw.pixels.len() as f64
        };
        let many = mean(64, 1);
        for (spp, light_samples) in [(1, 1), (1, 8), (1, 16), (2, 4), (2, 8), (3, 4), (4, 2)] {
            let few = mean(spp, light_samples);
            assert!((few - many).abs() < 0.1 * many, "{spp} with {light_samples}: {few}, {many} with many");
        }
    }

    #[test]
    fn variances_of_a_pixel_are_told_apart() {
        let probe = |light: [f32; 2], path: [f32; 2]| Probe {
            light: light.map(Vec3A::splat),
            path: path.map(Vec3A::splat),
            light_rays: 2,
            path_rays: 6,
        };
        // Light samples differ by 2 everywhere, paths not at all, camera rays not at all.
        let pixel = Pixel::of(&[probe([1.0, 3.0], [2.0; 2]), probe([3.0, 1.0], [2.0; 2])]).unwrap();
        let scale = 3.0 / (16.0 + 0.01);
        let near = |a: f64, b: f64| (a - b * scale).abs() < 1e-5;
        assert!(near(pixel.light, 2.0) && pixel.path == 0.0 && near(pixel.camera, -1.0));
        assert_eq!((pixel.light_rays, pixel.path_rays), (1.0, 3.0));
        // Only camera rays differ: by 4, so that their variance is 8.
        let pixel = Pixel::of(&[probe([1.0; 2], [1.0; 2]), probe([3.0; 2], [3.0; 2])]).unwrap();
        assert!(near(pixel.camera, 8.0) && pixel.light == 0.0 && pixel.path == 0.0);
        assert!(Pixel::of(&[]).is_none());
    }
}
