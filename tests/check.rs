//! `renderflow check`: every kind of file, good and bad, by content; one line each, in order; the exit code tells.

mod common;

use common::{renderflow, stderr};
use renderflow_frame::{Camera, Frame, Image, compact, exr, hdr, transforms};
use std::path::{Path, PathBuf};

/// Runs `check` on `files`: exit code and one line a file.
fn check(flags: &[&str], files: &[PathBuf]) -> (Option<i32>, String) {
    let names = files.iter().map(|f| f.to_str().expect("UTF-8"));
    let args: Vec<&str> = ["check"].into_iter().chain(flags.iter().copied()).chain(names).collect();
    let output = renderflow(&args);
    assert!(!stderr(&output).contains("panicked"), "{}", stderr(&output));
    (output.status.code(), String::from_utf8_lossy(&output.stdout).into_owned())
}

/// `check` accepts `file` and says all of `words`.
fn accepted(file: &Path, words: &[&str]) {
    let (code, text) = check(&[], &[file.into()]);
    assert_eq!(code, Some(0), "{text}");
    assert!(text.starts_with("accepted ") && text.lines().count() == 1, "{text}");
    words.iter().for_each(|word| assert!(text.contains(word), "{text} does not say {word:?}"));
}

/// `check` refuses `file` in one line with all of `words`.
fn refused(file: &Path, words: &[&str]) {
    let (code, text) = check(&[], &[file.into()]);
    assert_eq!(code, Some(1), "{text}");
    assert!(text.starts_with("refused  ") && text.lines().count() == 1, "{text}");
    words.iter().for_each(|word| assert!(text.contains(word), "{text} does not say {word:?}"));
}

/// A file of `bytes` in `folder`.
fn file(folder: &Path, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, bytes).unwrap();
    path
}

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().unwrap()
}

/// The folder with other people's files; `None` where it is absent.
fn assets() -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/assets");
    let there = path.is_dir();
    if !there {
        println!("skipped: {} is not there", path.display());
    }
    there.then_some(path)
}

const TRIANGLE: &str = "v 0 0 0\nv 2 0 0\nv 0 0 -3\nf 1 2 3\n";

/// A triangle from (0, 0, 0) to (1, 1, 0) with its 36 bytes of positions inside; its accessor claims `count` of them.
fn gltf(count: u32) -> String {
    format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":{count},"type":"VEC3","min":[0,0,0],"max":[1,1,0]}}],
        "bufferViews":[{{"buffer":0,"byteLength":36}}],
        "buffers":[{{"byteLength":36,"uri":"data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA"}}]}}"#
    )
}

/// The same as binary glTF: a header of 12 bytes and one JSON chunk.
fn glb(text: &str) -> Vec<u8> {
    let mut json = text.as_bytes().to_vec();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut bytes = b"glTF".to_vec();
    for number in [2, 20 + json.len() as u32, json.len() as u32] {
        bytes.extend(number.to_le_bytes());
    }
    bytes.extend(b"JSON");
    bytes.extend(json);
    bytes
}

/// Safetensors with zeros: names and shapes of 32-bit floats.
fn safetensors(tensors: &[(&str, &[usize])]) -> Vec<u8> {
    let (mut entries, mut end) = (Vec::new(), 0);
    for (name, shape) in tensors {
        let start = end;
        end += 4 * shape.iter().product::<usize>();
        entries.push(format!(r#""{name}":{{"dtype":"F32","shape":{shape:?},"data_offsets":[{start},{end}]}}"#));
    }
    let header = format!("{{{}}}", entries.join(","));
    let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
    bytes.extend(header.as_bytes());
    bytes.resize(bytes.len() + end, 0);
    bytes
}

/// A frame of 4 x 2 pixels, the left half of it a hit.
fn frame() -> Frame {
    let hit = |x: usize| x < 2;
    Frame {
        width: 4,
        height: 2,
        beauty: Some(Image::filled(4, 2, [0.25, 0.5, 1.0])),
        alpha: Image::from_fn(4, 2, |x, _| f32::from(u8::from(hit(x)))),
        albedo: Image::from_fn(4, 2, |x, _| if hit(x) { [0.5; 3] } else { [0.0; 3] }),
        normal: Image::from_fn(4, 2, |x, _| if hit(x) { [0.0, 0.6, 0.8] } else { [0.0; 3] }),
        depth: Image::from_fn(4, 2, |x, _| if hit(x) { 2.0 } else { f32::INFINITY }),
        material: Image::filled(4, 2, [0.0; 3]),
        object_id: Image::from_fn(4, 2, |x, _| u32::from(hit(x))),
        material_id: Image::from_fn(4, 2, |x, _| u32::from(hit(x))),
        ..Frame::default()
    }
}

#[test]
fn scenes() {
    let folder = folder();
    let text = common::succeed(&["compose", "--seed", "3"]);
    accepted(
        &file(folder.path(), "scene.json", &text),
        &["scene, instances", "triangles", "frames", "environment", "low (", "high ("],
    );
    let mut json: serde_json::Value = serde_json::from_str(&text).unwrap();
    json["materials"][0]["roughness"] = 1.4.into();
    json["resolution"][1] = 0.into();
    refused(
        &file(folder.path(), "range.json", json.to_string()),
        &["scene: ", "/materials/0/roughness: 1.4 is outside", "; ", "/resolution/1"],
    );
    refused(&file(folder.path(), "cut.json", &text[..text.len() / 2]), &["scene: ", "the text ends"]);
    let wanting = r#"{"version":1,"name":"a","resolution":[8,8],"camera":{"type":"orbit","target":[0,0,0],"distance":3,"elevation":10,
        "azimuth":0,"degrees_per_frame":0,"vertical_fov":40},"environment":{"source":{"file":"none.hdr"}},"objects":[]}"#;
    refused(&file(folder.path(), "wanting.json", wanting), &["scene: ", "/environment/source", "none.hdr", "No such file"]);
}

