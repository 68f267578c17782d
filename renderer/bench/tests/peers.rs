//! `renderflow-bench kernels` and `renderflow-bench peers`, with scripts that stand in for other renderers.

mod common;

use common::{bench, stderr, succeed};
use glam::Vec3A;
use renderflow_bench::export::{self, Exported};
use renderflow_bench::scenes;
use renderflow_frame::exr;
use renderflow_scenes::loaded::{AlphaMask, Encoding, Wrap};
use renderflow_scenes::mipmap::Texels;
use renderflow_scenes::{Material, Texture, TextureSlot};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::process::Command;

/// A small scene as a file.
fn scene_file(folder: &Path) -> String {
    let scene = json!({
        "version": 1, "name": "small", "resolution": [16, 16],
        "camera": {"type": "poses", "poses": [{"eye": [0.0, 1.6, 4.5], "target": [0.0, 0.0, 0.0]}], "vertical_fov": 40.0},
        "environment": {"source": {"constant": [0.5, 0.6, 0.7]}},
        "materials": [{"name": "m", "base_color": [0.6, 0.4, 0.2], "metallic": 0.2}],
        "objects": [
            {"name": "ball", "geometry": {"shape": {"family": "sphere", "radius": 1.0}}, "material": "m"},
            {"name": "ground", "geometry": {"shape": {"family": "plane", "size": 40.0}}, "material": "m",
             "transform": {"translation": [0.0, -1.0, 0.0]}}
        ]
    });
    let path = folder.join("small.json");
    std::fs::write(&path, scene.to_string()).unwrap();
    path.to_string_lossy().into_owned()
}

/// Vertex rows and triangles of an exported mesh.
fn read_ply(path: &Path) -> (Vec<Vec<f32>>, Vec<[u32; 3]>) {
    let bytes = std::fs::read(path).unwrap();
    let end = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
    let header = std::str::from_utf8(&bytes[..end]).unwrap();
    let count = |what: &str| -> usize {
        header.lines().find_map(|l| l.strip_prefix(&format!("element {what} "))).unwrap().parse().unwrap()
    };
    let width = header.matches("property float").count();
    let word = |b: &[u8]| <[u8; 4]>::try_from(b).unwrap();
    let floats: Vec<f32> = bytes[end..end + 4 * width * count("vertex")].chunks(4).map(|b| f32::from_le_bytes(word(b))).collect();
    let faces = bytes[end + 4 * floats.len()..].chunks(13);
    let triangles: Vec<[u32; 3]> = faces
        .map(|f| {
            assert_eq!(f[0], 3);
            [1, 5, 9].map(|at| u32::from_le_bytes(word(&f[at..at + 4])))
        })
        .collect();
    assert_eq!(triangles.len(), count("face"));
    (floats.chunks(width).map(<[f32]>::to_vec).collect(), triangles)
}

