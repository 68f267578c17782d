//! How many parameters the renderer has, item by item.

use super::{Flow, FlowConfig, Group};
use crate::Result;
use crate::wan::names::{Entry, Named};
use crate::wan::vae::Vae;
use burn::tensor::Device;
use std::fmt;

/// Parameters of one part.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Item {
    /// Which part.
    pub part: Part,
    /// Values.
    pub parameters: u64,
}

/// What parameters are counted by.
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
    /// Embedder of pictures on the way back.
    InverseEmbedder,
    /// Corrections of self-attention on the way back.
    InverseLora,
    /// Prompts, and attention to them, one a block.
    InversePrompts,
    /// Heads of the intrinsics.
    InverseHeads,
}

impl Part {
    /// All of them, in the order they are added up.
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

    /// In words.
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

/// Parameters of every part a renderer has; displays as a table.
///
/// The paper gives two numbers, 1.4 B without and 1.7 B with keyframes. They are met when the autoencoder is counted (as the numbers
/// it gives for other methods count theirs) and each block has one projection of the environment and, with keyframes, an attention
/// of its own; the rank of the perceptrons' correction is not told by them (8 to 64 all round to 1.7 B). Two projections a block and
/// no autoencoder would give 1.411 B and 1.69 to 1.72 B, which cannot be excluded; VACE's whole context path (734 M more) can be.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Account {
    /// In the order of [`Part::ALL`]; parts the renderer lacks are left out.
    pub items: Vec<Item>,
}

impl Account {
    /// Parameters of one part, 0 where there is none.
    pub fn of(&self, part: Part) -> u64 {
        self.items.iter().filter(|item| item.part == part).map(|item| item.parameters).sum()
    }

    /// All parts together.
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

impl FlowConfig {
    /// Counts the parameters of this renderer and its autoencoder, from shapes alone: nothing is made.
    ///
    /// # Errors
    /// When the configuration is invalid.
    pub fn account(&self) -> Result<Account> {
        let device = Device::flex();
        let entries = Flow::new(self, 0, &device)?.entries();
        let autoencoder = Vae::new(&self.vae, 0, &device)?.count();
        let sum = |part| entries.iter().filter(|e| Part::of_tensor(&e.diffusers) == part).map(Entry::parameters).sum();
        let item = |part| Item { part, parameters: if part == Part::Autoencoder { autoencoder } else { sum(part) } };
        Ok(Account { items: Part::ALL.into_iter().map(item).filter(|item| item.parameters > 0).collect() })
    }
}
