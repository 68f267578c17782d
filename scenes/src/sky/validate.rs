//! Range checks of sky parameters.

use super::{Lamp, Sky, Sun, Wall, Window, validate_parts};
use crate::shapes::Faults;

pub(super) fn validate(sky: &Sky) -> Vec<(String, String)> {
    let mut faults = Faults::default();
    match sky {
        Sky::Uniform { radiance } => faults.ranges("radiance", radiance, 0.0, 1e4),
        Sky::Gradient { zenith, horizon, ground, sharpness } => {
            faults.ranges("zenith", zenith, 0.0, 1e4);
            faults.ranges("horizon", horizon, 0.0, 1e4);
            faults.ranges("ground", ground, 0.0, 1e4);
            faults.range("sharpness", *sharpness, 0.1, 10.0);
        }
        Sky::Daylight { sun, turbidity, ground, luminance } => {
            outdoors(&mut faults, sun, 90.0, *turbidity, ground, *luminance);
        }
        Sky::Cloudy { sun, turbidity, coverage, scale, ground, luminance, .. } => {
            outdoors(&mut faults, sun, 90.0, *turbidity, ground, *luminance);
            faults.range("coverage", *coverage, 0.0, 1.0);
            faults.range("scale", *scale, 0.2, 5.0);
        }
        Sky::Sunset { sun, turbidity, bands, ground, luminance, .. } => {
            outdoors(&mut faults, sun, 15.0, *turbidity, ground, *luminance);
            faults.range("bands", *bands, 0.0, 1.0);
        }
        Sky::Overcast { zenith, ground, glow, glow_elevation, glow_azimuth } => {
            faults.ranges("zenith", zenith, 0.0, 1e4);
            faults.ranges("ground", ground, 0.0, 1.0);
            faults.range("glow", *glow, 0.0, 10.0);
            faults.range("glow_elevation", *glow_elevation, 0.0, 90.0);
            faults.range("glow_azimuth", *glow_azimuth, -3600.0, 3600.0);
        }
        Sky::Studio { lamps, fill, floor, backdrop } => {
            faults.count("lamps", lamps.len(), 64);
            for (index, lamp) in lamps.iter().enumerate() {
                check_lamp(&mut faults, &format!("lamps/{index}"), lamp);
            }
            faults.ranges("fill", fill, 0.0, 100.0);
            faults.ranges("floor", floor, 0.0, 100.0);
            if let Some(backdrop) = backdrop {
                validate_parts::backdrop(&mut faults, backdrop);
            }
        }
        Sky::Night { zenith, horizon, ground, lights, light_radius, luminance, .. } => {
            faults.ranges("zenith", zenith, 0.0, 100.0);
            faults.ranges("horizon", horizon, 0.0, 100.0);
            faults.ranges("ground", ground, 0.0, 100.0);
            faults.range("lights", *lights as f32, 1.0, 64.0);
            faults.range("light_radius", *light_radius, 0.2, 8.0);
            faults.range("luminance", *luminance, 0.0, 100.0);
        }
        Sky::Interior { size, eye_height, walls, floor, windows } => {
            faults.ranges("size", size, 1.0, 100.0);
            faults.range("eye_height", *eye_height, 0.1, 0.9 * size[1]);
            faults.ranges("walls", walls, 0.0, 1.0);
            faults.ranges("floor", floor, 0.0, 1.0);
            faults.count("windows", windows.len(), 16);
            for (index, window) in windows.iter().enumerate() {
                check_window(&mut faults, &format!("windows/{index}"), window, *size);
            }
        }
        Sky::Scenery { air, clouds, glows, stars, horizon, cover, lights, ground } => {
            validate_parts::air(&mut faults, air);
            validate_parts::clouds(&mut faults, clouds);
            validate_parts::glows(&mut faults, glows);
            stars.iter().for_each(|stars| validate_parts::stars(&mut faults, stars));
            horizon.iter().for_each(|horizon| validate_parts::horizon(&mut faults, horizon));
            cover.iter().for_each(|cover| validate_parts::cover(&mut faults, cover));
            validate_parts::lights(&mut faults, lights);
            validate_parts::ground(&mut faults, ground);
        }
        Sky::Room { size, eye_height, walls, floor, ceiling, openings, beam, furnishing } => {
            faults.ranges("size", size, 1.0, 100.0);
            faults.range("eye_height", *eye_height, 0.1, 0.9 * size[1]);
            for (field, color) in [("walls", walls), ("floor", floor), ("ceiling", ceiling)] {
                faults.ranges(field, color, 0.0, 0.95);
            }
            validate_parts::openings(&mut faults, openings, *size);
            beam.iter().for_each(|beam| validate_parts::beam(&mut faults, beam));
            furnishing.iter().for_each(|furnishing| validate_parts::furnishing(&mut faults, furnishing));
        }
        Sky::Abstract { colors, scale, softness, elevation, azimuth, .. } => {
            if !(2..=8).contains(&colors.len()) {
                faults.0.push(("/colors".to_owned(), format!("{} entries, outside 2..=8", colors.len())));
            }
            for (index, color) in colors.iter().enumerate() {
                faults.ranges(&format!("colors/{index}"), color, 0.0, 1e4);
            }
            faults.range("scale", *scale, 0.3, 10.0);
            faults.range("softness", *softness, 0.0, 1.0);
            faults.range("elevation", *elevation, -90.0, 90.0);
            faults.range("azimuth", *azimuth, -3600.0, 3600.0);
        }
    }
    faults.0
}

