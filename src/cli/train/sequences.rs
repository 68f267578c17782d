//! Training on sequences that are rendered during training: what the networks that learn from them share.

use super::{Bars, OutputFolder, Session, Train, smallest};
use crate::dataset::Dataset;
use crate::dataset::learning::{Indexed, Kept, Planned, Recipe, Recorded};
use crate::dataset::plan::{Allowed, Plan};
use crate::util::cancel::{Cancel, Interrupted};
use anyhow::{Context, Result, ensure};
use half::f16;
use renderflow_model::fusion::Record;
use renderflow_model::fusion::training::Source;
use renderflow_model::train::sequences::Crop;
use renderflow_model::train::{Team, TrainingConfig};
use renderflow_renderer::Settings;
use renderflow_scenes::procedural::Split;
use serde::de::{DeserializeOwned, Error as _};
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::{Map, Value};
use std::path::{Path, PathBuf};

/// The configuration of a network that learns from rendered sequences.
pub(super) trait Learns: TrainingConfig + Default {
    /// The recipe of its sequences.
    fn recipe() -> Recipe;
    /// The recipe of the frames that a run with `recipe` is validated on.
    fn validation_recipe(&self, recipe: &Recipe) -> Recipe;
    /// Kinds of crop.
    fn crops(&self) -> &[Crop];
    /// Number of sequences that are made before the first step.
    fn first(&self) -> u64;
    /// Checks every option. The network must be able to learn from sequences of `recipe`.
    fn check(&self, recipe: &Recipe) -> Result<()>;
    /// Trains the network on `source`, and validates it on `validation`.
    fn learn(&self, train: &Train, source: &dyn Source, validation: &[Record<f16>], session: &Session) -> Result<()>;
}

/// The options of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, bound = "C: Learns + Serialize + DeserializeOwned")]
pub(super) struct Options<C> {
    pub(super) training: C,
    #[serde(deserialize_with = "recipe_of::<C, _>")]
    pub(super) recipe: Recipe,
    /// Most sequences that the run is validated on, one frame each.
    pub(super) validation: u32,
}

impl<C: Learns> Default for Options<C> {
    fn default() -> Self {
        Self { training: C::default(), recipe: C::recipe(), validation: 8 }
    }
}

/// Reads a recipe. Options that it lacks are those of the network's own recipe.
fn recipe_of<'de, C: Learns, D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Recipe, D::Error> {
    let given = Map::deserialize(deserializer)?;
    let Value::Object(mut all) = serde_json::to_value(C::recipe()).map_err(D::Error::custom)? else {
        return Err(D::Error::custom("not an object"));
    };
    all.extend(given);
    serde_json::from_value(Value::Object(all)).map_err(D::Error::custom)
}

impl<C: Learns> Options<C> {
    /// Side of the largest crop, pixels.
    fn crop(&self) -> usize {
        self.training.crops().iter().map(|crop| crop.size).max().unwrap_or(0)
    }
}

/// Where the configuration has the crops.
const CROPS: &str = "training/crops";

impl Train {
    /// Refuses options outside their ranges, and flags of the paper's network.
    pub(super) fn check_sequences<C: Learns>(&self, options: &Options<C>) -> Result<()> {
        for (flag, given) in [("--vae", self.vae.is_some()), ("--cache-mib", self.cache_mib.is_some())] {
            ensure!(!given, "{flag} is an option of the paper's network: add --preset, or --config with its configuration");
        }
        let recipe = &options.recipe;
        options.training.check(recipe)?;
        let shares = [
            ("fast", recipe.fast),
            ("bare", recipe.bare),
            ("keyed", recipe.keyed),
            ("single", recipe.single),
            ("adaptive", recipe.adaptive),
            ("small", recipe.small),
        ];
        for (name, share) in shares {
            ensure!((0.0..=1.0).contains(&share), "recipe.{name}: {share} is outside 0..=1");
        }
        let counts = [("truth_spp", recipe.truth_spp), ("bare_spp", recipe.bare_spp), ("key_spp", recipe.key_spp)];
        let parts = recipe.samples.iter().flatten().map(|spp| ("samples", *spp));
        for (name, spp) in counts.into_iter().chain(parts) {
            ensure!(Settings::SPP.contains(&spp), "recipe.{name}: {spp} is outside {:?}", Settings::SPP);
        }
        let powers = recipe.samples.iter().flatten().all(|spp| spp.is_power_of_two());
        ensure!(powers || recipe.adaptive <= 0.0, "recipe.samples: with recipe.adaptive, all must be powers of two");
        let (bounces, range) = (recipe.max_bounces, Settings::MAX_BOUNCES);
        ensure!(range.contains(&bounces), "recipe.max_bounces: {bounces} is outside {range:?}");
        let frames = recipe.frames > 0 || recipe.bare >= 1.0;
        ensure!(frames, "recipe.frames: 0 leaves out all frames with samples, so recipe.bare must be 1");
        ensure!(recipe.relit <= Recipe::MOST_LIGHTS, "recipe.relit: {} is outside 0..={}", recipe.relit, Recipe::MOST_LIGHTS);
        Ok(())
    }

