//! Training of the network that reads all that is given, on sequences made beside the steps.

use super::monitor::Monitor;
use super::reference::References;
use super::{Bars, Train};
use crate::dataset::plan::Plan;
use crate::learning::{Planned, Recipe};
use crate::truth::Interrupted;
use anyhow::{Result, ensure};
use renderflow_model::fusion::training::{self, Config, Progress};
use renderflow_model::fusion::{Fusion, Record};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

/// The options of a run as JSON.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Options {
    training: Config,
    recipe: Recipe,
}

/// Samples a pixel of the truth of sequences that a run is validated on.
const VALIDATION_SPP: u32 = 64;
/// Samples a pixel of each part of their frames, and of each neighbour.
const VALIDATION_SAMPLES: [u32; 2] = [1, 2];
/// Most sequences that a run is validated on.
const VALIDATION_SEQUENCES: u32 = 8;

impl Train {
    pub(super) fn fusion(&self, plan: &Path, cancel: &AtomicBool) -> Result<()> {
        // Whatever a render that was stopped says, it was stopped.
        self.learn_from(plan, cancel).map_err(|error| if cancel.load(Ordering::Relaxed) { Interrupted.into() } else { error })
    }

    fn learn_from(&self, plan: &Path, cancel: &AtomicBool) -> Result<()> {
        let options = self.fusion_options()?;
        if self.print_config {
            println!("{}", serde_json::to_string_pretty(&options)?);
            return Ok(());
        }
        let plan = Plan::read(plan)?;
        let counts = plan.sequences;
        ensure!(counts.train > 0, "the plan has no sequences to learn from");
        let bars = Bars::new(options.training.first);
        let start = self.from.as_deref().map(Fusion::load).transpose()?;
        let tested = Planned::new(
            &plan,
            [counts.train, counts.val],
            Recipe { truth_spp: VALIDATION_SPP, frames: 1, samples: Some(VALIDATION_SAMPLES), ..options.recipe.clone() },
            cancel,
        );
        if !tested.denoises() {
            bars.note("this build has no denoiser: the truth that is learnt from is noisy");
        }
        let mut validation: Vec<Record<half::f16>> = Vec::new();
        for i in 0..counts.val.min(VALIDATION_SEQUENCES) {
            bars.loading.message(format!("validation, sequence {} of {}", i + 1, counts.val.min(VALIDATION_SEQUENCES)));
            // The last frame of a sequence has everything.
            validation.extend(tested.records(i.into())?.pop().map(|record| record.to_half()));
            ensure!(!cancel.load(Ordering::Relaxed), Interrupted);
        }
        let references = References::measure(&options.training.network, &validation)?;
        let learnt = Planned::new(&plan, [0, counts.train], options.recipe.clone(), cancel);
        let monitor = Monitor::new(&options.training.output, &validation, &references);
        let shown = |done: Result<()>| done.unwrap_or_else(|error| bars.note(&format!("{error:#}")));
        let tell = |progress: &Progress| match progress {
            Progress::Loading { done, total } => bars.loading(*done as usize, *total as usize),
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
        let run = || training::run(&options.training, &learnt, start.as_ref(), &validation, &tell, cancel);
        bars.finish(&run()?)
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
        Ok(options)
    }
}

/// PSNR by tier in one line.
fn listed(psnr: &BTreeMap<String, f32>) -> String {
    psnr.iter().map(|(name, psnr)| format!("{name} {psnr:.2}")).collect::<Vec<_>>().join(", ")
}
