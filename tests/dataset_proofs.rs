//! Records are held to their folder, and whoever looks at a dataset comes to the same judgement of it.

mod common;

use common::{copy, fail, files, renderflow, stderr, succeed};
use renderflow::dataset::Plan;
use renderflow::dataset::record::Record;
use renderflow_frame::{exr, file};
use renderflow_scenes::Scene;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// A dataset of eight training sequences, one to validate with and one to test with, and its plan.
fn whole() -> &'static Path {
    static WHOLE: OnceLock<tempfile::TempDir> = OnceLock::new();
    let folder = WHOLE.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let (plan, data) = (folder.path().join("plan.toml"), folder.path().join("data"));
        let sizes = ["--sequences", "10", "--frames", "2", "--resolution", "24", "--spp", "1", "--keyframe-gap", "2"];
        let common = ["dataset", "plan", "--seed", "2", "--denoise", "none", "--mesh-count", "64", "--environment-count", "64"];
        succeed(&[&common[..], &sizes, &["--out", text(&plan)]].concat());
        succeed(&["dataset", "render", "--plan", text(&plan), "--out", text(&data)]);
        folder
    });
    folder.path()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// A copy of the dataset to be damaged.
struct Copy {
    folder: tempfile::TempDir,
}

impl Copy {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        copy(whole(), folder.path());
        Self { folder }
    }

    fn data(&self) -> PathBuf {
        self.folder.path().join("data")
    }

    fn path(&self, name: &str) -> PathBuf {
        self.data().join(name)
    }

    /// What `verify` prints; it must find something.
    fn faults(&self) -> String {
        let before = files(&self.data());
        let output = renderflow(&["dataset", "verify", text(&self.data())]);
        let said = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(output.status.code() == Some(1) && said.contains("FAULT"), "{said} {}", stderr(&output));
        assert!(files(&self.data()) == before, "verify changed something");
        said
    }

    fn render(&self) -> std::process::Output {
        renderflow(&["dataset", "render", "--plan", text(&self.folder.path().join("plan.toml")), "--out", text(&self.data())])
    }

    fn merge_refuses(&self) -> String {
        let before = files(&self.data());
        let said =
            fail(&["dataset", "merge", "--plan", text(&self.folder.path().join("plan.toml")), "--out", text(&self.data())]);
        assert!(files(&self.data()) == before, "a refused merge changed something");
        assert!(said.contains("renderflow dataset repair"), "{said}");
        said
    }

    fn pack_refuses(&self) -> String {
        let out = self.folder.path().join("packed");
        fail(&["dataset", "pack", text(&self.data()), "--out", text(&out)])
    }

    fn repair(&self) -> String {
        succeed(&["dataset", "repair", text(&self.data())])
    }

    /// Files that are not as in the whole dataset; `aside` and what passes apart.
    fn differences(&self) -> Vec<String> {
        let passing = |name: &str| name.ends_with("timing.json") || name.starts_with("logs/") || name.starts_with("aside/");
        let lasting = |folder: &Path| files(folder).into_iter().filter(|(name, _)| !passing(name)).collect::<Vec<_>>();
        let (whole, now) = (lasting(&whole().join("data")), lasting(&self.data()));
        let only = |a: &[(String, Vec<u8>)], b: &[(String, Vec<u8>)]| {
            a.iter().filter(|file| !b.contains(file)).map(|file| file.0.clone()).collect::<Vec<_>>()
        };
        [only(&whole, &now), only(&now, &whole)].concat()
    }

    fn is_mended(&self) {
        assert_eq!(self.differences(), Vec::<String>::new());
        assert!(succeed(&["dataset", "verify", text(&self.data())]).contains("no faults"));
    }

    /// Changes JSON in place, as this program writes it.
    fn edit(&self, name: &str, change: impl Fn(&mut Value)) {
        let path = self.path(name);
        let mut value: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
        change(&mut value);
        // A record as the program would write it, with its fields in order: what it says is at issue, not its form.
        let record = name.ends_with("sequence.json").then(|| serde_json::from_value::<Record>(value.clone()).ok()).flatten();
        let bytes = record.map_or_else(|| file::json(&path, &value), |record| file::json(&path, &record));
        std::fs::write(&path, bytes.unwrap()).unwrap();
    }
}

