//! `render` and `check` with the cameras and animations of model files, and with cameras of `transforms.json`.

mod common;

use base64::Engine;
use common::{fail, renderflow, stderr, succeed};
use renderflow_frame::{exr, transforms};
use serde_json::{Value, json};
use std::path::Path;

/// A square that rises by a metre in a quarter of a second, a camera that looks at it, and one that rises with it.
fn model(folder: &Path) -> String {
    let numbers =
        [&[0.0_f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0][..], &[0.0, 0.25], &[0.0, 0.0, 0.0, 0.0, 1.0, 0.0]];
    let bytes: Vec<u8> = numbers.concat().into_iter().flat_map(f32::to_le_bytes).collect();
    let view = |from: usize, length: usize| json!({ "buffer": 0, "byteOffset": from, "byteLength": length });
    let lens = json!({ "type": "perspective", "perspective": { "yfov": 0.8, "aspectRatio": 1.5, "znear": 0.1 } });
    let document = json!({
        "asset": { "version": "2.0" },
        "buffers": [{ "byteLength": bytes.len(),
            "uri": format!("data:;base64,{}", base64::engine::general_purpose::STANDARD.encode(&bytes)) }],
        "bufferViews": [view(0, 48), view(48, 8), view(56, 24)],
        "accessors": [
            { "bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 4 },
            { "bufferView": 1, "componentType": 5126, "type": "SCALAR", "count": 2 },
            { "bufferView": 2, "componentType": 5126, "type": "VEC3", "count": 2 },
        ],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 }, "mode": 5 }] }],
        "cameras": [lens],
        "nodes": [
            { "mesh": 0, "children": [1] },
            { "name": "Lift", "camera": 0, "translation": [0.5, 0.5, 3] },
            { "name": "Front", "camera": 0, "translation": [0.5, 0.5, 4] },
        ],
        "scenes": [{ "nodes": [0, 2] }],
        "animations": [{ "name": "Rise", "samplers": [{ "input": 1, "output": 2 }],
            "channels": [{ "sampler": 0, "target": { "node": 0, "path": "translation" } }] }],
    });
    let path = folder.join("model.gltf");
    std::fs::write(&path, document.to_string()).unwrap();
    path.to_string_lossy().into_owned()
}

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> String {
        self.0.path().join(name).to_string_lossy().into_owned()
    }

    /// The words of a small render into the folder `out`.
    fn words(&self, input: &str, out: &str, more: &[&str]) -> Vec<String> {
        let out = self.path(out);
        let all = ["render", input, "--spp", "1", "--denoise", "none", "--no-sheet", "-o", &out];
        all.iter().chain(more).map(|word| (*word).to_owned()).collect()
    }

    /// Renders, and returns the cameras that are left and what was said.
    fn render(&self, input: &str, out: &str, more: &[&str]) -> (transforms::Sequence, String) {
        let words = self.words(input, out, more);
        let output = renderflow(&words.iter().map(String::as_str).collect::<Vec<_>>());
        assert!(output.status.success(), "{more:?}: {}", stderr(&output));
        (transforms::read(&self.0.path().join(out).join("transforms.json")).unwrap(), stderr(&output))
    }

    fn refused(&self, input: &str, more: &[&str]) -> String {
        let words = self.words(input, "refused", more);
        fail(&words.iter().map(String::as_str).collect::<Vec<_>>())
    }
}

