//! Materials that change along a sequence.

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
