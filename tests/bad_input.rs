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
    refused(&args, &["scene.json:", "the text ends"], &out);
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
    // A folder in which nothing could be written goes, too.
    if out.exists() {
        let left = common::files(&out).into_iter().map(|f| f.0).filter(|n| n.ends_with(".tmp") || n.ends_with(".exr"));
        let left: Vec<_> = left.collect();
        assert!(left.is_empty(), "left behind: {left:?}");
    }
}

#[test]
fn oidn_asked_for_and_absent() {
    let folder = tempfile::tempdir().unwrap();
    let (out, absent) = (folder.path().join("out"), folder.path().join("absent"));
    let run = |denoise: &str| {
        let arguments = ["render", "--frames", "1", "--resolution", "16", "--spp", "1", "--denoise", denoise, "--out"];
        let mut program = std::process::Command::new(env!("CARGO_BIN_EXE_renderflow"));
        program.args(arguments).arg(&out).env("RENDERFLOW_OIDN", &absent).output().unwrap()
    };
    let output = run("oidn");
    assert_eq!(output.status.code(), Some(1));
    let message = stderr(&output);
    assert!(["make oidn", "pip install pyoidn", "absent"].iter().all(|part| message.contains(part)), "{message}");
    assert!(!out.exists(), "a refused render wrote something");
    // What OIDN is not needed for goes on.
    let output = run("auto");
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(out.join("frame.0000.exr").is_file());
}

#[test]
fn usage_errors_exit_with_2() {
    for args in [&["render"][..], &["no-such-command"], &["dataset", "render", "--plan", "p", "--out", "o", "--shard", "0/3"]] {
        assert_eq!(renderflow(args).status.code(), Some(2), "{args:?}");
    }
}

/// Runs the program, which has to come to an end by itself; its exit code and what it said.
#[cfg(unix)]
fn ends(args: &[&str]) -> (Option<i32>, String) {
    use std::io::Read;
    use std::process::{Command, Stdio};
    let mut child = Command::new(env!("CARGO_BIN_EXE_renderflow"))
        .args(args)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    // Far more than any of these takes: only what waits for ever is stopped.
    for _ in 0..1200 {
        if let Some(status) = child.try_wait().expect("a child") {
            let mut text = String::new();
            child.stdout.take().expect("piped").read_to_string(&mut text).expect("UTF-8");
            child.stderr.take().expect("piped").read_to_string(&mut text).expect("UTF-8");
            return (status.code(), text);
        }
        std::thread::sleep(std::time::Duration::from_millis(100));
    }
    child.kill().expect("a child");
    panic!("{args:?} waits for ever");
}

/// A pipe without a writer.
#[cfg(unix)]
fn pipe(path: &Path) {
    rustix::fs::mknodat(rustix::fs::CWD, path, rustix::fs::FileType::Fifo, rustix::fs::Mode::RUSR, 0).expect("a pipe");
}

/// Every kind of input that a user names, as a pipe and as a socket.
#[cfg(unix)]
#[test]
fn pipes_and_sockets_are_refused_without_waiting() {
    type Make = fn(&Path);
    for (what, make) in [("pipe", pipe as Make), ("socket", |path| drop(std::os::unix::net::UnixListener::bind(path).unwrap()))] {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
        for name in ["x.json", "x.obj", "x.glb", "x.hdr", "x.png", "x.exr", "x.toml", "x.safetensors", "x.index.json", "x.pth"] {
            make(Path::new(&at(name)));
        }
        let results = folder.path().join("results");
        std::fs::create_dir(&results).unwrap();
        make(&results.join("results.json"));
        for pictures in ["truth", "mine"] {
            std::fs::create_dir(folder.path().join(pictures)).unwrap();
        }
        image::RgbImage::new(32, 32).save(at("truth/0.png")).unwrap();
        make(Path::new(&at("mine/0.png")));
        let out = at("out");
        for args in [
            &["render", "--scene", &at("x.json"), "--out", &out][..],
            &["render", "--scene", &at("x.obj"), "--out", &out],
            &["render", "--scene", &at("x.glb"), "--out", &out],
            &["render", "--hdri", &at("x.hdr"), "--out", &out],
            &["render", "--frames", "1", "--reference", &at("x.png"), "--out", &out],
            &["render", "--frames", "1", "--reference", &at("x.exr"), "--out", &out],
            &["demo", "--weights", &at("x.safetensors"), "--out", &out],
            &["weights", "inspect", &at("x.index.json")],
            &["weights", "inspect", &at("x.pth")],
            &["dataset", "render", "--plan", &at("x.toml"), "--out", &out],
            &["dataset", "render", "--plan", &at("x.json"), "--out", &out],
            &["report", &at("results"), "--out", &out],
            &["evaluate", &at("mine"), &at("truth"), "--out", &out],
        ] {
            let (code, said) = ends(args);
            let named = said.contains("not a regular file") || said.contains("cannot read");
            assert!(code == Some(1) && named && !said.contains("panicked"), "{what} {args:?}: {code:?} {said}");
        }
        let files = ["x.json", "x.obj", "x.glb", "x.hdr", "x.png", "x.exr", "x.toml", "x.safetensors"].map(at);
        let args: Vec<&str> = ["check"].into_iter().chain(files.iter().map(String::as_str)).collect();
        let (code, said) = ends(&args);
        assert!(code == Some(1) && said.matches("refused ").count() == files.len(), "{what}: {code:?} {said}");
        // Folders of models and maps go without them.
        let args =
            ["dataset", "plan", "--seed", "1", "--sequences", "1", "--hdris", folder.path().to_str().unwrap(), "--out", &out];
        let (code, said) = ends(&args);
        assert!(code == Some(1) && said.contains("left out: ") && said.contains("no map ending in"), "{what}: {code:?} {said}");
    }
}

