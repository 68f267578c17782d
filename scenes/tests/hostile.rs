//! Small files that ask for much: refused with a reason, before the memory or the time is spent.

mod common;

use common::anywhere;
use common::{empty_scene, grey, load_model};
use renderflow_frame::reach::Reach;
use renderflow_scenes::description::{Geometry, Object, Scene};
use renderflow_scenes::shapes::Shape;
use renderflow_scenes::{LoadedScene, load};
use serde_json::json;
use std::io::Cursor;

/// What loading `bytes` as a texture says.
fn texture_error(bytes: &[u8]) -> String {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("t.jpg"), bytes).unwrap();
    let mut material = grey("m");
    material.base_color_texture = Some("t.jpg".into());
    let shape = Geometry::Shape(Shape::Sphere { radius: 1.0 });
    let object = Object {
        name: "o".into(),
        geometry: shape,
        material: Some("m".into()),
        transform: Default::default(),
        motion: None,
        animation: None,
    };
    let scene = Scene { materials: vec![material], objects: vec![object], ..empty_scene() };
    load::load(&scene, &Reach::folder(folder.path())).map(|_| ()).expect_err("the texture was accepted").to_string()
}

/// A JPEG of 8 x 8 grey texels whose header says otherwise.
fn jpeg_claiming(width: u16, height: u16) -> Vec<u8> {
    let mut bytes = Cursor::new(vec![]);
    image::GrayImage::from_pixel(8, 8, image::Luma([100])).write_to(&mut bytes, image::ImageFormat::Jpeg).unwrap();
    let mut bytes = bytes.into_inner();
    // Start of frame (ITU T.81, B.2.2): marker, length, precision, height, width.
    let frame = bytes.windows(2).position(|w| w == [0xff, 0xc0]).unwrap();
    bytes[frame + 5..frame + 7].copy_from_slice(&height.to_be_bytes());
    bytes[frame + 7..frame + 9].copy_from_slice(&width.to_be_bytes());
    bytes
}

#[test]
fn a_jpeg_cut_off_behind_a_large_header_is_refused() {
    let error = texture_error(&jpeg_claiming(8192, 8192));
    assert!(error.contains("t.jpg: 8192 x 8192 texels cannot be in"), "{error}");
    let error = texture_error(&jpeg_claiming(16384, 16384));
    assert!(error.contains("t.jpg: 16384 x 16384 is more than 67108864 texels"), "{error}");
}

/// A JPEG (ITU T.81, B.2) of three components, the second twice as wide as the others, with a scan of the first one alone: its
/// decoder panics.
#[test]
fn a_jpeg_that_its_decoder_cannot_survive_is_refused() {
    let error = texture_error(include_bytes!("../../fuzz/seeds/texture/one_component_of_three.jpg"));
    assert!(error.contains("t.jpg: damaged image data"), "{error}");
}

/// What loading a glTF document says.
fn model_error(document: &serde_json::Value) -> String {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.gltf");
    std::fs::write(&path, document.to_string()).unwrap();
    load_model(&path).map(|_| ()).expect_err("the model was accepted").to_string()
}

/// A kilobyte that asks for gigabytes of zeros.
#[test]
fn accessors_without_data_do_not_fill_the_memory() {
    let primitive = json!({ "attributes": { "POSITION": 0, "NORMAL": 0 } });
    let error = model_error(&json!({
        "asset": { "version": "2.0" },
        "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": vec![primitive; 100] }],
        "accessors": [{ "componentType": 5126, "count": 8_000_000, "type": "VEC3", "sparse": {
            "count": 1,
            "indices": { "bufferView": 0, "componentType": 5121 },
            "values": { "bufferView": 0 }
        } }],
        "bufferViews": [{ "buffer": 0, "byteLength": 12 }],
        "buffers": [{ "byteLength": 12, "uri": "data:,%00%00%00%00%00%00%00%00%00%00%00%00" }]
    }));
    assert!(error.ends_with("/accessors/0: 8000000 elements without data"), "{error}");
}

