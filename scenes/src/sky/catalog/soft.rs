//! Places out of doors without a visible sun, or nearly.

use super::{
    ASPHALT, CONCRETE, GRASS, LEAVES, Place, ROCK, SEA, SNOW, clear, degrees, ground, layer, plain, shaded, skyline, sun, tint,
};
use crate::draw::Draw;
use crate::sky::{Air, CloudKind, Glow, Ground, HorizonKind, Scenery, Sky};
use rand_pcg::Pcg64;

fn overcast(rng: &mut Pcg64, brightest_glow: f32) -> Air {
    let level = rng.log(0.3, 1.5);
    Air::Overcast {
        zenith: tint(rng, level, 0.12),
        glow: rng.between(0.0, brightest_glow),
        glow_elevation: rng.between(10.0, 80.0),
        glow_azimuth: degrees(rng),
    }
}

pub(super) fn overcast_plain(rng: &mut Pcg64) -> Sky {
    let level = rng.log(0.3, 1.5);
    Sky::Overcast {
        zenith: tint(rng, level, 0.12),
        ground: ground(rng),
        glow: rng.between(0.0, 3.0),
        glow_elevation: rng.between(10.0, 80.0),
        glow_azimuth: degrees(rng),
    }
}

pub(super) fn overcast_hills(rng: &mut Pcg64) -> Sky {
    let air = overcast(rng, 2.0);
    let clouds = vec![layer(rng, CloudKind::Stratus, [0.3, 0.8])];
    let horizon = skyline(rng, HorizonKind::Hills, [6.0, 24.0], GRASS, [0.3, 0.8]);
    Place { air, clouds, horizon: Some(horizon), ground: plain(rng, GRASS) }.sky()
}

pub(super) fn fog(rng: &mut Pcg64) -> Sky {
    let level = rng.log(0.2, 1.0);
    let horizon = tint(rng, level, 0.1);
    let lift = rng.between(0.8, 1.7);
    let zenith = horizon.map(|v| Pcg64::tidy(v * lift));
    let kind = if rng.chance(0.5) { HorizonKind::Trees } else { HorizonKind::Skyline };
    let standing = skyline(rng, kind, [6.0, 30.0], [0.2; 3], [0.75, 0.97]);
    let color = if kind == HorizonKind::Trees { GRASS } else { ASPHALT };
    let air = Air::Gradient { zenith, horizon, sharpness: rng.between(0.5, 1.5) };
    let place = Place { air, clouds: Vec::new(), horizon: Some(standing), ground: plain(rng, color) };
    let strength = level * rng.log(0.3, 6.0);
    let glow = Glow {
        elevation: rng.between(5.0, 50.0),
        azimuth: degrees(rng),
        width: rng.between(12.0, 40.0),
        flatness: 1.0,
        radiance: tint(rng, strength, 0.15),
    };
    glowing(place.sky(), vec![glow])
}

/// Sets the soft bright places of a scenery.
pub(super) fn glowing(sky: Sky, glows: Vec<Glow>) -> Sky {
    match sky {
        Sky::Scenery(scenery) => Sky::Scenery(Scenery { glows, ..scenery }),
        other => other,
    }
}

pub(super) fn stratus_glow(rng: &mut Pcg64) -> Sky {
    let sun = sun(rng, 10.0, 60.0);
    let air = clear(rng, sun, 6.0);
    let clouds = vec![layer(rng, CloudKind::Stratus, [0.6, 0.95])];
    let horizon = rng.chance(0.5).then(|| skyline(rng, HorizonKind::Trees, [3.0, 12.0], LEAVES, [0.2, 0.7]));
    Place { air, clouds, horizon, ground: plain(rng, GRASS) }.sky()
}

