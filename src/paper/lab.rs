//! Makes data, trains networks and evaluates them for the tables. Everything is kept in the output folder under a name that
//! follows from its recipe, so that nothing is made twice, and a changed recipe is made again.

use super::Options;
use super::scale::{Data, Run, Scale};
use crate::dataset::shard::Shard;
use crate::dataset::{Dataset, render};
use crate::evaluate::find::{TestSequence, find};
use crate::evaluate::method::Method;
use crate::evaluate::renderer::{self, Drawing};
use crate::evaluate::results::Results;
use crate::evaluate::run;
use crate::metrics::Networks;
use crate::util::cancel::{Cancel, Interrupted};
use crate::util::progress::Progress;
use crate::util::{device, files};
use anyhow::{Context, Result, ensure};
use renderflow_frame::file;
use renderflow_model::data::ClipSource;
use renderflow_model::fusion::Fusion;
use renderflow_model::renderer::Renderer;
use renderflow_model::train::Team;
use renderflow_model::train::runner::RunContext;
use renderflow_model::wan::flow::FlowConfig;
use renderflow_model::wan::pictures::BridgeStart;
use renderflow_model::wan::train::{self, Config};
use renderflow_model::wan::{self, Autoencoder, Vae, VaeConfig};
use renderflow_model::weights::Precision;
use safetensors::SafeTensors;
use serde::{Deserialize, Serialize};
use std::cell::RefCell;
use std::collections::{BTreeSet, HashMap};
use std::path::{Path, PathBuf};

/// The weights in the folder of a training run.
const WEIGHTS: &str = "weights.safetensors";
/// The file that says that a training run is finished.
const DONE: &str = "done.json";

/// Where experiments are made, and with what.
pub struct Lab<'a> {
    /// Their sizes.
    pub scale: &'a Scale,
    /// Folder of everything.
    pub out: &'a Path,
    /// The network that reads samples.
    pub fusion: &'a Fusion,
    /// Weights of an autoencoder for the paper's network; without them it is trained.
    pub autoencoder: Option<&'a Path>,
    /// LPIPS, if its weights are there.
    pub lpips: &'a Networks,
    /// Stops the work.
    pub cancel: &'a Cancel,
    /// BLAKE3 of the weights of the network that reads samples.
    fusion_weights: String,
    /// Data that is known to be there.
    there: RefCell<BTreeSet<Data>>,
    /// Weights that are known to be there.
    trained: RefCell<HashMap<Run, Trained>>,
}

/// A finished training run.
#[derive(Clone, Debug, PartialEq)]
pub struct Trained {
    /// Its folder.
    pub folder: PathBuf,
    /// Optimiser steps.
    pub steps: u64,
    /// Seconds of training.
    pub seconds: f64,
    /// BLAKE3 of the file of the weights.
    hash: String,
}

/// What is kept of a finished run.
#[derive(Serialize, Deserialize)]
struct Done {
    steps: u64,
    seconds: f64,
}

/// What is evaluated.
#[derive(Clone, Debug, Serialize)]
pub struct Ask<'a> {
    /// Names of methods, as in `evaluate`.
    pub methods: &'a [&'a str],
    /// The run whose weights the paper's network has; `None` where no method needs it.
    pub run: Option<Run>,
    /// Euler steps.
    pub steps: u32,
    /// The sequences.
    pub data: Data,
    /// Distance of the keyframes instead of that of the data.
    pub gap: Option<u32>,
    /// Two of so many frames; 1 for all.
    pub every: u32,
}

impl<'a> Lab<'a> {
    /// A lab in the folder `out`.
    ///
    /// # Errors
    /// When the network that reads samples holds a value that no file of weights may hold.
    pub fn new(options: &Options<'a>, out: &'a Path, cancel: &'a Cancel) -> Result<Self> {
        let Options { scale, fusion, autoencoder, lpips, .. } = *options;
        let fusion_weights = blake3::hash(&fusion.encode(Precision::F32)?).to_hex().to_string();
        let (there, trained) = Default::default();
        Ok(Self { scale, out, fusion, autoencoder, lpips, cancel, fusion_weights, there, trained })
    }

    /// Checks the weights that are given.
    ///
    /// # Errors
    /// When they are no autoencoder's, not in a safetensors file, or do not fit the network or the pictures.
    pub fn check(options: &Options) -> Result<()> {
        let Some(file) = options.autoencoder else { return Ok(()) };
        SafeTensors::deserialize(&file::read(file)?).with_context(|| format!("{}: not a safetensors file", file.display()))?;
        let (vae, _) = Vae::open(file, &VaeConfig::wan(), options.fusion.device().device())?;
        let Scale { preset, side, .. } = *options.scale;
        let network = FlowConfig::preset(preset).context("no such preset")?;
        let network = FlowConfig { vae: vae.config().clone(), ..network };
        network.validate().with_context(|| format!("{}: is of another preset than {preset}", file.display()))?;
        let multiple = network.pixel_multiple();
        ensure!(
            (side as usize).is_multiple_of(multiple),
            "{}: needs pictures of a multiple of {multiple} pixels",
            file.display()
        );
        Ok(())
    }

