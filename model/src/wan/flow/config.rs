//! Sizes and variants of the renderer: presets and their limits.

use crate::wan::config::{DitConfig, VaeConfig};
use crate::wan::pictures::BridgeStart;
use crate::{Error, Result};
use serde::{Deserialize, Serialize};

/// How the environment modulates the tokens.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Environment {
    /// One factor and one offset for each latent frame, from the mean of its environment tokens. The paper leaves this choice
    /// open.
    #[default]
    Pooled,
    /// A factor and an offset for each token, from the environment token at the same position. Environment latents have the size
    /// of the picture's latents.
    Tokens,
}

/// The source of the queries of keyframe attention.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Query {
    /// A projection of the adapter, which is best in the paper.
    #[default]
    Dedicated,
    /// The queries of self-attention, which is the paper's cheaper variant.
    Reused,
}

/// The keyframe adapter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct KeyframeConfig {
    /// The source of the queries.
    pub query: Query,
    /// Rank of the correction of both layers of each perceptron, or 0 for no correction. The paper does not state it: ranks of 8
    /// to 64 all give its total of 1.7 B parameters.
    pub lora_rank: usize,
    /// The correction is scaled by `lora_alpha / lora_rank`, which is 1 by default.
    pub lora_alpha: f32,
}

impl Default for KeyframeConfig {
    fn default() -> Self {
        Self { query: Query::Dedicated, lora_rank: 32, lora_alpha: 32.0 }
    }
}

/// The inverse adapter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct InverseConfig {
    /// Rank of the correction of queries, keys and values of each self-attention, or 0 for no correction. The paper does not
    /// state it.
    pub lora_rank: usize,
    /// The correction is scaled by `lora_alpha / lora_rank`.
    pub lora_alpha: f32,
    /// Number of prompts: one for each [`Intrinsic`], and reserves for intrinsics that are added to trained weights.
    pub prompts: usize,
    /// Number of tokens in a prompt.
    pub prompt_tokens: usize,
}

impl Default for InverseConfig {
    fn default() -> Self {
        Self { lora_rank: 32, lora_alpha: 32.0, prompts: 5, prompt_tokens: 4 }
    }
}

/// A buffer that inverse rendering recovers.
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Intrinsic {
    /// Base colour.
    Albedo,
    /// Normals in camera space.
    Normal,
    /// Depth, in three equal channels.
    Depth,
    /// Roughness, metallic, specular.
    Material,
}

impl Intrinsic {
    /// All intrinsics. The index of an intrinsic is also the index of its prompt and of its head.
    pub const ALL: [Self; 4] = [Self::Albedo, Self::Normal, Self::Depth, Self::Material];

    /// Name in files and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Albedo => "albedo",
            Self::Normal => "normal",
            Self::Depth => "depth",
            Self::Material => "material",
        }
    }

    /// Index in [`Self::ALL`].
    pub fn index(self) -> usize {
        self as usize
    }
}

/// Number of buffers besides the albedo: normal, depth, material. Each is encoded as a picture.
const BUFFERS: usize = 3;

/// The renderer: its autoencoder, its transformer and its adapters.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FlowConfig {
    /// The autoencoder. It determines the channels of latents and masks.
    pub vae: VaeConfig,
    /// The transformer, without text.
    pub dit: DitConfig,
    /// How the environment modulates the tokens.
    #[serde(default)]
    pub environment: Environment,
    /// What the bridge begins with.
    #[serde(default, skip_serializing_if = "BridgeStart::is_albedo")]
    pub bridge_start: BridgeStart,
    /// The keyframe adapter, if there is one.
    #[serde(default)]
    pub keyframes: Option<KeyframeConfig>,
    /// The inverse adapter, if there is one.
    #[serde(default)]
    pub inverse: Option<InverseConfig>,
}

impl FlowConfig {
    /// The paper's renderer on Wan2.1 1.3B: 1396.4 M parameters with the autoencoder, 1700.0 M with the default keyframe adapter.
    pub fn wan_1_3b() -> Self {
        Self::plain(VaeConfig::wan(), DitConfig::wan_1_3b().without_text())
    }

    /// The same graph at a size that a CPU can train: 15 M parameters, or 20 M with the default keyframe adapter. It has a small
    /// autoencoder of its own. The statistics of its latents are 0 and 1 until training measures them.
    pub fn small() -> Self {
        let vae = VaeConfig {
            base_dim: 16,
            decoder_base_dim: 24,
            num_res_blocks: 1,
            latents_mean: vec![0.0; 16],
            latents_std: vec![1.0; 16],
            ..VaeConfig::wan()
        };
        let dit = DitConfig { heads: 5, head_dim: 64, ffn_dim: 1280, layers: 10, text_dim: None, ..DitConfig::wan_1_3b() };
        Self::plain(vae, dit)
    }

