//! Textures of patterns: made once it is known which of their maps anything looks at.

use super::{build, images};
use crate::description::Material as Described;
use crate::loaded::{Encoding, Wrap};
use crate::pattern::{Map, MapSet, Maps, Pattern};
use crate::{Material, Texture};
use glam::Vec3A;
use rayon::prelude::*;
use std::collections::HashMap;

/// A pattern of the scene and its three textures for each way to go on beyond the edge.
struct Wanted {
    pattern: Pattern,
    /// Base colour, metallic with roughness, normals; the last is `None` for a flat pattern.
    textures: Vec<[Option<usize>; 3]>,
}

/// The patterns of a scene, each once.
#[derive(Default)]
pub(super) struct Patterns {
    wanted: Vec<Wanted>,
    known: HashMap<String, usize>,
    slots: HashMap<(usize, Wrap), [Option<usize>; 3]>,
}

impl Patterns {
    /// Gives `material` the textures of its pattern, to be made later.
    pub fn add(&mut self, pattern: &Pattern, described: &Described, material: &mut Material, textures: &mut Vec<Texture>) {
        // Equal patterns have equal JSON.
        let key = serde_json::to_string(pattern).unwrap_or_default();
        let index = *self.known.entry(key).or_insert_with(|| {
            self.wanted.push(Wanted { pattern: pattern.clone(), textures: vec![] });
            self.wanted.len() - 1
        });
        let wrap = build::wrap(described);
        let slots = *self.slots.entry((index, wrap)).or_insert_with(|| {
            let mut room = |encoding| {
                textures.push(images::placeholder(pattern.kind(), encoding, [wrap; 2]));
                textures.len() - 1
            };
            let (color, surface) = (room(Encoding::Srgb), room(Encoding::Linear));
            let slots = [Some(color), Some(surface), pattern.has_relief().then(|| room(Encoding::Normal))];
            self.wanted[index].textures.push(slots);
            slots
        });
        let [color, surface, normal] = slots.map(|texture| texture.map(|t| build::slot(described, t)));
        material.base_color_texture = color;
        material.metallic_roughness_texture = surface;
        material.normal_texture = normal.map(|slot| (slot, 1.0));
    }

    /// Makes the maps that some material looks at. One that is the same everywhere becomes a factor, unless `everything` is asked
    /// for.
    pub fn make(&self, materials: &mut [Material], textures: &mut [Texture], everything: bool) {
        let looked_at = images::looked_at(materials, textures.len());
        let asked = |wanted: &Wanted, map: usize| {
            let mut indices = wanted.textures.iter().filter_map(|slots| slots[map]);
            indices.any(|texture| everything || looked_at[texture])
        };
        let made: Vec<Made> = self
            .wanted
            .par_iter()
            .enumerate()
            .filter_map(|(index, wanted)| {
                let set = MapSet { base_color: asked(wanted, 0), metallic_roughness: asked(wanted, 1), normal: asked(wanted, 2) };
                let nothing = MapSet { base_color: false, metallic_roughness: false, normal: false };
                (set != nothing).then(|| finish(index, wanted.pattern.kind(), wanted.pattern.maps(set)))
            })
            .collect();
        for Made { index, textures: maps, constants } in made {
            for slots in &self.wanted[index].textures {
                for (map, texture) in slots.iter().enumerate() {
                    let (Some(texture), Some(made)) = (*texture, maps.iter().find(|t| t.encoding == ENCODINGS[map])) else {
                        continue;
                    };
                    // Levels are shared, not copied.
                    textures[texture] = Texture { wrap: textures[texture].wrap, ..made.clone() };
                    if let (Some(constant), false) = (constants[map], everything) {
                        materials.iter_mut().for_each(|material| replace(material, map, texture, constant));
                    }
                }
            }
        }
    }
}

/// Encodings of the three maps.
const ENCODINGS: [Encoding; 3] = [Encoding::Srgb, Encoding::Linear, Encoding::Normal];

/// Textures of pattern `index`. Those of maps that are the same everywhere have one texel, and their values are here.
struct Made {
    index: usize,
    textures: Vec<Texture>,
    constants: [Option<[f32; 3]>; 3],
}

fn finish(index: usize, name: &str, maps: Maps) -> Made {
    let mut constants = [None; 3];
    let mut textures = vec![];
    for (k, map) in [maps.base_color, maps.metallic_roughness, maps.normal].into_iter().enumerate() {
        let (size, encoding) = ([maps.size; 2], ENCODINGS[k]);
        textures.push(match map {
            None => continue,
            Some(Map::Constant(value)) => {
                constants[k] = Some(value);
                let code = |v: f32| match encoding {
                    Encoding::Srgb => crate::mipmap::srgb_byte(v),
                    Encoding::Linear => (v * 255.0 + 0.5) as u8,
                    Encoding::Normal => (v * 127.5 + 128.0) as u8,
                };
                let [r, g, b] = value.map(code);
                Texture::from_rgba8(name, [1; 2], vec![[r, g, b, 255]], encoding, Default::default())
            }
            Some(Map::Bytes(texels)) => Texture::from_rgba8(name, size, texels, encoding, Default::default()),
            Some(Map::Words(texels)) => Texture::from_rgba16(name, size, texels, encoding, Default::default()),
        });
    }
    Made { index, textures, constants }
}

/// Puts a constant into the factors in place of texture `texture`.
fn replace(material: &mut Material, map: usize, texture: usize, [r, g, b]: [f32; 3]) {
    let is = |slot: &crate::TextureSlot| slot.texture == texture;
    match map {
        0 if material.base_color_texture.as_ref().is_some_and(is) => {
            material.base_color_texture = None;
            material.surface.base_color *= Vec3A::new(r, g, b);
        }
        1 if material.metallic_roughness_texture.as_ref().is_some_and(is) => {
            material.metallic_roughness_texture = None;
            material.surface.roughness *= g;
            material.surface.metallic *= b;
        }
        2 if material.normal_texture.as_ref().is_some_and(|(slot, _)| is(slot)) => material.normal_texture = None,
        _ => {}
    }
}
