//! Places in the sun; half of them under a low and hard one.

use super::{
    ASPHALT, CONCRETE, GRASS, LEAVES, Place, RED_ROCK, ROCK, SAND, SEA, SNOW, SOIL, any_ground, clear, degrees, layer,
    low_hard_sun, plain, shaded, skyline, sun, which,
};
use crate::draw::Draw;
use crate::sky::{Air, CloudKind, Cover, CoverKind, Ground, HorizonKind, Scenery, Sky, Sun};
use rand_pcg::Pcg64;

pub(super) fn clear_high_sun(rng: &mut Pcg64) -> Sky {
    let sun = sun(rng, 35.0, 85.0);
    let air = clear(rng, sun, 5.0);
    Place { air, clouds: Vec::new(), horizon: None, ground: any_ground(rng) }.sky()
}

pub(super) fn clear_low_sun(rng: &mut Pcg64) -> Sky {
    let sun = low_hard_sun(rng);
    let air = clear(rng, sun, 5.0);
    Place { air, clouds: Vec::new(), horizon: None, ground: any_ground(rng) }.sky()
}

pub(super) fn hazy_sun(rng: &mut Pcg64) -> Sky {
    let sun = Sun { radius: rng.log(1.0, 6.0), ..sun(rng, 8.0, 60.0) };
    let air = Air::Clear {
        sun,
        sun_tint: super::sun_tint(rng),
        turbidity: rng.between(5.0, 11.0),
        luminance: rng.log(0.25, 0.8),
        tint: [1.0, rng.between(0.94, 1.0), rng.between(0.82, 1.0)],
    };
    let horizon = rng.chance(0.5).then(|| skyline(rng, HorizonKind::Hills, [4.0, 16.0], GRASS, [0.5, 0.95]));
    Place { air, clouds: Vec::new(), horizon, ground: plain(rng, GRASS) }.sky()
}

/// Dust, smoke, other planets: suns of any colour under skies of another.
pub(super) fn tinted_sun(rng: &mut Pcg64) -> Sky {
    let (hue, strength) = (degrees(rng), rng.between(0.25, 0.85));
    let sky_hue = hue + rng.between(90.0, 270.0);
    let sky_strength = rng.between(0.1, 0.7);
    let air = Air::Clear {
        sun: low_hard_sun(rng),
        sun_tint: Pcg64::hsv(hue, strength, 1.2),
        turbidity: rng.log(2.0, 9.0),
        luminance: rng.log(0.2, 0.6),
        tint: Pcg64::hsv(sky_hue, sky_strength, 1.2),
    };
    let horizon = rng.chance(0.7).then(|| skyline(rng, HorizonKind::Ridges, [5.0, 22.0], ROCK, [0.2, 0.9]));
    Place { air, clouds: Vec::new(), horizon, ground: plain(rng, RED_ROCK) }.sky()
}

pub(super) fn alpine_sun(rng: &mut Pcg64) -> Sky {
    let sun = sun(rng, 15.0, 60.0);
    let air = clear(rng, sun, 2.6);
    let horizon = skyline(rng, HorizonKind::Ridges, [16.0, 42.0], ROCK, [0.1, 0.6]);
    let clouds = if rng.chance(0.5) { vec![layer(rng, CloudKind::Cumulus, [0.1, 0.45])] } else { Vec::new() };
    let color = if rng.chance(0.5) { SNOW } else { GRASS };
    Place { air, clouds, horizon: Some(horizon), ground: plain(rng, color) }.sky()
}

pub(super) fn snow_field(rng: &mut Pcg64) -> Sky {
    let sun = low_hard_sun(rng);
    let air = clear(rng, sun, 3.0);
    let kind = if rng.chance(0.5) { HorizonKind::Trees } else { HorizonKind::Hills };
    let color = if kind == HorizonKind::Trees { LEAVES } else { SNOW };
    let horizon = skyline(rng, kind, [3.0, 14.0], color, [0.1, 0.5]);
    Place { air, clouds: Vec::new(), horizon: Some(horizon), ground: plain(rng, SNOW) }.sky()
}