fn contains(text: &str, parts: &[&str]) {
    for part in parts {
        assert!(text.contains(part), "{part} is missing in: {text}");
    }
}

#[test]
fn a_training_sequence_in_the_test_split_is_found() {
    let copied = Copy::new();
    std::fs::remove_dir_all(copied.path("test/seq-000009")).unwrap();
    copy(&copied.path("train/seq-000000"), &copied.path("test/seq-000009"));
    let said = copied.faults();
    contains(&said, &["test/seq-000009: sequence.json: is that of train/seq-000000", "to repair it: renderflow dataset repair"]);
    // By the folder it lies in, whatever it says itself.
    contains(&said, &["train/seq-000000 and test/seq-000009 share what splits must not: environment family "]);
    contains(&copied.merge_refuses(), &["test/seq-000009: sequence.json: is that of train/seq-000000"]);
    // Not even a manifest that has gone hides it.
    std::fs::remove_file(copied.path("manifest.json")).unwrap();
    copied.merge_refuses();
    let output = copied.render();
    assert!(output.status.success(), "{}", stderr(&output));
    contains(
        &stderr(&output),
        &["is that of train/seq-000000", "is another sequence and was moved to", "aside/test-seq-000009-1"],
    );
    copied.is_mended();
    // What was in the way is still there.
    assert_eq!(files(&copied.path("aside/test-seq-000009-1")).len(), files(&copied.path("train/seq-000000")).len());
}

#[test]
fn sequences_that_changed_places_are_found() {
    let copied = Copy::new();
    let (a, b, between) = (copied.path("train/seq-000000"), copied.path("train/seq-000003"), copied.path("between"));
    std::fs::rename(&a, &between).unwrap();
    std::fs::rename(&b, &a).unwrap();
    std::fs::rename(&between, &b).unwrap();
    let expected = [
        "train/seq-000000: sequence.json: is that of train/seq-000003",
        "train/seq-000003: sequence.json: is that of train/seq-000000",
    ];
    contains(&copied.faults(), &expected);
    copied.merge_refuses();
    copied.repair();
    copied.is_mended();

    // One index twice, with names that fit.
    copied.edit("train/seq-000001/sequence.json", |record| record["index"] = 2.into());
    contains(&copied.faults(), &["train/seq-000001: sequence.json: is that of train/seq-000001, number 2"]);
    contains(&copied.merge_refuses(), &["number 2"]);
    copied.repair();
    copied.is_mended();
}

#[test]
fn folders_too_many_and_too_few_are_found() {
    let copied = Copy::new();
    copy(&copied.path("train/seq-000002"), &copied.path("train/seq-000099"));
    let said = copied.faults();
    contains(&said, &["train/seq-000099: is not a sequence of the plan", "to repair it: mv "]);
    // Named, not removed.
    let output = renderflow(&["dataset", "repair", text(&copied.data())]);
    assert_eq!(output.status.code(), Some(1));
    contains(&String::from_utf8_lossy(&output.stdout), &["FAULT ", "train/seq-000099: is not a sequence of the plan"]);
    assert!(copied.path("train/seq-000099/frame.0000.exr").is_file());
    contains(&copied.pack_refuses(), &["train/seq-000099: is not a sequence of the dataset"]);
    std::fs::remove_dir_all(copied.path("train/seq-000099")).unwrap();
    std::fs::write(copied.path("train/seq-000002/readme.txt"), "mine").unwrap();
    contains(&succeed(&["dataset", "verify", text(&copied.data())]), &["NOTE ", "readme.txt: is not part of the dataset"]);
    std::fs::remove_file(copied.path("train/seq-000002/readme.txt")).unwrap();

    std::fs::remove_dir_all(copied.path("val/seq-000008")).unwrap();
    contains(&copied.faults(), &["val/seq-000008: sequence.json: is not there", "dataset repair"]);
    contains(&copied.merge_refuses(), &["not complete: 1 of 10 sequences"]);
    copied.repair();
    copied.is_mended();
}

