//! Groups of parameters that are trained together: first the renderer, then each optional adapter with the rest frozen.

use super::Flow;
use burn::module::Module;

/// A group of parameters that learn in the same stage.
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
    /// All groups.
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
        // The keyframe adapter corrects perceptrons, and the inverse adapter corrects attention.
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
    /// The same renderer, in which only `group` learns. Only its parameters have gradients, and operations that do not depend on
    /// them are not recorded.
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