pub(super) fn desert_dunes(rng: &mut Pcg64) -> Sky {
    let sun = if rng.chance(0.5) { low_hard_sun(rng) } else { sun(rng, 20.0, 80.0) };
    let air = clear(rng, sun, 6.0);
    let horizon = skyline(rng, HorizonKind::Dunes, [6.0, 26.0], SAND, [0.1, 0.5]);
    Place { air, clouds: Vec::new(), horizon: Some(horizon), ground: plain(rng, SAND) }.sky()
}

pub(super) fn canyon(rng: &mut Pcg64) -> Sky {
    let sun = sun(rng, 12.0, 75.0);
    let air = clear(rng, sun, 4.0);
    let horizon = skyline(rng, HorizonKind::Cliffs, [18.0, 55.0], RED_ROCK, [0.0, 0.25]);
    let clouds = if rng.chance(0.3) { vec![layer(rng, CloudKind::Cumulus, [0.1, 0.4])] } else { Vec::new() };
    Place { air, clouds, horizon: Some(horizon), ground: plain(rng, RED_ROCK) }.sky()
}

pub(super) fn seaside(rng: &mut Pcg64) -> Sky {
    let sun = sun(rng, 20.0, 65.0);
    let air = clear(rng, sun, 5.0);
    let clouds = if rng.chance(0.6) { vec![layer(rng, CloudKind::Cumulus, [0.1, 0.5])] } else { Vec::new() };
    let horizon = rng.chance(0.4).then(|| skyline(rng, HorizonKind::Hills, [2.0, 9.0], ROCK, [0.4, 0.9]));
    Place { air, clouds, horizon, ground: Ground::Water { color: shaded(rng, SEA), wind: rng.log(1.0, 12.0) } }.sky()
}

pub(super) fn sea_low_sun(rng: &mut Pcg64) -> Sky {
    let sun = low_hard_sun(rng);
    let air = clear(rng, sun, 5.0);
    let clouds = if rng.chance(0.5) { vec![layer(rng, CloudKind::Cirrus, [0.2, 0.7])] } else { Vec::new() };
    Place { air, clouds, horizon: None, ground: Ground::Water { color: shaded(rng, SEA), wind: rng.log(0.5, 8.0) } }.sky()
}

pub(super) fn fair_cumulus(rng: &mut Pcg64) -> Sky {
    let sun = sun(rng, 15.0, 80.0);
    let air = clear(rng, sun, 4.0);
    let clouds = vec![layer(rng, CloudKind::Cumulus, [0.2, 0.65])];
    let horizon = rng.chance(0.5).then(|| skyline(rng, HorizonKind::Hills, [3.0, 14.0], GRASS, [0.3, 0.8]));
    Place { air, clouds, horizon, ground: plain(rng, GRASS) }.sky()
}

pub(super) fn cirrus_sun(rng: &mut Pcg64) -> Sky {
    let sun = if rng.chance(0.6) { low_hard_sun(rng) } else { sun(rng, 20.0, 70.0) };
    let air = clear(rng, sun, 4.0);
    let clouds = vec![layer(rng, CloudKind::Cirrus, [0.35, 0.9])];
    Place { air, clouds, horizon: None, ground: plain(rng, SOIL) }.sky()
}

pub(super) fn altocumulus_sun(rng: &mut Pcg64) -> Sky {
    let sun = sun(rng, 6.0, 50.0);
    let air = clear(rng, sun, 4.0);
    let clouds = vec![layer(rng, CloudKind::Altocumulus, [0.3, 0.65])];
    let horizon = rng.chance(0.5).then(|| skyline(rng, HorizonKind::Roofs, [4.0, 14.0], CONCRETE, [0.1, 0.6]));
    Place { air, clouds, horizon, ground: plain(rng, CONCRETE) }.sky()
}

pub(super) fn meadow_trees(rng: &mut Pcg64) -> Sky {
    let sun = if rng.chance(0.5) { low_hard_sun(rng) } else { sun(rng, 20.0, 75.0) };
    let air = clear(rng, sun, 4.0);
    let horizon = skyline(rng, HorizonKind::Trees, [8.0, 30.0], LEAVES, [0.0, 0.4]);
    let clouds = if rng.chance(0.5) { vec![layer(rng, CloudKind::Cumulus, [0.1, 0.6])] } else { Vec::new() };
    Place { air, clouds, horizon: Some(horizon), ground: plain(rng, GRASS) }.sky()
}

