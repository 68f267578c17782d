//! The named maps of the `hdri/` folder. They are held out: no random draw gives one of them.

use super::{Lamp, LampShape, Sky, Sun, Wall, Window, render};
use renderflow_frame::image::Rgb;
use renderflow_frame::{Result, file, hdr};
use serde::Serialize;
use std::path::Path;
use std::sync::LazyLock;

/// Width and height of the maps in `hdri/`, texels.
pub const LIBRARY_SIZE: [usize; 2] = [256, 128];

static LIBRARY: LazyLock<Vec<(&'static str, Sky)>> = LazyLock::new(make);

/// Every map of `hdri/` with its parameters.
pub fn library() -> &'static [(&'static str, Sky)] {
    &LIBRARY
}

/// Names of the maps of `hdri/`.
pub fn names() -> Vec<&'static str> {
    library().iter().map(|(name, _)| *name).collect()
}

/// The map of `hdri/` called `name`, made in memory at [`LIBRARY_SIZE`]; `None` when there is none.
pub fn builtin(name: &str) -> Option<Rgb> {
    let (_, sky) = library().iter().find(|(known, _)| *known == name)?;
    Some(render(sky, LIBRARY_SIZE[0], LIBRARY_SIZE[1]))
}

#[derive(Serialize)]
struct Manifest<'a> {
    note: &'static str,
    licence: &'static str,
    maps: Vec<Entry<'a>>,
}

#[derive(Serialize)]
struct Entry<'a> {
    name: &'a str,
    file: String,
    family: &'static str,
    width: usize,
    height: usize,
    bytes: usize,
    blake3: String,
    parameters: &'a Sky,
}

/// The files of `hdri/` by name: the maps, and last `manifest.json`.
///
/// # Errors
/// When the manifest has no JSON form.
pub fn library_files() -> Result<Vec<(String, Vec<u8>)>> {
    let [width, height] = LIBRARY_SIZE;
    let (mut files, mut maps) = (Vec::new(), Vec::new());
    for (name, sky) in library() {
        let bytes = hdr::encode(&render(sky, width, height));
        let file = format!("{name}.hdr");
        let blake3 = blake3::hash(&bytes).to_hex().to_string();
        maps.push(Entry {
            name,
            file: file.clone(),
            family: sky.family(),
            width,
            height,
            bytes: bytes.len(),
            blake3,
            parameters: sky,
        });
        files.push((file, bytes));
    }
    let manifest = Manifest {
        note: "Equirectangular radiance maps made by this project's own code; `renderflow hdri --out hdri` makes them again, bit for bit.",
        licence: "CC0-1.0 (own work)",
        maps,
    };
    files.push((MANIFEST.into(), file::json(Path::new(MANIFEST), &manifest)?));
    Ok(files)
}

/// The list of the maps with their parameters.
const MANIFEST: &str = "manifest.json";

const SOIL: [f32; 3] = [0.22, 0.19, 0.15];
const GRASS: [f32; 3] = [0.1, 0.14, 0.06];
const SAND: [f32; 3] = [0.42, 0.35, 0.25];
const CONCRETE: [f32; 3] = [0.3, 0.3, 0.29];

fn sun(elevation: f32, azimuth: f32, radius: f32, gain: f32) -> Sun {
    Sun { elevation, azimuth, radius, gain }
}

fn clear(sun: Sun, turbidity: f32, ground: [f32; 3]) -> Sky {
    Sky::Daylight { sun, turbidity, ground, luminance: 0.4 }
}

fn softbox(position: [f32; 3], size: [f32; 2], color: [f32; 3], power: f32) -> Lamp {
    Lamp { position, size, roll: 0.0, shape: LampShape::Rectangle, color, power, softness: 0.25, mask: None }
}

fn beauty_dish(position: [f32; 3], size: f32, color: [f32; 3], power: f32) -> Lamp {
    Lamp { position, size: [size; 2], roll: 0.0, shape: LampShape::Ellipse, color, power, softness: 0.1, mask: None }
}

fn window(wall: Wall, offset: [f32; 2], size: [f32; 2], radiance: [f32; 3]) -> Window {
    Window { wall, offset, size, radiance }
}

