//! Generated environment maps: light that does not depend on the size of the map, known answers, and the committed files.

use rayon::prelude::*;
use renderflow_frame::color::luminance;
use renderflow_frame::hdr;
use renderflow_frame::image::Rgb;
use renderflow_scenes::sky::{self, Lamp, LampShape, Sky, Sun};
use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};
use std::path::{Path, PathBuf};

fn hdri() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../hdri")
}

/// Sum over texels of f(radiance, direction) times exact solid angle.
fn integrate(map: &Rgb, f: impl Fn([f32; 3], [f64; 3]) -> f64) -> f64 {
    let mut sum = 0.0;
    for y in 0..map.height {
        let (top, bottom) = (PI * y as f64 / map.height as f64, PI * (y + 1) as f64 / map.height as f64);
        let solid_angle = TAU / map.width as f64 * (top.cos() - bottom.cos());
        let theta = 0.5 * (top + bottom);
        for x in 0..map.width {
            let phi = TAU * (x as f64 + 0.5) / map.width as f64;
            let d = [phi.sin() * theta.sin(), theta.cos(), -phi.cos() * theta.sin()];
            sum += solid_angle * f(*map.at(x, y), d);
        }
    }
    sum
}

/// Luminance integrated over the sphere.
fn flux(map: &Rgb) -> f64 {
    integrate(map, |rgb, _| f64::from(luminance(rgb)))
}

/// Luminance that arrives on level ground.
fn irradiance(map: &Rgb) -> f64 {
    integrate(map, |rgb, d| f64::from(luminance(rgb)) * d[1].max(0.0))
}

fn daylight(elevation: f32, radius: f32, gain: f32) -> Sky {
    let sun = Sun { elevation, azimuth: 137.0, radius, gain };
    Sky::Daylight { sun, turbidity: 2.5, ground: [0.0; 3], luminance: 0.5 }
}

#[test]
fn the_committed_maps_are_made_again_byte_for_byte() {
    let files: BTreeMap<String, Vec<u8>> = sky::library_files().expect("makes the maps").into_iter().collect();
    let mut bytes = 0;
    let names = || sky::names().into_iter().map(|n| format!("{n}.hdr")).chain(["manifest.json".to_owned()]);
    for name in names() {
        let made = &files[&name];
        let stored = std::fs::read(hdri().join(&name)).unwrap_or_default();
        assert!(*made == stored, "hdri/{name} differs; `renderflow hdri --out hdri` makes it again");
        bytes += made.len();
    }
    assert!(sky::library().len() >= 16 && bytes < 2 << 20, "{} maps, {bytes} bytes", sky::library().len());
    let stored = std::fs::read_dir(hdri()).expect("hdri/ is there").filter_map(|f| f.ok()?.file_name().into_string().ok());
    let mut maps: Vec<String> = stored.filter(|n| n.ends_with(".hdr")).collect();
    let mut known: Vec<String> = names().filter(|n| n.ends_with(".hdr")).collect();
    maps.sort();
    known.sort();
    assert_eq!(maps, known, "hdri/ holds exactly the library");
}

#[test]
fn manifest_describes_the_files() {
    let text = std::fs::read_to_string(hdri().join("manifest.json")).expect("manifest");
    let manifest: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    assert!(manifest["licence"].as_str().is_some_and(|l| l.starts_with("CC0")));
    for entry in manifest["maps"].as_array().expect("list") {
        let bytes = std::fs::read(hdri().join(entry["file"].as_str().expect("file"))).expect("map");
        assert_eq!(entry["blake3"], blake3::hash(&bytes).to_hex().to_string());
        let parameters: Sky = serde_json::from_value(entry["parameters"].clone()).expect("parameters");
        let name = entry["name"].as_str().expect("name");
        assert!(sky::library().iter().any(|(known, sky)| *known == name && *sky == parameters), "{name} has other parameters");
        let map = sky::builtin(name).expect("known");
        assert_eq!(map, hdr::decode(Path::new(name), &bytes).expect("decodes").map, "{name} equals its own file read back");
    }
}

#[test]
fn light_does_not_depend_on_the_size_of_the_map() {
    sky::library().par_iter().for_each(|(name, sky)| {
        assert_eq!(sky.validate(), [], "{name}");
        let reference = flux(&sky::render(sky, 512, 256));
        for width in [32, 100, 256] {
            let ratio = flux(&sky::render(sky, width, width / 2)) / reference;
            assert!((ratio - 1.0).abs() < 0.01, "{name} at {width}: {ratio} of the light");
        }
    });
}

#[test]
fn the_sun_keeps_its_irradiance_whatever_its_radius() {
    let alone = |radius| {
        let with = integrate(&sky::render(&daylight(40.0, radius, 1.0), 512, 256), |c, _| f64::from(luminance(c)));
        let without = integrate(&sky::render(&daylight(40.0, radius, 0.0), 512, 256), |c, _| f64::from(luminance(c)));
        with - without
    };
    let real = alone(0.27);
    for radius in [0.5, 1.0, 3.0, 10.0] {
        // Irradiance weights the disc by the cosine of its radius, flux does not.
        let expected = (1.0 - f64::from(radius).to_radians().cos()) * 2.0 / f64::from(radius).to_radians().sin().powi(2);
        let ratio = alone(radius) / real;
        assert!((ratio / expected - 1.0).abs() < 0.01, "radius {radius}: {ratio}");
    }
}

