//! Options of training runs of the wan networks. One JSON file holds one run.

use crate::Result;
use crate::bridge::Bridge;
use crate::train::config::{self, RunConfig, TrainingConfig, all, first_difference};
use crate::wan::config::VaeConfig;
use crate::wan::flow::{FlowConfig, InverseConfig, KeyframeConfig};
use crate::wan::weights::Precision;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use serde_json::{Map, Value};
use std::path::PathBuf;

/// A kind of batch.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BatchConfig {
    /// Rows and columns in pixels, 8..=4096. For an autoencoder it is a multiple of a latent pixel, and otherwise of a token.
    pub size: usize,
    /// Frames of an item: 1, or 1 more than the frames that a latent frame spans (5 with Wan's autoencoder).
    pub frames: usize,
    /// Number of items in a batch, 1..=4096.
    pub items: usize,
    /// Relative frequency, at least 0.
    pub weight: f32,
}

/// Weights of the terms that are added to the absolute error in the training of an autoencoder.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AutoencoderLoss {
    /// Weight of the difference of gradient magnitudes.
    pub gradient: f32,
    /// Weight of the divergence of latents from a normal distribution, per latent value. A small weight keeps latents at one
    /// scale without a loss of detail (Rombach et al. 2022 weigh the sum by 1e-6, which corresponds to 1e-7).
    pub divergence: f32,
    /// Weight of LPIPS, or 0 to leave it out.
    pub lpips: f32,
}

impl Default for AutoencoderLoss {
    fn default() -> Self {
        Self { gradient: 0.5, divergence: 1e-5, lpips: 0.0 }
    }
}

/// Losses on decoded predictions in the training of the renderer. They are added to the squared error of the velocity in the
/// latents.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PixelLoss {
    /// Weight of LPIPS and gradients together: the paper's lambda, whose value it does not state (LBM uses 10). With 0, nothing
    /// is decoded.
    pub weight: f32,
    /// Weight of LPIPS within `weight`, or 0 to train without LPIPS.
    pub lpips: f32,
    /// Weight of the difference of gradient magnitudes within `weight`.
    pub gradient: f32,
    /// Number of steps from one decoded prediction to the next, at least 1. Decoding takes longer than the rest of a step.
    pub period: u64,
    /// Side of the decoded window in latent pixels, at least 1. It is limited to the side of the latents.
    pub window: usize,
}

impl Default for PixelLoss {
    fn default() -> Self {
        Self { weight: 10.0, lpips: 1.0, gradient: 1.0, period: 4, window: 16 }
    }
}

/// Options that every stage of the renderer's training has.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LatentConfig {
    /// Weights file of the autoencoder, which is frozen.
    pub autoencoder: PathBuf,
    /// Noise and times of the bridge.
    pub bridge: Bridge,
    /// Losses on decoded predictions.
    pub pixels: PixelLoss,
    /// Probability that the first frame of a clip is given, 0..=1. The paper does not state it.
    pub reference_probability: f32,
    /// Whether the backward pass computes activations again, block by block. Training is slower by a third, and needs memory for
    /// one block.
    pub recompute: bool,
}

impl Default for LatentConfig {
    fn default() -> Self {
        Self {
            autoencoder: PathBuf::new(),
            bridge: Bridge::default(),
            pixels: PixelLoss::default(),
            reference_probability: 0.5,
            recompute: false,
        }
    }
}

/// What is trained.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Stage {
    /// An autoencoder for pictures of all kinds.
    Autoencoder {
        /// The network, or the name of a preset ([`FlowConfig::PRESETS`]), if training does not start from a file. Training
        /// measures the statistics of its latents.
        #[serde(default = "small_autoencoder", deserialize_with = "autoencoder_or_preset")]
        network: VaeConfig,
        /// Weights file to begin with.
        #[serde(default)]
        start: Option<PathBuf>,
        /// Weights of the loss.
        #[serde(default)]
        loss: AutoencoderLoss,
    },
    /// The renderer without optional adapters.
    Base {
        /// The network, or the name of a preset ([`FlowConfig::PRESETS`]). The autoencoder's file replaces its autoencoder.
        #[serde(deserialize_with = "network_or_preset")]
        network: Box<FlowConfig>,
        /// Weights file to begin with, of this program, or published weights of Wan or VACE.
        #[serde(default)]
        start: Option<PathBuf>,
        /// The other options.
        #[serde(default)]
        latents: LatentConfig,
    },
    /// The keyframe adapter on a frozen renderer.
    Keyframes {
        /// Weights file of the renderer.
        base: PathBuf,
        /// The adapter. A renderer that has one keeps it.
        #[serde(default)]
        network: KeyframeConfig,
        /// Distance from one keyframe to the next, in frame numbers, 1..=4096.
        #[serde(default = "sixteen")]
        gap: usize,
        /// The other options.
        #[serde(default)]
        latents: LatentConfig,
    },
    /// The inverse adapter on a frozen renderer.
    Inverse {
        /// Weights file of the renderer.
        base: PathBuf,
        /// The adapter. A renderer that has one keeps it.
        #[serde(default)]
        network: InverseConfig,
        /// Weight of LPIPS in the loss of the albedo, at least 0.
        #[serde(default)]
        lpips: f32,
        /// Weight of the squared error of latents, at least 0. It needs no decoding. The paper does not have this term; in steps
        /// that do not decode their prediction ([`PixelLoss::period`]), it is the whole loss.
        #[serde(default = "one")]
        latent: f32,
        /// The other options. Of its pixel losses, `weight` scales the losses of the intrinsics.
        #[serde(default)]
        latents: LatentConfig,
    },
}