    /// The usual question: methods on the test sequences.
    pub fn ask<'m>(&self, methods: &'m [&'m str]) -> Ask<'m> {
        Ask { methods, run: None, steps: 1, data: Data::Test, gap: None, every: self.scale.every }
    }

    /// Renders `data` if it is not there, and returns its folder.
    pub fn data(&self, data: Data) -> Result<PathBuf> {
        let folder = self.out.join("data").join(data.name());
        if !self.there.borrow().contains(&data) {
            self.cancel.check()?;
            render::run(&self.scale.plan(data)?, &folder, Shard::WHOLE, self.cancel)?;
            self.there.borrow_mut().insert(data);
        }
        Ok(folder)
    }

    /// Trains what `run` stands on, and then `run`, if they are not finished.
    pub fn train(&self, run: Run) -> Result<Trained> {
        if let Some(trained) = self.trained.borrow().get(&run) {
            return Ok(trained.clone());
        }
        self.cancel.check()?;
        if let (Run::Autoencoder, Some(file)) = (run, self.autoencoder) {
            let given = self.given(file)?;
            self.trained.borrow_mut().insert(run, given.clone());
            return Ok(given);
        }
        let autoencoder = if run == Run::Autoencoder { None } else { Some(self.train(Run::Autoencoder)?) };
        let renderer = run.renderer().map(|renderer| self.train(renderer)).transpose()?;
        let mut config = self.scale.config(run)?;
        let (data, count) = self.scale.lesson(run);
        // The names of the folders say what the run stands on; where the folders are does not matter.
        let name = |of: &Option<Trained>| of.as_ref().map(Trained::name).unwrap_or_default().into();
        Run::stand_on(&mut config, name(&autoencoder), name(&renderer));
        let recipe = digest(&(&config, self.scale.plan(data)?, count))?;
        let folder = self.out.join("runs").join(format!("{}-{recipe}", run.name()));
        let file = |of: &Option<Trained>| of.as_ref().map(|run| run.weights()).unwrap_or_default();
        Run::stand_on(&mut config, file(&autoencoder), file(&renderer));
        config.run.output.clone_from(&folder);
        config.latents_folder = autoencoder.as_ref().map(|run| run.folder.join("latents"));
        let done = match file::read_json::<Done>(&folder.join(DONE)) {
            Ok(done) => done,
            Err(error) if error.is_missing() => self.learn(run, &config, data, count)?,
            Err(error) => return Err(error.into()),
        };
        let trained = Trained::new(folder, done)?;
        self.trained.borrow_mut().insert(run, trained.clone());
        Ok(trained)
    }

    /// A copy of the autoencoder in `file`, as if it had been trained here.
    fn given(&self, file: &Path) -> Result<Trained> {
        let bytes = file::read(file)?;
        let hash = blake3::hash(&bytes).to_hex();
        let folder = self.out.join("runs").join(format!("{}-given-{}", Run::Autoencoder.name(), &hash[..10]));
        let weights = folder.join(WEIGHTS);
        if !weights.is_file() {
            std::fs::create_dir_all(&folder)?;
            file::write_atomic(&weights, &bytes)?;
        }
        Trained::new(folder, Done { steps: 0, seconds: 0.0 })
    }

    fn learn(&self, run: Run, config: &Config, data: Data, count: u32) -> Result<Done> {
        let (mut dataset, notes) = Dataset::open_to_learn(&self.data(data)?.join("train"))?;
        dataset.sequences.truncate(count as usize);
        if train::bridge_start(config)? == Some(BridgeStart::Deferred) {
            dataset = dataset.shaded(&[], config.stage.gap());
        }
        let progress = Progress::new(&format!("training {}", run.name()), 1000);
        notes.iter().for_each(|note| progress.print(note));
        let tell = |said: &train::Progress| match said {
            train::Progress::Loading { done, total } => progress.message(format!("reading clip {done} of {total}")),
            train::Progress::Note(note) => progress.print(&format!("note: {note}")),
            train::Progress::Step(record) => {
                progress.set((1000.0 * record.share) as u64);
                progress.message(format!("step {} loss {:.4}", record.step, record.loss));
            }
            train::Progress::Validated(_) => {}
        };
        let source: &dyn ClipSource = &dataset;
        let context = RunContext { device: self.fusion.device(), progress: &tell, cancel: self.cancel, team: &Team::alone() };
        let summary = train::run(config, source, context).with_context(|| format!("training {}", run.name()))?;
        if !summary.finished {
            return Err(Interrupted.into());
        }
        progress.finish();
        let done = Done { steps: summary.steps, seconds: summary.elapsed };
        file::write_json(&config.run.output.join(DONE), &done)?;
        Ok(done)
    }

    /// The renderer of a run.
    pub fn renderer(&self, run: Run) -> Result<Box<dyn Renderer>> {
        let (autoencoder, trained) = (self.train(Run::Autoencoder)?.weights(), self.train(run)?.weights());
        Ok(wan::open(&trained, Autoencoder { file: Some(&autoencoder), tile: None }, self.fusion.device())?)
    }

    /// The sequences of `data`, with keyframes `gap` frames apart if that is given.
    pub fn sequences(&self, data: Data, gap: Option<u32>) -> Result<Vec<TestSequence>> {
        let mut tests = find(&self.data(data)?)?;
        if let Some(gap) = gap.filter(|gap| *gap > 0) {
            tests.iter_mut().for_each(|test| test.sequence.set_keyframes(gap as usize));
        }
        Ok(tests)
    }

    /// The names of a run and its autoencoder, the BLAKE3 of their weights and of those of the network that reads samples, and
    /// the device: what pictures depend on besides the scenes.
    pub fn networks(&self, run: Option<Run>) -> Result<impl Serialize> {
        let runs = run.map_or_else(Vec::new, |run| vec![Run::Autoencoder, run]);
        let named = |run: Run| self.train(run).map(|run| (run.name(), run.hash));
        let runs = runs.into_iter().map(named).collect::<Result<Vec<_>>>()?;
        Ok((runs, self.fusion_weights.clone(), device::recorded(self.fusion.device())))
    }

    /// The machine, on which seconds depend, and the metrics.
    pub fn measured_by(&self) -> impl Serialize {
        (run::machine(), run::lpips(self.lpips))
    }

    /// Evaluates what is asked for, unless it is there.
    pub fn measure(&self, ask: &Ask) -> Result<Results> {
        let recipe = digest(&(ask, self.networks(ask.run)?, self.scale.plan(ask.data)?, self.measured_by()))?;
        let name = ask.run.map_or_else(|| ask.data.name(), Run::name);
        let out = self.out.join("rows").join(format!("{name}-{recipe}"));
        let methods: Vec<Method> = ask.methods.iter().map(|id| Method::parse(id)).collect::<Result<_>>()?;
        let tests = self.sequences(ask.data, ask.gap)?;
        let wan = ask.run.map(|run| self.renderer(run)).transpose()?;
        let options = run::Options {
            rendering: renderer::Options {
                fusion: Some(self.fusion),
                wan: wan.as_deref(),
                drawing: Drawing { steps: ask.steps, ..Drawing::default() },
                ..renderer::Options::new(&methods)
            },
            lpips: self.lpips,
            every: ask.every,
            raw_truth: false,
            pictures: 1,
            title: format!("RenderFlow: {name}"),
            settings: vec![("recipe".into(), recipe)],
        };
        let frames = tests.iter().map(|test| run::frames(test, ask.every) as u64).sum();
        let progress = Progress::new(&format!("evaluating {name}"), frames);
        run::run(&tests, &options, &out, &progress, self.cancel)?;
        progress.finish();
        Results::read(&out)
    }

    /// A small result that `make` computes, unless it is in the file that belongs to `recipe`.
    pub fn kept<T: Serialize + for<'de> Deserialize<'de>>(
        &self,
        name: &str,
        recipe: &impl Serialize,
        make: impl FnOnce() -> Result<T>,
    ) -> Result<T> {
        let path = self.out.join("rows").join(format!("{name}-{}.json", digest(recipe)?));
        match file::read_json(&path) {
            Ok(kept) => Ok(kept),
            Err(error) if error.is_missing() => {
                let made = make()?;
                file::write_json(&path, &made)?;
                Ok(made)
            }
            Err(error) => Err(error.into()),
        }
    }
}

impl Trained {
    fn new(folder: PathBuf, done: Done) -> Result<Self> {
        let hash = files::hash(&folder.join(WEIGHTS))?;
        Ok(Self { folder, steps: done.steps, seconds: done.seconds, hash })
    }

    /// The name of its folder, which follows from its recipe.
    pub fn name(&self) -> String {
        self.folder.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
    }

    /// The file of the weights.
    pub fn weights(&self) -> PathBuf {
        self.folder.join(WEIGHTS)
    }
}

/// The beginning of the BLAKE3 of a recipe as JSON.
pub fn digest(recipe: &impl Serialize) -> Result<String> {
    let hash = blake3::hash(&serde_json::to_vec(recipe)?).to_hex();
    Ok(hash[..10].to_owned())
}
