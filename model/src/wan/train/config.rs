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
    /// Rows and columns in pixels, a multiple of what a token (of an autoencoder: a latent pixel) spans.
    pub size: usize,
    /// Frames of an item: 1, or 1 more than a latent frame spans (5 with Wan's autoencoder).
    pub frames: usize,
    /// Items of a batch.
    pub items: usize,
    /// Relative frequency.
    pub weight: f32,
}

/// What is minimised when an autoencoder is trained: `|x - y|` and these.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AutoencoderLoss {
    /// Weight of the difference of gradient magnitudes.
    pub gradient: f32,
    /// Weight of the divergence of latents from a normal distribution, a latent value. Small: it keeps latents of one scale without
    /// costing detail (Rombach et al. 2022 weigh it with 1e-6 of a sum, which is 1e-7 here).
    pub divergence: f32,
    /// Weight of LPIPS; 0 for none.
    pub lpips: f32,
}

impl Default for AutoencoderLoss {
    fn default() -> Self {
        Self { gradient: 0.5, divergence: 1e-5, lpips: 0.0 }
    }
}

/// What is minimised when the renderer is trained: the squared error of the velocity in the latents, and these on decoded predictions.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PixelLoss {
    /// Weight of LPIPS and gradients together, the paper's lambda, which it does not tell (LBM: 10); 0 decodes nothing.
    pub weight: f32,
    /// Of which LPIPS; 0 to train without its weights.
    pub lpips: f32,
    /// Of which the difference of gradient magnitudes.
    pub gradient: f32,
    /// Steps from one decoded prediction to the next; each then counts once. Decoding takes longer than the rest of a step.
    pub period: u64,
    /// Side of the decoded window in latent pixels; less than the latent has, where it is larger.
    pub window: usize,
}

impl Default for PixelLoss {
    fn default() -> Self {
        Self { weight: 10.0, lpips: 1.0, gradient: 1.0, period: 4, window: 16 }
    }
}

/// Settings that every stage of the renderer's training has.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LatentConfig {
    /// Weights file of the autoencoder, frozen.
    pub autoencoder: PathBuf,
    /// Noise and times.
    pub bridge: Bridge,
    /// Losses on decoded predictions.
    pub pixels: PixelLoss,
    /// Probability that a clip's first frame is given; the paper does not tell it.
    pub reference_probability: f32,
    /// Whether activations are computed again block by block in the backward pass: slower by a third, memory of one block.
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
    /// An autoencoder, on pictures of all kinds.
    Autoencoder {
        /// The network, where training does not start from a file, or the name of a preset ([`FlowConfig::PRESETS`]); its statistics
        /// of latents are measured in training.
        #[serde(default = "small_autoencoder", deserialize_with = "autoencoder_or_preset")]
        network: VaeConfig,
        /// Weights file to start from.
        #[serde(default)]
        start: Option<PathBuf>,
        /// What is minimised.
        #[serde(default)]
        loss: AutoencoderLoss,
    },
    /// The renderer without optional adapters.
    Base {
        /// The network, or the name of a preset ([`FlowConfig::PRESETS`]); its autoencoder is replaced by that of the file.
        #[serde(deserialize_with = "network_or_preset")]
        network: Box<FlowConfig>,
        /// Weights file to start from: one of this program, or published ones of Wan or VACE.
        #[serde(default)]
        start: Option<PathBuf>,
        /// The rest.
        #[serde(default)]
        latents: LatentConfig,
    },
    /// The keyframe adapter on a frozen renderer.
    Keyframes {
        /// Weights file of the renderer.
        base: PathBuf,
        /// The adapter; a renderer that has one keeps it.
        #[serde(default)]
        network: KeyframeConfig,
        /// Frames from a keyframe to the next, counted as sequences count them.
        #[serde(default = "sixteen")]
        gap: usize,
        /// The rest.
        #[serde(default)]
        latents: LatentConfig,
    },
    /// The inverse adapter on a frozen renderer.
    Inverse {
        /// Weights file of the renderer.
        base: PathBuf,
        /// The adapter; a renderer that has one keeps it.
        #[serde(default)]
        network: InverseConfig,
        /// Weight of LPIPS in the loss of the albedo.
        #[serde(default)]
        lpips: f32,
        /// Weight of the squared error of latents, which costs no decoding. The paper has none; where a prediction is not decoded
        /// ([`PixelLoss::period`]) it is all there is.
        #[serde(default = "one")]
        latent: f32,
        /// The rest; of its pixel losses, `weight` scales those of the intrinsics.
        #[serde(default)]
        latents: LatentConfig,
    },
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
    let unknown = || D::Error::custom(format!("{name} is none of the presets {}", FlowConfig::PRESETS.join(", ")));
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
    /// Folder where latents are kept for resumptions of this run and for later stages with the same autoencoder. Without it, each run
    /// encodes all frames again, which takes longer than reading latents.
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
    /// [`Error::Config`] naming the option.
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
                    ("stage.loss", [loss.gradient, loss.divergence, loss.lpips].into_iter().all(weight), "weights must be >= 0"),
                ])
            }
            Stage::Base { network, latents, .. } => {
                network.validate()?;
                let plain = network.keyframes.is_none() && network.inverse.is_none();
                all([("stage.network", plain, "adapters are trained in stages of their own: leave keyframes and inverse out")])?;
                latents.validate()
            }
            Stage::Keyframes { gap, latents, .. } => {
                all([("stage.gap", (1..=4096).contains(gap), "must be 1..=4096")])?;
                latents.validate()
            }
            Stage::Inverse { lpips, latent, latents, .. } => {
                all([
                    ("stage.lpips", weight(*lpips), "must be a number >= 0"),
                    ("stage.latent", weight(*latent), "must be a number >= 0"),
                    ("stage.latent", *latent > 0.0 || latents.pixels.weight > 0.0, "nothing would be minimised"),
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
                "weights must be >= 0",
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
