//! What is refused leaves every file as it was, and nothing is replaced or removed that this program did not make.

mod common;

use common::{renderflow, stderr, succeed};
use std::path::{Path, PathBuf};

/// Every file and folder below `folder`; files with their bytes.
fn tree(folder: &Path) -> Vec<(String, Option<Vec<u8>>)> {
    let (mut found, mut open) = (Vec::new(), vec![folder.to_owned()]);
    while let Some(inside) = open.pop() {
        for entry in std::fs::read_dir(&inside).unwrap() {
            let path = entry.unwrap().path();
            let name = path.strip_prefix(folder).unwrap().to_string_lossy().into_owned();
            if path.is_dir() {
                found.push((name, None));
                open.push(path);
            } else {
                found.push((name, Some(std::fs::read(&path).unwrap())));
            }
        }
    }
    found.sort();
    found
}

/// Runs a command that must fail, say every one of `words`, and change nothing below `folder`. Returns what it said.
fn refused(folder: &Path, arguments: &[&str], words: &[&str]) -> String {
    let before = tree(folder);
    let output = renderflow(arguments);
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{arguments:?}: {said}");
    for word in words {
        assert!(said.contains(word), "{arguments:?}: {said:?} does not say {word:?}");
    }
    let after = tree(folder);
    let differs = |(name, bytes): &(String, Option<Vec<u8>>)| !before.iter().any(|(n, b)| n == name && b == bytes);
    let changed: Vec<&String> = after.iter().filter(|file| differs(file)).map(|(name, _)| name).collect();
    assert!(changed.is_empty() && before.len() == after.len(), "{arguments:?} changed {changed:?}: {said}");
    said
}

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self) -> &Path {
        self.0.path()
    }

    fn at(&self, name: &str) -> String {
        self.path().join(name).to_str().unwrap().to_owned()
    }

    fn put(&self, name: &str, content: &str) -> String {
        let path = self.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, content).unwrap();
        self.at(name)
    }

    fn bytes(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.path().join(name)).unwrap()
    }
}

/// A dataset of 4 sequences of 2 frames, rendered once, with its plan beside it.
fn dataset() -> (&'static Path, &'static Path) {
    static DATASET: std::sync::OnceLock<(tempfile::TempDir, PathBuf, PathBuf)> = std::sync::OnceLock::new();
    let (_, plan, data) = DATASET.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let (plan, data) = (folder.path().join("plan.json"), folder.path().join("data"));
        plan_to(plan.to_str().unwrap(), "8", &[]);
        succeed(&["dataset", "render", "--plan", plan.to_str().unwrap(), "--out", data.to_str().unwrap()]);
        (folder, plan, data)
    });
    (plan, data)
}

fn plan_words<'a>(out: &'a str, seed: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    let counts = ["--sequences", "4", "--frames", "2", "--resolution", "24", "--spp", "2", "--keyframe-gap", "2"];
    let small = ["--mesh-count", "8", "--environment-count", "4", "--denoise", "none"];
    [&["dataset", "plan", "--seed", seed, "--out", out][..], &counts, &small, more].concat()
}

fn plan_to(out: &str, seed: &str, more: &[&str]) {
    succeed(&plan_words(out, seed, more));
}

fn copy(from: &Path, to: &Path) {
    for (name, bytes) in tree(from) {
        match bytes {
            None => std::fs::create_dir_all(to.join(name)).unwrap(),
            Some(bytes) => {
                let path = to.join(name);
                std::fs::create_dir_all(path.parent().unwrap()).unwrap();
                std::fs::write(path, bytes).unwrap();
            }
        }
    }
}

fn render<'a>(out: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    [&["render", "--denoise", "none", "--out", out][..], more].concat()
}

