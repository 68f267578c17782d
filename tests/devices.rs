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
    // 32-bit floats give nearly the same picture, and say so.
    let exact = folder.path().join("exact");
    succeed(&["invert", text(&picture), "--device", "cpu:f32", "--out", text(&exact)]);
    let albedo = |folder: &Path| image::open(folder.join("picture.albedo.png")).unwrap().to_rgb8();
    assert!(albedo(&usual).iter().zip(albedo(&exact).iter()).all(|(a, b)| a.abs_diff(*b) <= 4));
    let record: Value = serde_json::from_slice(&std::fs::read(exact.join("invert.json")).unwrap()).unwrap();
    assert!(record["device"].as_str().unwrap().starts_with("cpu:f32"), "{record}");
    let said = fail(&["train", "--plan", text(folder.path()), "--device", "cpu:f32", "--out", text(&exact.join("run"))]);
    assert!(said.contains("products"), "{said}");
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
    succeed(&["invert", text(&picture), "--device", "cpu:f32", "--out", text(&cpu)]);
    succeed(&["invert", text(&picture), "--device", "opengl", "--out", text(&gpu)]);
    for buffer in ["albedo", "normal", "material"] {
        let name = format!("picture.{buffer}.png");
        let [a, b] = [&cpu, &gpu].map(|folder| image::open(folder.join(&name)).unwrap().to_rgb8());
        assert!(a.iter().zip(b.iter()).all(|(a, b)| a.abs_diff(*b) <= 1), "{buffer}");
    }
    let said = fail(&["invert", text(&picture), "--out", text(&gpu)]);
    assert!(said.contains("invert.json"), "{said}");
}

/// The commands that run networks, with all but the device and the output. `data` is a split of a dataset, `plan` its plan.
#[cfg(feature = "vulkan")]
fn commands<'a>(folder: &'a Path, plan: &'a Path, data: &'a Path, picture: &'a Path) -> Vec<(&'static str, Vec<&'a str>)> {
    let configuration = |name: &str, value: Value| {
        let path = folder.join(name);
        std::fs::write(&path, value.to_string()).unwrap();
        &*Box::leak(path.to_str().unwrap().to_owned().into_boxed_str())
    };
    let crops = serde_json::json!([{ "size": 64, "batch": 2, "from": 0.0 }]);
    let recipe = serde_json::json!({ "truth_spp": 2, "bare_spp": 2, "key_spp": 2, "frames": 1, "samples": [1, 1, 1, 1] });
    let run = |network: &str| {
        let training =
            serde_json::json!({ "steps": 4, "first": 1, "window": 1, "crops": crops, "products": "f32", "log_steps": 1 });
        serde_json::json!({ "network": network, "training": training, "recipe": recipe, "validation": 0 })
    };
    let (fusion, inverse) = (configuration("fusion.json", run("fusion")), configuration("inverse.json", run("inverse")));
    let autoencoder = configuration(
        "autoencoder.json",
        serde_json::json!({
            "stage": { "autoencoder": { "network": "wan-tiny" } },
            "batches": [{ "size": 32, "frames": 1, "items": 2, "weight": 1.0 }],
            "steps": 2, "log_steps": 1,
        }),
    );
    let (plan, data) = (text(plan), text(data));
    let scene = ["--seed", "7", "--frames", "1", "--resolution", "32", "--spp", "2"];
    vec![
        ("infer", vec!["infer", "--data", data]),
        ("infer --keyframes", vec!["infer", "--data", data, "--keyframes"]),
        ("infer --rays 2 --neighbours around", vec!["infer", "--data", data, "--rays", "2", "--neighbours", "around"]),
        ("invert", vec!["invert", text(picture)]),
        ("render --denoise neural", [&["render", "--denoise", "neural"][..], &scene].concat()),
        ("evaluate", vec!["evaluate", "--data", data, "--methods", "neural,neural+keys"]),
        (
            "edit",
            [
                &["edit", "--methods", "neural", "--sweep", "environment/rotation=0..90", "--steps", "2"][..],
                &scene[..2],
                &scene[4..],
            ]
            .concat(),
        ),
        ("train, fusion", vec!["train", "--plan", plan, "--config", fusion]),
        ("train, inverse", vec!["train", "--plan", plan, "--config", inverse]),
        ("train, autoencoder of the paper", vec!["train", "--data", data, "--config", autoencoder]),
    ]
}

