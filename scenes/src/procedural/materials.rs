//! Materials with textures and all lobes, for objects, floors and walls.

mod plain;

use crate::description::{Material, TextureTransform};
use crate::draw::Draw;
use crate::family::Faults;
use crate::pattern::{Pattern, random};
use plain::{dielectric, ground, metal, near, plain};
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

/// How often materials are what; all shares 0..=1.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MaterialKnobs {
    /// Objects with a procedural texture, 0.4 by default. Floors and walls have one more often: 1 - (1 - share)^2.
    pub textured: f64,
    /// Objects of metal (bare, rusty or painted), 0.25 by default.
    pub metal: f64,
    /// Objects with a clear coat, 0.08 by default.
    pub coated: f64,
    /// Objects of one colour, not of metal, with the sheen of cloth, 0.08 by default; of woven and knitted ones 0.4 have it
    /// anyway.
    pub sheen: f64,
    /// Objects with stretched highlights, 0.08 by default.
    pub anisotropic: f64,
    /// Objects of one colour, not of metal, or of marble, with the flat look of subsurface scattering, 0.08 by default.
    pub subsurface: f64,
}

impl Default for MaterialKnobs {
    fn default() -> Self {
        Self { textured: 0.4, metal: 0.25, coated: 0.08, sheen: 0.08, anisotropic: 0.08, subsurface: 0.08 }
    }
}

impl MaterialKnobs {
    /// What is out of range: JSON pointers below the knobs, and reasons.
    pub fn validate(&self) -> Vec<(String, String)> {
        let mut faults = Faults::default();
        for (field, share) in [
            ("textured", self.textured),
            ("metal", self.metal),
            ("coated", self.coated),
            ("sheen", self.sheen),
            ("anisotropic", self.anisotropic),
            ("subsurface", self.subsurface),
        ] {
            faults.range(field, share as f32, 0.0, 1.0);
        }
        faults.0
    }
}

/// Draws the parameters of a pattern.
type Maker = fn(&mut Pcg64) -> Pattern;

/// Textures of dielectric objects, with weights.
const OBJECTS: [(f64, Maker); 27] = [
    (1.4, random::wood),
    (0.8, random::planks),
    (0.5, random::parquet),
    (1.2, random::marble),
    (1.0, random::granite),
    (0.8, random::terrazzo),
    (0.5, random::cobbles),
    (0.4, random::cracked_earth),
    (0.3, random::sand),
    (0.7, random::bricks),
    (0.9, random::tiles),
    (0.7, random::mosaic),
    (0.6, random::plaster),
    (0.8, random::concrete),
    (1.2, random::woven),
    (1.0, random::knitted),
    (1.2, random::leather),
    (0.7, random::stripes),
    (0.5, random::camouflage),
    (0.7, random::graffiti),
    (0.9, random::cracked_paint),
    (0.8, random::dots),
    (0.8, random::checker),
    (0.8, random::blotches),
    (0.7, random::carbon_fibre),
    (0.5, |rng| random::corrugated(rng, false)),
    (0.5, |rng| random::hammered(rng, false)),
];

/// Textures of objects of metal.
const METALS: [(f64, Maker); 7] = [
    (1.5, random::rust),
    (1.3, random::scratched),
    (1.4, random::chipped_paint),
    (1.2, random::brushed),
    (1.0, |rng| random::hammered(rng, true)),
    (0.7, |rng| random::corrugated(rng, true)),
    (0.7, random::tread_plate),
];

/// Textures of floors.
const FLOORS: [(f64, Maker); 19] = [
    (1.5, random::planks),
    (1.2, random::parquet),
    (1.3, random::tiles),
    (1.2, random::concrete),
    (1.0, random::cobbles),
    (0.9, random::terrazzo),
    (0.9, random::marble),
    (0.6, random::granite),
    (0.8, random::checker),
    (0.9, random::sand),
    (0.8, random::cracked_earth),
    (0.7, random::bricks),
    (0.7, random::mosaic),
    (0.8, random::woven),
    (0.8, random::blotches),
    (0.4, random::tread_plate),
    (0.3, random::stripes),
    (0.3, random::chipped_paint),
    (0.3, random::leather),
];

