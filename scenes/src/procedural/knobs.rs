//! What a plan says about composition.

use super::materials::MaterialKnobs;
use serde::{Deserialize, Serialize};

/// Knobs of composition, the section `composition` of a plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Composition {
    /// How often each layout comes.
    pub layouts: Layouts,
    /// How often each kind of camera comes.
    pub cameras: Cameras,
    /// Fewest and most objects of a scene (floors, walls and plain furniture not counted), each 1..=64; 4 and 16.
    pub objects: [u32; 2],
    /// Share of sequences in which one to four objects move, 0..=1; 0.3. A fixed camera has moving objects or changing materials
    /// beyond this share, unless both shares are 0.
    pub moving: f64,
    /// Share of sequences in which materials change, 0..=1; 0.15.
    pub changing: f64,
    /// Share of scenes with walls, slabs or trees out of the camera's view that shade what it sees, 0..=1; 0.3.
    pub occluders: f64,
    /// Share of rooms with lamps (surfaces that emit), 0..=1; 0: the published setting is light from the environment alone.
    pub lamps: f64,
    /// Share of scenes in which some objects are of glass, 0..=1, where any has a single closed surface; 0.12. A plan file that
    /// leaves it out has none, as plans had before there was glass; so it is with the next four.
    #[serde(default = "none", skip_serializing_if = "is_none")]
    pub glass: f64,
    /// Share of scenes with a basin of water, 0..=1; 0.06.
    #[serde(default = "none", skip_serializing_if = "is_none")]
    pub water: f64,
    /// Share of rooms with panes in their openings, 0..=1; 0.3.
    #[serde(default = "none", skip_serializing_if = "is_none")]
    pub panes: f64,
    /// Share of scenes in open country whose trees have leaves with holes between them, 0..=1; 0.4.
    #[serde(default = "none", skip_serializing_if = "is_none")]
    pub leaves: f64,
    /// Share of scenes with one to three points or spots that light what the camera looks at, 0..=1; 0.06.
    #[serde(default = "none", skip_serializing_if = "is_none")]
    pub lights: f64,
    /// How often materials are what.
    pub materials: MaterialKnobs,
    /// Least and greatest gain of the environment, drawn evenly in its logarithm, each 0.001..=1000; 0.5 and 2.
    pub intensity: [f32; 2],
    /// Turn of an orbiting camera from a frame to the next, degrees, -45..=45; 3.6 turns once in 100 frames.
    pub degrees_per_frame: f32,
    /// Share of objects taken from the pool's model files, where it has any, 0..=1; 0.25.
    pub user_models: f64,
    /// Share of environments taken from the pool's image files, where it has any, 0..=1; 0.25.
    pub user_hdris: f64,
    /// Share of the other environments taken from the pool's named maps of `hdri/`, where it has any, 0..=1; 0.25.
    pub builtin_maps: f64,
}

impl Default for Composition {
    fn default() -> Self {
        Self {
            layouts: Layouts::default(),
            cameras: Cameras::default(),
            objects: [4, 16],
            moving: 0.3,
            changing: 0.15,
            occluders: 0.3,
            lamps: 0.0,
            glass: 0.12,
            water: 0.06,
            panes: 0.3,
            leaves: 0.4,
            lights: 0.06,
            materials: MaterialKnobs::default(),
            intensity: [0.5, 2.0],
            degrees_per_frame: 3.6,
            user_models: 0.25,
            user_hdris: 0.25,
            builtin_maps: 0.25,
        }
    }
}

// What a plan file has where it leaves a knob out that came later.
fn none() -> f64 {
    0.0
}
fn is_none(share: &f64) -> bool {
    *share == 0.0
}

/// Where the objects of a scene stand.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum LayoutKind {
    /// On a bounded ground.
    Ground,
    /// Between walls.
    Room,
    /// In open country.
    Outdoor,
}

/// How the camera moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum CameraKind {
    /// It turns about the objects.
    Orbit,
    /// It moves along a line.
    Dolly,
    /// It walks and shakes a little.
    Handheld,
    /// It stands still.
    Fixed,
}

impl LayoutKind {
    /// Name in plans and records.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ground => "ground",
            Self::Room => "room",
            Self::Outdoor => "outdoor",
        }
    }
}

impl CameraKind {
    /// Name in plans and records.
    pub fn name(self) -> &'static str {
        match self {
            Self::Orbit => "orbit",
            Self::Dolly => "dolly",
            Self::Handheld => "handheld",
            Self::Fixed => "fixed",
        }
    }
}

