//! Training of the fusion network, on sequences that are rendered during training.

use super::monitor::Monitor;
use super::reference::References;
use super::{Bars, Train, smallest};
use crate::dataset::Dataset;
use crate::dataset::learning::{Indexed, Kept, Planned, Recipe, Recorded};
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

/// The options of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct Options {
    pub(super) training: Config,
    pub(super) recipe: Recipe,
    /// Most sequences that the run is validated on, one frame each.
    pub(super) validation: u32,
}

impl Default for Options {
    fn default() -> Self {
        Self { training: Config::default(), recipe: Recipe::default(), validation: 8 }
    }
}

impl Options {
    /// Side of the largest crop, pixels.
    fn crop(&self) -> usize {
        self.training.crops.iter().map(|crop| crop.size).max().unwrap_or(0)
    }

    /// The recipe of the frames that a run is validated on.
    fn validation_recipe(&self) -> Recipe {
        Recipe {
            truth_spp: self.recipe.truth_spp.max(VALIDATION_SPP),
            frames: 1,
            samples: Some(VALIDATION_SAMPLES),
            fast: 0.0,
            bare: 0.0,
            skip: 0,
            count: None,
            ..self.recipe.clone()
        }
    }
}

/// Where the configuration has the crops.
const CROPS: &str = "training/crops";
/// Least samples per pixel of the truth in validation.
const VALIDATION_SPP: u32 = 128;
/// Samples per pixel of each part in validation. Each neighbour has as many as the first part.
const VALIDATION_SAMPLES: [u32; PARTS] = [4, 1, 2, 8];

impl Train {
    /// Refuses options outside their ranges, and flags of the other network.
    pub(super) fn check_fusion(&self, options: &Options) -> Result<()> {
        for (flag, given) in [("--vae", self.vae.is_some()), ("--cache-mib", self.cache_mib.is_some())] {
            ensure!(!given, "{flag} is an option of the paper's network: add --preset, or --config with its configuration");
        }
        options.training.validate()?;
        let recipe = &options.recipe;
        for (name, share) in [("fast", recipe.fast), ("bare", recipe.bare)] {
            ensure!((0.0..=1.0).contains(&share), "recipe.{name}: {share} is outside 0..=1");
        }
        Ok(())
    }

    pub(super) fn fusion(&self, options: &Options, allowed: &[PathBuf], cancel: &Cancel) -> Result<()> {
        let done = match &self.plan {
            Some(plan) => self.learn_from_plan(options, plan, cancel),
            None => self.learn_from_dataset(options, self.data()?, allowed, cancel),
        };
        // A render that was cancelled may report any error.
        done.map_err(|error| if cancel.is_set() { Interrupted.into() } else { error })
    }

    fn learn_from_plan(&self, options: &Options, plan: &Path, cancel: &Cancel) -> Result<()> {
        let plan = Plan::read(plan)?;
        let counts = plan.sequences;
        ensure!(counts.train > 0, "the plan has no training sequences");
        self.check_crop(plan.resolution.map(|side| side as usize), options.crop(), CROPS).context("the plan")?;
        let training = Planned::new(&plan, [0, counts.train], options.recipe.clone(), cancel);
        if self.is_done(&options.training, Some(&training.identity()))? {
            return Ok(());
        }
        let bars = Bars::new(options.training.first);
        let tested = Planned::new(&plan, [counts.train, counts.val], options.validation_recipe(), cancel);
        if !tested.denoises() {
            bars.note("OIDN is not found: the network learns from noisy truth");
        }
        let count = counts.val.min(options.validation);
        let validation = self.kept(&tested, &|tested| validation(&bars, count, tested, cancel))?;
        self.kept(&training, &|training| self.learn_beside(options, training, &validation, &bars, cancel))
    }

    fn learn_from_dataset(&self, options: &Options, data: &Path, allowed: &[PathBuf], cancel: &Cancel) -> Result<()> {
        let (dataset, notes) = Dataset::open_to_learn(data)?;
        let bars = Bars::new(options.training.first);
        notes.iter().for_each(|note| bars.note(note));
        for sequence in &dataset.sequences {
            self.check_crop(smallest(sequence), options.crop(), CROPS).with_context(|| sequence.folder.display().to_string())?;
        }
        let training = Recorded::new(&dataset, allowed, options.recipe.clone(), cancel)?;
        if self.is_done(&options.training, Some(&training.identity()))? {
            return Ok(());
        }
        let beside = std::path::absolute(data).ok().and_then(|data| Some(data.parent()?.join(Split::Val.name())));
        let held_out = match beside.filter(|folder| folder.is_dir() && !same(folder, data)) {
            Some(folder) => Some(Dataset::open_to_learn(&folder)?.0),
            None => {
                bars.note("there is no split val beside the data: the run is not validated");
                None
            }
        };
        let mut records = Vec::new();
        if let Some(held_out) = &held_out {
            let tested = Recorded::new(held_out, allowed, options.validation_recipe(), cancel)?;
            let count = options.validation.min(held_out.sequences.len() as u32);
            records = self.kept(&tested, &|tested| validation(&bars, count, tested, cancel))?;
        }
        self.kept(&training, &|training| self.learn_beside(options, training, &records, &bars, cancel))
    }

    /// Calls `with` with a source, or with the folder that keeps its sequences if there is one.
    fn kept<T>(&self, source: &dyn Indexed, with: &dyn Fn(&dyn Source) -> Result<T>) -> Result<T> {
        match &self.keep {
            Some(folder) => with(&Kept::new(source, folder)?),
            None => with(source),
        }
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
        let monitor = Monitor::new(&options.training.run.output, validation, &references);
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
        for (what, psnr) in [("inputs of the network", &references.inputs), ("OIDN on the same samples", &references.oidn)] {
            if !psnr.is_empty() {
                bars.note(&format!("validation, {what}: {} dB", listed(psnr)));
            }
        }
        bars.finish(&training::run(&options.training, source, start.as_ref(), validation, &tell, cancel)?)
    }
}

/// The PSNR of each kind of input, in one line.
fn listed(psnr: &BTreeMap<String, f32>) -> String {
    psnr.iter().map(|(name, psnr)| format!("{name} {psnr:.2}")).collect::<Vec<_>>().join(", ")
}

/// One frame of each of the first `count` sequences.
fn validation(bars: &Bars, count: u32, source: &dyn Source, cancel: &Cancel) -> Result<Vec<Record<f16>>> {
    let mut validation = Vec::new();
    for i in 0..count {
        bars.loading.message(format!("validation, sequence {} of {count}", i + 1));
        // The last record of a sequence has all inputs.
        validation.extend(source.make(i.into())?.pop());
        ensure!(!cancel.is_set(), Interrupted);
    }
    Ok(validation)
}

/// Whether two paths lead to one folder.
fn same(a: &Path, b: &Path) -> bool {
    matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
}
