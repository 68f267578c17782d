//! What the page and the program say to each other. All text messages are JSON; their `type` tells which one it is.

use super::method::{Method, Side};
use anyhow::ensure;
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize};
use std::collections::BTreeMap;

/// Sides of pictures, pixels. A page has no room for more.
const SIZE: std::ops::RangeInclusive<u32> = 16..=2048;
/// Fields of view that the page can show, degrees.
pub const FIELDS: std::ops::RangeInclusive<f32> = 1.0..=170.0;
/// Exposure of the page beside the scene's own, stops.
const STOPS: f32 = 16.0;
/// Samples per pixel that the network may be given.
const RAYS: [u32; 4] = [1, 2, 4, 8];

/// From the page.
#[derive(Debug, Deserialize)]
#[serde(tag = "type", rename_all = "lowercase")]
pub enum Request {
    /// Everything that decides the pictures.
    State(Box<State>),
    /// Tone mapping.
    Exposure {
        /// Stops beside the scene's own exposure.
        stops: f32,
    },
    /// Asks which material is seen at a place, in shares of the picture.
    Pick {
        /// From the left edge.
        x: f32,
        /// From the top edge.
        y: f32,
    },
    /// Back to the scene's own camera, light and materials.
    Home,
    /// The page has drawn the last picture.
    Shown,
}

/// What the page shows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct State {
    /// Grows with each message.
    pub id: u64,
    /// Whether more changes come at once, so that a rough picture is better than a late one.
    #[serde(default)]
    pub moving: bool,
    /// What the left side shows.
    pub left: Method,
    /// What the right side shows.
    pub right: Method,
    /// Whether the left side is shown at all.
    pub split: bool,
    /// Where the camera is.
    pub camera: Viewpoint,
    /// The frame of the scene's sequence.
    pub frame: u32,
    /// Rotation of the environment, degrees.
    pub rotation: f32,
    /// Samples per pixel of [`Method::NeuralRays`].
    pub rays: u32,
    /// Columns and rows.
    pub resolution: [u32; 2],
    /// Parameters of materials that were changed: by the material's number, then by the parameter's name.
    #[serde(default, deserialize_with = "by_number")]
    pub materials: BTreeMap<usize, BTreeMap<String, Value>>,
}

/// The names of JSON's fields are text, and serde does not read numbers from them inside of a tagged enum.
fn by_number<'de, D: Deserializer<'de>, T: Deserialize<'de>>(deserializer: D) -> Result<BTreeMap<usize, T>, D::Error> {
    let named = BTreeMap::<String, T>::deserialize(deserializer)?;
    let number = |name: &str| name.parse().map_err(|_| D::Error::custom(format!("{name:?} is not the number of a material")));
    named.into_iter().map(|(name, value)| Ok((number(&name)?, value))).collect()
}

/// A camera in the world.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Viewpoint {
    /// Its position, metres.
    pub eye: [f64; 3],
    /// The point that it looks at, metres.
    pub target: [f64; 3],
    /// Its up direction.
    pub up: [f32; 3],
    /// Degrees.
    pub vertical_fov: f32,
}

/// The value of a parameter.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Value {
    /// A number.
    Number(f32),
    /// Linear RGB.
    Color([f32; 3]),
}

impl State {
    /// What the side shows.
    pub fn method(&self, side: Side) -> Method {
        match side {
            Side::Left => self.left,
            Side::Right => self.right,
        }
    }

    /// The sides that are shown. The right one comes first, because it is the one that is always there.
    pub fn sides(&self) -> &'static [Side] {
        if self.split { &[Side::Right, Side::Left] } else { &[Side::Right] }
    }

    /// Whether the other state has the same scene, seen by the same camera, whatever methods draw it.
    pub fn shows_the_same(&self, other: &Self) -> bool {
        let scene = |state: &Self| Self {
            id: 0,
            moving: false,
            left: Method::Ibl,
            right: Method::Ibl,
            split: false,
            rays: 1,
            ..state.clone()
        };
        scene(self) == scene(other)
    }

    /// Refuses numbers with which nothing can be rendered.
    ///
    /// # Errors
    /// When a number is outside its range.
    pub fn check(&self) -> anyhow::Result<()> {
        let Viewpoint { eye, target, up, .. } = &self.camera;
        let finite = eye.iter().chain(target).all(|v| v.is_finite() && v.abs() < 1e9) && up.iter().all(|v| v.is_finite());
        ensure!(finite, "the camera is at no place of this world");
        ensure!(eye != target, "the camera is where it looks");
        ensure!(FIELDS.contains(&self.camera.vertical_fov), "a field of view of {} degrees", self.camera.vertical_fov);
        ensure!(self.rotation.is_finite() && self.rotation.abs() < 1e6, "a rotation of {} degrees", self.rotation);
        ensure!(self.resolution.iter().all(|side| SIZE.contains(side)), "a picture of {:?} pixels", self.resolution);
        ensure!(RAYS.contains(&self.rays), "{} samples", self.rays);
        let values = self.materials.values().flat_map(BTreeMap::values);
        let whole = |value: &Value| match value {
            Value::Number(v) => v.is_finite(),
            Value::Color(color) => color.iter().all(|v| v.is_finite()),
        };
        ensure!(values.into_iter().all(whole), "a material with a number that is none");
        Ok(())
    }
}

