//! The configuration inside a checkpoint, for checkpoints of older programs.

use serde_json::{Map, Value};
use std::path::Path;

/// Changes the configuration that a checkpoint holds, and leaves its tensors as they are.
pub fn edit_configuration(output: &Path, change: impl FnOnce(&mut Map<String, Value>)) {
    let path = output.join("checkpoint.safetensors");
    let file = std::fs::read(&path).expect("a checkpoint");
    let (length, rest) = file.split_at(8);
    let (header, tensors) = rest.split_at(u64::from_le_bytes(length.try_into().expect("8 bytes")) as usize);
    let mut header: Value = serde_json::from_slice(header).expect("a header");
    let text = &mut header["__metadata__"]["renderflow"];
    let mut ours: Value = serde_json::from_str(text.as_str().expect("our header")).expect("JSON");
    change(ours["config"].as_object_mut().expect("a configuration"));
    *text = ours.to_string().into();
    let mut header = header.to_string();
    header.push_str(&" ".repeat(header.len().next_multiple_of(8) - header.len()));
    std::fs::write(&path, [&(header.len() as u64).to_le_bytes(), header.as_bytes(), tensors].concat()).expect("written");
}
