//! Light that no place has.

use super::{degrees, which};
use crate::draw::Draw;
use crate::sky::{Abstract, Figure, Sky};
use rand_pcg::Pcg64;

fn colors(rng: &mut Pcg64, count: u32, dark: f32, bright: f32) -> Vec<[f32; 3]> {
    (0..count)
        .map(|_| {
            let level = rng.log(dark, bright);
            let color = Pcg64::hsv(degrees(rng), rng.between(0.0, 0.95), 1.0);
            color.map(|v| Pcg64::tidy(v * level))
        })
        .collect()
}

pub(super) fn color_gradient(rng: &mut Pcg64) -> Sky {
    let count = 2 + rng.below(4);
    Sky::Abstract(Abstract {
        figure: [Figure::Gradient, Figure::Bands, Figure::Marble][rng.weighted(&[0.5, 0.2, 0.3])],
        colors: colors(rng, count, 0.05, 3.0),
        scale: rng.log(0.5, 2.0),
        softness: rng.between(0.5, 1.0),
        elevation: rng.between(-90.0, 90.0),
        azimuth: degrees(rng),
        seed: which(rng),
    })
}

pub(super) fn color_shapes(rng: &mut Pcg64) -> Sky {
    let count = 3 + rng.below(5);
    Sky::Abstract(Abstract {
        figure: [Figure::Quadrants, Figure::Checker, Figure::Bands, Figure::Spots][rng.below(4) as usize],
        colors: colors(rng, count, 0.03, 4.0),
        scale: rng.log(0.7, 4.0),
        softness: rng.between(0.0, 0.4),
        elevation: rng.between(-90.0, 90.0),
        azimuth: degrees(rng),
        seed: which(rng),
    })
}

pub(super) fn soft_blobs(rng: &mut Pcg64) -> Sky {
    let count = 3 + rng.below(5);
    let mut palette = colors(rng, count, 0.1, 6.0);
    // The light comes from the blobs.
    let dim = rng.log(0.02, 0.3);
    palette[0] = palette[0].map(|v| Pcg64::tidy(v * dim));
    Sky::Abstract(Abstract {
        figure: if rng.chance(0.75) { Figure::Blobs } else { Figure::Spots },
        colors: palette,
        scale: rng.log(0.7, 4.0),
        softness: rng.between(0.1, 1.0),
        elevation: 90.0,
        azimuth: 0.0,
        seed: which(rng),
    })
}