#[test]
fn flipped_frames_and_cut_descriptions_are_made_again() {
    type Mend = fn(&Copy);
    let mend: [(&str, Mend); 2] = [
        ("render", |copied| {
            let output = copied.render();
            assert!(output.status.success(), "{}", stderr(&output));
            contains(&stderr(&output), &["note: ", "sequence.json says"]);
        }),
        ("repair", |copied| assert!(copied.repair().contains(" repaired; "))),
    ];
    for (name, mend) in mend {
        let copied = Copy::new();
        let change = |name: &str, change: &dyn Fn(&mut Vec<u8>)| {
            let mut bytes = std::fs::read(copied.path(name)).unwrap();
            change(&mut bytes);
            std::fs::write(copied.path(name), bytes).unwrap();
        };
        change("train/seq-000000/frame.0001.exr", &|bytes| {
            let last = bytes.len() - 1;
            bytes[last] ^= 1;
        });
        change("train/seq-000001/transforms.json", &|bytes| bytes.truncate(200));
        change("train/seq-000002/env.hdr", &|bytes| bytes.truncate(bytes.len() / 2));
        change("train/seq-000003/scene.json", &|bytes| bytes.clear());
        // Another scene that can be read.
        copied.edit("train/seq-000004/scene.json", |scene| scene["environment"]["rotation"] = 1.0.into());
        // A frame replaced by its neighbour.
        let neighbours = ["frame.0000.exr", "frame.0001.exr"].map(|frame| copied.path("train/seq-000005").join(frame));
        std::fs::copy(&neighbours[0], &neighbours[1]).unwrap();
        // A failure of long ago.
        std::fs::write(copied.path("train/seq-000006/failures.json"), "[{\"frame\": 1, \"seed\": 3, \"error\": \"once\"}]")
            .unwrap();
        let said = copied.faults();
        for place in [
            "train/seq-000000: frame.0001.exr: ",
            "train/seq-000001: transforms.json: ",
            "train/seq-000002: env.hdr: ",
            "train/seq-000003: scene.json:1:0: ",
            "train/seq-000004: scene.json: is scene ",
            "train/seq-000005: frame.0001.exr: ",
            "train/seq-000006 frame 1: failed when it was made: once",
        ] {
            contains(&said, &[place]);
        }
        assert_eq!(said.matches("FAULT").count(), said.matches("to repair it: renderflow dataset repair").count());
        contains(&copied.merge_refuses(), &["6 sequences damaged"]);
        mend(&copied);
        println!("{name}");
        copied.is_mended();
    }
}

/// Without the record nothing vouches for frames: they are believed only where they are what this program writes, of this camera.
#[test]
fn frames_without_a_record_are_not_believed_blindly() {
    let copied = Copy::new();
    for name in ["sequence.json", "timing.json"] {
        std::fs::remove_file(copied.path("train/seq-000000").join(name)).unwrap();
    }
    std::fs::remove_file(copied.path("manifest.json")).unwrap();
    let frames = ["frame.0000.exr", "frame.0001.exr"].map(|frame| copied.path("train/seq-000000").join(frame));
    std::fs::copy(&frames[0], &frames[1]).unwrap();
    // A picture of another sequence is not thrown away.
    let stranger = copied.path("train/seq-000001/frame.0001.exr");
    std::fs::remove_file(copied.path("train/seq-000001/sequence.json")).unwrap();
    std::fs::copy(copied.path("train/seq-000002/frame.0001.exr"), &stranger).unwrap();
    let output = copied.render();
    assert!(output.status.success(), "{}", stderr(&output));
    contains(&stderr(&output), &["frame.0001.exr: made again", "moved to", "aside/train-seq-000001-frame.0001.exr-1"]);
    assert!(copied.path("aside/train-seq-000001-frame.0001.exr-1").is_file());
    copied.is_mended();
}

