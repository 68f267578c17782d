//! The network that reads samples on one sequence: fills the network's input for each frame, and measures the seconds.

use super::Buffer;
use super::mixture::mixture;
use crate::dataset::around::{Carried, Traced, offer};
use crate::dataset::{Sequence, keyframes};
use crate::util::clock::timed;
use anyhow::Result;
use renderflow_frame::Frame;
use renderflow_frame::ibl;
use renderflow_frame::image::Rgb;
use renderflow_frame::warp::Keyframe;
use renderflow_model::fusion::fill::background;
use renderflow_model::fusion::record::Selection;
use renderflow_model::fusion::{Fusion, Record};
use renderflow_renderer::deferred::Deferred;
use renderflow_renderer::denoise::Denoiser;

/// The network that reads samples on one sequence.
pub struct Fused<'a> {
    sequence: &'a Sequence,
    network: &'a Fusion,
    /// Keyframes, by stored index, that start with the network's own picture of them.
    drawn: Vec<(usize, Keyframe)>,
    /// The same, that start with the split sum.
    lit: Vec<(usize, Keyframe)>,
}

impl<'a> Fused<'a> {
    /// Starts without keyframes.
    pub fn new(sequence: &'a Sequence, network: &'a Fusion) -> Self {
        Self { sequence, network, drawn: Vec::new(), lit: Vec::new() }
    }

    /// Reads the keyframes and draws them, for [`Self::shaded`]. `shade` gives the terms of one.
    pub fn draw_keyframes(&mut self, mut shade: impl FnMut(usize, &Frame) -> Result<Deferred>) -> Result<()> {
        let draw = |index, frame: &Frame| Ok(Some(self.alone(frame, &shade(index, frame)?)?));
        self.drawn = keyframes::prepare(self.sequence, &self.sequence.transforms.keyframes, draw)?;
        Ok(())
    }

    /// Reads the keyframes and shades them by the split sum, for [`Self::traced`].
    pub fn light_keyframes(&mut self) -> Result<()> {
        let light = self.sequence.light()?;
        let draw = |_, frame: &Frame| Ok(Some(ibl::shade(frame, light).image));
        self.lit = keyframes::prepare(self.sequence, &self.sequence.transforms.keyframes, draw)?;
        Ok(())
    }

    /// The picture from terms of deferred shading, and its seconds without those of the terms; with keyframes carried over it, or
    /// not.
    pub fn shaded(&self, buffer: Buffer, deferred: &Deferred, keyframes: bool) -> Result<(Rgb, f64)> {
        if let Some(truth) = truth(&self.drawn, buffer.index).filter(|_| keyframes) {
            return Ok((truth.clone(), 0.0));
        }
        timed(|| {
            let alone = self.alone(buffer.frame, deferred)?;
            let carried = |start| keyframes::warp(self.sequence, &self.drawn, buffer.index, buffer.frame, start);
            Ok(if keyframes { carried(&alone) } else { alone })
        })
    }

    /// The picture from terms of deferred shading alone.
    fn alone(&self, frame: &Frame, deferred: &Deferred) -> Result<Rgb> {
        let exposure = self.sequence.exposure();
        let mut record = Record::of(frame, &deferred.surfaces, exposure);
        record.add_deferred(&deferred.terms, exposure);
        self.draw(&record)
    }

    /// The picture from samples of the frame and of its neighbours, nearest first and each with its stored index, with or without
    /// keyframes, and with what `denoiser` makes of the samples; and its seconds without those of the samples. The network reads
    /// keyframes that are carried over the split sum, and then its picture is mixed with them.
    pub fn traced(
        &self,
        buffer: Buffer,
        own: &Traced,
        (places, others): (&[usize], &[Carried]),
        keyframes: bool,
        denoiser: Option<&mut Denoiser>,
    ) -> Result<(Rgb, f64)> {
        if let Some(truth) = truth(&self.lit, buffer.index).filter(|_| keyframes) {
            return Ok((truth.clone(), 0.0));
        }
        let (sequence, light, index) = (self.sequence, self.sequence.light()?, buffer.index);
        let (environment, exposure) = (&light.environment, light.exposure());
        timed(|| {
            let shading = ibl::shade(buffer.frame, light);
            let mut record = Record::of(buffer.frame, &shading.surfaces, exposure);
            record.add_environment(&shading, exposure);
            let behind = background(sequence.camera(index), &own.alpha, environment);
            record.add_part(0, &own.samples(&behind)?, exposure);
            let near = places.iter().copied().zip(others);
            offer(&mut record, index, near, |there| *sequence.camera(there), (environment, exposure))?;
            if keyframes {
                self.carry(&mut record, buffer, &shading.image);
            }
            if let Some(denoiser) = denoiser {
                let [color, albedo, normal] = record.noisy(&Selection::all(&record), exposure);
                record.add_denoised(0, &denoiser.denoise(&color, Some(&albedo), Some(&normal))?, exposure);
            }
            let drawn = self.draw(&record)?;
            Ok(if keyframes {
                let carried = keyframes::warp(sequence, &self.lit, index, buffer.frame, &shading.image);
                mixture(&drawn, &carried, own.spp, exposure)
            } else {
                drawn
            })
        })
    }

    /// Adds the keyframes around the frame, carried over its picture by the split sum.
    fn carry(&self, record: &mut Record<f32>, buffer: Buffer, start: &Rgb) {
        let before = self.lit.iter().rfind(|(key, _)| *key < buffer.index);
        let after = self.lit.iter().find(|(key, _)| *key > buffer.index);
        let seen =
            [before, after].map(|found| found.map(|(index, key)| keyframes::seen_from(self.sequence, buffer.index, *index, key)));
        record.add_keys(seen, buffer.frame, start, self.sequence.exposure());
    }

    fn draw(&self, record: &Record<f32>) -> Result<Rgb> {
        let exposure = self.sequence.exposure();
        let pixels = self.network.render(record)?.into_iter().map(|rgb| rgb.map(|v| v / exposure)).collect();
        Ok(Rgb { width: record.width, height: record.height, pixels })
    }
}

/// The truth of the frame with stored index `index`, if it is one of the keyframes `keys`.
fn truth(keys: &[(usize, Keyframe)], index: usize) -> Option<&Rgb> {
    keys.iter().find(|(key, _)| *key == index).map(|(_, key)| &key.truth)
}