#[test]
fn models() {
    let folder = folder();
    let folder = folder.path();
    let counts = ["instances 1", "vertices 3", "triangles 1", "dropped without area 0"];
    accepted(&file(folder, "a.gltf", gltf(3)), &[&counts[..], &["gltf", "low (0 0 0)", "high (1 1 0)"]].concat());
    accepted(&file(folder, "a.glb", glb(&gltf(3))), &counts);
    accepted(&file(folder, "a.obj", TRIANGLE), &[&counts[..], &["obj", "low (0 0 -3)", "high (2 0 0)"]].concat());
    let ply = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n\
               property list uchar int vertex_indices\nend_header\n0 0 -3\n2 0 0\n0 0 0\n";
    accepted(
        &file(folder, "a.ply", format!("{ply}3 0 1 2\n")),
        &[&counts[..], &["ply", "low (0 0 -3)", "high (2 0 0)"]].concat(),
    );
    // One face without area is dropped and counted.
    accepted(&file(folder, "flat.obj", format!("{TRIANGLE}f 1 1 2\n")), &["triangles 1", "dropped without area 1"]);

    refused(&file(folder, "long.gltf", gltf(30)), &["gltf: ", "accessor"]);
    refused(&file(folder, "cut.glb", &glb(&gltf(3))[..100]), &["gltf: "]);
    refused(&file(folder, "broken.gltf", &gltf(3)[..200]), &["gltf: ", "line 3 column 49"]);
    refused(&file(folder, "bad.obj", "v 0 0 0\nv 1 zwei 0\nv 0 0 1\nf 1 2 3\n"), &["obj: ", "line 2"]);
    refused(&file(folder, "points.obj", "v 0 0 0\np 1\n"), &["obj: ", "no triangle"]);
    refused(&file(folder, "cut.ply", format!("{ply}3 0 1")), &["ply: ", "face 0: the file ends"]);
}