#[test]
fn render_tells_changed_files_of_a_scene_apart() {
    let folder = Folder::new();
    let (model, picture, out) = (folder.at("corner.obj"), folder.at("paint.png"), folder.at("oo"));
    // The bounds stay, so that the scene around the model does.
    let corner = |at: u32| format!("mtllib corner.mtl\nusemtl paint\nv {at} {at} 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\n");
    let paint = |value: u8| image::RgbImage::from_pixel(2, 2, image::Rgb([value, 90, 20])).save(&picture).unwrap();
    std::fs::write(&model, corner(0)).unwrap();
    std::fs::write(folder.at("corner.mtl"), "newmtl paint\nmap_Kd paint.png\n").unwrap();
    paint(200);
    let small = ["--scene", &model, "--resolution", "8", "--spp", "1", "--frames", "2"];
    let again = render(&out, &small);
    succeed(&again);
    let first = folder.bytes("oo/frame.0000.exr");
    let words = ["frame.0000.exr: was rendered before files that the scene names changed", "--overwrite"];
    std::fs::write(&model, corner(1)).unwrap();
    let said = refused(folder.path(), &again, &words);
    assert!(!said.contains("another scene") && !said.contains("settings"), "{said}");
    refused(
        folder.path(),
        &[&again[..], &["--adaptive"]].concat(),
        &[words[0], "and is of other settings: the number of samples"],
    );
    std::fs::write(&model, corner(0)).unwrap();
    paint(201);
    refused(folder.path(), &again, &words);
    // With the old content it goes on, and the same content elsewhere is the same.
    paint(200);
    std::fs::remove_file(folder.at("oo/frame.0000.exr")).unwrap();
    succeed(&again);
    assert!(folder.bytes("oo/frame.0000.exr") == first);
    paint(201);
    succeed(&[&again[..], &["--overwrite"]].concat());
    assert!(folder.bytes("oo/frame.0000.exr") != first);
}

#[test]
fn render_says_what_differs_and_overwrites_only_when_asked() {
    let folder = Folder::new();
    let (scene, out) = (folder.at("scene.json"), folder.at("oo"));
    succeed(&["compose", "--seed", "7", "--out", &scene]);
    let first = ["--scene", &scene, "--resolution", "24", "--spp", "4", "--frames", "2"];
    succeed(&render(&out, &first));
    // Another size and length: the descriptions of the frames that are there stay theirs.
    let second = ["--scene", &scene, "--resolution", "16", "--spp", "8", "--frames", "1"];
    let said = refused(
        folder.path(),
        &render(&out, &second),
        &["frame.0000.exr: is of another scene", "/frames was 2, now 1", "/resolution/0 was 24, now 16", "--overwrite"],
    );
    assert!(said.contains("other settings: the number of samples was 4 in every pixel, now 8 in every pixel"), "{said}");
    // Settings alone: what differs is named, what does not is not.
    let adaptive = [&first[..], &["--adaptive"]].concat();
    let said = refused(folder.path(), &render(&out, &adaptive), &["the number of samples was 4 in every pixel, now average 4"]);
    assert!(!said.contains("BRDF") && !said.contains("denoiser") && !said.contains("another scene"), "{said}");
    let keyframes = [&first[..], &["--keyframe-gap", "1"]].concat();
    refused(folder.path(), &render(&out, &keyframes), &["transforms.json: /keyframes: were [0], now [0, 1]", "--overwrite"]);

    // Replaced: the same files as in a folder of its own; what is no part of it is named.
    let overwriting = [&second[..], &["--overwrite"]].concat();
    let said = stderr(&renderflow(&render(&out, &overwriting)));
    assert!(said.contains("frame.0001.exr to frame.0001.exr of the earlier render stay there"), "{said}");
    let other = folder.at("other");
    succeed(&render(&other, &second));
    for name in ["frame.0000.exr", "frame.0000.png", "scene.json", "transforms.json", "env.hdr"] {
        assert!(folder.bytes(&format!("oo/{name}")) == folder.bytes(&format!("other/{name}")), "{name}");
    }
    // Once more with --overwrite: nothing is rendered again.
    let before = std::fs::metadata(folder.path().join("oo/frame.0000.exr")).unwrap().modified().unwrap();
    succeed(&render(&out, &overwriting));
    assert_eq!(std::fs::metadata(folder.path().join("oo/frame.0000.exr")).unwrap().modified().unwrap(), before);
    // A folder that was begun, without a frame: it is another scene's all the same.
    std::fs::remove_file(folder.path().join("other/frame.0000.exr")).unwrap();
    refused(folder.path(), &render(&other, &first), &["scene.json: is of another scene", "/frames was 1, now 2"]);
}