pub(super) fn storm(rng: &mut Pcg64) -> Sky {
    let sun = sun(rng, 15.0, 60.0);
    let air = clear(rng, sun, 5.0);
    let clouds = vec![layer(rng, CloudKind::Storm, [0.7, 0.97])];
    let horizon = rng.chance(0.6).then(|| skyline(rng, HorizonKind::Hills, [3.0, 16.0], GRASS, [0.2, 0.6]));
    Place { air, clouds, horizon, ground: plain(rng, GRASS) }.sky()
}

/// Dark clouds with a bright strip under them.
pub(super) fn storm_break(rng: &mut Pcg64) -> Sky {
    let sun = sun(rng, 15.0, 50.0);
    let air = clear(rng, sun, 4.0);
    let clouds = vec![layer(rng, CloudKind::Storm, [0.6, 0.85])];
    let level = rng.log(0.6, 4.0);
    let strip = Glow {
        elevation: rng.between(1.0, 8.0),
        azimuth: degrees(rng),
        width: rng.between(30.0, 75.0),
        flatness: rng.between(3.0, 8.0),
        radiance: tint(rng, level, 0.25),
    };
    let kind = if rng.chance(0.5) { HorizonKind::Ridges } else { HorizonKind::Skyline };
    let horizon = skyline(rng, kind, [4.0, 20.0], ROCK, [0.1, 0.5]);
    glowing(Place { air, clouds, horizon: Some(horizon), ground: plain(rng, ROCK) }.sky(), vec![strip])
}

/// Wet streets mirror the grey sky.
pub(super) fn rainy_city(rng: &mut Pcg64) -> Sky {
    let air = overcast(rng, 0.6);
    let clouds = vec![layer(rng, CloudKind::Stratus, [0.5, 0.9])];
    let horizon = skyline(rng, HorizonKind::Skyline, [14.0, 50.0], CONCRETE, [0.3, 0.75]);
    let horizon = crate::sky::Horizon { lit: rng.between(0.05, 0.4), luminance: rng.log(0.003, 0.05), ..horizon };
    Place { air, clouds, horizon: Some(horizon), ground: Ground::Water { color: shaded(rng, ASPHALT), wind: rng.log(0.3, 3.0) } }
        .sky()
}

/// Deep between walls: the sun lights their rims only, if it is seen at all.
pub(super) fn open_shade(rng: &mut Pcg64) -> Sky {
    let sun = sun(rng, 10.0, 35.0);
    let air = clear(rng, sun, 3.0);
    let kind = if rng.chance(0.5) { HorizonKind::Cliffs } else { HorizonKind::Skyline };
    let horizon = skyline(rng, kind, [58.0, 74.0], CONCRETE, [0.0, 0.15]);
    Place { air, clouds: Vec::new(), horizon: Some(horizon), ground: plain(rng, CONCRETE) }.sky()
}

pub(super) fn winter_woods(rng: &mut Pcg64) -> Sky {
    let air = overcast(rng, 1.5);
    let horizon = skyline(rng, HorizonKind::Trees, [10.0, 35.0], [0.09, 0.08, 0.07], [0.2, 0.7]);
    Place { air, clouds: Vec::new(), horizon: Some(horizon), ground: plain(rng, SNOW) }.sky()
}

pub(super) fn grey_sea(rng: &mut Pcg64) -> Sky {
    let air = overcast(rng, 3.0);
    let kind = if rng.chance(0.5) { CloudKind::Stratus } else { CloudKind::Storm };
    let clouds = vec![layer(rng, kind, [0.4, 0.85])];
    Place { air, clouds, horizon: None, ground: Ground::Water { color: shaded(rng, SEA), wind: rng.log(2.0, 15.0) } }.sky()
}

pub(super) fn soft_gradient(rng: &mut Pcg64) -> Sky {
    let (high, low) = (rng.log(0.15, 1.2), rng.log(0.15, 1.2));
    Sky::Gradient {
        zenith: tint(rng, high, 0.4),
        horizon: tint(rng, low, 0.4),
        ground: tint(rng, 0.3 * low, 0.3),
        sharpness: rng.log(0.3, 2.0),
    }
}
