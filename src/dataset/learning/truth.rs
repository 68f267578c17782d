//! The truth of a frame for training: as it was traced, and denoised.

use super::Maker;
use super::relit::Lit;
use anyhow::{Context, Result, ensure};
use renderflow_frame::Frame;
use renderflow_frame::image::Rgb;
use renderflow_renderer::{RenderScene, render};
use renderflow_scenes::seed::Seed;
use std::sync::PoisonError;

/// The truth of a frame.
pub(super) struct Truth {
    /// Under the scene's own light.
    pub shown: Shown,
    /// What was traced, by groups of light; `None` where no other light is asked for.
    pub traced: Option<Frame>,
}

/// The truth of a frame under one light.
#[derive(Clone)]
pub(super) struct Shown {
    /// Denoised where OIDN was found.
    pub picture: Rgb,
    /// The same before it was denoised, if it was.
    pub raw: Option<Rgb>,
}

impl Truth {
    /// This truth, if it has the size of its frame.
    pub fn fitting(self, frame: &Frame) -> Result<Self> {
        let expected = [frame.width, frame.height];
        for picture in std::iter::once(&self.shown.picture).chain(&self.shown.raw) {
            let found = [picture.width, picture.height];
            ensure!(found == expected, "the truth has {found:?} pixels where the scene has {expected:?}");
        }
        Ok(self)
    }
}

impl Maker<'_> {
    /// The truth of the frame at which `scene` stands, in a sequence of `seed`. `key` says whether it is a keyframe.
    pub(super) fn truth(&self, scene: &RenderScene, seed: Seed, key: bool) -> Result<Truth> {
        let kind = self.kind(seed);
        let spp = match kind.samples {
            _ if key && kind.keys => self.recipe.key_spp,
            true => self.recipe.truth_spp,
            false => self.recipe.bare_spp,
        };
        let groups = self.groups(seed);
        let mut traced = render(scene, &self.tracing(spp, false, groups), &|_, _| (), self.cancel)?;
        let raw = traced.raw.take().context("the path tracer made no picture")?;
        let shown = self.denoised(raw, &traced)?;
        Ok(Truth { shown, traced: (groups > 0).then_some(traced) })
    }

    /// The truth under `lit`.
    pub(super) fn truth_under(&self, lit: &Lit, truth: &Truth) -> Result<Shown> {
        let Some(factors) = &lit.factors else { return Ok(truth.shown.clone()) };
        let traced = truth.traced.as_ref().context("the truth was not traced by groups of light")?;
        let own = &truth.shown.picture;
        let mut sum = Rgb { pixels: vec![[0.0; 3]; own.pixels.len()], ..*own };
        for (light, factors) in traced.light.iter().zip(factors) {
            let light = light.as_ref().context("a group of light is missing")?;
            for (sum, light) in sum.pixels.iter_mut().zip(&light.pixels) {
                (0..3).for_each(|c| sum[c] += factors[c] * light[c]);
            }
        }
        self.denoised(sum, traced)
    }

    /// `raw` and what OIDN makes of it with the guides of `traced`, where OIDN is found.
    fn denoised(&self, raw: Rgb, traced: &Frame) -> Result<Shown> {
        let Some([denoiser, _]) = &self.denoisers else { return Ok(Shown { picture: raw, raw: None }) };
        let mut denoiser = denoiser.lock().unwrap_or_else(PoisonError::into_inner);
        let picture = denoiser.denoise(&raw, traced.guide_albedo.as_ref(), traced.guide_normal.as_ref())?;
        Ok(Shown { picture, raw: Some(raw) })
    }
}
