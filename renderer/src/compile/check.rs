//! Refuses scenes that cannot be compiled.

use super::MAX_UV_SETS;
use crate::accel::MAX_TRIANGLES;
use crate::error::{Error, Result};
use crate::geometry::{Geometry, Sharing};
use renderflow_scenes::LoadedScene;
use renderflow_scenes::loaded::PunctualKind;
use renderflow_scenes::mipmap::{Level, Texels};

/// Refuses references that lead out of the scene's arrays, and values outside their range.
pub(super) fn check(scene: &LoadedScene, sharing: Sharing) -> Result<()> {
    if scene.cameras.is_empty() {
        return Err(Error::inconsistent("cameras", "there is none"));
    }
    let missing = |place: String, index: usize, count: usize| {
        Err(Error::inconsistent(place, format!("{index} does not exist, there are {count}")))
    };
    for (i, instance) in scene.instances.iter().enumerate() {
        if instance.mesh >= scene.meshes.len() {
            return missing(format!("instances/{i}/mesh"), instance.mesh, scene.meshes.len());
        }
        if instance.material >= scene.materials.len() {
            return missing(format!("instances/{i}/material"), instance.material, scene.materials.len());
        }
        if instance.transforms.is_empty() {
            return Err(Error::inconsistent(format!("instances/{i}/transforms"), "there is none"));
        }
    }
    for (i, light) in scene.lights.iter().enumerate() {
        let strength = match light.kind {
            PunctualKind::Point { intensity: v } | PunctualKind::Spot { intensity: v, .. } => v,
            PunctualKind::Directional { irradiance } => irradiance,
        };
        let placed = !light.transforms.is_empty() && light.transforms.iter().all(|t| t.is_finite());
        if !placed || !strength.iter().all(|v| v.is_finite() && *v >= 0.0) {
            return Err(Error::inconsistent(format!("lights/{i}"), "a strength or a transform is missing or not finite"));
        }
    }
    let (triangles, vertices) = Geometry::flattened_size(&scene.meshes, &scene.instances, sharing);
    if triangles > MAX_TRIANGLES {
        return Err(Error::TooLarge { what: "triangles", count: triangles, limit: MAX_TRIANGLES });
    }
    if vertices > u32::MAX as usize {
        return Err(Error::TooLarge { what: "vertices", count: vertices, limit: u32::MAX as usize });
    }
    for (i, mesh) in scene.meshes.iter().enumerate() {
        let count = mesh.positions.len();
        if let Some(t) = mesh.triangles.iter().position(|t| t.iter().any(|&v| v as usize >= count)) {
            return Err(Error::inconsistent(
                format!("meshes/{i}/triangles/{t}"),
                format!("a vertex is beyond the {count} there are"),
            ));
        }
        let further = mesh.more_uvs.iter().map(|uvs| ("more_uvs", uvs.len()));
        let own = [
            ("normals", mesh.normals.len()),
            ("uvs", mesh.uvs.len()),
            ("tangents", mesh.tangents.len()),
            ("colors", mesh.colors.len()),
        ];
        for (what, length) in own.into_iter().chain(further) {
            if length != 0 && length != count {
                let reason = format!("{length} for {count} vertices");
                return Err(Error::inconsistent(format!("meshes/{i}/{what}"), reason));
            }
        }
    }
    for (i, material) in scene.materials.iter().enumerate() {
        for slot in material.texture_slots() {
            if slot.texture >= scene.textures.len() {
                return missing(format!("materials/{i}"), slot.texture, scene.textures.len());
            }
            if slot.set > MAX_UV_SETS {
                return missing(format!("materials/{i}"), slot.set, MAX_UV_SETS);
            }
        }
        if !material.absorption.iter().all(|v| v.is_finite() && *v >= 0.0) {
            let reason = format!("absorption {:?} is not finite", material.absorption);
            return Err(Error::inconsistent(format!("materials/{i}"), reason));
        }
        if !material.emissive.iter().all(|v| v.is_finite() && *v >= 0.0) {
            return Err(Error::inconsistent(format!("materials/{i}"), format!("emission {:?} is not finite", material.emissive)));
        }
        for surface in std::iter::once(&material.surface).chain(&material.change) {
            if let Some((field, value)) = surface.out_of_range() {
                return Err(Error::inconsistent(format!("materials/{i}"), format!("{field}: {value} is outside 0..=1")));
            }
        }
    }
    for (i, texture) in scene.textures.iter().enumerate() {
        let complete = |level: &Level| match &level.texels {
            Texels::Bytes(texels) => texels.len() == level.width * level.height,
            Texels::Words(texels) => texels.len() == level.width * level.height,
        };
        if !texture.levels.iter().all(complete) {
            return Err(Error::inconsistent(format!("textures/{i}"), "size and texel count differ"));
        }
    }
    Ok(())
}