/// Records that were made to fit: what they say of files is true, and yet they are not this dataset's.
#[test]
fn records_that_fit_their_files_are_held_to_the_plan() {
    let copied = Copy::new();
    // Another picture, its hash in the record, and that of the record in the manifest.
    let sequence = copied.path("train/seq-000000");
    std::fs::copy(sequence.join("frame.0000.exr"), sequence.join("frame.0001.exr")).unwrap();
    let hash = |path: &Path| blake3::hash(&std::fs::read(path).unwrap()).to_hex().to_string();
    copied.edit("train/seq-000000/sequence.json", |record| {
        record["frames"][1]["blake3"] = record["frames"][0]["blake3"].clone();
        record["frames"][1]["bytes"] = record["frames"][0]["bytes"].clone();
    });
    let record = hash(&sequence.join("sequence.json"));
    copied.edit("manifest.json", |manifest| manifest["entries"][0]["record"] = record.as_str().into());
    contains(&copied.faults(), &["train/seq-000000: frame.0001.exr: "]);
    // What is not of any file: the environment, a count.
    let copied = Copy::new();
    copied.edit("test/seq-000009/sequence.json", |record| record["environment"]["family"] = "indoors".into());
    copied.edit("train/seq-000001/sequence.json", |record| record["triangles"] = 7.into());
    copied.edit("train/seq-000002/sequence.json", |record| record["statistics"]["coverage"][0] = 1.into());
    std::fs::remove_file(copied.path("manifest.json")).unwrap();
    let expected =
        ["sequence.json: /environment/family: is \"indoors\"", "sequence.json: /triangles: is 7", "/statistics: is not that"];
    contains(&copied.faults(), &expected);
    copied.repair();
    copied.is_mended();
    // Where the manifest is there, it tells at once.
    let copied = Copy::new();
    copied.edit("train/seq-000001/sequence.json", |record| record["triangles"] = 7.into());
    contains(&copied.merge_refuses(), &["train/seq-000001: sequence.json: has BLAKE3 ", "manifest.json says"]);
    assert!(copied.render().status.success());
    copied.is_mended();
}

#[test]
fn plans_and_manifests_are_mended() {
    for change in [
        |plan: &Path| std::fs::remove_file(plan).unwrap(),
        |plan: &Path| std::fs::write(plan, "{").unwrap(),
        |plan: &Path| {
            let text = std::fs::read_to_string(plan).unwrap();
            std::fs::write(plan, text.replacen("\"seed\": 2", "\"seed\": 7", 1)).unwrap();
        },
        |plan: &Path| std::fs::write(plan, std::fs::read_to_string(plan).unwrap().replacen('\n', "\n\n", 1)).unwrap(),
    ] {
        let copied = Copy::new();
        change(&copied.path("plan.json"));
        contains(&copied.faults(), &["plan.json: ", "dataset repair"]);
        copied.repair();
        copied.is_mended();
        // Without logs the plan has to come from elsewhere; another one is refused.
        change(&copied.path("plan.json"));
        std::fs::remove_dir_all(copied.path("logs")).unwrap();
        let plan = copied.folder.path().join("plan.toml");
        let other = copied.folder.path().join("other.toml");
        let edited = std::fs::read_to_string(&plan).unwrap().replacen("seed = 2", "seed = 3", 1);
        std::fs::write(&other, edited).unwrap();
        let output = renderflow(&["dataset", "repair", text(&copied.data())]);
        if output.status.success() {
            // Spaces alone: what is left of the file is the plan.
            copied.is_mended();
            continue;
        }
        contains(&stderr(&output), &["plan.json: ", "--plan PLAN"]);
        contains(&fail(&["dataset", "repair", text(&copied.data()), "--plan", text(&other)]), &["another plan"]);
        succeed(&["dataset", "repair", text(&copied.data()), "--plan", text(&plan)]);
        copied.is_mended();
    }
    let copied = Copy::new();
    for change in [
        |manifest: &mut Value| manifest["entries"][3]["record"] = "0".repeat(64).into(),
        |manifest: &mut Value| manifest["plan"] = "0".repeat(64).into(),
        |manifest: &mut Value| manifest["bytes"] = 5.into(),
    ] {
        copied.edit("manifest.json", change);
        contains(&copied.faults(), &["manifest.json", "dataset repair"]);
        contains(&copied.pack_refuses(), &["manifest.json", "dataset repair"]);
        assert!(copied.repair().contains("0 frames made"));
        copied.is_mended();
    }
}

