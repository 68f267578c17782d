//! Wavefront OBJ and MTL, parsed by tobj.

mod lines;
mod material;
mod texture;

use super::model::{Model, Part};
use crate::Mesh;
use crate::error::{Error, Result};
use glam::{DAffine3, Vec2, Vec3};
use lines::Lines;
use std::cell::RefCell;
use std::path::Path;

/// Reads an `.obj` file; materials and textures only `with_materials`.
pub(super) fn read(path: &Path, with_materials: bool) -> Result<Model> {
    let text = std::fs::read(path).map_err(Error::io(path, "read"))?;
    let mut lines = Lines::new(&text);
    let libraries = RefCell::new(material::Libraries::new(path));
    let options = tobj::LoadOptions { triangulate: true, single_index: true, ..Default::default() };
    let parsed = tobj::load_obj_buf(&mut lines, &options, |name| {
        if with_materials { libraries.borrow_mut().read(name) } else { Ok(Default::default()) }
    });
    let (models, materials) =
        parsed.map_err(|e| Error::model(path, format!("line {}", lines.line), format!("{e} (not an OBJ file?)")))?;
    let libraries = libraries.into_inner();
    let mut model = Model::default();
    model.report.triangles.out_of_range = lines.left_out.triangles;
    for (count, what) in [
        (lines.left_out.points_and_lines, "points and lines skipped"),
        (lines.left_out.attributes, "faces whose texture coordinates or normals do not exist are shown without"),
        (lines.left_out.colors, "vertices with colours, which are ignored"),
    ] {
        if count > 0 {
            model.report.notes.push(format!("{count} {what}"));
        }
    }
    if with_materials {
        let materials = materials.unwrap_or_default();
        libraries.finish(&materials, &lines.materials, &mut model)?;
    }
    for tobj::Model { mesh, name } in models {
        if mesh.indices.is_empty() {
            continue;
        }
        let material = mesh.material_id.filter(|_| with_materials);
        model.parts.push(Part { name: name.clone(), mesh: model.meshes.len(), material, transform: DAffine3::IDENTITY });
        model.meshes.push(convert(name, &mesh));
    }
    Ok(model)
}

/// The same mesh with v running down, as everywhere else here (in OBJ it runs up).
fn convert(name: String, mesh: &tobj::Mesh) -> Mesh {
    let vectors = |flat: &[f32]| flat.chunks_exact(3).map(Vec3::from_slice).collect::<Vec<_>>();
    Mesh {
        name,
        positions: vectors(&mesh.positions),
        normals: vectors(&mesh.normals),
        uvs: mesh.texcoords.chunks_exact(2).map(|uv| Vec2::new(uv[0], 1.0 - uv[1])).collect(),
        tangents: vec![],
        triangles: mesh.indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
    }
}