#[test]
fn maps_and_frames() {
    let folder = folder();
    let folder = folder.path();
    let sky = Image::from_fn(8, 4, |x, _| [0.5, 1.0, x as f32]);
    accepted(&file(folder, "a.hdr", hdr::encode(&sky)), &["map, size 8 x 4", "lowest 0", "highest 7", "repaired texels 0"]);
    let exr_map = folder.join("b.exr");
    common::write_map(&exr_map, |x, y| if (x, y) == (3, 1) { f32::NAN } else { 2.0 });
    accepted(&exr_map, &["map, size 16 x 8", "repaired texels 1"]);
    refused(&file(folder, "cut.hdr", b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 64 +X 128\n\x02\x02"), &["map: "]);
    let bytes = std::fs::read(&exr_map).unwrap();
    refused(&file(folder, "cut.exr", &bytes[..bytes.len() / 2]), &["map: "]);

    let path = folder.join("frame.exr");
    exr::write(&path, &frame()).unwrap();
    accepted(&path, &["frame, size 4 x 2", "covered 4", "highest 1"]);
    let with = |name: &str, change: &dyn Fn(&mut Frame)| {
        let (path, mut changed) = (folder.join(name), frame());
        change(&mut changed);
        exr::write(&path, &changed).unwrap();
        path
    };
    refused(&with("normal.exr", &|f| f.normal.pixels[5] = [0.0, 0.0, 0.5]), &["frame: pixel (1, 1)", "length 0.5"]);
    refused(&with("depth.exr", &|f| f.depth.pixels[1] = -2.0), &["frame: pixel (1, 0)", "depth.Z is -2"]);
    refused(&with("miss.exr", &|f| f.depth.pixels[0] = f32::INFINITY), &["frame: pixel (0, 0)", "miss"]);
    let whole = std::fs::read(&path).unwrap();
    refused(&file(folder, "cut_frame.exr", &whole[..whole.len() - 40]), &["frame: "]);

    // The compact form, whatever the file is called.
    let (compact, _) = compact::encode(&path, &frame()).unwrap();
    accepted(&file(folder, "frame.rff", &compact), &["frame, size 4 x 2", "covered 4", "highest 1"]);
    accepted(&file(folder, "other.exr", &compact), &["frame, size 4 x 2"]);
    refused(&file(folder, "cut.rff", &compact[..compact.len() - 1]), &["frame: ", "cut.rff", "cut short: layer material_id"]);
    refused(&file(folder, "empty.rff", b""), &["frame: ", "empty.rff"]);
}

#[test]
fn textures() {
    let folder = folder();
    let path = folder.path().join("a.png");
    image::RgbImage::from_fn(6, 3, |x, y| image::Rgb([x as u8, y as u8, 9])).save(&path).unwrap();
    accepted(&path, &["texture, size 6 x 3", "levels 3", "bytes"]);
    let bytes = std::fs::read(&path).unwrap();
    refused(&file(folder.path(), "cut.png", &bytes[..bytes.len() / 2]), &["texture: "]);
    let jpeg = folder.path().join("b.jpg");
    image::RgbImage::new(5, 5).save(&jpeg).unwrap();
    accepted(&jpeg, &["texture, size 5 x 5"]);
}

#[test]
fn weights() {
    let folder = folder();
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("model/weights/fusion.safetensors");
    let network = renderflow_model::fusion::Fusion::shipped().unwrap();
    let values = format!("parameters {}", network.header().fusion.values());
    accepted(&shipped, &["weights, network fusion", "tensors 62", &values]);
    let bytes = std::fs::read(shipped).unwrap();
    refused(&file(folder.path(), "cut.safetensors", &bytes[..bytes.len() - 1000]), &["weights: "]);
    refused(
        &file(folder.path(), "other.safetensors", safetensors(&[("a", &[2, 2])])),
        &["weights: ", "does not hold weights of this program"],
    );
    refused(&file(folder.path(), "lpips.safetensors", safetensors(&[("lin.0.weight", &[64])])), &["lpips: ", "is missing"]);
    refused(&file(folder.path(), "text.safetensors", "not weights at all"), &["weights: "]);
    if let Some(assets) = assets() {
        accepted(&assets.join("lpips/lpips_alex.safetensors"), &["lpips, backbone alex", "parameters 2470854"]);
        accepted(&assets.join("lpips/lpips_squeeze.safetensors"), &["lpips, backbone squeeze"]);
    }
}

#[test]
fn plans_cameras_and_datasets() {
    let folder = folder();
    let (plan, data) = (folder.path().join("plan.json"), folder.path().join("data"));
    let names = [plan.to_str().unwrap(), data.to_str().unwrap()];
    let sizes = ["--seed", "1", "--sequences", "2", "--frames", "2", "--resolution", "12", "--spp", "1", "--keyframe-gap", "2"];
    common::succeed(&[&["dataset", "plan", "--out", names[0]][..], &sizes].concat());
    accepted(&plan, &["plan, sequences 2", "frames 2", "size 12 x 12", "spp 1"]);
    let text = std::fs::read_to_string(&plan).unwrap();
    let with = |value: &str| file(folder.path(), "bad.json", text.replacen("\"spp\": 1", value, 1));
    refused(&with("\"spp\": 99999999"), &["plan: ", "/render/spp: 99999999 is outside"]);
    refused(&with("\"samples\": 1"), &["plan: ", "unknown field `samples`", "line"]);

    common::succeed(&["dataset", "render", "--plan", names[0], "--out", names[1]]);
    accepted(&data, &["dataset", "sequences 2", "frames 4", "keyframes 2"]);
    let sequences = common::files(&data);
    let one = |ending: &str| data.join(&sequences.iter().find(|f| f.0.ends_with(ending)).expect("was rendered").0);
    let cameras = one("transforms.json");
    accepted(&cameras, &["transforms, cameras 2", "missing frames 0"]);
    accepted(cameras.parent().unwrap(), &["dataset", "sequences 1"]);
    let text = std::fs::read_to_string(&cameras).unwrap();
    refused(&file(folder.path(), "c.json", text.replacen("opengl_c2w", "opencv_c2w", 1)), &["transforms: ", "/convention"]);

    let picture = one("frame.0001.exr");
    let whole = std::fs::read(&picture).unwrap();
    std::fs::write(&picture, &whole[..whole.len() / 2]).unwrap();
    refused(&data, &["dataset: ", "frame.0001.exr"]);
    std::fs::write(&picture, &whole).unwrap();
    let mut sequence = transforms::read(&cameras).unwrap();
    sequence.cameras = sequence.cameras.iter().map(|c| Camera { width: c.width + 1, ..*c }).collect();
    sequence.tracks = Default::default();
    transforms::write(&cameras, &sequence).unwrap();
    refused(&data, &["dataset: ", "frame.0000.exr", "12 x 12 pixels where the camera has 13 x 12"]);
    refused(folder.path().join("nothing").as_path(), &["No such file"]);
    let empty = folder.path().join("empty");
    std::fs::create_dir(&empty).unwrap();
    refused(&empty, &["dataset: no sequence"]);
}

/// The content decides what a file is, whatever its name says.
#[test]
fn endings_may_lie_or_be_missing() {
    let folder = folder();
    let folder = folder.path();
    for name in ["model", "model.obj", "model.png"] {
        let path = file(folder, name, glb(&gltf(3)));
        // The renderer asks for a model's ending where there is one.
        if name == "model.png" {
            refused(&path, &["gltf: ", "is not a .gltf"])
        } else {
            accepted(&path, &["gltf", "triangles 1"])
        }
    }
    accepted(&file(folder, "triangle", TRIANGLE), &["obj", "triangles 1"]);
    accepted(&file(folder, "triangle.gltf", TRIANGLE), &["obj", "triangles 1"]);
    accepted(&file(folder, "sky.obj", hdr::encode(&Image::filled(4, 2, [1.0; 3]))), &["map, size 4 x 2"]);
    accepted(&file(folder, "scene.hdr", common::succeed(&["compose", "--seed", "3"])), &["scene, instances"]);
    exr::write(&folder.join("frame.txt"), &frame()).unwrap();
    accepted(&folder.join("frame.txt"), &["frame, size 4 x 2"]);
    refused(&file(folder, "letter.txt", "Dear reader,\n"), &["unknown kind of file"]);
    refused(&file(folder, "nothing", ""), &["the file is empty"]);
}

#[test]
fn many_files_in_order_as_text_and_json() {
    let folder = folder();
    let good = file(folder.path(), "good.obj", TRIANGLE);
    let bad = file(folder.path(), "bad.hdr", "#?RADIANCE\n");
    let files: Vec<PathBuf> = (0..40).map(|i| if i % 3 == 1 { bad.clone() } else { good.clone() }).collect();
    let (code, text) = check(&[], &files);
    assert_eq!(code, Some(1));
    let verdicts: Vec<bool> = text.lines().map(|line| line.starts_with("accepted")).collect();
    assert_eq!(verdicts, (0..40).map(|i| i % 3 != 1).collect::<Vec<_>>(), "{text}");

    let (code, text) = check(&["--json"], &files);
    assert_eq!(code, Some(1));
    let array: Vec<serde_json::Value> = serde_json::from_str(&text).unwrap();
    assert_eq!(array.len(), 40);
    for (i, found) in array.iter().enumerate() {
        assert_eq!(found["path"], files[i].to_str().unwrap());
        assert_eq!(found["accepted"], i % 3 != 1);
        let (kind, known) =
            if i % 3 == 1 { ("map", found["reason"].is_string()) } else { ("obj", found["counts"]["triangles"] == 1) };
        assert!(found["kind"] == kind && known, "{found}");
    }

    let (code, text) = check(&["--refused"], &files);
    assert_eq!((code, text.lines().count()), (Some(1), 13), "{text}");
    let (code, text) = check(&["--refused"], &[good]);
    assert_eq!((code, text.as_str()), (Some(0), ""));
}

/// Nothing in the folder of other people's files, broken ones among them, makes a loader panic.
#[test]
fn assets_are_accepted_or_refused() {
    let Some(assets) = assets() else { return };
    let found: Vec<PathBuf> = ["gltf", "obj", "exr", "hdri"]
        .iter()
        .flat_map(|kind| common::files(&assets.join(kind)).into_iter().map(move |f| Path::new(kind).join(f.0)))
        .map(|name| assets.join(name))
        .collect();
    let (code, text) = check(&["--json"], &found);
    assert_eq!(code, Some(1), "some of them are broken");
    let array: Vec<serde_json::Value> = serde_json::from_str(&text).unwrap();
    assert_eq!(array.len(), found.len());
    let accepted = array.iter().filter(|f| f["accepted"] == true).count();
    println!("{accepted} of {} files accepted", array.len());
    assert!(accepted > 50 && !text.contains("internal error"), "{accepted}");
    for needed in ["hdri/potsdamer_platz_1k.hdr", "obj/spot/spot_triangulated.obj"] {
        let found = array.iter().find(|f| f["path"].as_str().is_some_and(|p| p.ends_with(needed)));
        assert!(found.is_none_or(|f| f["accepted"] == true), "{found:?}");
    }
}