/// Weights of the layouts, each 0..=1e6, not all 0; only their ratios matter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Layouts {
    /// Objects on a plain ground; 0.45.
    pub ground: f64,
    /// A room with openings to the environment; 0.25.
    pub room: f64,
    /// Open country with things scattered about a clear place; 0.3.
    pub outdoor: f64,
}

impl Default for Layouts {
    fn default() -> Self {
        Self { ground: 0.45, room: 0.25, outdoor: 0.3 }
    }
}

/// Weights of the kinds of cameras, each 0..=1e6, not all 0; only their ratios matter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Cameras {
    /// Turns about the objects; 0.5.
    pub orbit: f64,
    /// Moves along a line; 0.2.
    pub dolly: f64,
    /// Walks and shakes a little; 0.2.
    pub handheld: f64,
    /// Stands still before something that moves or changes; 0.1.
    pub fixed: f64,
}

impl Default for Cameras {
    fn default() -> Self {
        Self { orbit: 0.5, dolly: 0.2, handheld: 0.2, fixed: 0.1 }
    }
}

impl Composition {
    /// Without what lets light through and without lights: what a plan file asks for that says nothing of them.
    pub fn opaque() -> Self {
        Self { glass: none(), water: none(), panes: none(), leaves: none(), lights: none(), ..Self::default() }
    }

    /// Checks every range.
    ///
    /// # Errors
    /// The first violation, with its JSON pointer in a plan: `/composition/moving: 2 is outside 0..=1`.
    pub fn check(&self) -> Result<(), String> {
        let within = |field: &str, value: f64, low: f64, high: f64| {
            // NaN is in no range.
            let fine = (low..=high).contains(&value);
            if fine { Ok(()) } else { Err(format!("/composition/{field}: {value} is outside {low}..={high}")) }
        };
        let weights = |list: &str, weights: &[(&str, f64)]| {
            weights.iter().try_for_each(|(field, weight)| within(&format!("{list}/{field}"), *weight, 0.0, 1e6))?;
            let none = weights.iter().all(|(_, weight)| *weight == 0.0);
            if none { Err(format!("/composition/{list}: every weight is 0, one at least has to be greater")) } else { Ok(()) }
        };
        weights("layouts", &self.layouts.weights().map(|(kind, weight)| (kind.name(), weight)))?;
        weights("cameras", &self.cameras.weights().map(|(kind, weight)| (kind.name(), weight)))?;
        for (index, count) in self.objects.into_iter().enumerate() {
            within(&format!("objects/{index}"), f64::from(count), 1.0, 64.0)?;
        }
        if self.objects[0] > self.objects[1] {
            return Err(format!("/composition/objects: {} is more than {}", self.objects[0], self.objects[1]));
        }
        for (field, share) in [
            ("moving", self.moving),
            ("changing", self.changing),
            ("occluders", self.occluders),
            ("lamps", self.lamps),
            ("glass", self.glass),
            ("water", self.water),
            ("panes", self.panes),
            ("leaves", self.leaves),
            ("lights", self.lights),
            ("user_models", self.user_models),
            ("user_hdris", self.user_hdris),
            ("builtin_maps", self.builtin_maps),
        ] {
            within(field, share, 0.0, 1.0)?;
        }
        if let Some((field, reason)) = self.materials.validate().first() {
            return Err(format!("/composition/materials{field}: {reason}"));
        }
        for (index, gain) in self.intensity.into_iter().enumerate() {
            within(&format!("intensity/{index}"), f64::from(gain), 0.001, 1000.0)?;
        }
        if self.intensity[0] > self.intensity[1] {
            return Err(format!("/composition/intensity: {} is more than {}", self.intensity[0], self.intensity[1]));
        }
        within("degrees_per_frame", f64::from(self.degrees_per_frame), -45.0, 45.0)
    }
}

impl Layouts {
    pub(super) fn weights(&self) -> [(LayoutKind, f64); 3] {
        [(LayoutKind::Ground, self.ground), (LayoutKind::Room, self.room), (LayoutKind::Outdoor, self.outdoor)]
    }
}

impl Cameras {
    pub(super) fn weights(&self) -> [(CameraKind, f64); 4] {
        [
            (CameraKind::Orbit, self.orbit),
            (CameraKind::Dolly, self.dolly),
            (CameraKind::Handheld, self.handheld),
            (CameraKind::Fixed, self.fixed),
        ]
    }
}
