//! Environment maps made from parameters: analytic skies, overcast, studios, nights. The maps in `hdri/` are made here.

use renderflow_frame::image::Rgb;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Parameters of a generated environment map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields, tag = "family")]
pub enum Sky {
    /// The same radiance everywhere, darker below the horizon.
    Uniform {
        /// Scene-linear radiance.
        radiance: [f32; 3],
    },
}

/// Map of `sky` at `width x height`, equal to its own `.hdr` encoding read back.
pub fn render(_sky: &Sky, _width: usize, _height: usize) -> Rgb {
    todo!()
}
