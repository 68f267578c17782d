//! Training of the network that reads samples, on sequences made beside the steps.

use super::monitor::Monitor;
use super::reference::References;
use super::{Bars, Train};
use crate::dataset::Dataset;
use crate::dataset::learning::{Planned, Recipe, Recorded};
use crate::dataset::plan::Plan;
use crate::util::cancel::{Cancel, Interrupted};
use anyhow::{Context, Result, ensure};
use half::f16;
use renderflow_model::fusion::record::PARTS;
use renderflow_model::fusion::training::{self, Config, Source};
use renderflow_model::fusion::{Fusion, Record};
use renderflow_model::train::runner::Progress;
use renderflow_scenes::procedural::Split;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The options of a run as JSON.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Options {
    training: Config,
    recipe: Recipe,
}

impl Options {
    /// Refuses frames of which no crop can be taken, before anything is rendered.
    fn fits(&self, [width, height]: [usize; 2]) -> Result<()> {
        let crop = self.training.crops.iter().map(|crop| crop.size).max().unwrap_or(0);
        ensure!(
            width.min(height) >= crop,
            "frames of {width} x {height} pixels are smaller than the crop of {crop} (--config FILE sets crops)"
        );
        Ok(())
    }

    /// How the frames are made that a run is validated on.
    fn validation(&self) -> Recipe {
        Recipe {
            truth_spp: self.recipe.truth_spp.max(VALIDATION_SPP),
            frames: 1,
            samples: Some(VALIDATION_SAMPLES),
            fast: 0.0,
            ..self.recipe.clone()
        }
    }
}

/// Samples a pixel of the truth of sequences that a run is validated on, at least.
const VALIDATION_SPP: u32 = 128;
/// Samples a pixel of each part of their frames; of each neighbour as many as of the first.
const VALIDATION_SAMPLES: [u32; PARTS] = [4, 1, 2, 8];
/// Most sequences that a run is validated on.
const VALIDATION_SEQUENCES: u32 = 8;

impl Train {
    pub(super) fn fusion(&self, allowed: &[PathBuf], cancel: &Cancel) -> Result<()> {
        // Whatever a render that was stopped says, it was stopped.
        self.learn(allowed, cancel).map_err(|error| if cancel.is_set() { Interrupted.into() } else { error })
    }

    fn learn(&self, allowed: &[PathBuf], cancel: &Cancel) -> Result<()> {
        for (flag, given) in [("--vae", self.vae.is_some()), ("--cache-mib", self.cache_mib.is_some())] {
            ensure!(!given, "{flag} is of the paper's network: name its --preset or a configuration of it");
        }
        let options = self.fusion_options()?;
        if self.print_config {
            println!("{}", serde_json::to_string_pretty(&options)?);
            return Ok(());
        }
        match &self.plan {
            Some(plan) => self.learn_from_plan(&options, plan, cancel),
            None => self.learn_from_dataset(&options, self.data()?, allowed, cancel),
        }
    }

    fn learn_from_plan(&self, options: &Options, plan: &Path, cancel: &Cancel) -> Result<()> {
        let plan = Plan::read(plan)?;
        let counts = plan.sequences;
        ensure!(counts.train > 0, "the plan has no sequences to learn from");
        options.fits(plan.resolution.map(|side| side as usize)).context("the plan")?;
        let bars = Bars::new(options.training.first);
        let tested = Planned::new(&plan, [counts.train, counts.val], options.validation(), cancel);
        if !tested.denoises() {
            bars.note("this build has no denoiser: the truth that is learnt from is noisy");
        }
        let validation = validation(&bars, counts.val, &|i| tested.records(i), cancel)?;
        let learnt = Planned::new(&plan, [0, counts.train], options.recipe.clone(), cancel);
        self.learn_beside(options, &learnt, &validation, &bars, cancel)
    }

