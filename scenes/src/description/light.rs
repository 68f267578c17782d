//! Lights besides the environment and the materials that emit.

use super::{Motion, Transform, exact};
use glam::{DAffine3, DMat3, DVec3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize, Serializer};

/// A light. It shines along its own -Z axis (a point and a sphere: in all directions), as lights of glTF and Blender do.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Light {
    /// Unique name among the lights.
    pub name: String,
    /// What it is, and how strong.
    pub kind: LightKind,
    /// Linear Rec.709, 0..=1e6; multiplies the strength.
    #[serde(default = "white")]
    #[schemars(inner(range(min = 0, max = 1e6)))]
    pub color: [f32; 3],
    /// Placement at frame 0. The scale is that of a sphere, a disk or a rectangle, whose power stays; the others have no size.
    #[serde(default)]
    pub transform: Transform,
    /// A point that the light is turned to in every frame, metres: in place of the rotation of `transform` and the spin of
    /// `motion`. The light's +Y axis is then upwards.
    #[serde(default, skip_serializing_if = "Option::is_none", serialize_with = "target")]
    pub target: Option<[f64; 3]>,
    /// Change of placement from a frame to the next; static without it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub motion: Option<Motion>,
}

fn white() -> [f32; 3] {
    [1.0; 3]
}

fn target<S: Serializer>(value: &Option<[f64; 3]>, serializer: S) -> Result<S::Ok, S::Error> {
    match value {
        Some(value) => exact::vector(value, serializer),
        None => serializer.serialize_none(),
    }
}

/// What a light is. Strengths are radiometric, in the units in which the radiance of environments and materials is scene-linear;
/// each is multiplied by the light's colour.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum LightKind {
    /// A point. No ray meets it.
    Point {
        /// Radiant intensity, W/sr, 0..=1e9; with a profile, that of its brightest direction.
        #[schemars(range(min = 0, max = 1e9))]
        intensity: f32,
        /// Photometric profile: an IES LM-63 file of type C, relative to the scene file. Its vertical angle 0 is the light's -Z,
        /// its horizontal angles 0 and 90 are +X and +Y. It is scaled to 1 in its brightest direction.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        ies: Option<String>,
    },
    /// A point that shines into a cone, with the falloff of glTF: t^2, where t rises from 0 to 1 evenly with the cosine of the
    /// angle from the axis. No ray meets it.
    Spot {
        /// Radiant intensity on the axis, W/sr, 0..=1e9; with a profile, that of the profile's brightest direction.
        #[schemars(range(min = 0, max = 1e9))]
        intensity: f32,
        /// Degrees from the axis up to which it is as bright as there, from 0 to less than `outer_angle`.
        #[serde(default)]
        #[schemars(range(min = 0, max = 90))]
        inner_angle: f32,
        /// Degrees from the axis where it ends, up to 90.
        #[serde(default = "outer")]
        #[schemars(range(min = 0, max = 90))]
        outer_angle: f32,
        /// As for a point.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        ies: Option<String>,
    },
    /// Light from one direction, infinitely far away. No ray meets it.
    Directional {
        /// Irradiance of a surface that faces it, W/m^2, 0..=1e9.
        #[schemars(range(min = 0, max = 1e9))]
        irradiance: f32,
    },
    /// A glowing ball.
    Sphere {
        /// Radiant power, W, 0..=1e9.
        #[schemars(range(min = 0, max = 1e9))]
        power: f32,
        /// Metres, 1e-9..=1e9.
        #[schemars(range(min = 1e-9, max = 1e9))]
        radius: f32,
    },
    /// A glowing disk; its back is not there.
    Disk {
        /// Radiant power, W, 0..=1e9.
        #[schemars(range(min = 0, max = 1e9))]
        power: f32,
        /// Metres, 1e-9..=1e9.
        #[schemars(range(min = 1e-9, max = 1e9))]
        radius: f32,
    },
    /// A glowing rectangle; its back is not there.
    Rectangle {
        /// Radiant power, W, 0..=1e9.
        #[schemars(range(min = 0, max = 1e9))]
        power: f32,
        /// Metres along its X axis, 1e-9..=1e9.
        #[schemars(range(min = 1e-9, max = 1e9))]
        width: f32,
        /// Metres along its Y axis, 1e-9..=1e9.
        #[schemars(range(min = 1e-9, max = 1e9))]
        height: f32,
    },
}

fn outer() -> f32 {
    45.0
}

impl LightKind {
    /// The photometric profile that it names.
    pub fn ies(&self) -> Option<&str> {
        match self {
            Self::Point { ies, .. } | Self::Spot { ies, .. } => ies.as_deref(),
            _ => None,
        }
    }
}

impl Light {
    /// Light to world at `frame`, counted from 0, in double precision: the world may be wide.
    pub fn transform_at(&self, frame: u32) -> DAffine3 {
        let motion = self.motion.clone().unwrap_or_default();
        let own = self.transform.matrix(motion.shift(frame), f64::from(motion.spin) * f64::from(frame));
        let Some(target) = self.target else { return own };
        let z = (own.translation - DVec3::from(target)).normalize_or(DVec3::Z);
        // Straight up or down there is no upwards: then +Y is north.
        let x = DVec3::Y.cross(z).try_normalize().unwrap_or(DVec3::X);
        let scale = DMat3::from_diagonal(self.transform.scale.map(f64::from).into());
        DAffine3 { matrix3: DMat3::from_cols(x, z.cross(x), z) * scale, ..own }
    }

    /// Does its placement change from frame to frame?
    pub fn moves(&self) -> bool {
        self.motion.as_ref().is_some_and(|m| *m != Motion::default())
    }
}