#[test]
fn an_exported_scene_reads_back() {
    let folder = tempfile::tempdir().unwrap();
    let loaded = scenes::open("textured", Some(32), &[]).unwrap().loaded;
    let path = export::write(&loaded, 6, folder.path()).unwrap();
    let exported: Exported = renderflow_frame::file::read_json(&path).unwrap();
    assert_eq!((exported.camera.width, exported.camera.height, exported.max_bounces), (32, 32, 6));
    let camera = &loaded.cameras[0];
    // The direction through the image's centre and the field of view.
    let ahead = (Vec3A::from(exported.camera.target) - Vec3A::from(exported.camera.eye)).normalize();
    assert!(ahead.distance(camera.ray_direction(glam::Vec2::splat(16.0))) < 1e-5);
    let half = (0.5 * exported.camera.vertical_fov.to_radians()).tan();
    assert!((half - 16.0 / camera.fl_y).abs() < 1e-6);
    let up = Vec3A::from(exported.camera.up);
    assert!((camera.ray_direction(glam::Vec2::new(16.0, 0.0)).normalize().dot(up) - half / half.hypot(1.0)).abs() < 1e-5);

    assert_eq!(exported.objects.len(), loaded.instances.len());
    for (object, instance) in exported.objects.iter().zip(&loaded.instances) {
        let (mesh, transform) = (&loaded.meshes[instance.mesh], instance.transform(0));
        let (vertices, triangles) = read_ply(&folder.path().join(&object.mesh));
        assert_eq!((&object.name, object.triangles, &triangles), (&instance.name, mesh.triangles.len(), &mesh.triangles));
        for (vertex, p) in vertices.iter().zip(&mesh.positions) {
            assert_eq!(vertex[..3], transform.transform_point3a((*p).into()).to_array());
        }
        if object.smooth {
            // Shading normals stand on the triangles' side.
            let corner = |v: u32, at: usize| Vec3A::from_slice(&vertices[v as usize][at..]);
            let agree = triangles.iter().filter(|[a, b, c]| {
                let n = (corner(*b, 0) - corner(*a, 0)).cross(corner(*c, 0) - corner(*a, 0));
                n.dot(corner(*a, 3)) > 0.0
            });
            assert!(agree.count() * 100 >= 99 * triangles.len(), "{}", object.name);
        }
    }
    let sky = exr::read_rgb(&folder.path().join(&exported.environment)).unwrap();
    let map = &loaded.environment.map;
    assert!((sky.width, sky.height) == (map.width, map.height));
    assert!(sky.pixels.iter().zip(&map.pixels).all(|(a, b)| *a == b.map(|v| v * loaded.environment.intensity)));

    let ground = exported.objects.iter().position(|o| o.name == "ground").unwrap();
    let material = &loaded.materials[loaded.instances[ground].material];
    let named = &exported.objects[ground].material.textures;
    assert_eq!(named.keys().map(String::as_str).collect::<Vec<_>>(), ["base_color", "metallic", "normal", "roughness"]);
    let texels = |slot: &renderflow_scenes::TextureSlot| match &loaded.textures[slot.texture].levels[0].texels {
        Texels::Bytes(texels) => texels.clone(),
        Texels::Words(_) => panic!("eight bits were made"),
    };
    let color = image::open(folder.path().join(&named["base_color"].file)).unwrap().into_rgb8();
    let wanted = texels(material.base_color_texture.as_ref().unwrap());
    assert!(color.pixels().zip(&wanted).all(|(a, b)| a.0 == [b[0], b[1], b[2]]));
    let roughness = image::open(folder.path().join(&named["roughness"].file)).unwrap().into_luma8();
    let wanted = texels(material.metallic_roughness_texture.as_ref().unwrap());
    assert!(roughness.pixels().zip(&wanted).all(|(a, b)| a.0 == [b[1]]));

    // What the format has no place for is an error that names it.
    let mut turned = loaded.clone();
    let of_ground = turned.instances[ground].material;
    let slot = turned.materials[of_ground].base_color_texture.as_mut().unwrap();
    slot.uv_transform = glam::Affine2::from_scale(glam::Vec2::splat(2.0));
    let error = format!("{:#}", export::write(&turned, 6, folder.path()).unwrap_err());
    assert!(error.contains(&turned.materials[of_ground].name) && error.contains("different transforms"), "{error}");
}

