//! What a scene and the models in it may name: files of their own folder, and of those that the user allows; regular ones.

mod common;

use common::gltf::square;
use common::{anywhere, empty_scene, grey, model_scene};
use renderflow_frame::reach::Reach;
use renderflow_scenes::description::{EnvironmentSource, Geometry, Object, Scene};
use renderflow_scenes::load::{self, ModelView};
use renderflow_scenes::shapes::Shape;
use serde_json::json;
use std::path::{Path, PathBuf};

const TRIANGLE: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\n";

/// A folder `mine` with files of its own, and a folder `theirs` beside it.
struct Folders(tempfile::TempDir);

impl Folders {
    fn new() -> Self {
        let folders = Self(tempfile::tempdir().unwrap());
        for folder in ["mine", "theirs"] {
            std::fs::create_dir(folders.0.path().join(folder)).unwrap();
            folders.write(&format!("{folder}/model.obj"), TRIANGLE);
            folders.write(&format!("{folder}/paint.mtl"), "newmtl red\nKd 1 0 0\n");
            let (picture, map) = (folders.path(&format!("{folder}/wood.png")), folders.path(&format!("{folder}/sky.hdr")));
            image::RgbImage::new(2, 2).save(picture).unwrap();
            let sky = renderflow_frame::Image::filled(4, 2, [1.0; 3]);
            std::fs::write(map, renderflow_frame::hdr::encode(&sky)).unwrap();
        }
        folders
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn write(&self, name: &str, text: &str) -> PathBuf {
        std::fs::write(self.path(name), text).unwrap();
        self.path(name)
    }

    /// The folder `mine`, and `theirs` where it is allowed.
    fn reach(&self, allowed: bool) -> Reach {
        Reach::folder(self.path("mine")).allow(allowed.then(|| self.path("theirs")))
    }

    /// Loads with and without the permission: it is needed, and the refusal says which.
    fn needs_permission(&self, what: &str, load: impl Fn(&Reach) -> renderflow_scenes::Result<()>) {
        let refusal = load(&self.reach(false)).expect_err(what).to_string();
        let option = format!("--allow-files {}", self.path("theirs").display());
        assert!(refusal.contains("leads out of the folder") && refusal.ends_with(&option), "{what}: {refusal}");
        load(&self.reach(true)).unwrap_or_else(|e| panic!("{what}: {e}"));
    }
}

/// A ball with this texture, under this map.
fn ball(texture: Option<&str>, map: Option<&str>) -> Scene {
    let mut scene = empty_scene();
    let mut material = grey("m");
    material.base_color_texture = texture.map(Into::into);
    scene.materials.push(material);
    let geometry = Geometry::Shape(Shape::Sphere { radius: 1.0 });
    let object = Object {
        name: "o".into(),
        geometry,
        material: Some("m".into()),
        transform: Default::default(),
        motion: None,
        animation: None,
    };
    scene.objects.push(object);
    if let Some(map) = map {
        scene.environment.source = EnvironmentSource::File(map.into());
    }
    scene
}

#[test]
fn scenes_name_files_of_their_own_folder() {
    let folders = Folders::new();
    let theirs = |name: &str| [format!("../theirs/{name}"), folders.path("theirs").join(name).to_str().unwrap().to_owned()];
    let model = |name: &str| model_scene(Path::new(name), None);
    for (name, make) in [
        ("model.obj", &model as &dyn Fn(&str) -> Scene),
        ("wood.png", &|name| ball(Some(name), None)),
        ("sky.hdr", &|name| ball(None, Some(name))),
    ] {
        load::load(&make(name), &folders.reach(false)).unwrap_or_else(|e| panic!("{name}: {e}"));
        for name in theirs(name) {
            folders.needs_permission(&name, |reach| load::load(&make(&name), reach).map(drop));
        }
    }
}

/// Loads `mine/model.gltf` or `mine/model.obj` as a scene in `mine` names it.
fn model(name: &str, reach: &Reach) -> renderflow_scenes::Result<()> {
    load::load(&model_scene(Path::new(name), None), reach).map(drop)
}

#[test]
fn models_name_files_of_their_own_folder() {
    let folders = Folders::new();
    for library in ["mtllib ../theirs/paint.mtl".to_owned(), format!("mtllib {}", folders.path("theirs/paint.mtl").display())] {
        folders.write("mine/model.obj", &format!("{library}\nusemtl red\n{TRIANGLE}"));
        folders.needs_permission(&library, |reach| model("model.obj", reach));
        // The message says which file holds the name.
        let said = model("model.obj", &folders.reach(false)).expect_err(&library).to_string();
        assert!(said.contains("model.obj: mtllib"), "{said}");
    }
    folders.write("mine/model.obj", &format!("mtllib paint.mtl\nusemtl red\n{TRIANGLE}"));
    for line in
        ["map_Kd ../theirs/wood.png", "map_Kd ..\\theirs\\wood.png", "map_Pr ../theirs/wood.png", "map_d ../theirs/wood.png"]
    {
        folders.write("mine/paint.mtl", &format!("newmtl red\n{line}\n"));
        folders.needs_permission(line, |reach| model("model.obj", reach));
    }
    // A library that only the exporter had is a note, as always.
    folders.write("mine/model.obj", &format!("mtllib /home/nobody/here/paint.mtl\n{TRIANGLE}"));
    let loaded = load::load(&model_scene(Path::new("model.obj"), None), &folders.reach(false)).unwrap();
    assert!(loaded.report.notes.iter().any(|note| note.contains("paint.mtl is not there")), "{:?}", loaded.report.notes);
}

/// Percent-encoding is undone before a name is judged.
#[test]
fn uris_name_files_of_their_own_folder() {
    let folders = Folders::new();
    let bytes: Vec<u8> = common::gltf::bytes(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
    std::fs::write(folders.path("theirs/model.bin"), &bytes).unwrap();
    let with_buffer = |uri: &str| {
        let file = json!({
            "asset": { "version": "2.0" },
            "nodes": [{ "mesh": 0 }],
            "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 } }] }],
            "accessors": [{ "componentType": 5126, "count": 3, "type": "VEC3", "bufferView": 0 }],
            "bufferViews": [{ "buffer": 0, "byteLength": 36 }],
            "buffers": [{ "byteLength": 36, "uri": uri }]
        });
        folders.write("mine/model.gltf", &file.to_string())
    };
    for uri in ["../theirs/model.bin", "..%2Ftheirs%2fmodel.bin", "%2e%2e/theirs/model.bin", "a/../../theirs/model.bin"] {
        let path = with_buffer(uri);
        folders.needs_permission(uri, |reach| model("model.gltf", reach));
        let described = |reach: &Reach| load::describe_model(&path, None, &ModelView::default(), reach).map(drop);
        folders.needs_permission(uri, described);
    }
    // No URI is absolute, however it is written and whatever is allowed.
    let absolute = folders.path("theirs/model.bin").to_str().unwrap().to_owned();
    for uri in [absolute.clone(), absolute.replace('/', "%2F"), format!("file://{absolute}")] {
        with_buffer(&uri);
        let refusal = model("model.gltf", &folders.reach(true)).unwrap_err().to_string();
        assert!(refusal.contains("/buffers/0: ") && refusal.contains("is not a path relative to the file"), "{refusal}");
    }
    for uri in ["../theirs/wood.png", "%2E%2E%2Ftheirs/wood.png"] {
        let mut file = square();
        file["materials"] = json!([{ "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } }]);
        file["textures"] = json!([{ "source": 0 }]);
        file["images"] = json!([{ "uri": uri }]);
        file["meshes"][0]["primitives"][0]["material"] = json!(0);
        file["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = json!(1);
        folders.write("mine/model.gltf", &file.to_string());
        folders.needs_permission(uri, |reach| model("model.gltf", reach));
    }
}

/// Pipes and sockets would be read for ever, or wait for a writer.
#[cfg(unix)]
#[test]
fn pipes_and_sockets_are_refused_at_once() {
    let folders = Folders::new();
    type Make<'a> = &'a dyn Fn(&Path);
    let kinds: [(&str, Make<'_>); 2] = [
        ("pipe", &|path| {
            let (kind, mode) = (rustix::fs::FileType::Fifo, rustix::fs::Mode::RUSR);
            rustix::fs::mknodat(rustix::fs::CWD, path, kind, mode, 0).unwrap();
        }),
        ("socket", &|path| drop(std::os::unix::net::UnixListener::bind(path).unwrap())),
    ];
    for (kind, make) in kinds {
        let path = |ending: &str| format!("{kind}.{ending}");
        for ending in ["obj", "gltf", "json", "mtl", "png", "hdr", "bin"] {
            make(&folders.path("mine").join(path(ending)));
        }
        let refused = |what: String, result: renderflow_scenes::Result<()>| {
            let error = result.expect_err(&what).to_string();
            assert!(error.contains("not a regular file") || error.contains("cannot read"), "{what}: {error}");
        };
        let reach = folders.reach(false);
        for ending in ["obj", "gltf"] {
            refused(path(ending), model(&path(ending), &reach));
            let file = folders.path("mine").join(path(ending));
            refused(path(ending), load::describe_model(&file, None, &ModelView::default(), &anywhere()).map(drop));
        }
        refused(path("json"), Scene::read(&folders.path("mine").join(path("json"))).map(drop));
        refused(path("png"), load::load(&ball(Some(&path("png")), None), &reach).map(drop));
        refused(path("hdr"), load::load(&ball(None, Some(&path("hdr"))), &reach).map(drop));
        let mut file = square();
        file["buffers"][0]["uri"] = json!(path("bin"));
        folders.write("mine/model.gltf", &file.to_string());
        refused(path("bin"), model("model.gltf", &reach));
        // A library that cannot be read is noted, and its materials are the default ones.
        folders.write("mine/model.obj", &format!("mtllib {}\n{TRIANGLE}", path("mtl")));
        let loaded = load::load(&model_scene(Path::new("model.obj"), None), &reach).unwrap();
        assert!(loaded.report.notes.iter().any(|note| note.contains(&path("mtl"))), "{:?}", loaded.report.notes);
        folders.write("mine/model.obj", &format!("mtllib paint.mtl\nusemtl red\n{TRIANGLE}"));
        folders.write("mine/paint.mtl", &format!("newmtl red\nmap_Kd {}\n", path("png")));
        refused(path("png of a library"), model("model.obj", &reach));
    }
}
