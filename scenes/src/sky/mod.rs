//! Environment maps made from parameters: analytic skies, clouds, studios, nights, rooms. The maps in `hdri/` are made here.
//!
//! Directions follow `renderflow_frame::Environment`: an azimuth of a degrees lies at u = a / 360 (0 = -Z, 90 = +X), the zenith is +Y.
//! All radiance is scene-linear Rec.709 on a relative scale; a map's mean luminance lies near 0.1 to 2.

mod analytic;
mod canvas;
mod catalog;
mod chamber;
mod clouds;
mod cover;
mod fields;
mod figures;
mod horizon;
mod library;
mod lights;
mod night;
mod parts;
mod random;
mod room;
mod scenery;
mod validate;
mod validate_parts;
mod weather;

pub use catalog::{ENVIRONMENTS, GROUPS, group, random_of};
pub use fields::{Lamp, LampShape, Mask, Sun, Wall, Window};
pub use library::{LIBRARY_SIZE, builtin, library, library_files, names, write_library};
pub use parts::{
    Air, Backdrop, Beam, CloudKind, CloudLayer, Cover, CoverKind, Figure, Finish, Furnishing, Glow, Ground, Horizon, HorizonKind,
    Layout, LightGroup, Opening, Palette, Stars,
};
pub use random::random;