fn make() -> Vec<(&'static str, Sky)> {
    const WHITE: [f32; 3] = [1.0; 3];
    const WARM: [f32; 3] = [1.0, 0.78, 0.55];
    const COOL: [f32; 3] = [0.7, 0.85, 1.0];
    vec![
        ("clear_noon", clear(sun(68.0, 140.0, 0.27, 1.0), 2.5, SOIL)),
        ("clear_afternoon", clear(sun(38.0, 245.0, 0.5, 1.0), 3.0, GRASS)),
        ("clear_evening", clear(sun(14.0, 280.0, 0.5, 1.0), 3.5, SAND)),
        ("low_sun", clear(sun(6.0, 70.0, 0.8, 2.0), 3.0, SOIL)),
        ("hazy_morning", clear(sun(20.0, 105.0, 2.5, 1.2), 8.0, GRASS)),
        ("twilight", clear(sun(-3.0, 290.0, 0.5, 1.0), 2.5, CONCRETE)),
        (
            "sunset_bands",
            Sky::Sunset { sun: sun(3.0, 200.0, 1.0, 2.0), turbidity: 4.0, bands: 0.9, seed: 11, ground: SOIL, luminance: 0.35 },
        ),
        (
            "golden_hour",
            Sky::Sunset { sun: sun(9.0, 330.0, 0.6, 1.5), turbidity: 5.0, bands: 0.4, seed: 4, ground: SAND, luminance: 0.4 },
        ),
        (
            "fair_weather_clouds",
            Sky::Cloudy {
                sun: sun(48.0, 30.0, 0.5, 1.0),
                turbidity: 2.5,
                coverage: 0.35,
                scale: 1.0,
                seed: 3,
                ground: GRASS,
                luminance: 0.4,
            },
        ),
        (
            "broken_clouds",
            Sky::Cloudy {
                sun: sun(24.0, 160.0, 0.6, 1.2),
                turbidity: 3.5,
                coverage: 0.6,
                scale: 1.6,
                seed: 21,
                ground: CONCRETE,
                luminance: 0.4,
            },
        ),
        (
            "overcast",
            Sky::Overcast { zenith: [0.95, 1.0, 1.05], ground: CONCRETE, glow: 0.0, glow_elevation: 60.0, glow_azimuth: 0.0 },
        ),
        (
            "overcast_bright",
            Sky::Overcast { zenith: [0.7, 0.7, 0.72], ground: SOIL, glow: 2.5, glow_elevation: 35.0, glow_azimuth: 220.0 },
        ),
        (
            "studio_three_point",
            Sky::Studio {
                lamps: vec![
                    softbox([-2.0, 2.0, 2.0], [1.4, 1.4], WHITE, 12.0),
                    softbox([2.6, 1.0, 1.6], [1.6, 1.6], COOL, 3.0),
                    softbox([0.6, 2.2, -2.6], [0.6, 1.6], WARM, 16.0),
                ],
                fill: [0.05, 0.05, 0.055],
                floor: [0.03; 3],
                backdrop: None,
            },
        ),
        (
            "studio_overhead",
            Sky::Studio {
                lamps: vec![
                    softbox([0.0, 2.5, 0.1], [2.4, 2.4], WHITE, 5.0),
                    softbox([-3.0, 0.8, 0.0], [0.4, 2.2], WHITE, 8.0),
                    softbox([3.0, 0.8, 0.0], [0.4, 2.2], WHITE, 8.0),
                ],
                fill: [0.08; 3],
                floor: [0.12; 3],
                backdrop: None,
            },
        ),
        (
            "studio_two_colors",
            Sky::Studio {
                lamps: vec![
                    beauty_dish([-2.4, 1.4, 1.0], 1.0, [1.0, 0.25, 0.15], 40.0),
                    beauty_dish([2.4, 1.6, -0.6], 1.0, [0.15, 0.4, 1.0], 50.0),
                    softbox([0.0, 3.0, 1.5], [1.0, 0.6], WHITE, 6.0),
                ],
                fill: [0.03, 0.03, 0.04],
                floor: [0.02; 3],
                backdrop: None,
            },
        ),
        (
            "studio_hard_key",
            Sky::Studio {
                lamps: vec![beauty_dish([2.0, 2.6, 1.4], 0.22, WARM, 900.0), softbox([-3.0, 1.0, 0.5], [2.0, 2.0], COOL, 0.8)],
                fill: [0.04; 3],
                floor: [0.03; 3],
                backdrop: None,
            },
        ),
        (
            "night_street",
            Sky::Night {
                zenith: [0.004, 0.005, 0.009],
                horizon: [0.03, 0.022, 0.016],
                ground: [0.01, 0.009, 0.008],
                lights: 14,
                light_radius: 1.0,
                luminance: 0.2,
                seed: 5,
            },
        ),
        (
            "night_neon",
            Sky::Night {
                zenith: [0.006, 0.006, 0.012],
                horizon: [0.03, 0.02, 0.045],
                ground: [0.012, 0.01, 0.016],
                lights: 28,
                light_radius: 2.0,
                luminance: 0.25,
                seed: 40,
            },
        ),
        (
            "room_with_windows",
            Sky::Interior {
                size: [7.0, 2.8, 5.0],
                eye_height: 1.2,
                walls: [0.72, 0.69, 0.63],
                floor: [0.32, 0.22, 0.14],
                windows: vec![
                    window(Wall::North, [-1.6, 0.2], [1.4, 1.5], [9.0, 10.0, 11.5]),
                    window(Wall::North, [1.6, 0.2], [1.4, 1.5], [9.0, 10.0, 11.5]),
                    window(Wall::West, [0.5, 0.2], [1.2, 1.5], [6.0, 6.8, 8.0]),
                ],
            },
        ),
        (
            "hall_with_skylight",
            Sky::Interior {
                size: [14.0, 6.0, 20.0],
                eye_height: 1.7,
                walls: [0.5, 0.5, 0.5],
                floor: [0.25, 0.25, 0.26],
                windows: vec![
                    window(Wall::Ceiling, [0.0, 3.0], [4.0, 6.0], [14.0, 15.0, 16.0]),
                    window(Wall::South, [0.0, -0.8], [3.0, 2.4], [10.0, 8.5, 6.5]),
                ],
            },
        ),
    ]
}