#[test]
fn render_replaces_no_file_of_others() {
    let folder = Folder::new();
    let scene = folder.at("scene.json");
    succeed(&["compose", "--seed", "7", "--resolution", "16", "--frames", "1", "--out", &scene]);
    for (name, content) in [
        ("a/scene.json", "{\"name\": \"of another program\"}"),
        ("b/transforms.json", "{\"frames\": []}"),
        ("c/env.hdr", "my map"),
        ("d/frame.0000.png", "my picture"),
        ("e/frame.0000.exr", "my picture"),
        ("f/timing.json", "[]"),
    ] {
        folder.put(name, content);
        let out = folder.at(&name[..1]);
        for more in [&["--scene", &scene, "--spp", "1"][..], &["--scene", &scene, "--spp", "1", "--overwrite"]] {
            refused(folder.path(), &render(&out, more), &[name, "choose another folder"]);
        }
    }
    // The scene may lie where its render goes, and other files do not matter.
    std::fs::create_dir(folder.path().join("own")).unwrap();
    std::fs::copy(&scene, folder.path().join("own/scene.json")).unwrap();
    folder.put("own/notes.txt", "mine");
    succeed(&render(&folder.at("own"), &["--scene", &folder.at("own/scene.json"), "--spp", "1"]));
    assert_eq!(folder.bytes("own/notes.txt"), b"mine");
    // A picture of another program in the place of a frame, in a folder of this program: it is no broken frame.
    common::write_map(&folder.path().join("own/frame.0000.exr"), |_, _| 0.5);
    let again = ["--scene", &scene, "--spp", "1", "--overwrite"];
    refused(folder.path(), &render(&folder.at("own"), &again), &["frame.0000.exr", "not a frame of this program"]);
    // A sequence of a dataset is no render of a scene.
    let data = folder.path().join("data");
    copy(dataset().1, &data);
    let sequence = data.join("train/seq-000000");
    refused(folder.path(), &render(sequence.to_str().unwrap(), &again), &["sequence of a dataset"]);
}

#[test]
fn samples_beyond_the_range_are_refused_before_anything_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let output = renderflow(&["render", "--seed", "3", "--spp", "16777217", "--out", out.to_str().unwrap()]);
    let said = stderr(&output);
    assert!(output.status.code() == Some(2) && said.contains("16777217 is not in 1..=16777216"), "{said}");
    assert!(!out.exists());
}

#[test]
fn a_cut_frame_is_rendered_again() {
    let folder = Folder::new();
    let out = folder.at("out");
    let words = render(&out, &["--seed", "3", "--frames", "2", "--resolution", "16", "--spp", "2"]);
    succeed(&words);
    let whole = folder.bytes("out/frame.0001.exr");
    let kept = std::fs::metadata(folder.path().join("out/frame.0000.exr")).unwrap().modified().unwrap();
    std::fs::write(folder.path().join("out/frame.0001.exr"), &whole[..whole.len() / 2]).unwrap();
    let output = renderflow(&words);
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(
        stderr(&output).contains("note: rendered again:") && stderr(&output).contains("frame.0001.exr"),
        "{}",
        stderr(&output)
    );
    assert!(folder.bytes("out/frame.0001.exr") == whole);
    assert_eq!(std::fs::metadata(folder.path().join("out/frame.0000.exr")).unwrap().modified().unwrap(), kept);
}

#[test]
fn datasets_of_other_plans_stay() {
    let folder = Folder::new();
    let (plan, data) = dataset();
    copy(data, &folder.path().join("data"));
    let other = folder.at("other.json");
    plan_to(&other, "9", &[]);
    refused(folder.path(), &["dataset", "render", "--plan", &other, "--out", &folder.at("data")], &["plan.json", "another plan"]);
    // An edited plan stays; the same plan is no other file; replaced when asked.
    let edited = folder.put("plan.json", &std::fs::read_to_string(plan).unwrap().replace("\"frames\": 2", "\"frames\": 3"));
    refused(folder.path(), &plan_words(&edited, "8", &[]), &["plan.json: already exists", "--overwrite"]);
    succeed(&plan_words(&edited, "8", &["--overwrite"]));
    assert_eq!(folder.bytes("plan.json"), std::fs::read(plan).unwrap());
    succeed(&plan_words(&edited, "8", &[]));
    let toml = folder.put("plan.toml", "# mine\n");
    refused(folder.path(), &plan_words(&toml, "8", &[]), &["plan.toml: already exists"]);
}

