//! Shards and exports of a small dataset, end to end: the same bytes again, damage found, stopped runs gone on with, and other
//! people's formats.

mod common;

use common::{files, renderflow, stderr, succeed};
use renderflow::dataset::pack::Manifest;
use renderflow_frame::{compact, frame_file};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A dataset of 4 sequences of 3 frames, rendered once.
fn dataset() -> &'static Path {
    static DATASET: std::sync::OnceLock<(tempfile::TempDir, PathBuf)> = std::sync::OnceLock::new();
    let (_, path) = DATASET.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let (plan, data) = (folder.path().join("plan.json"), folder.path().join("data"));
        let (plan, out) = (plan.to_str().unwrap(), data.to_str().unwrap());
        let counts = ["--sequences", "4", "--frames", "3", "--resolution", "24", "--spp", "2", "--keyframe-gap", "2"];
        succeed(&[&["dataset", "plan", "--seed", "8", "--denoise", "none", "--out", plan][..], &counts].concat());
        succeed(&["dataset", "render", "--plan", plan, "--out", out]);
        (folder, data)
    });
    path
}

fn pack(data: &Path, out: &Path, more: &[&str]) -> std::process::Output {
    let words = ["dataset", "pack", data.to_str().unwrap(), "--out", out.to_str().unwrap(), "--samples-per-shard", "5"];
    renderflow(&[&words[..], more].concat())
}

fn verify(out: &Path) -> std::process::Output {
    renderflow(&["dataset", "pack", "--verify", out.to_str().unwrap()])
}

