//! How large the experiments are: their data, and the recipes of their training runs.

use crate::dataset::denoise::Denoise;
use crate::dataset::plan::{Keyframes, Plan, Render};
use crate::dataset::planning;
use crate::util::cancel::Cancel;
use anyhow::{Context, Result};
use renderflow_frame::frame_file::Profile;
use renderflow_model::bridge::{Bridge, Times};
use renderflow_model::lpips::{Backbone, weights_folder};
use renderflow_model::wan::flow::{FlowConfig, KeyframeConfig, Query};
use renderflow_model::wan::pictures::BridgeStart;
use renderflow_model::wan::train::{BatchConfig, Config, LatentConfig, Stage, StageName};
use renderflow_renderer::Settings;
use renderflow_renderer::denoise::Denoiser;
use renderflow_scenes::procedural::{Composition, Split};
use serde::Serialize;
use std::path::PathBuf;

/// Seed of all plans. No test set and no training of the project uses it.
const SEED: u64 = 2_026;
/// Frames of the paper's training clips.
const CLIP: u32 = 5;

/// The sizes of all experiments.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Scale {
    /// Size of the paper's network, one of [`FlowConfig::PRESETS`].
    pub preset: &'static str,
    /// Side of the pictures in pixels.
    pub side: u32,
    /// Samples for each pixel of the truth of training frames, and of test frames.
    pub spp: [u32; 2],
    /// Training sequences of five frames, and of [`Self::long`] frames for the keyframe adapters.
    pub train: [u32; 2],
    /// Frames of the longer training sequences.
    pub long: u32,
    /// Test sequences, and their frames.
    pub test: [u32; 2],
    /// Frames of the one sequence on which drift is measured.
    pub way: u32,
    /// Two of so many frames are evaluated.
    pub every: u32,
    /// Distances between keyframes.
    pub gaps: Vec<u32>,
    /// Runs of the test of determinism, and the frames of each.
    pub runs: [u32; 2],
    /// Steps that the stochastic baselines take: for single frames and for clips.
    pub noisy_steps: [u32; 2],
    /// Steps of an edit.
    pub edit: u32,
    /// Sides of the pictures whose seconds are measured.
    pub sides: Vec<u32>,
    /// Minutes of a training run.
    pub minutes: Option<f64>,
    /// Steps of a training run without minutes.
    pub steps: u64,
}

impl Scale {
    /// The sizes of a whole run, with this many minutes for each of its training runs and pictures of this side.
    pub fn whole(minutes: f64, side: u32) -> Self {
        Self {
            preset: "wan-small",
            side,
            spp: [16, 64],
            train: [300, 24],
            long: 21,
            test: [6, 50],
            way: 101,
            every: 10,
            gaps: vec![13, 16, 17, 25, 49],
            runs: [10, 5],
            noisy_steps: [50, 30],
            edit: 6,
            sides: vec![side / 2, side, 2 * side],
            minutes: Some(minutes),
            steps: u64::MAX,
        }
    }

    /// Every table in tiny form: it shows that the experiments run, and its numbers mean nothing.
    pub fn smoke() -> Self {
        Self {
            preset: "wan-tiny",
            side: 48,
            spp: [2, 4],
            train: [2, 1],
            long: 6,
            test: [1, 7],
            way: 7,
            every: 3,
            gaps: vec![2, 3],
            runs: [2, 2],
            noisy_steps: [3, 2],
            edit: 2,
            sides: vec![32, 48],
            minutes: None,
            steps: 2,
        }
    }

