//! The inverse network, as a user has it: inside the program, and trained by the program itself.

mod common;

use common::{fail, files, renderflow, stderr, succeed};
use renderflow::dataset::Dataset;
use serde_json::{Value, json};
use std::path::Path;

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// A bright wall over a dark floor.
fn picture(width: u32, height: u32) -> image::RgbImage {
    let pixel = |x: u32, y: u32| if 2 * y < height { image::Rgb([200, 180, (x % 50) as u8]) } else { image::Rgb([60, 50, 40]) };
    image::RgbImage::from_fn(width, height, pixel)
}

#[test]
fn pictures_are_inverted_without_any_file() {
    let folder = tempfile::tempdir().unwrap();
    let photos = folder.path().join("photos");
    std::fs::create_dir_all(photos.join("more")).unwrap();
    for (name, width, height) in [("a.png", 40, 20), ("b.jpg", 600, 130), ("more/a.png", 1, 1)] {
        picture(width, height).save(photos.join(name)).unwrap();
    }
    let out = folder.path().join("out");
    let invert = ["invert", text(&photos), "--exr", "--out", text(&out)];
    succeed(&invert);
    let there = files(&out);
    assert_eq!(there.len(), 1 + 3 * 4 * 2, "{:?}", there.iter().map(|(name, _)| name).collect::<Vec<_>>());
    for (name, size) in [("a", (40, 20)), ("b", (600, 130)), ("more/a", (1, 1))] {
        for buffer in ["albedo", "normal", "depth", "material"] {
            let found = image::open(out.join(format!("{name}.{buffer}.png"))).unwrap();
            assert_eq!((found.width(), found.height()), size, "{name} {buffer}");
            assert_eq!(found.color() == image::ColorType::L16, buffer == "depth");
        }
    }
    let normals = renderflow_frame::exr::read_rgb(&out.join("b.normal.exr")).unwrap();
    assert!(normals.pixels.iter().all(|n| (n.iter().map(|v| v * v).sum::<f32>() - 1.0).abs() < 1e-3));
    let depth = renderflow_frame::exr::read_rgb(&out.join("b.depth.exr")).unwrap();
    let ends = depth.pixels.iter().fold((f32::MAX, f32::MIN), |(low, high), d| (low.min(d[0]), high.max(d[0])));
    assert_eq!(ends, (0.0, 1.0));

    // The same command goes on, and makes what is missing.
    std::fs::remove_file(out.join("a.normal.png")).unwrap();
    succeed(&invert);
    assert!(files(&out) == there);
    let only = folder.path().join("only");
    succeed(&["invert", text(&photos.join("b.jpg")), "--only", "albedo,depth", "--out", text(&only)]);
    let names: Vec<String> = files(&only).into_iter().map(|(name, _)| name).collect();
    assert_eq!(names, ["b.albedo.png", "b.depth.png", "invert.json"]);

    // Options of the paper's network are refused, and nothing is written.
    let nothing = folder.path().join("nothing");
    for option in [["--clip", "2"], ["--steps", "1"]] {
        let said = fail(&[&["invert", text(&photos), "--out", text(&nothing)][..], &option].concat());
        assert!(said.contains(option[0]) && said.contains("the paper's network"), "{said}");
    }
    let inside = concat!(env!("CARGO_MANIFEST_DIR"), "/model/weights/inverse.safetensors");
    for option in [["--tile", "64"], ["--vae", inside]] {
        let said = fail(&[&["invert", text(&photos), "--weights", inside, "--out", text(&nothing)][..], &option].concat());
        assert!(said.contains(option[0]) && said.contains("the paper's network"), "{said}");
    }
    let reads_samples = concat!(env!("CARGO_MANIFEST_DIR"), "/model/weights/fusion.safetensors");
    let said = fail(&["invert", text(&photos), "--weights", reads_samples, "--out", text(&nothing)]);
    assert!(said.contains("fusion.safetensors") && !nothing.exists(), "{said}");

    // Light a little below 0, as denoisers leave it, is none, and costs the other components nothing.
    let (light, seen) = (folder.path().join("light"), folder.path().join("seen"));
    std::fs::create_dir_all(&light).unwrap();
    for (name, red) in [("none.exr", 0.0_f32), ("below.exr", -0.01)] {
        exr::prelude::write_rgb_file(light.join(name), 8, 8, |_, _| (red, 0.5_f32, 0.25_f32)).unwrap();
    }
    succeed(&["invert", text(&light), "--only", "albedo", "--out", text(&seen)]);
    let [none, below] = ["none", "below"].map(|name| std::fs::read(seen.join(format!("{name}.albedo.png"))).unwrap());
    assert!(none == below);

    // A decoder that panics makes one line of error.
    let damaged = concat!(env!("CARGO_MANIFEST_DIR"), "/fuzz/seeds/texture/one_component_of_three.jpg");
    let said = fail(&["invert", damaged, "--out", text(&nothing)]);
    assert!(said.contains("one_component_of_three.jpg: damaged image data") && !said.contains("panicked"), "{said}");

    // The weights inside the program are those of the file, and are recorded alike.
    let same = folder.path().join("same");
    succeed(&["invert", text(&photos), "--exr", "--weights", inside, "--out", text(&same)]);
    assert!(files(&same) == files(&out));
    // A program with other weights does not go on.
    let record = out.join("invert.json");
    let (told, digest) = (std::fs::read_to_string(&record).unwrap(), blake3::hash(&std::fs::read(inside).unwrap()).to_hex());
    assert!(told.contains(digest.as_str()), "{told}");
    std::fs::write(&record, told.replace(digest.as_str(), &blake3::hash(b"other").to_hex())).unwrap();
    assert!(fail(&invert).contains("other weights or options"));
}