#[test]
fn a_model_is_played_and_seen_through_its_cameras() {
    let folder = Folder::new();
    let model = model(folder.0.path());
    // At rest, the notes say what there is.
    let (rest, said) = folder.render(&model, "rest", &["--resolution", "24x16"]);
    assert_eq!((rest.cameras.len(), rest.tracks.objects.len()), (1, 0));
    for note in [
        "the file has 2 cameras (Lift, Front); --camera NAME uses one",
        "the file has 1 animation (Rise); --animation NAME plays one",
    ] {
        assert!(said.contains(note), "{note:?} is not in {said}");
    }
    // A quarter of a second at 24 frames is six frames, in which the object moves.
    let (moving, said) = folder.render(&model, "moving", &["--resolution", "24x16", "--animation", "Rise", "--camera", "Lift"]);
    assert!(!said.contains("--animation NAME") && !said.contains("--camera NAME"), "{said}");
    assert_eq!(moving.cameras.len(), 6);
    let track = &moving.tracks.objects[&1];
    let rise = |frame: usize| track[frame].translation.y - track[0].translation.y;
    let scale = track[0].matrix3.x_axis.length();
    for (frame, camera) in moving.cameras.iter().enumerate() {
        assert!((rise(frame) - scale * frame as f32 / 6.0).abs() < 1e-5, "frame {frame}");
        let up = camera.position().y - moving.cameras[0].position().y;
        assert!((up - rise(frame)).abs() < 1e-5, "frame {frame}: the camera rises by {up}");
        assert!((camera.fl_y - 8.0 / 0.4_f32.tan()).abs() < 1e-3);
    }
    // The square is seen by the camera that rises with it at the same place in every frame.
    let ids = |frame: usize| exr::read(Path::new(&folder.path(&format!("moving/frame.{frame:04}.exr")))).unwrap().object_id;
    assert_eq!(*ids(5).at(12, 8), 1);
    let square = |frame: usize| ids(frame).pixels.iter().map(|&id| id == 1).collect::<Vec<_>>();
    assert_eq!(square(5), square(0));
    // Without a name, the first; the number of frames may be another. The scene beside the frames says all of it.
    let (short, _) = folder.render(&model, "short", &["--resolution", "24x16", "--frames", "2", "--camera", "1", "--animation"]);
    assert_eq!((short.cameras.len(), short.cameras[0]), (2, short.cameras[1]));
    let scene: Value = serde_json::from_str(&std::fs::read_to_string(folder.path("short/scene.json")).unwrap()).unwrap();
    assert_eq!(scene["objects"][0]["animation"]["clip"], "0");
    let outside = folder.0.path().to_string_lossy().into_owned();
    let (again, _) = folder.render(&folder.path("short/scene.json"), "again", &["--allow-files", &outside]);
    assert_eq!(again.cameras, short.cameras);
    // A scene file plays one as well.
    let scene = folder.path("rest/scene.json");
    let (played, _) = folder.render(&scene, "played", &["--allow-files", &outside, "--animation", "Rise", "--camera", "Lift"]);
    assert_eq!((played.cameras.len(), played.tracks.objects.len()), (6, 1));
    // A picture that is narrower than the camera's.
    let (_, said) = folder.render(&model, "narrow", &["--resolution", "16", "--camera", "Front"]);
    assert!(said.contains("camera Front: its pictures are 1.5 times as wide as high, so 16x16 cuts off their sides"), "{said}");
}

/// A part that rises and one that stays belong to one object: no transform tells how the object moves.
#[test]
fn parts_that_move_apart_are_not_followed() {
    let folder = Folder::new();
    let model = model(folder.0.path());
    let mut document: Value = serde_json::from_str(&std::fs::read_to_string(&model).unwrap()).unwrap();
    document["nodes"][2]["mesh"] = json!(0);
    std::fs::write(&model, document.to_string()).unwrap();
    let (apart, _) = folder.render(&model, "apart", &["--resolution", "24x16", "--animation", "Rise", "--camera", "Lift"]);
    assert!(apart.tracks.objects[&1].is_empty(), "{:?}", apart.tracks);
    let cameras = std::fs::read_to_string(folder.path("apart/transforms.json")).unwrap();
    assert_eq!(serde_json::from_str::<Value>(&cameras).unwrap()["object_transforms"], json!({ "1": [] }));
}

