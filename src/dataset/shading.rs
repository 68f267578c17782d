//! Deferred shading of the frames of a sequence, with keyframes carried over it, for networks that begin with it.

use super::keyframes;
use super::sequence::Sequence;
use anyhow::{Context, Result, anyhow};
use renderflow_frame::Frame;
use renderflow_frame::image::Rgb;
use renderflow_frame::reach::Reach;
use renderflow_frame::warp::Keyframe;
use renderflow_renderer::deferred::{self, Lighting, Options, ShadowTiles};
use renderflow_renderer::{Channels, RenderScene, Settings, render_gbuffer};
use renderflow_scenes::description::Scene;
use renderflow_scenes::load;
use std::path::PathBuf;
use std::sync::Arc;

/// The channels of samples that the network reads besides their guides: what they are made of.
pub const TRACED: Channels = Channels { variance: true, paths: true, ..Channels::BEAUTY };
/// The channels of a G-buffer that shading and the networks read.
pub const BUFFERS: Channels = Channels { motion: false, variance: false, ..Channels::ALL };
/// Fewest samples on average that are spread by detail, of a frame by itself, whose camera rays make the G-buffer that a network
/// reads with them (docs/measurements/renderer-notes.md, detail).
pub const OWN_BUFFER: u32 = 8;

/// The scene of a sequence, ready to be shaded.
pub struct Shading<'a> {
    sequence: &'a Sequence,
    scene: RenderScene,
    /// Of the scene's description.
    hash: String,
    /// Of the files that it names.
    files: String,
    lighting: Lighting,
    /// The shadow tiles of the frames so far.
    tiles: ShadowTiles,
    /// Stored indices of the keyframes, ascending.
    keys: Vec<usize>,
    /// The keyframes around the last frame, at most two.
    near: Vec<(usize, Keyframe)>,
}

impl<'a> Shading<'a> {
    /// Loads the scene beside a sequence. It may name files in its own folder and in the folders `allowed`. The stored frames
    /// `keys` are carried to all others.
    ///
    /// # Errors
    /// When the scene is missing, cannot be loaded or cannot be rendered.
    pub fn new(sequence: &'a Sequence, allowed: &[PathBuf], keys: &[usize]) -> Result<Self> {
        let file = sequence.folder.join("scene.json");
        let scene = Scene::read(&file).context("the network begins with deferred shading, which needs the scene")?;
        let loaded = load::load(&scene, &Reach::of(&file).allow(allowed)).with_context(|| file.display().to_string())?;
        let lighting = Lighting::new(Arc::clone(sequence.light()?), deferred::LIGHTS);
        let (scene, tiles) = (RenderScene::compile(&loaded)?, ShadowTiles::default());
        let mut keys = keys.to_vec();
        keys.sort_unstable();
        Ok(Self { sequence, scene, hash: loaded.hash, files: loaded.files, lighting, tiles, keys, near: Vec::new() })
    }

    /// Stored frame `index` of the sequence, which holds `stored`, as scene-linear radiance.
    ///
    /// # Errors
    /// When the stored frame is of another scene, when the frame cannot be rendered, and when a keyframe cannot be read.
    pub fn picture(&mut self, index: usize, stored: &Frame) -> Result<Rgb> {
        self.approach(index)?;
        let (frame, shaded) = self.shade(index, stored)?;
        Ok(if self.near.is_empty() { shaded } else { keyframes::warp(self.sequence, &self.near, index, &frame, &shaded) })
    }

    /// Prepares the keyframe at or before frame `index` and the one after it, and forgets the others.
    fn approach(&mut self, index: usize) -> Result<()> {
        let next = self.keys.partition_point(|&key| key <= index);
        let wanted: Vec<usize> = self.keys[next.saturating_sub(1)..].iter().take(next.min(1) + 1).copied().collect();
        let mut near = std::mem::take(&mut self.near);
        near.retain(|(key, _)| wanted.contains(key));
        let missing: Vec<usize> = wanted.into_iter().filter(|key| near.iter().all(|(there, _)| there != key)).collect();
        let sequence = self.sequence;
        near.extend(keyframes::prepare(sequence, &missing, |key, frame| Ok(Some(self.shade(key, frame)?.1)))?);
        self.near = near;
        Ok(())
    }

    /// The G-buffer of a frame, and its picture without keyframes.
    fn shade(&mut self, index: usize, stored: &Frame) -> Result<(Frame, Rgb)> {
        let number = self.sequence.numbers[index];
        stored.info.check_scene(&self.hash, &self.files).map_err(|reason| anyhow!("frame {number} {reason}"))?;
        self.scene.set_frame(number);
        let frame = render_gbuffer(&self.scene, &Settings { channels: BUFFERS, ..Settings::default() })?;
        let shadows = self.tiles.maps(&self.scene, &self.lighting, &frame);
        let picture = deferred::picture(&frame, &self.lighting, &shadows, &Options::default());
        Ok((frame, picture))
    }
}