fn json(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

/// Names and bytes in an archive, in order.
fn members(path: &Path) -> Vec<(String, Vec<u8>)> {
    let mut archive = tar::Archive::new(std::fs::File::open(path).unwrap());
    let entries = archive.entries().unwrap().map(|entry| {
        let mut entry = entry.unwrap();
        assert_eq!(
            (entry.header().mtime().unwrap(), entry.header().uid().unwrap(), entry.header().mode().unwrap()),
            (0, 0, 0o644)
        );
        let mut bytes = Vec::new();
        std::io::Read::read_to_end(&mut entry, &mut bytes).unwrap();
        (entry.path().unwrap().to_str().unwrap().to_owned(), bytes)
    });
    entries.collect()
}

/// Every folder of sequences of the dataset with its split.
fn sequences(data: &Path) -> Vec<(&'static str, PathBuf)> {
    let mut found = Vec::new();
    for split in ["train", "val", "test"] {
        let Ok(entries) = std::fs::read_dir(data.join(split)) else { continue };
        let mut folders: Vec<_> = entries.map(|entry| entry.unwrap().path()).collect();
        folders.sort();
        found.extend(folders.into_iter().map(|folder| (split, folder)));
    }
    found
}

fn copy(from: &Path, to: &Path) {
    for (name, bytes) in files(from) {
        let path = to.join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }
}

/// The splits of a folder without a plan may come in any order.
#[test]
fn folders_without_a_plan_lose_no_sequence() {
    let (data, folder) = (dataset(), tempfile::tempdir().unwrap());
    let [mixed, shards, coco] = ["mixed", "shards", "coco"].map(|name| folder.path().join(name));
    let (plan, tested) = (folder.path().join("tested.json"), folder.path().join("tested"));
    let (plan, out) = (plan.to_str().unwrap(), tested.to_str().unwrap());
    let counts = ["--sequences", "1", "--split", "test", "--frames", "3", "--resolution", "24", "--spp", "2"];
    succeed(&[&["dataset", "plan", "--seed", "9", "--denoise", "none", "--out", plan][..], &counts].concat());
    succeed(&["dataset", "render", "--plan", plan, "--out", out]);
    let (train, test) = (sequences(data), sequences(&tested));
    for ((_, from), to) in [(&train[0], "a"), (&test[0], "b"), (&train[1], "c")] {
        copy(from, &mixed.join(to));
    }
    let output = pack(&mixed, &shards, &[]);
    assert!(output.status.success(), "{}", stderr(&output));
    let held = |file: &str| members(&shards.join(file)).into_iter().map(|(name, _)| name).collect::<Vec<_>>().join(" ");
    let train = held("train-000000.tar") + &held("train-000001.tar");
    assert!(train.contains("a_0000") && train.contains("c_0002") && held("test-000000.tar").contains("b_0000"), "{train}");
    assert!(verify(&shards).status.success());
    succeed(&["dataset", "export", mixed.to_str().unwrap(), "--to", "coco", "-o", coco.to_str().unwrap()]);
    assert_eq!(json(&coco.join("annotations/instances_train.json"))["images"].as_array().unwrap().len(), 6);
}

#[test]
fn shards_hold_every_frame_once_and_say_what_it_is() {
    let (data, folder) = (dataset(), tempfile::tempdir().unwrap());
    for (profile, ending) in [("stored", "exr"), ("compact", "rff")] {
        let out = folder.path().join(profile);
        assert!(pack(data, &out, &["--profile", profile]).status.success());
        let manifest = json(&out.join("manifest.json"));
        assert_eq!(manifest["dataset"], blake3::hash(&std::fs::read(data.join("manifest.json")).unwrap()).to_hex().as_str());
        let mut frames = BTreeMap::new();
        let mut described = 0;
        for shard in manifest["shards"].as_array().unwrap() {
            let path = out.join(shard["file"].as_str().unwrap());
            assert_eq!(shard["blake3"], blake3::hash(&std::fs::read(&path).unwrap()).to_hex().as_str());
            let members = members(&path);
            assert_eq!(members.len() as u64, 2 * shard["samples"].as_u64().unwrap());
            assert!(shard["kind"] == "sequences" || members.len() <= 10);
            for pair in members.chunks(2) {
                let [(name, bytes), (other, text)] = pair else { panic!("a file without its description") };
                let (key, found) = name.split_once('.').unwrap();
                assert_eq!(*other, format!("{key}.json"));
                let about: Value = serde_json::from_slice(text).unwrap();
                assert_eq!((about["key"].as_str(), &about["split"]), (Some(key), &shard["split"]));
                if shard["kind"] == "frames" {
                    assert_eq!(found, ending);
                    assert_eq!(about["blake3"], blake3::hash(bytes).to_hex().as_str());
                    assert!(frames.insert(key.to_owned(), (bytes.clone(), about)).is_none(), "{key} twice");
                } else {
                    let source = data.join(shard["split"].as_str().unwrap()).join(key);
                    assert_eq!(*bytes, std::fs::read(source.join("env.hdr")).unwrap());
                    assert_eq!(about["scene"], json(&source.join("scene.json")));
                    assert_eq!(about["transforms"], json(&source.join("transforms.json")));
                    assert_eq!(about["sequence"], json(&source.join("sequence.json")));
                    described += 1;
                }
            }
        }
        assert_eq!((frames.len(), described), (12, 4));
        for (split, source) in sequences(data) {
            let transforms = json(&source.join("transforms.json"));
            for (index, frame) in transforms["frames"].as_array().unwrap().iter().enumerate() {
                let (bytes, about) = &frames[&format!("{}_{index:04}", source.file_name().unwrap().to_str().unwrap())];
                let path = source.join(frame["file_path"].as_str().unwrap());
                let original = std::fs::read(&path).unwrap();
                let decoded = frame_file::decode(&path, &original).unwrap();
                if profile == "stored" {
                    assert_eq!(*bytes, original);
                } else {
                    assert_eq!(*bytes, compact::encode(&path, &decoded).unwrap().0);
                }
                assert_eq!(about["camera"]["transform_matrix"], frame["transform_matrix"]);
                assert_eq!(about["camera"]["fl_x"], transforms["fl_x"]);
                assert_eq!((about["split"].as_str(), about["spp"].as_u64()), (Some(split), Some(2)));
                assert_eq!(about["keyframe"], index % 2 == 0);
                let tracks = transforms["object_transforms"].as_object().cloned().unwrap_or_default();
                let here: serde_json::Map<String, Value> =
                    tracks.into_iter().map(|(id, track)| (id, track[index].clone())).collect();
                assert_eq!(about["object_transforms"].as_object().cloned().unwrap_or_default(), here);
            }
        }
        assert!(verify(&out).status.success());
    }
}

#[test]
fn packing_again_keeps_finished_shards_and_gives_the_same_bytes() {
    let (data, folder) = (dataset(), tempfile::tempdir().unwrap());
    let (whole, other) = (folder.path().join("whole"), folder.path().join("other"));
    assert!(pack(data, &whole, &[]).status.success());
    assert!(pack(data, &other, &["--threads", "1"]).status.success());
    assert!(files(&whole) == files(&other), "threads change the bytes");

    // A run that was stopped after one shard, leaving half of the next.
    let manifest = json(&other.join("manifest.json"));
    let kept = manifest["shards"][0].clone();
    std::fs::write(other.join("unfinished.json"), serde_json::to_vec(&[&kept]).unwrap()).unwrap();
    std::fs::remove_file(other.join("manifest.json")).unwrap();
    std::fs::write(other.join(manifest["shards"][1]["file"].as_str().unwrap()), b"half").unwrap();
    std::fs::write(other.join(".renderflow-aB3d5f.tmp"), b"half").unwrap();
    let kept = other.join(kept["file"].as_str().unwrap());
    let before = std::fs::metadata(&kept).unwrap().modified().unwrap();
    let unfinished = verify(&other);
    assert!(!unfinished.status.success() && stderr(&unfinished).contains("manifest.json"), "{}", stderr(&unfinished));
    assert!(pack(data, &other, &[]).status.success());
    assert!(files(&whole) == files(&other));
    assert_eq!(std::fs::metadata(&kept).unwrap().modified().unwrap(), before, "a finished shard was written again");

    // Other sizes of shards leave none of the old ones behind.
    let words = ["dataset", "pack", data.to_str().unwrap(), "--out", other.to_str().unwrap(), "--samples-per-shard", "100"];
    succeed(&words);
    assert!(verify(&other).status.success());
    assert!(files(&other).len() < files(&whole).len());
}

/// The list of shards with `edit` made to it and sealed again, as one who knows how would.
fn forge(path: &Path, edit: impl FnOnce(&mut Manifest)) {
    let mut manifest: Manifest = serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap();
    edit(&mut manifest);
    manifest.seal.clear();
    manifest.seal = blake3::hash(&serde_json::to_vec(&manifest).unwrap()).to_hex().to_string();
    std::fs::write(path, serde_json::to_vec(&manifest).unwrap()).unwrap();
}

/// Every file below a folder, and what became of packing into one of them.
fn refused(root: &Path, out: &Path, words: &[&str]) {
    let before = files(root);
    let output = pack(dataset(), out, &[]);
    let said = stderr(&output);
    assert!(output.status.code() == Some(1) && words.iter().all(|word| said.contains(word)), "{words:?}: {said}");
    assert!(files(root) == before, "{words:?}: files changed");
}

#[test]
fn lists_name_nothing_but_shards_and_are_as_they_were_written() {
    let root = tempfile::tempdir().unwrap();
    let out = root.path().join("shards");
    assert!(pack(dataset(), &out, &[]).status.success());
    let victim = root.path().join("victim");
    std::fs::write(&victim, b"precious").unwrap();
    std::fs::write(out.join("notes.tar"), b"precious").unwrap();
    std::fs::create_dir(out.join("inside")).unwrap();
    std::fs::write(out.join("inside/train-000000.tar"), b"precious").unwrap();
    let (manifest, unfinished) = (out.join("manifest.json"), out.join("unfinished.json"));
    let good = std::fs::read(&manifest).unwrap();
    let full = victim.to_str().unwrap();
    let names = [
        "../victim",
        full,
        "inside/train-000000.tar",
        "./train-000000.tar",
        "notes.tar",
        "manifest.json",
        "",
        "..",
        "train-0.tar",
    ];
    for name in names {
        // Edited by hand, and by one who knows how lists are sealed.
        std::fs::write(&manifest, String::from_utf8(good.clone()).unwrap().replacen("train-000000.tar", name, 1)).unwrap();
        refused(root.path(), &out, &["manifest.json"]);
        let verified = verify(&out);
        assert!(
            verified.status.code() == Some(1) && stderr(&verified).contains("/shards/0/file"),
            "{name}: {}",
            stderr(&verified)
        );
        std::fs::write(&manifest, &good).unwrap();
        let edit = |manifest: &mut Manifest| {
            let stolen = blake3::hash(b"precious").to_hex().to_string();
            (manifest.shards[0].file, manifest.shards[0].blake3, manifest.shards[0].bytes) = (name.into(), stolen, 8);
        };
        forge(&manifest, edit);
        refused(root.path(), &out, &["manifest.json", "/shards/0/file"]);
        // The list of a run that was stopped is read the same way.
        let shards = json(&manifest)["shards"].clone();
        std::fs::write(&unfinished, serde_json::to_vec(&shards).unwrap()).unwrap();
        std::fs::write(&manifest, &good).unwrap();
        refused(root.path(), &out, &["unfinished.json", "/0/file"]);
        std::fs::remove_file(&unfinished).unwrap();
    }
    // A list that is changed in any other way is no list of this program's.
    std::fs::write(&manifest, String::from_utf8(good.clone()).unwrap().replacen("\"samples\": 5", "\"samples\": 6", 1)).unwrap();
    refused(root.path(), &out, &["manifest.json", "/seal", "was changed"]);
    std::fs::write(&manifest, &good).unwrap();
    assert!(pack(dataset(), &out, &[]).status.success());
    assert!(std::fs::read(&victim).unwrap() == b"precious" && std::fs::read(out.join("notes.tar")).unwrap() == b"precious");
}

#[test]
fn only_shards_that_were_packed_are_removed() {
    let root = tempfile::tempdir().unwrap();
    let out = root.path().join("shards");
    let more = ["dataset", "pack", dataset().to_str().unwrap(), "--out", out.to_str().unwrap(), "--samples-per-shard"];
    let small = || succeed(&[&more[..], &["1"]].concat());
    let large = || stderr(&renderflow(&[&more[..], &["100"]].concat()));
    small();
    let stale = |number: usize| out.join(format!("train-{number:06}.tar"));
    // One was replaced by its owner, one is a link to a file elsewhere, one is gone.
    std::fs::write(stale(2), b"precious").unwrap();
    let elsewhere = root.path().join("elsewhere.tar");
    std::fs::rename(stale(3), &elsewhere).unwrap();
    #[cfg(unix)]
    std::os::unix::fs::symlink(&elsewhere, stale(3)).unwrap();
    std::fs::remove_file(stale(4)).unwrap();
    let said = large();
    assert!(!stale(1).exists() && !stale(5).exists(), "{said}");
    assert_eq!(std::fs::read(stale(2)).unwrap(), b"precious");
    assert!(elsewhere.is_file() && (!cfg!(unix) || std::fs::symlink_metadata(stale(3)).is_ok()));
    assert!(said.contains("train-000002.tar") && said.contains("not the file that was packed"), "{said}");
    assert!(!cfg!(unix) || said.contains("train-000003.tar") && said.contains("no regular file"), "{said}");
    assert!(!said.contains("train-000004.tar"), "{said}");

    // A folder of an earlier version has no seal: its shards are used, none is removed.
    std::fs::remove_dir_all(&out).unwrap();
    small();
    let mut manifest = json(&out.join("manifest.json"));
    manifest.as_object_mut().unwrap().remove("seal");
    std::fs::write(out.join("manifest.json"), manifest.to_string()).unwrap();
    let said = large();
    assert!(said.contains("train-000001.tar") && said.contains("an earlier version"), "{said}");
    assert!((1..6).all(|number| stale(number).is_file()));
    let known = json(&out.join("manifest.json"))["shards"].as_array().unwrap().len();
    assert!(known < 6, "{known}");
}

#[test]
fn shards_go_into_a_folder_of_their_own() {
    let root = tempfile::tempdir().unwrap();
    let out = root.path().join("mine");
    std::fs::create_dir(&out).unwrap();
    std::fs::write(out.join("train-000000.tar"), b"precious").unwrap();
    refused(root.path(), &out, &["not empty", "choose another folder"]);
    std::fs::write(out.join("manifest.json"), b"{\"name\": \"an app\"}").unwrap();
    refused(root.path(), &out, &["manifest.json", "not a folder of shards"]);
    std::fs::write(out.join("unfinished.json"), b"[1]").unwrap();
    refused(root.path(), &out, &["unfinished.json", "not a list of shards"]);
    // What is missing in the dataset is found before the folder of earlier shards is touched.
    let (data, shards) = (root.path().join("data"), root.path().join("shards"));
    copy(dataset(), &data);
    assert!(pack(&data, &shards, &[]).status.success());
    std::fs::remove_file(sequences(&data).pop().unwrap().1.join("frame.0001.exr")).unwrap();
    let before = files(root.path());
    assert_eq!(pack(&data, &shards, &[]).status.code(), Some(1));
    assert!(files(root.path()) == before);
}

#[test]
fn damage_is_found() {
    let (data, folder) = (dataset(), tempfile::tempdir().unwrap());
    let out = folder.path().join("shards");
    assert!(pack(data, &out, &[]).status.success());
    let shard = out.join(json(&out.join("manifest.json"))["shards"][0]["file"].as_str().unwrap());
    let bytes = std::fs::read(&shard).unwrap();
    let fault = |wanted: &str| {
        let found = verify(&out);
        let text = String::from_utf8_lossy(&found.stdout).into_owned();
        assert!(found.status.code() == Some(1) && text.contains("FAULT") && text.contains(wanted), "{text} {}", stderr(&found));
    };
    let mut flipped = bytes.clone();
    flipped[bytes.len() / 2] ^= 1;
    std::fs::write(&shard, &flipped).unwrap();
    fault("has BLAKE3");
    std::fs::write(&shard, &bytes[..bytes.len() - 512]).unwrap();
    fault("bytes, the manifest says");
    std::fs::remove_file(&shard).unwrap();
    fault("cannot read");
    assert!(pack(data, &out, &[]).status.success(), "what is damaged is made again");
    assert_eq!(std::fs::read(&shard).unwrap(), bytes);
    std::fs::copy(&shard, out.join("extra.tar")).unwrap();
    fault("extra.tar: is not in manifest.json");
}

#[test]
fn datasets_that_are_not_whole_are_refused() {
    let (data, folder) = (dataset(), tempfile::tempdir().unwrap());
    let broken = |name: &str, spoil: &dyn Fn(&Path), wanted: &str| {
        let (copied, out) = (folder.path().join(name), folder.path().join(format!("{name}-out")));
        copy(data, &copied);
        spoil(&copied);
        for refused in [pack(&copied, &out, &[]), pack(&copied, &out, &["--profile", "compact"])] {
            assert!(refused.status.code() == Some(1) && stderr(&refused).contains(wanted), "{name}: {}", stderr(&refused));
            assert!(!out.join("manifest.json").exists());
        }
    };
    let first = |data: &Path| sequences(data)[0].1.join("frame.0001.exr");
    broken("unmerged", &|d| std::fs::remove_file(d.join("manifest.json")).unwrap(), "not complete");
    broken("missing", &|d| std::fs::remove_file(first(d)).unwrap(), "frame.0001.exr: is not there");
    let other = |d: &Path| {
        let bytes = std::fs::read(first(d).with_file_name("frame.0000.exr")).unwrap();
        std::fs::write(first(d), bytes).unwrap();
    };
    broken("other", &other, "frame.0001.exr: has ");
    broken("empty", &|d| ["train", "val", "test"].iter().for_each(|s| drop(std::fs::remove_dir_all(d.join(s)))), "no sequence");
}

fn export(to: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    succeed(&["dataset", "export", dataset().to_str().unwrap(), "--to", to, "--out", folder.path().to_str().unwrap()]);
    folder
}

fn picture(path: PathBuf) -> image::DynamicImage {
    image::open(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

#[test]
fn nerfstudio_sees_the_depths_and_cameras_of_the_frames() {
    let out = export("nerfstudio");
    for (split, source) in sequences(dataset()) {
        let folder = out.path().join(split).join(source.file_name().unwrap());
        let (ours, theirs) = (json(&source.join("transforms.json")), json(&folder.join("transforms.json")));
        assert_eq!((&theirs["fl_x"], &theirs["w"], &theirs["camera_model"]), (&ours["fl_x"], &ours["w"], &"PINHOLE".into()));
        for (own, entry) in ours["frames"].as_array().unwrap().iter().zip(theirs["frames"].as_array().unwrap()) {
            let frame = frame_file::read(&source.join(own["file_path"].as_str().unwrap())).unwrap();
            let open = |key: &str| picture(folder.join(entry[key].as_str().unwrap()));
            let (depth, mask) = (open("depth_file_path").into_luma16(), open("mask_path").into_luma8());
            assert_eq!(open("file_path").color(), image::ColorType::Rgb8);
            for (i, (&d, &id)) in frame.depth.pixels.iter().zip(&frame.object_id.pixels).enumerate() {
                let (x, y) = (i as u32 % 24, i as u32 / 24);
                let stored = depth.get_pixel(x, y)[0];
                let expected = if d < 65.5 { f64::from(d) } else { 0.0 };
                assert!((f64::from(stored) / 1000.0 - expected).abs() <= 0.000_51, "{stored} {d}");
                let moving = ours["object_transforms"].get(id.to_string()).is_some();
                assert_eq!(mask.get_pixel(x, y)[0], if id == 0 || moving { 0 } else { 255 });
            }
            // Heights are +Z there.
            let at = |matrix: &Value, row: usize| matrix["transform_matrix"][row][3].as_f64().unwrap();
            assert_eq!([at(entry, 0), at(entry, 1), at(entry, 2)], [at(own, 0), -at(own, 2), at(own, 1)]);
        }
    }
}

/// A split or one sequence can be exported alone, and comes out as it does with the others.
#[test]
fn parts_of_a_dataset() {
    let (whole, folder) = (export("cosmos"), tempfile::tempdir().unwrap());
    let (split, sequence) = sequences(dataset())[0].clone();
    let part = |from: &Path, name: &str| {
        let out = folder.path().join(name);
        succeed(&["dataset", "export", from.to_str().unwrap(), "--to", "cosmos", "--out", out.to_str().unwrap()]);
        let all = files(whole.path());
        let found = files(&out);
        assert!(!found.is_empty() && found.iter().all(|file| all.contains(file)), "{name}");
        found.len()
    };
    let (one, many) = (part(&sequence, "sequence"), part(&dataset().join(split), "split"));
    assert!(one > 24 && many >= one);
}

/// The numbers that the pixels of a PNG with a palette hold.
fn indices(path: &Path) -> Vec<u8> {
    let mut reader = png::Decoder::new(std::io::BufReader::new(std::fs::File::open(path).unwrap())).read_info().unwrap();
    assert_eq!(reader.info().color_type, png::ColorType::Indexed);
    let palette = reader.info().palette.clone().unwrap();
    assert!(palette[..3] == [0; 3] && palette[3..6].iter().any(|v| *v > 100), "ids can be told apart");
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    reader.next_frame(&mut pixels).unwrap();
    pixels
}

#[test]
fn cosmos_and_png_files_hold_the_channels() {
    let (cosmos, png) = (export("cosmos"), export("png"));
    for (split, source) in sequences(dataset()) {
        let clip = source.file_name().unwrap().to_str().unwrap();
        let ranges = json(&png.path().join(split).join(clip).join("data_ranges.json"));
        let range = json(&cosmos.path().join(split).join(format!("{clip}.cameras.json")))["depth_range"].clone();
        let [near, far] = [0, 1].map(|i| range[i].as_f64().unwrap() as f32);
        let limits = |name: &str| ["min", "max"].map(|key| ranges[name][key].as_f64().unwrap() as f32);
        for index in 0..3 {
            let frame = frame_file::read(&source.join(format!("frame.{index:04}.exr"))).unwrap();
            let their =
                |label: &str| picture(cosmos.path().join(split).join(format!("{clip}.{index:04}.{label}.png"))).into_rgb8();
            let own = |name: &str| picture(png.path().join(split).join(clip).join(format!("{name}_{index:04}.png")));
            let labels = ["rgb", "basecolor", "metallic", "roughness", "normal", "depth", "env_ldr", "env_log"].map(their);
            assert!(labels.iter().all(|label| label.dimensions() == (24, 24)));
            let (albedo, normal, depth) =
                (own("values/albedo").into_rgb16(), own("normal").into_rgb16(), own("depth").into_luma16());
            let (beauty, seen, motion) =
                (own("values/beauty").into_rgb16(), own("albedo").into_rgb8(), own("motion").into_rgb16());
            let ids = indices(&png.path().join(split).join(clip).join(format!("object_id_{index:04}.png")));
            let ([low, high], [slow, fast]) = (limits("depth"), limits("motion"));
            for (i, &id) in ids.iter().enumerate() {
                let (x, y) = (i as u32 % 24, i as u32 / 24);
                let (n, d) = (frame.normal.pixels[i], frame.depth.pixels[i]);
                for (c, n) in n.into_iter().enumerate() {
                    let off = f32::from(labels[4].get_pixel(x, y)[c]) / 127.5 - 1.0 - n;
                    assert!(off.abs() < 0.005, "{off}");
                    assert!((f32::from(normal.get_pixel(x, y)[c]) / 32767.5 - 1.0 - n).abs() < 2e-5);
                    assert!((f32::from(albedo.get_pixel(x, y)[c]) / 65535.0 - frame.albedo.pixels[i][c]).abs() < 1e-5);
                    let shown = 255.0 * renderflow_frame::color::linear_to_srgb(frame.albedo.pixels[i][c]);
                    assert!((f32::from(seen.get_pixel(x, y)[c]) - shown).abs() <= 0.51);
                    let bits = beauty.get_pixel(x, y)[c];
                    assert_eq!(half::f16::from_bits(bits / 2).to_f32(), frame.beauty.as_ref().unwrap().pixels[i][c]);
                }
                let (share, code) = (f32::from(labels[5].get_pixel(x, y)[0]) / 255.0, depth.get_pixel(x, y)[0]);
                if d.is_finite() {
                    assert!((near + share * (far - near) - d).abs() <= 0.51 / 255.0 * (far - near));
                    let read = low + f32::from(code - 1) / 65534.0 * (high - low);
                    assert!((read - d).abs() <= (high - low) / 1e5, "{read} {d}");
                } else {
                    assert_eq!((share, code), (1.0, 0));
                }
                let moved = slow + f32::from(motion.get_pixel(x, y)[1]) / 65535.0 * (fast - slow);
                assert!((moved - frame.motion.as_ref().unwrap().pixels[i][1]).abs() <= (fast - slow) / 1e5);
                assert_eq!(u32::from(id), frame.object_id.pixels[i]);
            }
        }
        assert!(cosmos.path().join(split).join(format!("{clip}.0000.env_nrm.png")).is_file());
    }
}

#[test]
fn coco_masks_are_the_object_ids() {
    static TABLE: std::sync::OnceLock<Vec<Value>> = std::sync::OnceLock::new();
    let out = export("coco");
    // A part of the dataset has the ids of the whole.
    let part = tempfile::tempdir().unwrap();
    let (split, sequence) = sequences(dataset()).pop().unwrap();
    succeed(&["dataset", "export", sequence.to_str().unwrap(), "--to", "coco", "--out", part.path().to_str().unwrap()]);
    let file = format!("annotations/instances_{split}.json");
    assert_eq!(json(&part.path().join(&file))["categories"], json(&out.path().join(&file))["categories"]);
    // Another part would take its place.
    let (other, before) = (sequences(dataset()).remove(0).1, files(part.path()));
    let words = ["dataset", "export", other.to_str().unwrap(), "--to", "coco", "--out", part.path().to_str().unwrap()];
    assert!(common::fail(&words).contains("which would be lost") && files(part.path()) == before);
    // Families have their ids by the program's list, in every dataset.
    let table = json(&out.path().join(&file))["categories"].clone();
    for (i, family) in renderflow_scenes::shapes::FAMILIES.iter().enumerate() {
        assert_eq!((table[i]["id"].as_u64(), table[i]["name"].as_str()), (Some(i as u64 + 1), Some(*family)));
    }
    assert!(table.as_array().unwrap().iter().any(|category| category["name"] == "ground"));
    for split in ["train", "val", "test"] {
        let folders: Vec<_> = sequences(dataset()).into_iter().filter(|s| s.0 == split).collect();
        let path = out.path().join(format!("annotations/instances_{split}.json"));
        assert_eq!(path.is_file(), !folders.is_empty());
        if folders.is_empty() {
            continue;
        }
        let found = json(&path);
        let list = |key: &str| found[key].as_array().unwrap().clone();
        assert_eq!(list("images").len(), 3 * folders.len());
        assert_eq!(*TABLE.get_or_init(|| list("categories")), list("categories"), "{split}: other ids");
        let category = |id: &Value| list("categories").into_iter().find(|c| c["id"] == *id).unwrap()["name"].clone();
        for image in list("images") {
            let name = image["file_name"].as_str().unwrap();
            assert_eq!(picture(out.path().join(split).join(name)).color(), image::ColorType::Rgb8);
            let (sequence, index) = name.strip_suffix(".png").unwrap().rsplit_once('_').unwrap();
            let folder = dataset().join(split).join(sequence);
            let ids = frame_file::read(&folder.join(format!("frame.{index}.exr"))).unwrap().object_id;
            let objects = json(&folder.join("scene.json"))["objects"].clone();
            let mut total = 0;
            for annotation in list("annotations").iter().filter(|a| a["image_id"] == image["id"]) {
                let id = annotation["object_id"].as_u64().unwrap();
                let area = ids.pixels.iter().filter(|pixel| u64::from(**pixel) == id).count();
                assert_eq!(annotation["area"], area);
                assert_eq!(annotation["segmentation"]["size"], serde_json::json!([24, 24]));
                let name = objects[id as usize - 1]["name"].as_str().unwrap();
                assert!(name.starts_with(category(&annotation["category_id"]).as_str().unwrap()), "{name}");
                total += area;
            }
            assert_eq!(total, ids.pixels.iter().filter(|id| **id != 0).count());
        }
    }
}

/// A dataset that has lost its plan is damaged for everybody, though its manifest is whole.
#[test]
fn a_dataset_without_its_plan_is_not_packed() {
    let folder = tempfile::tempdir().unwrap();
    let (data, out) = (folder.path().join("data"), folder.path().join("packed"));
    copy(dataset(), &data);
    std::fs::remove_file(data.join("plan.json")).unwrap();
    let output = pack(&data, &out, &[]);
    let said = common::stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("no plan.json beside manifest.json") && said.contains("renderflow dataset repair"), "{said}");
    assert!(!out.exists());
}

#[cfg(unix)]
#[test]
fn one_process_at_a_time_packs_into_a_folder() {
    let out = tempfile::tempdir().unwrap();
    // As another process that packs holds it.
    let taken = std::fs::File::open(out.path()).unwrap();
    taken.lock().unwrap();
    let refused = pack(dataset(), out.path(), &[]);
    assert_eq!(refused.status.code(), Some(1));
    assert!(stderr(&refused).contains("another process writes to this folder"), "{}", stderr(&refused));
    assert!(files(out.path()).is_empty());
    drop(taken);
    for _ in 0..2 {
        assert!(pack(dataset(), out.path(), &[]).status.success());
    }
    assert!(verify(out.path()).status.success());
}

#[cfg(unix)]
#[test]
fn one_process_at_a_time_exports_into_a_folder() {
    let out = tempfile::tempdir().unwrap();
    let words = ["dataset", "export", dataset().to_str().unwrap(), "--to", "coco", "--out", out.path().to_str().unwrap()];
    // As another process that exports holds it.
    let taken = std::fs::File::open(out.path()).unwrap();
    taken.lock().unwrap();
    let refused = renderflow(&words);
    assert_eq!(refused.status.code(), Some(1));
    assert!(stderr(&refused).contains("another process writes to this folder"), "{}", stderr(&refused));
    assert!(files(out.path()).is_empty());
    drop(taken);
    succeed(&words);
    let made = files(out.path());
    succeed(&words);
    assert!(made.iter().any(|(name, _)| name == "export.json") && files(out.path()) == made);
}
