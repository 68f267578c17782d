//! Shards and exports of folders that have no plan, such as the renders of a scene or of a model.

mod common;

use common::{copy, files, renderflow, stderr, succeed};
use serde_json::{Value, json};
use std::path::Path;

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Renders a small frame of a composed scene into the folder `out`.
fn render(out: &Path, seed: &str, more: &[&str]) {
    let small = ["--frames", "1", "--resolution", "24x16", "--spp", "1", "--denoise", "none", "--no-sheet"];
    succeed(&[&["render", "--seed", seed, "-o", text(out)][..], &small, more].concat());
}

/// Packs a folder, and returns the description of its first frame.
fn packed(data: &Path, out: &Path) -> Value {
    succeed(&["dataset", "pack", text(data), "--out", text(out)]);
    let mut archive = tar::Archive::new(std::fs::File::open(out.join("train-000000.tar")).unwrap());
    for entry in archive.entries().unwrap() {
        let entry = entry.unwrap();
        if entry.path().unwrap().to_str().unwrap().ends_with(".json") {
            return serde_json::from_reader(entry).unwrap();
        }
    }
    panic!("no description");
}

#[test]
fn shards_tell_the_lens_and_what_moves_in_an_unknown_way() {
    let folder = tempfile::tempdir().unwrap();
    let [capture, straight, bent] = ["capture.json", "straight", "bent"].map(|name| folder.path().join(name));
    render(&straight, "5", &[]);
    let camera = packed(&straight, &folder.path().join("straight-shards"))["camera"].clone();
    assert!(camera["camera_model"] == "PINHOLE" && camera.get("k1").is_none(), "{camera}");

    let cameras = json!({ "camera_model": "OPENCV", "w": 48, "h": 32, "fl_x": 40, "fl_y": 40, "cx": 24, "cy": 16, "k1": 0.1,
        "frames": [{ "file_path": "a.png", "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 1], [0, 0, 1, 4], [0, 0, 0, 1]] }] });
    std::fs::write(&capture, cameras.to_string()).unwrap();
    render(&bent, "5", &["--cameras", text(&capture)]);
    // As for a model whose parts move against each other.
    let path = bent.join("transforms.json");
    let mut transforms: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    transforms["object_transforms"] = json!({ "1": [] });
    std::fs::write(&path, transforms.to_string()).unwrap();
    let about = packed(&bent, &folder.path().join("bent-shards"));
    let camera = &about["camera"];
    assert_eq!([&camera["camera_model"], &camera["k1"]], [&transforms["camera_model"], &json!(0.1)], "{camera}");
    assert_eq!(about["object_transforms"], json!({ "1": null }));
}

#[test]
fn an_export_holds_one_dataset() {
    let folder = tempfile::tempdir().unwrap();
    let [one, other] = ["one/shot", "other/shot"].map(|name| folder.path().join(name));
    render(&one, "5", &[]);
    render(&other, "6", &[]);
    for to in ["coco", "png"] {
        let out = folder.path().join(to);
        let export = |data: &Path| renderflow(&["dataset", "export", text(data), "--to", to, "--out", text(&out)]);
        assert!(export(&one).status.success());
        let before = files(&out);
        let refused = export(&other);
        assert_eq!(refused.status.code(), Some(1), "{to}");
        assert!(stderr(&refused).contains("of another dataset"), "{}", stderr(&refused));
        assert!(export(&one).status.success() && files(&out) == before, "{to}");
    }
}

/// Lights with an area are seen by pixels, so they are annotated as objects are.
#[test]
fn annotations_hold_lights_and_do_not_replace_what_cannot_be_read() {
    let folder = tempfile::tempdir().unwrap();
    let [shot, out] = ["shot", "coco"].map(|name| folder.path().join(name));
    let scene = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/examples/lights.json");
    let small = ["--frames", "1", "--resolution", "48x32", "--spp", "1", "--denoise", "none", "--no-sheet"];
    succeed(&[&["render", scene, "-o", text(&shot)][..], &small].concat());
    let export = || renderflow(&["dataset", "export", text(&shot), "--to", "coco", "--out", text(&out)]);
    let exported = export();
    assert!(exported.status.success(), "{}", stderr(&exported));
    let annotations = out.join("annotations/instances_train.json");
    let found: Value = serde_json::from_slice(&std::fs::read(&annotations).unwrap()).unwrap();
    let names: Vec<&str> = found["categories"].as_array().unwrap().iter().map(|c| c["name"].as_str().unwrap()).collect();
    let described: Value = serde_json::from_slice(&std::fs::read(scene).unwrap()).unwrap();
    let lamps = described["lights"].as_array().unwrap();
    let seen = |lamp: &&Value| ["sphere", "disk", "rectangle"].iter().any(|kind| lamp["kind"].get(kind).is_some());
    let lamps: Vec<&str> = lamps.iter().filter(seen).map(|lamp| lamp["name"].as_str().unwrap()).collect();
    assert!(!lamps.is_empty() && lamps.iter().all(|lamp| names.iter().any(|name| lamp.starts_with(name))), "{lamps:?} {names:?}");
    assert!(names.iter().all(|name| !name.is_empty()), "{names:?}");
    std::fs::write(&annotations, "{").unwrap();
    let refused = export();
    assert!(!refused.status.success() && stderr(&refused).contains("instances_train.json"), "{}", stderr(&refused));
    assert_eq!(std::fs::read(&annotations).unwrap(), b"{");
}

/// A camera of other pixels than its frame is told, whatever the layout.
#[test]
fn exports_compare_frames_with_their_cameras() {
    let folder = tempfile::tempdir().unwrap();
    let shot = folder.path().join("shot");
    render(&shot, "5", &[]);
    let path = shot.join("transforms.json");
    let mut transforms: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    (transforms["w"], transforms["h"]) = (json!(300_000), json!(300_000));
    std::fs::write(&path, transforms.to_string()).unwrap();
    for to in ["cosmos", "nerfstudio", "png"] {
        let said = common::fail(&["dataset", "export", text(&shot), "--to", to, "--out", text(&folder.path().join(to))]);
        assert!(said.contains("frame.0000.exr"), "{to}: {said}");
    }
}

/// Methods that need keyframes where there are none.
#[test]
fn methods_without_scores_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let [shot, alone, both] = ["shot", "alone", "both"].map(|name| folder.path().join(name));
    render(&shot, "5", &[]);
    let path = shot.join("transforms.json");
    let mut transforms: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    transforms["keyframes"] = json!([]);
    std::fs::write(&path, transforms.to_string()).unwrap();
    let evaluate =
        |methods: &str, out: &Path| renderflow(&["evaluate", "--data", text(&shot), "--methods", methods, "--out", text(out)]);
    let refused = evaluate("warp-ibl", &alone);
    assert!(!refused.status.success() && stderr(&refused).contains("no method has a score"), "{}", stderr(&refused));
    let noted = evaluate("ibl,warp-ibl", &both);
    assert!(noted.status.success() && stderr(&noted).contains("warp-ibl has no score"), "{}", stderr(&noted));
}

/// Plans often lie in the folder that one works in.
#[test]
fn a_plan_beside_a_render_says_nothing_about_it() {
    let folder = tempfile::tempdir().unwrap();
    let [plan, shot, out] = ["plan.json", "work/shot", "exported"].map(|name| folder.path().join(name));
    succeed(&["dataset", "plan", "--seed", "1", "--sequences", "1", "--frames", "1", "--out", text(&plan)]);
    render(&shot, "5", &[]);
    succeed(&["dataset", "export", text(&shot), "--to", "nerfstudio", "--out", text(&out)]);
    assert!(out.join("train/shot/transforms.json").is_file());
}

/// What a repair has put aside is damaged, and no part of the dataset.
#[test]
fn a_check_of_a_dataset_leaves_out_what_was_put_aside() {
    let folder = tempfile::tempdir().unwrap();
    let [data, good, aside] = ["data", "data/train/seq", "data/aside/train-seq-1"].map(|name| folder.path().join(name));
    render(&good, "5", &[]);
    copy(&good, &aside);
    std::fs::write(aside.join("frame.0000.exr"), "damaged").unwrap();
    std::fs::write(data.join("plan.json"), "{}").unwrap();
    let found = succeed(&["check", text(&data)]);
    assert!(found.contains("splits 1, sequences 1, frames 1"), "{found}");
}
