//! Nights: the moon, stars, and lamps over three orders of magnitude of brightness.

use super::{ASPHALT, CONCRETE, GRASS, LEAVES, ROCK, SEA, SOIL, degrees, layer, plain, shaded, skyline, tint, which};
use crate::draw::Draw;
use crate::sky::{
    Air, CloudKind, CloudLayer, Glow, Ground, Horizon, HorizonKind, Layout, LightGroup, Palette, Scenery, Sky, Stars, Sun,
};
use rand_pcg::Pcg64;

/// A scenery of the night.
struct Night {
    air: Air,
    clouds: Vec<CloudLayer>,
    glows: Vec<Glow>,
    stars: Option<Stars>,
    horizon: Option<Horizon>,
    lights: Vec<LightGroup>,
    ground: Ground,
}

impl Night {
    fn sky(self) -> Sky {
        let Self { air, clouds, glows, stars, horizon, lights, ground } = self;
        let horizon = horizon.map(Box::new);
        Sky::Scenery(Scenery { air, clouds, glows, stars, horizon, cover: None, lights, ground })
    }
}

fn moonlight(rng: &mut Pcg64, highest: f32) -> Air {
    let moon =
        Sun { elevation: rng.between(6.0, highest), azimuth: degrees(rng), radius: rng.log(0.27, 0.9), gain: rng.log(0.6, 4.0) };
    Air::Clear {
        sun: moon,
        sun_tint: [rng.between(0.75, 1.0), rng.between(0.85, 1.0), 1.0],
        turbidity: rng.log(1.6, 4.0),
        luminance: rng.log(0.04, 0.14),
        tint: [rng.between(0.45, 0.9), rng.between(0.6, 0.95), 1.0],
    }
}

/// Air that the moon does not light.
fn dark(rng: &mut Pcg64, level: f32) -> Air {
    let zenith = [rng.between(0.25, 0.6), rng.between(0.35, 0.65), rng.between(0.6, 1.1)].map(|v| Pcg64::tidy(v * 0.5 * level));
    Air::Gradient { zenith, horizon: tint(rng, level, 0.25), sharpness: rng.between(0.3, 1.0) }
}

fn stars(rng: &mut Pcg64, brightest: f32) -> Stars {
    Stars { count: 300 + rng.below(1500), luminance: rng.log(0.05 * brightest, brightest), milky_way: [0.0; 3], seed: which(rng) }
}

fn lamps(
    rng: &mut Pcg64,
    layout: Layout,
    palettes: &[Palette],
    count: [u32; 2],
    radius: [f32; 2],
    elevation: [f32; 2],
) -> LightGroup {
    LightGroup {
        layout,
        palette: palettes[rng.below(palettes.len() as u32) as usize],
        count: count[0] + rng.below(count[1] - count[0] + 1),
        radius: rng.log(radius[0], radius[1]),
        azimuth: degrees(rng),
        elevation: rng.between(elevation[0], elevation[1]),
        luminance: rng.log(0.06, 1.2),
        seed: which(rng),
    }
}

pub(super) fn moonlit_clear(rng: &mut Pcg64) -> Sky {
    let kind = [HorizonKind::Hills, HorizonKind::Trees, HorizonKind::Ridges][rng.below(3) as usize];
    Night {
        air: moonlight(rng, 70.0),
        clouds: Vec::new(),
        glows: Vec::new(),
        stars: Some(stars(rng, 0.015)),
        horizon: Some(skyline(rng, kind, [5.0, 24.0], ROCK, [0.1, 0.6])),
        lights: Vec::new(),
        ground: plain(rng, GRASS),
    }
    .sky()
}

pub(super) fn moonlit_clouds(rng: &mut Pcg64) -> Sky {
    let kind = [CloudKind::Cumulus, CloudKind::Altocumulus, CloudKind::Cirrus][rng.below(3) as usize];
    Night {
        air: moonlight(rng, 60.0),
        clouds: vec![layer(rng, kind, [0.25, 0.7])],
        glows: Vec::new(),
        stars: Some(stars(rng, 0.008)),
        horizon: rng.chance(0.6).then(|| skyline(rng, HorizonKind::Trees, [3.0, 14.0], LEAVES, [0.1, 0.5])),
        lights: Vec::new(),
        ground: plain(rng, SOIL),
    }
    .sky()
}

