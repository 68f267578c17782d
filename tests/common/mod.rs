//! Runs the program as a user does.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// Runs `renderflow` with `args`.
pub fn renderflow(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_renderflow"))
        .args(args)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .expect("the program starts")
}

/// Standard error as text.
#[allow(dead_code)]
pub fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Runs `renderflow` and expects success.
#[allow(dead_code)]
pub fn succeed(args: &[&str]) -> String {
    let output = renderflow(args);
    assert!(output.status.success(), "renderflow {args:?}: {}", stderr(&output));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// Every file below `folder` with its bytes, by relative name.
#[allow(dead_code)]
pub fn files(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let mut found = Vec::new();
    let mut open: Vec<PathBuf> = vec![folder.to_owned()];
    while let Some(folder_now) = open.pop() {
        for entry in std::fs::read_dir(&folder_now).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path);
            } else {
                let name = path.strip_prefix(folder).unwrap().to_string_lossy().into_owned();
                found.push((name, std::fs::read(&path).unwrap()));
            }
        }
    }
    found.sort();
    found
}

/// Writes a 16x8 float OpenEXR map of grey values.
#[allow(dead_code)]
pub fn write_map(path: &Path, value: impl Fn(usize, usize) -> f32 + Sync) {
    exr::prelude::write_rgb_file(path, 16, 8, |x, y| (value(x, y), value(x, y), value(x, y))).unwrap();
}

/// Runs `renderflow`, expects failure, and returns what it said.
#[allow(dead_code)]
pub fn fail(args: &[&str]) -> String {
    let output = renderflow(args);
    assert_eq!(output.status.code(), Some(1), "renderflow {args:?}: {}", stderr(&output));
    stderr(&output)
}

/// Writes options of a small network for steps of moments on frames of 32 x 32.
#[allow(dead_code)]
pub fn write_training(path: &Path, steps: u64) {
    let printed = succeed(&["train", "--data", "nothing", "--out", "nothing", "--print-config"]);
    let mut options: serde_json::Value = serde_json::from_str(&printed).unwrap();
    options["training"]["crops"] = serde_json::json!([{ "size": 32, "batch": 1, "from": 0.0 }]);
    options["training"]["steps"] = steps.into();
    options["training"]["network"]["widths"] = serde_json::json!([16, 16, 16, 16]);
    options["training"]["first"] = 2.into();
    options["training"]["window"] = 2.into();
    options["recipe"]["frames"] = 1.into();
    std::fs::write(path, options.to_string()).unwrap();
}

/// Copies a folder with all that is in it.
#[allow(dead_code)]
pub fn copy(from: &Path, to: &Path) {
    for (name, bytes) in files(from) {
        let path = to.join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }
}
