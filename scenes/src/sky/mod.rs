//! Environment maps made from parameters: analytic skies, clouds, studios, nights, rooms. The maps in `hdri/` are made here.
//!
//! Directions follow `renderflow_frame::Environment`: an azimuth of a degrees lies at u = a / 360 (0 = -Z, 90 = +X), the zenith
//! is +Y. All radiance is scene-linear Rec.709 on a relative scale; a map's mean luminance lies near 0.1 to 2.

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
mod room;
mod scenery;
mod weather;

pub(crate) use catalog::random_at;
pub use catalog::{ENVIRONMENTS, GROUPS, group, random_of};
pub use chamber::Room;
pub use fields::{Lamp, LampShape, Mask, Sun, Wall, Window};
pub use figures::Abstract;
pub use library::{LIBRARY_SIZE, builtin, library, library_files, names};
pub use parts::{
    Air, Backdrop, Beam, CloudKind, CloudLayer, Cover, CoverKind, Figure, Finish, Furnishing, Glow, Ground, Horizon, HorizonKind,
    Layout, LightGroup, Opening, Palette, Stars,
};
pub use scenery::Scenery;

use crate::family::{Faults, Tagged, below, family};
use renderflow_frame::image::Rgb;

family! {
    /// Parameters of a generated environment map.
    pub enum Sky by "family" {
        /// The same radiance everywhere.
        Uniform = "uniform" {
            /// Scene-linear radiance.
            radiance: [f32; 3] [0, 10000];
        }
        /// A smooth gradient from zenith to horizon above a plain ground.
        Gradient = "gradient" {
            /// Radiance at the zenith.
            zenith: [f32; 3] [0, 10000];
            /// Radiance at the horizon.
            horizon: [f32; 3] [0, 10000];
            /// Radiance below the horizon.
            ground: [f32; 3] [0, 10000];
            /// Exponent of the sine of the elevation: small = the horizon colour is a narrow band.
            sharpness: f32 [0.1, 10];
        }
        /// Clear sky: single scattering by air, haze and ozone, with a multiple-scattering term.
        Daylight = "daylight" {
            /// The sun.
            sun: Sun;
            /// Haze: 1 = pure air, 2 = very clear, 10 = hazy.
            turbidity: f32 [1, 12];
            /// Diffuse reflectance of the ground, linear Rec.709.
            ground: [f32; 3] [0, 1];
            /// Mean luminance of the upper half without the sun's disc; the sun keeps its natural ratio to the sky.
            luminance: f32 [0.001, 100];
        }
        /// Clear sky with seeded clouds before it; they veil the sun too.
        Cloudy = "cloudy" {
            /// The sun.
            sun: Sun;
            /// Haze, as in `daylight`.
            turbidity: f32 [1, 12];
            /// Share of the sky that clouds cover.
            coverage: f32 [0, 1];
            /// Size of the clouds; 1 = about a dozen across the sky.
            scale: f32 [0.2, 5];
            /// Which clouds.
            seed: u32;
            /// Diffuse reflectance of the ground, linear Rec.709.
            ground: [f32; 3] [0, 1];
            /// Mean luminance of the clear upper half without the sun's disc.
            luminance: f32 [0.001, 100];
        }
        /// A low sun with bands of cloud above the horizon lit from below.
        Sunset = "sunset" {
            /// The sun; its elevation is -5..=15 here.
            sun: Sun;
            /// Haze, as in `daylight`.
            turbidity: f32 [1, 12];
            /// Strength of the cloud bands.
            bands: f32 [0, 1];
            /// Which bands.
            seed: u32;
            /// Diffuse reflectance of the ground, linear Rec.709.
            ground: [f32; 3] [0, 1];
            /// Mean luminance of the upper half without bands and the sun's disc.
            luminance: f32 [0.001, 100];
        }, rules |faults, at| {
            faults.narrower(&below(at, "sun/elevation"), sun.elevation, [-5.0, 90.0], -5.0, 15.0);
        }
        /// CIE standard overcast sky (Moon and Spencer 1942): three times as bright at the zenith as at the horizon.
        Overcast = "overcast" {
            /// Radiance at the zenith.
            zenith: [f32; 3] [0, 10000];
            /// Diffuse reflectance of the ground, linear Rec.709.
            ground: [f32; 3] [0, 1];
            /// Brightening towards the hidden sun as a share of the sky's radiance.
            glow: f32 [0, 10];
            /// Elevation of the hidden sun, degrees.
            glow_elevation: f32 [0, 90];
            /// Azimuth of the hidden sun, degrees.
            glow_azimuth: f32 [-3600, 3600];
        }
        /// Lamps in a dim room.
        Studio = "studio" {
            /// Lamps.
            lamps: Vec<Lamp> [; count 1, 64];
            /// Radiance of the room above.
            fill: [f32; 3] [0, 100];
            /// Radiance of the room below.
            floor: [f32; 3] [0, 100];
            /// A lit backdrop; absent = none.
            #[serde(default, skip_serializing_if = "Option::is_none")]
            backdrop: Option<Backdrop>;
        }
        /// A dark sky with small strong lights around the horizon.
        Night = "night" {
            /// Radiance at the zenith.
            zenith: [f32; 3] [0, 100];
            /// Radiance at the horizon.
            horizon: [f32; 3] [0, 100];
            /// Radiance below the horizon.
            ground: [f32; 3] [0, 100];
            /// Number of lights.
            lights: u32 [1, 64];
            /// Mean angular radius of a light, degrees.
            light_radius: f32 [0.2, 8];
            /// Luminance of the whole map that the lights bring on average.
            luminance: f32 [0, 100];
            /// Where the lights are and which colours they have.
            seed: u32;
        }
        /// A room with bright windows, seen from its middle.
        Interior = "interior" {
            /// Extent of the room along x, y, z, metres.
            size: [f32; 3] [1, 100];
            /// Height of the point the map is seen from above the floor, metres, at most 0.9 of the room's height.
            eye_height: f32 [0.1, 90; most 0.9 * size[1]];
            /// Diffuse reflectance of walls and ceiling, linear Rec.709.
            walls: [f32; 3] [0, 1];
            /// Diffuse reflectance of the floor, linear Rec.709.
            floor: [f32; 3] [0, 1];
            /// Windows and ceiling lights.
            windows: Vec<Window> [; count 1, 16];
        }, rules |faults, at| {
            for (index, window) in windows.iter().enumerate() {
                fits(faults, &below(at, format!("windows/{index}")), window.wall.face(*size), window.size, window.offset);
            }
        }
    }
    or {
        /// A place out of doors: air, clouds, stars, a silhouette on the horizon, something overhead, lamps, and a ground.
        Scenery = "scenery";
        /// A room with inter-reflections, pillars and boxes, lit through openings.
        Room = "room";
        /// Colours and shapes that no sky has.
        Abstract = "abstract";

    }
}

/// Notes a window or an opening, `size` metres large and `offset` from the middle, that does not lie inside its face of a room.
fn fits(faults: &mut Faults, at: &str, face: [f32; 2], size: [f32; 2], offset: [f32; 2]) {
    for (k, face) in face.into_iter().enumerate() {
        faults.narrower(&below(at, format!("size/{k}")), size[k], [0.05, 100.0], 0.05, face);
        let play = 0.5 * (face - size[k]).max(0.0);
        faults.narrower(&below(at, format!("offset/{k}")), offset[k], [-50.0, 50.0], -play, play);
    }
}

impl Sky {
    /// Name of the family as scene files write it.
    pub fn family(&self) -> &'static str {
        self.name()
    }

    /// Parameters out of their documented range: (JSON pointer below the sky, message such as `-1 is outside 0..=1`).
    pub fn validate(&self) -> Vec<(String, String)> {
        Faults::of(self)
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
        Sky::Scenery(scenery) => scenery::scenery(scenery),
        Sky::Room(room) => chamber::chamber(room),
        Sky::Abstract(shapes) => figures::figure(shapes),
    };
    dome.render(width, height)
}
