//! Random parameters of each kind, in colours that such surfaces have.

mod metal;
mod natural;

pub(crate) use metal::*;
pub(crate) use natural::*;

use super::*;
use crate::draw::Draw;
use rand_pcg::Pcg64;

type Color = [f32; 3];

/// Fired clay and cut stone of bricks.
const BRICKS: [Color; 6] =
    [[0.42, 0.16, 0.09], [0.5, 0.24, 0.14], [0.3, 0.1, 0.07], [0.55, 0.45, 0.3], [0.62, 0.6, 0.57], [0.16, 0.15, 0.15]];
/// Woods: light and dark of oak, pine, walnut, mahogany, ash, ebony, grey weathered wood.
const WOODS: [[Color; 2]; 7] = [
    [[0.45, 0.29, 0.15], [0.25, 0.14, 0.06]],
    [[0.62, 0.42, 0.22], [0.4, 0.22, 0.09]],
    [[0.2, 0.115, 0.06], [0.08, 0.045, 0.025]],
    [[0.32, 0.11, 0.055], [0.14, 0.04, 0.02]],
    [[0.65, 0.55, 0.4], [0.45, 0.34, 0.22]],
    [[0.07, 0.05, 0.04], [0.03, 0.02, 0.018]],
    [[0.36, 0.34, 0.31], [0.2, 0.185, 0.165]],
];
/// Stones from white to black, with the warm ones between.
const STONES: [Color; 9] = [
    [0.78, 0.76, 0.72],
    [0.58, 0.57, 0.55],
    [0.42, 0.4, 0.38],
    [0.25, 0.25, 0.26],
    [0.07, 0.07, 0.075],
    [0.52, 0.42, 0.3],
    [0.45, 0.28, 0.2],
    [0.2, 0.26, 0.2],
    [0.55, 0.36, 0.33],
];
/// Metals as used for things: steel, iron, aluminium, copper, brass, bronze, gold, dark steel.
const METALS: [Color; 8] = [
    [0.63, 0.62, 0.61],
    [0.5, 0.49, 0.48],
    [0.86, 0.87, 0.88],
    [0.9, 0.56, 0.42],
    [0.86, 0.7, 0.36],
    [0.6, 0.42, 0.24],
    [0.98, 0.74, 0.32],
    [0.26, 0.26, 0.28],
];
/// Hides.
const LEATHERS: [Color; 6] =
    [[0.3, 0.13, 0.06], [0.12, 0.05, 0.03], [0.45, 0.26, 0.13], [0.03, 0.028, 0.028], [0.32, 0.05, 0.05], [0.6, 0.52, 0.42]];
/// Earths and sands.
const EARTHS: [Color; 6] =
    [[0.42, 0.29, 0.17], [0.6, 0.47, 0.31], [0.26, 0.17, 0.1], [0.5, 0.24, 0.13], [0.7, 0.66, 0.58], [0.22, 0.21, 0.2]];
/// What lies between stones: cement, sand, soil.
const JOINTS: [Color; 4] = [[0.5, 0.47, 0.42], [0.32, 0.3, 0.28], [0.68, 0.66, 0.62], [0.1, 0.085, 0.07]];

fn one_of<T: Copy>(rng: &mut Pcg64, list: &[T]) -> T {
    list[rng.below(list.len() as u32) as usize]
}

/// A colour near `base`, `gain` times as bright.
fn near(rng: &mut Pcg64, base: Color, gain: f32) -> Color {
    let gain = gain * rng.between(0.8, 1.2);
    base.map(|v| Pcg64::tidy((v * gain * rng.between(0.93, 1.07)).clamp(0.004, 0.95)))
}

/// Any hue.
fn dye(rng: &mut Pcg64) -> Color {
    let (hue, saturation, value) = (rng.between(0.0, 360.0), rng.between(0.25, 0.92), rng.log(0.07, 0.8));
    Pcg64::hsv(hue, saturation, value)
}

/// White to black with a breath of a hue.
fn neutral(rng: &mut Pcg64) -> Color {
    let (hue, saturation, value) = (rng.between(0.0, 360.0), rng.between(0.0, 0.18), rng.log(0.03, 0.82));
    Pcg64::hsv(hue, saturation, value)
}