/// A plan is rendered, a network learns from it, and its weights are used, measured and described.
#[test]
fn a_network_is_trained_and_used() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let (plan, options, run) = (path("plan.json"), path("run.json"), path("run"));
    let sizes = ["--sequences", "10", "--frames", "2", "--resolution", "64", "--spp", "1", "--seed", "5"];
    succeed(&[&["dataset", "plan", "--denoise", "none", "--out", text(&plan)][..], &sizes].concat());
    std::fs::write(&options, r#"{"network": "inverse"}"#).unwrap();
    let printed = succeed(&["train", "--config", text(&options), "--plan", text(&plan), "--out", text(&run), "--print-config"]);
    let mut config: Value = serde_json::from_str(&printed).unwrap();
    assert_eq!((&config["network"], &config["recipe"]["bare"]), (&json!("inverse"), &json!(1.0)));
    // Of a recipe, a file may name what differs from the network's own alone; and what the network cannot do is refused.
    let print = |options: &str| {
        ["train", "--config", options, "--plan", text(&plan), "--out", text(&run), "--print-config"].map(str::to_owned)
    };
    let some = path("some.json");
    std::fs::write(&some, r#"{"network": "inverse", "recipe": {"skip": 7}}"#).unwrap();
    let printed: Value = serde_json::from_str(&succeed(&print(text(&some)).each_ref().map(String::as_str))).unwrap();
    assert_eq!(printed["recipe"]["skip"], json!(7));
    assert_eq!([&printed["recipe"]["bare"], &printed["recipe"]["deferred"]], [&json!(1.0), &json!(false)]);
    std::fs::write(&some, r#"{"network": "fusion", "training": {"lpips_weights": "/none"}}"#).unwrap();
    assert!(succeed(&print(text(&some)).each_ref().map(String::as_str)).contains("\"lpips_weights\": \"/none\""));
    for (options, says) in [
        (r#"{"network": "inverse", "recipe": {"keyed": 0.5}}"#, "reads neither samples nor keyframes"),
        (r#"{"network": "fusion", "recipe": {"deferred": false, "bare": 1.0}}"#, "recipe.deferred: a tier"),
        (r#"{"network": "inverse", "recipe": {"deffered": false}}"#, "deffered"),
        (r#"{"network": "inverse", "training": {"loss": {"normal": -1}}}"#, "loss.normal"),
        (r#"{"network": "fusion", "training": {"loss": {"lpips": -1}}}"#, "loss.lpips"),
        (r#"{"network": "fusion", "training": {"crops": [{"size": 96, "batch": 8, "from": 50}]}}"#, "crops.from"),
        (r#"{"network": "fusion", "recipe": {"truth_spp": 0}}"#, "recipe.truth_spp"),
        (r#"{"network": "fusion", "recipe": {"samples": [1, 2, 4, 0]}}"#, "recipe.samples"),
        (r#"{"network": "fusion", "recipe": {"max_bounces": 0}}"#, "recipe.max_bounces"),
        (r#"{"network": "fusion", "recipe": {"frames": 0}}"#, "recipe.frames"),
        (r#"{"network": "fusion", "recipe": {"single": 2}}"#, "recipe.single"),
        (r#"{"network": "fusion", "training": {"loss": {"lpips": 1}, "lpips_weights": "/none"}}"#, "lpips_squeeze.safetensors"),
    ] {
        std::fs::write(&some, options).unwrap();
        let said = fail(&print(text(&some)).each_ref().map(String::as_str));
        assert!(said.contains(says), "{said}");
    }
    config["training"]["crops"] = json!([{ "size": 64, "batch": 1, "from": 0.0 }]);
    config["training"]["network"]["widths"] = json!([16, 16, 16, 16, 16, 16]);
    config["training"]["first"] = 1.into();
    config["training"]["checkpoint_steps"] = 2.into();
    config["training"]["log_steps"] = 1.into();
    config["recipe"]["bare_spp"] = 1.into();
    config["validation"] = 1.into();
    std::fs::write(&options, config.to_string()).unwrap();
    let train = |steps: &str, out: &Path| {
        let kept = path("kept");
        let from = ["train", "--config", text(&options), "--plan", text(&plan), "--keep", text(&kept)];
        succeed(&[&from[..], &["--steps", steps, "--out", text(out)]].concat())
    };
    assert!(train("3", &run).contains("3 steps"));
    assert!(train("3", &run).contains("already done"));
    for name in ["checkpoint.safetensors", "log.jsonl", "validation.jsonl", "curves.html", "validation-inverse.png"] {
        assert!(run.join(name).is_file(), "{name}");
    }
    let curves = std::fs::read_to_string(run.join("curves.html")).unwrap();
    assert!(curves.contains("normals, degrees"));

    let weights = run.join("weights.safetensors");
    let said = succeed(&["weights", "inspect", text(&weights)]);
    assert!(said.contains("network that inverts pictures, 3 steps"), "{said}");
    let said = succeed(&["weights", text(&weights), "--json"]);
    let header: Value = serde_json::from_str(&said).unwrap();
    assert_eq!(header, json!({ "inverse": { "widths": [16, 16, 16, 16, 16, 16] }, "steps": 3, "seed": 1 }));
    assert!(succeed(&["check", text(&weights)]).contains("network inverse"));
    let wide = path("wide.safetensors");
    succeed(&["weights", "convert", text(&weights), text(&wide), "--precision", "f32"]);
    assert!(std::fs::metadata(&wide).unwrap().len() > 3 * std::fs::metadata(&weights).unwrap().len() / 2);

    // A dataset is inverted and measured.
    let data = path("data");
    succeed(&["dataset", "render", "--plan", text(&plan), "--out", text(&data)]);
    let (data, out) = (data.join("train"), path("buffers"));
    succeed(&["invert", "--data", text(&data), "--weights", text(&weights), "--out", text(&out)]);
    let results = |from: &[&str], out: &Path| -> Value {
        succeed(&[&["evaluate", "inverse", "--data", text(&data), "--every", "1", "--out", text(out)][..], from].concat());
        serde_json::from_slice(&std::fs::read(out.join("inverse.json")).unwrap()).unwrap()
    };
    let by_network = results(&["--weights", text(&weights)], &path("by-network"));
    let by_files = results(&["--buffers", text(&out)], &path("by-files"));
    // They name what they are of.
    let digest = |path: &Path| blake3::hash(&std::fs::read(path).unwrap()).to_hex().to_string();
    assert_eq!((&by_network["weights"], &by_network["every"]), (&json!([digest(&weights)]), &json!(1)));
    assert_eq!((&by_files["weights"], &by_files["data"]), (&json!([]), &by_network["data"]));
    assert!(by_files["buffers"].is_string() && by_network["buffers"].is_null());
    let read = by_network["data"].as_object().unwrap();
    let sequences = Dataset::open(&data).unwrap().sequences;
    assert_eq!(read.len(), sequences.len());
    for sequence in &sequences {
        let all: Vec<usize> = (0..sequence.len()).collect();
        let place = read.iter().find(|(place, _)| place.ends_with(&format!("/{}", sequence.name)));
        assert_eq!(place.unwrap().1, &json!(sequence.digest(&all).unwrap()));
    }
    let mean = |of: &Value, id: &str| of["sets"][0]["rows"][0]["values"][id]["mean"].as_f64().unwrap();
    for (id, within) in [("albedo_psnr", 0.1), ("normal_mean", 1.0), ("depth_relative", 0.01), ("roughness_rms", 0.003)] {
        let [a, b] = [&by_network, &by_files].map(|of| mean(of, id));
        assert!((a - b).abs() < within, "{id}: {a} and {b}");
    }
    let inside = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/model/weights/inverse.safetensors"));
    let shipped = results(&[], &path("by-program"));
    assert_eq!(shipped["weights"], json!([digest(inside)]));
    assert!(mean(&shipped, "albedo_psnr") > mean(&by_network, "albedo_psnr"));

    // Weights of another network are no beginning.
    let inside = concat!(env!("CARGO_MANIFEST_DIR"), "/model/weights/fusion.safetensors");
    let other = path("other");
    let output = renderflow(&[
        "train",
        "--config",
        text(&options),
        "--plan",
        text(&plan),
        "--from",
        inside,
        "--steps",
        "1",
        "--out",
        text(&other),
    ]);
    assert!(!output.status.success() && stderr(&output).contains("fusion.safetensors"), "{}", stderr(&output));
}

/// A picture is inverted and shown under another light.
#[test]
fn buffers_are_shown_under_another_light() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let (plan, data) = (path("plan.json"), path("data"));
    let sizes = ["--sequences", "2", "--frames", "2", "--resolution", "64", "--spp", "16", "--seed", "8", "--split", "test"];
    succeed(&[&["dataset", "plan", "--denoise", "none", "--out", text(&plan)][..], &sizes].concat());
    succeed(&["dataset", "render", "--plan", text(&plan), "--out", text(&data)]);
    // Names with points are kept whole.
    for (number, name) in ["seq.a", "seq.b"].into_iter().enumerate() {
        std::fs::rename(data.join(format!("test/seq-00000{number}")), data.join("test").join(name)).unwrap();
    }
    let relight = |turn: &str, out: &Path| -> Value {
        let sizes = ["--turn", turn, "--spp", "16"];
        succeed(&[&["evaluate", "relight", "--data", text(&data), "--out", text(out)][..], &sizes].concat());
        serde_json::from_slice(&std::fs::read(out.join("relight.json")).unwrap()).unwrap()
    };
    let psnr = |results: &Value, row: usize| results["rows"][row]["values"]["psnr"]["mean"].as_f64().unwrap();
    let (still, turned) = (relight("0", &path("still")), relight("-120", &path("turned")));
    assert_eq!((&turned["sequences"], &turned["turn"]), (&json!(2), &json!(-120.0)));
    let names: Vec<&str> = turned["rows"].as_array().unwrap().iter().map(|row| row["buffers"].as_str().unwrap()).collect();
    let known = "network; network, ratio; network, traced; network, ratio traced; true buffers; true buffers, traced; no network; \
        the old picture";
    assert_eq!(names, known.split("; ").collect::<Vec<_>>());
    let row = |results: &Value, name: &str| psnr(results, names.iter().position(|row| *row == name).unwrap());
    // Where nothing turned, the old picture is the truth but for noise.
    let old = row(&still, "the old picture");
    assert!(old > row(&turned, "the old picture") + 3.0 && old > row(&still, "true buffers") + 3.0, "{still} {turned}");
    // So is a ratio of two shadings that are the same.
    for ratio in ["network, ratio", "network, ratio traced"] {
        assert!((row(&still, ratio) - old).abs() < 0.5, "{still}");
    }
    // Shadows and bounces are worth something.
    for results in [&still, &turned] {
        assert!(row(results, "true buffers, traced") > row(results, "true buffers") + 1.0, "{results}");
    }
    let truth = |set: &str| files(&path(set).join("truth"));
    assert!(truth("still") != truth("turned"));
    let sheets = files(&path("still")).into_iter().map(|(name, _)| name).filter(|name| name.ends_with(".png"));
    let mut sheets: Vec<String> = sheets.filter_map(|name| Some(name.rsplit(['/', '\\']).next()?.to_owned())).collect();
    sheets.sort();
    assert_eq!(sheets, ["seq.a.png", "seq.b.png"]);

    // The truth is read where it is there, and a folder of another angle is not mixed in.
    let before = truth("turned");
    assert_eq!(relight("-120", &path("turned")), turned);
    assert!(truth("turned") == before);
    let said =
        fail(&["evaluate", "relight", "--data", text(&data), "--turn", "60", "--spp", "16", "--out", text(&path("turned"))]);
    assert!(said.contains("pictures of another light"), "{said}");
    // So are results of other weights and of other data.
    let (record, moved) = (path("turned/relight.json"), path("moved"));
    let other = |data: &Path| {
        fail(&["evaluate", "relight", "--data", text(data), "--turn", "-120", "--spp", "16", "--out", text(&path("turned"))])
    };
    std::fs::rename(data.join("test/seq.b"), &moved).unwrap();
    let said = other(&data);
    assert!(said.contains("relight.json: the folder holds results of other weights, data"), "{said}");
    // Sequences may be added to those that are there.
    let one = relight("-120", &path("grown"));
    std::fs::rename(&moved, data.join("test/seq.b")).unwrap();
    assert_eq!((&one["sequences"], one["data"].as_object().unwrap().len()), (&json!(1), 1));
    assert_eq!(relight("-120", &path("grown")), turned);
    let told = std::fs::read_to_string(&record).unwrap();
    let weights = turned["weights"][0].as_str().unwrap();
    assert_eq!((turned["weights"].as_array().unwrap().len(), turned["data"].as_object().unwrap().len()), (1, 2));
    std::fs::write(&record, told.replace(weights, &blake3::hash(b"other").to_hex())).unwrap();
    let before = files(&path("turned"));
    let said = other(&data);
    assert!(said.contains("results of other weights") && files(&path("turned")) == before, "{said}");
    // The truth is rendered of frame 0. A sequence that begins later shows something else.
    let transforms = data.join("test/seq.b/transforms.json");
    let mut value: Value = serde_json::from_slice(&std::fs::read(&transforms).unwrap()).unwrap();
    value["frames"].as_array_mut().unwrap().remove(0);
    value["keyframes"] = json!([]);
    std::fs::write(&transforms, value.to_string()).unwrap();
    let said = fail(&["evaluate", "relight", "--data", text(&data), "--out", text(&path("late"))]);
    assert!(said.contains("seq.b: frame 0 is missing") && !path("late").exists(), "{said}");
    for name in files(&data).into_iter().map(|(name, _)| name).filter(|name| name.ends_with("scene.json")) {
        std::fs::remove_file(data.join(name)).unwrap();
    }
    let said = fail(&["evaluate", "relight", "--data", text(&data), "--out", text(&path("none"))]);
    assert!(said.contains("scene.json") && !path("none").exists(), "{said}");
}
