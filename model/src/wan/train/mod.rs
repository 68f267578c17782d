//! Training of the wan networks: an autoencoder, the renderer, its keyframe adapter, its inverse adapter. A [`Config`] describes
//! one run.
//!
//! Clips are turned into pictures ([`clip_pictures`]) and pictures into latents ([`latents`]); both are kept in half precision.
//! Batches depend on the seed and the step alone, so that a run that was stopped continues as if it had not been. Weights,
//! gradients and the optimiser use single precision, because the CPU backend has no faster format.
//!
//! Sources: RenderFlow, sections "Latent-Space Bridge-Matching Training" and "Inverse Rendering", appendix "Implementation
//! Details".

pub mod autoencoder;
pub mod clip_pictures;
pub mod config;
pub mod flow;
pub mod latent_batch;
pub mod latents;
pub mod losses;
mod preset;
pub mod recompute;
mod round_trip;

pub use config::{AutoencoderLoss, BatchConfig, Config, LatentConfig, PixelLoss, Stage};
pub use preset::StageName;
pub use round_trip::{Measured, RoundTrip, round_trip};

use super::config::VaeConfig;
use super::flow::{Flow, FlowConfig, Group};
use super::names::{Named, Naming};
use super::pictures::{BridgeStart, Kind};
use super::vae::Vae;
use super::weights::{self, Header, Network, Provenance, Source};
use crate::data::{Clip, ClipSource, step_rng};
use crate::lpips::Lpips;
use crate::parameters;
use crate::train::optimizer::Optimizer;
use crate::train::pool::{Make, Pool, PoolSettings, Stored};
use crate::train::runner::{self, Objective, RunContext, Runner};
pub use crate::train::runner::{LogRecord, Progress, Summary};
use crate::{Error, Result};
use autoencoder::{AutoencoderObjective, PictureBatch, StatisticsSample, new_autoencoder};
use burn::module::Module;
use burn::tensor::Device;
use clip_pictures::ClipPictures;
use flow::FlowObjective;
use latent_batch::{BatchSampler, LatentBatch, Task};
use latents::{ClipLatents, Encoder, Store};
use std::collections::hash_map::DefaultHasher;
use std::hash::{Hash, Hasher};
use std::path::Path;
use std::sync::Arc;

/// Trains a network, and resumes from the checkpoint in the output folder if there is one.
///
/// Batches depend on the seed and the step alone. Each process of a team makes its share of them. Progress is told from this
/// thread, and during loading from others.
///
/// # Errors
/// For invalid options or data, files that cannot be read or written, a checkpoint of another run, a loss that stays not finite,
/// or a device that fails.
pub fn run(config: &Config, source: &dyn ClipSource, context: RunContext) -> Result<Summary> {
    config.validate()?;
    config.batches.iter().try_for_each(|batch| context.team.share().check_batch("batches.items", batch.items))?;
    let context = context.reporting();
    let run = Run { config, source, context, device: context.autodiff() };
    match &config.stage {
        Stage::Autoencoder { network, start, loss } => run.autoencoder(network, start.as_deref(), *loss),
        Stage::Base { network, start, latents } => run.base(network, start.as_deref(), latents),
        Stage::Keyframes { base, network, gap, latents } => {
            let add = |old: FlowConfig| if old.keyframes.is_some() { old } else { old.with_keyframes(network.clone()) };
            let task = Task::Render { gap: Some(*gap) };
            run.adapter(base, add, FlowStage { group: Group::Keyframes, task, latents, latent_weight: 1.0, albedo_lpips: 0.0 })
        }
        Stage::Inverse { base, network, lpips, latent, latents } => {
            let add = |old: FlowConfig| if old.inverse.is_some() { old } else { old.with_inverse(network.clone()) };
            let (group, task) = (Group::Inverse, Task::Invert);
            run.adapter(base, add, FlowStage { group, task, latents, latent_weight: *latent, albedo_lpips: *lpips })
        }
    }
}

/// What the bridge of the renderer begins with that a run trains; `None` if it trains an autoencoder.
///
/// # Errors
/// When the weights that the run starts with cannot be read.
pub fn bridge_start(config: &Config) -> Result<Option<BridgeStart>> {
    let stored = |path: &Path| -> Result<Option<BridgeStart>> {
        let header = Source::open(path)?.header()?;
        Ok(header.and_then(|header| if let Network::WanFlow(config) = header.network { Some(config.bridge_start) } else { None }))
    };
    match &config.stage {
        Stage::Autoencoder { .. } => Ok(None),
        Stage::Base { network, start, .. } => {
            Ok(start.as_deref().map(stored).transpose()?.flatten().or(Some(network.bridge_start)))
        }
        Stage::Keyframes { base, .. } | Stage::Inverse { base, .. } => stored(base),
    }
}

