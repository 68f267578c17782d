//! Wood, stone and earth.

use super::*;

pub(crate) fn planks(rng: &mut Pcg64) -> Pattern {
    let [light, dark] = one_of(rng, &WOODS);
    Pattern::Planks(Planks {
        colors: [near(rng, light, 1.0), near(rng, dark, 1.0), near(rng, [0.03, 0.02, 0.015], 1.0)],
        roughness: rough(rng, [0.15, 0.5], 0.5),
        depth: deep(rng, 0.004),
        boards: count(rng, 3, 12),
        contrast: rng.between(0.15, 0.9),
        grain: rng.between(0.3, 1.0),
        worn: rng.between(0.0, 0.8),
        seed: seed(rng),
        ..Planks::default()
    })
}

pub(crate) fn wood(rng: &mut Pcg64) -> Pattern {
    let [light, dark] = one_of(rng, &WOODS);
    Pattern::Wood(Wood {
        colors: [near(rng, light, 1.1), near(rng, dark, 1.1), near(rng, dark, 0.4)],
        roughness: rough(rng, [0.12, 0.5], 0.4),
        depth: deep(rng, 0.002),
        rings: count(rng, 6, 32),
        wavy: rng.between(0.1, 1.0),
        knots: rng.between(0.0, 0.8),
        fibres: rng.between(0.2, 1.0),
        seed: seed(rng),
        ..Wood::default()
    })
}

pub(crate) fn parquet(rng: &mut Pcg64) -> Pattern {
    let [light, dark] = one_of(rng, &WOODS);
    Pattern::Parquet(Parquet {
        colors: [near(rng, light, 1.0), near(rng, dark, 1.1), near(rng, dark, 0.25)],
        roughness: rough(rng, [0.06, 0.35], 0.4),
        depth: deep(rng, 0.0015),
        pairs: count(rng, 1, 3),
        strips: count(rng, 2, 6),
        contrast: rng.between(0.2, 0.9),
        seed: seed(rng),
        ..Parquet::default()
    })
}

pub(crate) fn marble(rng: &mut Pcg64) -> Pattern {
    let base = one_of(rng, &STONES);
    // Light veins on dark stone, dark or golden ones on light stone.
    let bright = base[1] > 0.35;
    let vein = if !bright {
        near(rng, [0.72, 0.68, 0.6], 1.0)
    } else if rng.chance(0.3) {
        near(rng, [0.5, 0.33, 0.12], 1.0)
    } else {
        near(rng, base, 0.25)
    };
    Pattern::Marble(Marble {
        colors: [near(rng, base, 1.0), near(rng, base, if bright { 0.72 } else { 1.7 }), vein],
        roughness: rough(rng, [0.03, 0.25], 0.3),
        veins: count(rng, 1, 6),
        turbulence: rng.between(0.15, 1.0),
        contrast: rng.between(0.2, 1.0),
        seed: seed(rng),
        ..Marble::default()
    })
}

pub(crate) fn granite(rng: &mut Pcg64) -> Pattern {
    let base = one_of(rng, &STONES);
    Pattern::Granite(Granite {
        colors: [near(rng, base, 1.0), near(rng, base, 0.6), near(rng, [0.68, 0.66, 0.63], 1.0), near(rng, [0.04; 3], 1.0)],
        roughness: rough(rng, [0.05, 0.4], 0.4),
        depth: if rng.chance(0.6) { 0.0 } else { deep(rng, 0.003) },
        grains: count(rng, 24, 96),
        clumps: rng.between(0.0, 1.0),
        dark: rng.between(0.0, 0.8),
        seed: seed(rng),
        ..Granite::default()
    })
}

pub(crate) fn terrazzo(rng: &mut Pcg64) -> Pattern {
    let binder = if rng.chance(0.7) { one_of(rng, &STONES) } else { paint(rng) };
    let chip = |rng: &mut Pcg64| if rng.chance(0.5) { one_of(rng, &STONES) } else { dye(rng) };
    Pattern::Terrazzo(Terrazzo {
        colors: [chip(rng), chip(rng), chip(rng), near(rng, binder, 1.0)],
        roughness: rough(rng, [0.05, 0.3], 0.4),
        chips: count(rng, 6, 24),
        cover: rng.between(0.25, 0.9),
        variation: rng.between(0.1, 0.8),
        seed: seed(rng),
        ..Terrazzo::default()
    })
}

pub(crate) fn cracked_earth(rng: &mut Pcg64) -> Pattern {
    let base = one_of(rng, &EARTHS);
    let plates = count(rng, 3, 12);
    Pattern::CrackedEarth(CrackedEarth {
        colors: [near(rng, base, 1.0), near(rng, base, 0.75), near(rng, base, 0.15)],
        roughness: rough(rng, [0.7, 0.85], 0.2),
        depth: Pcg64::tidy(rng.between(0.06, 0.16) / plates as f32),
        plates,
        gap: rng.between(0.03, 0.15),
        curl: rng.between(0.0, 1.0),
        wavy: rng.between(0.1, 1.0),
        seed: seed(rng),
        ..CrackedEarth::default()
    })
}

pub(crate) fn sand(rng: &mut Pcg64) -> Pattern {
    let base = one_of(rng, &EARTHS);
    let ripples = if rng.chance(0.25) { 0 } else { count(rng, 4, 24) };
    Pattern::Sand(Sand {
        colors: [near(rng, base, 1.1), near(rng, base, 0.8), near(rng, base, 0.4)],
        roughness: rough(rng, [0.65, 0.85], 0.25),
        depth: Pcg64::tidy(rng.between(0.08, 0.2) / ripples.max(8) as f32),
        ripples,
        wavy: rng.between(0.2, 1.0),
        grains: count(rng, 48, 128),
        seed: seed(rng),
        ..Sand::default()
    })
}

pub(crate) fn blotches(rng: &mut Pcg64) -> Pattern {
    let base = if rng.chance(0.5) { one_of(rng, &EARTHS) } else { paint(rng) };
    Pattern::Blotches(Blotches {
        colors: [near(rng, base, 1.0), near(rng, base, 0.6), if rng.chance(0.5) { near(rng, base, 0.35) } else { paint(rng) }],
        roughness: rough(rng, [0.1, 0.7], 0.5),
        depth: if rng.chance(0.4) { 0.0 } else { deep(rng, 0.004) },
        count: count(rng, 2, 10),
        detail: count(rng, 1, 6),
        contrast: rng.between(0.0, 1.0),
        seed: seed(rng),
        ..Blotches::default()
    })
}

pub(crate) fn leaves(rng: &mut Pcg64) -> Pattern {
    let (hue, saturation, value) = (rng.between(60.0, 130.0), rng.between(0.45, 0.85), rng.log(0.1, 0.35));
    let leaf = Pcg64::hsv(hue, saturation, value);
    // Now and then autumn.
    let second = if rng.chance(0.15) {
        Pcg64::hsv(rng.between(15.0, 55.0), rng.between(0.6, 0.9), rng.between(0.25, 0.6))
    } else {
        Pcg64::hsv(hue + rng.between(-15.0, 8.0), saturation, (value * rng.between(0.7, 1.5)).min(0.5))
    };
    Pattern::Leaves(Leaves {
        colors: [leaf, second, near(rng, leaf, 1.5)],
        roughness: rough(rng, [0.25, 0.6], 0.3),
        depth: deep(rng, 0.008),
        leaves: count(rng, 5, 14),
        density: rng.between(0.35, 0.9),
        slender: rng.between(1.3, 4.0),
        uneven: rng.between(0.2, 1.0),
        seed: seed(rng),
        ..Leaves::default()
    })
}