    /// The same graph at a size for unit tests.
    pub fn tiny() -> Self {
        Self::plain(VaeConfig::tiny(), DitConfig::tiny().without_text())
    }

    fn plain(vae: VaeConfig, dit: DitConfig) -> Self {
        Self { vae, dit, environment: Environment::Pooled, bridge_start: BridgeStart::Albedo, keyframes: None, inverse: None }
    }

    /// Names of the presets.
    pub const PRESETS: [&str; 3] = ["wan-1.3b", "wan-small", "wan-tiny"];

    /// The preset of a name, without optional adapters.
    pub fn preset(name: &str) -> Option<Self> {
        match name {
            "wan-1.3b" => Some(Self::wan_1_3b()),
            "wan-small" => Some(Self::small()),
            "wan-tiny" => Some(Self::tiny()),
            _ => None,
        }
    }

    /// The same with a keyframe adapter.
    pub fn with_keyframes(self, keyframes: KeyframeConfig) -> Self {
        Self { keyframes: Some(keyframes), ..self }
    }

    /// The same with an inverse adapter.
    pub fn with_inverse(self, inverse: InverseConfig) -> Self {
        Self { inverse: Some(inverse), ..self }
    }

    /// Channels of the masked reference: inactive latents, reactive latents, and the cells of the mask.
    pub fn reference_channels(&self) -> usize {
        2 * self.vae.z_dim + self.mask_channels()
    }

    /// Channels of the mask: one for each pixel that a latent pixel covers.
    pub fn mask_channels(&self) -> usize {
        self.vae.spatial_factor().pow(2)
    }

    /// Latent channels of the buffers in [`super::Conditions::attributes`]; the albedo is one of them if the bridge begins with
    /// noise.
    pub fn buffer_channels(&self) -> usize {
        (BUFFERS + usize::from(self.bridge_start == BridgeStart::Noise)) * self.vae.z_dim
    }

    /// Channels of [`super::Conditions::attributes`].
    pub fn attribute_channels(&self) -> usize {
        self.reference_channels() + self.buffer_channels()
    }

    /// Pixels a token spans in height and in width: what sizes of pictures are multiples of.
    pub fn pixel_multiple(&self) -> usize {
        self.vae.spatial_factor() * self.dit.patch_size[1].max(self.dit.patch_size[2])
    }

    /// Checks that the numbers describe a network.
    ///
    /// # Errors
    /// [`Error::Config`] naming the option.
    pub fn validate(&self) -> Result<()> {
        self.vae.validate()?;
        self.dit.validate()?;
        let check = |option, valid: bool, reason: &str| if valid { Ok(()) } else { Err(Error::config(option, reason)) };
        check("dit.text_dim", self.dit.text_dim.is_none(), "the renderer reads no text; leave it out")?;
        let z = self.vae.z_dim;
        check("dit.in_channels", self.dit.in_channels == z, "must be the autoencoder's z_dim")?;
        check("dit.out_channels", self.dit.out_channels == z, "must be the autoencoder's z_dim")?;
        let [frames, rows, columns] = self.dit.patch_size;
        check(
            "dit.patch_size",
            frames == 1,
            "a token spans one latent frame: keyframes and environment are given frame by frame",
        )?;
        check("dit.patch_size", rows == columns, "must be square")?;
        let rank = 0..=self.dit.width().min(4096);
        let alpha = |alpha: f32| alpha.is_finite() && alpha > 0.0;
        if let Some(keyframes) = &self.keyframes {
            check("keyframes.lora_rank", rank.contains(&keyframes.lora_rank), "must be 0 to the width of a token")?;
            check("keyframes.lora_alpha", alpha(keyframes.lora_alpha), "must be a positive number")?;
        }
        if let Some(inverse) = &self.inverse {
            let reason = "must be the albedo: the inverse adapter turns that bridge around";
            check("bridge_start", self.bridge_start.is_albedo(), reason)?;
            check("inverse.lora_rank", rank.contains(&inverse.lora_rank), "must be 0 to the width of a token")?;
            check("inverse.lora_alpha", alpha(inverse.lora_alpha), "must be a positive number")?;
            let prompts = Intrinsic::ALL.len()..=1024;
            check("inverse.prompts", prompts.contains(&inverse.prompts), "must be 4 (one for each intrinsic) to 1024")?;
            check("inverse.prompt_tokens", (1..=1024).contains(&inverse.prompt_tokens), "must be 1 to 1024")?;
        }
        Ok(())
    }
}