pub(super) fn moonlit_sea(rng: &mut Pcg64) -> Sky {
    let cloudy = rng.chance(0.5);
    Night {
        air: moonlight(rng, 40.0),
        clouds: if cloudy { vec![layer(rng, CloudKind::Cumulus, [0.15, 0.5])] } else { Vec::new() },
        glows: Vec::new(),
        stars: Some(stars(rng, 0.006)),
        horizon: None,
        lights: Vec::new(),
        ground: Ground::Water { color: shaded(rng, SEA), wind: rng.log(0.4, 6.0) },
    }
    .sky()
}

pub(super) fn milky_way(rng: &mut Pcg64) -> Sky {
    let level = rng.log(0.05, 0.12);
    let band = rng.log(0.1, 0.35);
    let milky_way = tint(rng, band, 0.25);
    let kind = [HorizonKind::Ridges, HorizonKind::Dunes, HorizonKind::Trees][rng.below(3) as usize];
    let glow = Glow {
        elevation: rng.between(-4.0, 2.0),
        azimuth: degrees(rng),
        width: rng.between(15.0, 45.0),
        flatness: rng.between(1.0, 3.0),
        radiance: [1.0, rng.between(0.5, 0.8), rng.between(0.2, 0.6)].map(|v| Pcg64::tidy(v * level * 3.0)),
    };
    Night {
        air: dark(rng, level),
        clouds: Vec::new(),
        glows: vec![glow],
        stars: Some(Stars { milky_way, ..stars(rng, 0.05) }),
        horizon: Some(skyline(rng, kind, [3.0, 15.0], ROCK, [0.0, 0.3])),
        lights: Vec::new(),
        ground: plain(rng, SOIL),
    }
    .sky()
}

pub(super) fn street_lamps(rng: &mut Pcg64) -> Sky {
    let street = lamps(rng, Layout::Street, &[Palette::Sodium, Palette::Warm, Palette::Cool], [8, 30], [0.8, 4.0], [40.0, 68.0]);
    let level = rng.log(0.01, 0.05);
    let kind = if rng.chance(0.5) { HorizonKind::Roofs } else { HorizonKind::Skyline };
    let horizon = Horizon {
        lit: rng.between(0.05, 0.4),
        luminance: Pcg64::tidy(street.luminance * rng.log(0.05, 0.4)),
        ..skyline(rng, kind, [8.0, 28.0], CONCRETE, [0.0, 0.2])
    };
    Night {
        air: dark(rng, level),
        clouds: Vec::new(),
        glows: Vec::new(),
        stars: None,
        horizon: Some(horizon),
        ground: if rng.chance(0.3) { Ground::Water { color: ASPHALT, wind: rng.log(0.3, 2.0) } } else { plain(rng, ASPHALT) },
        lights: vec![street],
    }
    .sky()
}

pub(super) fn neon_signs(rng: &mut Pcg64) -> Sky {
    let signs = lamps(rng, Layout::Signs, &[Palette::Neon], [8, 36], [1.5, 7.0], [8.0, 32.0]);
    let level = rng.log(0.01, 0.06);
    let horizon = Horizon {
        lit: rng.between(0.1, 0.5),
        luminance: Pcg64::tidy(signs.luminance * rng.log(0.05, 0.3)),
        ..skyline(rng, HorizonKind::Skyline, [25.0, 60.0], CONCRETE, [0.0, 0.2])
    };
    Night {
        air: dark(rng, level),
        clouds: Vec::new(),
        glows: Vec::new(),
        stars: None,
        horizon: Some(horizon),
        ground: if rng.chance(0.6) { Ground::Water { color: ASPHALT, wind: rng.log(0.5, 3.0) } } else { plain(rng, ASPHALT) },
        lights: vec![signs],
    }
    .sky()
}

pub(super) fn harbour(rng: &mut Pcg64) -> Sky {
    let quay = lamps(rng, Layout::Scattered, &[Palette::Mixed, Palette::Sodium, Palette::Warm], [10, 40], [0.4, 1.6], [3.0, 9.0]);
    let level = rng.log(0.01, 0.06);
    let horizon = Horizon {
        lit: rng.between(0.2, 0.7),
        luminance: Pcg64::tidy(quay.luminance * rng.log(0.2, 0.8)),
        ..skyline(rng, HorizonKind::Roofs, [4.0, 12.0], CONCRETE, [0.0, 0.3])
    };
    Night {
        air: dark(rng, level),
        clouds: Vec::new(),
        glows: Vec::new(),
        stars: rng.chance(0.5).then(|| stars(rng, 0.006)),
        horizon: Some(horizon),
        lights: vec![quay],
        ground: Ground::Water { color: shaded(rng, SEA), wind: rng.log(0.3, 3.0) },
    }
    .sky()
}