/// Textures of walls.
const WALLS: [(f64, Maker); 15] = [
    (1.8, random::plaster),
    (1.6, random::bricks),
    (1.3, random::concrete),
    (1.1, random::tiles),
    (0.8, random::planks),
    (0.6, random::stripes),
    (0.4, random::dots),
    (0.6, random::graffiti),
    (0.7, random::cobbles),
    (0.8, random::cracked_paint),
    (0.4, random::marble),
    (0.4, random::mosaic),
    (0.4, random::blotches),
    (0.5, |rng| random::corrugated(rng, true)),
    (0.3, random::chipped_paint),
];

/// Repetitions of an object's texture: what closes around bodies whose u goes from 0 to 2.
const REPEATS: [f32; 6] = [0.5, 1.0, 1.0, 1.5, 2.0, 3.0];

/// A material of an object about a metre in size, from all that this crate knows.
pub fn object(rng: &mut Pcg64, name: &str, knobs: &MaterialKnobs) -> Material {
    let (textured, metallic) = (rng.chance(knobs.textured), rng.chance(knobs.metal));
    let mut material = match (textured, metallic) {
        (true, true) => patterned(rng, name, &METALS),
        (true, false) => patterned(rng, name, &OBJECTS),
        (false, true) => metal(rng, name),
        (false, false) => constant(rng, name),
    };
    if textured {
        let repeat = REPEATS[rng.below(REPEATS.len() as u32) as usize];
        let rotation = if rng.chance(0.25) { 90.0 } else { 0.0 };
        // Any start: only whole and half repetitions close around a body, wherever they begin.
        let offset = [rng.between(0.0, 1.0), rng.between(0.0, 1.0)];
        material.texture_transform = TextureTransform { offset, rotation, scale: [repeat; 2] };
    }
    lobes(rng, &mut material, metallic, knobs);
    material
}

/// The floor's material, named `name`. Texture coordinates are expected in metres.
pub fn floor(rng: &mut Pcg64, name: &str, knobs: &MaterialKnobs) -> Material {
    let mut material = if rng.chance(often(knobs.textured)) {
        let mut material = patterned(rng, name, &FLOORS);
        let repeat = rng.log(0.33, 2.0);
        let (offset, rotation) = ([rng.between(0.0, 1.0), rng.between(0.0, 1.0)], rng.between(0.0, 360.0));
        material.texture_transform = TextureTransform { offset, rotation, scale: [repeat; 2] };
        material
    } else {
        ground(rng, name)
    };
    if rng.chance(0.5 * knobs.coated) {
        coat(rng, &mut material);
    }
    material
}

/// A wall's material, named `name`. Texture coordinates are expected in metres, v downwards.
pub fn wall(rng: &mut Pcg64, name: &str, knobs: &MaterialKnobs) -> Material {
    if rng.chance(often(knobs.textured)) {
        let mut material = patterned(rng, name, &WALLS);
        let repeat = rng.log(0.33, 1.5);
        let offset = [rng.between(0.0, 1.0), rng.between(0.0, 1.0)];
        material.texture_transform = TextureTransform { offset, rotation: 0.0, scale: [repeat; 2] };
        return material;
    }
    // Wall paint: mostly pale.
    let (hue, saturation) = (rng.between(0.0, 360.0), rng.between(0.0, 0.5));
    let value = if rng.chance(0.7) { rng.between(0.5, 0.85) } else { rng.log(0.06, 0.5) };
    plain(name, Pcg64::hsv(hue, saturation, value), 0.0, rng.between(0.5, 1.0), rng.between(0.1, 0.5))
}

/// How often what is seen most has a texture.
fn often(share: f64) -> f64 {
    1.0 - (1.0 - share) * (1.0 - share)
}

