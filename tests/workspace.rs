//! The chain of crates is one-way: frame <- scenes <- renderer, frame <- model. The root knows them all, and only what measures
//! knows the root.

use std::collections::BTreeMap;
use std::process::Command;

#[test]
fn dependencies_point_one_way() {
    let output = Command::new(env!("CARGO"))
        .args(["metadata", "--format-version", "1", "--no-deps", "--offline"])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .expect("cargo metadata runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let metadata: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let mut edges: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for package in metadata["packages"].as_array().unwrap() {
        let dependencies = package["dependencies"].as_array().unwrap().iter();
        let ours = dependencies.filter_map(|d| d["name"].as_str()).filter(|name| name.starts_with("renderflow"));
        let mut ours: Vec<String> = ours.map(str::to_owned).collect();
        ours.sort();
        ours.dedup();
        edges.insert(package["name"].as_str().unwrap().to_owned(), ours);
    }
    let allowed: &[(&str, &[&str])] = &[
        ("renderflow", &["renderflow-frame", "renderflow-model", "renderflow-renderer", "renderflow-scenes"]),
        ("renderflow-bench", &["renderflow", "renderflow-frame", "renderflow-model", "renderflow-renderer", "renderflow-scenes"]),
        ("renderflow-frame", &[]),
        ("renderflow-model", &["renderflow-frame"]),
        ("renderflow-renderer", &["renderflow-frame", "renderflow-scenes"]),
        ("renderflow-scenes", &["renderflow-frame"]),
    ];
    assert_eq!(edges.len(), allowed.len(), "a crate is missing here: {:?}", edges.keys());
    for (name, may_use) in allowed {
        let used = &edges[*name];
        assert!(used.iter().all(|d| may_use.contains(&d.as_str())), "{name} uses {used:?}, may use {may_use:?}");
    }
}