    /// The plan of some data.
    ///
    /// # Errors
    /// When no meshes or lights are left for a split.
    pub fn plan(&self, data: Data) -> Result<Plan> {
        let [learnt, shown] = self.spp;
        let (split, sequences, frames, side, spp) = match data {
            Data::Clips => (Split::Train, self.train[0], CLIP, self.side, learnt),
            Data::Long => (Split::Train, self.train[1], self.long, self.side, learnt),
            Data::Seen => (Split::Train, self.test[0], CLIP, self.side, shown),
            Data::Test => (Split::Test, self.test[0], self.test[1], self.side, shown),
            Data::Way => (Split::Test, 1, self.way, self.side, learnt),
            Data::Side(side) => (Split::Test, 1, 2, side, 1),
        };
        let denoise = if Denoiser::new().is_ok() { Denoise::Oidn } else { Denoise::None };
        let mut plan = Plan {
            version: 2,
            // Clips that were learnt from come again as what is seen; the others share nothing.
            seed: SEED
                + match data {
                    Data::Clips | Data::Seen => 0,
                    Data::Long => 1,
                    Data::Test => 2,
                    Data::Way | Data::Side(_) => 3,
                },
            sequences: planning::all_to(split, sequences),
            frames,
            frame_step: 1,
            resolution: [side; 2],
            render: Render {
                spp,
                adaptive: false,
                max_bounces: Settings::default().max_bounces,
                denoise,
                irradiance: false,
                distance: false,
                light_groups: 0,
            },
            keyframes: Keyframes { gap: 16, between_spp: None },
            storage: Profile::Compact,
            meshes: Plan::MESHES,
            environments: Plan::ENVIRONMENTS,
            classic: (),
            // The paper's setting: light from the environment, and opaque surfaces.
            composition: Composition { lamps: 0.0, ..Composition::opaque() },
            splits: Default::default(),
            allowed: Default::default(),
        };
        plan.splits = planning::splits(&plan, None, None, &Cancel::default())?;
        Ok(plan)
    }

    /// The configuration of a training run, without names of files.
    pub(super) fn config(&self, run: Run) -> Result<Config> {
        let stage = match run {
            Run::Autoencoder => StageName::Autoencoder,
            Run::Keys(_) => StageName::Keyframes,
            Run::Inverse => StageName::Inverse,
            Run::Base | Run::Variant(_) | Run::Noise { .. } | Run::Data(_) | Run::Time(_) => StageName::Base,
        };
        let mut config = Config::preset(self.preset, stage).with_context(|| format!("{}: no such preset", self.preset))?;
        let network = FlowConfig::preset(self.preset).context("no such preset")?;
        let there = weights_folder().is_some_and(|folder| folder.join(Backbone::Squeeze.file_name()).is_file());
        if let Some(latents) = config.stage.latents_mut() {
            *latents = self.latents(run, there);
        }
        match &mut config.stage {
            Stage::Base { network: of, .. } => of.bridge_start = start(run),
            Stage::Keyframes { network: of, gap, .. } => {
                *gap = self.long.min(17) as usize - 1;
                let rank = KeyframeConfig::default().lora_rank;
                let (query, lora_rank) = match run {
                    Run::Keys(Keys::Reused) => (Query::Reused, 0),
                    Run::Keys(Keys::Dedicated) => (Query::Dedicated, 0),
                    _ => (Query::Dedicated, rank.min(network.dit.width())),
                };
                *of = KeyframeConfig { query, lora_rank, lora_alpha: rank as f32 };
            }
            Stage::Autoencoder { .. } | Stage::Inverse { .. } => {}
        }
        config.batches = self.batches(run);
        config.run.steps = match run {
            Run::Time(part) if self.minutes.is_none() => (self.steps / u64::from(part)).max(1),
            _ => self.steps,
        };
        config.run.minutes = self.minutes.map(|minutes| match run {
            // Everything else stands on it.
            Run::Autoencoder => 2.0 * minutes,
            Run::Time(part) => minutes / f64::from(part),
            _ => minutes,
        });
        config.run.warmup_steps = config.run.warmup_steps.min(self.steps / 4);
        Ok(config)
    }

