//! Materials that change along a sequence.

use crate::Principled;
use glam::Vec3A;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What a material is at the last frame of the sequence; in between it changes evenly. What is left out stays.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct MaterialChange {
    /// Linear Rec.709, 0..=1.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(inner(inner(range(min = 0, max = 1))))]
    pub base_color: Option<[f32; 3]>,
    /// 0..=1.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0, max = 1))]
    pub metallic: Option<f32>,
    /// 0..=1.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0, max = 1))]
    pub roughness: Option<f32>,
    /// 0..=1.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0, max = 1))]
    pub specular: Option<f32>,
}

impl MaterialChange {
    /// The parameters at the last frame of a material that starts as `first`.
    pub(crate) fn applied(&self, first: Principled) -> Principled {
        Principled {
            base_color: self.base_color.map_or(first.base_color, Vec3A::from_array),
            metallic: self.metallic.unwrap_or(first.metallic),
            roughness: self.roughness.unwrap_or(first.roughness),
            specular: self.specular.unwrap_or(first.specular),
            ..first
        }
    }
}
