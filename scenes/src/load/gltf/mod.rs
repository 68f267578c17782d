//! glTF 2.0: the default scene's node tree, triangles, metallic-roughness materials.

mod access;
mod container;
mod document;
mod extension;
mod material;
mod uri;

use super::model::{Model, Part};
use crate::error::{Error, Result};
use crate::texture::Budget;
use crate::{LoadReport, Mesh};
use access::Buffers;
use glam::{DAffine3, DMat3, DMat4, DQuat, DVec3, DVec4, Vec2, Vec3, Vec4};
use gltf::{Document, Semantic, mesh::Mode, scene::Transform};
use material::Materials;
use renderflow_frame::file;
use renderflow_frame::reach::Reach;
use std::collections::HashMap;
use std::path::Path;

/// Extensions that are read, beyond those that the gltf crate knows it can.
const READ: [&str; 7] = [
    "KHR_mesh_quantization",
    "KHR_materials_specular",
    "KHR_materials_clearcoat",
    "KHR_materials_sheen",
    "KHR_materials_anisotropy",
    "KHR_materials_transmission",
    "KHR_materials_volume",
];
/// Extensions that the gltf crate reads here (its cargo features).
const READ_BY_CRATE: [&str; 3] = ["KHR_texture_transform", "KHR_materials_ior", "KHR_materials_emissive_strength"];

/// Reads a `.gltf` or `.glb` file, whose URIs lead where `reach` says; materials and textures only within a budget for the
/// latter.
pub(super) fn read(path: &Path, reach: &Reach, textures: Option<&Budget>) -> Result<Model> {
    let bytes = file::read(path)?;
    let (document, blob) = document::parse(path, &bytes)?;
    drop(bytes);
    let buffers = Buffers::read(path, reach, &document, blob)?;
    let mut reader = Reader {
        path,
        buffers: &buffers,
        model: Model::default(),
        materials: textures.map(|_| Materials::new(path, reach, &document)),
        meshes: HashMap::new(),
        skipped: Skipped::default(),
    };
    reader.scene(&document)?;
    let Reader { mut model, materials, skipped, .. } = reader;
    skipped.tell(&mut model.report);
    for extension in document.extensions_used() {
        if !READ.contains(&extension) && !READ_BY_CRATE.contains(&extension) {
            model.report.notes.push(format!("the extension {extension} is not read"));
        }
    }
    if let (Some(materials), Some(budget)) = (materials, textures) {
        (model.materials, model.textures) = materials.finish(&buffers, budget)?;
    }
    if model.meshes.is_empty() {
        let why = if document.meshes().len() == 0 { "the file has no mesh" } else { "no node of its scene shows a mesh" };
        if model.report.notes.is_empty() {
            model.report.notes.push(why.into());
        }
    }
    let unused = [(document.cameras().len(), "camera", "used"), (document.animations().len(), "animation", "played")];
    for (count, what, done) in unused.into_iter().filter(|(count, ..)| *count > 0) {
        let (plural, verb) = if count == 1 { ("", "is") } else { ("s", "are") };
        model.report.notes.push(format!("{count} {what}{plural} of the file {verb} not {done}"));
    }
    Ok(model)
}

/// What was met and not rendered.
#[derive(Default)]
struct Skipped {
    points_and_lines: usize,
    colors: usize,
    skins: usize,
    morphs: usize,
    collapsed: usize,
    without_positions: usize,
}

impl Skipped {
    fn tell(&self, report: &mut LoadReport) {
        for (count, what) in [
            (self.points_and_lines, "primitives of points or lines skipped"),
            (self.without_positions, "primitives without positions skipped"),
            (self.colors, "primitives with vertex colours, which are ignored"),
            (self.skins, "skinned nodes shown as their meshes stand in the file"),
            (self.morphs, "primitives with morph targets, which are ignored"),
            (self.collapsed, "nodes skipped because their transform flattens everything"),
        ] {
            if count > 0 {
                report.notes.push(format!("{count} {what}"));
            }
        }
    }
}