/// A leaf on a ground: single-sided, with holes, a scaled normal map, a lamp's texture, and an image that is mirrored.
#[test]
fn what_models_have_is_exported() {
    let folder = tempfile::tempdir().unwrap();
    let mut loaded = scenes::open("textured", Some(32), &[]).unwrap().loaded;
    let ground = loaded.instances.iter().position(|i| i.name == "ground").unwrap();
    let of_ground = loaded.instances[ground].material;
    let texture = |texels: Vec<[u8; 4]>, encoding| Texture::from_rgba8("two texels", [2, 1], texels, encoding, [Wrap::Mirror; 2]);
    let first = loaded.textures.len();
    loaded.textures.push(texture(vec![[255, 255, 255, 255], [255, 255, 255, 0]], Encoding::Srgb));
    loaded.textures.push(texture(vec![[255, 128, 255, 255], [128, 128, 255, 255]], Encoding::Normal));
    let slot = |texture| Some(TextureSlot { texture, ..TextureSlot::default() });
    loaded.materials[of_ground] = Material {
        name: "leaf".into(),
        base_color_texture: slot(first),
        normal_texture: slot(first + 1).map(|slot| (slot, 0.5)),
        emissive: [3.0, 2.0, 1.0],
        emissive_texture: slot(first),
        alpha_mask: Some(AlphaMask { cutoff: 0.25, factor: 1.0 }),
        double_sided: false,
        ..Material::default()
    };
    let path = export::write(&loaded, 6, folder.path()).unwrap();
    let exported: Exported = renderflow_frame::file::read_json(&path).unwrap();
    let object = &exported.objects[ground];
    assert!(!object.double_sided && exported.objects.iter().any(|other| other.double_sided));
    let named = &object.material.textures;
    assert_eq!(named.keys().map(String::as_str).collect::<Vec<_>>(), ["base_color", "emissive", "normal", "opacity"]);
    assert!(named.values().all(|texture| texture.wrap == "mirror"), "{named:?}");
    // The alpha falls from 1 to 0 between the texels' centres, at a quarter and three quarters of the image: it is below a
    // quarter from 5/8 of the image on. Enlarged four times, that is after five of eight columns.
    let opacity = image::open(folder.path().join(&named["opacity"].file)).unwrap().into_luma8();
    assert_eq!(opacity.dimensions(), (8, 4));
    assert_eq!(opacity.as_raw()[..8], [255, 255, 255, 255, 255, 0, 0, 0]);
    // Half of the lean: (1, 0, 1) becomes (1/2, 0, 1), of unit length.
    let normal = image::open(folder.path().join(&named["normal"].file)).unwrap().into_rgb16();
    let [x, y, z] = normal.get_pixel(0, 0).0.map(|v| 2.0 * f64::from(v) / 65535.0 - 1.0);
    assert!((x - 0.2f64.sqrt()).abs() < 0.01 && y.abs() < 0.01 && (z - 0.8f64.sqrt()).abs() < 0.01, "{x} {y} {z}");
    let light = exr::read_rgb(&folder.path().join(&named["emissive"].file)).unwrap();
    assert_eq!((light.at(0, 0), object.material.emissive), (&[3.0, 2.0, 1.0], [1.0; 3]));

    // Of a mask without a texture nothing or everything is left.
    loaded.materials[of_ground].base_color_texture = None;
    let count = exported.objects.len();
    for (factor, left) in [(0.2, count - 1), (0.3, count)] {
        loaded.materials[of_ground].alpha_mask = Some(AlphaMask { cutoff: 0.25, factor });
        let path = export::write(&loaded, 6, folder.path()).unwrap();
        let exported: Exported = renderflow_frame::file::read_json(&path).unwrap();
        assert_eq!(exported.objects.len(), left, "{factor}");
        assert!(exported.objects.iter().all(|o| !o.material.textures.contains_key("opacity")));
    }
}

