//! The commands of `renderflow-bench` on the smallest of pictures: what they print and write.

mod common;

use common::{bench, stderr, succeed};
use renderflow_frame::exr;
use renderflow_frame::reach::Reach;
use renderflow_scenes::{Scene, load};
use serde_json::Value;
use std::path::{Path, PathBuf};

fn json(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

/// Marks of an SVG file that is well-formed XML.
fn circles(path: &Path) -> usize {
    let text = std::fs::read_to_string(path).unwrap();
    let document = roxmltree::Document::parse(&text).unwrap();
    assert_eq!(document.root_element().tag_name().name(), "svg");
    document.descendants().filter(|node| node.has_tag_name("circle")).count()
}

#[test]
fn convergence_gives_a_table_json_and_plots_and_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().to_string_lossy().into_owned();
    let common = ["convergence", "--scene", "interior", "--scene", "textured", "--reference-spp", "32", "--out", &out];
    let run = |more: &[&str]| bench(&[&common[..], more].concat());
    let small = ["--resolution", "16", "--max-spp", "16"];
    let first = run(&[&small[..], &["--repeats", "1"]].concat());
    assert!(first.status.success(), "{}", stderr(&first));
    let table = String::from_utf8_lossy(&first.stdout).into_owned();
    // A heading and three rows a scene and method; then a heading of two lines and a row a scene and method.
    let lines = |name: &str| table.lines().filter(|line| line.starts_with(name)).count();
    assert_eq!((lines("scene"), lines("interior"), lines("textured")), (2, 8, 8), "{table}");
    for heading in ["Msamp/s", "x spp", "SSIM", "cpu s", "99 % trim"] {
        assert!(table.contains(heading), "{heading} in {table}");
    }

    let path = folder.path().join("convergence.json");
    let results = json(&path);
    assert_eq!(results["conditions"]["resolution"], 16);
    for scene in results["scenes"].as_array().unwrap() {
        assert!(scene["reference_noise"].as_f64().unwrap() > 0.0);
        let rows = scene["rows"].as_array().unwrap();
        assert_eq!(rows.iter().map(|r| r["spp"].as_u64().unwrap()).collect::<Vec<_>>(), [4, 8, 16, 4, 8, 16]);
        assert!(rows.iter().enumerate().all(|(i, r)| r["method"] == if i < 3 { "uniform" } else { "adaptive" }));
        for row in rows {
            let run = &row["runs"][0];
            let (samples, asked) = (run["stats"]["samples"].as_u64().unwrap(), 256 * row["spp"].as_u64().unwrap());
            assert!(samples <= asked && (row["method"] == "adaptive" || samples == asked), "{samples} of {asked}");
            for key in ["mean", "trimmed", "clipped", "median"] {
                assert!(run["relmse"][key].as_f64().unwrap().is_finite());
            }
            assert!(run["time"]["seconds"].as_f64().unwrap() > 0.0 && run["displayed"]["ssim"].as_f64().unwrap() < 1.0);
        }
    }
    // A mark a row.
    assert_eq!(circles(&folder.path().join("convergence.svg")), 4 * 3);
    assert_eq!(circles(&folder.path().join("convergence_trimmed.svg")), 4 * 3);

    // More repeats and samples: what is there stays, the references too.
    let references = || -> Vec<(PathBuf, Vec<u8>)> {
        let entries = std::fs::read_dir(folder.path().join("references")).unwrap();
        let mut files: Vec<_> = entries.map(|e| e.unwrap().path()).map(|p| (p.clone(), std::fs::read(p).unwrap())).collect();
        files.sort();
        files
    };
    let before = references();
    assert_eq!(before.len(), 2);
    let second = run(&["--resolution", "16", "--max-spp", "32", "--repeats", "2"]);
    assert!(second.status.success(), "{}", stderr(&second));
    let more = json(&path);
    assert_eq!(references(), before);
    for (old, new) in results["scenes"].as_array().unwrap().iter().zip(more["scenes"].as_array().unwrap()) {
        assert_eq!(new["rows"].as_array().unwrap().len(), 8);
        assert_eq!(new["rows"][0]["runs"][0], old["rows"][0]["runs"][0]);
        let errors: Vec<_> = (0..2).map(|i| new["rows"][0]["runs"][i]["relmse"]["mean"].as_f64().unwrap()).collect();
        assert_ne!(errors[0], errors[1], "repeats have seeds of their own");
    }

    let other = run(&["--resolution", "24", "--max-spp", "4"]);
    assert!(!other.status.success() && stderr(&other).contains("other conditions"), "{}", stderr(&other));
    let unknown = bench(&["convergence", "--scene", "nowhere", "--out", &out]);
    assert!(!unknown.status.success() && stderr(&unknown).contains("soft_sun"), "{}", stderr(&unknown));
}

#[test]
fn scaling_gives_tables_and_json() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().to_string_lossy().into_owned();
    let words = ["--scene", "interior", "--spp", "1", "--repeats", "1", "--max-resolution", "16", "--max-triangles", "10000"];
    let text = succeed(&[&["--threads", "2", "scaling", "--out", &out], &words[..]].concat());
    for heading in ["speed-up", "build s", "a triangle", "16^2"] {
        assert!(text.contains(heading), "{heading} in {text}");
    }
    let results = json(&folder.path().join("scaling.json"));
    let column = |rows: &str, name: &str| -> Vec<u64> {
        results[rows].as_array().unwrap().iter().map(|row| row[name].as_u64().unwrap()).collect()
    };
    assert_eq!(column("threads", "threads"), [1, 2]);
    assert_eq!(column("resolutions", "resolution"), [16]);
    let triangles = column("triangles", "triangles");
    assert!(
        triangles.len() == 2 && (900..1100).contains(&triangles[0]) && (9000..11000).contains(&triangles[1]),
        "{triangles:?}"
    );
    assert!(column("triangles", "bytes").iter().zip(&triangles).all(|(bytes, n)| (30..400).contains(&(bytes / n))));
}