impl Stage {
    /// Distance from one keyframe to the next, in frame numbers; `None` where no keyframes are read.
    pub fn gap(&self) -> Option<usize> {
        if let Self::Keyframes { gap, .. } = self { Some(*gap) } else { None }
    }

    /// The options that all stages but the autoencoder's have.
    pub fn latents_mut(&mut self) -> Option<&mut LatentConfig> {
        match self {
            Self::Autoencoder { .. } => None,
            Self::Base { latents, .. } | Self::Keyframes { latents, .. } | Self::Inverse { latents, .. } => Some(latents),
        }
    }
}

fn network_or_preset<'de, D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Box<FlowConfig>, D::Error> {
    match given(deserializer)? {
        Given::Preset(network) => Ok(network),
        Given::Value(value) => serde_json::from_value(value).map_err(D::Error::custom),
    }
}

fn autoencoder_or_preset<'de, D: Deserializer<'de>>(deserializer: D) -> std::result::Result<VaeConfig, D::Error> {
    match given(deserializer)? {
        Given::Preset(network) => Ok(network.vae),
        Given::Value(value) => serde_json::from_value(value).map_err(D::Error::custom),
    }
}

enum Given {
    Preset(Box<FlowConfig>),
    Value(serde_json::Value),
}

fn given<'de, D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Given, D::Error> {
    let value = serde_json::Value::deserialize(deserializer)?;
    let serde_json::Value::String(name) = &value else { return Ok(Given::Value(value)) };
    let unknown = || D::Error::custom(format!("{name} is not one of the presets {}", FlowConfig::PRESETS.join(", ")));
    FlowConfig::preset(name).map(|network| Given::Preset(Box::new(network))).ok_or_else(unknown)
}

fn small_autoencoder() -> VaeConfig {
    FlowConfig::small().vae
}

fn sixteen() -> usize {
    16
}

fn one() -> f32 {
    1.0
}

/// Options of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(remote = "Self")]
pub struct Config {
    /// What is trained.
    pub stage: Stage,
    /// The options that every run has.
    #[serde(flatten)]
    pub run: RunConfig,
    /// Kinds of batch, drawn by weight.
    pub batches: Vec<BatchConfig>,
    /// Folder with the weights of LPIPS, or `None` for [`crate::lpips::weights_folder`].
    pub lpips_weights: Option<PathBuf>,
    /// Folder where latents are kept for resumptions of this run and for later stages with the same autoencoder. Without it, each
    /// run encodes all frames again, which takes longer than reading latents.
    pub latents_folder: Option<PathBuf>,
    /// Memory for training data, MiB.
    pub cache_mib: usize,
    /// Steps after which one clip in memory is replaced when not all clips fit, at least 1.
    pub rotate_steps: u64,
    /// Number format of the weights file.
    pub precision: Precision,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            stage: Stage::Autoencoder { network: small_autoencoder(), start: None, loss: AutoencoderLoss::default() },
            run: RunConfig::default(),
            batches: vec![BatchConfig { size: 128, frames: 1, items: 8, weight: 1.0 }],
            lpips_weights: None,
            latents_folder: None,
            cache_mib: 8192,
            rotate_steps: 50,
            precision: Precision::F32,
        }
    }
}

impl Serialize for Config {
    fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        Self::serialize(self, serializer)
    }
}

impl<'de> Deserialize<'de> for Config {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        config::over_defaults(deserializer, unfold_optimizer, Self::deserialize)
    }
}

/// Older files keep the options of the optimiser in an object of their own.
fn unfold_optimizer(file: &mut Map<String, Value>) {
    match file.remove("optimizer") {
        Some(Value::Object(options)) => file.extend(options),
        Some(other) => _ = file.insert("optimizer".into(), other),
        None => {}
    }
}

impl TrainingConfig for Config {
    fn run(&self) -> &RunConfig {
        &self.run
    }

    fn difference(&self, other: &Self) -> Option<&'static str> {
        first_difference([("stage", self.stage == other.stage), ("batches", self.batches == other.batches)])
    }
}