/// A program that is started in place of Python and answers as a renderer would; `None`, with the reason, where there is no
/// Python. It writes down every command. Pictures are 0.5 for seeds of references and 0.6 for others; `misbehave` is run before
/// each.
fn stand_in(folder: &Path, misbehave: &str) -> Option<(String, PathBuf)> {
    if !Command::new("python3").arg("--version").output().is_ok_and(|o| o.status.success()) {
        eprintln!("skipped: no python3");
        return None;
    }
    let log = folder.join("commands.txt");
    let script = folder.join("stand_in.py");
    let text = format!(
        r#"
import array, json, os, sys, time
log = open({log:?}, "a")
print(json.dumps({{"ready": {{"name": "stand-in", "version": "1.2.3"}}}}), flush=True)
for line in sys.stdin:
    command = json.loads(line)
    log.write(line)
    log.flush()
    if "load" in command:
        scene = json.load(open(command["load"]))
        assert all(os.path.exists(os.path.join(os.path.dirname(command["load"]), o["mesh"])) for o in scene["objects"])
        size = scene["camera"]["width"] * scene["camera"]["height"] * 3
        print(json.dumps({{"loaded": True, "notes": ["stands in"]}}), flush=True)
    elif "warm" in command:
        print(json.dumps({{"warm": True}}), flush=True)
    else:
        order = command["render"]
        {misbehave}
        value = 0.5 if order["seed"] >= 1000000 else 0.6
        array.array("f", [value] * size).tofile(open(order["file"], "wb"))
        print(json.dumps({{"wall": 0.25 * order["spp"], "cpu": 1.0 * order["spp"]}}), flush=True)
"#
    );
    std::fs::write(&script, text).unwrap();
    let program = folder.join("python");
    std::fs::write(&program, format!("#!/bin/sh\nexec python3 {}\n", script.display())).unwrap();
    #[cfg(unix)]
    std::fs::set_permissions(&program, std::os::unix::fs::PermissionsExt::from_mode(0o755)).unwrap();
    Some((program.to_string_lossy().into_owned(), log))
}

/// Arguments of a small run.
fn peers<'a>(scene: &'a str, out: &'a str, python: &'a str) -> Vec<&'a str> {
    let fixed =
        "peers --threads 2 --resolution 16 --spp 1,2 --repeats 2 --reference-spp 8 --only mitsuba-scalar --only renderflow";
    fixed.split(' ').chain(["--scene", scene, "--out", out, "--mitsuba-python", python]).collect()
}

/// Others are told of the materials that their own forms cannot express, and references of both kinds are kept apart.
#[cfg(unix)]
#[test]
fn all_renderers_can_be_given_lambertian_materials() {
    let folder = tempfile::tempdir().unwrap();
    let Some((python, _)) = stand_in(folder.path(), "pass") else { return };
    let (scene, out) = (scene_file(folder.path()), folder.path().join("out"));
    let out = out.to_str().unwrap();
    let mut references = 0;
    for lambertian in [false, true] {
        let mut arguments = peers(&scene, out, &python);
        arguments.extend(lambertian.then_some("--lambertian"));
        let text = succeed(&arguments);
        assert_eq!(text.contains("ours: Lambertian"), lambertian, "{text}");
        let exported = std::fs::read_dir(format!("{out}/scenes")).unwrap().next().unwrap().unwrap().path().join("scene.json");
        let exported: Exported = serde_json::from_slice(&std::fs::read(exported).unwrap()).unwrap();
        assert!(exported.objects.iter().all(|o| o.material.lambertian == lambertian), "{exported:?}");
        let now = std::fs::read_dir(format!("{out}/references")).unwrap().count();
        assert!(now == references + 2, "{now} references");
        references = now;
    }
}

