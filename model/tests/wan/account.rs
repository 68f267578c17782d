//! Number of parameters of each part of the renderer.

use burn::tensor::Device;
use renderflow_model::wan::flow::Group;
use renderflow_model::wan::names::{Entry, Named};
use renderflow_model::wan::{Flow, FlowConfig, Vae};
use std::fmt;

/// Parameters of one part.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Item {
    /// The part.
    pub part: Part,
    /// Number of values.
    pub parameters: u64,
}

/// A part of the renderer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Part {
    /// The transformer without text, with the albedo's embedder.
    Backbone,
    /// Embedder of the other buffers and the masked reference.
    AttributeEmbedder,
    /// Embedder of the environment.
    EnvironmentEmbedder,
    /// Projections of the environment, one a block.
    EnvironmentAdapter,
    /// Autoencoder.
    Autoencoder,
    /// Attention to keyframes, one a block.
    KeyframeAttention,
    /// Embedder of keyframes.
    KeyframeEmbedder,
    /// Corrections of the perceptrons with keyframes.
    KeyframeLora,
    /// Embedder of pictures for inverse rendering.
    InverseEmbedder,
    /// Corrections of self-attention for inverse rendering.
    InverseLora,
    /// Prompts, and attention to them, one a block.
    InversePrompts,
    /// Heads of the intrinsics.
    InverseHeads,
}

impl Part {
    /// All parts, in the order in which they are listed.
    pub const ALL: [Self; 12] = [
        Self::Backbone,
        Self::AttributeEmbedder,
        Self::EnvironmentEmbedder,
        Self::EnvironmentAdapter,
        Self::Autoencoder,
        Self::KeyframeAttention,
        Self::KeyframeEmbedder,
        Self::KeyframeLora,
        Self::InverseEmbedder,
        Self::InverseLora,
        Self::InversePrompts,
        Self::InverseHeads,
    ];

    /// Name for tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Backbone => "backbone",
            Self::AttributeEmbedder => "attribute embedder",
            Self::EnvironmentEmbedder => "environment embedder",
            Self::EnvironmentAdapter => "environment adapter",
            Self::Autoencoder => "autoencoder",
            Self::KeyframeAttention => "keyframe attention",
            Self::KeyframeEmbedder => "keyframe embedder",
            Self::KeyframeLora => "keyframe LoRA",
            Self::InverseEmbedder => "inverse embedder",
            Self::InverseLora => "inverse LoRA",
            Self::InversePrompts => "inverse prompts",
            Self::InverseHeads => "inverse heads",
        }
    }

    /// The part a tensor of [`Flow`] belongs to, by its diffusers name.
    fn of_tensor(name: &str) -> Self {
        let has = |piece: &str| name.contains(piece);
        match Group::of_tensor(name) {
            Group::Keyframes if has(".lora_") => Self::KeyframeLora,
            Group::Keyframes if has("keyframe_embedding") => Self::KeyframeEmbedder,
            Group::Keyframes => Self::KeyframeAttention,
            Group::Inverse if has(".lora_") => Self::InverseLora,
            Group::Inverse if has("inverse_embedding") => Self::InverseEmbedder,
            Group::Inverse if has("inverse_heads") => Self::InverseHeads,
            Group::Inverse => Self::InversePrompts,
            Group::Base if has("attribute_embedding") => Self::AttributeEmbedder,
            Group::Base if has("environment_embedding") => Self::EnvironmentEmbedder,
            Group::Base if has("environment_proj") => Self::EnvironmentAdapter,
            Group::Base => Self::Backbone,
        }
    }
}

/// The number of parameters of every part that a renderer has. It displays as a table.
///
/// The paper states two totals: 1.4 B without keyframes, and 1.7 B with them. The counts agree with both if the autoencoder is
/// included (as it is in the totals that the paper gives for other methods), and if each block has one projection of the
/// environment and, with keyframes, an attention of its own. The totals do not determine the rank of the perceptrons' correction:
/// 8 to 64 all round to 1.7 B. They also fit two projections per block without the autoencoder (1.411 B and 1.69 to 1.72 B), but
/// not VACE's whole context path, which has 734 M parameters more.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Account {
    /// In the order of [`Part::ALL`], without the parts that the renderer lacks.
    pub items: Vec<Item>,
}

impl Account {
    /// Parameters of one part; 0 if the renderer lacks it.
    pub fn of(&self, part: Part) -> u64 {
        self.items.iter().filter(|item| item.part == part).map(|item| item.parameters).sum()
    }

    /// Parameters of all parts.
    pub fn total(&self) -> u64 {
        self.items.iter().map(|item| item.parameters).sum()
    }
}

impl fmt::Display for Account {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        for item in &self.items {
            writeln!(f, "{:22}{:>14}", item.part.name(), item.parameters)?;
        }
        write!(f, "{:22}{:>14}", "total", self.total())
    }
}

/// Counts the parameters of a renderer and its autoencoder from their shapes. No weights are made.
pub fn account(config: &FlowConfig) -> Account {
    let device = Device::flex();
    let entries = Flow::new(config, 0, &device).expect("valid").entries();
    let autoencoder = Vae::new(&config.vae, 0, &device).expect("valid").count();
    let sum = |part| entries.iter().filter(|e| Part::of_tensor(&e.diffusers) == part).map(Entry::parameters).sum();
    let item = |part| Item { part, parameters: if part == Part::Autoencoder { autoencoder } else { sum(part) } };
    Account { items: Part::ALL.into_iter().map(item).filter(|item| item.parameters > 0).collect() }
}
