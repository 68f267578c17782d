//! The pipeline through the binary, small: determinism over shards, threads and resume, and the demo's outputs.

mod common;

use common::{files, renderflow, succeed};
use std::path::Path;

fn plan(folder: &Path) -> String {
    let plan = folder.join("plan.json");
    succeed(&[
        "dataset",
        "plan",
        "--seed",
        "11",
        "--sequences",
        "3",
        "--frames",
        "2",
        "--resolution",
        "32",
        "--spp",
        "4",
        "--keyframe-gap",
        "1",
        "--denoise",
        "none",
        "--out",
        plan.to_str().unwrap(),
    ]);
    plan.to_str().unwrap().to_owned()
}

/// Dataset files that must not differ: all but the clock's.
fn dataset(folder: &Path) -> Vec<(String, Vec<u8>)> {
    files(folder).into_iter().filter(|(name, _)| !name.ends_with("timing.json") && !name.starts_with("logs/")).collect()
}

#[test]
fn shards_threads_and_resume_give_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let plan = plan(folder.path());
    let render = |out: &str, shard: &str, threads: &str| {
        let out = folder.path().join(out);
        succeed(&["dataset", "render", "--plan", &plan, "--out", out.to_str().unwrap(), "--shard", shard, "--threads", threads]);
        out
    };
    let whole = render("whole", "1/1", "3");
    render("parts", "2/2", "1");
    let parts = render("parts", "1/2", "2");
    let expected = dataset(&whole);
    assert!(expected.iter().any(|(name, _)| name == "manifest.json"));
    assert_eq!(expected.iter().filter(|(name, _)| name.ends_with(".exr")).count(), 6);
    assert!(dataset(&parts) == expected, "shards differ from the whole");
    // A frame lost, everything else kept: the same command makes it again.
    let lost = parts.join("train/seq-000001/frame.0001.exr");
    std::fs::remove_file(&lost).unwrap();
    render("parts", "1/1", "2");
    assert!(dataset(&parts) == expected, "resumed differs from the whole");
}

#[test]
fn frames_of_other_settings_are_not_mixed_in() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let render = |spp: &str| {
        renderflow(&[
            "render",
            "--frames",
            "1",
            "--resolution",
            "16",
            "--spp",
            spp,
            "--denoise",
            "none",
            "--out",
            out.to_str().unwrap(),
        ])
    };
    assert!(render("2").status.success());
    let second = render("3");
    assert_eq!(second.status.code(), Some(1));
    assert!(common::stderr(&second).contains("other settings"), "{}", common::stderr(&second));
}

#[test]
fn demo_prints_a_table_and_writes_a_self_contained_report() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("demo");
    let run = || {
        succeed(&[
            "demo",
            "--resolution",
            "64",
            "--frames",
            "5",
            "--keyframe-gap",
            "4",
            "--spp",
            "8",
            "--path-traced",
            "1",
            "--out",
            out.to_str().unwrap(),
        ])
    };
    let text = run();
    for row in ["IBL (split sum)", "Deferred", "neural ", "neural + keyframes", "warped keyframes + Deferred", "1 spp"] {
        assert!(text.contains(row), "{row} missing in\n{text}");
    }
    let report = std::fs::read_to_string(out.join("report/index.html")).unwrap();
    let page = std::fs::read_to_string(out.join("report/demo-scene-sequence.html")).unwrap();
    // The first bytes of a PNG, in base64.
    assert!(page.matches("iVBORw0KGgo").count() >= 3 * (1 + 6));
    for page in [report, page] {
        // The namespace of SVG is a name, not an address.
        let page = page.replace("http://www.w3.org/2000/svg", "");
        assert!(!page.contains("http://") && !page.contains("https://"), "the report must not load anything");
    }
    // Again from the stored truth: the same scores, seconds aside.
    let scores = || {
        let text = std::fs::read_to_string(out.join("results/demo/scene/sequence.jsonl")).unwrap();
        let without_seconds = |line: &str| {
            let mut score: serde_json::Value = serde_json::from_str(line).unwrap();
            score["seconds"] = 0.into();
            score
        };
        text.lines().map(without_seconds).collect::<Vec<_>>()
    };
    let first = scores();
    assert_eq!(first.len(), 5 * 6);
    std::fs::remove_dir_all(out.join("results")).unwrap();
    run();
    assert_eq!(first, scores());
}