/// The size of a scene's pictures, made to fit the page: smaller pictures with the same shape as far as whole pixels allow.
pub fn fitting(resolution: [u32; 2]) -> [u32; 2] {
    let longer = f64::from(resolution[0].max(resolution[1]).max(1));
    let scale = (f64::from(*SIZE.end()) / longer).min(1.0);
    resolution.map(|side| ((f64::from(side) * scale).round() as u32).clamp(*SIZE.start(), *SIZE.end()))
}

/// Exposure that is not beyond all use.
pub fn stops(stops: f32) -> f32 {
    if stops.is_finite() { stops.clamp(-STOPS, STOPS) } else { 0.0 }
}

/// To the page, as text.
#[derive(Debug, Serialize)]
#[serde(tag = "type", rename_all = "lowercase")]
pub enum Message {
    /// The first message.
    Hello(Box<Hello>),
    /// The state that the program went back to.
    State {
        /// The state.
        state: Box<State>,
    },
    /// PSNR of the pictures that stand, in dB against the reference.
    Psnr {
        /// Id of the state.
        state: u64,
        /// Of the left picture.
        left: Option<f64>,
        /// Of the right picture.
        right: Option<f64>,
        /// Samples per pixel of the reference.
        reference: u32,
    },
    /// Answer to [`Request::Pick`].
    Pick {
        /// The number of the material; `None` where there is the background.
        material: Option<usize>,
    },
    /// For the user to read.
    Note {
        /// One sentence.
        text: String,
    },
    /// The last message.
    End {
        /// Why there is no more.
        text: String,
    },
}

/// What there is to see and to change.
#[derive(Debug, Serialize)]
pub struct Hello {
    /// Name of the scene.
    pub name: String,
    /// Columns and rows that the scene asks for.
    pub resolution: [u32; 2],
    /// Number of frames.
    pub frames: u32,
    /// What a side can show.
    pub methods: Vec<Choice>,
    /// What can be changed of a material.
    pub parameters: Vec<Parameter>,
    /// The materials.
    pub materials: Vec<MaterialValues>,
    /// The state to begin with.
    pub state: State,
}

/// A method in a list.
#[derive(Debug, Serialize)]
pub struct Choice {
    /// Which one.
    pub name: Method,
    /// Its name for people.
    pub label: &'static str,
    /// The part of the list that it stands in.
    pub group: &'static str,
}

/// A parameter of materials.
#[derive(Debug, Serialize)]
pub struct Parameter {
    /// Its name in scene files.
    pub name: String,
    /// Its name for people.
    pub label: String,
    /// `number` or `color`.
    pub r#type: &'static str,
    /// Least and greatest value.
    pub range: [f32; 2],
}

/// A material as the scene has it.
#[derive(Debug, Serialize)]
pub struct MaterialValues {
    /// Its name.
    pub name: String,
    /// Whether textures change it from place to place; its parameters are factors then.
    pub textured: bool,
    /// Its parameters.
    pub values: BTreeMap<String, Value>,
}

/// The header of a picture.
#[derive(Clone, Debug, Serialize)]
pub struct Picture {
    /// `picture`.
    pub r#type: &'static str,
    /// Where it belongs.
    pub side: Side,
    /// How it was made.
    pub method: Method,
    /// Id of the state that it shows.
    pub state: u64,
    /// Columns and rows.
    pub size: [usize; 2],
    /// How many times smaller it is than what was asked for.
    pub scale: u32,
    /// Samples per pixel; 0 for methods that trace none.
    pub samples: u32,
    /// Seconds that it took, of all its samples.
    pub seconds: f64,
    /// PSNR in dB against the reference of this state.
    pub psnr: Option<f64>,
    /// Samples per pixel of that reference.
    pub reference: Option<u32>,
    /// Whether it will get no better.
    pub done: bool,
}
