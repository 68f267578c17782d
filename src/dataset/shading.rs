//! Deferred shading of the frames of a sequence, for networks that begin with it.

use super::sequence::Sequence;
use anyhow::{Context, Result, ensure};
use renderflow_frame::Frame;
use renderflow_frame::image::Rgb;
use renderflow_frame::reach::Reach;
use renderflow_renderer::deferred::{self, Lighting, Options, ShadowTiles};
use renderflow_renderer::{RenderScene, Settings, render_gbuffer};
use renderflow_scenes::description::Scene;
use renderflow_scenes::load;
use std::path::PathBuf;
use std::sync::Arc;

/// The scene of a sequence, ready to be shaded.
pub struct Shading {
    scene: RenderScene,
    /// Of the scene's description.
    hash: String,
    lighting: Lighting,
    /// The shadow tiles of the frames so far.
    tiles: ShadowTiles,
}

impl Shading {
    /// Loads the scene beside a sequence. It may name files in its own folder and in the folders `allowed`.
    ///
    /// # Errors
    /// When the scene is missing, cannot be loaded or cannot be rendered.
    pub fn new(sequence: &Sequence, allowed: &[PathBuf]) -> Result<Self> {
        let file = sequence.folder.join("scene.json");
        let scene = Scene::read(&file).context("the network begins with deferred shading, which needs the scene")?;
        let loaded = load::load(&scene, &Reach::of(&file).allow(allowed)).with_context(|| file.display().to_string())?;
        let lighting = Lighting::new(Arc::clone(sequence.light()?), deferred::LIGHTS);
        Ok(Self { scene: RenderScene::compile(&loaded)?, hash: loaded.hash, lighting, tiles: ShadowTiles::default() })
    }

    /// Frame `number` of the sequence, which is stored as `stored`, as scene-linear radiance.
    ///
    /// # Errors
    /// When the stored frame is of another scene, and when the frame cannot be rendered.
    pub fn picture(&mut self, number: usize, stored: &Frame) -> Result<Rgb> {
        ensure!(stored.info.scene_hash == self.hash, "frame {number} is of another scene than scene.json");
        self.scene.set_frame(number);
        let frame = render_gbuffer(&self.scene, &Settings::default())?;
        let shadows = self.tiles.maps(&self.scene, &self.lighting, &frame);
        Ok(deferred::picture(&frame, &self.lighting, &shadows, &Options::default()))
    }
}
