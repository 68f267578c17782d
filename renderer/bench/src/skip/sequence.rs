//! Rows of what is kept from frame to frame.

use super::{Bench, picture};
use crate::orbit::{moving, orbit};
use anyhow::Result;
use renderflow_frame::image::Rgb;
use renderflow_renderer::denoise::{DenoiseError, Denoiser};
use renderflow_renderer::{RenderScene, Settings, Sharing, render};
use renderflow_scenes::LoadedScene;

/// Frames of a row.
const FRAMES: usize = 4;

/// Measures them.
pub(super) fn measure(bench: &mut Bench<'_>) -> Result<()> {
    let (turned, moved) = ("trees and tables of an orbit", "trees fitted to what moves");
    if bench.wanted(turned) || bench.wanted(moved) {
        let million = bench.scene("million")?;
        kept(bench, turned, "million", &orbit(&million, FRAMES), "frames of one sample, against compiling each")?;
        fitted(bench, moved, "million", &moving(&million, FRAMES))?;
    }
    shared(bench)?;
    denoiser(bench)
}

/// Settings of frames whose rendering does not hide what comes before.
fn quick(bench: &Bench<'_>) -> Settings {
    Settings { spp: 1, ..bench.settings() }
}

fn kept(bench: &mut Bench<'_>, name: &str, scene: &str, loaded: &LoadedScene, note: &'static str) -> Result<()> {
    let (settings, cancel) = (quick(bench), bench.cancel);
    let mut compiled = RenderScene::compile(loaded)?;
    let last = |scene: &mut RenderScene, frame| {
        scene.set_frame(frame);
        picture(scene, &settings, cancel)
    };
    bench.row(
        name,
        scene,
        (true, note),
        || {
            let mut result = super::no_picture();
            for frame in 0..FRAMES {
                result = last(&mut compiled, frame)?;
            }
            Ok(result)
        },
        || {
            let mut result = super::no_picture();
            for frame in 0..FRAMES {
                result = last(&mut RenderScene::compile(loaded)?, frame)?;
            }
            Ok(result)
        },
    )
}

fn fitted(bench: &mut Bench<'_>, name: &str, scene: &str, loaded: &LoadedScene) -> Result<()> {
    let (settings, cancel) = (quick(bench), bench.cancel);
    let [mut fitted, mut anew] = [RenderScene::compile(loaded)?, RenderScene::compile(loaded)?];
    let walk = |scene: &mut RenderScene, step: fn(&mut RenderScene, usize)| {
        let mut result = super::no_picture();
        for frame in 1..FRAMES {
            step(scene, frame);
            result = picture(scene, &settings, cancel)?;
        }
        Ok(result)
    };
    let note = (true, "frames of one sample, against building");
    bench.row(name, scene, note, || walk(&mut fitted, RenderScene::set_frame), || walk(&mut anew, RenderScene::set_frame_anew))
}

/// Many instances of one dense mesh: a tree for it, against one tree of all.
fn shared(bench: &mut Bench<'_>) -> Result<()> {
    let name = "one tree for a mesh used often";
    if !bench.wanted(name) {
        return Ok(());
    }
    let mut loaded = bench.scene("soft_sun")?;
    let Some(body) = loaded.instances.iter().find(|i| i.name == "dense_displaced").cloned() else { return Ok(()) };
    for i in 0..8u8 {
        let mut copy = body.clone();
        copy.name = format!("copy {i}");
        for transform in &mut copy.transforms {
            transform.translation += glam::Vec3A::new(1.2 * f32::from(i % 4) - 2.0, 0.0, -1.6 * f32::from(1 + i / 4));
        }
        loaded.instances.push(copy);
    }
    let (settings, cancel) = (quick(bench), bench.cancel);
    let way = |sharing| picture(&RenderScene::compile_with(&loaded, sharing)?, &settings, cancel);
    bench.row(
        name,
        "9 bodies",
        (false, "compiling and one sample, by rounding"),
        || way(Sharing::Automatic),
        || way(Sharing::Never),
    )
}

fn denoiser(bench: &mut Bench<'_>) -> Result<()> {
    let name = "denoiser kept for the next frame";
    if !bench.wanted(name) {
        return Ok(());
    }
    let mut kept = match Denoiser::new() {
        Ok(denoiser) => denoiser,
        Err(error @ DenoiseError::NotFound(_)) => {
            println!("{name}: skipped: {error}");
            return Ok(());
        }
        Err(error) => return Err(error.into()),
    };
    let frame = render(&RenderScene::compile(&bench.scene("soft_sun")?)?, &quick(bench), &|_, _| (), bench.cancel)?;
    let denoise = |denoiser: &mut Denoiser| -> Result<Rgb> {
        let Some(raw) = &frame.raw else { return Ok(super::no_picture()) };
        Ok(denoiser.denoise(raw, frame.guide_albedo.as_ref(), frame.guide_normal.as_ref())?)
    };
    bench.row(name, "soft_sun", (true, "denoising alone"), || denoise(&mut kept), || denoise(&mut Denoiser::new()?))
}