/// A mesh of the model with its material.
#[derive(Clone)]
struct Primitive {
    mesh: usize,
    material: Option<usize>,
}

struct Reader<'a> {
    path: &'a Path,
    buffers: &'a Buffers<'a>,
    model: Model,
    materials: Option<Materials<'a>>,
    /// Renderable primitives of each mesh read so far.
    meshes: HashMap<usize, Vec<Primitive>>,
    skipped: Skipped,
}

impl Reader<'_> {
    /// Walks the default scene, else the first one, else every node that is no child.
    fn scene(&mut self, document: &Document) -> Result<()> {
        let nodes: Vec<gltf::Node> = document.nodes().collect();
        let roots: Vec<usize> = match document.default_scene().or_else(|| document.scenes().next()) {
            Some(scene) => scene.nodes().map(|n| n.index()).collect(),
            None => {
                let mut is_child = vec![false; nodes.len()];
                nodes.iter().flat_map(|n| n.children()).for_each(|c| is_child[c.index()] = true);
                (0..nodes.len()).filter(|&i| !is_child[i]).collect()
            }
        };
        // A stack instead of recursion, and each node once: loops and shared children end here.
        let mut visited = vec![false; nodes.len()];
        let mut stack: Vec<(usize, DAffine3)> = roots.into_iter().rev().map(|i| (i, DAffine3::IDENTITY)).collect();
        while let Some((index, parent)) = stack.pop() {
            let place = format!("/nodes/{index}");
            if std::mem::replace(&mut visited[index], true) {
                return Err(Error::model(self.path, place, "the node has two parents, or is its own ancestor"));
            }
            let node = &nodes[index];
            let transform = parent * local(node);
            if !transform.is_finite() {
                return Err(Error::model(self.path, place, "the transform is not finite"));
            }
            self.node(node, transform)?;
            let children: Vec<usize> = node.children().map(|c| c.index()).collect();
            stack.extend(children.into_iter().rev().map(|c| (c, transform)));
        }
        Ok(())
    }

    fn node(&mut self, node: &gltf::Node, transform: DAffine3) -> Result<()> {
        let Some(mesh) = node.mesh() else { return Ok(()) };
        if !super::invertible(super::relative(transform, transform.translation)) {
            self.skipped.collapsed += 1;
            return Ok(());
        }
        self.skipped.skins += usize::from(node.skin().is_some());
        let primitives = match self.meshes.get(&mesh.index()) {
            Some(known) => known.clone(),
            None => {
                let read = self.mesh(&mesh)?;
                self.meshes.insert(mesh.index(), read.clone());
                read
            }
        };
        let name = node.name().or(mesh.name()).map_or_else(|| format!("node {}", node.index()), str::to_owned);
        for Primitive { mesh, material } in primitives {
            self.model.parts.push(Part { name: name.clone(), mesh, material, transform });
        }
        Ok(())
    }

    fn mesh(&mut self, mesh: &gltf::Mesh) -> Result<Vec<Primitive>> {
        let mut result = vec![];
        for primitive in mesh.primitives() {
            if let Some(read) = self.primitive(mesh, &primitive)? {
                self.model.meshes.push(read);
                let material = match &mut self.materials {
                    Some(materials) => Some(materials.index(&primitive.material(), &mut self.model.report)),
                    None => None,
                };
                result.push(Primitive { mesh: self.model.meshes.len() - 1, material });
            }
        }
        Ok(result)
    }

    /// Triangles of a primitive; `None` for points, lines and primitives without positions.
    fn primitive(&mut self, mesh: &gltf::Mesh, primitive: &gltf::Primitive) -> Result<Option<Mesh>> {
        let place = format!("/meshes/{}/primitives/{}", mesh.index(), primitive.index());
        if matches!(primitive.mode(), Mode::Points | Mode::Lines | Mode::LineLoop | Mode::LineStrip) {
            self.skipped.points_and_lines += 1;
            return Ok(None);
        }
        let Some(accessor) = primitive.get(&Semantic::Positions) else {
            self.skipped.without_positions += 1;
            return Ok(None);
        };
        self.skipped.colors += usize::from(primitive.get(&Semantic::Colors(0)).is_some());
        self.skipped.morphs += usize::from(primitive.morph_targets().next().is_some());
        let buffers = self.buffers;
        let positions = buffers.floats::<3>(&accessor, &format!("{place}/attributes/POSITION"))?;
        let order = match primitive.indices() {
            Some(accessor) => buffers.indices(&accessor, &format!("{place}/indices"))?,
            None => (0..positions.len() as u32).collect(),
        };
        let set = self.materials.as_ref().map_or(0, |materials| materials.texture_set(&primitive.material()));
        let vertices = positions.len();
        Ok(Some(Mesh {
            name: mesh.name().map_or_else(|| format!("mesh {}", mesh.index()), str::to_owned),
            normals: self.attribute::<3, Vec3>(primitive, Semantic::Normals, vertices, &place)?,
            tangents: self.attribute::<4, Vec4>(primitive, Semantic::Tangents, vertices, &place)?,
            uvs: self.attribute::<2, Vec2>(primitive, Semantic::TexCoords(set), vertices, &place)?,
            positions: positions.into_iter().map(Vec3::from).collect(),
            triangles: triangles(primitive.mode(), &order),
        }))
    }

    /// An optional attribute with one value for each of `vertices`.
    fn attribute<const N: usize, T: From<[f32; N]>>(
        &self,
        primitive: &gltf::Primitive,
        semantic: Semantic,
        vertices: usize,
        place: &str,
    ) -> Result<Vec<T>> {
        let Some(accessor) = primitive.get(&semantic) else { return Ok(vec![]) };
        let place = format!("{place}/attributes/{}", semantic.to_string());
        let values = self.buffers.floats::<N>(&accessor, &place)?;
        if values.len() != vertices {
            return Err(Error::model(self.path, place, format!("{} values for {vertices} positions", values.len())));
        }
        Ok(values.into_iter().map(T::from).collect())
    }
}