    fn latents(&self, run: Run, lpips: bool) -> LatentConfig {
        let mut latents = LatentConfig::default();
        if !lpips {
            latents.pixels.lpips = 0.0;
        }
        match run {
            Run::Variant(Variant::UniformSde) => latents.bridge.times = Times::Uniform,
            Run::Variant(Variant::FourOde) => latents.bridge.sigma = 0.0,
            Run::Variant(Variant::LatentAlone) => latents.pixels.weight = 0.0,
            Run::Variant(Variant::LatentAndLpips) => latents.pixels.gradient = 0.0,
            // Diffusion models of this kind learn in latents, at any time of a straight path.
            Run::Noise { .. } => {
                latents.bridge = Bridge { sigma: 0.0, times: Times::Uniform };
                latents.pixels.weight = 0.0;
                latents.reference_probability = 0.0;
            }
            _ => {}
        }
        latents
    }

    /// Kinds of batch: stills and clips for everything that renders, as in the recipe of `wan-small`.
    fn batches(&self, run: Run) -> Vec<BatchConfig> {
        let clip = CLIP as usize;
        let batch = |size, frames, items, weight| BatchConfig { size, frames, items, weight };
        let small = (self.side as usize / 2).next_multiple_of(16).min(self.side as usize);
        let large = (self.side as usize / 16 * 16).max(16);
        match run {
            Run::Autoencoder => {
                vec![batch(small, 1, 8, 0.3), batch((small / 2).next_multiple_of(16), 1, 16, 0.4), batch(small, clip, 2, 0.3)]
            }
            Run::Inverse | Run::Noise { clips: false } => vec![batch(small, 1, 8, 0.7), batch(large, 1, 2, 0.3)],
            Run::Noise { clips: true } => vec![batch(small, clip, 4, 0.7), batch(large, clip, 1, 0.3)],
            _ => {
                vec![batch(small, 1, 4, 0.35), batch(large, 1, 1, 0.15), batch(small, clip, 2, 0.35), batch(large, clip, 1, 0.15)]
            }
        }
    }

    /// The data that a run learns from, and how many of its sequences.
    pub(super) fn lesson(&self, run: Run) -> (Data, u32) {
        match run {
            Run::Keys(_) => (Data::Long, self.train[1]),
            Run::Data(part) => (Data::Clips, (self.train[0] / part).max(1)),
            _ => (Data::Clips, self.train[0]),
        }
    }
}

fn start(run: Run) -> BridgeStart {
    match run {
        Run::Noise { .. } => BridgeStart::Noise,
        Run::Variant(Variant::Lit) => BridgeStart::Lit,
        Run::Variant(Variant::Deferred) => BridgeStart::Deferred,
        _ => BridgeStart::Albedo,
    }
}

/// A set of sequences.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize)]
pub enum Data {
    /// Clips to learn from.
    Clips,
    /// Longer sequences to learn from with keyframes.
    Long,
    /// Some of the clips, to measure what was learnt by heart.
    Seen,
    /// Sequences of mesh families and lights that training never sees.
    Test,
    /// One long sequence.
    Way,
    /// One scene with pictures of this side, for seconds.
    Side(u32),
}

impl Data {
    /// Its folder.
    pub(super) fn name(self) -> String {
        match self {
            Self::Clips => "clips".into(),
            Self::Long => "long".into(),
            Self::Seen => "seen".into(),
            Self::Test => "test".into(),
            Self::Way => "way".into(),
            Self::Side(side) => format!("side-{side}"),
        }
    }
}

/// A training run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
pub enum Run {
    /// The autoencoder that all others stand on.
    Autoencoder,
    /// The paper's recipe.
    Base,
    /// The paper's recipe with one change.
    Variant(Variant),
    /// A bridge from noise, on single frames or on clips.
    Noise {
        /// Whether it learns from clips.
        clips: bool,
    },
    /// A keyframe adapter, on [`Self::Base`] but for [`Keys::Carried`].
    Keys(Keys),
    /// The inverse adapter on [`Self::Base`].
    Inverse,
    /// The paper's recipe on one part of so many of the data.
    Data(u32),
    /// The paper's recipe in one part of so many of the time.
    Time(u32),
}