#[test]
fn composed_scenes_and_maps_and_scripts_are_not_replaced() {
    let folder = Folder::new();
    let scene = folder.put("scene.json", "{}");
    let compose = ["compose", "--seed", "7", "--out", &scene];
    refused(folder.path(), &compose, &["scene.json: already exists", "--overwrite"]);
    succeed(&[&compose[..], &["--overwrite"]].concat());
    succeed(&compose);
    folder.put("hdri/overcast.hdr", "my map");
    folder.put("hdri/manifest.json", "mine");
    let hdri = folder.at("hdri");
    refused(folder.path(), &["hdri", "--out", &hdri], &["already exists", "--overwrite"]);

    let plan = dataset().0.to_str().unwrap();
    let (jobs, data) = (folder.at("jobs"), folder.at("data"));
    let slurm = ["dataset", "slurm", "--plan", plan, "--out", &data, "--script-dir", &jobs, "--program", "renderflow"];
    succeed(&slurm);
    succeed(&slurm);
    folder.put("jobs/submit.sh", "#!/bin/sh\necho mine\n");
    std::fs::remove_file(folder.path().join("jobs/array.sh")).unwrap();
    refused(folder.path(), &slurm, &["submit.sh: already exists", "--overwrite"]);
    succeed(&[&slurm[..], &["--overwrite"]].concat());
    assert!(folder.path().join("jobs/array.sh").is_file());

    let previews = folder.at("previews");
    folder.put("previews/meshes.png", "my picture");
    refused(
        folder.path(),
        &["dataset", "preview", "--plan", plan, "--out", &previews, "--count-only"],
        &["meshes.png", "not part of a preview"],
    );
    let own = folder.at("own");
    for _ in 0..2 {
        succeed(&["dataset", "preview", "--plan", plan, "--out", &own, "--count-only"]);
    }
    let counted: serde_json::Value = serde_json::from_slice(&folder.bytes("own/catalog.json")).unwrap();
    assert!(counted["distinct_meshes"].as_u64().is_some_and(|n| n > 0));
    // Pictures without the count: each sequence is shown once, and every picture has a label.
    let shown = folder.at("shown");
    succeed(&["dataset", "preview", "--plan", plan, "--out", &shown, "--size", "16", "--spp", "1"]);
    let known: serde_json::Value = serde_json::from_slice(&folder.bytes("shown/catalog.json")).unwrap();
    assert!(known["distinct_meshes"].is_null() && known["meshes"] == counted["meshes"]);
    let plan: serde_json::Value = serde_json::from_slice(&std::fs::read(plan).unwrap()).unwrap();
    let sequences: u64 = ["train", "val", "test"].iter().map(|split| plan["sequences"][split].as_u64().unwrap()).sum();
    let scenes = image::load_from_memory(&folder.bytes("shown/scenes.png")).unwrap();
    assert_eq!((scenes.width(), scenes.height()), (8 + sequences as u32 * (224 + 8), 8 + 20 + 224 + 8));
    let page = folder.put("page.html", "<html>mine</html>");
    let numbers = ["dataset", "stats", dataset().1.to_str().unwrap(), "--out", &page];
    refused(folder.path(), &numbers, &["page.html", "not a page of this program"]);
    std::fs::remove_file(&page).unwrap();
    succeed(&numbers);
    succeed(&numbers);
    let results = folder.put("stress.json", "{\"mine\": 1}");
    refused(folder.path(), &["stress", "--quick", "--only", "film", "--out", &results], &["not the results of an earlier run"]);
}

#[test]
fn converted_weights_replace_no_other_file() {
    let folder = Folder::new();
    let shipped = concat!(env!("CARGO_MANIFEST_DIR"), "/model/weights/fusion.safetensors");
    let out = folder.put("w.safetensors", "mine");
    for (precision, others) in [("f16", "f32"), ("f32", "f16")] {
        let convert = ["weights", "convert", shipped, &out, "--precision", precision];
        refused(folder.path(), &convert, &["w.safetensors: already exists", "--overwrite"]);
        succeed(&[&convert[..], &["--overwrite"]].concat());
        let before = std::fs::metadata(&out).unwrap().modified().unwrap();
        succeed(&convert);
        assert_eq!(std::fs::metadata(&out).unwrap().modified().unwrap(), before, "the same bytes were written again");
        refused(folder.path(), &["weights", "convert", shipped, &out, "--precision", others], &["already exists"]);
    }
}

