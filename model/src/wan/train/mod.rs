//! Training of the wan networks: an autoencoder, the renderer, its keyframe adapter, its inverse adapter; one [`Config`] a run.
//!
//! Clips become pictures ([`album`]), pictures latents ([`super::latents`]), both once and in half precision; batches depend on the
//! seed and the step alone, so that a run that was stopped goes on as if it had not been. Weights, gradients and the optimiser are in
//! single precision: the CPU's tensors have no other that is faster.
//!
//! Sources: RenderFlow, section "Latent-Space Bridge-Matching Training", "Inverse Rendering" and the appendix "Implementation Details".

pub mod album;
pub mod autoencoder;
pub mod batch;
pub mod config;
pub mod losses;
pub mod recompute;
pub mod renderer;
mod round_trip;

pub use config::{AutoencoderLoss, BatchConfig, Config, LatentConfig, OptimizerConfig, PixelLoss, Stage};
pub use round_trip::{RoundTrip, round_trip};

use super::config::VaeConfig;
use super::flow::{Flow, FlowConfig, Group};
use super::latents::{ClipLatents, Encoder, Store};
use super::names::{Named, Naming};
use super::pictures::Kind;
use super::vae::Vae;
use super::weights::{self, Header, LoadOptions, Network, Provenance, Source};
use crate::data::{Clip, ClipSource, step_rng};
use crate::lpips::{Backbone, Lpips, weights_folder};
use crate::parameters;
use crate::train::optimizer::Optimizer;
use crate::train::pool::{Make, Pool, PoolSettings, Stored};
use crate::train::runner::{self, Learner, Runner};
pub use crate::train::runner::{LogRecord, Progress, Summary};
use crate::{Error, Result};
use album::Album;
use autoencoder::{AutoencoderLearner, PictureBatch, Sample, new_autoencoder};
use batch::{Drawing, LatentBatch, Lesson};
use burn::module::Module;
use burn::tensor::Device;
use renderer::FlowLearner;
use std::collections::hash_map::DefaultHasher;
use std::hash::{Hash, Hasher};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Trains, resuming from the checkpoint in `config.output` if there is one.
///
/// Batches depend on (seed, step) only. `progress` is called from this thread and, while loading, from others. Setting `cancel`
/// stops after the current step with a checkpoint.
///
/// # Errors
/// Bad options or data, files that cannot be read or written, a checkpoint of another run, or a loss that is no longer finite.
pub fn run(
    config: &Config,
    source: &dyn ClipSource,
    progress: &(dyn Fn(&Progress) + Sync),
    cancel: &AtomicBool,
) -> Result<Summary> {
    config.validate()?;
    let run = Run { config, source, progress, cancel, device: Device::flex().autodiff() };
    match &config.stage {
        Stage::Autoencoder { network, start, loss } => run.autoencoder(network, start.as_deref(), *loss),
        Stage::Base { network, start, latents } => run.base(network, start.as_deref(), latents),
        Stage::Keyframes { base, network, gap, latents } => {
            let add = |old: FlowConfig| FlowConfig { keyframes: old.keyframes.or(Some(network.clone())), ..old };
            run.adapter(base, add, Group::Keyframes, Lesson::Render { gap: Some(*gap) }, latents, [1.0, 0.0])
        }
        Stage::Inverse { base, network, lpips, latent, latents } => {
            let add = |old: FlowConfig| FlowConfig { inverse: old.inverse.or(Some(network.clone())), ..old };
            run.adapter(base, add, Group::Inverse, Lesson::Invert, latents, [*latent, *lpips])
        }
    }
}

/// An autoencoder from a file of this program, or from published weights of the configuration `published`.
///
/// # Errors
/// When the file cannot be read, holds another network, or its tensors do not fit.
pub fn open_autoencoder(path: &Path, published: &VaeConfig, device: &Device) -> Result<(Vae, Provenance)> {
    let source = Source::open(path)?;
    let (config, mut provenance) = match source.header()? {
        Some(Header { network: Network::WanVae(config), provenance }) => (config, provenance),
        Some(_) => return Err(Error::malformed(path, "holds another network than an autoencoder")),
        None => (published.clone(), Provenance::default()),
    };
    let (vae, _) = weights::load(Vae::new(&config, 0, device)?, &source, LoadOptions::default())?;
    provenance.sources.push(path.display().to_string());
    Ok((vae, provenance))
}

/// Draws the batch of a step from the clips in memory.
type Draw<'a, T, B> = &'a (dyn Fn(&[Arc<T>], u64) -> Result<B> + Sync);

