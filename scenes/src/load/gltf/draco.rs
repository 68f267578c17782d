//! Meshes that are compressed with Draco (KHR_draco_mesh_compression): they are decompressed once, and then stand for the
//! accessors that their primitives name.

use super::access::Buffers;
use crate::error::{Error, Result};
use draco_core::{DecodeLimits, DecoderBuffer, Mesh, MeshDecoder};
use gltf::Document;
use gltf::accessor::{Accessor, DataType};
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::path::Path;

/// Name of the extension.
pub(super) const NAME: &str = "KHR_draco_mesh_compression";

/// Bytes that all meshes of a file may decompress to, beside [`RATIO`] times those of its buffers: a constant attribute takes no
/// bytes for any number of vertices, so a kilobyte could fill any memory.
const ALLOWANCE: u64 = 64 << 20;
/// Bytes that a byte of a buffer may become on average.
const RATIO: u64 = 512;
/// Bytes of a triangle's indices.
const TRIANGLE: u64 = size_of::<[u32; 3]>() as u64;

/// What the compressed primitives of a file hold.
#[derive(Default)]
pub(super) struct Decompressed {
    /// Elements of accessors without gaps, in the accessor's own type.
    pub values: HashMap<usize, Vec<u8>>,
    /// Triangles of primitives, by the numbers of mesh and primitive.
    pub triangles: HashMap<(usize, usize), Vec<[u32; 3]>>,
}

impl Decompressed {
    /// Bytes of all values.
    pub(super) fn bytes(&self) -> usize {
        self.values.values().map(Vec::len).sum()
    }
}

/// Decompresses every primitive of `document` that is compressed.
pub(super) fn decompress(path: &Path, document: &Document, buffers: &Buffers) -> Result<Decompressed> {
    let mut found = Decompressed::default();
    // Primitives may share a buffer view.
    let mut meshes: HashMap<usize, Mesh> = HashMap::new();
    let mut left = ALLOWANCE.saturating_add(RATIO.saturating_mul(buffers.bytes() as u64));
    let primitives = document.meshes().flat_map(|mesh| mesh.primitives().map(move |primitive| (mesh.index(), primitive)));
    for (mesh, primitive) in primitives {
        let Some(extension) = primitive.extension_value(NAME) else { continue };
        let place = format!("/meshes/{mesh}/primitives/{}/extensions/{NAME}", primitive.index());
        let fail = |at: &str, reason: String| Error::model(path, format!("{place}{at}"), reason);
        let view = extension.get("bufferView").and_then(serde_json::Value::as_u64);
        let view = view.and_then(|view| document.views().nth(usize::try_from(view).ok()?));
        let view = view.ok_or_else(|| fail("/bufferView", "the buffer view does not exist".into()))?;
        let mut again = false;
        let decoded = match meshes.entry(view.index()) {
            Entry::Occupied(known) => {
                again = true;
                known.into_mut()
            }
            Entry::Vacant(free) => {
                let decoded = decode(buffers.view(&view)?, left).map_err(|reason| fail("", reason))?;
                left = left.saturating_sub(bytes(&decoded));
                free.insert(decoded)
            }
        };
        let points = decoded.num_points();
        let ids = extension.get("attributes").and_then(serde_json::Value::as_object);
        for (semantic, accessor) in primitive.attributes() {
            let name = semantic.to_string();
            let Some(id) = ids.and_then(|ids| ids.get(&name)) else { continue };
            let attribute = id.as_u64().and_then(|id| decoded.attribute_by_unique_id(u32::try_from(id).ok()?));
            let Some(attribute) = attribute else {
                return Err(fail(&format!("/attributes/{name}"), format!("the compressed mesh has no attribute {id}")));
            };
            left = left.checked_sub((accessor.size() * points) as u64).ok_or_else(|| fail("", TOO_LARGE.into()))?;
            let values = attribute.read_f32s(points, accessor.dimensions().multiplicity());
            found.values.insert(accessor.index(), packed(&accessor, &values));
        }
        if again {
            let copied = TRIANGLE * decoded.num_faces() as u64;
            left = left.checked_sub(copied).ok_or_else(|| fail("", TOO_LARGE.into()))?;
        }
        let triangles = decoded.faces().iter().map(|face| face.map(|point| point.0));
        found.triangles.insert((mesh, primitive.index()), triangles.collect());
    }
    Ok(found)
}

const TOO_LARGE: &str = "decompresses to far more than its file holds";

/// The mesh in `bytes`, which may take `left` bytes; the error says what is wrong, in words.
fn decode(bytes: &[u8], left: u64) -> std::result::Result<Mesh, String> {
    let triangles = left / TRIANGLE;
    let limits = DecodeLimits::default().with_max_points(triangles).with_max_faces(triangles).with_max_decoded_bytes(left);
    let mut mesh = Mesh::new();
    match MeshDecoder::new().decode(&mut DecoderBuffer::new(bytes).with_limits(limits), &mut mesh) {
        Ok(()) => Ok(mesh),
        Err(error) if error.kind() == draco_core::ErrorKind::LimitExceeded => Err(TOO_LARGE.into()),
        Err(error) => Err(format!("cannot be decompressed: {error}")),
    }
}

/// Bytes that a mesh takes.
fn bytes(mesh: &Mesh) -> u64 {
    let values = (0..mesh.num_attributes()).map(|id| mesh.attribute(id).buffer().data().len() as u64);
    values.sum::<u64>() + TRIANGLE * mesh.num_faces() as u64
}

/// Numbers in the type of `accessor`.
fn packed(accessor: &Accessor, values: &[f32]) -> Vec<u8> {
    let mut packed = Vec::with_capacity(values.len() * accessor.data_type().size());
    for &value in values {
        match accessor.data_type() {
            DataType::F32 => packed.extend(value.to_le_bytes()),
            DataType::I8 => packed.extend((value as i8).to_le_bytes()),
            DataType::U8 => packed.push(value as u8),
            DataType::I16 => packed.extend((value as i16).to_le_bytes()),
            DataType::U16 => packed.extend((value as u16).to_le_bytes()),
            DataType::U32 => packed.extend((value as u32).to_le_bytes()),
        }
    }
    packed
}