    pub(super) fn sequences<C: Learns>(
        &self,
        options: &Options<C>,
        team: &Team,
        folder: &OutputFolder,
        allowed: &[PathBuf],
        cancel: &Cancel,
    ) -> Result<()> {
        // A file that is missing is told before anything is rendered.
        if let Some(path) = self.from.as_deref().filter(|path| *path != Path::new(super::SHIPPED) && !path.is_dir()) {
            renderflow_frame::file::open(path)?;
        }
        let done = match &self.plan {
            Some(plan) => self.learn_from_plan(options, plan, team, folder, allowed, cancel),
            None => self.learn_from_dataset(options, self.data()?, team, folder, allowed, cancel),
        };
        // A render that was cancelled may report any error of its sequence. What could not be stored must be told.
        let of_data = |error: &anyhow::Error| matches!(error.downcast_ref(), Some(renderflow_model::Error::Data { .. }));
        done.map_err(|error| if cancel.is_set() && of_data(&error) { Interrupted.into() } else { error })
    }

    fn learn_from_plan<C: Learns>(
        &self,
        options: &Options<C>,
        plan: &Path,
        team: &Team,
        folder: &OutputFolder,
        allowed: &[PathBuf],
        cancel: &Cancel,
    ) -> Result<()> {
        let plan = Plan { allowed: Allowed(allowed.to_vec()), ..Plan::read(plan)? };
        let counts = plan.sequences;
        ensure!(counts.train > 0, "the plan has no training sequences");
        // Where not all sequences are small, large crops are taken from the others.
        let part = if options.recipe.small < 1.0 { 1 } else { 2 };
        self.check_crop(plan.resolution.map(|side| side as usize / part), options.crop(), CROPS).context("the plan")?;
        let training = Planned::new(&plan, [0, counts.train], options.recipe.clone(), cancel);
        if self.is_done(&options.training, Some(&training.identity()), team)? {
            return Ok(());
        }
        let bars = self.bars(team, options.training.first());
        if plan.frames < 3 && options.recipe.bare < 1.0 && options.recipe.single < 1.0 {
            bars.note("sequences of fewer than 3 frames have none between keyframes: of these, only those of recipe.single have samples");
        }
        let tested = Planned::new(&plan, [counts.train, counts.val], options.training.validation_recipe(&options.recipe), cancel);
        if !tested.denoises() {
            bars.note("OIDN is not found: the network learns from noisy truth");
        }
        // The process that leads validates.
        let count = if team.leads() { counts.val.min(options.validation) } else { 0 };
        let validation = self.kept(&tested, 1, &|tested| validation(&bars, count, tested, cancel))?;
        let session = Session { team, bars: &bars, folder, cancel };
        self.kept(&training, team.size(), &|training| options.training.learn(self, training, &validation, &session))
    }

    fn learn_from_dataset<C: Learns>(
        &self,
        options: &Options<C>,
        data: &Path,
        team: &Team,
        folder: &OutputFolder,
        allowed: &[PathBuf],
        cancel: &Cancel,
    ) -> Result<()> {
        let (dataset, notes) = Dataset::open_to_learn(data)?;
        let bars = self.bars(team, options.training.first());
        notes.iter().for_each(|note| bars.note(note));
        for sequence in &dataset.sequences {
            self.check_crop(smallest(sequence), options.crop(), CROPS).with_context(|| sequence.folder.display().to_string())?;
        }
        let training = Recorded::new(&dataset, allowed, options.recipe.clone(), cancel)?;
        if self.is_done(&options.training, Some(&training.identity()), team)? {
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
        if let Some(held_out) = held_out.as_ref().filter(|_| team.leads()) {
            let tested = Recorded::new(held_out, allowed, options.training.validation_recipe(&options.recipe), cancel)?;
            let count = options.validation.min(held_out.sequences.len() as u32);
            records = self.kept(&tested, 1, &|tested| validation(&bars, count, tested, cancel))?;
        }
        let session = Session { team, bars: &bars, folder, cancel };
        self.kept(&training, team.size(), &|training| options.training.learn(self, training, &records, &session))
    }

    /// The progress bars of a run that begins with `sequences`.
    fn bars(&self, team: &Team, sequences: u64) -> Bars {
        let bars = Bars::new(team, sequences);
        if team.size() > 1 && self.keep.is_none() {
            bars.note("every process renders all sequences: with --keep and a folder that all see, they share the rendering");
        }
        bars
    }

    /// Calls `with` with a source, or with the folder that keeps its sequences if there is one. So many `processes` ask for the
    /// same sequences.
    fn kept<T>(&self, source: &dyn Indexed, processes: usize, with: &dyn Fn(&dyn Source) -> Result<T>) -> Result<T> {
        match &self.keep {
            Some(folder) => with(&Kept::new(source, folder)?.shared_by(processes)),
            None => with(source),
        }
    }
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
