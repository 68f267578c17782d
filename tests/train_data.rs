//! What is learned from: a run goes on with the data it began with alone, and what is no whole, own sequence is refused.

mod common;

use common::{copy, fail, renderflow, succeed};
use renderflow_frame::{exr, transforms};
use std::path::{Path, PathBuf};

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Two datasets of small frames, one with two training sequences, and options of two steps.
struct Data {
    folder: tempfile::TempDir,
}

impl Data {
    fn new() -> Self {
        let data = Self { folder: tempfile::tempdir().unwrap() };
        for (name, seed) in [("a", "2"), ("b", "3")] {
            let plan = data.path(&format!("{name}.json"));
            let sizes = ["--sequences", "2", "--frames", "2", "--resolution", "32", "--spp", "1", "--seed", seed];
            succeed(&[&["dataset", "plan", "--denoise", "none", "--out", text(&plan)][..], &sizes].concat());
            succeed(&["dataset", "render", "--plan", text(&plan), "--out", text(&data.path(name))]);
        }
        common::write_training(&data.path("options.json"), 2);
        data
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn arguments<'a>(&self, options: &'a Path, data: &'a Path, out: &'a Path) -> [&'a str; 7] {
        ["train", "--config", text(options), "--data", text(data), "--out", text(out)]
    }

    fn trained(&self, data: &Path, out: &str) -> String {
        succeed(&self.arguments(&self.path("options.json"), data, &self.path(out)))
    }

    fn refused(&self, data: &Path, out: &str, expected: &[&str]) {
        let said = fail(&self.arguments(&self.path("options.json"), data, &self.path(out)));
        for part in expected {
            assert!(said.contains(part), "{part} is missing in: {said}");
        }
    }
}

#[test]
fn a_run_goes_on_with_its_own_data_alone() {
    let data = Data::new();
    let (a, b) = (data.path("a/train"), data.path("b/train"));
    assert!(data.trained(&a, "run").contains("2 steps"));
    let checkpoint = std::fs::read(data.path("run/checkpoint.safetensors")).unwrap();
    // Finished, and asked for with other data.
    data.refused(&b, "run", &["training data: is not what the run in", "checkpoint.safetensors", "another output folder"]);
    assert!(std::fs::read(data.path("run/checkpoint.safetensors")).unwrap() == checkpoint);
    let log = std::fs::read(data.path("run/log.jsonl")).unwrap();
    let again = renderflow(&data.arguments(&data.path("options.json"), &a, &data.path("run")));
    assert!(String::from_utf8_lossy(&again.stdout).starts_with("already done: 2 steps in "), "{again:?}");
    // Nothing was loaded.
    assert!(again.status.success() && !common::stderr(&again).contains("done in"), "{again:?}");
    assert!(std::fs::read(data.path("run/log.jsonl")).unwrap() == log);
    // To be gone on with.
    common::write_training(&data.path("options.json"), 3);
    data.refused(&b, "run", &["is not what the run in"]);
    // The same data elsewhere is the same data, with a plan and without.
    let (moved, plain) = (data.path("moved"), data.path("plain"));
    copy(&data.path("a"), &moved);
    copy(&a, &plain);
    for sequence in ["seq-000000", "seq-000001"] {
        std::fs::remove_file(plain.join(sequence).join("sequence.json")).unwrap();
    }
    assert!(data.trained(&moved.join("train"), "run").contains("3 steps"));
    assert!(data.trained(&plain, "run").contains("3 steps"));
    // One byte of one frame is other data, in a folder without records too.
    let frame = plain.join("seq-000001/frame.0001.exr");
    let mut picture = exr::read(&frame).unwrap();
    picture.beauty.as_mut().unwrap().pixels[5][0] += 1.0;
    exr::write(&frame, &picture).unwrap();
    data.refused(&plain, "run", &["is not what the run in"]);
    // A checkpoint that cannot be read comes with a way out.
    std::fs::write(data.path("run/checkpoint.safetensors"), &checkpoint[..checkpoint.len() / 2]).unwrap();
    data.refused(&a, "run", &["checkpoint.safetensors", "remove the file to begin again"]);
}