/// A colour of paint and cloth.
fn paint(rng: &mut Pcg64) -> Color {
    if rng.chance(0.6) { dye(rng) } else { neutral(rng) }
}

/// A colour that differs from `other` enough to be told from it.
fn unlike(rng: &mut Pcg64, other: Color) -> Color {
    for _ in 0..8 {
        let color = paint(rng);
        // Lightness goes about with the third root.
        let apart: f32 = color.iter().zip(other).map(|(a, b)| (a.cbrt() - b.cbrt()).abs()).sum();
        if apart > 0.45 {
            return color;
        }
    }
    if other.iter().sum::<f32>() > 0.6 { [0.03, 0.03, 0.035] } else { [0.75, 0.73, 0.68] }
}

/// A range of roughness: its low end in `low`, at most `most` wide.
fn rough(rng: &mut Pcg64, low: [f32; 2], most: f32) -> [f32; 2] {
    let from = rng.between(low[0], low[1]);
    [from, Pcg64::tidy((from + rng.between(0.3 * most, most)).min(1.0))]
}

/// Depth about `usual`.
fn deep(rng: &mut Pcg64, usual: f32) -> f32 {
    Pcg64::tidy(usual * rng.log(0.5, 1.6))
}

fn count(rng: &mut Pcg64, low: u32, high: u32) -> u32 {
    low + rng.below(high - low + 1)
}

fn seed(rng: &mut Pcg64) -> u32 {
    rng.below(1 << 20)
}

pub(crate) fn checker(rng: &mut Pcg64) -> Pattern {
    let first = paint(rng);
    Pattern::Checker(Checker {
        colors: [first, unlike(rng, first)],
        roughness: rough(rng, [0.05, 0.6], 0.4),
        depth: deep(rng, 0.002),
        pairs: count(rng, 1, 6),
        wear: rng.between(0.0, 0.9),
        seed: seed(rng),
        ..Checker::default()
    })
}

pub(crate) fn stripes(rng: &mut Pcg64) -> Pattern {
    let ground = paint(rng);
    Pattern::Stripes(Stripes {
        colors: [ground, unlike(rng, ground), paint(rng), paint(rng)],
        roughness: rough(rng, [0.4, 0.7], 0.3),
        depth: deep(rng, 0.0015),
        groups: count(rng, 1, 7),
        uneven: rng.between(0.0, 1.0),
        threads: rng.between(0.0, 1.0),
        seed: seed(rng),
        ..Stripes::default()
    })
}

pub(crate) fn dots(rng: &mut Pcg64) -> Pattern {
    let ground = paint(rng);
    Pattern::Dots(Dots {
        colors: [ground, unlike(rng, ground), unlike(rng, ground)],
        roughness: rough(rng, [0.1, 0.5], 0.5),
        depth: if rng.chance(0.5) { 0.0 } else { deep(rng, 0.006) },
        pairs: count(rng, 1, 7),
        radius: rng.between(0.12, 0.42),
        uneven: rng.between(0.0, 1.0),
        seed: seed(rng),
        ..Dots::default()
    })
}

pub(crate) fn camouflage(rng: &mut Pcg64) -> Pattern {
    let usual = Camouflage::default();
    // Woodland, desert, snow, city, or any colours.
    let colors = match rng.below(5) {
        0 => usual.colors,
        1 => [[0.6, 0.48, 0.32], [0.42, 0.3, 0.18], [0.7, 0.6, 0.45], [0.2, 0.14, 0.09]],
        2 => [[0.85, 0.86, 0.88], [0.6, 0.63, 0.66], [0.4, 0.43, 0.45], [0.12, 0.13, 0.14]],
        3 => [[0.3, 0.31, 0.33], [0.5, 0.52, 0.55], [0.12, 0.13, 0.15], [0.03, 0.03, 0.035]],
        _ => std::array::from_fn(|_| paint(rng)),
    };
    Pattern::Camouflage(Camouflage {
        colors: colors.map(|c| near(rng, c, 1.0)),
        roughness: rough(rng, [0.5, 0.8], 0.3),
        depth: deep(rng, 0.001),
        patches: count(rng, 2, 7),
        cover: rng.between(0.3, 0.8),
        ragged: rng.between(0.0, 1.0),
        seed: seed(rng),
        ..usual
    })
}