/// One change of the paper's recipe.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
pub enum Variant {
    /// Times from 0 to 1 instead of four of them.
    UniformSde,
    /// No noise on the way.
    FourOde,
    /// Velocities of latents alone.
    LatentAlone,
    /// Without the loss on gradients of pictures.
    LatentAndLpips,
    /// The albedo times the irradiance at the beginning.
    Lit,
    /// The picture by deferred shading at the beginning, whose change the autoencoder codes.
    Deferred,
}

/// Variants of the keyframe adapter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
pub enum Keys {
    /// The queries of self-attention, without a correction of the perceptron.
    Reused,
    /// Queries of its own, without a correction of the perceptron.
    Dedicated,
    /// Queries of its own, and a correction of the perceptron: the paper's adapter.
    Whole,
    /// The paper's adapter on [`Variant::Deferred`], whose bridge then begins with carried keyframes.
    Carried,
}

impl Run {
    /// Name of its folder.
    pub(super) fn name(self) -> String {
        match self {
            Self::Autoencoder => "autoencoder".into(),
            Self::Base => "base".into(),
            Self::Variant(Variant::UniformSde) => "uniform-sde".into(),
            Self::Variant(Variant::FourOde) => "four-ode".into(),
            Self::Variant(Variant::LatentAlone) => "latent-alone".into(),
            Self::Variant(Variant::LatentAndLpips) => "latent-and-lpips".into(),
            Self::Variant(Variant::Lit) => "lit".into(),
            Self::Variant(Variant::Deferred) => "deferred".into(),
            Self::Noise { clips: false } => "noise-stills".into(),
            Self::Noise { clips: true } => "noise-clips".into(),
            Self::Keys(Keys::Reused) => "keys-reused".into(),
            Self::Keys(Keys::Dedicated) => "keys-dedicated".into(),
            Self::Keys(Keys::Whole) => "keys".into(),
            Self::Keys(Keys::Carried) => "keys-carried".into(),
            Self::Inverse => "inverse".into(),
            Self::Data(part) => format!("base-data-{part}"),
            Self::Time(part) => format!("base-time-{part}"),
        }
    }

    /// The renderer that its adapter stands on.
    pub(super) fn renderer(self) -> Option<Self> {
        match self {
            Self::Keys(Keys::Carried) => Some(Self::Variant(Variant::Deferred)),
            Self::Keys(_) | Self::Inverse => Some(Self::Base),
            _ => None,
        }
    }

