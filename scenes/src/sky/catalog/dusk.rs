//! The sun at the horizon.

use super::soft::glowing;
use super::{CONCRETE, GRASS, Place, ROCK, SEA, SOIL, clear, degrees, ground, layer, plain, shaded, skyline, tint, which};
use crate::draw::Draw;
use crate::sky::{Air, CloudKind, Glow, Ground, Horizon, HorizonKind, Sky, Sun};
use rand_pcg::Pcg64;

fn setting(rng: &mut Pcg64, low: f32, high: f32) -> Sun {
    Sun { elevation: rng.between(low, high), azimuth: degrees(rng), radius: rng.log(0.27, 1.5), gain: rng.log(0.7, 4.0) }
}

fn air(rng: &mut Pcg64, low: f32, high: f32) -> Air {
    let sun = setting(rng, low, high);
    match clear(rng, sun, 7.0) {
        Air::Clear { sun, sun_tint, turbidity, luminance, tint } => {
            Air::Clear { sun, sun_tint, turbidity: turbidity.max(2.0), luminance: Pcg64::tidy(0.8 * luminance), tint }
        }
        other => other,
    }
}

pub(super) fn sunset_clear(rng: &mut Pcg64) -> Sky {
    let air = air(rng, -2.0, 10.0);
    Place { air, clouds: Vec::new(), horizon: None, ground: plain(rng, SOIL) }.sky()
}

pub(super) fn sunset_streaks(rng: &mut Pcg64) -> Sky {
    Sky::Sunset {
        sun: setting(rng, -3.0, 13.0),
        turbidity: rng.log(2.0, 7.0),
        bands: rng.between(0.3, 1.0),
        seed: which(rng),
        ground: ground(rng),
        luminance: rng.log(0.15, 0.6),
    }
}

pub(super) fn sunset_sea(rng: &mut Pcg64) -> Sky {
    let air = air(rng, 0.5, 9.0);
    let clouds = if rng.chance(0.6) { vec![layer(rng, CloudKind::Cirrus, [0.3, 0.8])] } else { Vec::new() };
    Place { air, clouds, horizon: None, ground: Ground::Water { color: shaded(rng, SEA), wind: rng.log(0.4, 7.0) } }.sky()
}

pub(super) fn sunset_ridges(rng: &mut Pcg64) -> Sky {
    let air = air(rng, 1.0, 12.0);
    let horizon = skyline(rng, HorizonKind::Ridges, [6.0, 22.0], ROCK, [0.3, 0.85]);
    let clouds = if rng.chance(0.5) { vec![layer(rng, CloudKind::Cirrus, [0.3, 0.8])] } else { Vec::new() };
    Place { air, clouds, horizon: Some(horizon), ground: plain(rng, GRASS) }.sky()
}

pub(super) fn sunset_skyline(rng: &mut Pcg64) -> Sky {
    let air = air(rng, 0.0, 9.0);
    let horizon = Horizon {
        lit: rng.between(0.05, 0.5),
        luminance: rng.log(0.005, 0.08),
        ..skyline(rng, HorizonKind::Skyline, [5.0, 25.0], CONCRETE, [0.1, 0.6])
    };
    let clouds = if rng.chance(0.5) { vec![layer(rng, CloudKind::Altocumulus, [0.25, 0.6])] } else { Vec::new() };
    Place { air, clouds, horizon: Some(horizon), ground: plain(rng, CONCRETE) }.sky()
}

pub(super) fn sunset_cumulus(rng: &mut Pcg64) -> Sky {
    let air = air(rng, 0.5, 12.0);
    let clouds = vec![layer(rng, CloudKind::Cirrus, [0.2, 0.5]), layer(rng, CloudKind::Cumulus, [0.2, 0.6])];
    let horizon = rng.chance(0.6).then(|| skyline(rng, HorizonKind::Trees, [2.0, 9.0], GRASS, [0.1, 0.5]));
    Place { air, clouds, horizon, ground: plain(rng, GRASS) }.sky()
}

/// The sun under the rim of a dark cloud.
pub(super) fn storm_sunset(rng: &mut Pcg64) -> Sky {
    let air = air(rng, 1.0, 7.0);
    let azimuth = match &air {
        Air::Clear { sun, .. } => sun.azimuth,
        _ => 0.0,
    };
    let clouds = vec![layer(rng, CloudKind::Storm, [0.5, 0.8])];
    let level = rng.log(0.5, 4.0);
    let warm = [1.0, rng.between(0.35, 0.6), rng.between(0.1, 0.35)].map(|v| Pcg64::tidy(v * level));
    let glow = Glow { elevation: 2.0, azimuth, width: rng.between(20.0, 60.0), flatness: rng.between(2.0, 6.0), radiance: warm };
    let horizon = skyline(rng, HorizonKind::Hills, [2.0, 9.0], ROCK, [0.1, 0.4]);
    glowing(Place { air, clouds, horizon: Some(horizon), ground: plain(rng, SOIL) }.sky(), vec![glow])
}

pub(super) fn dawn_mist(rng: &mut Pcg64) -> Sky {
    let sun = Sun { radius: rng.log(0.5, 4.0), ..setting(rng, 1.0, 14.0) };
    let air = Air::Clear {
        sun,
        sun_tint: [1.0, rng.between(0.75, 1.0), rng.between(0.55, 1.0)],
        turbidity: rng.between(6.0, 12.0),
        luminance: rng.log(0.15, 0.6),
        tint: [1.0, rng.between(0.9, 1.0), rng.between(0.85, 1.1)],
    };
    let horizon = skyline(rng, HorizonKind::Trees, [4.0, 16.0], [0.08, 0.09, 0.06], [0.6, 0.95]);
    Place { air, clouds: Vec::new(), horizon: Some(horizon), ground: plain(rng, GRASS) }.sky()
}

/// After sunset: a band of light and a dark zenith.
pub(super) fn twilight_glow(rng: &mut Pcg64) -> Sky {
    let level = rng.log(0.08, 0.5);
    let zenith = [rng.between(0.15, 0.4), rng.between(0.2, 0.45), rng.between(0.6, 1.0)].map(|v| Pcg64::tidy(v * 0.5 * level));
    let air = Air::Gradient { zenith, horizon: tint(rng, 0.6 * level, 0.25), sharpness: rng.between(0.3, 0.9) };
    let strength = level * rng.log(1.0, 8.0);
    let warm = [1.0, rng.between(0.35, 0.65), rng.between(0.1, 0.5)].map(|v| Pcg64::tidy(v * strength));
    let glow = Glow {
        elevation: rng.between(-3.0, 3.0),
        azimuth: degrees(rng),
        width: rng.between(25.0, 70.0),
        flatness: rng.between(1.5, 5.0),
        radiance: warm,
    };
    let kind = [HorizonKind::Hills, HorizonKind::Trees, HorizonKind::Roofs][rng.below(3) as usize];
    let horizon = skyline(rng, kind, [3.0, 18.0], SOIL, [0.0, 0.4]);
    let lit = if kind == HorizonKind::Roofs { rng.between(0.1, 0.5) } else { 0.0 };
    let horizon = Horizon { lit, luminance: Pcg64::tidy(0.15 * level), ..horizon };
    let clouds = if rng.chance(0.5) { vec![layer(rng, CloudKind::Cirrus, [0.2, 0.6])] } else { Vec::new() };
    glowing(Place { air, clouds, horizon: Some(horizon), ground: plain(rng, SOIL) }.sky(), vec![glow])
}
