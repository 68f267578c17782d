//! `renderflow edit`: steps are the scenes that they say, pictures and tables are made, and what makes no sense is refused.

mod common;

use common::{fail, renderflow, stderr, succeed};
use renderflow_frame::exr;
use serde_json::Value;
use std::path::Path;

const SCENE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/examples/moving_objects.json");
const SMALL: [&str; 8] = ["--resolution", "32", "--spp", "2", "--denoise", "none", "--methods", "ibl,neural"];

fn edit(out: &Path, words: &[&str]) -> Vec<Value> {
    let output = succeed(&[&["edit", "--json", "-o", out.to_str().unwrap()][..], &SMALL, words].concat());
    serde_json::from_str::<Value>(&output).unwrap().as_array().unwrap().clone()
}

#[test]
fn the_papers_edits_become_sheets_animations_and_tables() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("edits");
    let tables = edit(&out, &["--steps", "3"]);
    let names = ["cone-roughness", "cylinder-metallic", "cube-color"];
    assert_eq!(tables.iter().map(|table| table["edit"].as_str().unwrap()).collect::<Vec<_>>(), names);
    for (table, labels) in tables.iter().zip([
        ["roughness 1", "roughness 0.5", "roughness 0"],
        ["metallic 0", "metallic 0.5", "metallic 1"],
        ["base_color 0 0 1", "base_color 0 0.5 0.5", "base_color 0 1 0"],
    ]) {
        let steps = table["steps"].as_array().unwrap();
        assert_eq!(steps.iter().map(|step| step["step"].as_str().unwrap()).collect::<Vec<_>>(), labels);
        for step in steps {
            let scores = step["scores"].as_array().unwrap();
            assert_eq!(scores.iter().map(|score| score["method"].as_str().unwrap()).collect::<Vec<_>>(), ["ibl", "neural"]);
            assert!(scores.iter().all(|score| score["metrics"]["psnr"].as_f64().is_some_and(|psnr| psnr > 8.0)), "{step}");
        }
    }
    for name in names {
        let sheet = image::open(out.join(format!("{name}.png"))).unwrap();
        // Three columns of tiles; a row for the truth and for each method.
        assert!(sheet.width() > 3 * 224 && sheet.height() > 3 * 224, "{}x{}", sheet.width(), sheet.height());
        let gif = std::fs::File::open(out.join(format!("{name}.gif"))).unwrap();
        let decoder = image::codecs::gif::GifDecoder::new(std::io::BufReader::new(gif)).unwrap();
        // There and back.
        assert_eq!(image::AnimationDecoder::into_frames(decoder).count(), 4);
    }
    // The same command finds everything there; another number of steps would mix with it.
    let before = common::files(&out);
    assert_eq!(edit(&out, &["--steps", "3"]), tables);
    assert!(before == common::files(&out));
    let other = fail(&[&["edit", "--steps", "2", "-o", out.to_str().unwrap()][..], &SMALL].concat());
    assert!(other.contains("other methods or settings"), "{other}");
    let report = folder.path().join("report");
    succeed(&["report", out.join("results").to_str().unwrap(), "-o", report.to_str().unwrap()]);
    assert!(report.join("edit-cone-roughness-0002.html").is_file());
}

/// Each end is what `render --set` makes of the same scene.
#[test]
fn the_ends_of_a_sweep_are_the_scenes_with_these_values() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("edits");
    let tables = edit(
        &out,
        &[
            SCENE,
            "--set",
            "environment/intensity=2",
            "--sweep",
            "materials/0/base_color=[.9,.1,.1]..[.1,.1,.9]",
            "--sweep",
            "environment/rotation=-90..90",
            "--steps",
            "2",
        ],
    );
    assert_eq!(tables[0]["edit"], "base_color-rotation");
    let labels: Vec<&str> = tables[0]["steps"].as_array().unwrap().iter().map(|step| step["step"].as_str().unwrap()).collect();
    assert_eq!(labels, ["base_color 0.9 0.1 0.1, rotation -90", "base_color 0.1 0.1 0.9, rotation 90"]);
    for (step, color, rotation) in [("0000", "[.9,.1,.1]", "-90"), ("0001", "[.1,.1,.9]", "90")] {
        let rendered = folder.path().join(step);
        let (color, rotation) = (
            format!("materials/0/base_color={}", color.replace("[.", "[0.").replace(",.", ",0.")),
            format!("environment/rotation={rotation}"),
        );
        let set = ["--set", "environment/intensity=2", "--set", &color, "--set", &rotation];
        let rest = ["--frames", "1", "-o", rendered.to_str().unwrap()];
        succeed(&[&["render", SCENE, "--no-sheet"][..], &SMALL[..6], &set, &rest].concat());
        let [own, expected] = [out.join("steps/base_color-rotation").join(step), rendered]
            .map(|folder| exr::read(&folder.join("frame.0000.exr")).unwrap().beauty.unwrap());
        assert!(own == expected, "step {step}");
    }
}

#[test]
fn edits_that_make_no_sense_are_refused_before_anything_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("edits");
    for (words, said) in [
        (&["--sweep", "materials/0/roughness"][..], "give PATH=FROM..TO"),
        (&["--sweep", "materials/0/roughness=0..3"], "sweep at roughness 1.2"),
        (&["--sweep", "materials/0/roughnes=0..1"], "roughnes"),
        (&["--sweep", "materials/99/roughness=0..1"], "no \"99\""),
        (&["--sweep", "materials/0/base_color=[0,0,1]..[0,1]"], "different numbers of values"),
        (&[SCENE], "--sweep"),
        (&["--steps", "0"], "--steps"),
        (&["--methods", "neural+keys"], "needs keyframes"),
        (&["--methods", "wan"], "--weights"),
        (&["--denoise", "neural"], "must not be its own"),
    ] {
        let output =
            renderflow(&[&["edit", "--resolution", "32", "--spp", "1", "-o", out.to_str().unwrap()][..], words].concat());
        assert!(!output.status.success(), "{words:?}");
        assert!(stderr(&output).contains(said), "{words:?}: {}", stderr(&output));
        assert!(!out.exists(), "{words:?} wrote something");
    }
    // A folder that holds something else stays as it is.
    std::fs::create_dir_all(out.join("results")).unwrap();
    std::fs::write(out.join("results/mine.txt"), "mine").unwrap();
    let output = fail(&[&["edit", "-o", out.to_str().unwrap()][..], &SMALL].concat());
    assert!(output.contains("not empty"), "{output}");
    assert_eq!(common::files(&out).len(), 1);
}

/// Textures are often called as the values that change.
#[test]
fn pictures_that_are_not_of_an_edit_stay() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["roughness.png", "roughness.gif"] {
        let (out, words) = (folder.path().join(name), ["--sweep", "materials/0/roughness=1..0", "--steps", "2"]);
        std::fs::create_dir(&out).unwrap();
        std::fs::write(out.join(name), "mine").unwrap();
        let said = fail(&[&["edit", SCENE, "-o", out.to_str().unwrap()][..], &SMALL, &words].concat());
        assert!(said.contains(name) && said.contains("already exists"), "{said}");
        assert_eq!(common::files(&out), [(name.to_owned(), b"mine".to_vec())]);
    }
}
