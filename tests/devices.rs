//! The choice of a device, as a user has it in a build for the processor and in one for GPUs.

mod common;

use common::{fail, files, renderflow, stderr, succeed};
use serde_json::Value;
use std::path::Path;

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// A picture to invert.
fn picture(folder: &Path) -> std::path::PathBuf {
    let path = folder.join("picture.png");
    image::RgbImage::from_fn(24, 16, |x, y| image::Rgb([10 * x as u8, 15 * y as u8, 90])).save(&path).unwrap();
    path
}

#[test]
fn the_processor_is_the_usual_device() {
    let folder = tempfile::tempdir().unwrap();
    let picture = picture(folder.path());
    let (usual, named) = (folder.path().join("usual"), folder.path().join("named"));
    succeed(&["invert", text(&picture), "--out", text(&usual)]);
    succeed(&["invert", text(&picture), "--device", "cpu", "--out", text(&named)]);
    assert!(files(&usual) == files(&named));
    for device in ["gpu", "cpu:1", "vulkan:x", ""] {
        let output = renderflow(&["invert", text(&picture), "--device", device, "--out", text(&folder.path().join("none"))]);
        assert_eq!(output.status.code(), Some(2), "{device}: {}", stderr(&output));
    }
    assert!(!folder.path().join("none").exists());
}

#[cfg(not(any(feature = "vulkan", feature = "cuda")))]
#[test]
fn a_build_for_the_processor_says_how_to_make_one_for_gpus() {
    let folder = tempfile::tempdir().unwrap();
    let (picture, out) = (picture(folder.path()), folder.path().join("out"));
    for device in ["vulkan", "vulkan:1", "cuda", "opengl"] {
        let said = fail(&["invert", text(&picture), "--device", device, "--out", text(&out)]);
        assert!(said.contains(&format!("device {device}: ")) && said.contains("--features"), "{said}");
        let plan = text(folder.path());
        let said = fail(&["train", "--plan", plan, "--device", device, "--out", text(&out)]);
        assert!(said.contains("--features"), "{said}");
    }
    assert!(!out.exists());
    // There is no GPU to choose, so the processor is taken, and nothing is noted.
    succeed(&["invert", text(&picture), "--device", "auto", "--out", text(&out)]);
    let record: Value = serde_json::from_slice(&std::fs::read(out.join("invert.json")).unwrap()).unwrap();
    assert!(record.get("device").is_none(), "{record}");
    let found: Value = serde_json::from_str(&succeed(&["doctor", "--json"])).unwrap();
    assert_eq!(found["gpus"].as_array().unwrap().len(), 0);
}

/// OpenGL is software where there is no GPU. Pictures are the same up to a step of 8 bits, and say where they were made.
#[cfg(feature = "vulkan")]
#[test]
fn pictures_of_another_device_are_the_same_and_are_not_mixed_in() {
    let folder = tempfile::tempdir().unwrap();
    let found: Value = serde_json::from_str(&succeed(&["doctor", "--json"])).unwrap();
    if !found["gpus"].as_array().unwrap().iter().any(|gpu| gpu["choice"] == "opengl:0") {
        return println!("skipped: there is no OpenGL");
    }
    let picture = picture(folder.path());
    let (cpu, gpu) = (folder.path().join("cpu"), folder.path().join("gpu"));
    succeed(&["invert", text(&picture), "--out", text(&cpu)]);
    succeed(&["invert", text(&picture), "--device", "opengl", "--out", text(&gpu)]);
    for buffer in ["albedo", "normal", "material"] {
        let name = format!("picture.{buffer}.png");
        let [a, b] = [&cpu, &gpu].map(|folder| image::open(folder.join(&name)).unwrap().to_rgb8());
        assert!(a.iter().zip(b.iter()).all(|(a, b)| a.abs_diff(*b) <= 1), "{buffer}");
    }
    let said = fail(&["invert", text(&picture), "--out", text(&gpu)]);
    assert!(said.contains("invert.json"), "{said}");
}