pub(crate) fn graffiti(rng: &mut Pcg64) -> Pattern {
    let line = if rng.chance(0.7) { [0.02, 0.02, 0.025] } else { [0.8, 0.8, 0.78] };
    Pattern::Graffiti(Graffiti {
        colors: [near(rng, [0.55, 0.53, 0.5], 1.0), dye(rng), dye(rng), line],
        roughness: rough(rng, [0.15, 0.4], 0.6),
        depth: deep(rng, 0.0015),
        figures: count(rng, 1, 4),
        outline: rng.between(0.1, 0.8),
        splatter: rng.between(0.0, 1.0),
        seed: seed(rng),
        ..Graffiti::default()
    })
}

pub(crate) fn bricks(rng: &mut Pcg64) -> Pattern {
    let base = one_of(rng, &BRICKS);
    let joint = one_of(rng, &JOINTS);
    Pattern::Bricks(Bricks {
        colors: [near(rng, base, 1.1), near(rng, base, 0.6), near(rng, joint, 1.0)],
        roughness: rough(rng, [0.55, 0.8], 0.3),
        depth: deep(rng, 0.008),
        pairs: count(rng, 2, 7),
        joint: rng.between(0.05, 0.2),
        contrast: rng.between(0.2, 1.0),
        worn: rng.between(0.0, 0.9),
        seed: seed(rng),
        ..Bricks::default()
    })
}

pub(crate) fn tiles(rng: &mut Pcg64) -> Pattern {
    let (first, joint) = (if rng.chance(0.5) { one_of(rng, &STONES) } else { paint(rng) }, one_of(rng, &JOINTS));
    let second = if rng.chance(0.5) { near(rng, first, 0.7) } else { unlike(rng, first) };
    Pattern::Tiles(Tiles {
        colors: [near(rng, first, 1.0), second, near(rng, joint, 1.0)],
        roughness: rough(rng, [0.04, 0.4], 0.6),
        depth: deep(rng, 0.004),
        count: count(rng, 2, 12),
        grout: rng.between(0.02, 0.1),
        bevel: rng.between(0.02, 0.15),
        mixed: rng.between(0.0, 0.6),
        variation: rng.between(0.0, 0.8),
        seed: seed(rng),
        ..Tiles::default()
    })
}

pub(crate) fn cobbles(rng: &mut Pcg64) -> Pattern {
    let count = count(rng, 4, 24);
    let stones: [Color; 3] = std::array::from_fn(|_| one_of(rng, &STONES));
    let joint = one_of(rng, &JOINTS);
    Pattern::Cobbles(Cobbles {
        colors: [near(rng, stones[0], 0.9), near(rng, stones[1], 0.8), near(rng, stones[2], 0.9), near(rng, joint, 0.5)],
        roughness: rough(rng, [0.3, 0.7], 0.4),
        depth: Pcg64::tidy(rng.between(0.08, 0.2) / count as f32),
        count,
        uneven: rng.between(0.2, 1.0),
        gap: rng.between(0.04, 0.25),
        round: rng.between(0.0, 1.0),
        seed: seed(rng),
        ..Cobbles::default()
    })
}

pub(crate) fn mosaic(rng: &mut Pcg64) -> Pattern {
    let joint = one_of(rng, &JOINTS);
    Pattern::Mosaic(Mosaic {
        colors: [paint(rng), paint(rng), paint(rng), near(rng, joint, 1.0)],
        roughness: rough(rng, [0.05, 0.3], 0.7),
        depth: deep(rng, 0.004),
        count: count(rng, 8, 28),
        shards: rng.between(0.0, 1.0),
        joint: rng.between(0.05, 0.2),
        figures: count(rng, 1, 6),
        seed: seed(rng),
        ..Mosaic::default()
    })
}

