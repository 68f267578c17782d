//! The paper's network through the binary, as small as it gets: trained, looked at, rendered with, turned round, evaluated.

mod common;

use common::{copy, fail, files, renderflow, stderr, succeed};
use renderflow::dataset::shading::Shading;
use renderflow::dataset::{Dataset, Sequence};
use renderflow::evaluate::results::Results;
use renderflow_frame::{color, frame_file};
use renderflow_model::data::ClipSource;
use renderflow_model::device::NetworkDevice;
use renderflow_model::renderer::{Options, View};
use renderflow_model::wan::{self, Autoencoder};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

const SIDE: usize = 32;
/// A clip, and two frames of the next.
const FRAMES: usize = 7;

/// All rows of the paper's network, and two to stand beside.
const METHODS: &str = "ibl,neural,wan,wan+keys,wan-stills,wan-stills+keys";

/// A sequence with keyframes 4 frames apart.
fn data(folder: &Path) -> PathBuf {
    let (plan, out) = (folder.join("plan.json"), folder.join("data"));
    let arguments = ["dataset", "plan", "--seed", "5", "--split", "test", "--sequences", "1", "--frames", "7"];
    let size = ["--resolution", "32", "--spp", "2", "--keyframe-gap", "4", "--denoise", "none", "--out", text(&plan)];
    succeed(&[&arguments[..], &size].concat());
    succeed(&["dataset", "render", "--plan", text(&plan), "--out", text(&out)]);
    out.join("test")
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Weights of every stage: the autoencoder, the renderer with a keyframe adapter, that with an inverse adapter.
struct Weights {
    vae: PathBuf,
    keys: PathBuf,
    inverse: PathBuf,
}

fn train(folder: &Path, data: &Path) -> Weights {
    // The autoencoder by a file of options.
    let config = json!({
        "stage": { "autoencoder": { "network": "wan-tiny" } },
        "batches": [{ "size": 32, "frames": 1, "items": 2, "weight": 1.0 }],
        "steps": 2,
    });
    let path = folder.join("autoencoder.json");
    std::fs::write(&path, config.to_string()).unwrap();
    let out = |name: &str| folder.join(name);
    let said = succeed(&["train", "--config", text(&path), "--data", text(data), "--out", text(&out("vae"))]);
    assert!(said.contains("2 steps"), "{said}");
    let weights = |name: &str| out(name).join("weights.safetensors");
    let vae = weights("vae");
    let stage = |stage: &str, steps: &str, more: &[&str]| {
        let (out, common) = (out(stage), ["train", "--preset", "wan-tiny", "--stage", stage, "--vae", text(&vae)]);
        let run = ["--data", text(data), "--steps", steps, "--out", text(&out)];
        succeed(&[&common[..], &run, more].concat());
    };
    // A preset's options in full are a file of options.
    let print =
        |more: &[&str]| succeed(&[&["train", "--data", text(data), "--out", "runs/out", "--print-config"][..], more].concat());
    let printed = print(&["--preset", "wan-small", "--stage", "base", "--vae", "vae.safetensors", "--minutes", "5"]);
    std::fs::write(&path, &printed).unwrap();
    assert_eq!(print(&["--config", text(&path)]), printed);
    let options: Value = serde_json::from_str(&printed).unwrap();
    assert_eq!(options["stage"]["base"]["latents"]["autoencoder"], "vae.safetensors");
    // Those of the other network are another's.
    std::fs::write(&path, print(&[])).unwrap();
    assert!(print(&["--config", text(&path)]).contains("crops"));
    stage("base", "2", &[]);
    stage("keyframes", "2", &["--base", text(&weights("base"))]);
    // After two steps every buffer would be the picture.
    stage("inverse", "40", &["--base", text(&weights("keyframes"))]);
    Weights { keys: weights("keyframes"), inverse: weights("inverse"), vae }
}

#[test]
fn the_papers_network_from_training_to_tables() {
    let folder = tempfile::tempdir().unwrap();
    let data = data(folder.path());
    let weights = train(folder.path(), &data);
    files_say_what_they_are(folder.path(), &weights);
    sequences_are_rendered(folder.path(), &data, &weights);
    pictures_are_taken_apart(folder.path(), &data, &weights);
    the_autoencoder_is_measured(folder.path(), &data, &weights);
    recovered_buffers_are_measured(folder.path(), &data, &weights);
    rows_stand_beside_the_others(folder.path(), &data, &weights);
    the_bridge_begins_with_deferred_shading(folder.path(), &data, &weights);
}

fn files_say_what_they_are(folder: &Path, weights: &Weights) {
    let header: Value = serde_json::from_str(&succeed(&["weights", "--json", text(&weights.inverse)])).unwrap();
    assert_eq!(header["network"]["kind"], "wan-flow");
    assert!(header["network"]["config"]["inverse"].is_object() && header["provenance"]["steps"] == 44, "{header}");

    let table = succeed(&["weights", "inspect", text(&weights.vae), text(&weights.keys)]);
    for part in ["decoder.conv_in.weight", "[32, 4, 3, 3, 3]", "Wan autoencoder", "renderer on Wan's transformer", "tensors fit"]
    {
        assert!(table.contains(part), "{part} missing in\n{table}");
    }
    let list: Value = serde_json::from_str(&succeed(&["weights", "inspect", "--json", text(&weights.vae)])).unwrap();
    let sum = |key: &str| list[0][key].as_array().unwrap().iter().map(|row| row["parameters"].as_u64().unwrap()).sum::<u64>();
    assert_eq!(list[0]["parameters"], sum("tensors"));
    assert_eq!(list[0]["parameters"], sum("parts"));
    assert_eq!((&list[0]["kind"], &list[0]["fits"]), (&json!("wan-vae"), &json!(true)));

    // To the original names and back, through a file that only shapes tell apart.
    let (original, back) = (folder.join("converted/original.safetensors"), folder.join("converted/back.safetensors"));
    succeed(&["weights", "convert", text(&weights.vae), text(&original), "--naming", "original"]);
    let said = succeed(&["weights", "inspect", text(&original)]);
    assert!(said.contains("decoder.conv1.weight") && said.contains("original names"), "{said}");
    succeed(&["weights", "convert", text(&original), text(&back)]);
    assert!(std::fs::read(&back).unwrap() == std::fs::read(&weights.vae).unwrap(), "there and back is another file");
    succeed(&["weights", "convert", text(&original), text(&back), "--precision", "bf16", "--overwrite"]);
    let [half, whole] = [&back, &weights.vae].map(|path| std::fs::metadata(path).unwrap().len());
    assert!(half < whole * 6 / 10, "{half} bytes of {whole}");
    // The network inside the program is a file among others.
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("model/weights/fusion.safetensors");
    let said = succeed(&["weights", "inspect", text(&shipped)]);
    let values = renderflow_model::fusion::FusionConfig::default().values().to_string();
    assert!(said.contains("network that reads samples") && said.contains(&values), "{said}");
    let single = folder.join("converted/single.safetensors");
    succeed(&["weights", "convert", text(&shipped), text(&single), "--precision", "f32"]);
    succeed(&["weights", "convert", text(&single), text(&back), "--precision", "f16", "--overwrite"]);
    assert!(std::fs::read(&back).unwrap() == std::fs::read(&shipped).unwrap());

    let accepted = succeed(&["check", text(&weights.vae), text(&weights.inverse)]);
    for part in ["Wan autoencoder", "keyframes yes", "inverse yes", "steps 44"] {
        assert!(accepted.contains(part), "{part} missing in\n{accepted}");
    }
    // A tensor that is cut off is named.
    let bytes = std::fs::read(&weights.vae).unwrap();
    let cut = folder.join("converted/cut.safetensors");
    std::fs::write(&cut, &bytes[..bytes.len() - 8]).unwrap();
    for command in
        [&["weights", "inspect", text(&cut)][..], &["check", text(&cut)], &["weights", "convert", text(&cut), text(&back)]]
    {
        let output = renderflow(command);
        let said = stderr(&output) + &String::from_utf8_lossy(&output.stdout);
        assert!(output.status.code() == Some(1) && said.contains("cut off"), "{command:?}: {said}");
    }
}

fn sequences_are_rendered(folder: &Path, data: &Path, weights: &Weights) {
    let infer = |out: &Path, more: &[&str]| {
        let common = ["infer", "--data", text(data), "--weights", text(&weights.keys), "--vae", text(&weights.vae)];
        renderflow(&[&common[..], &["--out", text(out)], more].concat())
    };
    let [plain, keyed] = ["plain", "keyed"].map(|name| folder.join("infer").join(name));
    for (out, more) in [(&plain, &[][..]), (&keyed, &["--keyframes"])] {
        let output = infer(out, more);
        assert!(output.status.success(), "{}", stderr(&output));
    }
    let sequence = Sequence::open(&data.join("seq-000000")).unwrap();
    let read = |out: &Path, i: usize| {
        let frame = frame_file::read(&out.join(format!("seq-000000/frame.{i:04}.exr"))).unwrap();
        assert!(out.join(format!("seq-000000/frame.{i:04}.png")).is_file());
        frame.beauty.unwrap()
    };
    for i in 0..FRAMES {
        let (with, without) = (read(&keyed, i), read(&plain, i));
        assert_eq!((with.width, with.height), (SIDE, SIDE));
        // A network of two steps is hardly moved by keyframes; at theirs, they are returned (in the half precision of files).
        let display = |picture: &renderflow_frame::image::Rgb| picture.map(|p| color::display(*p, sequence.exposure()));
        let truth = sequence.frame(i).unwrap().beauty.unwrap();
        let near = |picture| display(picture).pixels.iter().zip(&display(&truth).pixels).all(|(a, b)| (a[0] - b[0]).abs() < 2e-3);
        assert_eq!((near(&with), near(&without)), (i % 4 == 0, false), "frame {i}");
    }
    // Complete: nothing is made again. Without its last frames: the same bytes, whatever is known of where it stopped.
    let before = files(&plain);
    assert!(!before.iter().any(|(name, _)| name.contains("stopped")), "the place of a stop is left behind");
    assert!(infer(&plain, &[]).status.success());
    assert!(files(&plain) == before);
    std::fs::remove_file(plain.join("seq-000000/frame.0006.exr")).unwrap();
    assert!(infer(&plain, &["--threads", "1"]).status.success());
    assert!(files(&plain) == before);
    // Stopped after its first clip, which is kept as it is and says how the next begins.
    let stopped = folder.join("infer/stopped");
    std::fs::create_dir_all(stopped.join("seq-000000")).unwrap();
    std::fs::copy(plain.join("infer.json"), stopped.join("infer.json")).unwrap();
    for i in 0..5 {
        std::fs::write(stopped.join(format!("seq-000000/frame.{i:04}.exr")), [i as u8]).unwrap();
    }
    let renderer = wan::open(&weights.keys, Autoencoder { file: Some(&weights.vae), tile: None }, &NetworkDevice::cpu()).unwrap();
    let mut session = renderer.begin(&sequence, Options::default()).unwrap();
    for index in 0..5 {
        let frame = sequence.frame(index).unwrap();
        session.push(View { number: index, index, frame: &frame, shaded: None }).unwrap();
    }
    let state = session.state().unwrap().encode().unwrap();
    std::fs::write(stopped.join("seq-000000/stopped.safetensors"), state).unwrap();
    assert!(infer(&stopped, &[]).status.success());
    for (name, bytes) in files(&stopped) {
        let kept = (0..5).find(|i| name.ends_with(&format!("frame.{i:04}.exr")));
        let expected = kept.map_or_else(|| std::fs::read(plain.join(&name)).unwrap(), |i| vec![i as u8]);
        assert!(bytes == expected, "{name}");
    }
    assert!(!stopped.join("seq-000000/stopped.safetensors").exists() && stopped.join("seq-000000/frame.0006.exr").exists());
    // Frames by themselves: those that are there are kept, whichever they are.
    let stills = folder.join("infer/stills");
    assert!(infer(&stills, &["--stills"]).status.success());
    let before = files(&stills);
    assert!((0..FRAMES).all(|i| read(&stills, i).pixels != read(&plain, i).pixels));
    std::fs::remove_file(stills.join("seq-000000/frame.0003.exr")).unwrap();
    std::fs::remove_file(stills.join("seq-000000/frame.0006.exr")).unwrap();
    assert!(infer(&stills, &["--stills"]).status.success());
    assert!(files(&stills) == before);
    let said = stderr(&infer(&stills, &[]));
    assert!(said.contains("other weights or options"), "{said}");
    // Other options do not mix in, nor does a folder of something else.
    let said = stderr(&infer(&plain, &["--steps", "2"]));
    assert!(said.contains("other weights or options"), "{said}");
    let said = stderr(&infer(data, &[]));
    assert!(said.contains("not empty"), "{said}");
    // Without the autoencoder nothing goes.
    let said = fail(&["infer", "--data", text(data), "--weights", text(&weights.keys), "--out", text(&folder.join("none"))]);
    assert!(said.contains("vae.safetensors"), "{said}");
    assert!(!folder.join("none").exists());
}

fn pictures_are_taken_apart(folder: &Path, data: &Path, weights: &Weights) {
    let photos = folder.join("photos");
    std::fs::create_dir_all(photos.join("more")).unwrap();
    for (name, side) in [("a.png", 40), ("b.jpg", 24), ("more/a.png", 16)] {
        image::RgbImage::from_fn(side, 20, |x, y| image::Rgb([8 * x as u8, 10 * y as u8, 90])).save(photos.join(name)).unwrap();
    }
    let invert = |more: &[&str]| {
        let common = ["invert", "--weights", text(&weights.inverse), "--vae", text(&weights.vae)];
        renderflow(&[&common[..], more].concat())
    };
    let out = folder.join("invert");
    let output = invert(&[text(&photos), "--exr", "--out", text(&out)]);
    assert!(output.status.success(), "{}", stderr(&output));
    let there = files(&out);
    assert_eq!(there.len(), 1 + 3 * 4 * 2, "{:?}", there.iter().map(|(name, _)| name).collect::<Vec<_>>());
    let picture = |name: &str| image::open(out.join(name)).unwrap();
    assert_eq!((picture("a.albedo.png").width(), picture("a.albedo.png").height()), (40, 20));
    assert_eq!(picture("more/a.depth.png").color(), image::ColorType::L16);
    let normals = renderflow_frame::exr::read_rgb(&out.join("b.normal.exr")).unwrap();
    let unit = |n: &[f32; 3]| (n.iter().map(|v| v * v).sum::<f32>() - 1.0).abs() < 1e-4;
    assert!(normals.width == 24 && normals.pixels.iter().all(unit));
    assert!(invert(&[text(&photos), "--exr", "--out", text(&out)]).status.success());
    assert!(files(&out) == there);
    let said = stderr(&invert(&[text(&photos), "--clip", "5", "--out", text(&folder.join("clips"))]));
    assert!(said.contains("24x20") && said.contains("40x20"), "{said}");

    let out = folder.join("invert-data");
    let output = invert(&["--data", text(data), "--only", "albedo,depth", "--clip", "5", "--out", text(&out)]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert_eq!(files(&out).len(), 1 + FRAMES * 2);
    // A frame that is not there, and one whose name leads out of the folder: nothing is written.
    let (damaged, nothing) = (folder.join("damaged"), folder.join("nothing"));
    for name in ["frame.0099.exr", "../seq-000000/frame.0001.exr"] {
        let _ = std::fs::remove_dir_all(&damaged);
        copy(data, &damaged);
        let transforms = damaged.join("seq-000000/transforms.json");
        let told = std::fs::read_to_string(&transforms).unwrap();
        std::fs::write(&transforms, told.replace("frame.0001.exr", name)).unwrap();
        let said = stderr(&invert(&["--data", text(&damaged), "--out", text(&nothing)]));
        assert!(said.contains("seq-000000") && !nothing.exists(), "{name}: {said}");
    }
    assert!(out.join("seq-000000/frame.0006.albedo.png").is_file());
    let (keys, vae) = (text(&weights.keys), text(&weights.vae));
    let said = fail(&["invert", text(&photos), "--weights", keys, "--vae", vae, "--out", text(&folder.join("none"))]);
    assert!(said.contains("no inverse adapter"), "{said}");
}

fn the_autoencoder_is_measured(folder: &Path, data: &Path, weights: &Weights) {
    let out = folder.join("measured-autoencoder");
    let said = succeed(&["evaluate", "autoencoder", "--vae", text(&weights.vae), "--data", text(data), "--out", text(&out)]);
    assert!(said.contains("sequences 1:") && said.contains("albedo"), "{said}");
    let read = |out: &Path| -> Value { serde_json::from_slice(&std::fs::read(out.join("autoencoder.json")).unwrap()).unwrap() };
    let results = read(&out);
    let sets = &results["sets"];
    let [still, clip] = [0, 1].map(|i| sets[0]["kinds"]["albedo"][i].as_array().unwrap());
    // The first frame of a clip is a picture by itself.
    assert!((still.len(), clip.len()) == (1, 5) && still[0] == clip[0] && clip[0] != clip[1], "{still:?} {clip:?}");
    // What was measured is named: the file of the weights, and every frame.
    let digest = blake3::hash(&std::fs::read(&weights.vae).unwrap()).to_hex().to_string();
    assert_eq!((&results["weights"], &results["frames"], &results["clips"]), (&json!([digest]), &json!(5), &json!(1)));
    let sequence = Sequence::open(&data.join("seq-000000")).unwrap();
    let all: Vec<usize> = (0..FRAMES).collect();
    let named: Vec<&Value> = results["data"].as_object().unwrap().values().collect();
    assert_eq!(named, [&json!(sequence.digest(&all).unwrap())]);
    // A folder stands for the weights inside it.
    let (inside, again) = (folder.join("published-vae"), folder.join("measured-inside"));
    std::fs::create_dir_all(&inside).unwrap();
    std::fs::copy(&weights.vae, inside.join("diffusion_pytorch_model.safetensors")).unwrap();
    succeed(&["evaluate", "autoencoder", "--vae", text(&inside), "--data", text(data), "--out", text(&again)]);
    assert_eq!(read(&again), results);
    let photo = folder.join("photo.png");
    image::RgbImage::from_pixel(16, 16, image::Rgb([90, 80, 70])).save(&photo).unwrap();
    let from = ["--weights", text(&weights.inverse), "--vae", text(&inside)];
    succeed(&[&["invert", text(&photo), "--out", text(&folder.join("inverted-inside"))][..], &from].concat());
    // Of sequences that are too short for a clip, none counts.
    let (short, out) = (folder.join("short"), folder.join("measured-short"));
    copy(&data.join("seq-000000"), &short.join("seq-000001"));
    let transforms = short.join("seq-000001/transforms.json");
    let mut told: Value = serde_json::from_slice(&std::fs::read(&transforms).unwrap()).unwrap();
    told["frames"].as_array_mut().unwrap().truncate(3);
    told["keyframes"] = json!([]);
    std::fs::write(&transforms, told.to_string()).unwrap();
    let evaluate = ["evaluate", "autoencoder", "--vae", text(&weights.vae), "--data", text(&short), "--out", text(&out)];
    let said = fail(&evaluate);
    assert!(said.contains("no sequence has 5 frames in a row") && !out.exists(), "{said}");
    copy(&data.join("seq-000000"), &short.join("seq-000000"));
    let output = renderflow(&evaluate);
    assert!(stderr(&output).contains("short: 1 sequence without 5 frames in a row left out"), "{}", stderr(&output));
    let alone = &read(&out)["sets"];
    assert_eq!((&alone[0]["sequences"], &alone[0]["left_out"]), (&json!(1), &json!(1)));
    assert_eq!((&alone[0]["kinds"], &sets[0]["left_out"]), (&sets[0]["kinds"], &json!(0)));
    let out = folder.join("measured-change");
    let more = ["--vae", text(&weights.vae), "--data", text(data), "--deferred", "--json", "--out", text(&out)];
    let results: Value = serde_json::from_str(&succeed(&[&["evaluate", "autoencoder"][..], &more].concat())).unwrap();
    let sets = &results["sets"];
    // The change from deferred shading loses less than the picture.
    let [picture, change] = ["target", "target as change"].map(|row| sets[0]["kinds"][row][0][0].as_f64().unwrap());
    assert!(change > picture + 1.0 && sets[0]["kinds"]["deferred"][1][4].is_number(), "{sets}");
}

/// By the network itself, and from the pictures it wrote.
fn recovered_buffers_are_measured(folder: &Path, data: &Path, Weights { vae, keys, inverse }: &Weights) {
    let (out, written) = (folder.join("measured-inverse"), folder.join("invert-all"));
    let from = ["--weights", text(inverse), "--vae", text(vae)];
    let evaluate = |from: &[&str], out: &Path| {
        succeed(&[&["evaluate", "inverse", "--data", text(data), "--every", "3", "--out", text(out)][..], from].concat());
        let results: Value = serde_json::from_slice(&std::fs::read(out.join("inverse.json")).unwrap()).unwrap();
        assert_eq!(results["sets"][0]["frames"], (0..FRAMES).filter(|frame| frame % 3 < 2).count());
        results["sets"][0]["rows"].clone()
    };
    let rows = evaluate(&from, &out);
    let (network, start) = (&rows[0], &rows[1]);
    assert!(network["seconds"].as_f64().unwrap() > 0.0 && start["seconds"].is_null());
    succeed(&[&["invert", "--data", text(data), "--out", text(&written)][..], &from].concat());
    let rows = evaluate(&["--buffers", text(&written)], &out.join("buffers"));
    assert_eq!((&rows[0]["method"], &rows[1]["values"]), (&json!("buffers"), &start["values"]));
    let mean = |row: &Value, id: &str| row["values"][id]["mean"].as_f64().unwrap();
    // 8 bits a value.
    for (id, within) in [
        ("albedo_psnr", 0.1),
        ("albedo_psnr_scaled", 0.1),
        ("normal_mean", 1.0),
        ("depth_relative", 0.01),
        ("roughness_rms", 0.003),
        ("metallic_rms", 0.003),
    ] {
        let [a, b] = [network, &rows[0]].map(|row| mean(row, id));
        // Depth that is inside out counts as none, and this network knows next to nothing.
        let differs = id == "depth_relative" || a != mean(start, id);
        assert!((a - b).abs() < within && differs, "{id}: {a} and {b}");
    }
    let none = folder.join("measured-nothing");
    let evaluate = ["evaluate", "inverse", "--data", text(data), "--out", text(&none)];
    let said = fail(&[&evaluate[..], &["--weights", text(keys), "--vae", text(vae)]].concat());
    assert!(said.contains("no inverse adapter"), "{said}");
    let said = fail(&[&evaluate[..], &["--buffers", text(folder)]].concat());
    assert!(said.contains("no buffers of any frame") && !none.exists(), "{said}");
}

/// A network that has learnt next to nothing returns deferred shading: in an evaluation and in files, stopped or not.
fn the_bridge_begins_with_deferred_shading(folder: &Path, data: &Path, weights: &Weights) {
    let path = folder.join("deferred.json");
    let preset = ["--preset", "wan-tiny", "--stage", "base", "--vae", text(&weights.vae), "--steps", "1", "--print-config"];
    let print = [&["train", "--data", text(data), "--out", "runs/out"][..], &preset].concat();
    let mut config: Value = serde_json::from_str(&succeed(&print)).unwrap();
    config["stage"]["base"]["network"]["bridge_start"] = json!("deferred");
    std::fs::write(&path, config.to_string()).unwrap();
    let run = folder.join("deferred");
    succeed(&["train", "--config", text(&path), "--data", text(data), "--out", text(&run)]);
    let network = run.join("weights.safetensors");
    let from = ["--data", text(data), "--weights", text(&network), "--vae", text(&weights.vae)];
    let out = folder.join("results-deferred");
    succeed(&[&["evaluate", "--methods", "deferred,wan,wan-stills", "--out", text(&out)][..], &from].concat());
    let scores = Results::read(&out).unwrap().sequences.remove(0).scores;
    let of = |method: &str| scores.iter().filter(|s| s.method == method).map(|s| s.values["psnr"]).collect::<Vec<_>>();
    for method in ["wan", "wan-stills"] {
        assert_eq!(of(method).len(), of("deferred").len());
        let far = of(method).iter().zip(of("deferred")).fold(0.0f64, |worst, (a, b)| worst.max((a - b).abs()));
        assert!(far < 0.3, "{method}: {:?} and {:?}", of(method), of("deferred"));
    }
    let pictures = folder.join("infer/deferred");
    let infer = |more: &[&str]| succeed(&[&["infer", "--out", text(&pictures)][..], &from, more].concat());
    infer(&[]);
    let before = files(&pictures);
    std::fs::remove_file(pictures.join("seq-000000/frame.0005.exr")).unwrap();
    infer(&[]);
    assert!(files(&pictures) == before, "a resumed run makes other pictures");
    // Each file shows its own frame.
    let sequence = Sequence::open(&data.join("seq-000000")).unwrap();
    let error = |made: usize, truth: usize| {
        let path = pictures.join(format!("seq-000000/frame.{made:04}.exr"));
        let (made, truth) = (frame_file::read(&path).unwrap().beauty.unwrap(), sequence.frame(truth).unwrap().beauty.unwrap());
        let display = |pixel: [f32; 3]| color::display(pixel, sequence.exposure());
        let pairs = made.pixels.iter().zip(&truth.pixels).map(|(a, b)| (display(*a), display(*b)));
        pairs.map(|(a, b)| (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2) + (a[2] - b[2]).powi(2)).sum::<f32>()
    };
    for (own, other) in [(0, FRAMES - 1), (FRAMES - 1, 0)] {
        assert!(error(own, own) < error(own, other), "frame {own}: {} and {}", error(own, own), error(own, other));
    }
    carried_keyframes_come_first(folder, data, weights, &network);
    // Another scene is not shaded, and without a scene there is nothing to begin with.
    let bare = folder.join("bare");
    copy(&data.join("seq-000000"), &bare.join("seq-000000"));
    let scene = bare.join("seq-000000/scene.json");
    let mut other: Value = serde_json::from_slice(&std::fs::read(&scene).unwrap()).unwrap();
    other["seed"] = json!(12345);
    std::fs::write(&scene, other.to_string()).unwrap();
    let without = ["--data", text(&bare), "--weights", text(&network), "--vae", text(&weights.vae)];
    let said = fail(&[&["infer", "--out", text(&folder.join("infer/other"))][..], &without].concat());
    assert!(said.contains("frame 0 is of another scene than scene.json"), "{said}");
    std::fs::remove_file(&scene).unwrap();
    let said = fail(&[&["infer", "--out", text(&folder.join("infer/bare"))][..], &without].concat());
    assert!(said.contains("begins with deferred shading"), "{said}");
}

/// With keyframes, a network that has learnt next to nothing returns keyframes carried over deferred shading.
fn carried_keyframes_come_first(folder: &Path, data: &Path, weights: &Weights, base: &Path) {
    let (path, run) = (folder.join("carried.json"), folder.join("carried"));
    let stage = ["--preset", "wan-tiny", "--stage", "keyframes", "--vae", text(&weights.vae), "--base", text(base)];
    let print = [&["train", "--data", text(data), "--out", "runs/out", "--steps", "1", "--print-config"][..], &stage].concat();
    let mut config: Value = serde_json::from_str(&succeed(&print)).unwrap();
    config["stage"]["keyframes"]["gap"] = json!(4);
    std::fs::write(&path, config.to_string()).unwrap();
    succeed(&["train", "--config", text(&path), "--data", text(data), "--out", text(&run)]);
    let network = run.join("weights.safetensors");
    let from = ["--data", text(data), "--weights", text(&network), "--vae", text(&weights.vae)];
    let out = folder.join("results-carried");
    let methods = ["evaluate", "--methods", "deferred,wan-stills,warp,wan+keys,wan-stills+keys", "--out", text(&out)];
    succeed(&[&methods[..], &from].concat());
    let scores = Results::read(&out).unwrap().sequences.remove(0).scores;
    let keys: Vec<usize> = scores.iter().filter(|score| score.key).map(|score| score.frame).collect();
    let of = |method: &str| -> Vec<f64> {
        let rows = scores.iter().filter(|score| score.method == method && !keys.contains(&score.frame));
        rows.map(|score| score.values["psnr"]).collect()
    };
    assert_eq!(of("warp").len(), FRAMES - 2);
    for (method, begins) in [("wan-stills", "deferred"), ("wan+keys", "warp"), ("wan-stills+keys", "warp")] {
        let far = of(method).iter().zip(of(begins)).fold(0.0f64, |worst, (a, b)| worst.max((a - b).abs()));
        assert!(far < 0.3 && of(method).len() == of(begins).len(), "{method}: {:?} and {:?}", of(method), of(begins));
    }
    assert!(of("warp").iter().zip(of("deferred")).any(|(a, b)| (a - b).abs() > 0.6), "keyframes change nothing here");
    // So do files.
    let pictures = folder.join("infer/carried");
    let infer = || succeed(&[&["infer", "--keyframes", "--out", text(&pictures)][..], &from].concat());
    infer();
    let before = files(&pictures);
    std::fs::remove_file(pictures.join("seq-000000/frame.0005.exr")).unwrap();
    infer();
    assert!(files(&pictures) == before, "a resumed run makes other pictures");
    let sequence = Sequence::open(&data.join("seq-000000")).unwrap();
    // Their order does not matter.
    let keys: Vec<usize> = sequence.transforms.keyframes.iter().rev().copied().collect();
    let mut shading = Shading::new(&sequence, &[], &keys).unwrap();
    // So does what training begins with.
    let learnt = |gap| Dataset::open(data).unwrap().shaded(&[], gap).load(0).unwrap().shaded;
    let (carried, alone) = (learnt(Some(4)), learnt(None));
    for index in 0..FRAMES {
        let stored = sequence.frame(index).unwrap();
        let begun = shading.picture(index, &stored).unwrap();
        assert!(begun == carried[index] && begun != alone[index], "frame {index}");
        let made = frame_file::read(&pictures.join(format!("seq-000000/frame.{index:04}.exr"))).unwrap().beauty.unwrap();
        let display = |pixel: [f32; 3]| color::display(pixel, sequence.exposure());
        let covered = || (0..SIDE * SIDE).filter(|&i| stored.alpha.pixels[i] >= 1.0);
        let far = |i: usize| (0..3).map(|c| (display(made.pixels[i])[c] - display(begun.pixels[i])[c]).abs()).sum::<f32>() / 3.0;
        let mean = covered().map(far).sum::<f32>() / covered().count() as f32;
        assert!(mean < 0.02, "frame {index}: {mean}");
    }
}

fn rows_stand_beside_the_others(folder: &Path, data: &Path, weights: &Weights) {
    let out = folder.join("results");
    let (keys, vae) = (text(&weights.keys), text(&weights.vae));
    let evaluate_with = |out: &Path, every: &str, more: &[&str]| {
        let what = ["evaluate", "--data", text(data), "--methods", METHODS, "--every", every, "--out", text(out)];
        renderflow(&[&what[..], &["--weights", keys, "--vae", vae], more].concat())
    };
    let evaluate = |out: &Path, every: &str| {
        let output = evaluate_with(out, every, &[]);
        assert!(output.status.success(), "{}", stderr(&output));
        String::from_utf8(output.stdout).unwrap()
    };
    let table = evaluate(&out, "1");
    for row in ["IBL (split sum)", "neural", "wan", "wan + keyframes", "wan, frame by frame", "wan, frame by frame + keyframes"] {
        assert!(table.contains(row), "{row} missing in\n{table}");
    }
    let scores = |out: &Path| Results::read(out).unwrap().sequences.remove(0).scores;
    let all = scores(&out);
    assert_eq!(all.len(), FRAMES * 6);
    for score in &all {
        let psnr = score.values.get("psnr").copied();
        assert!(psnr.is_some_and(f64::is_finite) && score.seconds.is_some_and(|s| s > 0.0), "{score:?}");
        assert_eq!(
            psnr == Some(100.0),
            score.key && score.method.starts_with("wan") && score.method.ends_with("+keys"),
            "{score:?}"
        );
    }
    let of = |method: &str| all.iter().filter(|s| s.method == method).map(|s| s.values.get("psnr").copied()).collect::<Vec<_>>();
    assert!(of("wan").len() == FRAMES && of("wan") != of("wan-stills") && of("wan+keys") != of("wan-stills+keys"));
    // The networks see the whole sequence whichever frames are evaluated.
    let some = folder.join("some");
    evaluate(&some, "3");
    for score in scores(&some).iter().filter(|score| score.method.starts_with("wan")) {
        let same = all.iter().find(|other| other.method == score.method && other.frame == score.frame).unwrap();
        assert_eq!(score.values.get("psnr"), same.values.get("psnr"), "frame {}", score.frame);
    }
    // More steps make other pictures by the paper's network, and by no other; they do not mix with those of one step.
    let steps = folder.join("steps");
    assert!(evaluate_with(&steps, "3", &["--steps", "3"]).status.success());
    for (three, one) in scores(&steps).iter().zip(scores(&some)) {
        let known = three.values.get("psnr") == Some(&100.0);
        assert_eq!(three.values.get("psnr") != one.values.get("psnr"), one.method.starts_with("wan") && !known, "{one:?}");
    }
    assert!(stderr(&evaluate_with(&some, "3", &["--steps", "3"])).contains("other methods or settings"));
    let said = fail(&["evaluate", "--data", text(data), "--methods", "wan", "--out", text(&folder.join("none"))]);
    assert!(said.contains("--weights"), "{said}");
    let twice = ["--weights", keys, "--weights", text(&weights.inverse), "--vae", vae];
    let said = fail(&[&["evaluate", "--data", text(data), "--out", text(&folder.join("none"))][..], &twice].concat());
    assert!(said.contains("two networks of this kind"), "{said}");
}