/// Node to parent, in double precision: trees of many nodes may go far out and come back. Quaternions are normalised; one of zero
/// length turns nothing.
fn local(node: &gltf::Node) -> DAffine3 {
    match node.transform() {
        Transform::Matrix { matrix } => {
            DAffine3::from_mat4(DMat4::from_cols_array_2d(&matrix.map(|column| column.map(f64::from))))
        }
        Transform::Decomposed { translation, rotation, scale } => {
            let q = DVec4::from(rotation.map(f64::from));
            let turn = q.try_normalize().map_or(DQuat::IDENTITY, DQuat::from_vec4);
            let matrix3 = DMat3::from_quat(turn) * DMat3::from_diagonal(DVec3::from(scale.map(f64::from)));
            DAffine3 { matrix3, translation: DVec3::from(translation.map(f64::from)) }
        }
    }
}

/// Triangles of a list, strip or fan (glTF 2.0, section 3.7.2.1).
fn triangles(mode: Mode, order: &[u32]) -> Vec<[u32; 3]> {
    let at = |i: usize| order[i];
    let windows = order.len().saturating_sub(2);
    match mode {
        Mode::Triangles => order.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
        Mode::TriangleStrip => (0..windows).map(|i| [at(i), at(i + 1 + i % 2), at(i + 2 - i % 2)]).collect(),
        Mode::TriangleFan => (0..windows).map(|i| [at(i + 1), at(i + 2), at(0)]).collect(),
        Mode::Points | Mode::Lines | Mode::LineLoop | Mode::LineStrip => vec![],
    }
}
