//! Training of the fusion network.

use super::monitor::{FRAMES, Monitor};
use super::reference::References;
use super::sequences::Learns;
use super::{Session, Train};
use crate::dataset::learning::Recipe;
use crate::util::device::DeviceArgs;
use crate::util::picture;
use anyhow::{Result, ensure};
use half::f16;
use renderflow_frame::image::Rgb;
use renderflow_model::device::NetworkDevice;
use renderflow_model::fusion::batch::Tier;
use renderflow_model::fusion::loss::display;
use renderflow_model::fusion::record::{PARTS, at};
use renderflow_model::fusion::training::{self, Config, Source, variants};
use renderflow_model::fusion::{Fusion, Record};
use renderflow_model::lpips::Lpips;
use renderflow_model::train::runner::RunContext;
use renderflow_model::train::sequences::Crop;
use std::path::Path;

/// Least samples per pixel of the truth in validation, which is compared before it is denoised.
const VALIDATION_SPP: u32 = 512;
/// The same of its keyframes, which are denoised.
const VALIDATION_KEY_SPP: u32 = 128;
/// Samples per pixel of each part in validation. Each neighbour has as many as the first part.
const VALIDATION_SAMPLES: [u32; PARTS] = [4, 1, 2, 8];
/// The kinds of input that the sheets of pictures show.
const SHEETS: [&str; 4] = ["deferred", "rays 1", "denoised 4", "denoised+around+keys 4"];

impl Learns for Config {
    fn recipe() -> Recipe {
        Recipe::default()
    }

    fn validation_recipe(&self, recipe: &Recipe) -> Recipe {
        let truth_spp = recipe.truth_spp.max(VALIDATION_SPP);
        let reads = |which: fn(&Tier) -> bool| self.tiers().is_ok_and(|tiers| tiers.iter().any(which));
        Recipe {
            truth_spp,
            frames: 1,
            samples: Some(VALIDATION_SAMPLES),
            fast: 0.0,
            // Samples are rendered only where a tier that is trained reads them.
            bare: if reads(|tier| tier.groups.samples) { 0.0 } else { 1.0 },
            keyed: if reads(|tier| tier.groups.keys) { 1.0 } else { 0.0 },
            single: 0.0,
            bare_spp: truth_spp,
            key_spp: recipe.key_spp.max(VALIDATION_KEY_SPP),
            small: 0.0,
            relit: 0,
            skip: 0,
            count: None,
            ..recipe.clone()
        }
    }

    fn crops(&self) -> &[Crop] {
        &self.crops
    }

    fn first(&self) -> u64 {
        self.first
    }

    fn check(&self, recipe: &Recipe) -> Result<()> {
        self.validate()?;
        let reads = self.tiers()?.iter().any(|tier| tier.groups.deferred);
        ensure!(recipe.deferred || !reads, "recipe.deferred: a tier that is trained reads deferred shading");
        // Weights that are missing are reported before anything is rendered.
        if self.loss.lpips > 0.0 {
            Lpips::for_loss(self.lpips_weights.as_deref(), NetworkDevice::cpu().device())?;
        }
        Ok(())
    }

    fn learn(&self, train: &Train, source: &dyn Source, validation: &[Record<f16>], session: &Session) -> Result<()> {
        let Session { team, bars, folder, cancel } = *session;
        let start = train.start()?;
        let tiers = self.tiers()?;
        let references = References::measure(&self.network, validation, &tiers)?;
        let sheets = |weights: &Path| sheets(weights, validation, &tiers);
        let monitor = Monitor::new(&self.run.output, &references.oidn, &sheets);
        for (what, psnr) in [("inputs of the network", &references.inputs), ("OIDN on the same samples", &references.oidn)] {
            if !psnr.is_empty() {
                bars.note(&format!("validation, {what}: {} dB", super::monitor::listed(psnr)));
            }
        }
        let tell = |progress: &_| monitor.tell(bars, progress);
        let context = RunContext { device: &DeviceArgs::from(train.device).get()?, progress: &tell, cancel, team };
        folder.begin()?;
        bars.finish(&training::run(self, source, start.as_ref(), validation, context)?)
    }
}

/// The sheets of the network in the file `weights`, by name.
fn sheets(weights: &Path, validation: &[Record<f16>], tiers: &[Tier]) -> Result<Vec<(String, Rgb)>> {
    let network = Fusion::load(weights)?;
    let untrained = Fusion::untrained(&network.header().fusion, 0)?;
    let mut sheets = Vec::new();
    for name in SHEETS {
        if let Some(sheet) = sheet(&network, &untrained, validation, tiers, name)? {
            sheets.push((name.replace([' ', '+'], "-"), sheet));
        }
    }
    Ok(sheets)
}

/// A sheet with one row for each frame that has the inputs `name`: the best input, the picture of the network, the truth, and the
/// errors of the first two.
fn sheet(network: &Fusion, untrained: &Fusion, frames: &[Record<f16>], tiers: &[Tier], name: &str) -> Result<Option<Rgb>> {
    let mut rows = Vec::new();
    for record in frames {
        let Some((_, selection)) = variants(record, tiers).into_iter().find(|(variant, _)| variant == name) else { continue };
        let picture = |pixels: Vec<[f32; 3]>| Rgb {
            width: record.width,
            height: record.height,
            pixels: pixels.into_iter().map(|rgb| rgb.map(display)).collect(),
        };
        let [input, drawn] = [untrained, network].map(|network| network.draw(record, &selection).map(picture));
        let truth = record.pixels.chunks_exact(at::COUNT).map(|stored| [0, 1, 2].map(|c| stored[at::TRUTH + c].to_f32()));
        let (input, drawn, truth) = (input?, drawn?, picture(truth.collect()));
        let errors = [&input, &drawn].map(|made| picture::error_map(made, &truth));
        let [before, after] = errors;
        rows.push([input, drawn, truth, before, after]);
        if rows.len() == FRAMES {
            break;
        }
    }
    let Some([first, ..]) = rows.first() else { return Ok(None) };
    let (width, height) = (first.width, first.height);
    Ok(Some(Rgb::from_fn(5 * width, rows.len() * height, |x, y| *rows[y / height][x / width].at(x % width, y % height))))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What no trained tier reads is not rendered for validation. The truth is the same.
    #[test]
    fn validation_renders_what_is_trained() {
        let recipe = |tiers: &[&str]| {
            let tiers = tiers.iter().map(|&name| name.to_owned()).collect();
            Config { tiers, ..Config::default() }.validation_recipe(&Recipe { key_spp: 16, ..Recipe::default() })
        };
        let shares = |recipe: &Recipe| [recipe.bare, recipe.keyed];
        assert_eq!(shares(&recipe(&[])), [0.0, 1.0]);
        assert_eq!(shares(&recipe(&["rays"])), [0.0, 0.0]);
        assert_eq!(shares(&recipe(&["deferred"])), [1.0, 0.0]);
        let keyed = recipe(&["deferred", "deferred+keys"]);
        assert_eq!(shares(&keyed), [1.0, 1.0]);
        assert_eq!([keyed.truth_spp, keyed.bare_spp, keyed.key_spp], [VALIDATION_SPP, VALIDATION_SPP, VALIDATION_KEY_SPP]);
    }
}