use renderflow_frame::image::Rgb;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Parameters of a generated environment map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields, tag = "family")]
pub enum Sky {
    /// The same radiance everywhere.
    Uniform {
        /// Scene-linear radiance, each 0..=10000.
        radiance: [f32; 3],
    },
    /// A smooth gradient from zenith to horizon above a plain ground.
    Gradient {
        /// Radiance at the zenith, each 0..=10000.
        zenith: [f32; 3],
        /// Radiance at the horizon, each 0..=10000.
        horizon: [f32; 3],
        /// Radiance below the horizon, each 0..=10000.
        ground: [f32; 3],
        /// Exponent of the sine of the elevation, 0.1..=10: small = the horizon colour is a narrow band.
        sharpness: f32,
    },
    /// Clear sky: single scattering by air, haze and ozone, with a multiple-scattering term.
    Daylight {
        /// The sun.
        sun: Sun,
        /// Haze: 1 = pure air, 2 = very clear, 10 = hazy; 1..=12.
        turbidity: f32,
        /// Diffuse reflectance of the ground, linear Rec.709, each 0..=1.
        ground: [f32; 3],
        /// Mean luminance of the upper half without the sun's disc, 0.001..=100; the sun keeps its natural ratio to the sky.
        luminance: f32,
    },
    /// Clear sky with seeded clouds before it; they veil the sun too.
    Cloudy {
        /// The sun.
        sun: Sun,
        /// Haze, as in `daylight`, 1..=12.
        turbidity: f32,
        /// Share of the sky that clouds cover, 0..=1.
        coverage: f32,
        /// Size of the clouds, 0.2..=5; 1 = about a dozen across the sky.
        scale: f32,
        /// Which clouds.
        seed: u32,
        /// Diffuse reflectance of the ground, linear Rec.709, each 0..=1.
        ground: [f32; 3],
        /// Mean luminance of the clear upper half without the sun's disc, 0.001..=100.
        luminance: f32,
    },
    /// A low sun with bands of cloud above the horizon lit from below.
    Sunset {
        /// The sun; its elevation is -5..=15 here.
        sun: Sun,
        /// Haze, as in `daylight`, 1..=12.
        turbidity: f32,
        /// Strength of the cloud bands, 0..=1.
        bands: f32,
        /// Which bands.
        seed: u32,
        /// Diffuse reflectance of the ground, linear Rec.709, each 0..=1.
        ground: [f32; 3],
        /// Mean luminance of the upper half without bands and the sun's disc, 0.001..=100.
        luminance: f32,
    },
    /// CIE standard overcast sky (Moon and Spencer 1942): three times as bright at the zenith as at the horizon.
    Overcast {
        /// Radiance at the zenith, each 0..=10000.
        zenith: [f32; 3],
        /// Diffuse reflectance of the ground, linear Rec.709, each 0..=1.
        ground: [f32; 3],
        /// Brightening towards the hidden sun as a share of the sky's radiance, 0..=10.
        glow: f32,
        /// Elevation of the hidden sun, degrees, 0..=90.
        glow_elevation: f32,
        /// Azimuth of the hidden sun, degrees.
        glow_azimuth: f32,
    },
    /// Lamps in a dim room.
    Studio {
        /// Lamps, 1..=64.
        lamps: Vec<Lamp>,
        /// Radiance of the room above, each 0..=100.
        fill: [f32; 3],
        /// Radiance of the room below, each 0..=100.
        floor: [f32; 3],
        /// A lit backdrop; absent = none.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        backdrop: Option<Backdrop>,
    },
    /// A dark sky with small strong lights around the horizon.
    Night {
        /// Radiance at the zenith, each 0..=100.
        zenith: [f32; 3],
        /// Radiance at the horizon, each 0..=100.
        horizon: [f32; 3],
        /// Radiance below the horizon, each 0..=100.
        ground: [f32; 3],
        /// Number of lights, 1..=64.
        lights: u32,
        /// Mean angular radius of a light, degrees, 0.2..=8.
        light_radius: f32,
        /// Luminance of the whole map that the lights bring on average, 0..=100.
        luminance: f32,
        /// Where the lights are and which colours they have.
        seed: u32,
    },
    /// A room with bright windows, seen from its middle.
    Interior {
        /// Extent of the room along x, y, z, metres, each 1..=100.
        size: [f32; 3],
        /// Height of the point the map is seen from above the floor, metres, 0.1..=0.9 of the room's height.
        eye_height: f32,
        /// Diffuse reflectance of walls and ceiling, linear Rec.709, each 0..=1.
        walls: [f32; 3],
        /// Diffuse reflectance of the floor, linear Rec.709, each 0..=1.
        floor: [f32; 3],
        /// Windows and ceiling lights, 1..=16.
        windows: Vec<Window>,
    },
    /// A place out of doors: air, clouds, stars, a silhouette on the horizon, something overhead, lamps, and a ground.
    Scenery {
        /// The sky behind everything, with the sun or the moon.
        air: Air,
        /// Layers of clouds from the highest to the lowest, at most 4.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        clouds: Vec<CloudLayer>,
        /// Soft bright places, at most 12.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        glows: Vec<Glow>,
        /// Stars.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        stars: Option<Stars>,
        /// What stands on the horizon.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        horizon: Option<Box<Horizon>>,
        /// What covers the eye.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        cover: Option<Box<Cover>>,
        /// Groups of lamps, at most 4.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        lights: Vec<LightGroup>,
        /// What lies below the horizon.
        ground: Ground,
    },
    /// A room with inter-reflections, pillars and boxes, lit through openings.
    Room {
        /// Extent of the room along x, y, z, metres, each 1..=100.
        size: [f32; 3],
        /// Height of the point the map is seen from above the floor, metres, 0.1..=0.9 of the room's height.
        eye_height: f32,
        /// Diffuse reflectance of the walls, linear Rec.709, each 0..=0.95.
        walls: [f32; 3],
        /// Diffuse reflectance of the floor, linear Rec.709, each 0..=0.95.
        floor: [f32; 3],
        /// Diffuse reflectance of the ceiling, linear Rec.709, each 0..=0.95.
        ceiling: [f32; 3],
        /// Windows, doors and lit panels, 1..=48.
        openings: Vec<Opening>,
        /// Sunlight through the openings; absent = none.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        beam: Option<Beam>,
        /// What stands in it and how its faces are finished.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        furnishing: Option<Furnishing>,
    },
    /// Colours and shapes that no sky has.
    Abstract {
        /// What it is made of.
        figure: Figure,
        /// Radiances, 2..=8 of them, each 0..=10000.
        colors: Vec<[f32; 3]>,
        /// How many shapes: 1 = few, 0.3..=10.
        scale: f32,
        /// Width of transitions, 0..=1.
        softness: f32,
        /// Elevation of the axis, degrees, -90..=90.
        elevation: f32,
        /// Azimuth of the axis, degrees.
        azimuth: f32,
        /// Where the shapes are.
        seed: u32,
    },
}

