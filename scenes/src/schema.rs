//! The JSON Schema of the scene file, generated from the Rust types (so it cannot drift from what is read).

use crate::description::Scene;

/// JSON Schema (draft 2020-12) of a scene file; `scenes/schema.json` is this, pretty-printed.
pub fn json_schema() -> serde_json::Value {
    schemars::schema_for!(Scene).to_value()
}