/// Adds a cover to a scenery.
pub(super) fn under(sky: Sky, roof: Cover) -> Sky {
    match sky {
        Sky::Scenery(scenery) => Sky::Scenery(Scenery { cover: Some(Box::new(roof)), ..scenery }),
        other => other,
    }
}

pub(super) fn forest_canopy(rng: &mut Pcg64) -> Sky {
    let sun = Sun { gain: rng.log(1.0, 5.0), ..sun(rng, 15.0, 80.0) };
    let air = clear(rng, sun, 3.0);
    let horizon = rng.chance(0.6).then(|| skyline(rng, HorizonKind::Trees, [6.0, 20.0], LEAVES, [0.1, 0.4]));
    let roof = Cover {
        kind: CoverKind::Leaves,
        amount: rng.between(0.3, 0.65),
        scale: rng.log(0.5, 2.0),
        elevation: 0.0,
        azimuth: 0.0,
        color: shaded(rng, [0.1, 0.16, 0.04]),
        seed: which(rng),
    };
    under(Place { air, clouds: Vec::new(), horizon, ground: plain(rng, SOIL) }.sky(), roof)
}

pub(super) fn village(rng: &mut Pcg64) -> Sky {
    let sun = low_hard_sun(rng);
    let air = clear(rng, sun, 5.0);
    let horizon = skyline(rng, HorizonKind::Roofs, [12.0, 34.0], [0.45, 0.34, 0.26], [0.0, 0.3]);
    let clouds = if rng.chance(0.6) { vec![layer(rng, CloudKind::Cumulus, [0.1, 0.5])] } else { Vec::new() };
    Place { air, clouds, horizon: Some(horizon), ground: plain(rng, CONCRETE) }.sky()
}

pub(super) fn city_day(rng: &mut Pcg64) -> Sky {
    let sun = sun(rng, 10.0, 70.0);
    let air = clear(rng, sun, 6.0);
    let horizon = skyline(rng, HorizonKind::Skyline, [8.0, 30.0], CONCRETE, [0.1, 0.6]);
    let clouds = if rng.chance(0.6) { vec![layer(rng, CloudKind::Cumulus, [0.15, 0.6])] } else { Vec::new() };
    Place { air, clouds, horizon: Some(horizon), ground: plain(rng, ASPHALT) }.sky()
}

pub(super) fn city_canyon(rng: &mut Pcg64) -> Sky {
    let sun = low_hard_sun(rng);
    // Higher than in the open, so that it looks over some of the roofs.
    let sun = Sun { elevation: Pcg64::tidy(sun.elevation * 1.5 + 4.0), ..sun };
    let air = clear(rng, sun, 4.0);
    let horizon = skyline(rng, HorizonKind::Skyline, [38.0, 65.0], CONCRETE, [0.0, 0.25]);
    Place { air, clouds: Vec::new(), horizon: Some(horizon), ground: plain(rng, ASPHALT) }.sky()
}

pub(super) fn pergola(rng: &mut Pcg64) -> Sky {
    let sun = Sun { elevation: rng.between(35.0, 80.0), gain: rng.log(1.0, 4.0), ..low_hard_sun(rng) };
    let air = clear(rng, sun, 4.0);
    let horizon = rng.chance(0.6).then(|| skyline(rng, HorizonKind::Trees, [4.0, 14.0], LEAVES, [0.1, 0.5]));
    let roof = Cover {
        kind: CoverKind::Lattice,
        amount: rng.between(0.25, 0.65),
        scale: rng.log(0.6, 2.5),
        elevation: 0.0,
        azimuth: degrees(rng),
        color: shaded(rng, [0.4, 0.28, 0.18]),
        seed: which(rng),
    };
    under(Place { air, clouds: Vec::new(), horizon, ground: plain(rng, CONCRETE) }.sky(), roof)
}

pub(super) fn hills_low_sun(rng: &mut Pcg64) -> Sky {
    let sun = low_hard_sun(rng);
    let air = clear(rng, sun, 6.0);
    let horizon = skyline(rng, HorizonKind::Hills, [5.0, 18.0], GRASS, [0.2, 0.8]);
    Place { air, clouds: Vec::new(), horizon: Some(horizon), ground: plain(rng, GRASS) }.sky()
}
