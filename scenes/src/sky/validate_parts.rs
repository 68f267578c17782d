//! Range checks of the parts of composed families.

use super::parts::{Air, Backdrop, Beam, CloudLayer, Cover, Furnishing, Glow, Ground, Horizon, LightGroup, Opening, Stars};
use super::{Mask, Sun};
use crate::shapes::Faults;

const TURNS: f32 = 3600.0;

pub(super) fn sun(faults: &mut Faults, at: &str, sun: &Sun) {
    faults.range(&format!("{at}/elevation"), sun.elevation, -5.0, 90.0);
    faults.range(&format!("{at}/azimuth"), sun.azimuth, -TURNS, TURNS);
    faults.range(&format!("{at}/radius"), sun.radius, 0.2, 10.0);
    faults.range(&format!("{at}/gain"), sun.gain, 0.0, 100.0);
}

pub(super) fn air(faults: &mut Faults, air: &Air) {
    match air {
        Air::Clear { sun: star, sun_tint, turbidity, luminance, tint } => {
            sun(faults, "air/sun", star);
            faults.ranges("air/sun_tint", sun_tint, 0.0, 4.0);
            faults.range("air/turbidity", *turbidity, 1.0, 12.0);
            faults.range("air/luminance", *luminance, 1e-4, 100.0);
            faults.ranges("air/tint", tint, 0.0, 4.0);
        }
        Air::Gradient { zenith, horizon, sharpness } => {
            faults.ranges("air/zenith", zenith, 0.0, 1e4);
            faults.ranges("air/horizon", horizon, 0.0, 1e4);
            faults.range("air/sharpness", *sharpness, 0.1, 10.0);
        }
        Air::Overcast { zenith, glow, glow_elevation, glow_azimuth } => {
            faults.ranges("air/zenith", zenith, 0.0, 1e4);
            faults.range("air/glow", *glow, 0.0, 10.0);
            faults.range("air/glow_elevation", *glow_elevation, 0.0, 90.0);
            faults.range("air/glow_azimuth", *glow_azimuth, -TURNS, TURNS);
        }
    }
}

/// A list that may be empty.
fn at_most(faults: &mut Faults, field: &str, length: usize, most: usize) {
    if length > most {
        faults.0.push((format!("/{field}"), format!("{length} entries, outside 0..={most}")));
    }
}

pub(super) fn clouds(faults: &mut Faults, layers: &[CloudLayer]) {
    at_most(faults, "clouds", layers.len(), 4);
    for (index, layer) in layers.iter().enumerate() {
        faults.range(&format!("clouds/{index}/coverage"), layer.coverage, 0.0, 1.0);
        faults.range(&format!("clouds/{index}/scale"), layer.scale, 0.2, 5.0);
        faults.range(&format!("clouds/{index}/depth"), layer.depth, 0.02, 3.0);
        faults.range(&format!("clouds/{index}/direction"), layer.direction, -TURNS, TURNS);
    }
}

pub(super) fn glows(faults: &mut Faults, glows: &[Glow]) {
    at_most(faults, "glows", glows.len(), 12);
    for (index, glow) in glows.iter().enumerate() {
        faults.range(&format!("glows/{index}/elevation"), glow.elevation, -30.0, 90.0);
        faults.range(&format!("glows/{index}/azimuth"), glow.azimuth, -TURNS, TURNS);
        faults.range(&format!("glows/{index}/width"), glow.width, 3.0, 90.0);
        faults.range(&format!("glows/{index}/flatness"), glow.flatness, 1.0, 8.0);
        faults.ranges(&format!("glows/{index}/radiance"), &glow.radiance, 0.0, 1e3);
    }
}

pub(super) fn stars(faults: &mut Faults, stars: &Stars) {
    faults.range("stars/count", stars.count as f32, 1.0, 4000.0);
    faults.range("stars/luminance", stars.luminance, 0.0, 10.0);
    faults.ranges("stars/milky_way", &stars.milky_way, 0.0, 10.0);
}

pub(super) fn horizon(faults: &mut Faults, horizon: &Horizon) {
    faults.range("horizon/height", horizon.height, 0.2, 75.0);
    faults.ranges("horizon/color", &horizon.color, 0.0, 1.0);
    faults.range("horizon/haze", horizon.haze, 0.0, 1.0);
    faults.range("horizon/lit", horizon.lit, 0.0, 1.0);
    faults.range("horizon/luminance", horizon.luminance, 0.0, 100.0);
}