fn outdoors(faults: &mut Faults, sun: &Sun, highest: f32, turbidity: f32, ground: &[f32], luminance: f32) {
    faults.range("sun/elevation", sun.elevation, -5.0, highest);
    faults.range("sun/azimuth", sun.azimuth, -3600.0, 3600.0);
    faults.range("sun/radius", sun.radius, 0.2, 10.0);
    faults.range("sun/gain", sun.gain, 0.0, 100.0);
    faults.range("turbidity", turbidity, 1.0, 12.0);
    faults.ranges("ground", ground, 0.0, 1.0);
    faults.range("luminance", luminance, 0.001, 100.0);
}

fn check_lamp(faults: &mut Faults, at: &str, lamp: &Lamp) {
    let distance = lamp.position.iter().map(|v| v * v).sum::<f32>().sqrt();
    if !(0.2..=100.0).contains(&distance) {
        faults.0.push((format!("/{at}/position"), format!("{distance} m from the centre is outside 0.2..=100")));
    }
    faults.ranges(&format!("{at}/size"), &lamp.size, 0.02, 20.0);
    faults.range(&format!("{at}/roll"), lamp.roll, -3600.0, 3600.0);
    faults.ranges(&format!("{at}/color"), &lamp.color, 0.0, 1.0);
    faults.range(&format!("{at}/power"), lamp.power, 0.0, 1e5);
    faults.range(&format!("{at}/softness"), lamp.softness, 0.0, 1.0);
    if let Some(mask) = &lamp.mask {
        validate_parts::mask(faults, &format!("{at}/mask"), mask);
    }
}

fn check_window(faults: &mut Faults, at: &str, window: &Window, room: [f32; 3]) {
    let face = match window.wall {
        Wall::North | Wall::South => [room[0], room[1]],
        Wall::East | Wall::West => [room[2], room[1]],
        Wall::Ceiling => [room[0], room[2]],
    };
    for (k, face) in face.into_iter().enumerate() {
        faults.range(&format!("{at}/size/{k}"), window.size[k], 0.05, face);
        let play = 0.5 * (face - window.size[k]).max(0.0);
        faults.range(&format!("{at}/offset/{k}"), window.offset[k], -play, play);
    }
    faults.ranges(&format!("{at}/radiance"), &window.radiance, 0.0, 1e4);
}