#[test]
fn exports_keep_away_from_their_dataset_and_from_other_files() {
    let folder = Folder::new();
    let data = folder.path().join("sets/data");
    copy(dataset().1, &data);
    let data = data.to_str().unwrap();
    let sequence = format!("{data}/train/seq-000000");
    #[cfg(unix)]
    std::os::unix::fs::symlink("data", folder.path().join("sets/link")).unwrap();
    for form in ["nerfstudio", "cosmos", "png", "coco"] {
        for from in [data, &sequence] {
            for (out, word) in [
                (data.to_owned(), "is the folder of"),
                (format!("{data}/new/nerf"), "is inside of"),
                (format!("{data}/new/../train"), "is inside of"),
                (folder.at("sets"), "is above"),
                (folder.at("sets/link"), if cfg!(unix) { "is the folder of" } else { "" }),
            ] {
                if !word.is_empty() {
                    refused(
                        folder.path(),
                        &["dataset", "export", from, "--to", form, "--out", &out],
                        &[word, "choose another folder"],
                    );
                }
            }
        }
    }
    // Another dataset, and files of anybody's.
    let other = folder.path().join("other");
    copy(dataset().1, &other);
    folder.put("mine/notes.txt", "mine");
    for out in ["other", "mine"] {
        refused(
            folder.path(),
            &["dataset", "export", data, "--to", "nerfstudio", "--out", &folder.at(out)],
            &["not empty", "export.json"],
        );
    }
    let out = folder.at("coco");
    for from in [&sequence, data] {
        succeed(&["dataset", "export", from, "--to", "coco", "--out", &out]);
    }
    refused(folder.path(), &["dataset", "export", data, "--to", "png", "--out", &out], &["export.json", "files of another form"]);
    // G-buffers alone are no pictures: found out before the first file.
    let bare = folder.at("bare");
    plan_to(&folder.at("bare.json"), "8", &["--between-spp", "0"]);
    succeed(&["dataset", "render", "--plan", &folder.at("bare.json"), "--out", &bare]);
    refused(folder.path(), &["dataset", "export", &bare, "--to", "cosmos", "--out", &folder.at("c")], &["has no beauty"]);
}

#[test]
fn networks_write_into_folders_of_their_own() {
    let folder = Folder::new();
    let data = folder.path().join("data");
    copy(dataset().1, &data);
    let train = data.join("train");
    let train = train.to_str().unwrap();
    folder.put("mine/notes.txt", "mine");
    let (mine, out) = (folder.at("mine"), folder.at("out"));
    refused(folder.path(), &["infer", "--data", train, "--out", &mine], &["not empty", "infer.json"]);
    // A frame that is not there, and one whose name leads out of the folder.
    let transforms = data.join("train/seq-000003/transforms.json");
    let text = std::fs::read_to_string(&transforms).unwrap();
    for (name, word) in [("frame.0007.exr", "is not there"), ("../seq-000000/frame.0001.exr", "not the plain name of a file")] {
        std::fs::write(&transforms, text.replace("frame.0001.exr", name)).unwrap();
        refused(folder.path(), &["infer", "--data", train, "--out", &out], &["seq-000003", word]);
    }
    std::fs::write(&transforms, &text).unwrap();
    refused(folder.path(), &["invert", &mine, "--out", &out], &["no picture"]);
    // Frames are smaller than the crops: no folder, no empty log.
    refused(
        folder.path(),
        &["train", "--data", train, "--steps", "1", "--out", &out],
        &["smaller than the crop", "--print-config", "--config run.json"],
    );
    // Somebody's log and weights; the folder of a run has a checkpoint.
    let options = folder.at("options.json");
    common::write_training(Path::new(&options), 1);
    let smaller = std::fs::read_to_string(&options).unwrap().replace("\"size\":32", "\"size\":16");
    std::fs::write(&options, smaller).unwrap();
    for (name, words) in [("logs/log.jsonl", "not a training log"), ("weights/weights.safetensors", "no checkpoint")] {
        folder.put(name, "mine\n");
        let out = folder.at(name.split('/').next().unwrap());
        let command = ["train", "--config", &options, "--data", train, "--out", &out];
        refused(folder.path(), &command, &[name, words, "choose another"]);
    }
}