#[cfg(unix)]
#[test]
fn a_peer_renders_on_command_and_finished_rows_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let Some((python, log)) = stand_in(folder.path(), "pass") else { return };
    let (scene, out) = (scene_file(folder.path()), folder.path().join("out"));
    let out = out.to_str().unwrap();
    let text = succeed(&peers(&scene, out, &python));
    assert!(text.contains("stands in") && text.contains("Mitsuba scalar") && text.contains("1.2.3"), "{text}");

    let commands: Vec<Value> =
        std::fs::read_to_string(&log).unwrap().lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert!(commands[0]["load"].as_str().unwrap().ends_with("scene.json"));
    let renders: Vec<(u64, u64)> =
        commands.iter().filter_map(|c| Some((c["render"]["spp"].as_u64()?, c["render"]["seed"].as_u64()?))).collect();
    // Eight parts of the reference, then every number of samples in every repeat, with seeds of their own.
    assert!(renders[..8].iter().enumerate().all(|(i, r)| *r == (1, 1_000_000 + i as u64)), "{renders:?}");
    assert_eq!(renders[8..], [(1, 1), (2, 1), (1, 2), (2, 2)]);
    assert_eq!(commands[9], json!({"warm": {"spps": [1, 2]}}));

    let results: Value = serde_json::from_slice(&std::fs::read(format!("{out}/peers.json")).unwrap()).unwrap();
    let rows = results["rows"].as_array().unwrap();
    assert_eq!(rows.len(), 8);
    for row in rows.iter().filter(|r| r["renderer"] == "mitsuba-scalar") {
        // (0.6 - 0.5)^2 / (0.5^2 + 0.01), against a reference without noise.
        assert!((row["error"]["mean"].as_f64().unwrap() - 0.01 / 0.26).abs() < 1e-6, "{row}");
        assert_eq!(row["wall"].as_f64().unwrap(), 0.25 * row["spp"].as_f64().unwrap());
    }
    let curve = |id: &str| results["curves"].as_array().unwrap().iter().find(|c| c["renderer"] == id).unwrap().clone();
    // The error stays what it is: beyond the last point, in proportion.
    let time = &curve("mitsuba-scalar")["wall_to_target"];
    assert!(
        time["extrapolated"] == true && (time["seconds"].as_f64().unwrap() - 0.5 * 0.01 / 0.26 / 0.01).abs() < 1e-5,
        "{time}"
    );
    assert!(curve("mitsuba-scalar")["ours_over_this"]["renderflow"][0].as_f64().unwrap() > 0.0);
    assert!(curve("renderflow")["ours_over_this"] == json!({}));
    assert!(results["differences"][0]["ratio"].as_f64().unwrap() > 0.0);

    succeed(&peers(&scene, out, &python));
    let again = std::fs::read_to_string(&log).unwrap();
    assert_eq!(again.matches("render").count(), renders.len(), "finished pictures and references are not rendered again");
}

