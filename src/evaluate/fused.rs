//! The network that reads samples, on one sequence: what it is handed of a frame, and the seconds that this takes.

use super::keyframes;
use super::renderer::timed;
use super::traced::{Buffer, Carried, Traced};
use crate::dataset::SequenceFolder;
use anyhow::{Context, Result};
use renderflow_frame::ibl;
use renderflow_frame::image::Rgb;
use renderflow_frame::warp::Keyframe;
use renderflow_model::fusion::batch::BEFORE;
use renderflow_model::fusion::fill::{Samples, background};
use renderflow_model::fusion::record::{NEIGHBOURS, Selection};
use renderflow_model::fusion::{Fusion, Record};
use renderflow_renderer::deferred::Deferred;
use renderflow_renderer::denoise::Denoiser;

/// What lasts for a sequence.
pub struct Fused<'a> {
    folder: &'a SequenceFolder,
    network: &'a Fusion,
    /// Keyframes by index among the stored frames.
    keys: Vec<(usize, Keyframe)>,
}

impl<'a> Fused<'a> {
    /// Without keyframes.
    pub fn new(folder: &'a SequenceFolder, network: &'a Fusion) -> Self {
        Self { folder, network, keys: Vec::new() }
    }

    /// Reads the keyframes; `shaded` gives the deferred picture of one, where there is one.
    pub fn prepare_keyframes(&mut self, shaded: impl Fn(usize) -> Option<Rgb>) -> Result<()> {
        self.keys = keyframes::prepare(self.folder, |index, _| Ok(shaded(index)))?;
        Ok(())
    }

    /// From the terms of deferred shading, with or without keyframes, and the seconds beside theirs.
    pub fn shaded(&self, buffer: Buffer, deferred: &Deferred, keyframes: bool) -> Result<(Rgb, f64)> {
        if let Some(truth) = self.truth(buffer.index, keyframes) {
            return Ok((truth, 0.0));
        }
        let exposure = self.folder.light.exposure();
        timed(|| {
            let mut record = Record::of(buffer.frame, &deferred.surfaces, exposure);
            record.add_deferred(&deferred.terms, exposure);
            if keyframes {
                self.carry(&mut record, buffer, Some(&deferred.image));
            }
            self.draw(&record)
        })
    }

    /// From samples of the frame and of its neighbours, with or without keyframes and what `denoiser` makes of the samples, and
    /// the seconds beside those of the samples.
    pub fn traced(
        &self,
        buffer: Buffer,
        own: &Traced,
        others: &[(usize, Carried)],
        keyframes: bool,
        denoiser: Option<&mut Denoiser>,
    ) -> Result<(Rgb, f64)> {
        if let Some(truth) = self.truth(buffer.index, keyframes) {
            return Ok((truth, 0.0));
        }
        let (folder, index) = (self.folder, buffer.index);
        let (environment, exposure) = (&folder.light.environment, folder.light.exposure());
        timed(|| {
            let shading = ibl::shade(buffer.frame, &folder.light);
            let mut record = Record::of(buffer.frame, &shading.surfaces, exposure);
            record.add_environment(&shading, exposure);
            let behind = background(folder.camera(index), &own.alpha, environment);
            record.add_part(0, &samples(own, &behind)?, exposure);
            let (mut before, mut after) = (0, BEFORE);
            for (there, carried) in others {
                let (place, limit) = if *there < index { (&mut before, BEFORE) } else { (&mut after, NEIGHBOURS) };
                if *place < limit {
                    let traced = carried.samples;
                    let behind = background(folder.camera(*there), &traced.alpha, environment);
                    record.add_neighbour(*place, &samples(traced, &behind)?, &carried.source, exposure);
                    *place += 1;
                }
            }
            if keyframes {
                self.carry(&mut record, buffer, None);
            }
            if let Some(denoiser) = denoiser {
                let [color, albedo, normal] = record.noisy(&Selection::all(&record), exposure);
                record.add_denoised(0, &denoiser.denoise(&color, Some(&albedo), Some(&normal))?, exposure);
            }
            self.draw(&record)
        })
    }

    /// The truth of a frame that is a keyframe.
    fn truth(&self, index: usize, keyframes: bool) -> Option<Rgb> {
        let found = self.keys.iter().find(|(key, _)| keyframes && *key == index);
        found.map(|(_, key)| key.truth.clone())
    }

    fn carry(&self, record: &mut Record<f32>, buffer: Buffer, shaded: Option<&Rgb>) {
        let before = self.keys.iter().rfind(|(key, _)| *key < buffer.index);
        let after = self.keys.iter().find(|(key, _)| *key > buffer.index);
        for (k, found) in [before, after].into_iter().enumerate() {
            if let Some((index, key)) = found {
                let seen = keyframes::seen_from(self.folder, buffer.index, *index, key);
                record.add_key(k, &seen, buffer.frame, shaded, self.folder.light.exposure());
            }
        }
    }

    fn draw(&self, record: &Record<f32>) -> Result<Rgb> {
        let exposure = self.folder.light.exposure();
        let pixels = self.network.render(record)?.into_iter().map(|rgb| rgb.map(|v| v / exposure)).collect();
        Ok(Rgb { width: record.width, height: record.height, pixels })
    }
}

/// Samples as the network takes them; `background` is the environment behind their frame.
fn samples<'a>(traced: &'a Traced, background: &'a Rgb) -> Result<Samples<'a>> {
    let [albedo, _] = traced.guides.as_ref().context("samples without guides")?;
    Ok(Samples { raw: &traced.raw, alpha: &traced.alpha, albedo, background, spp: traced.spp })
}