#[test]
fn results_and_reports_are_not_mixed_with_other_files() {
    let folder = Folder::new();
    let data = folder.path().join("data");
    copy(dataset().1, &data);
    let sequence = data.join("train/seq-000000");
    let (sequence, results) = (sequence.to_str().unwrap(), folder.at("results"));
    folder.put("mine/notes.txt", "mine");
    let mine = folder.at("mine");
    refused(folder.path(), &["evaluate", "--data", sequence, "--methods", "ibl", "--out", &mine], &["not empty", "results.json"]);
    refused(folder.path(), &["evaluate", sequence, sequence, "--out", &mine], &["not empty", "results.json"]);
    // Pictures of another size: nothing is written before the first sequence is through.
    image::RgbImage::new(8, 8).save(folder.put("small/frame.0000.png", "")).unwrap();
    let small = ["evaluate", &folder.at("small"), sequence, "--partial", "--out", &results];
    refused(folder.path(), &small, &["8 x 8"]);
    // Truth without a picture: the record says so.
    let bare = folder.at("bare");
    plan_to(&folder.at("bare.json"), "8", &["--between-spp", "0"]);
    succeed(&["dataset", "render", "--plan", &folder.at("bare.json"), "--out", &bare]);
    refused(folder.path(), &["evaluate", "--data", &bare, "--methods", "ibl", "--out", &results], &["frame 1 has no beauty"]);

    succeed(&["evaluate", sequence, sequence, "--out", &results]);
    succeed(&["evaluate", sequence, sequence, "--out", &results]);
    refused(
        folder.path(),
        &["evaluate", sequence, sequence, "--label", "x", "--out", &results],
        &["results.json", "other pictures or settings"],
    );
    refused(
        folder.path(),
        &["evaluate", "--data", sequence, "--methods", "ibl", "--out", &results],
        &["other methods or settings"],
    );

    // The record of a downloaded sequence names the folder its results go into.
    let record = data.join("train/seq-000000/sequence.json");
    let text = std::fs::read_to_string(&record).unwrap();
    let layout = serde_json::from_str::<serde_json::Value>(&text).unwrap()["layout"].to_string();
    std::fs::write(&record, text.replace(&format!("\"layout\": {layout}"), "\"layout\": \"../../../escaped\"")).unwrap();
    assert_ne!(std::fs::read_to_string(&record).unwrap(), text);
    let deep = folder.at("deep/er/results");
    succeed(&["evaluate", "--data", sequence, "--methods", "ibl", "--out", &deep]);
    assert!(!folder.path().join("escaped").exists() && !folder.path().join("deep/escaped").exists());
    assert!(folder.path().join("deep/er/results/seq-000000/scene/seq-000000.json").is_file());
    std::fs::write(&record, text).unwrap();

    let report = folder.at("report");
    succeed(&["report", &results, "--out", &report]);
    succeed(&["report", &results, "--out", &report]);
    folder.put("site/index.html", "<html><title>My site</title>");
    refused(folder.path(), &["report", &results, "--out", &folder.at("site")], &["index.html", "not a page of this program"]);
    // A damaged picture: the pages that are there stay as they are.
    let picture = tree(&folder.path().join("results"))
        .into_iter()
        .map(|(name, _)| name)
        .find(|name| name.ends_with("0001.truth.png"))
        .unwrap();
    folder.put(&format!("results/{picture}"), "no picture");
    for out in [&report, &folder.at("new")] {
        let output = renderflow(&["report", &results, "--out", out]);
        assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    }
    assert!(!folder.path().join("new/index.html").exists());
    let before = tree(&folder.path().join("report"));
    assert!(before.iter().all(|(name, _)| name.ends_with(".html")), "{before:?}");
    refused(folder.path(), &["report", &results, "--out", &report], &["0001.truth.png"]);
}

#[test]
fn the_demo_looks_at_all_its_folders_first() {
    let folder = Folder::new();
    for (name, content, words) in [
        ("a/results/notes.txt", "mine", "results.json"),
        ("b/report/index.html", "mine", "not a page of this program"),
        ("c/sequence/scene.json", "{}", "choose another folder"),
        ("d/comparison.0000.png", "mine", "not of a demo"),
    ] {
        folder.put(name, content);
        let out = folder.at(&name[..1]);
        let words = &[words][..];
        refused(folder.path(), &["demo", "--resolution", "16", "--frames", "1", "--spp", "1", "--out", &out], words);
    }
}