/// Commands on the processor and on another device: pictures are the same up to two steps of 8 bits, and losses up to a
/// thousandth. With `--nocapture` it prints the table of docs/gpus.md.
#[cfg(feature = "vulkan")]
#[test]
fn every_command_gives_the_same_on_another_device() {
    let found: Value = serde_json::from_str(&succeed(&["doctor", "--json"])).unwrap();
    let usable = found["gpus"].as_array().unwrap().iter().find(|gpu| gpu["problem"].is_null());
    let Some(gpu) = usable.map(|gpu| gpu["choice"].as_str().unwrap()) else {
        return println!("skipped: there is no GPU, and no OpenGL");
    };
    let folder = tempfile::tempdir().unwrap();
    let (plan, out) = (folder.path().join("plan.json"), folder.path().join("data"));
    let what = ["dataset", "plan", "--seed", "5", "--sequences", "1", "--frames", "5", "--resolution", "64", "--spp", "2"];
    succeed(&[&what[..], &["--keyframe-gap", "4", "--denoise", "none", "--out", text(&plan)]].concat());
    succeed(&["dataset", "render", "--plan", text(&plan), "--out", text(&out)]);
    let (data, picture) = (out.join("train"), picture(folder.path()));

    println!("| command | processor | {gpu} | largest difference |");
    println!("|---|---|---|---|");
    for (number, (name, command)) in commands(folder.path(), &plan, &data, &picture).into_iter().enumerate() {
        let run = |device: &str| {
            let out = folder.path().join(format!("{number}-{}", device.replace(':', "-")));
            let begun = std::time::Instant::now();
            succeed(&[&command[..], &["--device", device, "--out", text(&out)]].concat());
            (begun.elapsed().as_secs_f64(), out)
        };
        // A run of training multiplies as its configuration says.
        let processor = if command.contains(&"train") { "cpu" } else { "cpu:f32" };
        let ((on_cpu, a), (on_gpu, b)) = (run(processor), run(gpu));
        println!("| `{name}` | {on_cpu:.1} s | {on_gpu:.1} s | {} |", difference(&a, &b));
    }
}

/// How far the pictures in two folders are apart, or the losses of two runs. They must not be far.
#[cfg(feature = "vulkan")]
fn difference(a: &Path, b: &Path) -> String {
    let losses = |folder: &Path| -> Vec<f64> {
        let log = std::fs::read_to_string(folder.join("log.jsonl")).unwrap_or_default();
        log.lines().map(|line| serde_json::from_str::<Value>(line).unwrap()["loss"].as_f64().unwrap()).collect()
    };
    let (losses_a, losses_b) = (losses(a), losses(b));
    assert_eq!(losses_a.len(), losses_b.len());
    if !losses_a.is_empty() {
        let worst = losses_a.iter().zip(&losses_b).map(|(a, b)| ((a - b) / a).abs()).fold(0.0, f64::max);
        assert!(worst < 1e-3, "{losses_a:?} and {losses_b:?}");
        return format!("{worst:.1e} of a loss");
    }
    let (mut worst, mut count) = (0, 0);
    for (name, bytes) in files(a).into_iter().filter(|(name, _)| name.ends_with(".png")) {
        let open = |bytes: &[u8]| image::load_from_memory(bytes).unwrap().to_rgb8();
        let (a, b) = (open(&bytes), open(&std::fs::read(b.join(&name)).unwrap()));
        worst = a.iter().zip(b.iter()).map(|(a, b)| a.abs_diff(*b)).fold(worst, u8::max);
        count += 1;
    }
    assert!(count > 0, "there are no pictures");
    assert!(worst <= 2, "{worst} steps of 8 bits");
    format!("{worst} of 255, {count} pictures")
}
