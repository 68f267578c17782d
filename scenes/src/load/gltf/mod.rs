//! glTF 2.0: the default scene's node tree, triangles, metallic-roughness materials.

mod access;
mod container;
mod curve;
mod document;
mod draco;
mod extension;
mod glossiness;
pub(super) mod label;
pub(super) mod lights;
mod material;
mod morph;
pub(super) mod rig;
pub(super) mod skin;
mod tree;
mod uri;

use super::deform::Deformer;
use super::mesh;
use super::model::{Model, Part};
use crate::error::{Error, Result};
use crate::loaded::{Rows, Shape};
use crate::texture::Budget;
use crate::{LoadReport, Mesh};
use access::Buffers;
use glam::{DAffine3, Vec2, Vec3, Vec4};
use gltf::{Document, Semantic, mesh::Mode};
use material::Materials;
use renderflow_frame::file;
use renderflow_frame::reach::Reach;
use skin::{Followed, Skin};
use std::collections::{HashMap, HashSet};
use std::path::Path;
use std::rc::Rc;
use std::sync::Arc;

/// Extensions that are read, beyond those that the gltf crate knows it can.
const READ: [&str; 14] = [
    draco::NAME,
    tree::INSTANCING,
    "EXT_texture_webp",
    "KHR_lights_punctual",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_unlit",
    "KHR_materials_variants",
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

/// Most parts of a model: nodes and instances times the primitives of their meshes. A kilobyte could ask for any number.
const MOST_PARTS: usize = 1 << 21;

/// Reads a `.gltf` or `.glb` file, whose URIs lead where `reach` says; materials and textures only within a budget for the
/// latter. What only an animation needs, parts that are flattened as they rest and meshes before anything moves them, comes with
/// it where the model is to be `animated`.
pub(super) fn read(path: &Path, reach: &Reach, textures: Option<&Budget>, animated: bool) -> Result<Model> {
    let bytes = file::read(path)?;
    let (document, blob) = document::parse(path, &bytes)?;
    let morphs = document.meshes().flat_map(|mesh| mesh.primitives()).any(|primitive| primitive.morph_targets().len() > 0);
    let further_targets = if morphs { document::further_targets(&bytes) } else { HashSet::new() };
    drop(bytes);
    let buffers = Buffers::read(path, reach, &document, blob)?;
    let mut reader = Reader {
        path,
        buffers: &buffers,
        model: Model::default(),
        materials: textures.map(|_| Materials::new(path, reach, &document)),
        meshes: HashMap::new(),
        skins: HashMap::new(),
        places: HashMap::new(),
        rest: vec![],
        weighted: document.nodes().any(|node| node.weights().is_some_and(morph::some)),
        further_targets,
        skipped: Skipped::default(),
        animated,
    };
    let mut nodes = tree::nodes(path, &document)?;
    let own = nodes.len();
    tree::add_instances(path, &document, &buffers, &mut nodes)?;
    reader.scene(&document, &nodes)?;
    nodes.truncate(own);
    let Reader { mut model, materials, skipped, .. } = reader;
    skipped.tell(&mut model.report);
    for extension in document.extensions_used() {
        if !READ.contains(&extension) && !READ_BY_CRATE.contains(&extension) {
            model.report.notes.push(format!("the extension {extension} is not read"));
        }
    }
    if let (Some(materials), Some(budget)) = (materials, textures) {
        (model.materials, model.textures) = materials.finish(&buffers, budget, &mut model.report)?;
    }
    model.report.notes.extend(variants(&document));
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

/// What is said of the variants of a file's materials (KHR_materials_variants), of which the default is shown.
fn variants(document: &Document) -> Option<String> {
    let names = document.extension_value("KHR_materials_variants")?.get("variants")?.as_array()?;
    let names: Vec<Option<&str>> = names.iter().map(|variant| variant.get("name").and_then(serde_json::Value::as_str)).collect();
    let (count, known) = (names.len(), label::list(names.into_iter()));
    (count > 0).then(|| format!("the materials have {count} variants ({known}), which are not read; the default ones are shown"))
}

/// What was met and not rendered.
#[derive(Default)]
struct Skipped {
    points_and_lines: usize,
    colors: usize,
    without_joints: usize,
    without_uvs: usize,
    further_targets: usize,
    collapsed: usize,
    without_positions: usize,
}

impl Skipped {
    fn tell(&self, report: &mut LoadReport) {
        for (count, what) in [
            (self.points_and_lines, "primitives of points or lines skipped"),
            (self.without_positions, "primitives without positions skipped"),
            (self.colors, "primitives with vertex colours are unlit and shown without them"),
            (self.without_uvs, "sets of texture coordinates that materials ask for are not there"),
            (self.further_targets, "primitives have morph targets of texture coordinates or colours, which are not read"),
            (self.without_joints, "primitives on nodes with a skin that have no joints, and follow their nodes"),
            (self.collapsed, "nodes skipped because their transform flattens everything"),
        ] {
            if count > 0 {
                report.notes.push(format!("{count} {what}"));
            }
        }
    }
}

/// A mesh of the model with its material.
struct Primitive {
    mesh: Option<usize>,
    material: Option<usize>,
    /// What can move its vertices.
    soft: Option<Soft>,
}

/// A mesh whose vertices can move against each other.
struct Soft {
    mesh: Rc<Mesh>,
    shape: Arc<Shape>,
    targets: usize,
    /// The highest number of a joint, and the attribute it is in; `None` where it has no joints.
    highest: Option<(usize, String)>,
}

struct Reader<'a> {
    path: &'a Path,
    buffers: &'a Buffers<'a>,
    model: Model,
    materials: Option<Materials<'a>>,
    /// Renderable primitives of each mesh read so far.
    meshes: HashMap<usize, Vec<Primitive>>,
    /// Skins read so far; `None` for those that cannot be used.
    skins: HashMap<usize, Option<Rc<Skin>>>,
    /// Place of each node of the scene in the tree, by its number in the file.
    places: HashMap<usize, usize>,
    /// Node to model space of each node in the tree, as the model rests.
    rest: Vec<DAffine3>,
    /// Whether some node gives its morph targets weights.
    weighted: bool,
    /// Primitives, each by the numbers of its mesh and its own, whose morph targets have more than is read.
    further_targets: HashSet<(usize, usize)>,
    skipped: Skipped,
    /// Whether what only an animation needs is read too.
    animated: bool,
}

impl Reader<'_> {
    fn scene(&mut self, document: &Document, tree: &[tree::Node]) -> Result<()> {
        let nodes: Vec<gltf::Node> = document.nodes().collect();
        for node in tree {
            let transform = node.parent.map_or(DAffine3::IDENTITY, |parent| self.rest[parent]) * node.local.affine();
            if !transform.is_finite() {
                return Err(Error::model(self.path, format!("/nodes/{}", node.index), "the transform is not finite"));
            }
            if !node.instance {
                self.places.insert(node.index, self.rest.len());
            }
            self.rest.push(transform);
        }
        let spread: HashSet<usize> = tree.iter().filter(|node| node.instance).map(|node| node.index).collect();
        let shown = tree.iter().enumerate().filter(|(_, node)| node.instance || !spread.contains(&node.index));
        for (place, node) in shown {
            self.node(&nodes[node.index], place)?;
        }
        Ok(())
    }

    /// The meshes of a node at `place` in the tree.
    fn node(&mut self, node: &gltf::Node, place: usize) -> Result<()> {
        let Some(mesh) = node.mesh() else { return Ok(()) };
        let transform = self.rest[place];
        let skin = match node.skin() {
            None => None,
            Some(skin) => match self.skins.get(&skin.index()) {
                Some(known) => known.clone(),
                None => {
                    let read = self.skin(&skin)?.map(Rc::new);
                    self.skins.insert(skin.index(), read.clone());
                    read
                }
            },
        };
        let flat = !self.animated && !super::invertible(super::relative(transform, transform.translation));
        if flat && skin.is_none() {
            self.skipped.collapsed += 1;
            return Ok(());
        }
        // Taken out while its primitives are placed.
        let mut primitives = match self.meshes.remove(&mesh.index()) {
            Some(known) => known,
            None => self.mesh(&mesh)?,
        };
        if self.model.parts.len() + primitives.len() > MOST_PARTS {
            return Err(Error::model(self.path, format!("/nodes/{}", node.index()), format!("more than {MOST_PARTS} parts")));
        }
        let name = node.name().or(mesh.name()).map_or_else(|| format!("node {}", node.index()), str::to_owned);
        for primitive in &mut primitives {
            let part = Part { name: name.clone(), mesh: 0, material: primitive.material, transform, node: place, deformer: None };
            let deformed = match &primitive.soft {
                Some(soft) => self.deformed(node, &mesh, soft, skin.as_ref(), &part)?,
                None => None,
            };
            let jointed = primitive.soft.as_ref().is_some_and(|soft| soft.highest.is_some());
            self.skipped.without_joints += usize::from(skin.is_some() && !jointed);
            let part = deformed.unwrap_or_else(|| {
                let mesh = *primitive.mesh.get_or_insert_with(|| {
                    self.model.meshes.extend(primitive.soft.as_ref().map(|soft| Mesh::clone(&soft.mesh)));
                    self.model.meshes.len() - 1
                });
                Part { mesh, ..part }
            });
            self.model.parts.push(part);
        }
        self.meshes.insert(mesh.index(), primitives);
        Ok(())
    }

    /// The part of a node whose vertices a skin or morph targets move; `None` where nothing moves them.
    fn deformed(
        &mut self,
        node: &gltf::Node,
        mesh: &gltf::Mesh,
        soft: &Soft,
        skin: Option<&Rc<Skin>>,
        part: &Part,
    ) -> Result<Option<Part>> {
        let skin = skin.filter(|_| soft.highest.is_some()).cloned();
        let weights = morph::at_rest(self, node, mesh, soft.targets)?;
        if skin.is_none() && !(soft.targets > 0 && self.animated) && weights.iter().all(|&weight| weight == 0.0) {
            return Ok(None);
        }
        if let (Some(skin), Some((highest, place))) = (&skin, &soft.highest)
            && *highest >= skin.joints()
        {
            let reason = format!("joint {highest} does not exist, there are {}", skin.joints());
            return Err(Error::model(self.path, place, reason));
        }
        let place = format!("/nodes/{}", node.index());
        let base = if skin.as_ref().is_some_and(|skin| skin.mirrors) {
            Rc::new(mesh::mirrored(&soft.mesh))
        } else {
            Rc::clone(&soft.mesh)
        };
        let vertex = size_of::<Vec3>() * 2 + size_of::<Vec4>() + size_of::<Vec2>();
        self.buffers.spend(vertex, base.positions.len(), &place, "posed again and again")?;
        self.buffers.spend(size_of::<[u32; 3]>(), base.triangles.len(), &place, "posed again and again")?;
        let transform = skin.as_ref().map_or(part.transform, |skin| DAffine3::from_translation(skin.origin));
        // Without its skin a shape moves by its targets alone.
        let deformer = Deformer { base, shape: Arc::clone(&soft.shape), skin, weights: weights.clone() };
        self.model.meshes.push(deformer.still(deformer.posed(&self.rest, weights)));
        let deformer = self.animated.then(|| Rc::new(deformer));
        let (name, mesh) = (part.name.clone(), self.model.meshes.len() - 1);
        Ok(Some(Part { name, mesh, transform, deformer, ..*part }))
    }

    fn mesh(&mut self, mesh: &gltf::Mesh) -> Result<Vec<Primitive>> {
        let mut result = vec![];
        for primitive in mesh.primitives() {
            if let Some(read) = self.primitive(mesh, &primitive)? {
                let soft = self.soft(mesh, &primitive, read)?;
                let material = match &mut self.materials {
                    Some(materials) => Some(materials.index(&primitive.material(), &mut self.model.report)),
                    None => None,
                };
                result.push(match soft {
                    Err(rigid) => {
                        self.model.meshes.push(rigid);
                        Primitive { mesh: Some(self.model.meshes.len() - 1), material, soft: None }
                    }
                    Ok(soft) => Primitive { mesh: None, material, soft: Some(soft) },
                });
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
        let buffers = self.buffers;
        let positions = buffers.floats::<3>(&accessor, &format!("{place}/attributes/POSITION"))?;
        let triangles = match (buffers.decompressed(mesh.index(), primitive.index()), primitive.indices()) {
            (Some(decompressed), _) => decompressed.to_vec(),
            (None, Some(accessor)) => triangles(primitive.mode(), &buffers.indices(&accessor, &format!("{place}/indices"))?),
            (None, None) => triangles(primitive.mode(), &(0..positions.len() as u32).collect::<Vec<u32>>()),
        };
        let sets = self.materials.as_ref().map_or_else(|| vec![0], |m| m.texture_sets(&primitive.material()));
        let vertices = positions.len();
        let uvs = |&set: &u32| self.attribute::<2, Vec2>(primitive, Semantic::TexCoords(set), vertices, &place);
        let more_uvs = sets[1..].iter().map(uvs).collect::<Result<Vec<Vec<Vec2>>>>()?;
        let missing = more_uvs.iter().filter(|uvs| uvs.is_empty()).count();
        let mesh_uvs = uvs(&sets[0])?;
        self.skipped.without_uvs += missing;
        let colors = if self.materials.is_some() { self.colors(primitive, vertices, &place)? } else { vec![] };
        Ok(Some(Mesh {
            name: mesh.name().map_or_else(|| format!("mesh {}", mesh.index()), str::to_owned),
            normals: self.attribute::<3, Vec3>(primitive, Semantic::Normals, vertices, &place)?,
            tangents: self.attribute::<4, Vec4>(primitive, Semantic::Tangents, vertices, &place)?,
            uvs: mesh_uvs,
            more_uvs,
            colors,
            positions: positions.into_iter().map(Vec3::from).collect(),
            triangles,
            ..Mesh::default()
        }))
    }

    /// What can move the vertices of a primitive that was read; `None` where nothing can.
    fn soft(&mut self, mesh: &gltf::Mesh, primitive: &gltf::Primitive, read: Mesh) -> Result<std::result::Result<Soft, Mesh>> {
        let place = format!("/meshes/{}/primitives/{}", mesh.index(), primitive.index());
        let vertices = read.positions.len();
        let followed = self.followed(primitive, vertices, &place)?;
        // Targets that no weight ever asks for are not read.
        let asked = self.animated || self.weighted || mesh.weights().is_some_and(morph::some);
        let targets = if asked { primitive.morph_targets().count() } else { 0 };
        if followed.is_none() && targets == 0 {
            return Ok(Err(read));
        }
        let further = targets > 0 && self.further_targets.contains(&(mesh.index(), primitive.index()));
        self.skipped.further_targets += usize::from(further);
        let displacements = if targets > 0 { self.displacements(primitive, vertices, &place)? } else { Rows::default() };
        let (influences, highest) = followed.map_or_else(Default::default, |Followed { rows, highest }| (rows, Some(highest)));
        let shape = Arc::new(Shape { displacements, influences });
        Ok(Ok(Soft { mesh: Rc::new(read), shape, targets, highest }))
    }

    /// Colours of the vertices, with an opacity of 1 where they have none; empty where there are none. What emits its base colour
    /// ([unlit](https://github.com/KhronosGroup/glTF/tree/main/extensions/2.0/Khronos/KHR_materials_unlit)) does so without them.
    fn colors(&mut self, primitive: &gltf::Primitive, vertices: usize, place: &str) -> Result<Vec<Vec4>> {
        let Some(accessor) = primitive.get(&Semantic::Colors(0)) else { return Ok(vec![]) };
        if primitive.material().extension_value("KHR_materials_unlit").is_some() {
            self.skipped.colors += 1;
            return Ok(vec![]);
        }
        if accessor.dimensions() == gltf::accessor::Dimensions::Vec3 {
            let colors = self.attribute::<3, Vec3>(primitive, Semantic::Colors(0), vertices, place)?;
            return Ok(colors.into_iter().map(|color| color.extend(1.0)).collect());
        }
        self.attribute(primitive, Semantic::Colors(0), vertices, place)
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