impl Sky {
    /// Name of the family as scene files write it.
    pub fn family(&self) -> &'static str {
        match self {
            Self::Uniform { .. } => "uniform",
            Self::Gradient { .. } => "gradient",
            Self::Daylight { .. } => "daylight",
            Self::Cloudy { .. } => "cloudy",
            Self::Sunset { .. } => "sunset",
            Self::Overcast { .. } => "overcast",
            Self::Studio { .. } => "studio",
            Self::Night { .. } => "night",
            Self::Interior { .. } => "interior",
            Self::Scenery { .. } => "scenery",
            Self::Room { .. } => "room",
            Self::Abstract { .. } => "abstract",
        }
    }

    /// The sun (or the moon), where the sky has one.
    pub fn sun(&self) -> Option<&Sun> {
        match self {
            Self::Daylight { sun, .. } | Self::Cloudy { sun, .. } | Self::Sunset { sun, .. } => Some(sun),
            Self::Scenery { air, .. } => air.sun(),
            _ => None,
        }
    }

    /// Parameters out of their documented range: (JSON pointer below the sky, message such as `-1 is outside 0..=1`).
    pub fn validate(&self) -> Vec<(String, String)> {
        validate::validate(self)
    }
}

/// Map of `sky` at `width x height`, equal to its own `.hdr` encoding read back.
///
/// Suns and lamps are averaged over each texel and their total is fixed, so the light does not depend on the size.
/// Arithmetic is in f64 and rounded to 8-bit mantissas, which hides differences between machines' mathematical libraries.
pub fn render(sky: &Sky, width: usize, height: usize) -> Rgb {
    let dome = match sky {
        Sky::Uniform { radiance } => weather::uniform(*radiance),
        Sky::Gradient { zenith, horizon, ground, sharpness } => weather::gradient(*zenith, *horizon, *ground, *sharpness),
        Sky::Daylight { sun, turbidity, ground, luminance } => weather::daylight(sun, *turbidity, *ground, *luminance),
        Sky::Cloudy { sun, turbidity, coverage, scale, seed, ground, luminance } => {
            let clouds = weather::Clouds { coverage: *coverage, scale: *scale, seed: *seed };
            weather::cloudy(sun, *turbidity, &clouds, *ground, *luminance)
        }
        Sky::Sunset { sun, turbidity, bands, seed, ground, luminance } => {
            weather::sunset(sun, *turbidity, *bands, *seed, *ground, *luminance)
        }
        Sky::Overcast { zenith, ground, glow, glow_elevation, glow_azimuth } => {
            weather::overcast(*zenith, *ground, *glow, [*glow_elevation, *glow_azimuth])
        }
        Sky::Studio { lamps, fill, floor, backdrop } => room::studio(lamps, *fill, *floor, backdrop.as_ref()),
        Sky::Night { zenith, horizon, ground, lights, light_radius, luminance, seed } => {
            let lamps = night::Lights { count: *lights, radius: *light_radius, luminance: *luminance, seed: *seed };
            night::night(*zenith, *horizon, *ground, &lamps)
        }
        Sky::Interior { size, eye_height, walls, floor, windows } => room::interior(*size, *eye_height, *walls, *floor, windows),
        Sky::Scenery { air, clouds, glows, stars, horizon, cover, lights, ground } => scenery::scenery(&scenery::Scenery {
            air,
            clouds,
            glows,
            stars: stars.as_ref(),
            horizon: horizon.as_deref(),
            cover: cover.as_deref(),
            lights,
            ground,
        }),
        Sky::Room { size, eye_height, walls, floor, ceiling, openings, beam, furnishing } => chamber::chamber(&chamber::Room {
            size: *size,
            eye_height: *eye_height,
            walls: *walls,
            floor: *floor,
            ceiling: *ceiling,
            openings,
            beam: beam.as_ref(),
            furnishing: furnishing.as_ref(),
        }),
        Sky::Abstract { figure, colors, scale, softness, elevation, azimuth, seed } => figures::figure(&figures::Abstract {
            figure: *figure,
            colors,
            scale: *scale,
            softness: *softness,
            elevation: *elevation,
            azimuth: *azimuth,
            seed: *seed,
        }),
    };
    dome.render(width, height)
}