impl Config {
    /// Checks every option that can be checked without reading files.
    ///
    /// # Errors
    /// [`crate::Error::Config`] naming the option.
    pub fn validate(&self) -> Result<()> {
        let weight = |w: f32| w >= 0.0 && w.is_finite();
        self.run.validate()?;
        all([
            ("batches", !self.batches.is_empty(), "needs at least one kind of batch"),
            ("batches.size", self.batches.iter().all(|b| (8..=4096).contains(&b.size)), "must be 8..=4096"),
            ("batches.frames", self.batches.iter().all(|b| (1..=64).contains(&b.frames)), "must be 1..=64"),
            ("batches.items", self.batches.iter().all(|b| (1..=4096).contains(&b.items)), "must be 1..=4096"),
            ("batches.weight", self.batches.iter().all(|b| weight(b.weight)), "must be a number of at least 0"),
            ("batches.weight", self.batches.iter().map(|b| b.weight).sum::<f32>() > 0.0, "must not all be 0"),
            ("rotate_steps", self.rotate_steps > 0, "must be at least 1"),
        ])?;
        match &self.stage {
            Stage::Autoencoder { network, loss, .. } => {
                network.validate()?;
                all([
                    ("stage.network.in_channels", network.in_channels == 3, "pictures have three channels"),
                    ("stage.network.out_channels", network.out_channels == 3, "pictures have three channels"),
                    (
                        "stage.loss",
                        [loss.gradient, loss.divergence, loss.lpips].into_iter().all(weight),
                        "weights must be at least 0",
                    ),
                ])
            }
            Stage::Base { network, latents, .. } => {
                network.validate()?;
                let plain = network.keyframes.is_none() && network.inverse.is_none();
                all([("stage.network", plain, "other stages train the adapters: leave out keyframes and inverse")])?;
                latents.validate()
            }
            Stage::Keyframes { gap, latents, .. } => {
                all([("stage.gap", (1..=4096).contains(gap), "must be 1..=4096")])?;
                latents.validate()
            }
            Stage::Inverse { lpips, latent, latents, .. } => {
                all([
                    ("stage.lpips", weight(*lpips), "must be a number of at least 0"),
                    ("stage.latent", weight(*latent), "must be a number of at least 0"),
                    ("stage.latent", *latent > 0.0 || latents.pixels.weight > 0.0, "all weights of the loss are 0"),
                ])?;
                latents.validate()
            }
        }
    }
}

impl LatentConfig {
    fn validate(&self) -> Result<()> {
        let (pixels, weight) = (&self.pixels, |w: f32| w >= 0.0 && w.is_finite());
        self.bridge.validate()?;
        all([
            ("stage.latents.autoencoder", !self.autoencoder.as_os_str().is_empty(), "name the weights file of the autoencoder"),
            ("stage.latents.reference_probability", (0.0..=1.0).contains(&self.reference_probability), "must be in 0..=1"),
            (
                "stage.latents.pixels",
                [pixels.weight, pixels.lpips, pixels.gradient].into_iter().all(weight),
                "weights must be at least 0",
            ),
            ("stage.latents.pixels.period", pixels.period > 0, "must be at least 1"),
            ("stage.latents.pixels.window", pixels.window > 0, "must be at least 1"),
        ])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn configurations_are_read_as_they_are_written() {
        let text = r#"{"stage": {"base": {"network": "wan-small", "latents": {"autoencoder": "vae.safetensors"}}}, "steps": 7}"#;
        let config: Config = serde_json::from_str(text).expect("a preset");
        config.validate().expect("valid");
        let Stage::Base { network, latents, .. } = &config.stage else { panic!("{:?}", config.stage) };
        assert_eq!((**network).clone(), FlowConfig::small());
        assert_eq!((latents.reference_probability, latents.bridge, config.run.steps), (0.5, Bridge::default(), 7));
        let again: Config = serde_json::from_str(&serde_json::to_string(&config).expect("text")).expect("the same");
        assert_eq!(again, config);
        let default = Config::default();
        default.validate().expect("valid");
        let again: Config = serde_json::from_str(&serde_json::to_string(&default).expect("text")).expect("the same");
        assert_eq!(again, default);
        // Checkpoints hold options as JSON, which has no infinity: the run could not be resumed.
        let endless = Config { run: RunConfig { clip_norm: f32::INFINITY, ..default.run }, ..default };
        assert!(endless.validate().expect_err("no bound").to_string().contains("clip_norm"));
        for (text, word) in [
            (r#"{"stage": {"base": {"network": "wan-big"}}}"#, "wan-small"),
            (r#"{"stage": {"base": {"network": "wan-small", "pixels": 1}}}"#, "pixels"),
            (r#"{"stage": {"autoencoder": {"network": {"base_dim": 3}}}}"#, "decoder_base_dim"),
            (r#"{"rate": 3}"#, "`rate`, expected one of `batches`"),
            (r#"{"optimizer": {"rate": 3}}"#, "`rate`, expected one of `batches`"),
            (r#"{"optimizer": "sgd"}"#, "adamw"),
            (r#"{"steps": -3}"#, "u64"),
        ] {
            let error = serde_json::from_str::<Config>(text).expect_err("not a configuration").to_string();
            assert!(error.contains(word), "{error}");
        }
    }
}