/// A stage of the renderer's training.
struct FlowStage<'a> {
    /// Parameters that learn.
    group: Group,
    /// What they learn.
    task: Task,
    /// Options that every such stage has.
    latents: &'a LatentConfig,
    /// Weight of the squared error of the velocity.
    latent_weight: f32,
    /// Weight of LPIPS in the loss of a recovered albedo.
    albedo_lpips: f32,
}

/// Draws the batch of a step from the clips in memory.
type Draw<'a, T, B> = &'a (dyn Fn(&[Arc<T>], u64) -> Result<B> + Sync);

struct Run<'a> {
    config: &'a Config,
    source: &'a dyn ClipSource,
    context: RunContext<'a>,
    /// The device, which records operations.
    device: Device,
}

impl Run<'_> {
    fn autoencoder(&self, network: &VaeConfig, start: Option<&Path>, loss: AutoencoderLoss) -> Result<Summary> {
        let config = self.config;
        let (vae, provenance) = match start {
            Some(path) => Vae::open(path, network, &self.device)?,
            None => (new_autoencoder(network, config.run.seed, &self.device)?, self.new_provenance()),
        };
        let network = vae.config().clone();
        self.check_batches(network.spatial_factor(), &network)?;
        let least = config.batches.iter().map(|b| b.size).max().unwrap_or(1);
        let multiple = network.spatial_factor();
        let make = move |clip: &Clip| ClipPictures::new(clip, None, least, multiple);
        let sample = StatisticsSample::draw(config, &network, self.source, &make)?;
        let objective = AutoencoderObjective { loss, lpips: self.lpips(loss.lpips)? };
        let save = |optimizer: &Optimizer, vae: &Vae| {
            let vae = self.averaged(optimizer, vae);
            let header = Network::WanVae(sample.measure(&network, &vae)?);
            self.save(&vae, header, &provenance, optimizer.steps)
        };
        let share = self.context.team.share();
        let draw = |clips: &[_], step: u64| {
            PictureBatch::draw(&network, &config.batches, clips, share, &mut step_rng(config.run.seed, step))
        };
        self.train(&objective, vae, &make, &draw, &save)
    }

    fn base(&self, network: &FlowConfig, start: Option<&Path>, latents: &LatentConfig) -> Result<Summary> {
        let (vae, _) = Vae::open(&latents.autoencoder, &network.vae, &self.device)?;
        let network = FlowConfig { vae: vae.config().clone(), ..network.clone() };
        let seed = self.config.run.seed;
        let (flow, provenance) = match start {
            None => (Flow::new(&network, seed, &self.device)?, self.new_provenance()),
            Some(path) => {
                let source = Source::open(path)?;
                let named = |mut provenance: Provenance| {
                    provenance.sources.push(path.display().to_string());
                    provenance
                };
                if source.header()?.is_some() {
                    let plain = |old| FlowConfig { keyframes: None, inverse: None, ..old };
                    let (flow, header, _) = Flow::read(&source, plain, seed, &self.device)?;
                    (flow, named(header.provenance))
                } else {
                    (Flow::adopt(&network, &source, None, seed, &self.device)?.0, named(Provenance::default()))
                }
            }
        };
        let task = Task::Render { gap: None };
        let stage = FlowStage { group: Group::Base, task, latents, latent_weight: 1.0, albedo_lpips: 0.0 };
        self.flow(flow, vae, provenance, stage)
    }

    /// Trains an optional adapter of the renderer in the file `base`.
    fn adapter(&self, base: &Path, add: impl FnOnce(FlowConfig) -> FlowConfig, stage: FlowStage) -> Result<Summary> {
        let (flow, header, _) = Flow::read(&Source::open(base)?, add, self.config.run.seed, &self.device)?;
        let (vae, _) = Vae::open(&stage.latents.autoencoder, &flow.config().vae, &self.device)?;
        let mut provenance = header.provenance;
        provenance.sources.push(base.display().to_string());
        self.flow(flow, vae, provenance, stage)
    }

    /// Trains a part of the renderer.
    fn flow(&self, flow: Flow, vae: Vae, provenance: Provenance, stage: FlowStage) -> Result<Summary> {
        let FlowStage { group, task, latents, latent_weight, albedo_lpips } = stage;
        let config = self.config;
        let network = flow.config().clone();
        if &network.vae != vae.config() {
            let reason = "is not the autoencoder whose latents the renderer was trained on";
            return Err(Error::config("stage.latents.autoencoder", reason));
        }
        self.check_batches(network.pixel_multiple(), &network.vae)?;
        let share = self.context.team.share();
        let sampler = BatchSampler { network: &network, latents, batches: &config.batches, task, share };
        let vae = vae.no_grad();
        let plain = vae.valid();
        let decodes = latents.pixels.weight > 0.0;
        let encoder = Encoder {
            vae: &plain,
            sizes: sampler.sizes(),
            start: network.bridge_start,
            multiple: network.pixel_multiple(),
            stills: config.batches.iter().any(|b| b.frames == 1),
            clips: config.batches.iter().any(|b| b.frames > 1),
            references: latents.reference_probability > 0.0 && task != Task::Invert,
            pictures: match task {
                _ if !decodes => &[],
                Task::Render { .. } if network.bridge_start.is_coded_as_change() => &[Kind::Target, Kind::Albedo],
                Task::Render { .. } => &[Kind::Target],
                Task::Invert => &[Kind::Albedo, Kind::Normal, Kind::Depth, Kind::Material],
            },
            store: config.latents_folder.as_deref().map(|folder| Store::new(folder, &plain)),
        };
        let wants_lpips = if task == Task::Invert { albedo_lpips } else { latents.pixels.lpips };
        let objective = FlowObjective {
            vae,
            pixels: latents.pixels,
            latent: latent_weight,
            albedo_lpips,
            lpips: self.lpips(if decodes { wants_lpips } else { 0.0 })?,
            recompute: latents.recompute,
        };
        let flow = flow.learn_only(group);
        let frozen = digests(&flow);
        let save = |optimizer: &Optimizer, flow: &Flow| {
            let flow = self.averaged(optimizer, flow);
            // A frozen parameter must stay the same to the bit.
            if let Some((name, _)) =
                digests(&flow).into_iter().zip(&frozen).find(|(now, before)| &now != before).map(|(now, _)| now)
            {
                return Err(Error::Data { place: "training".into(), reason: format!("{name} was frozen and has changed") });
            }
            self.save(&flow, Network::WanFlow(network.clone()), &provenance, optimizer.steps)
        };
        let draw = |clips: &[Arc<Vec<ClipLatents>>], step: u64| -> Result<LatentBatch> {
            sampler.draw(clips, step, &mut step_rng(config.run.seed, step))
        };
        self.train(&objective, flow, &|clip: &Clip| encoder.encode(clip), &draw, &save)
    }

    /// Runs the loop. Clips are kept as `T`, and batches are drawn from them.
    fn train<O: Objective, T: Stored>(
        &self,
        objective: &O,
        model: O::Model,
        make: Make<T>,
        draw: Draw<T, O::Batch>,
        save: &dyn Fn(&Optimizer, &O::Model) -> Result<()>,
    ) -> Result<Summary> {
        let config = self.config;
        let settings = PoolSettings { limit: config.cache_mib << 20, rotate_steps: config.rotate_steps, seed: config.run.seed };
        let loading = |done, total| (self.context.progress)(&Progress::Loading { done: done as u64, total: total as u64 });
        let runner = Runner { config, data: self.source.identity()?, context: self.context };
        let batches = |first_step| {
            let mut pool = Pool::load(self.source, make, settings, first_step, self.context.cancel, &loading)?;
            Ok(move |step| draw(&pool.at(step)?, step))
        };
        runner.run(objective, model, batches, save)
    }

    /// The model with its averaged weights, which are the ones that are saved.
    fn averaged<M: Module>(&self, optimizer: &Optimizer, model: &M) -> M {
        let average: Vec<&[f32]> = optimizer.slots.iter().map(|slot| slot.average.as_slice()).collect();
        parameters::import_learning(model.clone(), &average, &self.device)
    }

    fn save<M: Named>(&self, model: &M, network: Network, provenance: &Provenance, steps: u64) -> Result<()> {
        let provenance = Provenance { steps: provenance.steps + steps, ..provenance.clone() };
        let header = Header { network, provenance };
        weights::save(&runner::weights_path(&self.config.run.output), model, &header, self.config.precision, Naming::Diffusers)
    }

    /// The provenance of weights that begin with this run.
    fn new_provenance(&self) -> Provenance {
        Provenance { seed: Some(self.config.run.seed), program: env!("CARGO_PKG_VERSION").into(), ..Provenance::default() }
    }

    /// LPIPS if its weight is above 0.
    fn lpips(&self, weight: f32) -> Result<Option<Lpips>> {
        (weight > 0.0).then(|| Lpips::for_loss(self.config.lpips_weights.as_deref(), &self.device)).transpose()
    }

    fn check_batches(&self, multiple: usize, vae: &VaeConfig) -> Result<()> {
        for batch in &self.config.batches {
            if !batch.size.is_multiple_of(multiple) {
                return Err(Error::config("batches.size", format!("{} is not a multiple of {multiple}", batch.size)));
            }
            let clip = 1 + vae.temporal_factor();
            if batch.frames != 1 && (batch.frames != clip || clip == 2) {
                return Err(Error::config("batches.frames", format!("{} is neither 1 nor {clip}", batch.frames)));
            }
        }
        Ok(())
    }
}

/// The name of every parameter that does not learn, and a digest of its values.
fn digests<M: Module>(model: &M) -> Vec<(String, u64)> {
    let digest = |values: &[f32]| {
        let mut hasher = DefaultHasher::new();
        values.iter().for_each(|value| value.to_bits().hash(&mut hasher));
        hasher.finish()
    };
    let frozen = parameters::export_some(model, &|_, learns| !learns);
    frozen.into_iter().map(|p| (digest(&p.values), p.name)).map(|(digest, name)| (name, digest)).collect()
}