#[test]
fn what_is_not_there_is_answered_with_what_is() {
    let folder = Folder::new();
    let model = model(folder.0.path());
    let says = folder.refused(&model, &["--camera", "Back"]);
    assert!(says.contains("no camera is named \"Back\"; there are Lift, Front"), "{says}");
    let says = folder.refused(&model, &["--animation", "Fall"]);
    assert!(says.contains("no animation is named \"Fall\"; there are Rise"), "{says}");
    let obj = folder.path("a.obj");
    std::fs::write(&obj, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
    assert!(folder.refused(&obj, &["--animation"]).contains("a.obj: only a glTF file has animations"));
    assert!(folder.refused(&obj, &["--camera", "0"]).contains("no node of the file's scene shows a camera"));
    let words = ["render", "--animation", "-o", &folder.path("composed")];
    assert!(fail(&words).contains("a composed scene has no cameras or animations of a file"));
    let both = folder.words(&model, "both", &["--camera", "0", "--cameras", "x.json"]);
    let output = renderflow(&both.iter().map(String::as_str).collect::<Vec<_>>());
    assert_eq!(output.status.code(), Some(2));
    let found = succeed(&["check", &model]);
    assert!(found.contains("cameras 2") && found.contains("animations 1"), "{found}");
}

/// What a render leaves gives the same cameras, and with them the same pictures.
#[test]
fn cameras_of_a_render_give_its_pictures_again() {
    let folder = Folder::new();
    let model = model(folder.0.path());
    let (first, _) = folder.render(&model, "first", &["--resolution", "24x16", "--frames", "3"]);
    let (again, _) = folder.render(&model, "again", &["--cameras", &folder.path("first/transforms.json")]);
    assert_eq!(again.cameras.len(), 3);
    for (a, b) in first.cameras.iter().zip(&again.cameras) {
        assert!(a.camera_to_world.abs_diff_eq(b.camera_to_world, 1e-6), "{a:?} is not {b:?}");
        assert!((a.fl_x - b.fl_x).abs() < 1e-4 && (a.cy - b.cy).abs() < 1e-4 && [a.width, a.height] == [b.width, b.height]);
    }
    for frame in 0..3 {
        let read = |out: &str| exr::read(Path::new(&folder.path(&format!("{out}/frame.{frame:04}.exr")))).unwrap();
        assert_eq!(read("first").raw, read("again").raw, "frame {frame}");
    }
}

#[test]
fn cameras_of_a_capture_go_with_the_model() {
    let folder = Folder::new();
    let model = model(folder.0.path());
    let path = folder.path("capture.json");
    let capture = |distortion: f64| {
        json!({ "camera_model": "OPENCV", "w": 48, "h": 32, "fl_x": 40, "fl_y": 40, "cx": 20.5, "cy": 16, "k1": distortion,
            "frames": [{ "file_path": "images/a.png", "transform_matrix":
                [[1, 0, 0, 0.5], [0, 1, 0, 0.5], [0, 0, 1, 4], [0, 0, 0, 1]] }] })
    };
    std::fs::write(&path, capture(0.0).to_string()).unwrap();
    let (seen, _) = folder.render(&model, "seen", &["--cameras", &path, "--resolution", "24x16"]);
    assert_eq!((seen.cameras.len(), seen.cameras[0].fl_x, seen.cameras[0].cx), (1, 20.0, 10.25));
    // The square's middle stands before the camera, so it is at the principal point.
    let ids = exr::read(Path::new(&folder.path("seen/frame.0000.exr"))).unwrap().object_id;
    let square: Vec<usize> = (0..24).filter(|&x| *ids.at(x, 7) == 1).collect();
    // 5 pixels: a metre, 4 metres away.
    assert_eq!(square, [8, 9, 10, 11, 12], "{square:?}");
    let says = folder.refused(&model, &["--cameras", &path, "--resolution", "24x24"]);
    assert!(says.contains("its pictures have 48 x 32 pixels, and 24 x 24 is another shape; --resolution 24x16 fits"), "{says}");
    let found = succeed(&["check", &path]);
    assert!(found.contains("transforms") && found.contains("cameras 1") && found.contains("size 48 x 32"), "{found}");
    // A lens that bends lines goes into the frames and their transforms.
    std::fs::write(&path, capture(0.1).to_string()).unwrap();
    let (bent, _) = folder.render(&model, "bent", &["--cameras", &path, "--resolution", "24x16"]);
    assert_eq!(bent.cameras[0].distortion.unwrap().k1, 0.1);
    let frame = exr::read(Path::new(&folder.path("bent/frame.0000.exr"))).unwrap();
    assert_eq!(frame.info.camera, bent.cameras[0]);
    std::fs::write(&path, capture(-4.0).to_string()).unwrap();
    let says = folder.refused(&model, &["--cameras", &path]);
    assert!(says.contains("/frames/0: the lens shows nothing at"), "{says}");
}

/// A shutter blurs what moves, and a render goes on only with the one it began with.
#[test]
fn a_shutter_blurs_what_moves() {
    let folder = Folder::new();
    let model = model(folder.0.path());
    let words = |out: &str, more: &[&str]| -> Vec<String> {
        let out = folder.path(out);
        let moving = ["--animation", "Rise", "--camera", "Front", "--frames", "3", "--resolution", "24x16", "-o", &out];
        let all = [&["render", &model, "--denoise", "none", "--no-sheet"], &moving[..], more].concat();
        all.into_iter().map(str::to_owned).collect()
    };
    let run = |out: &str, more: &[&str]| {
        let words = words(out, more);
        let output = renderflow(&words.iter().map(String::as_str).collect::<Vec<_>>());
        (output.status.success(), stderr(&output))
    };
    let rendered = |out: &str, more: &[&str]| {
        let (good, said) = run(out, more);
        assert!(good, "{more:?}: {said}");
        said
    };
    let refused = |out: &str, more: &[&str]| {
        let (good, said) = run(out, more);
        assert!(!good, "{more:?} is accepted");
        said
    };
    let read = |path: &str| exr::read(Path::new(&folder.path(path))).unwrap();
    let said = rendered("blurred", &["--spp", "64", "--shutter", "1"]);
    assert!(!said.contains("moments"), "{said}");
    rendered("sharp", &["--spp", "64"]);
    for frame in ["frame.0000.exr", "frame.0002.exr"] {
        let [blurred, sharp] = ["blurred", "sharp"].map(|out| read(&format!("{out}/{frame}")));
        assert_eq!((blurred.info.shutter.as_str(), sharp.info.shutter.as_str()), ("open 1 moments 32", ""));
        assert_eq!((&blurred.depth, &blurred.motion), (&sharp.depth, &sharp.motion));
        assert!(blurred.alpha != sharp.alpha && blurred.raw != sharp.raw, "{frame}");
    }
    // The same command goes on; another shutter, or none, is another render.
    rendered("blurred", &["--spp", "64", "--shutter", "1"]);
    for (more, was) in [(&["--shutter", ".5"][..], "now open 0.5 moments 32"), (&[], "now open for one moment")] {
        let says = refused("blurred", &[&["--spp", "64"], more].concat());
        assert!(says.contains("the shutter was open 1 moments 32") && says.contains(was), "{says}");
    }
    let said = rendered("few", &["--spp", "1", "--shutter", "1"]);
    assert!(said.contains("with so few samples the shutter shows 1 moment of the movement"), "{said}");
    for (more, reason) in [
        (&["--shutter", "0"][..], "must be above 0, and 1 at most"),
        (&["--shutter", "1.5"], "must be above 0, and 1 at most"),
        (&["--shutter", "nan"], "must be above 0, and 1 at most"),
        (&["--shutter", "1", "--adaptive"], "cannot be used with"),
    ] {
        let says = refused("refused", more);
        assert!(says.contains(reason), "{more:?}: {says}");
    }
    let (_, said) = folder.render(&model, "one", &["--resolution", "8", "--shutter", "1"]);
    assert!(said.contains("the scene has one frame, so nothing moves"), "{said}");
}
