//! Wavefront OBJ and MTL, parsed by tobj.

mod lines;
mod material;
mod texture;

use super::model::{Model, Part};
use super::polygon;
use crate::error::{Error, Result};
use crate::texture::Budget;
use crate::{Material, Mesh};
use glam::{DAffine3, Vec2, Vec3, Vec3A, Vec4};
use lines::Lines;
use renderflow_frame::color::srgb_to_linear;
use renderflow_frame::file;
use renderflow_frame::reach::Reach;
use std::cell::RefCell;
use std::path::Path;

/// Reads an `.obj` file, whose names lead where `reach` says; materials and textures only within a budget for the latter.
pub(super) fn read(path: &Path, reach: &Reach, textures: Option<&Budget>) -> Result<Model> {
    let text = file::read(path)?;
    let text = text.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&text);
    let mut libraries = material::Libraries::new(reach);
    let mut lines = Lines::new(text, |name| if textures.is_some() { libraries.read(name) } else { vec![] });
    let libraries = RefCell::new(libraries);
    let options = tobj::LoadOptions { triangulate: false, single_index: true, ..Default::default() };
    let parsed = tobj::load_obj_buf(&mut lines, &options, |number| libraries.borrow_mut().take(number));
    let (models, materials) = parsed.map_err(|e| {
        // What was seen in the line is more than the parser says.
        let (line, reason) =
            lines.fault.take().filter(|(line, _)| *line == lines.line).unwrap_or_else(|| (lines.line, e.to_string()));
        Error::model(path, format!("line {line}"), format!("{reason} (not an OBJ file?)"))
    })?;
    let libraries = libraries.into_inner();
    let mut model = Model::default();
    model.report.triangles.out_of_range = lines.left_out.triangles;
    model.missing_vertex = lines.missing_vertex.take();
    model.not_finite = lines.not_finite.take();
    model.report.notes.extend(model.missing_vertex.iter().map(|place| format!("{place}: the face is left out")));
    for (count, what) in [
        (lines.left_out.points_and_lines, "points and lines skipped"),
        (lines.left_out.attributes, "faces whose texture coordinates or normals do not exist are shown without"),
        (lines.left_out.colors, "vertices with colours that are not read"),
    ] {
        if count > 0 {
            model.report.notes.push(format!("{count} {what}"));
        }
    }
    if let Some(budget) = textures {
        let materials = materials.unwrap_or_default();
        libraries.finish(&materials, &lines.materials, budget, &mut model).map_err(|error| match error {
            // Only here it is known which file holds the name.
            Error::Name { reason } => Error::Name { reason: format!("{}: {reason}", path.display()) },
            other => other,
        })?;
    }
    let mut colored = None;
    for tobj::Model { mesh, name } in models {
        if mesh.indices.is_empty() {
            continue;
        }
        let mut material = mesh.material_id.filter(|_| textures.is_some());
        let mut mesh = convert(name.clone(), &mesh);
        if textures.is_none() {
            mesh.colors.clear();
        } else if material.is_none() && !mesh.colors.is_empty() {
            material = Some(*colored.get_or_insert_with(|| {
                model.materials.push(Material { name: "colours of vertices".into(), ..Material::default() });
                model.materials.last_mut().into_iter().for_each(|material| material.surface.base_color = Vec3A::ONE);
                model.materials.len() - 1
            }));
        }
        let (mesh_number, transform) = (model.meshes.len(), DAffine3::IDENTITY);
        model.parts.push(Part { name: name.clone(), mesh: mesh_number, material, transform, node: 0, deformer: None });
        model.meshes.push(mesh);
    }
    Ok(model)
}

/// The same mesh with v running down, as everywhere else here (in OBJ it runs up), and linear colours: those in such files are
/// encoded as sRGB.
fn convert(name: String, mesh: &tobj::Mesh) -> Mesh {
    let vectors = |flat: &[f32]| flat.chunks_exact(3).map(Vec3::from_slice).collect::<Vec<_>>();
    let positions = vectors(&mesh.positions);
    let mut triangles = vec![];
    if mesh.face_arities.is_empty() {
        triangles.extend(mesh.indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]));
    }
    let mut rest = &mesh.indices[..];
    for &corners in &mesh.face_arities {
        let Some((face, behind)) = rest.split_at_checked(corners as usize) else { break };
        polygon::cut(face, &positions, &mut triangles);
        rest = behind;
    }
    Mesh {
        name,
        positions,
        normals: vectors(&mesh.normals),
        uvs: mesh.texcoords.chunks_exact(2).map(|uv| Vec2::new(uv[0], 1.0 - uv[1])).collect(),
        colors: vectors(&mesh.vertex_color)
            .into_iter()
            .map(|color| Vec4::from((color.map(|v| srgb_to_linear(v.clamp(0.0, 1.0))), 1.0)))
            .collect(),
        triangles,
        ..Mesh::default()
    }
}
