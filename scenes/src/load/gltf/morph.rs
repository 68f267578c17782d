//! Morph targets of a glTF file (glTF 2.0, section 3.7.2.2).

use super::Reader;
use crate::error::{Error, Result};
use crate::loaded::{Displacement, Rows};
use glam::Vec3;

impl Reader<'_> {
    /// What the morph targets of a primitive add to its vertices. Only what is not zero is kept.
    pub(super) fn displacements(
        &mut self,
        primitive: &gltf::Primitive,
        vertices: usize,
        place: &str,
    ) -> Result<Rows<Displacement>> {
        let mut found: Vec<(u32, Displacement)> = Vec::new();
        for (target, morph) in primitive.morph_targets().enumerate() {
            let read = |accessor: Option<gltf::Accessor>, name: &str| -> Result<Vec<[f32; 3]>> {
                let Some(accessor) = accessor else { return Ok(vec![]) };
                let place = format!("{place}/targets/{target}/{name}");
                let values = self.buffers.floats::<3>(&accessor, &place)?;
                if values.len() != vertices {
                    return Err(Error::model(self.path, place, format!("{} values for {vertices} positions", values.len())));
                }
                Ok(values)
            };
            let [positions, normals, tangents] =
                [read(morph.positions(), "POSITION")?, read(morph.normals(), "NORMAL")?, read(morph.tangents(), "TANGENT")?];
            if [&positions, &normals, &tangents].iter().all(|list| list.is_empty()) {
                continue;
            }
            for vertex in 0..vertices {
                let [position, normal, tangent] =
                    [&positions, &normals, &tangents].map(|list| list.get(vertex).map_or(Vec3::ZERO, |&v| Vec3::from(v)));
                if [position, normal, tangent] != [Vec3::ZERO; 3] {
                    found.push((vertex as u32, Displacement { target: target as u32, position, normal, tangent }));
                }
            }
        }
        Ok(Rows::new(vertices, &found))
    }
}

/// The weights of the morph targets of a node as it rests: its own, or else those of its mesh, or else zeros.
pub(super) fn at_rest(reader: &Reader, node: &gltf::Node, mesh: &gltf::Mesh, targets: usize) -> Result<Vec<f32>> {
    let (given, place) = match (node.weights(), mesh.weights()) {
        (Some(own), _) => (own, format!("/nodes/{}/weights", node.index())),
        (None, Some(common)) => (common, format!("/meshes/{}/weights", mesh.index())),
        (None, None) => (&[][..], String::new()),
    };
    if let Some(at) = given.iter().position(|weight| !weight.is_finite()) {
        return Err(Error::model(reader.path, place, format!("weight {at} is not finite")));
    }
    let mut weights = given.to_vec();
    weights.resize(targets, 0.0);
    Ok(weights)
}

/// Whether some weight is not zero.
pub(super) fn some(weights: &[f32]) -> bool {
    weights.iter().any(|&weight| weight != 0.0)
}
