//! How glTF files store things otherwise: Draco against formulae, WebP, colours of vertices, and instances of a node.

mod common;

use common::gltf::{FLOAT, File, STRIP, bytes, data_uri, document, png, square};
use common::{anywhere, asset, load_model, model_scene};
use glam::{Affine3A, Vec3, Vec3A, Vec4};
use renderflow_scenes::description::Animation;
use renderflow_scenes::mipmap::Texels;
use renderflow_scenes::{LoadedScene, load};
use serde_json::{Value, json};
use std::f32::consts::TAU;

const UNSIGNED_BYTE: u32 = 5121;
const UNSIGNED_SHORT: u32 = 5123;

/// The tori of `references/draco.gltf`, which Google's encoder compressed.
fn tori() -> Value {
    serde_json::from_str(include_str!("references/draco.gltf")).unwrap()
}

#[test]
fn draco_gives_what_google_compressed() {
    let scene = File::new(&tori()).load().unwrap();
    assert_eq!(scene.meshes.len(), 2);
    for (mesh, at) in scene.meshes.iter().zip([0.0, 4.0]) {
        assert_eq!((mesh.positions.len(), mesh.triangles.len()), (288, 576), "{}", mesh.name);
        let placed = scene.instances.iter().find(|i| scene.meshes[i.mesh].name == mesh.name).unwrap().transforms[0];
        assert_eq!(placed.translation + Vec3A::from(scene.origin.as_vec3()), Vec3A::new(at, 0.0, 0.0));
        for vertex in 0..mesh.positions.len() {
            let [u, v] = mesh.uvs[vertex].to_array();
            let (a, b) = (TAU * u, TAU * v);
            let n = Vec3::new(b.cos() * a.cos(), b.sin(), -b.cos() * a.sin());
            let p = Vec3::new(a.cos(), 0.0, -a.sin()) + 0.4 * n;
            // 12 bits of texture coordinates: 2 pi / 2^13 of a radian, times 1.4 metres.
            assert!(mesh.positions[vertex].distance(p) < 2e-3, "{p} {}", mesh.positions[vertex]);
            assert!(mesh.normals[vertex].distance(n) < 8e-3, "{n} {}", mesh.normals[vertex]);
            let color = Vec4::new(u, v, 128.0 / 255.0, 1.0);
            assert!(mesh.colors[vertex].distance(color) < 3e-3, "{color} {}", mesh.colors[vertex]);
        }
        for triangle in &mesh.triangles {
            let [a, b, c] = triangle.map(|v| mesh.positions[v as usize]);
            assert!((b - a).cross(c - a).dot(mesh.normals[triangle[0] as usize]) > 0.0);
        }
    }
}

/// A sphere that glTF-Transform compressed, with positions of 16 bits, in a container.
#[test]
fn draco_of_gltf_transform_is_read() {
    let Some(path) = asset("gltf/edge/gltf-transform/DenseSphere.glb") else { return };
    let scene = load_model(&path).unwrap();
    let mesh = &scene.meshes[0];
    assert_eq!((mesh.triangles.len(), mesh.positions.len()), (30720, 15362));
    // What Google's decoder finds: radii from 32470.35 to 32798.86 of 32767.
    let radii = || mesh.positions.iter().map(|p| p.length() * 32767.0);
    let (low, high) = (radii().fold(f32::INFINITY, f32::min), radii().fold(0.0, f32::max));
    assert!((low - 32470.35).abs() < 0.1 && (high - 32798.86).abs() < 0.1, "{low} {high}");
}

#[test]
fn damaged_draco_is_refused_with_its_place() {
    let extension = "/meshes/0/primitives/0/extensions/KHR_draco_mesh_compression";
    let with = |change: &dyn Fn(&mut Value)| {
        let mut file = tori();
        change(&mut file["meshes"][0]["primitives"][0]["extensions"]["KHR_draco_mesh_compression"]);
        File::new(&file).error()
    };
    let error = with(&|extension| extension["bufferView"] = json!(9));
    assert!(error.ends_with(&format!("{extension}/bufferView: the buffer view does not exist")), "{error}");
    let error = with(&|extension| extension["attributes"]["NORMAL"] = json!(77));
    assert!(error.ends_with(&format!("{extension}/attributes/NORMAL: the compressed mesh has no attribute 77")), "{error}");
    let mut short = tori();
    short["bufferViews"][0]["byteLength"] = json!(200);
    let error = File::new(&short).error();
    assert!(error.contains(&format!("{extension}: cannot be decompressed: ")), "{error}");
}

