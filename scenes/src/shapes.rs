//! Parametric shapes and their meshes.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A parametric shape, about 1 metre in size, centred at the origin.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields, tag = "family")]
pub enum Shape {
    /// A square in the plane y = 0, facing +y.
    Plane {
        /// Edge length, metres, > 0.
        size: f32,
    },
}