    /// Puts the files of the runs that it stands on into its configuration.
    pub(super) fn stand_on(config: &mut Config, autoencoder: PathBuf, renderer: PathBuf) {
        if let Some(latents) = config.stage.latents_mut() {
            latents.autoencoder = autoencoder;
        }
        match &mut config.stage {
            Stage::Keyframes { base, .. } | Stage::Inverse { base, .. } => *base = renderer,
            Stage::Autoencoder { .. } | Stage::Base { .. } => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::plan::Counts;

    const RUNS: [Run; 17] = [
        Run::Autoencoder,
        Run::Base,
        Run::Variant(Variant::UniformSde),
        Run::Variant(Variant::FourOde),
        Run::Variant(Variant::LatentAlone),
        Run::Variant(Variant::LatentAndLpips),
        Run::Variant(Variant::Lit),
        Run::Variant(Variant::Deferred),
        Run::Noise { clips: false },
        Run::Noise { clips: true },
        Run::Keys(Keys::Reused),
        Run::Keys(Keys::Dedicated),
        Run::Keys(Keys::Whole),
        Run::Keys(Keys::Carried),
        Run::Inverse,
        Run::Data(4),
        Run::Time(2),
    ];

    #[test]
    fn plans_and_recipes_are_valid_at_every_scale() {
        for scale in [Scale::smoke(), Scale::whole(30.0, 256), Scale::whole(30.0, 128)] {
            let mut all = vec![Data::Clips, Data::Long, Data::Seen, Data::Test, Data::Way];
            all.extend(scale.sides.iter().map(|&side| Data::Side(side)));
            for data in all {
                let plan = scale.plan(data).expect("a plan");
                plan.check().unwrap_or_else(|error| panic!("{data:?}: {error:#}"));
                // A gap needs frames on both sides.
                assert!(data != Data::Test || plan.frames > *scale.gaps.iter().max().expect("gaps"));
            }
            let multiple = FlowConfig::preset(scale.preset).expect("a preset").pixel_multiple();
            let mut names = Vec::new();
            for run in RUNS {
                let mut config = scale.config(run).expect("a configuration");
                Run::stand_on(&mut config, "vae".into(), "base".into());
                config.validate().unwrap_or_else(|error| panic!("{run:?}: {error}"));
                for batch in &config.batches {
                    assert!(batch.size <= scale.side as usize && batch.size.is_multiple_of(multiple), "{run:?}: {batch:?}");
                }
                names.push(run.name());
            }
            names.sort();
            names.dedup();
            assert_eq!(names.len(), RUNS.len());
        }
        // What is seen was learnt from; what is tested was not.
        let scale = Scale::whole(1.0, 256);
        let [clips, seen, test] = [Data::Clips, Data::Seen, Data::Test].map(|data| scale.plan(data).expect("a plan"));
        assert_eq!((clips.seed, clips.frames), (seen.seed, seen.frames));
        assert_eq!(test.sequences, Counts { train: 0, val: 0, test: 6 });
        let scene = |plan: &Plan| plan.compose(&plan.catalog(), 0).expect("a scene").scene.objects;
        assert_eq!(scene(&clips), scene(&seen));
        assert_ne!(scene(&clips), scene(&test));
    }

    /// The recipes differ in what their names say, and in nothing else.
    #[test]
    fn variants_change_one_thing() {
        let scale = Scale::whole(1.0, 256);
        let base = scale.config(Run::Base).expect("a configuration");
        let changed = |run: Run| {
            let config = scale.config(run).expect("a configuration");
            let values = |config: &Config| serde_json::to_value(config).expect("JSON");
            let (a, b) = (values(&base), values(&config));
            let (stage_a, stage_b) = (&a["stage"]["base"], &b["stage"]["base"]);
            let mut changes = Vec::new();
            for (place, a, b) in [
                ("start", &stage_a["network"]["bridge_start"], &stage_b["network"]["bridge_start"]),
                ("sigma", &stage_a["latents"]["bridge"]["sigma"], &stage_b["latents"]["bridge"]["sigma"]),
                ("times", &stage_a["latents"]["bridge"]["times"], &stage_b["latents"]["bridge"]["times"]),
                ("weight", &stage_a["latents"]["pixels"]["weight"], &stage_b["latents"]["pixels"]["weight"]),
                ("gradient", &stage_a["latents"]["pixels"]["gradient"], &stage_b["latents"]["pixels"]["gradient"]),
                ("minutes", &a["minutes"], &b["minutes"]),
                ("batches", &a["batches"], &b["batches"]),
            ] {
                changes.extend((a != b).then_some(place));
            }
            changes
        };
        assert!(changed(Run::Base).is_empty() && changed(Run::Data(4)).is_empty());
        assert_eq!(changed(Run::Variant(Variant::UniformSde)), ["times"]);
        assert_eq!(changed(Run::Variant(Variant::FourOde)), ["sigma"]);
        assert_eq!(changed(Run::Variant(Variant::LatentAlone)), ["weight"]);
        assert_eq!(changed(Run::Variant(Variant::LatentAndLpips)), ["gradient"]);
        assert_eq!(changed(Run::Variant(Variant::Lit)), ["start"]);
        assert_eq!(changed(Run::Variant(Variant::Deferred)), ["start"]);
        assert_eq!(changed(Run::Time(4)), ["minutes"]);
        assert_eq!(scale.lesson(Run::Data(4)).1, scale.lesson(Run::Base).1 / 4);
    }
}
