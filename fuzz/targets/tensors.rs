//! Published weights: a safetensors file, one with its index (both before a NUL each), or PyTorch's archive, by what the input
//! begins with.
#![no_main]

use libfuzzer_sys::fuzz_target;
use renderflow_fuzz::{catch_in_readers, folder, names_file, put, watch};
use renderflow_model::wan::weights::{Source, identify};
use std::path::PathBuf;
use std::sync::LazyLock;

static FOLDER: LazyLock<PathBuf> = LazyLock::new(folder);
const NAMES: [&str; 3] = ["model.safetensors.index.json", "model.safetensors", "model.pth"];

fuzz_target!(
    init: catch_in_readers(),
    |bytes: &[u8]| watch(|| {
        let name = match bytes {
            [b'{', ..] => NAMES[0],
            [b'P', b'K', ..] | [0x80, ..] => NAMES[2],
            _ => NAMES[1],
        };
        if name == NAMES[0] {
            let end = bytes.iter().position(|&byte| byte == 0).unwrap_or(bytes.len());
            put(&FOLDER.join(NAMES[0]), &bytes[..end]);
            put(&FOLDER.join(NAMES[1]), &file(bytes.get(end + 1..).unwrap_or_default()));
        } else {
            put(&FOLDER.join(name), bytes);
        }
        match Source::open(&FOLDER.join(name)) {
            Ok(source) => check(&source),
            Err(error) => names_file(error, &NAMES),
        }
    })
);

/// The text before the first NUL as the list of tensors of a safetensors file, the rest as their bytes.
fn file(bytes: &[u8]) -> Vec<u8> {
    let end = bytes.iter().position(|&byte| byte == 0).unwrap_or(bytes.len());
    let length = (end as u64).to_le_bytes();
    [&length, &bytes[..end], bytes.get(end + 1..).unwrap_or_default()].concat()
}

fn check(source: &Source) {
    let table = source.table();
    assert_eq!(table.rows.len(), source.names().count());
    assert!(!table.to_string().is_empty());
    for row in &table.rows {
        match source.read(&row.name) {
            Ok(values) => {
                assert_eq!(values.len() as u64, row.parameters, "{}", row.name);
                assert!(values.iter().all(|v| v.is_finite()));
            }
            Err(error) => names_file(error, &NAMES),
        }
    }
    if let Err(error) = identify(source) {
        names_file(error, &NAMES);
    }
}