/// Six thousand primitives that all read the whole buffer.
#[test]
fn an_accessor_shared_by_too_many_primitives_is_refused() {
    let primitive = json!({ "attributes": { "POSITION": 0 } });
    let bytes = "%41".repeat(60_000);
    let error = model_error(&json!({
        "asset": { "version": "2.0" },
        "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": vec![primitive; 6_000] }],
        "accessors": [{ "componentType": 5126, "count": 5_000, "type": "VEC3", "bufferView": 0 }],
        "bufferViews": [{ "buffer": 0, "byteLength": 60_000 }],
        "buffers": [{ "byteLength": 60_000, "uri": format!("data:,{bytes}") }]
    }));
    assert!(error.ends_with("/accessors/0: 5000 elements read again and again"), "{error}");
}

/// An OBJ file, loaded with its materials.
fn obj(text: &[u8]) -> Result<LoadedScene, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.obj");
    std::fs::write(&path, text).unwrap();
    load::load(&common::model_scene(&path, None), &anywhere()).map_err(|e| e.to_string())
}

/// Went to the parser unchecked, whose index arithmetic overflowed.
#[test]
fn a_face_with_an_empty_fourth_index_is_checked() {
    let scene = obj(b"v 1 0 0\nvn 0 0 1\nf 1//-11/").unwrap();
    assert!(scene.meshes.iter().all(|mesh| mesh.triangles.is_empty()));
    let scene = obj(b"v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nf 1//-11/ 2//1/ 3//6148914691236517205/\n").unwrap();
    assert_eq!(scene.meshes[0].triangles, [[0, 1, 2]]);
    let error = obj(b"v 0 0 0\nf 1//6148914691236517205//1 1 1\n").unwrap_err();
    assert!(error.contains("model.obj line 2: "), "{error}");
}

/// A PNG whose header says 8192 x 8192 texels of 16 bits, with enough bytes behind it to be taken at its word.
fn png_claiming_much() -> Vec<u8> {
    let chunk = |kind: &[u8; 4], data: &[u8]| {
        let body = [&kind[..], data].concat();
        let crc = body.iter().fold(!0_u32, |crc, &byte| {
            (0..8).fold(crc ^ u32::from(byte), |crc, _| if crc & 1 == 1 { crc >> 1 ^ 0xedb8_8320 } else { crc >> 1 })
        });
        [&(data.len() as u32).to_be_bytes()[..], &body, &(!crc).to_be_bytes()].concat()
    };
    let header = [&8192_u32.to_be_bytes()[..], &8192_u32.to_be_bytes(), &[16, 6, 0, 0, 0]].concat();
    [&b"\x89PNG\r\n\x1a\n"[..], &chunk(b"IHDR", &header), &chunk(b"IDAT", &vec![0; 1 << 14])].concat()
}

/// Each is within the limits; all together would be 13 GiB. Nothing is decoded: the file has no texels.
#[test]
fn textures_that_do_not_fit_together_are_refused_before_they_are_decoded() {
    let png = png_claiming_much();
    let mut file = common::gltf::square();
    let count = 20;
    let list = |item: &dyn Fn(usize) -> serde_json::Value| (0..count).map(item).collect::<serde_json::Value>();
    file["materials"] = list(&|i| json!({ "pbrMetallicRoughness": { "baseColorTexture": { "index": i } } }));
    file["textures"] = list(&|i| json!({ "source": i }));
    file["images"] = list(&|_| json!({ "uri": common::gltf::data_uri("image/png", &png) }));
    file["meshes"][0]["primitives"] =
        list(&|i| json!({ "attributes": { "POSITION": 0, "TEXCOORD_0": 1 }, "mode": 5, "material": i }));
    let error = common::gltf::File::new(&file).error();
    assert!(
        error.contains("the 20 textures take 13.3 GiB of memory, more than the ")
            && error.contains("the largest are image 0 (0.7 GiB)"),
        "{error}"
    );
    // The same of a scene's own materials.
    let folder = tempfile::tempdir().unwrap();
    let mut scene = empty_scene();
    for i in 0..count {
        std::fs::write(folder.path().join(format!("{i}.png")), &png).unwrap();
        let mut material = grey(&format!("m{i}"));
        material.base_color_texture = Some(format!("{i}.png"));
        scene.materials.push(material);
        let geometry = Geometry::Shape(Shape::Sphere { radius: 1.0 });
        let (name, material) = (format!("o{i}"), Some(format!("m{i}")));
        scene.objects.push(Object { name, geometry, material, transform: Default::default(), motion: None, animation: None });
    }
    let error = load::load(&scene, &Reach::folder(folder.path())).map(drop).unwrap_err().to_string();
    assert!(error.contains("the 20 textures take 13.3 GiB of memory"), "{error}");
}
