//! The nodes of the file's scene.

use super::access::Buffers;
use crate::error::{Error, Result};
use glam::{DAffine3, DMat3, DMat4, DQuat, DVec3, DVec4};
use gltf::Document;
use gltf::scene::Transform;
use std::path::Path;

/// The extension by which a node shows its mesh at many places.
pub(super) const INSTANCING: &str = "EXT_mesh_gpu_instancing";

/// Most places at which the nodes of a file may show their meshes.
const MOST_INSTANCES: usize = 1 << 20;

/// A node of the tree.
pub(super) struct Node {
    /// Its number in the file.
    pub index: usize,
    /// Place of its parent in the list of nodes, always an earlier one.
    pub parent: Option<usize>,
    pub local: Local,
    /// Whether it stands for one of several places at which its parent shows its mesh (EXT_mesh_gpu_instancing).
    pub instance: bool,
}

/// Node to parent, in double precision: trees of many nodes may go far out and come back.
#[derive(Clone, Copy)]
pub(super) enum Local {
    Matrix(DAffine3),
    Parts(Parts),
}

#[derive(Clone, Copy)]
pub(super) struct Parts {
    pub translation: DVec3,
    /// Of any length.
    pub rotation: DVec4,
    pub scale: DVec3,
}

impl Local {
    pub(super) fn affine(&self) -> DAffine3 {
        match self {
            Self::Matrix(matrix) => *matrix,
            Self::Parts(parts) => parts.affine(),
        }
    }
}

impl Parts {
    /// Quaternions are normalised; one of zero length turns nothing.
    pub(super) fn affine(&self) -> DAffine3 {
        let turn = self.rotation.try_normalize().map_or(DQuat::IDENTITY, DQuat::from_vec4);
        let matrix3 = DMat3::from_quat(turn) * DMat3::from_diagonal(self.scale);
        DAffine3 { matrix3, translation: self.translation }
    }
}

fn local(node: &gltf::Node) -> Local {
    match node.transform() {
        Transform::Matrix { matrix } => {
            Local::Matrix(DAffine3::from_mat4(DMat4::from_cols_array_2d(&matrix.map(|column| column.map(f64::from)))))
        }
        Transform::Decomposed { translation, rotation, scale } => Local::Parts(Parts {
            translation: DVec3::from(translation.map(f64::from)),
            rotation: DVec4::from(rotation.map(f64::from)),
            scale: DVec3::from(scale.map(f64::from)),
        }),
    }
}

/// The nodes of the default scene, else of the first one, else every node; each after its parent.
pub(super) fn nodes(path: &Path, document: &Document) -> Result<Vec<Node>> {
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
    let mut stack: Vec<(usize, Option<usize>)> = roots.into_iter().rev().map(|i| (i, None)).collect();
    let mut found = Vec::new();
    while let Some((index, parent)) = stack.pop() {
        if std::mem::replace(&mut visited[index], true) {
            let reason = "the node has two parents, or is its own ancestor";
            return Err(Error::model(path, format!("/nodes/{index}"), reason));
        }
        let node = &nodes[index];
        let place = found.len();
        found.push(Node { index, parent, local: local(node), instance: false });
        let children: Vec<usize> = node.children().map(|c| c.index()).collect();
        stack.extend(children.into_iter().rev().map(|c| (c, Some(place))));
    }
    Ok(found)
}

/// Adds, behind `nodes`, one for each place at which a node shows its mesh by [`INSTANCING`]. Skins go before it: they say where
/// all vertices are.
pub(super) fn add_instances(path: &Path, document: &Document, buffers: &Buffers, nodes: &mut Vec<Node>) -> Result<()> {
    let all: Vec<gltf::Node> = document.nodes().collect();
    for parent in 0..nodes.len() {
        let index = nodes[parent].index;
        let Some(extension) = all[index].extension_value(INSTANCING) else { continue };
        if all[index].mesh().is_none() || all[index].skin().is_some() {
            continue;
        }
        let here = format!("/nodes/{index}/extensions/{INSTANCING}/attributes");
        let accessor = |name: &str| -> Result<Option<gltf::Accessor>> {
            let Some(number) = extension.get("attributes").and_then(|attributes| attributes.get(name)) else { return Ok(None) };
            let found = number.as_u64().and_then(|number| document.accessors().nth(usize::try_from(number).ok()?));
            found.map(Some).ok_or_else(|| Error::model(path, format!("{here}/{name}"), format!("there is no accessor {number}")))
        };
        let names = ["TRANSLATION", "ROTATION", "SCALE"];
        let [translation, rotation, scale] = [accessor(names[0])?, accessor(names[1])?, accessor(names[2])?];
        let counts: Vec<usize> = [&translation, &rotation, &scale].into_iter().flatten().map(gltf::Accessor::count).collect();
        let Some(&count) = counts.first() else { continue };
        if counts.iter().any(|other| *other != count) {
            return Err(Error::model(path, here, "translations, rotations and scales differ in number"));
        }
        if nodes.len().saturating_add(count) > MOST_INSTANCES {
            return Err(Error::model(path, here, format!("more than {MOST_INSTANCES} nodes and instances")));
        }
        let three = |accessor: Option<gltf::Accessor>, name: &str, otherwise: f32| match accessor {
            Some(accessor) => buffers.floats::<3>(&accessor, &format!("{here}/{name}")),
            None => Ok(vec![[otherwise; 3]; count]),
        };
        let (translations, scales) = (three(translation, names[0], 0.0)?, three(scale, names[2], 1.0)?);
        let rotations = match rotation {
            Some(accessor) => buffers.floats::<4>(&accessor, &format!("{here}/{}", names[1]))?,
            None => vec![[0.0, 0.0, 0.0, 1.0]; count],
        };
        for ((translation, rotation), scale) in translations.into_iter().zip(rotations).zip(scales) {
            let local = Local::Parts(Parts {
                translation: DVec3::from(translation.map(f64::from)),
                rotation: DVec4::from(rotation.map(f64::from)),
                scale: DVec3::from(scale.map(f64::from)),
            });
            nodes.push(Node { index, parent: Some(parent), local, instance: true });
        }
    }
    Ok(())
}
