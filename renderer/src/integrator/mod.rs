//! From a compiled scene to a [`Frame`]: the path integrator for the beauty, the first-hit integrator for the G-buffer, and the
//! split-sum baseline on top of the latter.

mod gbuffer;
pub mod ibl;
mod path;

use crate::accel::Scratch;
use crate::camera::{Filter, Projector};
use crate::compile::RenderScene;
use crate::error::{Error, Result};
use crate::features::{Features, with_features};
use crate::sampler::PixelSampler;
use crate::schedule::{self, Progress, Tile};
use crate::stats::Stats;
use gbuffer::{Centre, Guides};
use renderflow_frame::{Frame, FrameInfo, Image};
use serde::{Deserialize, Serialize};
use std::sync::atomic::AtomicBool;

/// What to render and how well.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Settings {
    /// Samples a pixel of the beauty, 1..=2^24; powers of two use the sampler best.
    pub spp: u32,
    /// Surfaces a path may scatter at, 1..=1024; 1 is direct light only.
    pub max_bounces: u32,
    /// Camera rays a pixel for coverage and guides when no beauty is rendered, 1..=2^16.
    pub guide_samples: u32,
    /// Whether to fill [`Frame::irradiance`].
    pub irradiance: bool,
    /// Pixel filter of beauty, coverage and guides.
    pub filter: Filter,
}

impl Default for Settings {
    fn default() -> Self {
        Self { spp: 256, max_bounces: 6, guide_samples: 16, irradiance: false, filter: Filter::Box }
    }
}

impl Settings {
    fn check(&self) -> Result<()> {
        let range = |name, value: u32, limit: u32, range| {
            if (1..=limit).contains(&value) { Ok(()) } else { Err(Error::Setting { name, value: value.into(), range }) }
        };
        range("spp", self.spp, 1 << 24, "1..=16777216")?;
        range("max_bounces", self.max_bounces, 1024, "1..=1024")?;
        range("guide_samples", self.guide_samples, 1 << 16, "1..=65536")
    }
}

/// Path-traces the current frame: beauty with variance, coverage, guides, and the G-buffer at pixel centres.
///
/// The picture is a function of the scene (its seed included), the frame and the settings; threads and tiles do not enter.
/// A sample that is not finite contributes 0; [`render_with_stats`] tells how many there were.
///
/// # Errors
/// When a setting is out of range, or `cancel` was set.
pub fn render(scene: &RenderScene, settings: &Settings, progress: Progress<'_>, cancel: &AtomicBool) -> Result<Frame> {
    render_with_stats(scene, settings, progress, cancel).map(|(frame, _)| frame)
}

/// As [`render`], with the counts of what was done.
///
/// # Errors
/// As [`render`].
pub fn render_with_stats(
    scene: &RenderScene,
    settings: &Settings,
    progress: Progress<'_>,
    cancel: &AtomicBool,
) -> Result<(Frame, Stats)> {
    settings.check()?;
    with_features!(scene.features(), run(scene, settings, true, progress, cancel))
}

/// Renders only what camera rays see: G-buffer, coverage and guides from `settings.guide_samples` rays a pixel. No light is traced.
///
/// # Errors
/// When a setting is out of range.
pub fn render_gbuffer(scene: &RenderScene, settings: &Settings) -> Result<Frame> {
    settings.check()?;
    let never = AtomicBool::new(false);
    with_features!(scene.features(), run(scene, settings, false, &|_, _| (), &never)).map(|(frame, _)| frame)
}

/// All that one pixel contributes to a frame.
struct Pixel {
    centre: Centre,
    guides: Guides,
    radiance: [f32; 3],
    variance: [f32; 3],
}

