//! Bad input: a clear error that names file and place, the documented exit code, and no partial file.

mod common;

use common::{renderflow, stderr};
use std::path::Path;

/// Runs, expects exit code 1, and every one of `words` in the message; nothing may have been written to `out`.
fn refused(args: &[&str], words: &[&str], out: &Path) {
    let output = renderflow(args);
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{args:?}: {message}");
    for word in words {
        assert!(message.contains(word), "{args:?}: {message:?} does not say {word:?}");
    }
    assert!(!message.contains("panicked"), "{message}");
    let left = if out.is_dir() { common::files(out) } else { Vec::new() };
    let names: Vec<_> = left.iter().map(|f| &f.0).filter(|n| n.ends_with(".exr") || n.ends_with(".tmp")).collect();
    assert!(names.is_empty(), "left behind: {names:?}");
}

#[test]
fn missing_scene() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    refused(
        &["render", "--scene", "no/such/scene.json", "--out", out.to_str().unwrap()],
        &["no/such/scene.json", "No such file"],
        &out,
    );
    refused(&["render", "--scene", "no/such/model.glb", "--out", out.to_str().unwrap()], &["no/such/model.glb"], &out);
    refused(&["demo", "--hdri", "no-such-sky.hdr", "--out", out.to_str().unwrap()], &["no-such-sky.hdr"], &out);
}

#[test]
fn bad_value_in_scene() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, out) = (folder.path().join("scene.json"), folder.path().join("out"));
    let text = common::succeed(&["compose", "--seed", "3"]);
    let mut json: serde_json::Value = serde_json::from_str(&text).unwrap();
    json["materials"][0]["roughness"] = 1.4.into();
    std::fs::write(&scene, json.to_string()).unwrap();
    let args = ["render", "--scene", scene.to_str().unwrap(), "--out", out.to_str().unwrap()];
    refused(&args, &["scene.json", "/materials/0/roughness", "1.4"], &out);
    std::fs::write(&scene, &text[..text.len() / 2]).unwrap();
    refused(&args, &["scene.json:", "EOF"], &out);
}

#[test]
fn gltf_with_broken_buffer() {
    let folder = tempfile::tempdir().unwrap();
    let (model, out) = (folder.path().join("broken.gltf"), folder.path().join("out"));
    // The accessor asks for 3 positions (36 bytes), the buffer is said to be 36 bytes long and holds 12.
    let gltf = r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],"nodes":[{"mesh":0}],
        "meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],
        "accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,0]}],
        "bufferViews":[{"buffer":0,"byteLength":36}],"buffers":[{"byteLength":36,"uri":"broken.bin"}]}"#;
    std::fs::write(&model, gltf).unwrap();
    let args = ["render", "--scene", model.to_str().unwrap(), "--out", out.to_str().unwrap()];
    refused(&args, &["broken.bin"], &out);
    std::fs::write(folder.path().join("broken.bin"), [0u8; 12]).unwrap();
    refused(&args, &["broken.gltf", "/buffers/0"], &out);
}

#[test]
fn hdr_with_nan_is_repaired_and_counted() {
    let folder = tempfile::tempdir().unwrap();
    let (map, out) = (folder.path().join("sky.exr"), folder.path().join("out"));
    common::write_map(&map, |x, _| if x == 3 { f32::NAN } else { 1.0 });
    let output = renderflow(&[
        "render",
        "--hdri",
        map.to_str().unwrap(),
        "--frames",
        "1",
        "--resolution",
        "16",
        "--spp",
        "2",
        "--denoise",
        "none",
        "--out",
        out.to_str().unwrap(),
    ]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(stderr(&output).contains("8 texels"), "{}", stderr(&output));
    let frame = renderflow_frame::exr::read(&out.join("frame.0000.exr")).unwrap();
    assert!(frame.beauty.unwrap().pixels.iter().flatten().all(|v| v.is_finite()));
}

#[test]
fn truncated_hdr() {
    let folder = tempfile::tempdir().unwrap();
    let (map, out) = (folder.path().join("sky.hdr"), folder.path().join("out"));
    std::fs::write(&map, b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 64 +X 128\n\x02\x02").unwrap();
    refused(&["render", "--hdri", map.to_str().unwrap(), "--out", out.to_str().unwrap()], &["sky.hdr"], &out);
}

#[test]
fn wrong_weights() {
    let folder = tempfile::tempdir().unwrap();
    let (weights, out) = (folder.path().join("w.safetensors"), folder.path().join("out"));
    let args = ["demo", "--weights", weights.to_str().unwrap(), "--out", out.to_str().unwrap()];
    refused(&args, &["w.safetensors"], &out);
    std::fs::write(&weights, b"not weights at all").unwrap();
    refused(&args, &["w.safetensors"], &out);
    // A well-formed file of something else: header of 2 bytes, no tensors.
    std::fs::write(&weights, b"\x02\0\0\0\0\0\0\0{}").unwrap();
    refused(&args, &["w.safetensors"], &out);
}

/// A disk that is full: `ulimit -f` lets no file grow past 4 KiB (1 block of 4, where the shell counts 512 or 1024 bytes).
#[test]
#[cfg(target_os = "linux")]
fn full_disk() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let command = format!(
        "trap '' XFSZ; ulimit -f 4; exec {} render --frames 1 --resolution 64 --spp 1 --denoise none --out {}",
        env!("CARGO_BIN_EXE_renderflow"),
        out.display()
    );
    let output = std::process::Command::new("sh").args(["-c", &command]).output().unwrap();
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    let message = stderr(&output);
    assert!(message.contains("cannot write") && message.contains("out"), "{message}");
    let left: Vec<_> =
        common::files(&out).into_iter().map(|f| f.0).filter(|n| n.ends_with(".tmp") || n.ends_with(".exr")).collect();
    assert!(left.is_empty(), "left behind: {left:?}");
}

#[test]
fn oidn_asked_for_and_absent() {
    if cfg!(feature = "oidn") {
        println!("skipped: built with OIDN");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    refused(&["render", "--denoise", "oidn", "--out", out.to_str().unwrap()], &["make oidn"], &out);
}

#[test]
fn usage_errors_exit_with_2() {
    for args in [&["render"][..], &["no-such-command"], &["dataset", "render", "--plan", "p", "--out", "o", "--shard", "0/3"]] {
        assert_eq!(renderflow(args).status.code(), Some(2), "{args:?}");
    }
}