#[cfg(unix)]
#[test]
fn a_peer_that_fails_or_ends_is_left_out() {
    for (misbehave, expected) in [
        (r#"if order["seed"] == 2: print(json.dumps({"error": "no memory"}), flush=True); continue"#, "no memory"),
        (r#"if order["seed"] == 2: sys.exit(1)"#, "it has ended"),
        (r#"if order["seed"] == 2: size -= 3"#, "16 x 16 pixels"),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let Some((python, _)) = stand_in(folder.path(), misbehave) else { return };
        let (scene, out) = (scene_file(folder.path()), folder.path().join("out"));
        let text = succeed(&peers(&scene, out.to_str().unwrap(), &python));
        assert!(text.contains("left out mitsuba-scalar") && text.contains(expected), "{text}");
        let results: Value = serde_json::from_slice(&std::fs::read(out.join("peers.json")).unwrap()).unwrap();
        let count = |id: &str| results["rows"].as_array().unwrap().iter().filter(|r| r["renderer"] == id).count();
        assert_eq!((count("renderflow"), count("mitsuba-scalar")), (4, 2));
    }
}

#[test]
fn a_peer_that_is_not_there_is_skipped_with_a_message() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, out) = (scene_file(folder.path()), folder.path().join("out"));
    let text = succeed(&peers(&scene, out.to_str().unwrap(), "/nowhere/python"));
    assert!(text.contains("skipped mitsuba-scalar: /nowhere/python cannot be started"), "{text}");
    assert!(text.contains("renderflow, uniform"), "{text}");
}

#[cfg(unix)]
#[test]
fn an_interrupted_run_ends_at_once_and_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let slow =
        r#"if order["seed"] == 2 and not os.path.exists(__file__ + ".once"): open(__file__ + ".once", "w"); time.sleep(60)"#;
    let Some((python, log)) = stand_in(folder.path(), slow) else { return };
    let (scene, out) = (scene_file(folder.path()), folder.path().join("out"));
    let arguments = peers(&scene, out.to_str().unwrap(), &python);
    let mut run = Command::new(env!("CARGO_BIN_EXE_renderflow-bench")).args(&arguments).spawn().unwrap();
    while !std::fs::read_to_string(&log).is_ok_and(|text| text.contains(r#""seed":2"#)) {
        std::thread::sleep(std::time::Duration::from_millis(20));
        assert!(run.try_wait().unwrap().is_none(), "it ended by itself");
    }
    assert!(Command::new("kill").args(["-INT", &run.id().to_string()]).status().unwrap().success());
    assert_eq!(run.wait().unwrap().code(), Some(75));
    succeed(&arguments);
    let text = std::fs::read_to_string(&log).unwrap();
    let pictures = text.lines().filter(|l| l.contains("render")).count();
    assert_eq!(pictures, 8 + 4 + 1, "only the picture that was interrupted is rendered twice: {text}");
}

#[test]
fn kernels_run_without_embree() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, out) = (scene_file(folder.path()), folder.path().join("kernels.json"));
    let fixed = "kernels --no-embree --resolution 24 --repeats 2";
    let text = succeed(&fixed.split(' ').chain(["--scene", &scene, "--out", out.to_str().unwrap()]).collect::<Vec<_>>());
    assert!(text.contains("small:"), "{text}");
    let results: Value = serde_json::from_slice(&std::fs::read(out).unwrap()).unwrap();
    assert!(results["embree"].is_null());
    let rows: Vec<Value> = results["scenes"][0]["rows"].as_array().unwrap().clone();
    let single: Vec<&Value> = rows.iter().filter(|r| r["tracer"] == "renderflow").collect();
    let kinds: Vec<&str> = single.iter().map(|r| r["rays"].as_str().unwrap()).collect();
    assert_eq!(kinds, ["primary", "diffuse", "shuffled", "shadow"]);
    assert_eq!(single[0]["count"], 576);
    // Order does not change what is hit.
    assert_eq!(single[1]["hits"], single[2]["hits"]);
    for row in &rows {
        assert!(row["hits"].as_u64().unwrap() > 0 && row["disagree"] == 0 && row["seconds_cpu"].as_array().unwrap().len() == 2);
        assert!(row["mrays_cpu"].as_f64().unwrap() > 0.0 && row["ratio"].is_null());
    }
}

#[test]
fn embree_agrees_where_it_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, out) = (scene_file(folder.path()), folder.path().join("kernels.json"));
    let fixed = "kernels --resolution 128 --repeats 1";
    let text = succeed(&fixed.split(' ').chain(["--scene", &scene, "--out", out.to_str().unwrap()]).collect::<Vec<_>>());
    if text.contains("skipped Embree") {
        eprintln!("skipped: {text}");
        return;
    }
    let results: Value = serde_json::from_slice(&std::fs::read(out).unwrap()).unwrap();
    let rows = results["scenes"][0]["rows"].as_array().unwrap();
    let robust: Vec<&Value> = rows.iter().filter(|r| r["tracer"].as_str().unwrap().ends_with("robust")).collect();
    assert_eq!(robust.len(), 4);
    assert!(robust.iter().all(|r| r["disagree"] == 0), "{robust:?}");
    // Without `robust` a few rays in a million pass between triangles.
    assert!(rows.iter().all(|r| r["disagree"].as_u64().unwrap() <= 3), "{rows:?}");
}

#[test]
fn an_embree_that_was_named_must_be_there() {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene_file(folder.path());
    let output = bench(&["kernels", "--scene", &scene, "--embree", "/nowhere/libembree4.so"]);
    assert!(!output.status.success() && stderr(&output).contains("/nowhere/libembree4.so"), "{}", stderr(&output));
}