/// The scene beside rendered frames names its files in full: it is read again only with the permission that the refusal names.
#[test]
fn files_of_another_folder_need_permission() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (models, maps) = (folder.path().join("models"), folder.path().join("maps"));
    std::fs::create_dir(&models).unwrap();
    std::fs::create_dir(&maps).unwrap();
    std::fs::write(models.join("box.obj"), "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n").unwrap();
    std::fs::write(maps.join("sky.hdr"), renderflow_frame::hdr::encode(&renderflow_frame::Image::filled(8, 4, [1.0; 3])))
        .unwrap();
    let small = ["--frames", "1", "--resolution", "16", "--spp", "1", "--denoise", "none"];
    // What the command line names is allowed by that.
    common::succeed(
        &[&["render", "--scene", &at("models/box.obj"), "--hdri", &at("maps/sky.hdr"), "--out", &at("a")][..], &small].concat(),
    );
    let scene = at("a/scene.json");
    let again = ["render", "--scene", &scene, "--out", &at("b"), "--resolution", "16", "--spp", "1", "--denoise", "none"];
    let option = |folder: &Path| format!("--allow-files {}", folder.display());
    let said = common::fail(&again);
    assert!(said.contains("/environment/source: ") && said.contains(&option(&maps)), "{said}");
    let said = common::fail(&[&again[..], &["--allow-files", maps.to_str().unwrap()]].concat());
    assert!(said.contains("/objects/0 (box): ") && said.contains(&option(&models)), "{said}");
    let both = ["--allow-files", maps.to_str().unwrap(), "--allow-files", models.to_str().unwrap()];
    common::succeed(&[&again[..], &both].concat());
    let frame = |folder: &str| std::fs::read(folder_file(&at(folder))).unwrap();
    assert!(frame("a") == frame("b"), "the same scene, the same bytes");

    assert_eq!(renderflow(&["check", &scene]).status.code(), Some(1));
    common::succeed(&[&["check", &scene][..], &both].concat());
    // Rows that trace the scene of a sequence.
    let evaluate = ["evaluate", "--data", &at("a"), "--methods", "pt1", "--out", &at("results")];
    let said = common::fail(&evaluate);
    assert!(said.contains("a/scene.json") && said.contains(&option(&maps)), "{said}");
    common::succeed(&[&evaluate[..], &both].concat());
    // A folder that is not there allows nothing.
    let said = common::fail(&["check", &scene, "--allow-files", &at("nothing")]);
    assert!(said.contains("there is no such folder"), "{said}");
}

fn folder_file(folder: &str) -> std::path::PathBuf {
    Path::new(folder).join("frame.0000.exr")
}

