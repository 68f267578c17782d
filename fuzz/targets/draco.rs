//! A mesh that is compressed with Draco, in a glTF file whose binary chunk it is.
#![no_main]

use libfuzzer_sys::fuzz_target;
use renderflow_fuzz::{catch_in_readers, check_scene, folder, names_file, put, scenes, watch};
use std::path::PathBuf;
use std::sync::LazyLock;

static FOLDER: LazyLock<PathBuf> = LazyLock::new(folder);

/// A file whose attributes have the numbers that common encoders give them, read as floats, and colours as bytes.
fn document(length: usize) -> String {
    format!(
        r#"{{"asset": {{"version": "2.0"}}, "buffers": [{{"byteLength": {length}}}],
            "bufferViews": [{{"buffer": 0, "byteLength": {length}}}],
            "accessors": [{{"componentType": 5126, "type": "VEC3", "count": 3}}, {{"componentType": 5126, "type": "VEC3", "count": 3}},
                {{"componentType": 5126, "type": "VEC2", "count": 3}}, {{"componentType": 5121, "type": "VEC3", "count": 3, "normalized": true}}],
            "meshes": [{{"primitives": [{{"attributes": {{"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2, "COLOR_0": 3}},
                "extensions": {{"KHR_draco_mesh_compression": {{"bufferView": 0,
                    "attributes": {{"POSITION": 3, "NORMAL": 2, "TEXCOORD_0": 1, "COLOR_0": 0}}}}}}}}]}}],
            "nodes": [{{"mesh": 0}}], "scenes": [{{"nodes": [0]}}], "scene": 0}}"#
    )
}

fuzz_target!(
    init: catch_in_readers(),
    |bytes: &[u8]| watch(|| {
        put(&FOLDER.join("input.glb"), &scenes::binary(document(bytes.len().max(1)).as_bytes(), bytes));
        match scenes::model(&FOLDER, "input.glb") {
            Ok(scene) => check_scene(&scene),
            Err(error) => names_file(error, &["input.glb"]),
        }
    })
);