/// WebP by its extension, with and without a picture for readers that do not know it.
#[test]
fn webp_is_read() {
    let picture = image::RgbaImage::from_raw(2, 1, vec![188, 51, 0, 255, 1, 2, 3, 128]).unwrap();
    let mut webp = std::io::Cursor::new(vec![]);
    picture.write_to(&mut webp, image::ImageFormat::WebP).unwrap();
    let webp = json!({ "uri": data_uri("image/webp", &webp.into_inner()), "mimeType": "image/webp" });
    let load = |texture: Value| {
        let mut file = square();
        file["images"] = json!([webp, { "uri": png(&[[9, 9, 9, 255]]) }]);
        file["textures"] = json!([texture]);
        file["materials"] = json!([{ "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } }]);
        file["meshes"][0]["primitives"][0]["material"] = json!(0);
        file["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = json!(1);
        file["extensionsRequired"] = json!(["EXT_texture_webp"]);
        file["extensionsUsed"] = json!(["EXT_texture_webp"]);
        let scene = File::new(&file).load().unwrap();
        assert_eq!(scene.report.notes, [""; 0]);
        let Texels::Bytes(texels) = &scene.textures[0].levels[0].texels else { panic!("8 bits a channel") };
        texels.to_vec()
    };
    let only = load(json!({ "extensions": { "EXT_texture_webp": { "source": 0 } } }));
    assert_eq!(only, [[188, 51, 0, 255], [1, 2, 3, 128]]);
    let plain = load(json!({ "source": 1, "extensions": { "EXT_texture_webp": { "source": 0 } } }));
    assert_eq!(plain, [[9, 9, 9, 255]]);
}

#[test]
fn colors_of_vertices_are_read_in_every_form() {
    let load = |component: u32, kind: &str, normalized: bool, data: Vec<u8>| {
        let mut file = document(&[(FLOAT, "VEC3", 4, false, bytes(&STRIP)), (component, kind, 4, normalized, data)]);
        file["meshes"][0]["primitives"][0] = json!({ "mode": 5, "attributes": { "POSITION": 0, "COLOR_0": 1 } });
        File::new(&file)
    };
    let colors = |file: File| file.load().unwrap().meshes[0].colors.clone();
    let row = [[0.0, 0.2, 1.0, 0.4], [1.0, 1.0, 1.0, 1.0], [0.6, 0.0, 0.0, 0.0], [0.2, 0.4, 0.6, 0.8]].map(Vec4::from);
    let near = |a: &[Vec4], b: &[Vec4]| a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a.distance(*b) < 1e-5);
    let floats: Vec<f32> = row.iter().flat_map(Vec4::to_array).collect();
    assert!(near(&colors(load(FLOAT, "VEC4", false, bytes(&floats))), &row));
    let eight = floats.iter().map(|v| (v * 255.0).round() as u8).collect();
    assert!(near(&colors(load(UNSIGNED_BYTE, "VEC4", true, eight)), &row));
    let opaque = row.map(|c| c.truncate().extend(1.0));
    let three: Vec<f32> = row.iter().flat_map(|c| c.truncate().to_array()).collect();
    assert!(near(&colors(load(FLOAT, "VEC3", false, bytes(&three))), &opaque));
    // Of 16 bits, each element begins at a multiple of four bytes.
    let sixteen = floats.iter().flat_map(|v| ((v * 65535.0).round() as u16).to_le_bytes()).collect();
    assert!(near(&colors(load(UNSIGNED_SHORT, "VEC4", true, sixteen)), &row));
    // White is none, and what is no colour becomes one.
    assert!(colors(load(FLOAT, "VEC4", false, bytes(&[1.0; 16]))).is_empty());
    let odd = [f32::NAN, -1.0, 7.0, f32::INFINITY].repeat(4);
    assert_eq!(colors(load(FLOAT, "VEC4", false, bytes(&odd))), [Vec4::new(1.0, 0.0, 1.0, 1.0); 4]);
    let error = load(FLOAT, "VEC2", false, bytes(&[0.5; 8])).error();
    assert!(error.contains("/meshes/0/primitives/0/attributes/COLOR_0: "), "{error}");
}

/// Colours belong to the file's material: with one of the scene they are gone.
#[test]
fn another_material_has_no_colors() {
    let mut file = document(&[(FLOAT, "VEC3", 4, false, bytes(&STRIP)), (FLOAT, "VEC3", 4, false, bytes(&[0.5; 12]))]);
    file["meshes"][0]["primitives"][0] = json!({ "mode": 5, "attributes": { "POSITION": 0, "COLOR_0": 1 } });
    let file = File::new(&file);
    assert_eq!(file.load().unwrap().meshes[0].colors.len(), 4);
    let other = load::load(&model_scene(&file.path(), Some(common::grey("m"))), &anywhere()).unwrap();
    assert!(other.meshes[0].colors.is_empty());
}

/// A square at three places of its own, below a node that is moved.
fn spread() -> Value {
    let turn = std::f32::consts::FRAC_1_SQRT_2;
    let mut file = document(&[
        (FLOAT, "VEC3", 4, false, bytes(&STRIP)),
        (FLOAT, "VEC3", 3, false, bytes(&[0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 3.0, 0.0])),
        (FLOAT, "VEC4", 3, false, bytes(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, turn, turn, 0.0, 0.0, 0.0, 1.0])),
        (FLOAT, "VEC3", 3, false, bytes(&[1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 2.0, 1.0, 0.5])),
    ]);
    file["meshes"][0]["primitives"][0]["mode"] = json!(5);
    let attributes = json!({ "TRANSLATION": 1, "ROTATION": 2, "SCALE": 3 });
    let extensions = json!({ "EXT_mesh_gpu_instancing": { "attributes": attributes } });
    file["nodes"] = json!([{ "mesh": 0, "translation": [10, 0, 0], "extensions": extensions, "children": [1] }, { "mesh": 0 }]);
    file["extensionsRequired"] = json!(["EXT_mesh_gpu_instancing"]);
    file
}

/// Where the corner (1, 0, 0) of each square is at a frame, sorted.
fn corners(scene: &LoadedScene, frame: usize) -> Vec<[i64; 3]> {
    let corner = |transforms: &[Affine3A]| {
        let transform = transforms[frame.min(transforms.len() - 1)];
        let at = transform.transform_point3(Vec3::X) + scene.origin.as_vec3();
        at.to_array().map(|v| (v * 1000.0).round() as i64)
    };
    let mut all: Vec<[i64; 3]> = scene.instances.iter().map(|instance| corner(&instance.transforms)).collect();
    all.sort_unstable();
    all
}

#[test]
fn a_node_shows_its_mesh_at_every_instance() {
    let scene = File::new(&spread()).load().unwrap();
    assert_eq!((scene.meshes.len(), scene.report.notes.len()), (1, 0));
    // Its child is shown once, at the node itself.
    assert_eq!(corners(&scene, 0), [[11000, 0, 0], [11000, 0, 0], [12000, 1000, 0], [12000, 3000, 0]]);

    let mut uneven = spread();
    uneven["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"]["SCALE"] = json!(0);
    let error = File::new(&uneven).error();
    assert!(error.contains("EXT_mesh_gpu_instancing/attributes: translations, rotations and scales differ"), "{error}");
    uneven["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"]["SCALE"] = json!(99);
    let error = File::new(&uneven).error();
    assert!(error.contains("/attributes/SCALE: there is no accessor 99"), "{error}");
    uneven["accessors"] = json!([
        uneven["accessors"][0],
        { "componentType": FLOAT, "type": "VEC3", "count": 2_000_000 }
    ]);
    uneven["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"] = json!({ "TRANSLATION": 1 });
    let error = File::new(&uneven).error();
    assert!(error.contains("more than 1048576 nodes and instances"), "{error}");
    // As many as there may be, of a mesh of many primitives.
    uneven["accessors"][1]["count"] = json!(1_000_000);
    uneven["meshes"][0]["primitives"] = vec![uneven["meshes"][0]["primitives"][0].clone(); 500].into();
    let error = File::new(&uneven).error();
    assert!(error.contains("/nodes/0: more than 2097152 parts"), "{error}");
}

#[test]
fn instances_follow_an_animated_node() {
    let mut file = spread();
    let curve = document(&[
        (FLOAT, "SCALAR", 2, false, bytes(&[0.0, 1.0])),
        (FLOAT, "VEC3", 2, false, bytes(&[10.0, 0.0, 0.0, 10.0, 0.0, 5.0])),
    ]);
    // A second buffer with the curve; the file has four views and accessors of its own.
    let push = |file: &mut Value, list: &str, mut entry: Value, key: &str, number: usize| {
        entry[key] = json!(number);
        file[list].as_array_mut().unwrap().push(entry);
    };
    file["buffers"].as_array_mut().unwrap().push(curve["buffers"][0].clone());
    for number in 0..2 {
        push(&mut file, "bufferViews", curve["bufferViews"][number].clone(), "buffer", 1);
        push(&mut file, "accessors", curve["accessors"][number].clone(), "bufferView", 4 + number);
    }
    file["accessors"][4]["min"] = json!([0.0]);
    file["accessors"][4]["max"] = json!([1.0]);
    file["animations"] = json!([{
        "samplers": [{ "input": 4, "output": 5 }],
        "channels": [{ "sampler": 0, "target": { "node": 0, "path": "translation" } }]
    }]);
    let file = File::new(&file);
    let mut scene = model_scene(&file.path(), None);
    scene.frames = 2;
    scene.objects[0].animation = Some(Animation { frames_per_second: 2.0, ..Animation::default() });
    let scene = load::load(&scene, &anywhere()).unwrap();
    assert_eq!(corners(&scene, 0), [[11000, 0, 0], [11000, 0, 0], [12000, 1000, 0], [12000, 3000, 0]]);
    assert_eq!(corners(&scene, 1), [[11000, 0, 2500], [11000, 0, 2500], [12000, 1000, 2500], [12000, 3000, 2500]]);
}