struct Run<'a> {
    config: &'a Config,
    source: &'a dyn ClipSource,
    progress: &'a (dyn Fn(&Progress) + Sync),
    cancel: &'a AtomicBool,
    device: Device,
}

impl Run<'_> {
    fn autoencoder(&self, network: &VaeConfig, start: Option<&Path>, loss: AutoencoderLoss) -> Result<Summary> {
        let config = self.config;
        let (vae, provenance) = match start {
            Some(path) => open_autoencoder(path, network, &self.device)?,
            None => (new_autoencoder(network, config.seed, &self.device)?, self.drawn()),
        };
        let network = vae.config().clone();
        self.check_batches(network.spatial_factor(), &network)?;
        let least = config.batches.iter().map(|b| b.size).max().unwrap_or(1);
        let multiple = network.spatial_factor();
        let make = move |clip: &Clip| Album::new(clip, None, least, multiple);
        let sample = Sample::draw(config, &network, self.source, &make)?;
        let learner = AutoencoderLearner { loss, lpips: self.lpips(loss.lpips)? };
        let save = |optimizer: &Optimizer, vae: &Vae| {
            let vae = self.averaged(optimizer, vae);
            let header = Network::WanVae(sample.measure(&network, &vae)?);
            self.save(&vae, header, &provenance, optimizer.steps)
        };
        let draw =
            |albums: &[_], step: u64| PictureBatch::draw(&network, &config.batches, albums, &mut step_rng(config.seed, step));
        self.train(&learner, vae, &make, &draw, &save)
    }

    fn base(&self, network: &FlowConfig, start: Option<&Path>, latents: &LatentConfig) -> Result<Summary> {
        let (vae, _) = open_autoencoder(&latents.autoencoder, &network.vae, &self.device)?;
        let network = FlowConfig { vae: vae.config().clone(), ..network.clone() };
        let seed = self.config.seed;
        let (flow, provenance) = match start {
            None => (Flow::new(&network, seed, &self.device)?, self.drawn()),
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
        self.renderer(flow, vae, provenance, Group::Base, Lesson::Render { gap: None }, latents, [1.0, 0.0])
    }

    /// Trains one of the optional adapters of the renderer in a file; `weights` are those of the latent loss and of LPIPS in the loss
    /// of the albedo.
    fn adapter(
        &self,
        base: &Path,
        add: impl FnOnce(FlowConfig) -> FlowConfig,
        group: Group,
        lesson: Lesson,
        latents: &LatentConfig,
        weights: [f32; 2],
    ) -> Result<Summary> {
        let (flow, header, _) = Flow::read(&Source::open(base)?, add, self.config.seed, &self.device)?;
        let (vae, _) = open_autoencoder(&latents.autoencoder, &flow.config().vae, &self.device)?;
        let mut provenance = header.provenance;
        provenance.sources.push(base.display().to_string());
        self.renderer(flow, vae, provenance, group, lesson, latents, weights)
    }

    #[allow(clippy::too_many_arguments)]
    fn renderer(
        &self,
        flow: Flow,
        vae: Vae,
        provenance: Provenance,
        group: Group,
        lesson: Lesson,
        latents: &LatentConfig,
        [latent, albedo_lpips]: [f32; 2],
    ) -> Result<Summary> {
        let config = self.config;
        let network = flow.config().clone();
        if &network.vae != vae.config() {
            let reason = "is not the autoencoder whose latents the renderer was trained on";
            return Err(Error::config("stage.latents.autoencoder", reason));
        }
        self.check_batches(network.pixel_multiple(), &network.vae)?;
        let drawing = Drawing { network: &network, latents, batches: &config.batches, lesson };
        let vae = vae.no_grad();
        let plain = vae.valid();
        let decodes = latents.pixels.weight > 0.0;
        let encoder = Encoder {
            vae: &plain,
            sizes: drawing.sizes(),
            multiple: network.pixel_multiple(),
            stills: config.batches.iter().any(|b| b.frames == 1),
            clips: config.batches.iter().any(|b| b.frames > 1),
            references: latents.reference_probability > 0.0 && lesson != Lesson::Invert,
            pictures: match lesson {
                _ if !decodes => &[],
                Lesson::Render { .. } => &[Kind::Target],
                Lesson::Invert => &[Kind::Albedo, Kind::Normal, Kind::Depth, Kind::Material],
            },
            store: config.latents_folder.as_deref().map(|folder| Store::new(folder, &plain)),
        };
        let wants_lpips = if lesson == Lesson::Invert { albedo_lpips } else { latents.pixels.lpips };
        let learner = FlowLearner {
            vae,
            pixels: latents.pixels,
            latent,
            albedo_lpips,
            lpips: self.lpips(if decodes { wants_lpips } else { 0.0 })?,
            recompute: latents.recompute,
        };
        let flow = flow.learn_only(group);
        let frozen = digests(&flow);
        let save = |optimizer: &Optimizer, flow: &Flow| {
            let flow = self.averaged(optimizer, flow);
            // Whoever froze a parameter was promised that it is the same to the bit.
            if let Some((name, _)) =
                digests(&flow).into_iter().zip(&frozen).find(|(now, before)| &now != before).map(|(now, _)| now)
            {
                return Err(Error::Data { place: "training".into(), reason: format!("{name} was frozen and has changed") });
            }
            self.save(&flow, Network::WanFlow(network.clone()), &provenance, optimizer.steps)
        };
        let draw = |clips: &[Arc<Vec<ClipLatents>>], step: u64| -> Result<LatentBatch> {
            drawing.draw(clips, step, &mut step_rng(config.seed, step))
        };
        self.train(&learner, flow, &|clip: &Clip| encoder.encode(clip), &draw, &save)
    }

    /// The loop: clips kept as `T`, batches drawn from them, checkpoints, log.
    fn train<L: Learner, T: Stored>(
        &self,
        learner: &L,
        model: L::Model,
        make: Make<T>,
        draw: Draw<T, L::Batch>,
        save: &dyn Fn(&Optimizer, &L::Model) -> Result<()>,
    ) -> Result<Summary> {
        let config = self.config;
        let settings = PoolSettings { limit: config.cache_mib << 20, rotate_steps: config.rotate_steps, seed: config.seed };
        let loading = |done, total| (self.progress)(&Progress::Loading { done: done as u64, total: total as u64 });
        let runner = Runner {
            config,
            difference: &config::difference,
            output: &config.output,
            data: self.source.identity()?,
            settings: config.settings(),
            device: self.device.clone(),
            progress: self.progress,
            cancel: self.cancel,
        };
        let batches = |first_step| {
            let mut pool = Pool::load(self.source, make, settings, first_step, self.cancel, &loading)?;
            Ok(move |step| draw(&pool.at(step)?, step))
        };
        runner.run(learner, model, batches, save)
    }

    /// The model with its averaged weights: what is evaluated and shipped.
    fn averaged<M: Module>(&self, optimizer: &Optimizer, model: &M) -> M {
        let average: Vec<&[f32]> = optimizer.slots.iter().map(|slot| slot.average.as_slice()).collect();
        parameters::import_learning(model.clone(), &average, &self.device)
    }

    fn save<M: Named>(&self, model: &M, network: Network, provenance: &Provenance, steps: u64) -> Result<()> {
        let provenance = Provenance { steps: provenance.steps + steps, ..provenance.clone() };
        let header = Header { network, provenance };
        weights::save(&runner::weights_path(&self.config.output), model, &header, self.config.precision, Naming::Diffusers)
    }

    fn drawn(&self) -> Provenance {
        Provenance { seed: Some(self.config.seed), program: env!("CARGO_PKG_VERSION").into(), ..Provenance::default() }
    }

    /// The network of LPIPS where its weight asks for it: SqueezeNet, the faster.
    fn lpips(&self, weight: f32) -> Result<Option<Lpips>> {
        if weight <= 0.0 {
            return Ok(None);
        }
        let folder = self.config.lpips_weights.clone().unwrap_or_else(|| weights_folder().folder);
        let path = folder.join(Backbone::Squeeze.file_name());
        Lpips::load_on(&path, Backbone::Squeeze, &self.device).map(Some)
    }

    fn check_batches(&self, multiple: usize, vae: &VaeConfig) -> Result<()> {
        for batch in &self.config.batches {
            if !batch.size.is_multiple_of(multiple) {
                return Err(Error::config("batches.size", format!("{} is no multiple of {multiple}", batch.size)));
            }
            let clip = 1 + vae.temporal_factor();
            if batch.frames != 1 && (batch.frames != clip || clip == 2) {
                return Err(Error::config("batches.frames", format!("{} is neither 1 nor {clip}", batch.frames)));
            }
        }
        Ok(())
    }
}

/// Name and a digest of the values of every parameter that does not learn.
fn digests<M: Module>(model: &M) -> Vec<(String, u64)> {
    let digest = |values: &[f32]| {
        let mut hasher = DefaultHasher::new();
        values.iter().for_each(|value| value.to_bits().hash(&mut hasher));
        hasher.finish()
    };
    let frozen = parameters::export_some(model, &|_, learns| !learns);
    frozen.into_iter().map(|p| (digest(&p.values), p.name)).map(|(digest, name)| (name, digest)).collect()
}
