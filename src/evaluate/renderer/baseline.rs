//! The deferred renderer on one sequence: its lights, its shadow maps, its pictures with parts left out, and keyframes carried
//! over them.

use crate::dataset::{Sequence, keyframes};
use crate::evaluate::method::Part;
use crate::util::clock::timed;
use anyhow::{Context, Result};
use renderflow_frame::Frame;
use renderflow_frame::image::Rgb;
use renderflow_frame::warp::Keyframe;
use renderflow_renderer::RenderScene;
use renderflow_renderer::deferred::{self, Deferred, Lighting, ShadowMode, ShadowTiles, Shadows};
use std::sync::{Arc, Mutex, PoisonError};

/// The deferred renderer on one sequence.
pub struct DeferredBaseline<'a> {
    sequence: &'a Sequence,
    /// The lights that were taken out of the environment, and the rest of it.
    lighting: Lighting,
    /// The whole environment without lights taken out, if a method asks for it.
    whole: Option<Lighting>,
    keyframes: Vec<(usize, Keyframe)>,
    /// The shadow tiles of the frames so far, with `lighting` and with `whole`; and again with `lighting` for networks that see
    /// frames before their turn, so that nobody else's seconds change.
    tiles: [Mutex<ShadowTiles>; 3],
}

/// Shadow maps of a frame, and the seconds they took.
#[derive(Default)]
pub struct Maps {
    shadows: Shadows,
    seconds: f64,
}

impl<'a> DeferredBaseline<'a> {
    /// Takes lights out of the environment and prefilters the rest; if `whole`, also prepares the environment as a whole.
    pub fn new(sequence: &'a Sequence, whole: bool) -> Result<Self> {
        let light = sequence.light()?;
        Ok(Self {
            sequence,
            lighting: Lighting::new(Arc::clone(light), deferred::LIGHTS),
            whole: whole.then(|| Lighting::new(Arc::clone(light), 0)),
            keyframes: Vec::new(),
            tiles: Default::default(),
        })
    }

    /// Forgets the shadow tiles of earlier frames.
    pub fn forget(&mut self) {
        self.tiles = Default::default();
    }

    /// Draws the keyframes, so that they can be carried. `scene` stays at the last one.
    pub fn prepare_keyframes(&mut self, scene: &mut RenderScene) -> Result<()> {
        self.keyframes = keyframes::prepare(self.sequence, &self.sequence.transforms.keyframes, |index, frame| {
            scene.set_frame(self.sequence.numbers[index]);
            let maps = self.maps(scene, frame)?;
            Ok(Some(self.picture(scene, frame, &maps, None)?.0))
        })?;
        // Every frame pays for its own shadow maps.
        self.forget();
        Ok(())
    }

    /// The shadow maps of the frame with the G-buffer `frame`, at which `scene` stands.
    pub fn maps(&self, scene: &RenderScene, frame: &Frame) -> Result<Maps> {
        self.maps_of(scene, (&self.lighting, &self.tiles[0]), frame)
    }

    /// The picture of a frame before its turn, and its seconds.
    pub fn picture_ahead(&self, scene: &RenderScene, frame: &Frame) -> Result<(Rgb, f64)> {
        let maps = self.maps_of(scene, (&self.lighting, &self.tiles[2]), frame)?;
        self.picture(scene, frame, &maps, None)
    }

    fn maps_of(&self, scene: &RenderScene, (lighting, tiles): (&Lighting, &Mutex<ShadowTiles>), frame: &Frame) -> Result<Maps> {
        let mut tiles = tiles.lock().unwrap_or_else(PoisonError::into_inner);
        let (shadows, seconds) = timed(|| Ok(tiles.maps(scene, lighting, frame)))?;
        Ok(Maps { shadows, seconds })
    }

    /// The picture of a frame without one of its parts, and its seconds, which include the shadow maps.
    pub fn picture(&self, scene: &RenderScene, frame: &Frame, maps: &Maps, without: Option<Part>) -> Result<(Rgb, f64)> {
        let mut options = deferred::Options::default();
        let (none, others);
        let (mut lighting, mut maps) = (&self.lighting, maps);
        match without {
            None => {}
            Some(Part::Lights) => {
                lighting = self.whole.as_ref().context("the environment with its lights")?;
                others = self.maps_of(scene, (lighting, &self.tiles[1]), frame)?;
                maps = &others;
            }
            Some(part @ (Part::Shadows | Part::Maps)) => {
                options.shadows = if part == Part::Maps { ShadowMode::ScreenSpace } else { ShadowMode::None };
                options.sky = false;
                // The scene's own lights keep their shadows, which are not maps.
                none = Maps { shadows: Shadows { lamps: maps.shadows.lamps.clone(), ..Shadows::default() }, seconds: 0.0 };
                maps = &none;
            }
            // The seconds of the sky's maps still count, since these are made together with the maps of the lights.
            Some(Part::Sky) => options.sky = false,
            Some(Part::Occlusion) => options.occlusion = false,
            Some(Part::Reflections) => options.reflections = false,
            Some(Part::Indirect) => options.indirect = false,
        }
        let (picture, shading) = timed(|| Ok(deferred::picture(frame, lighting, &maps.shadows, &options)))?;
        Ok((picture, maps.seconds + shading))
    }

    /// The picture with its parts, and its seconds.
    pub fn parts(&self, frame: &Frame, maps: &Maps) -> Result<(Deferred, f64)> {
        let shade = || Ok(deferred::shade(frame, &self.lighting, &maps.shadows, &deferred::Options::default()));
        let (parts, shading) = timed(shade)?;
        Ok((parts, maps.seconds + shading))
    }

    /// The keyframes carried to stored frame `index`, with the deferred picture in the holes; and the seconds without the
    /// G-buffer's.
    pub fn warped(&self, scene: &RenderScene, frame: &Frame, index: usize, maps: &Maps) -> Result<(Rgb, f64)> {
        self.carried(frame, index, &self.picture(scene, frame, maps, None)?)
    }

    /// As [`Self::warped`], over the deferred picture `current` and its seconds.
    pub fn carried(&self, frame: &Frame, index: usize, (current, seconds): &(Rgb, f64)) -> Result<(Rgb, f64)> {
        let (picture, carrying) = timed(|| Ok(keyframes::warp(self.sequence, &self.keyframes, index, frame, current)))?;
        Ok((picture, seconds + carrying))
    }
}