    fn learn_from_dataset(&self, options: &Options, data: &Path, allowed: &[PathBuf], cancel: &Cancel) -> Result<()> {
        let (dataset, notes) = Dataset::open_to_learn(data)?;
        let bars = Bars::new(options.training.first);
        notes.iter().for_each(|note| bars.note(note));
        for sequence in &dataset.sequences {
            let camera = sequence.transforms.cameras.iter().min_by_key(|camera| camera.width.min(camera.height));
            let size = camera.map_or([0; 2], |camera| [camera.width, camera.height]);
            options.fits(size).with_context(|| sequence.folder.display().to_string())?;
        }
        let beside = std::path::absolute(data).ok().and_then(|data| Some(data.parent()?.join(Split::Val.name())));
        let held_out = match beside.filter(|folder| folder.is_dir() && !same(folder, data)) {
            Some(folder) => Some(Dataset::open_to_learn(&folder)?.0),
            None => {
                bars.note("there is no split val beside the data: nothing is validated");
                None
            }
        };
        let mut records = Vec::new();
        if let Some(held_out) = &held_out {
            let tested = Recorded::new(held_out, allowed, options.validation(), cancel)?;
            records = validation(&bars, held_out.sequences.len() as u32, &|i| tested.records(i), cancel)?;
        }
        let learnt = Recorded::new(&dataset, allowed, options.recipe.clone(), cancel)?;
        self.learn_beside(options, &learnt, &records, &bars, cancel)
    }

    fn learn_beside(
        &self,
        options: &Options,
        source: &dyn Source,
        validation: &[Record<f16>],
        bars: &Bars,
        cancel: &Cancel,
    ) -> Result<()> {
        let start = self.from.as_deref().map(Fusion::load).transpose()?;
        let references = References::measure(&options.training.network, validation)?;
        let monitor = Monitor::new(&options.training.output, validation, &references);
        let shown = |done: Result<()>| done.unwrap_or_else(|error| bars.note(&format!("{error:#}")));
        let tell = |progress: &Progress| match progress {
            Progress::Loading { done, total } => bars.loading(*done, *total),
            Progress::Note(note) => bars.note(note),
            Progress::Validated(validated) => {
                bars.note(&format!("validation at step {}: {} dB", validated.step, listed(&validated.psnr)));
                shown(monitor.validated(validated));
            }
            Progress::Step(record) => {
                let rate = record.items_per_second;
                bars.step(record.share, format!("step {} loss {:.5}, {rate:.1} crops/s", record.step, record.loss));
                shown(monitor.line(record));
            }
        };
        for (what, psnr) in [("what the network is handed", &references.handed), ("OIDN on the same samples", &references.oidn)] {
            if !psnr.is_empty() {
                bars.note(&format!("validation, {what}: {} dB", listed(psnr)));
            }
        }
        bars.finish(&training::run(&options.training, source, start.as_ref(), validation, &tell, cancel)?)
    }

    fn fusion_options(&self) -> Result<Options> {
        let mut options: Options = match &self.config {
            Some(path) => renderflow_frame::file::read_json(path)?,
            None => Options::default(),
        };
        let training = &mut options.training;
        training.output = self.out.clone();
        training.steps = self.steps.unwrap_or(training.steps);
        training.minutes = self.minutes.or(training.minutes);
        training.seed = self.seed.unwrap_or(training.seed);
        training.validate()?;
        let fast = options.recipe.fast;
        ensure!((0.0..=1.0).contains(&fast), "recipe.fast: {fast} is outside 0..=1");
        Ok(options)
    }
}

/// PSNR by tier in one line.
fn listed(psnr: &BTreeMap<String, f32>) -> String {
    psnr.iter().map(|(name, psnr)| format!("{name} {psnr:.2}")).collect::<Vec<_>>().join(", ")
}

/// One frame of each of the first of `count` sequences.
fn validation(
    bars: &Bars,
    count: u32,
    records: &dyn Fn(u64) -> Result<Vec<Record<f32>>>,
    cancel: &Cancel,
) -> Result<Vec<Record<f16>>> {
    let count = count.min(VALIDATION_SEQUENCES);
    let mut validation = Vec::new();
    for i in 0..count {
        bars.loading.message(format!("validation, sequence {} of {count}", i + 1));
        // The last frame of a sequence has everything.
        validation.extend(records(i.into())?.pop().map(|record| record.to_half()));
        ensure!(!cancel.is_set(), Interrupted);
    }
    Ok(validation)
}

/// Whether two paths lead to one folder.
fn same(a: &Path, b: &Path) -> bool {
    matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
}