/// One warm light near the ground.
pub(super) fn campfire(rng: &mut Pcg64) -> Sky {
    let fire = lamps(rng, Layout::Fire, &[Palette::Flame], [5, 14], [2.0, 7.0], [3.0, 14.0]);
    let level = rng.log(0.008, 0.04);
    let halo = Glow {
        elevation: fire.elevation,
        azimuth: fire.azimuth,
        width: rng.between(12.0, 35.0),
        flatness: 1.0,
        radiance: [1.0, 0.4, 0.12].map(|v| Pcg64::tidy(v * fire.luminance * rng.log(0.3, 1.5))),
    };
    Night {
        air: dark(rng, level),
        clouds: Vec::new(),
        glows: vec![halo],
        stars: Some(stars(rng, 0.01)),
        horizon: Some(skyline(rng, HorizonKind::Trees, [12.0, 40.0], LEAVES, [0.0, 0.15])),
        lights: vec![fire],
        ground: plain(rng, SOIL),
    }
    .sky()
}

/// A town behind the horizon lights haze and clouds.
pub(super) fn city_glow(rng: &mut Pcg64) -> Sky {
    let level = rng.log(0.04, 0.1);
    let glows = (0..1 + rng.below(3))
        .map(|_| Glow {
            elevation: rng.between(-4.0, 3.0),
            azimuth: degrees(rng),
            width: rng.between(14.0, 50.0),
            flatness: rng.between(1.0, 3.0),
            radiance: {
                let strength = rng.log(0.3, 2.5);
                [1.0, rng.between(0.5, 0.85), rng.between(0.15, 0.7)].map(|v| Pcg64::tidy(v * strength))
            },
        })
        .collect();
    let kind = if rng.chance(0.5) { HorizonKind::Hills } else { HorizonKind::Trees };
    Night {
        air: dark(rng, level),
        clouds: if rng.chance(0.6) { vec![layer(rng, CloudKind::Cumulus, [0.2, 0.6])] } else { Vec::new() },
        glows,
        stars: Some(stars(rng, 0.01)),
        horizon: Some(skyline(rng, kind, [3.0, 15.0], SOIL, [0.0, 0.2])),
        lights: Vec::new(),
        ground: plain(rng, SOIL),
    }
    .sky()
}

pub(super) fn skyline_night(rng: &mut Pcg64) -> Sky {
    let level = rng.log(0.015, 0.08);
    let horizon = Horizon {
        lit: rng.between(0.15, 0.7),
        luminance: rng.log(0.06, 0.8),
        ..skyline(rng, HorizonKind::Skyline, [12.0, 50.0], CONCRETE, [0.0, 0.3])
    };
    Night {
        air: dark(rng, level),
        clouds: Vec::new(),
        glows: vec![Glow {
            elevation: 0.0,
            azimuth: degrees(rng),
            width: rng.between(40.0, 80.0),
            flatness: rng.between(1.5, 4.0),
            radiance: tint(rng, 2.0 * level, 0.4),
        }],
        stars: None,
        horizon: Some(horizon),
        lights: Vec::new(),
        ground: if rng.chance(0.5) { Ground::Water { color: SEA, wind: rng.log(0.4, 4.0) } } else { plain(rng, ASPHALT) },
    }
    .sky()
}

pub(super) fn festival_strings(rng: &mut Pcg64) -> Sky {
    let bulbs = lamps(rng, Layout::Strings, &[Palette::Bulbs, Palette::Warm, Palette::Mixed], [24, 60], [0.3, 1.4], [35.0, 65.0]);
    let level = rng.log(0.01, 0.08);
    Night {
        air: dark(rng, level),
        clouds: Vec::new(),
        glows: Vec::new(),
        stars: rng.chance(0.3).then(|| stars(rng, 0.006)),
        horizon: Some(skyline(rng, HorizonKind::Trees, [8.0, 25.0], LEAVES, [0.0, 0.2])),
        lights: vec![bulbs],
        ground: plain(rng, CONCRETE),
    }
    .sky()
}
