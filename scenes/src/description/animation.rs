//! How an animation of a model file is played.

use super::exact;
use renderflow_frame::words::shortened;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::convert::Infallible;
use std::str::FromStr;

/// An animation of the object's model file. Frame i shows the second `start` + i / `frames_per_second`; past its end the
/// animation starts again.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Animation {
    /// The file's animation; the first one without it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clip: Option<NameOrNumber>,
    /// Frames in a second of the animation, 0.001..=1e6.
    #[serde(default = "film", serialize_with = "exact::number")]
    #[schemars(range(min = 0.001, max = 1e6))]
    pub frames_per_second: f64,
    /// Second of the animation that the first frame shows, 0..=1e6.
    #[serde(default, serialize_with = "exact::number")]
    #[schemars(range(min = 0, max = 1e6))]
    pub start: f64,
}

fn film() -> f64 {
    24.0
}

impl Default for Animation {
    fn default() -> Self {
        Self { clip: None, frames_per_second: film(), start: 0.0 }
    }
}

/// A full turn of an animation and a share of it this small are the same moment: frames and key times are rounded.
const SAME: f64 = 1e-6;

impl Animation {
    /// The second that `frame`, counted from 0, shows of an animation that lasts `length` seconds.
    pub fn second(&self, frame: u32, length: f64) -> f64 {
        let second = self.start + f64::from(frame) / self.frames_per_second;
        let turns = second / length;
        if length <= 0.0 || turns < 1.0 - SAME {
            return second;
        }
        let share = turns.fract();
        if share > 1.0 - SAME { 0.0 } else { share * length }
    }

    /// Frames of one turn of an animation of `length` seconds; at least one.
    pub fn frames(&self, length: f64) -> f64 {
        (length * self.frames_per_second * (1.0 - SAME)).ceil().max(1.0)
    }
}

/// One of several things in a file, by its name or by its number, counted from 0.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum NameOrNumber {
    /// Number, counted from 0.
    Number(u32),
    /// Name. The text of a number is that number, unless something has this name.
    Name(String),
}

impl FromStr for NameOrNumber {
    type Err = Infallible;

    fn from_str(text: &str) -> Result<Self, Infallible> {
        Ok(Self::Name(text.to_owned()))
    }
}

impl NameOrNumber {
    /// The position of what is chosen among things that have these names.
    pub(crate) fn find<'a>(&self, names: impl Iterator<Item = Option<&'a str>> + Clone) -> Option<usize> {
        let number = match self {
            Self::Number(number) => Some(*number as usize),
            Self::Name(name) => match names.clone().position(|other| other == Some(name)) {
                Some(found) => return Some(found),
                None => name.parse().ok(),
            },
        };
        let count = names.count();
        number.filter(|number| *number < count)
    }
}

impl std::fmt::Display for NameOrNumber {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Number(number) => write!(f, "{number}"),
            Self::Name(name) => write!(f, "{:?}", shortened(name)),
        }
    }
}
