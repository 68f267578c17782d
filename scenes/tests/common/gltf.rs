//! Small glTF files written by the tests.

use super::model_scene;
use base64::Engine;
use renderflow_frame::reach::Reach;
use renderflow_scenes::{LoadedScene, Result, load};
use serde_json::{Value, json};
use std::path::PathBuf;

pub fn data_uri(kind: &str, bytes: &[u8]) -> String {
    format!("data:{kind};base64,{}", base64::engine::general_purpose::STANDARD.encode(bytes))
}

pub fn bytes(numbers: &[f32]) -> Vec<u8> {
    numbers.iter().flat_map(|v| v.to_le_bytes()).collect()
}

/// A folder with `model.gltf` in it; the folder lives as long as the value.
pub struct File(tempfile::TempDir);

impl File {
    pub fn new(document: &Value) -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("model.gltf"), document.to_string()).unwrap();
        Self(folder)
    }

    pub fn path(&self) -> PathBuf {
        self.0.path().join("model.gltf")
    }

    pub fn load(&self) -> Result<LoadedScene> {
        load::load(&model_scene(&self.path(), None), &Reach::of(&self.path()))
    }

    /// What loading says, without the folder's name.
    pub fn error(&self) -> String {
        let message = self.load().expect_err("must be refused").to_string();
        message.replace(self.0.path().to_str().unwrap(), "FOLDER")
    }
}

/// A document with one buffer; each view is one accessor: (component type, type, count, normalised, bytes).
pub fn document(accessors: &[(u32, &str, usize, bool, Vec<u8>)]) -> Value {
    let mut buffer = vec![];
    let (mut views, mut entries) = (vec![], vec![]);
    for (component, kind, count, normalized, data) in accessors {
        buffer.resize(buffer.len().next_multiple_of(4), 0);
        views.push(json!({ "buffer": 0, "byteOffset": buffer.len(), "byteLength": data.len() }));
        let view = views.len() - 1;
        entries.push(
            json!({ "bufferView": view, "componentType": component, "type": kind, "count": count, "normalized": normalized }),
        );
        buffer.extend_from_slice(data);
    }
    json!({
        "asset": { "version": "2.0" },
        "buffers": [{ "byteLength": buffer.len(), "uri": data_uri("application/octet-stream", &buffer) }],
        "bufferViews": views,
        "accessors": entries,
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 } }] }],
        "nodes": [{ "mesh": 0 }],
        "scenes": [{ "nodes": [0] }],
        "scene": 0,
    })
}

/// Corners of the unit square in the plane z = 0, in the order of a strip.
pub const STRIP: [f32; 12] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0];
pub const FLOAT: u32 = 5126;

/// The unit square, two triangles.
pub fn square() -> Value {
    let mut file = document(&[(FLOAT, "VEC3", 4, false, bytes(&STRIP)), (FLOAT, "VEC2", 4, false, bytes(&[0.5; 8]))]);
    file["meshes"][0]["primitives"][0]["mode"] = json!(5);
    file
}

/// PNG of one row of RGBA pixels, as a data URI.
pub fn png(pixels: &[[u8; 4]]) -> String {
    let picture = image::RgbaImage::from_raw(pixels.len() as u32, 1, pixels.as_flattened().to_vec()).unwrap();
    let mut out = std::io::Cursor::new(vec![]);
    picture.write_to(&mut out, image::ImageFormat::Png).unwrap();
    data_uri("image/png", &out.into_inner())
}
