//! glTF 2.0: the default scene's node tree, triangles, metallic-roughness materials.

mod access;
mod container;
mod curve;
mod document;
mod extension;
pub(super) mod label;
pub(super) mod lights;
mod material;
pub(super) mod rig;
mod tree;
mod uri;

use super::model::{Model, Part};
use crate::error::{Error, Result};
use crate::texture::Budget;
use crate::{LoadReport, Mesh};
use access::Buffers;
use glam::{DAffine3, Vec2, Vec3, Vec4};
use gltf::{Document, Semantic, mesh::Mode};
use material::Materials;
use renderflow_frame::file;
use renderflow_frame::reach::Reach;
use std::collections::HashMap;
use std::path::Path;

/// Extensions that are read, beyond those that the gltf crate knows it can.
const READ: [&str; 8] = [
    "KHR_lights_punctual",
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
/// latter. Parts that are flattened as they rest come with it where `flat` parts are asked for.
pub(super) fn read(path: &Path, reach: &Reach, textures: Option<&Budget>, flat: bool) -> Result<Model> {
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
        flat,
    };
    let nodes = tree::nodes(path, &document)?;
    reader.scene(&document, &nodes)?;
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
    model.lights = lights::read(path, &document, &nodes, &mut model.report)?;
    let cameras = rig::cameras(&document, &nodes);
    model.cameras = cameras.iter().enumerate().map(|(number, camera)| label::of(number, camera.name.as_deref())).collect();
    model.animations = document.animations().map(|a| label::of(a.index(), a.name())).collect();
    if cameras.is_empty() && document.cameras().len() > 0 {
        model.report.notes.push("no node of the file's scene shows a camera of the file".into());
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
    /// Whether parts without volume, which an animation may unfold, are read too.
    flat: bool,
}

impl Reader<'_> {
    fn scene(&mut self, document: &Document, tree: &[tree::Node]) -> Result<()> {
        let nodes: Vec<gltf::Node> = document.nodes().collect();
        let mut world: Vec<DAffine3> = Vec::with_capacity(tree.len());
        for (place, node) in tree.iter().enumerate() {
            let transform = node.parent.map_or(DAffine3::IDENTITY, |parent| world[parent]) * node.local.affine();
            if !transform.is_finite() {
                return Err(Error::model(self.path, format!("/nodes/{}", node.index), "the transform is not finite"));
            }
            self.node(&nodes[node.index], place, transform)?;
            world.push(transform);
        }
        Ok(())
    }

    /// The meshes of a node at `place` in the tree.
    fn node(&mut self, node: &gltf::Node, place: usize, transform: DAffine3) -> Result<()> {
        let Some(mesh) = node.mesh() else { return Ok(()) };
        if !self.flat && !super::invertible(super::relative(transform, transform.translation)) {
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
            self.model.parts.push(Part { name: name.clone(), mesh, material, transform, node: place });
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
