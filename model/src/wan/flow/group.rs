//! Which parameters learn together: the renderer first, then each optional adapter with the rest frozen.

use super::Flow;
use burn::module::Module;

/// Parameters that learn in the same stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Group {
    /// Stage 1: backbone, the embedders of attributes and environment, the environment's projections.
    Base,
    /// Stage 2: the keyframe adapter.
    Keyframes,
    /// The inverse adapter.
    Inverse,
}

impl Group {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Base, Self::Keyframes, Self::Inverse];

    /// The group of a parameter of [`Flow`], by its name in [`crate::parameters`] (a path of fields, such as
    /// `keyframes.blocks.0.to_k.weight`).
    pub fn of(parameter: &str) -> Self {
        match parameter.split('.').next() {
            Some("keyframes") => Self::Keyframes,
            Some("inverse") => Self::Inverse,
            _ => Self::Base,
        }
    }

    /// The group of a tensor in a file, by its name under either naming (see [`crate::wan::names::Entry`]).
    pub fn of_tensor(name: &str) -> Self {
        let part = if name.starts_with("blocks.") { name.splitn(3, '.').nth(2) } else { Some(name) }.unwrap_or_default();
        // With keyframes the perceptrons are corrected, on the way back the attention.
        let (corrects, perceptron) = (part.contains(".lora_"), part.starts_with("ffn."));
        if part.starts_with("keyframe_") || (corrects && perceptron) {
            Self::Keyframes
        } else if part.starts_with("inverse_") || corrects {
            Self::Inverse
        } else {
            Self::Base
        }
    }
}

impl Flow {
    /// The same renderer with only `group` learning: gradients are found for its parameters alone, and whatever depends on none of
    /// them is not recorded.
    pub fn learn_only(self, group: Group) -> Self {
        let learns = |of| of == group;
        Self {
            dit: self.dit.set_require_grad(learns(Group::Base)),
            attributes: self.attributes.set_require_grad(learns(Group::Base)),
            environment: self.environment.set_require_grad(learns(Group::Base)),
            keyframes: self.keyframes.map(|adapter| adapter.set_require_grad(learns(Group::Keyframes))),
            inverse: self.inverse.map(|adapter| adapter.set_require_grad(learns(Group::Inverse))),
            config: self.config,
        }
    }
}
