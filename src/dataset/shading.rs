//! Deferred shading of the frames of a sequence, with keyframes carried over it, for networks that begin with it.

use super::keyframes;
use super::sequence::Sequence;
use anyhow::{Context, Result, ensure};
use renderflow_frame::Frame;
use renderflow_frame::image::Rgb;
use renderflow_frame::reach::Reach;
use renderflow_frame::warp::Keyframe;
use renderflow_renderer::deferred::{self, Lighting, Options, ShadowTiles};
use renderflow_renderer::{RenderScene, Settings, render_gbuffer};
use renderflow_scenes::description::Scene;
use renderflow_scenes::load;
use std::path::PathBuf;
use std::sync::Arc;

/// The scene of a sequence, ready to be shaded.
pub struct Shading<'a> {
    sequence: &'a Sequence,
    scene: RenderScene,
    /// Of the scene's description.
    hash: String,
    lighting: Lighting,
    /// The shadow tiles of the frames so far.
    tiles: ShadowTiles,
    /// What is carried, by stored index.
    keys: Vec<(usize, Keyframe)>,
}

impl<'a> Shading<'a> {
    /// Loads the scene beside a sequence. It may name files in its own folder and in the folders `allowed`. The stored frames
    /// `keys` are carried to all others.
    ///
    /// # Errors
    /// When the scene is missing, cannot be loaded or cannot be rendered, and when a keyframe cannot be read.
    pub fn new(sequence: &'a Sequence, allowed: &[PathBuf], keys: &[usize]) -> Result<Self> {
        let file = sequence.folder.join("scene.json");
        let scene = Scene::read(&file).context("the network begins with deferred shading, which needs the scene")?;
        let loaded = load::load(&scene, &Reach::of(&file).allow(allowed)).with_context(|| file.display().to_string())?;
        let lighting = Lighting::new(Arc::clone(sequence.light()?), deferred::LIGHTS);
        let (scene, tiles) = (RenderScene::compile(&loaded)?, ShadowTiles::default());
        let mut shading = Self { sequence, scene, hash: loaded.hash, lighting, tiles, keys: Vec::new() };
        shading.keys = keyframes::prepare(sequence, keys, |index, frame| Ok(Some(shading.shade(index, frame)?.1)))?;
        Ok(shading)
    }

    /// Stored frame `index` of the sequence, which holds `stored`, as scene-linear radiance.
    ///
    /// # Errors
    /// When the stored frame is of another scene, and when the frame cannot be rendered.
    pub fn picture(&mut self, index: usize, stored: &Frame) -> Result<Rgb> {
        let (frame, shaded) = self.shade(index, stored)?;
        Ok(if self.keys.is_empty() { shaded } else { keyframes::warp(self.sequence, &self.keys, index, &frame, &shaded) })
    }

    /// The G-buffer of a frame, and its picture without keyframes.
    fn shade(&mut self, index: usize, stored: &Frame) -> Result<(Frame, Rgb)> {
        let number = self.sequence.numbers[index];
        ensure!(stored.info.scene_hash == self.hash, "frame {number} is of another scene than scene.json");
        self.scene.set_frame(number);
        let frame = render_gbuffer(&self.scene, &Settings::default())?;
        let shadows = self.tiles.maps(&self.scene, &self.lighting, &frame);
        let picture = deferred::picture(&frame, &self.lighting, &shadows, &Options::default());
        Ok((frame, picture))
    }
}