/// A dataset that another version of the program began is not gone on with, and nothing of it is lost.
#[test]
fn another_versions_sequence_is_left_as_it_is() {
    let copied = Copy::new();
    let folder = copied.path("train/seq-000000");
    std::fs::remove_file(folder.join("sequence.json")).unwrap();
    copied.edit("train/seq-000000/scene.json", |scene| scene["environment"]["rotation"] = 1.0.into());
    let scene = Scene::read(&folder.join("scene.json")).unwrap();
    for frame in ["frame.0000.exr", "frame.0001.exr"] {
        let mut picture = exr::read(&folder.join(frame)).unwrap();
        picture.info.scene_hash = scene.hash();
        exr::write(&folder.join(frame), &picture).unwrap();
    }
    let before = files(&folder);
    for output in [copied.render(), renderflow(&["dataset", "repair", text(&copied.data())])] {
        assert_eq!(output.status.code(), Some(1));
        contains(&stderr(&output), &["seq-000000", "another version of this program", "another folder"]);
        assert!(files(&folder) == before);
    }
}

/// What lies at the place of a file and is none is moved aside, not removed.
#[test]
fn folders_in_the_place_of_files_are_moved_aside() {
    let copied = Copy::new();
    for name in
        ["train/seq-000000/frame.0001.exr", "train/seq-000001/sequence.json", "manifest.json", "plan.json", "val/seq-000008"]
    {
        let path = copied.path(name);
        if path.is_dir() {
            std::fs::remove_dir_all(&path).unwrap();
            std::fs::write(&path, "a file").unwrap();
        } else {
            std::fs::remove_file(&path).unwrap();
            std::fs::create_dir(&path).unwrap();
            std::fs::write(path.join("inside"), "of nobody").unwrap();
        }
    }
    copied.faults();
    copied.repair();
    copied.is_mended();
    assert_eq!(files(&copied.path("aside")).len(), 5);
}

/// Names in a record lead nowhere.
#[test]
fn names_in_records_are_plain() {
    let copied = Copy::new();
    let secret = copied.folder.path().join("secret.txt");
    std::fs::write(&secret, "secret").unwrap();
    for pointer in ["/frames/0/file", "/descriptions/0/0"] {
        let copied = Copy::new();
        copied.edit("train/seq-000000/sequence.json", |record| {
            *record.pointer_mut(pointer).unwrap() = "../../../secret.txt".into()
        });
        let expected =
            format!("train/seq-000000: sequence.json: {pointer}: \"../../../secret.txt\" is not the plain name of a file");
        contains(&copied.faults(), &[&expected]);
        contains(&fail(&["dataset", "stats", text(&copied.data())]), &["is not the plain name"]);
        copied.repair();
        copied.is_mended();
    }
    assert_eq!(std::fs::read(&secret).unwrap(), b"secret");
    let plan = Plan::read(&whole().join("plan.toml")).unwrap();
    let record = Record::read(&whole().join("data/train/seq-000000")).unwrap().unwrap();
    assert_eq!(record.misfits(&plan, 0), Vec::<String>::new());
}

#[cfg(unix)]
#[test]
fn one_process_at_a_time_repairs_a_dataset() {
    let copied = Copy::new();
    let data = copied.data();
    let refused = |output: std::process::Output| {
        assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
        contains(&stderr(&output), &["another process writes to this folder"]);
    };
    let repair = || renderflow(&["dataset", "repair", text(&data)]);
    let plan = copied.folder.path().join("plan.toml");
    let merge = || renderflow(&["dataset", "merge", "--plan", text(&plan), "--out", text(&data)]);
    let before = files(&data);
    // As a process that renders a shard shares it. Others may render other shards.
    let taken = std::fs::File::open(&data).unwrap();
    taken.lock_shared().unwrap();
    refused(repair());
    assert!(files(&data) == before, "a refused repair changed something");
    assert!(copied.render().status.success() && merge().status.success());
    drop(taken);
    // As another process that repairs holds it.
    let taken = std::fs::File::open(&data).unwrap();
    taken.lock().unwrap();
    let before = files(&data);
    [repair(), copied.render(), merge()].into_iter().for_each(refused);
    assert!(files(&data) == before, "what was refused changed something");
    assert!(succeed(&["dataset", "verify", text(&data)]).contains("no faults"));
    drop(taken);
    assert!(repair().status.success());
    copied.is_mended();
}
