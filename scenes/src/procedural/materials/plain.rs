//! Materials of one colour that look like real ones: paints, plastics, ceramics, stones, woods, fabrics, metals.

use crate::description::Material;
use crate::draw::Draw;
use rand_pcg::Pcg64;

/// Reflectance of metals at normal incidence, linear Rec.709 (rounded values of measured spectra as collected at
/// physicallybased.info): gold, silver, copper, iron, aluminium, brass, chromium, titanium, platinum.
const METALS: [[f32; 3]; 9] = [
    [1.0, 0.77, 0.31],
    [0.97, 0.96, 0.92],
    [0.95, 0.64, 0.54],
    [0.53, 0.51, 0.49],
    [0.91, 0.92, 0.92],
    [0.91, 0.78, 0.42],
    [0.65, 0.69, 0.7],
    [0.62, 0.58, 0.54],
    [0.68, 0.64, 0.59],
];

/// Earths, stones and woods, linear Rec.709.
const EARTHS: [[f32; 3]; 8] = [
    [0.42, 0.27, 0.15],
    [0.22, 0.11, 0.05],
    [0.6, 0.45, 0.28],
    [0.35, 0.33, 0.3],
    [0.55, 0.53, 0.5],
    [0.18, 0.17, 0.17],
    [0.48, 0.2, 0.12],
    [0.7, 0.66, 0.58],
];

pub(super) fn plain(name: &str, base_color: [f32; 3], metallic: f32, roughness: f32, specular: f32) -> Material {
    Material {
        name: name.into(),
        base_color: base_color.map(|v| Pcg64::tidy(v.clamp(0.01, 1.0))),
        metallic,
        roughness,
        specular,
        ..Material::default()
    }
}

/// A colour near `base`: brighter or darker as a whole and a little different by channel.
pub(super) fn near(rng: &mut Pcg64, base: [f32; 3], level: f32, spread: f32) -> [f32; 3] {
    let gain = rng.between(1.0 - level, 1.0 + level);
    base.map(|v| (v * gain * rng.between(1.0 - spread, 1.0 + spread)).min(0.95))
}

pub(super) fn dielectric(rng: &mut Pcg64, name: &str) -> Material {
    match rng.weighted(&[0.35, 0.2, 0.12, 0.2, 0.13]) {
        // Paint and plastic in any hue.
        0 => {
            let (hue, saturation, value) = (rng.between(0.0, 360.0), rng.between(0.35, 0.95), rng.log(0.15, 0.9));
            plain(name, Pcg64::hsv(hue, saturation, value), 0.0, rng.between(0.08, 0.65), rng.between(0.3, 0.8))
        }
        // Muted hues.
        1 => {
            let (hue, saturation, value) = (rng.between(0.0, 360.0), rng.between(0.05, 0.35), rng.log(0.2, 0.85));
            plain(name, Pcg64::hsv(hue, saturation, value), 0.0, rng.between(0.2, 0.9), rng.between(0.2, 0.7))
        }
        // Ceramic and plaster: near white; glazed or dull.
        2 => {
            let color = near(rng, [0.82, 0.81, 0.78], 0.1, 0.04);
            plain(
                name,
                color,
                0.0,
                if rng.chance(0.5) { rng.between(0.05, 0.25) } else { rng.between(0.5, 1.0) },
                rng.between(0.4, 0.7),
            )
        }
        // Wood, stone, clay.
        3 => {
            let base = EARTHS[rng.below(EARTHS.len() as u32) as usize];
            plain(name, near(rng, base, 0.3, 0.1), 0.0, rng.between(0.35, 1.0), rng.between(0.2, 0.6))
        }
        // Rubber and fabric: dark or dull; any specular level.
        _ => {
            let (hue, saturation, value) = (rng.between(0.0, 360.0), rng.between(0.0, 0.8), rng.log(0.03, 0.4));
            plain(name, Pcg64::hsv(hue, saturation, value), 0.0, rng.between(0.5, 1.0), rng.between(0.0, 1.0))
        }
    }
}

pub(super) fn metal(rng: &mut Pcg64, name: &str) -> Material {
    let color = if rng.chance(0.15) {
        // Anodised.
        let (hue, saturation) = (rng.between(0.0, 360.0), rng.between(0.4, 0.85));
        Pcg64::hsv(hue, saturation, 0.75)
    } else {
        let base = METALS[rng.below(METALS.len() as u32) as usize];
        near(rng, base, 0.05, 0.03)
    };
    // A mirror is the hardest case for any renderer: some, not most.
    plain(name, color, if rng.chance(0.85) { 1.0 } else { rng.between(0.6, 1.0) }, rng.log(0.05, 0.75), 0.5)
}

/// The floor's material: mostly dull.
pub(super) fn ground(rng: &mut Pcg64, name: &str) -> Material {
    let color = if rng.chance(0.6) {
        let base = EARTHS[rng.below(EARTHS.len() as u32) as usize];
        near(rng, base, 0.3, 0.08)
    } else {
        let (hue, saturation, value) = (rng.between(0.0, 360.0), rng.between(0.0, 0.45), rng.log(0.12, 0.8));
        Pcg64::hsv(hue, saturation, value)
    };
    let roughness = if rng.chance(0.15) { rng.between(0.1, 0.4) } else { rng.between(0.4, 1.0) };
    plain(name, color, 0.0, roughness, rng.between(0.1, 0.6))
}