#[test]
fn a_test_set_of_other_plans_is_found_before_the_first_frame() {
    let folder = Folder::new();
    let (plan, _) = dataset();
    folder.put("sets/synthetic/large/plan.json", &std::fs::read_to_string(plan).unwrap());
    refused(folder.path(), &["testset", "make", "synthetic", "--out", &folder.at("sets")], &["large/plan.json", "another plan"]);
}

/// A disk of 300 KiB, in a namespace of mounts of its own.
#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_leaves_no_parts_of_files() {
    let folder = Folder::new();
    let disk = folder.at("disk");
    std::fs::create_dir(&disk).unwrap();
    let run = |script: &str| {
        let mount = format!("mount -t tmpfs -o size=300k tmpfs '{disk}' 2>/dev/null || exit 99; {script}");
        std::process::Command::new("unshare").args(["-m", "sh", "-c", &mount]).output()
    };
    let program = env!("CARGO_BIN_EXE_renderflow");
    let (plan, data) = dataset();
    let (plan, data) = (plan.display(), data.display());
    let weights = concat!(env!("CARGO_MANIFEST_DIR"), "/model/weights/fusion.safetensors");
    for command in [
        format!("dataset pack '{data}' --out '{disk}/x'"),
        format!("dataset export '{data}' --to png --out '{disk}/x'"),
        format!("dataset render --plan '{plan}' --out '{disk}/x'"),
        format!("weights convert '{weights}' '{disk}/x/w.safetensors' --precision f32"),
        format!("render --frames 20 --resolution 64 --spp 1 --denoise none --out '{disk}/x'"),
        format!("hdri --out '{disk}/x'"),
    ] {
        let list = format!("ls -RA '{disk}'; test -z \"$(find '{disk}' -name '.*' -type f)\"");
        let Ok(output) = run(&format!("'{program}' {command} || {{ test $? = 1 && {list}; exit $?; }}; exit 98")) else {
            return println!("skipped: there is no unshare");
        };
        if [Some(99), Some(1)].contains(&output.status.code()) && stderr(&output).contains("unshare")
            || output.status.code() == Some(99)
        {
            return println!("skipped: no disk can be mounted here");
        }
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(0), "{command}: {said}{}", String::from_utf8_lossy(&output.stdout));
        assert!(said.contains("No space left") && said.contains(&disk), "{command}: {said}");
    }
}

#[test]
fn bench_says_where_it_went() {
    for words in [&["bench"][..], &["bench", "inverse", "--buffers", "theirs/"], &["--threads", "2", "bench", "peers", "--help"]]
    {
        let output = renderflow(words);
        assert_eq!(output.status.code(), Some(2), "{words:?}");
        let said = stderr(&output);
        assert!(said.lines().count() == 1 && said.contains("renderflow-bench") && said.contains("evaluate inverse"), "{said}");
    }
}

#[test]
fn the_composer_of_version_0_1_is_gone() {
    let folder = Folder::new();
    let (path, old) = (folder.at("plan.json"), folder.at("old.toml"));
    let words = ["dataset", "plan", "--seed", "5", "--sequences", "1", "--classic", "--out", &path];
    refused(folder.path(), &words, &["--classic", "the classic composer of version 0.1 is gone"]);
    plan_to(&path, "5", &[]);
    let plan = renderflow::dataset::plan::Plan::read(Path::new(&path)).unwrap();
    let text = String::from_utf8(folder.bytes("plan.json")).unwrap();
    assert!(!text.contains("classic"));
    let with = |value: &str| text.replacen('{', &format!("{{\"classic\": {value},"), 1);
    folder.put("plan.json", &with("false"));
    assert_eq!(renderflow::dataset::plan::Plan::read(Path::new(&path)).unwrap(), plan);
    folder.put("plan.json", &with("true"));
    folder.put("old.toml", "classic = true\n");
    for plan in [&path, &old] {
        let said = refused(folder.path(), &["dataset", "render", "--plan", plan, "--out", &folder.at("data")], &[plan]);
        assert!(said.contains("the classic composer of version 0.1 is gone"), "{said}");
        assert_eq!(said.lines().filter(|line| line.contains("classic")).count(), 1, "{said}");
    }
}