pub(super) fn cover(faults: &mut Faults, cover: &Cover) {
    faults.range("cover/amount", cover.amount, 0.02, 0.98);
    faults.range("cover/scale", cover.scale, 0.2, 5.0);
    faults.range("cover/elevation", cover.elevation, -10.0, 90.0);
    faults.range("cover/azimuth", cover.azimuth, -TURNS, TURNS);
    faults.ranges("cover/color", &cover.color, 0.0, 1.0);
}

pub(super) fn lights(faults: &mut Faults, groups: &[LightGroup]) {
    at_most(faults, "lights", groups.len(), 4);
    for (index, group) in groups.iter().enumerate() {
        faults.range(&format!("lights/{index}/count"), group.count as f32, 1.0, 64.0);
        faults.range(&format!("lights/{index}/radius"), group.radius, 0.1, 10.0);
        faults.range(&format!("lights/{index}/azimuth"), group.azimuth, -TURNS, TURNS);
        faults.range(&format!("lights/{index}/elevation"), group.elevation, -20.0, 85.0);
        faults.range(&format!("lights/{index}/luminance"), group.luminance, 0.0, 100.0);
    }
}

pub(super) fn ground(faults: &mut Faults, ground: &Ground) {
    match ground {
        Ground::Plain { color, variation, .. } => {
            faults.ranges("ground/color", color, 0.0, 1.0);
            faults.range("ground/variation", *variation, 0.0, 1.0);
        }
        Ground::Water { color, wind } => {
            faults.ranges("ground/color", color, 0.0, 1.0);
            faults.range("ground/wind", *wind, 0.2, 15.0);
        }
    }
}

pub(super) fn openings(faults: &mut Faults, openings: &[Opening], room: [f32; 3]) {
    faults.count("openings", openings.len(), 48);
    for (index, opening) in openings.iter().enumerate() {
        let at = format!("openings/{index}");
        for (k, face) in opening.wall.face(room).into_iter().enumerate() {
            faults.range(&format!("{at}/size/{k}"), opening.size[k], 0.05, face);
            let play = 0.5 * (face - opening.size[k]).max(0.0);
            faults.range(&format!("{at}/offset/{k}"), opening.offset[k], -play, play);
        }
        faults.ranges(&format!("{at}/radiance"), &opening.radiance, 0.0, 1e4);
        opening.lower.iter().for_each(|lower| faults.ranges(&format!("{at}/lower"), lower, 0.0, 1e4));
        faults.ranges(&format!("{at}/panes"), &opening.panes.map(|n| n as f32), 1.0, 12.0);
    }
}

pub(super) fn beam(faults: &mut Faults, beam: &Beam) {
    faults.range("beam/elevation", beam.elevation, 1.0, 89.0);
    faults.range("beam/azimuth", beam.azimuth, -TURNS, TURNS);
    faults.ranges("beam/irradiance", &beam.irradiance, 0.0, 1e4);
}

pub(super) fn furnishing(faults: &mut Faults, furnishing: &Furnishing) {
    faults.range("furnishing/pillars", furnishing.pillars as f32, 0.0, 12.0);
    faults.range("furnishing/boxes", furnishing.boxes as f32, 0.0, 16.0);
    faults.range("furnishing/contrast", furnishing.contrast, 0.0, 1.0);
    faults.range("furnishing/scale", furnishing.scale, 0.05, 5.0);
}

pub(super) fn backdrop(faults: &mut Faults, backdrop: &Backdrop) {
    faults.range("backdrop/azimuth", backdrop.azimuth, -TURNS, TURNS);
    faults.range("backdrop/width", backdrop.width, 10.0, 360.0);
    faults.range("backdrop/top", backdrop.top, 0.0, 85.0);
    faults.range("backdrop/bottom", backdrop.bottom, -90.0, 0.0);
    faults.ranges("backdrop/base", &backdrop.base, 0.0, 100.0);
    faults.ranges("backdrop/rise", &backdrop.rise, 0.0, 100.0);
}

pub(super) fn mask(faults: &mut Faults, at: &str, mask: &Mask) {
    let share = |faults: &mut Faults, field: &str, value: f32| faults.range(&format!("{at}/{field}"), value, 0.05, 0.95);
    match mask {
        Mask::Ring { inner } => share(faults, "inner", *inner),
        Mask::Slats { count, open } => {
            faults.range(&format!("{at}/count"), *count as f32, 1.0, 24.0);
            share(faults, "open", *open);
        }
        Mask::Cells { cells, open } => {
            faults.ranges(&format!("{at}/cells"), &cells.map(|n| n as f32), 1.0, 24.0);
            share(faults, "open", *open);
        }
        Mask::Leaves { open, .. } => share(faults, "open", *open),
    }
}