/// A material that is what its pattern says.
fn patterned(rng: &mut Pcg64, name: &str, makers: &[(f64, Maker)]) -> Material {
    let weights: Vec<f64> = makers.iter().map(|m| m.0).collect();
    let pattern = makers[rng.weighted(&weights)].1(rng);
    let (metallic, specular) = match &pattern {
        Pattern::Rust(_) | Pattern::Scratched(_) | Pattern::ChippedPaint(_) | Pattern::Brushed(_) | Pattern::TreadPlate(_) => {
            (1.0, 0.5)
        }
        Pattern::Hammered(p) => (if p.metallic > 0.0 { 1.0 } else { 0.0 }, 0.5),
        Pattern::Corrugated(p) => (if p.metallic > 0.0 { 1.0 } else { 0.0 }, 0.5),
        // Cloth, earth and plaster reflect little.
        Pattern::Woven(_) | Pattern::Knitted(_) | Pattern::Stripes(_) | Pattern::Camouflage(_) => (0.0, rng.between(0.1, 0.4)),
        Pattern::Plaster(_) | Pattern::Sand(_) | Pattern::CrackedEarth(_) | Pattern::Bricks(_) => (0.0, rng.between(0.1, 0.5)),
        _ => (0.0, rng.between(0.3, 0.7)),
    };
    let mut material = plain(name, [1.0; 3], metallic, 1.0, specular);
    match &pattern {
        // Carbon fibre lies in resin; wood and leather are often varnished.
        Pattern::CarbonFibre(_) if rng.chance(0.7) => coat(rng, &mut material),
        Pattern::Wood(_) | Pattern::Parquet(_) | Pattern::Leather(_) if rng.chance(0.2) => coat(rng, &mut material),
        Pattern::Woven(_) | Pattern::Knitted(_) if rng.chance(0.4) => cloth(rng, &mut material),
        Pattern::Brushed(_) if rng.chance(0.6) => material.anisotropic = rng.between(0.4, 0.95),
        _ => {}
    }
    material.pattern = Some(pattern);
    material
}

/// A dielectric of one colour.
fn constant(rng: &mut Pcg64, name: &str) -> Material {
    match rng.weighted(&[0.62, 0.1, 0.1, 0.1, 0.08]) {
        0 => dielectric(rng, name),
        // Lacquer and glazed things: deep colours, nearly mirrors.
        1 => {
            let (hue, saturation, value) = (rng.between(0.0, 360.0), rng.between(0.0, 1.0), rng.log(0.01, 0.3));
            plain(name, Pcg64::hsv(hue, saturation, value), 0.0, rng.log(0.03, 0.15), rng.between(0.5, 1.0))
        }
        // Chalk, paper, snow and unglazed clay.
        2 => {
            let color = near(rng, [0.84, 0.83, 0.81], 0.06, 0.05);
            plain(name, color, 0.0, rng.between(0.85, 1.0), rng.between(0.0, 0.25))
        }
        // Signal colours of plastics.
        3 => {
            let (hue, saturation, value) = (rng.between(0.0, 360.0), rng.between(0.85, 1.0), rng.between(0.5, 0.9));
            plain(name, Pcg64::hsv(hue, saturation, value), 0.0, rng.between(0.15, 0.5), rng.between(0.4, 0.7))
        }
        // Paints with metal flakes, and minerals between both.
        _ => {
            let (hue, saturation, value) = (rng.between(0.0, 360.0), rng.between(0.1, 0.9), rng.log(0.1, 0.7));
            plain(name, Pcg64::hsv(hue, saturation, value), rng.between(0.2, 0.7), rng.between(0.2, 0.6), rng.between(0.3, 0.8))
        }
    }
}

/// The lobes that only some materials have.
fn lobes(rng: &mut Pcg64, material: &mut Material, metallic: bool, knobs: &MaterialKnobs) {
    let patterned = material.pattern.is_some();
    if rng.chance(knobs.coated) {
        coat(rng, material);
    }
    if rng.chance(knobs.anisotropic) {
        material.anisotropic = rng.between(0.4, 0.95);
        if !patterned {
            // Stretched lobes are seen where they are neither mirrors nor dull.
            material.roughness = rng.between(0.2, 0.5);
        }
    }
    if metallic {
        return;
    }
    // Bricks have no fluff, and light does not wander through rust.
    if !patterned && rng.chance(knobs.sheen) {
        cloth(rng, material);
        material.roughness = rng.between(0.6, 1.0);
    }
    let translucent = !patterned || matches!(material.pattern, Some(Pattern::Marble(_)));
    if translucent && rng.chance(knobs.subsurface) {
        material.subsurface = rng.between(0.4, 1.0);
    }
    if rng.chance(0.1) {
        material.specular_tint = rng.between(0.2, 1.0);
    }
}

fn coat(rng: &mut Pcg64, material: &mut Material) {
    (material.clearcoat, material.clearcoat_gloss) = (rng.between(0.4, 1.0), rng.between(0.7, 1.0));
}

fn cloth(rng: &mut Pcg64, material: &mut Material) {
    (material.sheen, material.sheen_tint) = (rng.between(0.3, 1.0), rng.between(0.0, 1.0));
}