/// A PNG of one bit a pixel whose header says `width` x `height`; no pixel is in it.
fn png_claiming(width: u32, height: u32) -> Vec<u8> {
    let chunk = |kind: &[u8; 4], data: &[u8]| {
        let body = [&kind[..], data].concat();
        let crc = body.iter().fold(!0_u32, |crc, &byte| {
            (0..8).fold(crc ^ u32::from(byte), |crc, _| if crc & 1 == 1 { crc >> 1 ^ 0xedb8_8320 } else { crc >> 1 })
        });
        [&(data.len() as u32).to_be_bytes()[..], &body, &(!crc).to_be_bytes()].concat()
    };
    let header = [&width.to_be_bytes()[..], &height.to_be_bytes(), &[8, 0, 0, 0, 0]].concat();
    [&b"\x89PNG\r\n\x1a\n"[..], &chunk(b"IHDR", &header), &chunk(b"IDAT", &[0; 64])].concat()
}

/// The sizes are compared before a pixel is decoded: this one would be half a gigabyte.
#[test]
fn a_picture_of_another_size_is_refused_by_its_header() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    for pictures in ["truth", "mine", "huge"] {
        std::fs::create_dir(folder.path().join(pictures)).unwrap();
    }
    image::RgbImage::new(32, 32).save(at("truth/0.png")).unwrap();
    std::fs::write(at("mine/0.png"), png_claiming(40_000, 13_000)).unwrap();
    let said = common::fail(&["evaluate", &at("mine"), &at("truth"), "--out", &at("out")]);
    assert!(said.contains("mine/0.png: 40000 x 13000 pixels where the picture to compare with has 32 x 32"), "{said}");
    std::fs::remove_file(at("mine/0.png")).unwrap();
    let map = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 8192 +X 16384\n";
    std::fs::write(at("mine/0.hdr"), map).unwrap();
    let said = common::fail(&["evaluate", &at("mine"), &at("truth"), "--out", &at("out")]);
    assert!(said.contains("mine/0.hdr: 16384 x 8192 pixels where the picture to compare with has 32 x 32"), "{said}");
    // Nobody says how large the truth should be.
    std::fs::write(at("huge/0.png"), png_claiming(40_000, 13_000)).unwrap();
    let said = common::fail(&["evaluate", &at("truth"), &at("huge"), "--out", &at("out")]);
    assert!(said.contains("huge/0.png: 40000 x 13000 is more than the 67108864 pixels"), "{said}");
}

#[test]
fn maps_that_cannot_be_used_are_left_out_of_a_plan() {
    let folder = tempfile::tempdir().unwrap();
    let maps = folder.path().join("maps");
    std::fs::create_dir(&maps).unwrap();
    std::fs::write(maps.join("good.hdr"), renderflow_frame::hdr::encode(&renderflow_frame::Image::filled(8, 4, [1.0; 3])))
        .unwrap();
    std::fs::write(maps.join("cut.hdr"), b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 64 +X 128\n\x02\x02").unwrap();
    std::fs::write(maps.join("text.exr"), b"no map").unwrap();
    let plan = folder.path().join("plan.json");
    let (maps_text, plan_text) = (maps.to_str().unwrap(), plan.to_str().unwrap());
    let arguments = ["dataset", "plan", "--seed", "1", "--sequences", "1", "--hdris", maps_text, "--out", plan_text];
    let output = renderflow(&arguments);
    assert!(output.status.success(), "{}", stderr(&output));
    for name in ["cut.hdr", "text.exr"] {
        assert!(stderr(&output).lines().any(|line| line.contains("left out: ") && line.contains(name)), "{}", stderr(&output));
    }
    let text = std::fs::read_to_string(&plan).unwrap();
    assert!(text.contains("good.hdr") && !text.contains("cut.hdr") && !text.contains("text.exr"), "{text}");
    std::fs::remove_file(maps.join("good.hdr")).unwrap();
    let said = common::fail(&arguments);
    assert!(said.contains("no map ending in hdr, exr that can be used"), "{said}");
}

/// Names in results make names of files.
#[test]
fn results_name_no_file_of_another_folder() {
    let folder = tempfile::tempdir().unwrap();
    let text = r#"{"version": 2, "program": "p", "title": "t", "machine": "m", "curve": "c", "settings": [], "methods":
        [{"id": "/../../secret", "label": "l", "group": "other", "series": null, "spp": null, "note": ""}]}"#;
    std::fs::write(folder.path().join("results.json"), text).unwrap();
    let out = folder.path().join("report");
    let said = common::fail(&["report", folder.path().to_str().unwrap(), "--out", out.to_str().unwrap()]);
    assert!(said.contains("/methods/0/id: ") && said.contains("is not the plain name of a file"), "{said}");
}