#[test]
fn the_brightest_texel_lies_where_the_sun_is() {
    for (elevation, azimuth) in [(3.0f32, 10.0f32), (30.0, 100.0), (55.0, 260.0), (80.0, 359.0)] {
        let sun = Sun { elevation, azimuth, radius: 0.27, gain: 1.0 };
        let map = sky::render(&Sky::Daylight { sun, turbidity: 3.0, ground: [0.2; 3], luminance: 0.5 }, 256, 128);
        let brightest = (0..map.pixels.len()).max_by(|&a, &b| luminance(map.pixels[a]).total_cmp(&luminance(map.pixels[b])));
        let index = brightest.expect("pixels");
        let (x, y) = ((index % 256) as f32 + 0.5, (index / 256) as f32 + 0.5);
        let (found_azimuth, found_elevation) = (x / 256.0 * 360.0, 90.0 - y / 128.0 * 180.0);
        assert!((found_elevation - elevation).abs() <= 1.41, "elevation {found_elevation}, expected {elevation}");
        assert!((found_azimuth - azimuth).abs() <= 1.41, "azimuth {found_azimuth}, expected {azimuth}");
    }
}

#[test]
fn clear_skies_have_the_asked_luminance_and_natural_ratios() {
    for elevation in [-4.0, 2.0, 15.0, 45.0, 80.0] {
        let map = sky::render(&daylight(elevation, 0.27, 0.0), 256, 128);
        let mean = flux(&map) / TAU;
        assert!((mean - 0.5).abs() < 0.01, "mean luminance {mean} at {elevation} degrees");
    }
    // Measured clear days send 10 to 20% of the light from the sky when the sun is high (e.g. the ASHRAE clear-sky model),
    // a little more of the visible part.
    let share = |elevation| {
        let sky = irradiance(&sky::render(&daylight(elevation, 0.27, 0.0), 256, 128));
        sky / irradiance(&sky::render(&daylight(elevation, 0.27, 1.0), 256, 128))
    };
    let (high, low) = (share(60.0), share(8.0));
    assert!((0.08..0.28).contains(&high), "diffuse share {high} at 60 degrees");
    assert!(low > 1.8 * high, "diffuse share {low} at 8 degrees");
    // Blue above, and a sun that reddens as it sinks.
    let map = sky::render(&daylight(60.0, 0.27, 0.0), 64, 32);
    let zenith = map.at(48, 1);
    assert!(zenith[2] > 1.8 * zenith[0], "zenith {zenith:?}");
    let sun_color = |elevation| {
        let (with, without) = (daylight(elevation, 0.27, 1.0), daylight(elevation, 0.27, 0.0));
        let channel = |sky: &Sky, k: usize| integrate(&sky::render(sky, 256, 128), |c, _| f64::from(c[k]));
        let light = [0, 2].map(|k| channel(&with, k) - channel(&without, k));
        light[0] / light[1]
    };
    let (noon, evening) = (sun_color(60.0), sun_color(4.0));
    assert!((1.0..1.8).contains(&noon) && evening > 3.0 * noon, "red over blue {noon} at noon, {evening} in the evening");
}

#[test]
fn overcast_irradiance_is_seven_ninths_of_pi() {
    let sky = Sky::Overcast { zenith: [1.0; 3], ground: [0.0; 3], glow: 0.0, glow_elevation: 0.0, glow_azimuth: 0.0 };
    let e = irradiance(&sky::render(&sky, 256, 128));
    assert!((e / (7.0 / 9.0 * PI) - 1.0).abs() < 0.005, "{e}");
}

#[test]
fn a_softbox_overhead_gives_the_textbook_irradiance() {
    // A rectangle of half extents a, b at height h, parallel to the receiver below its middle (Siegel and Howell, configuration
    // 1).
    let (a, b, h) = (0.9f64, 0.4f64, 1.5f64);
    let (x, y) = (a / h, b / h);
    let corner = x / (1.0 + x * x).sqrt() * (y / (1.0 + x * x).sqrt()).atan()
        + y / (1.0 + y * y).sqrt() * (x / (1.0 + y * y).sqrt()).atan();
    let expected = 10.0 * 4.0 * 0.5 * corner;
    let lamp = Lamp {
        position: [0.0, h as f32, 0.0],
        size: [2.0 * a as f32, 2.0 * b as f32],
        roll: 30.0,
        shape: LampShape::Rectangle,
        color: [1.0; 3],
        power: 10.0,
        softness: 0.0,
        mask: None,
    };
    for width in [64, 256] {
        let sky = Sky::Studio { lamps: vec![lamp.clone()], fill: [0.0; 3], floor: [0.0; 3], backdrop: None };
        let e = irradiance(&sky::render(&sky, width, width / 2));
        assert!((e / expected - 1.0).abs() < 0.01, "{e}, expected {expected}");
    }
}

#[test]
fn odd_sizes_and_bad_parameters_do_not_panic() {
    for (_, sky) in sky::library().iter().step_by(3) {
        for (width, height) in [(0, 0), (1, 1), (3, 7), (17, 2)] {
            let map = sky::render(sky, width, height);
            assert_eq!(map.pixels.len(), width * height);
            assert!(map.pixels.iter().flatten().all(|v| v.is_finite()));
        }
    }
    let sun = Sun { elevation: f32::NAN, azimuth: 0.0, radius: 20.0, gain: -1.0 };
    let sky = Sky::Daylight { sun, turbidity: 0.0, ground: [0.0; 3], luminance: 1.0 };
    let pointers: Vec<String> = sky.validate().into_iter().map(|(at, _)| at).collect();
    assert_eq!(pointers, ["/sun/elevation", "/sun/radius", "/sun/gain", "/turbidity"]);
    assert!(sky::render(&sky, 8, 4).pixels.iter().flatten().all(|v| v.is_finite()));
}
