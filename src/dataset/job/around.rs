//! Denoises the frames of a sequence with samples of the frames around them, after all of them are rendered.

use super::clean::Around;
use super::{Cost, OpenSequence, TruthSettings, tracks};
use crate::dataset::around::{Carried, Neighbours, REACH, Traced, surface};
use crate::util::cancel::Cancel;
use crate::util::machine;
use anyhow::{Context, Result};
use renderflow_frame::Frame;
use renderflow_frame::frame_file;
use renderflow_frame::ibl;
use renderflow_frame::tracks::Tracks;
use std::collections::BTreeMap;
use std::time::Instant;

/// Bytes of a pixel of a frame that others use: the picture and its logarithms, coverage, two guides, the surface, and where its
/// samples go with which share.
const HELD: u64 = 128;
/// Bytes of what its samples are made of, where frames store it: three pictures.
const HELD_PATHS: u64 = 36;

/// The frames that are at hand while a sequence is denoised.
#[derive(Default)]
pub struct Window {
    /// Surfaces and samples, by place in the sequence.
    frames: BTreeMap<usize, (Frame, Traced)>,
    /// The movement of the objects.
    tracks: Option<Tracks>,
}

impl OpenSequence<'_> {
    /// Denoises the frame in place `index` of the sequence with samples of the frames around it. All frames of the sequence are
    /// rendered. Does nothing, and returns `None`, where the frame is denoised already.
    ///
    /// # Errors
    /// When stopped ([`Interrupted`](crate::util::cancel::Interrupted)), when a frame cannot be read or denoised, or when the
    /// file cannot be written.
    pub fn denoise(
        &mut self,
        index: usize,
        settings: &TruthSettings,
        window: &mut Window,
        cancel: &Cancel,
    ) -> Result<Option<Cost>> {
        let numbers: Vec<usize> = self.job.numbers(self.loaded.cameras.len()).collect();
        let path = self.path(numbers[index]);
        let mut frame = frame_file::read(&path).with_context(|| path.display().to_string())?;
        let Some(denoiser) = settings.denoiser.as_ref().filter(|_| frame.info.denoiser != settings.denoiser_name()) else {
            return Ok(None);
        };
        let started = Instant::now();
        let others = settings.neighbours.of(REACH, index, numbers.len());
        let exposure = ibl::exposure(&self.loaded.environment);
        window.frames.retain(|there, _| there.abs_diff(index) <= REACH);
        for &there in others.iter().chain([&index]).filter(|there| !window.frames.contains_key(there)).collect::<Vec<_>>() {
            cancel.check()?;
            let path = self.path(numbers[there]);
            let frame = frame_file::read(&path).with_context(|| path.display().to_string())?;
            window.frames.insert(there, (surface(&frame), Traced::of(frame, exposure)?));
        }
        let tracks = window.tracks.get_or_insert_with(|| tracks(&self.loaded, &numbers));
        let (current, own) = &window.frames[&index];
        let carry = |&there: &usize| {
            let (surface, samples) = &window.frames[&there];
            let movement = tracks.between(index, there);
            (there, Carried::new((current, own), (surface, samples), movement, there.abs_diff(index)))
        };
        let others: Vec<(usize, Carried)> = others.iter().map(carry).collect();
        self.compile(settings)?;
        let scene = self.compiled.as_mut().context("the scene is not compiled")?;
        scene.set_frame(numbers[index]);
        let cameras: Vec<_> = numbers.iter().map(|&number| self.loaded.cameras[number]).collect();
        let around = Around { index, own, others: &others, cameras: &cameras };
        frame.beauty = Some(denoiser.clean(scene, &frame, Some(around), &settings.render, cancel)?);
        frame.info.denoiser = settings.denoiser_name();
        let denoise = started.elapsed().as_secs_f64();
        let cost = self.write(numbers[index], &frame)?;
        if let Some(seconds) = &mut self.timing.seconds[numbers[index]] {
            *seconds += denoise;
        }
        self.write_timing()?;
        Ok(Some(Cost { denoise, ..cost }))
    }
}

impl TruthSettings {
    /// Refuses a sequence of `frames` frames of this size if the frames that are denoised together take more memory than is
    /// available.
    ///
    /// # Errors
    /// The message has both numbers.
    pub(super) fn ensure_window(&self, size: [u32; 2], frames: usize) -> Result<()> {
        if !self.denoises_later() {
            return Ok(());
        }
        let most = 1 + (0..frames).map(|index| self.neighbours.of(REACH, index, frames).len()).max().unwrap_or(0);
        let pixels = u64::from(size[0]) * u64::from(size[1]);
        let held = HELD + if self.stores_paths() { HELD_PATHS } else { 0 };
        let needed = pixels.saturating_mul(held * most as u64).saturating_add(self.denoising(pixels)[0]);
        let ways = "a smaller resolution, or no neighbours, takes less";
        machine::ensure_memory(&format!("denoising {most} frames together"), needed, ways)
    }

    /// The same, but frames are denoised with samples of the frames around them, by [`OpenSequence::denoise`] once all frames are
    /// rendered. `frames` is the number of frames. Without a denoiser nothing changes. Frames keep indirect and hidden light
    /// if the denoiser reads them.
    ///
    /// # Errors
    /// When the denoiser is not found.
    pub fn with_neighbours(mut self, neighbours: Neighbours, frames: usize) -> Result<Self> {
        if let Some(denoiser) = &mut self.denoiser {
            self.neighbours = neighbours;
            denoiser.reopen(&self.render, neighbours.fewest(frames))?;
        }
        Ok(self)
    }
}