#[test]
fn scenes_of_the_set_can_be_written_and_are_good_scene_files() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().to_string_lossy().into_owned();
    assert!(succeed(&["scenes"]).lines().count() >= 8);
    let path = succeed(&["scenes", "textured", "--resolution", "8", "--out", &out]);
    let path = Path::new(path.trim());
    load::load(&Scene::read(path).unwrap(), &Reach::of(path)).unwrap();
    let refused = bench(&["scenes", "nothing", "--out", &out]);
    assert!(!refused.status.success() && stderr(&refused).contains("no such scene"));
}

#[test]
fn skips_change_no_picture_that_they_should_not() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().to_string_lossy().into_owned();
    // Rows on scenes of a million triangles take seconds to make.
    let rows =
        ["feature set", "sky only", "guides", "shadow ray", "light sample", "last ray", "without light", "flat sky", "beauty"];
    let only: Vec<&str> = rows.iter().flat_map(|row| ["--only", row]).collect();
    let small = ["skip", "--resolution", "24", "--spp", "16", "--repeats", "1", "--out", &out];
    let text = succeed(&[&small[..], &only].concat());
    let results = json(&folder.path().join("skip.json"));
    let measured = results["rows"].as_array().unwrap();
    for row in rows {
        assert!(measured.iter().any(|m| m["name"].as_str().unwrap().contains(row)) && text.contains(row), "{row}: {text}");
    }
    let (mut exact, mut others) = (0, 0);
    for row in measured {
        let difference = row["difference"].as_f64().unwrap();
        if row["exact"].as_bool().unwrap() {
            assert_eq!(difference, 0.0, "{}", row["name"]);
            exact += 1;
        } else {
            let most = if row["note"] == "by rounding" { 1e-3 } else { 1e3 };
            assert!(difference < most && row["note"] != "", "{}: {difference}", row["name"]);
            others += 1;
        }
        for way in ["with", "without"] {
            assert!(row[way]["seconds"].as_f64().unwrap() > 0.0);
        }
    }
    assert!(exact >= 10 && others == 2, "{exact} {others}: {text}");
}

#[test]
fn orbits_and_frames_are_told_by_stage() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().to_string_lossy().into_owned();
    let words = ["--scene", "textured", "--resolution", "16", "--repeats", "1", "--out", &out];
    let text = succeed(&[&["orbit", "--frames", "2"], &words[..]].concat());
    assert!(text.contains("camera moving") && text.contains("objects moving") && text.contains("saved"), "{text}");
    let orbit = json(&folder.path().join("orbit.json"));
    let sequences = orbit["sequences"].as_array().unwrap();
    assert_eq!(sequences.iter().map(|s| s["motion"].as_str().unwrap()).collect::<Vec<_>>(), ["camera", "objects"]);
    for sequence in sequences {
        for stage in ["load", "compile", "beauty", "gbuffer", "write"] {
            for which in ["alone", "frame"] {
                assert!(sequence[which][stage]["seconds"].as_f64().unwrap() > 0.0, "{which} {stage}");
            }
        }
    }

    let text = succeed(&[&["frame", "--seed", "1", "--spp", "32", "--reference-spp", "256"], &words[..]].concat());
    let frame = json(&folder.path().join("frame.json"));
    let rows = frame["rows"].as_array().unwrap();
    let names: Vec<_> = rows.iter().map(|r| (r["scene"].as_str().unwrap(), r["method"].as_str().unwrap())).collect();
    let [uniform, adaptive] = ["uniform", "adaptive"];
    assert_eq!(names, [("composed_1", uniform), ("composed_1", adaptive), ("textured", uniform), ("textured", adaptive)]);
    assert_eq!(text.lines().filter(|line| line.starts_with("composed_1") || line.starts_with("textured")).count(), 4, "{text}");
    for pair in rows.chunks(2) {
        assert_eq!((pair[0]["spp"].as_f64().unwrap(), pair[0]["ratio"].as_f64().unwrap()), (32.0, 1.0));
        let spp = pair[1]["spp"].as_f64().unwrap();
        assert!((1.0..=64.0).contains(&spp) && pair[1]["ratio"].as_f64().unwrap() > 0.0, "{spp}");
        for row in pair {
            assert!(row["relmse"].as_f64().unwrap().is_finite() && (0.0..=1.0).contains(&row["hits"].as_f64().unwrap()));
            assert!(row["stages"]["beauty"]["seconds"].as_f64().unwrap() > 0.0);
        }
    }
}

#[test]
fn files_are_measured_in_three_forms() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    let scene = renderflow_bench::scenes::open("overcast", Some(16), &[]).unwrap().loaded;
    let scene = renderflow_renderer::RenderScene::compile(&scene).unwrap();
    let frame = renderflow_renderer::render_gbuffer(&scene, &renderflow_renderer::Settings::default()).unwrap();
    exr::write(Path::new(&path("frame.exr")), &frame).unwrap();
    let text = succeed(&["files", &path("frame.exr"), "--rounds", "1", "--out", &path("out")]);
    assert!(text.contains("compact: ") && text.contains("loading: "), "{text}");
    let rows = json(&folder.path().join("out/files.json"))["rows"].clone();
    assert!(rows[0]["bytes"].as_array().unwrap().iter().all(|bytes| bytes.as_u64().unwrap() > 0), "{rows}");
    assert!(!bench(&["files", &path("nothing.exr")]).status.success());
}