pub(crate) fn plaster(rng: &mut Pcg64) -> Pattern {
    let (hue, saturation, value) = (rng.between(0.0, 360.0), rng.between(0.0, 0.45), rng.between(0.35, 0.82));
    let base = Pcg64::hsv(hue, saturation, value);
    Pattern::Plaster(Plaster {
        colors: [base, near(rng, base, 0.82), near(rng, [0.25, 0.2, 0.14], 1.0)],
        roughness: rough(rng, [0.6, 0.85], 0.25),
        depth: deep(rng, 0.005),
        bumps: count(rng, 8, 48),
        stains: rng.between(0.0, 0.8),
        streaks: count(rng, 4, 20),
        trowelled: rng.between(0.0, 1.0),
        seed: seed(rng),
        ..Plaster::default()
    })
}

pub(crate) fn concrete(rng: &mut Pcg64) -> Pattern {
    let base = near(rng, [0.46, 0.45, 0.43], 1.0);
    Pattern::Concrete(Concrete {
        colors: [base, near(rng, base, 0.65), near(rng, base, 0.25)],
        roughness: rough(rng, [0.45, 0.8], 0.35),
        depth: deep(rng, 0.004),
        boards: if rng.chance(0.5) { 0 } else { count(rng, 1, 8) },
        pores: rng.between(0.05, 0.8),
        contrast: rng.between(0.2, 0.9),
        seed: seed(rng),
        ..Concrete::default()
    })
}

pub(crate) fn woven(rng: &mut Pcg64) -> Pattern {
    let warp = paint(rng);
    let weft = if rng.chance(0.6) { near(rng, warp, 1.15) } else { paint(rng) };
    let pairs = count(rng, 6, 32);
    Pattern::Woven(Woven {
        colors: [warp, weft, near(rng, warp, 0.2)],
        roughness: rough(rng, [0.45, 0.75], 0.3),
        depth: Pcg64::tidy(rng.between(0.08, 0.2) / (2 * pairs) as f32),
        pairs,
        width: rng.between(0.7, 1.0),
        uneven: rng.between(0.0, 1.0),
        seed: seed(rng),
        ..Woven::default()
    })
}

pub(crate) fn knitted(rng: &mut Pcg64) -> Pattern {
    let first = paint(rng);
    let stitches = count(rng, 8, 28);
    Pattern::Knitted(Knitted {
        colors: [first, unlike(rng, first), near(rng, first, 0.15)],
        roughness: rough(rng, [0.65, 0.85], 0.2),
        depth: Pcg64::tidy(rng.between(0.12, 0.25) / stitches as f32),
        stitches,
        bands: if rng.chance(0.5) { 0 } else { count(rng, 1, 4) },
        fluff: rng.between(0.1, 1.0),
        seed: seed(rng),
        ..Knitted::default()
    })
}

pub(crate) fn leather(rng: &mut Pcg64) -> Pattern {
    let base = if rng.chance(0.8) { one_of(rng, &LEATHERS) } else { dye(rng) };
    let grains = count(rng, 20, 64);
    Pattern::Leather(Leather {
        colors: [near(rng, base, 1.0), near(rng, base, 0.7), near(rng, base, 0.25)],
        roughness: rough(rng, [0.2, 0.45], 0.45),
        depth: Pcg64::tidy(rng.between(0.06, 0.16) / grains as f32),
        grains,
        creases: rng.between(0.0, 0.9),
        worn: rng.between(0.0, 0.8),
        seed: seed(rng),
        ..Leather::default()
    })
}

pub(crate) fn cracked_paint(rng: &mut Pcg64) -> Pattern {
    let (base, below) = (paint(rng), one_of(rng, &WOODS)[1]);
    Pattern::CrackedPaint(CrackedPaint {
        colors: [base, near(rng, base, 0.8), near(rng, below, 1.2), near(rng, below, 0.3)],
        roughness: rough(rng, [0.2, 0.5], 0.6),
        depth: deep(rng, 0.004),
        flakes: count(rng, 5, 20),
        lost: rng.between(0.05, 0.55),
        stretch: rng.between(0.0, 1.0),
        seed: seed(rng),
        ..CrackedPaint::default()
    })
}
