//! What a network is: its inputs, its start point, its size. Stored inside every weights file.

use crate::{Error, Result};
use serde::{Deserialize, Serialize};

/// One group of per-pixel input channels; the order in [`NetworkConfig::inputs`] is the order of the channels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Input {
    /// Base colour, linear, 0..=1 (3 channels).
    Albedo,
    /// Shading normal in camera space, unit (3).
    Normal,
    /// `ln(depth / median depth of the frame) / 2`, clamped to -2..=2 (1).
    Depth,
    /// Roughness, metallic, specular, 0..=1 (3).
    Material,
    /// Unoccluded irradiance / pi at the normal, times exposure, in the log curve (3).
    Irradiance,
    /// Environment prefiltered for this roughness along the mirror direction, times exposure, in the log curve (3).
    Prefiltered,
    /// Split-sum scale and bias on F0, 0..=1 (2).
    Brdf,
    /// Screen-space ambient visibility, 0..=1 (1).
    Occlusion,
    /// Cosine between the bent normal and the normal, -1..=1 (1).
    BentNormal,
    /// Screen-space visibility of the dominant light, 0..=1 (1).
    LightVisibility,
    /// Share of the irradiance that comes from the dominant light, 0..=1 (1).
    LightShare,
    /// Hit coverage of the pixel, 0..=1 (1).
    Coverage,
}

impl Input {
    /// Every input, in the order in which frames are stored in memory.
    pub const ALL: [Self; 12] = [
        Self::Albedo,
        Self::Normal,
        Self::Depth,
        Self::Material,
        Self::Irradiance,
        Self::Prefiltered,
        Self::Brdf,
        Self::Occlusion,
        Self::BentNormal,
        Self::LightVisibility,
        Self::LightShare,
        Self::Coverage,
    ];

    /// Channels of this input.
    pub const fn channels(self) -> usize {
        match self {
            Self::Albedo | Self::Normal | Self::Material | Self::Irradiance | Self::Prefiltered => 3,
            Self::Brdf => 2,
            Self::Depth | Self::Occlusion | Self::BentNormal | Self::LightVisibility | Self::LightShare | Self::Coverage => 1,
        }
    }

    /// First channel of this input in the stored order of [`Input::ALL`].
    pub fn offset(self) -> usize {
        Self::ALL.iter().take_while(|&&other| other != self).map(|other| other.channels()).sum()
    }

    /// `(scale, shift)` that bring the stored value to about -1..=1.
    pub const fn normalisation(self) -> (f32, f32) {
        match self {
            Self::Albedo | Self::Material | Self::Irradiance | Self::Prefiltered => (2.0, -1.0),
            _ => (1.0, 0.0),
        }
    }
}

/// Where the bridge starts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Start {
    /// The split-sum image, with multiplicative heads on its diffuse and specular part.
    #[default]
    Ibl,
    /// The albedo (the paper's start).
    Albedo,
    /// Albedo times unoccluded irradiance.
    AlbedoIrradiance,
}

impl Start {
    /// Channels the network predicts: three heads of three for [`Start::Ibl`], one residual otherwise.
    pub const fn head_channels(self) -> usize {
        match self {
            Self::Ibl => 9,
            Self::Albedo | Self::AlbedoIrradiance => 3,
        }
    }
}

/// The space in which the bridge runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Curve {
    /// `z = 2 log1p(8 x) / log1p(8) - 1`, x = exposure times radiance.
    #[default]
    Log,
    /// `z = 2 sRGB(x) - 1`, the sRGB curve continued above 1.
    Srgb,
}

/// The second-stage network that repairs warped keyframes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct KeyframeConfig {
    /// Channels at 1/2, 1/4 and 1/8 of the resolution.
    pub widths: [usize; 3],
}

impl Default for KeyframeConfig {
    fn default() -> Self {
        Self { widths: [32, 48, 64] }
    }
}

/// Everything that decides the shapes and the meaning of the weights.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NetworkConfig {
    /// Per-pixel inputs besides the bridge state `z_t`.
    pub inputs: Vec<Input>,
    /// Start point.
    pub start: Start,
    /// Space of the bridge.
    pub curve: Curve,
    /// Channels at 1/2, 1/4 and 1/8 of the resolution.
    pub widths: [usize; 3],
    /// Residual blocks at each of these levels on the way down.
    pub encoder_blocks: [usize; 3],
    /// Residual blocks at each of these levels on the way up.
    pub decoder_blocks: [usize; 3],
    /// Channels of the transformer at 1/16; a multiple of `4 * heads`.
    pub token_width: usize,
    /// Attention heads.
    pub heads: usize,
    /// Transformer blocks.
    pub transformer_blocks: usize,
    /// Hidden width of the transformer's perceptron, as a multiple of `token_width`.
    pub mlp_ratio: usize,
    /// Width of the vector that carries time and the pooled environment to every level.
    pub condition_width: usize,
    /// The keyframe stage, when the file has one.
    pub keyframes: Option<KeyframeConfig>,
}

impl Default for NetworkConfig {
    fn default() -> Self {
        Self {
            inputs: Input::ALL.to_vec(),
            start: Start::Ibl,
            curve: Curve::Log,
            widths: [32, 64, 128],
            encoder_blocks: [1, 2, 2],
            decoder_blocks: [1, 1, 1],
            token_width: 192,
            heads: 6,
            transformer_blocks: 4,
            mlp_ratio: 3,
            condition_width: 64,
            keyframes: None,
        }
    }
}

impl NetworkConfig {
    /// A network small enough for unit tests; same graph.
    pub fn tiny() -> Self {
        Self {
            widths: [16, 16, 32],
            encoder_blocks: [1, 1, 1],
            decoder_blocks: [1, 1, 1],
            token_width: 32,
            heads: 2,
            transformer_blocks: 1,
            mlp_ratio: 2,
            condition_width: 32,
            ..Self::default()
        }
    }

    /// Input channels a pixel, `z_t` included.
    pub fn pixel_channels(&self) -> usize {
        3 + self.inputs.iter().map(|input| input.channels()).sum::<usize>()
    }

    /// Checks that the numbers describe a network.
    ///
    /// # Errors
    /// [`Error::Config`] naming the option.
    pub fn validate(&self) -> Result<()> {
        if self.inputs.iter().enumerate().any(|(i, input)| self.inputs[..i].contains(input)) {
            return Err(Error::config("network.inputs", "an input is listed twice"));
        }
        let positive = [
            ("network.widths", self.widths.iter().all(|&w| (1..=4096).contains(&w))),
            ("network.token_width", (4..=4096).contains(&self.token_width)),
            ("network.mlp_ratio", (1..=16).contains(&self.mlp_ratio)),
            ("network.condition_width", (1..=4096).contains(&self.condition_width)),
            ("network.heads", (1..=64).contains(&self.heads)),
            ("network.transformer_blocks", self.transformer_blocks <= 64),
            ("network.encoder_blocks", self.encoder_blocks.iter().all(|&n| n <= 16)),
            ("network.decoder_blocks", self.decoder_blocks.iter().all(|&n| n <= 16)),
        ];
        for (option, valid) in positive {
            if !valid {
                return Err(Error::config(option, "out of range"));
            }
        }
        if !self.token_width.is_multiple_of(4 * self.heads) {
            return Err(Error::config("network.token_width", "must be a multiple of 4 * network.heads"));
        }
        if let Some(keyframes) = &self.keyframes
            && !keyframes.widths.iter().all(|&w| (1..=1024).contains(&w))
        {
            return Err(Error::config("network.keyframes.widths", "out of range"));
        }
        Ok(())
    }
}