#[test]
fn what_does_not_belong_is_not_learned_from() {
    let data = Data::new();
    let copied = |from: &str, name: &str| {
        copy(&data.path(from), &data.path(name));
        data.path(name)
    };
    // Of a dataset with a plan: everything in its place, complete, as it was recorded.
    let stranger = copied("a", "stranger").join("train");
    copy(&data.path("b/train/seq-000001"), &stranger.join("seq-000005"));
    data.refused(&stranger, "x", &["seq-000005: is not a sequence of the dataset"]);
    let replaced = copied("a", "replaced");
    copy(&data.path("b/train/seq-000001"), &replaced.join("train/seq-000001"));
    data.refused(&replaced.join("train"), "x", &["train/seq-000001: sequence.json: /plan: is of another plan", "dataset repair"]);
    let again = copied("a", "again").join("train");
    copy(&again.join("seq-000000"), &again.join("seq-000001"));
    data.refused(&again, "x", &["train/seq-000001: sequence.json: is that of train/seq-000000", "dataset repair"]);
    let unfinished = copied("a", "unfinished").join("train");
    std::fs::remove_file(unfinished.join("seq-000001/sequence.json")).unwrap();
    data.refused(&unfinished, "x", &["not complete: 1 of 2 sequences", "seq-000001", "dataset repair"]);
    let flipped = copied("a", "flipped").join("train");
    let frame = flipped.join("seq-000000/frame.0001.exr");
    let mut bytes = std::fs::read(&frame).unwrap();
    let last = bytes.len() - 1;
    bytes[last] ^= 1;
    std::fs::write(&frame, &bytes).unwrap();
    data.refused(&flipped, "x", &["frame.0001.exr: is not the file that sequence.json has recorded", "dataset repair"]);
    let rewritten = copied("a", "rewritten").join("train");
    let scene = rewritten.join("seq-000001/scene.json");
    std::fs::write(&scene, std::fs::read_to_string(&scene).unwrap() + "\n").unwrap();
    data.refused(&rewritten, "x", &["seq-000001", "scene.json", "dataset repair"]);
    let missing = copied("a", "missing").join("train");
    std::fs::remove_dir_all(missing.join("seq-000001")).unwrap();
    assert!(data.trained(&missing, "fewer").contains("2 steps"));
    // Without the plan nobody knows that one is missing.
    std::fs::remove_file(missing.with_file_name("plan.json")).unwrap();
    data.refused(&missing, "x", &["no plan.json beside manifest.json", "dataset repair"]);

    // Of a plain folder of sequences: what their records say.
    let recorded = copied("a/train", "recorded");
    std::fs::copy(flipped.join("seq-000000/frame.0001.exr"), recorded.join("seq-000000/frame.0001.exr")).unwrap();
    data.refused(&recorded, "x", &["frame.0001.exr: is not the file that sequence.json has recorded; remove its sequence.json"]);
    std::fs::write(recorded.join("seq-000000/sequence.json"), "{\"version\": 1, ").unwrap();
    data.refused(
        &recorded,
        "x",
        &["seq-000000/sequence.json: the text ends", "remove its sequence.json to take the sequence as it is"],
    );

    // Without records: what fits together.
    let plain = |name: &str| {
        copy(&data.path("a/train"), &data.path(name));
        for sequence in ["seq-000000", "seq-000001"] {
            std::fs::remove_file(data.path(name).join(sequence).join("sequence.json")).unwrap();
        }
        data.path(name)
    };
    let mixed = plain("mixed");
    std::fs::copy(mixed.join("seq-000000/frame.0001.exr"), mixed.join("seq-000001/frame.0001.exr")).unwrap();
    data.refused(&mixed, "x", &["seq-000001", "frame.0001.exr"]);
    let edit = |folder: &Path, change: &dyn Fn(&mut transforms::Sequence)| {
        let path = folder.join("seq-000001/transforms.json");
        let mut sequence = transforms::read(&path).unwrap();
        change(&mut sequence);
        transforms::write(&path, &sequence).unwrap();
    };
    let large = plain("large");
    edit(&large, &|sequence| sequence.cameras.iter_mut().for_each(|camera| (camera.width, camera.height) = (1 << 62, 1 << 62)));
    data.refused(&large, "x", &["frame.0000.exr", "32 x 32 pixels where the camera has 4611686018427387904"]);
    let turned = plain("turned");
    edit(&turned, &|sequence| sequence.cameras.swap(0, 1));
    data.refused(&turned, "x", &["frame.0000.exr: was seen by another camera"]);
    let outside = plain("outside");
    // The writer refuses such names, so the text is edited.
    let rename = |folder: &Path, from: &str, to: &str| {
        let path = folder.join("seq-000001/transforms.json");
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.contains(from), "{text}");
        std::fs::write(&path, text.replace(from, to)).unwrap();
    };
    rename(&outside, "\"frame.0001.exr\"", "\"../seq-000000/frame.0001.exr\"");
    data.refused(
        &outside,
        "x",
        &["transforms.json: /frames/1/file_path: \"../seq-000000/frame.0001.exr\" is not the plain name"],
    );
    let light = plain("light");
    rename(&light, "\"env.hdr\"", "\"../seq-000000/env.hdr\"");
    data.refused(&light, "x", &["transforms.json: /environment/file: ", "is not the plain name"]);
    assert!(!data.path("x/weights.safetensors").exists());
}

#[cfg(unix)]
#[test]
fn one_process_at_a_time_trains_into_a_folder() {
    let data = Data::new();
    let (options, learned, run) = (data.path("options.json"), data.path("a/train"), data.path("run"));
    std::fs::create_dir(&run).unwrap();
    // As another process that trains holds it.
    let taken = std::fs::File::open(&run).unwrap();
    taken.lock().unwrap();
    data.refused(&learned, "run", &["another process writes to this folder"]);
    drop(taken);
    assert_eq!(std::fs::read_dir(&run).unwrap().count(), 0);
    // A run without an end, with a checkpoint after every step. It makes the folder itself.
    std::fs::remove_dir(&run).unwrap();
    let mut endless: serde_json::Value = serde_json::from_slice(&std::fs::read(&options).unwrap()).unwrap();
    for (option, value) in [("steps", 1_000_000), ("log_steps", 1), ("checkpoint_steps", 1)] {
        endless["training"][option] = value.into();
    }
    std::fs::write(&options, endless.to_string()).unwrap();
    let command = data.arguments(&options, &learned, &run);
    let mut running = std::process::Command::new(env!("CARGO_BIN_EXE_renderflow")).args(command).spawn().unwrap();
    while !run.join("checkpoint.safetensors").exists() && running.try_wait().unwrap().is_none() {
        std::thread::sleep(std::time::Duration::from_millis(10));
    }
    let second = renderflow(&command);
    running.kill().unwrap();
    running.wait().unwrap();
    assert_eq!(second.status.code(), Some(1));
    assert!(common::stderr(&second).contains("another process writes to this folder"), "{second:?}");
    // The lock ends with the process, so the run goes on.
    let steps = std::fs::read_to_string(run.join("log.jsonl")).unwrap().lines().count() + 2;
    endless["training"]["steps"] = steps.into();
    std::fs::write(&options, endless.to_string()).unwrap();
    assert!(data.trained(&learned, "run").contains(&format!("{steps} steps")));
}