fn run<F: Features>(
    scene: &RenderScene,
    settings: &Settings,
    beauty: bool,
    progress: Progress<'_>,
    cancel: &AtomicBool,
) -> Result<(Frame, Stats)> {
    let camera = *scene.camera();
    let size = (camera.width, camera.height);
    let views = gbuffer::Views::new(scene);
    let projector = Projector::new(&camera);
    let visible = gbuffer::Visible::new(scene, settings.filter);
    let rays = if beauty { settings.spp } else { settings.guide_samples };
    let tables = settings.irradiance.then(|| scene.ibl_tables());

    let work = |tile: Tile| {
        let mut scratch = Scratch::default();
        let mut stats = Stats::default();
        let pixels: Vec<Pixel> = tile
            .pixels()
            .map(|(x, y)| {
                let sampler = PixelSampler::new(scene.seed, scene.frame() as u64, (y * size.0 + x) as u64);
                let seen = visible.at(x, y);
                let centre =
                    if seen { gbuffer::centre::<F>(scene, &views, tables, x, y, &mut scratch, &mut stats) } else { Centre::MISS };
                let mut pixel = Pixel { centre, guides: Guides::default(), radiance: [0.0; 3], variance: [0.0; 3] };
                if beauty {
                    let mut film = crate::film::PixelStatistics::default();
                    for index in 0..settings.spp {
                        let sample = path::sample::<F>(scene, settings, &sampler, (x, y), index, seen, &mut scratch, &mut stats);
                        film.push(sample.radiance);
                        pixel.guides.add(sample.first);
                    }
                    stats.samples += u64::from(settings.spp);
                    pixel.radiance = film.mean();
                    pixel.variance = film.variance_of_mean();
                } else if seen {
                    for index in 0..settings.guide_samples {
                        let (ray, _) = path::camera_ray(scene, settings, &sampler, (x, y), index);
                        pixel.guides.add(gbuffer::first_hit::<F>(scene, &ray, &mut scratch, &mut stats));
                    }
                }
                pixel.guides.finish(rays, &projector);
                pixel
            })
            .collect();
        (pixels, stats)
    };

    let mut frame = empty_frame(scene, settings, beauty);
    let mut stats = Stats::default();
    schedule::for_tiles(size, u64::from(rays), progress, cancel, work, |tile, (pixels, tile_stats)| {
        stats += tile_stats;
        for ((x, y), pixel) in tile.pixels().zip(pixels) {
            store(&mut frame, y * size.0 + x, pixel);
        }
    })?;
    frame.beauty.clone_from(&frame.raw);
    Ok((frame, stats))
}

/// A frame with the channels that will be filled.
fn empty_frame(scene: &RenderScene, settings: &Settings, beauty: bool) -> Frame {
    let (width, height) = (scene.camera().width, scene.camera().height);
    let rgb = || Image::filled(width, height, [0.0f32; 3]);
    let flow = || Image::filled(width, height, [0.0f32; 2]);
    Frame {
        width,
        height,
        beauty: None,
        alpha: Image::filled(width, height, 0.0),
        raw: beauty.then(rgb),
        variance: beauty.then(rgb),
        light: Default::default(),
        albedo: rgb(),
        normal: rgb(),
        depth: Image::filled(width, height, f32::INFINITY),
        material: rgb(),
        irradiance: settings.irradiance.then(rgb),
        guide_albedo: Some(rgb()),
        guide_normal: Some(rgb()),
        motion: Some(flow()),
        motion_prev: Some(flow()),
        object_id: Image::filled(width, height, 0),
        material_id: Image::filled(width, height, 0),
        info: FrameInfo {
            camera: Some(*scene.camera()),
            spp: if beauty { settings.spp } else { 0 },
            seed: scene.seed,
            scene_hash: scene.hash.clone(),
            exposure: scene.exposure(),
            denoiser: None,
        },
    }
}

fn store(frame: &mut Frame, at: usize, pixel: Pixel) {
    let Pixel { centre, guides, radiance, variance } = pixel;
    frame.alpha.pixels[at] = guides.coverage;
    frame.albedo.pixels[at] = centre.albedo;
    frame.normal.pixels[at] = centre.normal;
    frame.depth.pixels[at] = centre.depth;
    frame.material.pixels[at] = centre.material;
    frame.object_id.pixels[at] = centre.object_id;
    frame.material_id.pixels[at] = centre.material_id;
    let optional = [
        (&mut frame.raw, radiance),
        (&mut frame.variance, variance),
        (&mut frame.irradiance, centre.irradiance),
        (&mut frame.guide_albedo, guides.albedo.to_array()),
        (&mut frame.guide_normal, guides.normal.to_array()),
    ];
    for (image, value) in optional {
        if let Some(image) = image {
            image.pixels[at] = value;
        }
    }
    for (image, value) in [(&mut frame.motion, centre.motion), (&mut frame.motion_prev, centre.motion_prev)] {
        if let Some(image) = image {
            image.pixels[at] = value;
        }
    }
}
