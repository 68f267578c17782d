//! Images of described materials: read once it is known which of them anything looks at.

use crate::error::{Error, Result};
use crate::loaded::{Encoding, Wrap};
use crate::texture::{self, Budget};
use crate::{Instance, Material, Mesh, Texture};
use glam::Vec3A;
use renderflow_frame::reach::Reach;
use std::borrow::Cow;
use std::path::PathBuf;

/// An image to read into one of the scene's textures.
pub(super) struct Wanted {
    /// Index of the texture.
    pub texture: usize,
    /// `Err` with the reason where the scene may not name it.
    pub path: std::result::Result<PathBuf, String>,
    /// The material, by place and by name.
    pub place: String,
    pub user: String,
}

/// A texture whose image is not read yet.
pub(super) fn placeholder(name: &str, encoding: Encoding, wrap: [Wrap; 2]) -> Texture {
    Texture { name: name.into(), wrap, encoding, levels: [].into() }
}

/// Takes away the look-ups that cannot change a picture: all those of materials on nothing, normal maps on meshes without
/// tangents, and what a factor of zero hides. Returns the names of unused materials that had any.
pub(super) fn drop_idle_slots(materials: &mut [Material], instances: &[Instance], meshes: &[Mesh]) -> Vec<String> {
    let (mut used, mut bumpy) = (vec![false; materials.len()], vec![false; materials.len()]);
    for instance in instances {
        used[instance.material] = true;
        bumpy[instance.material] |= !meshes[instance.mesh].tangents.is_empty();
    }
    let mut unused = vec![];
    for (i, material) in materials.iter_mut().enumerate() {
        if !used[i] {
            let had = material.texture_slots().count() > 0;
            let (name, alpha_mask, opacity) = (material.name.clone(), material.alpha_mask, material.opacity);
            if had {
                unused.push(name);
            }
            // A mask by a colour's alpha means nothing without it.
            material.alpha_mask = alpha_mask.filter(|_| material.base_color_texture.is_none());
            material.opacity = opacity.filter(|_| material.base_color_texture.is_none());
            (material.base_color_texture, material.metallic_roughness_texture) = (None, None);
            (material.normal_texture, material.emissive_texture, material.transmission_texture) = (None, None, None);
            continue;
        }
        if !bumpy[i] {
            material.normal_texture = None;
        }
        if material.emissive == [0.0; 3] {
            material.emissive_texture = None;
        }
        // What a change brings from zero is looked at later.
        let (first, last) = (material.surface, material.change.unwrap_or(material.surface));
        let covers = material.alpha_mask.is_none() && material.opacity.is_none();
        if first.base_color == Vec3A::ZERO && last.base_color == Vec3A::ZERO && covers {
            material.base_color_texture = None;
        }
        if [first.roughness, first.metallic, last.roughness, last.metallic] == [0.0; 4] {
            material.metallic_roughness_texture = None;
        }
    }
    unused
}

/// Reads the images that some material looks at, where all fit into `budget`, and notes them in `reach`.
pub(super) fn read(
    wanted: &[Wanted],
    materials: &[Material],
    textures: &mut [Texture],
    budget: &Budget,
    reach: &Reach,
) -> Result<()> {
    let looked_at = looked_at(materials, textures.len());
    let asked: Vec<&Wanted> = wanted.iter().filter(|w| looked_at[w.texture]).collect();
    let about = |wanted: &&Wanted| {
        let Texture { name, encoding, wrap, .. } = &textures[wanted.texture];
        texture::Wanted { name: name.clone(), encoding: *encoding, wrap: *wrap }
    };
    let fail = |wanted: &&Wanted, reason: String| {
        let path = wanted.path.clone().unwrap_or_else(|_| textures[wanted.texture].name.clone().into());
        Error::Texture { user: wanted.user.clone(), path, reason }.at(wanted.place.clone())
    };
    let bytes = |wanted: &&Wanted| match &wanted.path {
        Ok(path) => texture::read(path).map(Cow::Owned).map_err(|reason| fail(wanted, reason)),
        Err(reason) => Err(Error::Name { reason: format!("{}: {reason}", wanted.user) }.at(wanted.place.clone())),
    };
    let decoded = texture::decode_all(&asked, budget, about, bytes, fail)?;
    for (wanted, texture) in asked.iter().zip(decoded) {
        wanted.path.iter().for_each(|path| reach.note(path));
        textures[wanted.texture] = texture;
    }
    Ok(())
}

/// Drops the textures that no material looks at.
pub(super) fn drop_idle_textures(materials: &mut [Material], textures: &mut Vec<Texture>) {
    let looked_at = looked_at(materials, textures.len());
    let mut kept = 0;
    let place: Vec<usize> = looked_at
        .iter()
        .map(|&kept_here| {
            kept += usize::from(kept_here);
            kept - usize::from(kept_here)
        })
        .collect();
    for slot in materials.iter_mut().flat_map(Material::texture_slots_mut) {
        slot.texture = place[slot.texture];
    }
    let mut looked_at = looked_at.into_iter();
    textures.retain(|_| looked_at.next().unwrap_or(true));
}

pub(super) fn looked_at(materials: &[Material], textures: usize) -> Vec<bool> {
    let mut looked_at = vec![false; textures];
    materials.iter().flat_map(Material::texture_slots).for_each(|slot| looked_at[slot.texture] = true);
    looked_at
}
