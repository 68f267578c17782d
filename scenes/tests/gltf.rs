//! glTF features, one by one, in small files written here.

mod common;

use common::anywhere;
use common::gltf::{FLOAT, File, STRIP, bytes, data_uri, document, square};
use common::{asset, grey, load_model, model_scene};
use glam::{Vec2, Vec3};
use renderflow_frame::reach::Reach;
use renderflow_scenes::loaded::Wrap;
use renderflow_scenes::mipmap::{self, Texels};
use renderflow_scenes::{LoadedScene, load};
use serde_json::{Value, json};

/// Sum of the triangles' vector areas in the world.
fn vector_area(scene: &LoadedScene) -> Vec3 {
    let mut sum = Vec3::ZERO;
    for instance in &scene.instances {
        let mesh = &scene.meshes[instance.mesh];
        for t in &mesh.triangles {
            let [a, b, c] = t.map(|i| instance.transform(0).transform_point3(mesh.positions[i as usize]));
            sum += 0.5 * (b - a).cross(c - a);
        }
    }
    sum
}

#[test]
fn strips_fans_and_lists_face_the_same_way() {
    assert_eq!(vector_area(&File::new(&square()).load().unwrap()), Vec3::Z);
    // A fan around the first corner, and a list with 8-bit indices.
    let mut fan = document(&[(FLOAT, "VEC3", 4, false, bytes(&STRIP)), (5121, "SCALAR", 4, false, vec![0, 1, 3, 2])]);
    fan["meshes"][0]["primitives"][0]["indices"] = json!(1);
    fan["meshes"][0]["primitives"][0]["mode"] = json!(6);
    assert_eq!(vector_area(&File::new(&fan).load().unwrap()), Vec3::Z);
    let mut list = document(&[(FLOAT, "VEC3", 4, false, bytes(&STRIP)), (5121, "SCALAR", 6, false, vec![0, 1, 2, 2, 1, 3])]);
    list["meshes"][0]["primitives"][0]["indices"] = json!(1);
    assert_eq!(vector_area(&File::new(&list).load().unwrap()), Vec3::Z);
}

#[test]
fn mirrored_nodes_keep_the_outside_outside() {
    let mut file = square();
    // A square facing +z, mirrored in x, still faces +z; mirrored in z it faces -z.
    file["nodes"] = json!([{ "mesh": 0, "scale": [-2, 1, 1] }, { "mesh": 0, "scale": [1, 1, -1], "translation": [5, 0, 0] }]);
    file["scenes"][0]["nodes"] = json!([0]);
    assert_eq!(vector_area(&File::new(&file).load().unwrap()), 2.0 * Vec3::Z);
    file["scenes"][0]["nodes"] = json!([1]);
    assert_eq!(vector_area(&File::new(&file).load().unwrap()), -Vec3::Z);
    // Both nodes together share one mesh (and its one reversed copy).
    file["scenes"][0]["nodes"] = json!([0, 1]);
    let scene = File::new(&file).load().unwrap();
    assert_eq!((scene.instances.len(), scene.instances[0].mesh == scene.instances[1].mesh), (2, true));
}

#[test]
fn child_nodes_follow_their_parents() {
    let mut file = square();
    // A column-major matrix: quarter turn about z, then 3 along x; the child moves 1 along its own x.
    let matrix = json!([0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 3, 0, 0, 1]);
    file["nodes"] = json!([{ "children": [1], "matrix": matrix }, { "mesh": 0, "translation": [1, 0, 0] }]);
    let scene = File::new(&file).load().unwrap();
    let corner = scene.instances[0].transform(0).transform_point3(Vec3::X);
    assert!(corner.distance(Vec3::new(3.0, 2.0, 0.0)) < 1e-6, "{corner}");
}

#[test]
fn integers_are_normalised_and_quantised_positions_read() {
    // 16-bit positions (KHR_mesh_quantization) as plain integers, 8-bit texture coordinates and normals as fractions.
    let positions: Vec<u8> = [0_i16, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 0].iter().flat_map(|v| v.to_le_bytes()).collect();
    let mut file = document(&[
        (5122, "VEC3", 3, false, positions[..18].to_vec()),
        (5121, "VEC2", 3, true, vec![0, 255, 51, 0, 0, 0]),
        (5120, "VEC3", 3, true, vec![0, 0, 127, 0, 0, 127, 0, 0, 127]),
    ]);
    file["meshes"][0]["primitives"][0]["attributes"] = json!({ "POSITION": 0, "TEXCOORD_0": 1, "NORMAL": 2 });
    file["extensionsUsed"] = json!(["KHR_mesh_quantization"]);
    file["extensionsRequired"] = json!(["KHR_mesh_quantization"]);
    let scene = File::new(&file).load().unwrap();
    let mesh = &scene.meshes[0];
    assert_eq!(mesh.uvs[..2], [Vec2::new(0.0, 1.0), Vec2::new(0.2, 0.0)]);
    assert_eq!(mesh.normals, [Vec3::Z; 3]);
    assert_eq!(mesh.positions[1], Vec3::new(0.0, 2.0, 0.0));
}

/// A square with a material that looks up one image in TEXCOORD_1.
fn textured(image: Value) -> Value {
    let uvs = [0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 1.0];
    let mut file = document(&[
        (FLOAT, "VEC3", 4, false, bytes(&STRIP)),
        (FLOAT, "VEC2", 4, false, bytes(&[0.5; 8])),
        (FLOAT, "VEC2", 4, false, bytes(&uvs)),
    ]);
    file["meshes"][0]["primitives"][0] =
        json!({ "mode": 5, "material": 0, "attributes": { "POSITION": 0, "TEXCOORD_0": 1, "TEXCOORD_1": 2 } });
    file["images"] = json!([image]);
    file["samplers"] = json!([{ "wrapS": 33071, "wrapT": 33648 }]);
    file["textures"] = json!([{ "source": 0, "sampler": 0 }]);
    file["materials"] = json!([{
        "name": "painted",
        "alphaMode": "BLEND",
        "pbrMetallicRoughness": { "baseColorTexture": { "index": 0, "texCoord": 1 }, "baseColorFactor": [0.5, 1, 1, 0.5], "metallicFactor": 0.25 },
        "normalTexture": { "index": 0, "texCoord": 1, "scale": 0.5, "extensions": { "KHR_texture_transform": { "offset": [0.5, 0] } } },
        "emissiveFactor": [1, 0, 0],
        "extensions": { "KHR_materials_ior": { "ior": 1.25 }, "KHR_materials_emissive_strength": { "emissiveStrength": 3 } },
    }]);
    file
}

/// 2 x 1 pixels, 16 bits a channel.
fn png16() -> Vec<u8> {
    let picture = image::ImageBuffer::<image::Rgb<u16>, _>::from_raw(2, 1, vec![0_u16, 32768, 65535, 65535, 0, 0]).unwrap();
    let mut out = std::io::Cursor::new(vec![]);
    image::DynamicImage::ImageRgb16(picture).write_to(&mut out, image::ImageFormat::Png).unwrap();
    out.into_inner()
}

#[test]
fn materials_textures_and_their_options_arrive() {
    let scene = File::new(&textured(json!({ "uri": data_uri("image/png", &png16()) }))).load().unwrap();
    let material = &scene.materials[0];
    assert_eq!(
        (material.name.as_str(), material.surface.base_color.to_array(), material.surface.metallic),
        ("painted", [0.5, 1.0, 1.0], 0.25)
    );
    // F0 of an index of 1.25 is 1/81, in units of 0.08.
    assert!((material.surface.specular - 1.0 / 81.0 / 0.08).abs() < 1e-6);
    assert_eq!(material.emissive, [3.0, 0.0, 0.0]);
    assert_eq!((material.opacity, scene.report.blended), (Some(0.5), 1));
    let color = &scene.textures[material.base_color_texture.as_ref().unwrap().texture];
    assert_eq!(color.wrap, [Wrap::Clamp, Wrap::Mirror]);
    // sRGB 32768/65535 is 0.2140482 linear (IEC 61966-2-1).
    let Texels::Words(texels) = &color.levels[0].texels else { panic!("16 bits a channel") };
    assert_eq!(texels[..], [[0, 32768, 65535, 65535], [65535, 0, 0, 65535]]);
    assert!((mipmap::decode(color.encoding, 32768.0 / 65535.0) - 0.214_048_2).abs() < 1e-6);
    let (slot, scale) = material.normal_texture.as_ref().unwrap();
    assert_eq!((*scale, slot.uv_transform.translation), (0.5, Vec2::new(0.5, 0.0)));
    let normal = &scene.textures[slot.texture];
    assert_eq!([1.0, 0.0].map(|v| mipmap::decode(normal.encoding, v)), [1.0, -1.0]);
    assert_eq!(normal.levels[0], color.levels[0]);
    // The coordinates are those of TEXCOORD_1, and the normal map brought tangents: u grows along x, green points to smaller v.
    let mesh = &scene.meshes[0];
    // (The mesh has no normals: each of its two triangles has corners of its own.)
    assert_eq!((mesh.uvs.len(), mesh.uvs[4]), (6, Vec2::ONE));
    assert!(mesh.tangents.iter().all(|t| t.truncate().distance(Vec3::X) < 1e-6 && t.w == -1.0), "{:?}", mesh.tangents);
}

/// There is no look-up of the nearest texel: one note says so for the whole file.
#[test]
fn textures_that_ask_for_the_nearest_texel_are_noted() {
    let notes = |sampler: Value| {
        let mut file = textured(json!({ "uri": data_uri("image/png", &png16()) }));
        file["samplers"] = json!([sampler]);
        let notes = File::new(&file).load().unwrap().report.notes;
        notes.into_iter().filter(|note| note.contains("nearest texel")).collect::<Vec<String>>()
    };
    for sampler in [json!({ "magFilter": 9728, "minFilter": 9987 }), json!({ "minFilter": 9728 })] {
        let notes = notes(sampler);
        let expected = "model.gltf: 1 textures ask for the nearest texel (NEAREST); they are filtered like the others";
        assert!(notes.len() == 1 && notes[0].ends_with(expected), "{notes:?}");
    }
    assert_eq!(notes(json!({})), [""; 0]);
    assert_eq!(notes(json!({ "magFilter": 9729, "minFilter": 9986 })), [""; 0]);
}

#[test]
fn a_texture_that_is_missing_or_broken_is_named() {
    let file = File::new(&textured(json!({ "uri": "oak%20wood.png" })));
    let expected = "/objects/0 (model): material \"painted\", /images/0: cannot use texture FOLDER/oak wood.png: cannot read: ";
    assert!(file.error().starts_with(expected), "{}", file.error());
    // In grey, nobody wants the texture.
    assert!(load_model(&file.path()).is_ok());
    let broken = File::new(&textured(json!({ "uri": data_uri("image/png", b"no picture") })));
    assert!(broken.error().ends_with("model.gltf: neither PNG, JPEG nor WebP"), "{}", broken.error());
    let elsewhere = File::new(&textured(json!({ "uri": "https://example.org/a.png" })));
    assert!(
        elsewhere.error().ends_with("\"https://example.org/a.png\" is not a path relative to the file"),
        "{}",
        elsewhere.error()
    );
}

#[test]
fn errors_name_the_place_in_the_file() {
    let error = |change: &dyn Fn(&mut Value)| {
        let mut file = square();
        change(&mut file);
        File::new(&file).error().replace("/objects/0 (model): FOLDER/model.gltf ", "")
    };
    let buffer = error(&|f| f["buffers"][0]["byteLength"] = json!(1000));
    assert_eq!(buffer, "/buffers/0: holds 80 bytes where byteLength says 1000");
    let missing = error(&|f| f["buffers"][0]["uri"] = json!("gone.bin"));
    assert!(missing.starts_with("/buffers/0: cannot read FOLDER/gone.bin: "), "{missing}");
    let count = error(&|f| f["accessors"][0]["count"] = json!(4_000_000_000_u32));
    assert_eq!(count, "/accessors/0: 4000000000 elements of 12 bytes leave the 48 bytes of buffer view 0");
    let view = error(&|f| f["bufferViews"][0]["byteOffset"] = json!(u64::MAX));
    assert!(view.starts_with("/bufferViews/0: 48 bytes from 18446744073709551615 leave the 80 bytes of buffer 0"), "{view}");
    let loops = error(&|f| f["nodes"] = json!([{ "mesh": 0, "children": [1] }, { "children": [0] }]));
    assert_eq!(loops, "/nodes/0: the node has two parents, or is its own ancestor");
    let extension = error(&|f| f["extensionsRequired"] = json!(["EXT_meshopt_compression"]));
    assert!(extension.contains("EXT_meshopt_compression") && extension.contains("required extension"), "{extension}");
    let lengths = error(&|f| {
        f["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = json!(1);
        f["accessors"][1]["count"] = json!(3);
    });
    assert_eq!(lengths, "/meshes/0/primitives/0/attributes/TEXCOORD_0: 3 values for 4 positions");
    let zeros = error(&|f| {
        let exceptions =
            json!({ "count": 1, "indices": { "bufferView": 0, "componentType": 5121 }, "values": { "bufferView": 0 } });
        f["accessors"][0] = json!({ "componentType": FLOAT, "type": "VEC3", "count": 4_000_000_000_u32, "sparse": exceptions });
    });
    assert_eq!(zeros, "/accessors/0: 4000000000 elements without data");
}

#[test]
fn triangles_that_cannot_be_rendered_are_dropped_and_counted() {
    // NaN, an index out of range, no area; one good triangle.
    let mut positions = STRIP.to_vec();
    positions.extend([f32::NAN, 0.0, 0.0, f32::INFINITY, 0.0, 0.0]);
    let order = [0, 1, 4, 0, 1, 5, 0, 1, 9, 1, 1, 2, 0, 1, 2];
    let mut file = document(&[(FLOAT, "VEC3", 6, false, bytes(&positions)), (5121, "SCALAR", 15, false, order.to_vec())]);
    file["meshes"][0]["primitives"][0]["indices"] = json!(1);
    let scene = File::new(&file).load().unwrap();
    assert_eq!((scene.report.triangles.dropped(), scene.meshes[0].triangles.len()), (4, 1));
    assert!(scene.meshes[0].positions.iter().all(|p| p.is_finite()));
}

#[test]
fn points_lines_and_flat_nodes_are_skipped_and_noted() {
    let mut file = square();
    let attributes = json!({ "POSITION": 0 });
    file["meshes"] = json!([{ "primitives": [{ "attributes": attributes, "mode": 5 }, { "attributes": attributes, "mode": 0 }, { "attributes": attributes, "mode": 1 }] }]);
    file["nodes"] = json!([{ "mesh": 0 }, { "mesh": 0, "scale": [1, 0, 1] }]);
    file["scenes"][0]["nodes"] = json!([0, 1]);
    let scene = File::new(&file).load().unwrap();
    assert_eq!(scene.instances.len(), 1);
    let notes = scene.report.notes.join("\n");
    for expected in ["2 primitives of points or lines skipped", "1 nodes skipped because their transform flattens"] {
        assert!(notes.contains(expected), "{expected:?} is not in\n{notes}");
    }
}

#[test]
fn cameras_and_animations_are_noted() {
    let mut file = square();
    let camera = json!({ "type": "perspective", "perspective": { "yfov": 0.7, "znear": 0.1 } });
    file["cameras"] = json!([camera, camera]);
    file["nodes"] = json!([{ "mesh": 0, "camera": 1 }]);
    file["accessors"].as_array_mut().unwrap().push(json!({
        "bufferView": 0, "componentType": FLOAT, "type": "SCALAR", "count": 4, "min": [0.0], "max": [1.0]
    }));
    file["animations"] = json!([{
        "samplers": [{ "input": 1, "output": 0 }],
        "channels": [{ "sampler": 0, "target": { "node": 0, "path": "translation" } }]
    }]);
    let notes = File::new(&file).load().unwrap().report.notes.join("\n");
    let expected =
        ["the file has 1 camera (0); --camera NAME uses one", "the file has 1 animation (0); --animation NAME plays one"];
    for expected in expected {
        assert!(notes.contains(expected), "{expected:?} is not in\n{notes}");
    }
    file["nodes"] = json!([{ "mesh": 0 }]);
    let notes = File::new(&file).load().unwrap().report.notes.join("\n");
    assert!(notes.contains("no node of the file's scene shows a camera of the file"), "{notes}");
}

#[test]
fn parts_share_an_object_and_have_names_of_their_own() {
    let mut file = square();
    file["nodes"] = json!([{ "mesh": 0, "name": "leg" }, { "mesh": 0, "name": "leg", "translation": [2, 0, 0] }]);
    file["scenes"][0]["nodes"] = json!([0, 1]);
    let written = File::new(&file);
    let mut scene = model_scene(&written.path(), Some(grey("grey")));
    let mut second = scene.objects[0].clone();
    (second.name, second.transform.translation) = ("model/leg".into(), [0.0, 3.0, 0.0]);
    scene.objects.push(second);
    let loaded = load::load(&scene, &anywhere()).unwrap();
    let names: Vec<_> = loaded.instances.iter().map(|i| (i.name.as_str(), i.object_id, i.mesh)).collect();
    assert_eq!(names, [("model/leg#2", 1, 0), ("model/leg#3", 1, 0), ("model/leg/leg", 2, 0), ("model/leg/leg#2", 2, 0)]);
}

/// A closed, single-sided body whose faces point inwards is not there from outside: that is said, and nothing is changed.
#[test]
fn bodies_that_are_inside_out_are_noted() {
    let corners: Vec<f32> = (0..8u8).flat_map(|i| [1, 2, 4].map(|bit| f32::from(u8::from(i & bit != 0)))).collect();
    let sides: [[u16; 4]; 6] = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let indices = |inwards: bool, count: usize| -> Vec<u8> {
        let triangles = sides[..count].iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]);
        let turned = triangles.map(|[a, b, c]| if inwards { [a, c, b] } else { [a, b, c] });
        turned.flatten().flat_map(u16::to_le_bytes).collect()
    };
    let body = |inwards: bool, sides: usize, double_sided: bool, scale: f32| {
        let count = 6 * sides;
        let mut file =
            document(&[(FLOAT, "VEC3", 8, false, bytes(&corners)), (5123, "SCALAR", count, false, indices(inwards, sides))]);
        file["materials"] = json!([{ "doubleSided": double_sided }]);
        file["meshes"][0]["primitives"][0]["indices"] = json!(1);
        file["meshes"][0]["primitives"][0]["material"] = json!(0);
        // Twice, one of them perhaps a mirror image: the mesh is named once.
        file["nodes"] = json!([{ "mesh": 0, "name": "a" }, { "mesh": 0, "name": "b", "scale": [scale, 1, 1] }]);
        file["scenes"][0]["nodes"] = json!([0, 1]);
        File::new(&file).load().unwrap()
    };
    let said = |scene: &LoadedScene| scene.report.notes.iter().filter(|note| note.contains("point inwards")).count();
    for scale in [1.0, -1.0] {
        assert_eq!(said(&body(true, 6, false, scale)), 1, "{scale}");
        for (inwards, sides, double_sided) in [(false, 6, false), (true, 6, true), (true, 5, false)] {
            let scene = body(inwards, sides, double_sided, scale);
            assert_eq!(said(&scene), 0, "{inwards} {sides} {double_sided}: {:?}", scene.report.notes);
        }
    }
    let Some(path) = asset("gltf/edge/gltf-rs/box_sparse.glb") else { return };
    assert_eq!(said(&renderflow_scenes::load::load(&model_scene(&path, None), &anywhere()).unwrap()), 1);
}

/// Loads a document as text, perhaps with a byte order mark, or as a container.
fn load_bytes(bytes: &[u8]) -> Result<usize, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.gltf");
    std::fs::write(&path, bytes).unwrap();
    let loaded = load::load(&common::model_scene(&path, None), &anywhere()).map_err(|e| e.to_string())?;
    Ok(loaded.meshes.iter().map(|mesh| mesh.triangles.len()).sum())
}

fn container(json: &[u8]) -> Vec<u8> {
    let mut json = json.to_vec();
    json.resize(json.len().next_multiple_of(4), b' ');
    let words = [20 + json.len() as u32, json.len() as u32].map(u32::to_le_bytes);
    [&b"glTF\x02\0\0\0"[..], &words[0], &words[1], b"JSON", &json].concat()
}

/// All of it is valid glTF 2.0.
#[test]
fn every_form_of_a_valid_file_is_read() {
    let accepted = |what: &str, change: &dyn Fn(&mut Value)| {
        let mut file = square();
        change(&mut file);
        let json = file.to_string().into_bytes();
        for bytes in [json.clone(), [&b"\xef\xbb\xbf"[..], &json].concat(), container(&json)] {
            assert_eq!(load_bytes(&bytes), Ok(2), "{what}");
        }
    };
    for extras in [json!("text"), json!([1, 2]), json!(7), json!(true), json!(null), json!({ "a": 1 })] {
        accepted("extras", &|f| {
            for place in ["/asset", "/nodes/0", "/meshes/0", "/meshes/0/primitives/0", "/accessors/0", "/buffers/0", "/scenes/0"]
            {
                f.pointer_mut(place).unwrap()["extras"] = extras.clone();
            }
            f["extras"] = extras.clone();
        });
    }
    accepted("an animation of what is no node", &|f| {
        let target = json!({ "path": "pointer", "extensions": { "KHR_animation_pointer": { "pointer": "/materials/0/x" } } });
        let sampler = json!({ "input": 0, "output": 0 });
        f["animations"] = json!([{ "samplers": [sampler], "channels": [{ "sampler": 0, "target": target }] }]);
    });
    accepted("whole numbers with a fraction of zero", &|f| {
        f["accessors"][0]["count"] = json!(4.0);
        f["accessors"][0]["componentType"] = json!(5126.0);
        f["bufferViews"][0]["byteLength"] = json!(48.0);
        f["meshes"][0]["primitives"][0]["mode"] = json!(5.0);
        f["scene"] = json!(0.0);
        f["nodes"][0]["translation"] = json!([1.0, 2.0, -3.0]);
    });
    accepted("an attribute of an application", &|f| f["meshes"][0]["primitives"][0]["attributes"]["_TEMPERATURE"] = json!(0));
}

/// A texture whose image only an extension tells is noted and not used.
#[test]
fn a_texture_of_an_extension_is_noted() {
    for extension in [Some("EXT_texture_avif"), Some("KHR_texture_basisu"), None] {
        let mut file = square();
        let mut texture = json!({});
        if let Some(name) = extension {
            texture["extensions"][name] = json!({ "source": 0 });
            file["extensionsUsed"] = json!([name]);
        }
        file["textures"] = json!([texture]);
        file["images"] = json!([{ "uri": "gone.avif", "mimeType": "image/avif" }]);
        file["materials"] =
            json!([{ "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } }, "emissiveTexture": { "index": 0 } }]);
        file["meshes"][0]["primitives"][0]["material"] = json!(0);
        let loaded = File::new(&file).load().unwrap();
        assert!(loaded.textures.is_empty() && loaded.materials[0].base_color_texture.is_none());
        let notes: Vec<&String> = loaded.report.notes.iter().filter(|note| note.contains(": /textures/0 is not used")).collect();
        assert_eq!(notes.len(), 1, "{:?}", loaded.report.notes);
        assert!(notes[0].contains(extension.unwrap_or("no image")), "{notes:?}");
    }
}

/// What is not valid stays refused, with its place and in plain words.
#[test]
fn refusals_say_what_is_wrong_and_where() {
    for (change, expected) in [
        (
            &|f: &mut Value| f["accessors"][0]["count"] = json!(4.5) as Value,
            "/accessors/0/count: not glTF 2.0: found 4.5 where a whole number",
        ),
        (&|f| f["nodes"][0]["name"] = json!(7), "/nodes/0/name: not glTF 2.0: found 7 where a string is needed"),
        (
            &|f| f["meshes"][0]["primitives"][0]["attributes"]["COLOUR"] = json!(0),
            "/meshes/0/primitives/0/attributes/COLOUR: no attribute has this name",
        ),
        (&|f| f["nodes"][0]["mesh"] = json!(3), "/nodes/0/mesh: there is nothing with the index 3"),
        (
            &|f| f["accessors"][0]["componentType"] = json!(77),
            "/accessors/0/componentType: 77 is not one of the values allowed here",
        ),
        (
            &|f| {
                f["animations"] =
                    json!([{ "samplers": [], "channels": [{ "sampler": 0, "target": { "node": 0, "path": "translation" } }] }])
            },
            "/animations/0/channels/0/sampler: there is nothing with the index 0",
        ),
        (&|f| f["asset"]["version"] = json!("9".repeat(5000)), "/asset/version: \"9999"),
    ] as [(&dyn Fn(&mut Value), &str); 7]
    {
        let mut file = square();
        change(&mut file);
        let error = File::new(&file).error();
        let reason = error.strip_prefix("/objects/0 (model): FOLDER/model.gltf ").unwrap_or(&error);
        assert!(reason.starts_with(expected) && reason.len() < 200, "{expected}: {error}");
    }
    assert!(load_bytes(&container(b"")).unwrap_err().ends_with("there is no JSON in it"));
    assert!(load_bytes(b"{").unwrap_err().ends_with("not glTF 2.0: the text ends inside an object at line 1 column 1"));
}

/// Meshes that are not there, or not shown, or all broken.
#[test]
fn a_model_without_a_triangle_says_why() {
    let refusal = |change: &dyn Fn(&mut Value)| {
        let mut file = square();
        change(&mut file);
        let file = File::new(&file);
        let error = load::describe_model(&file.path(), None, &load::ModelView::default(), &Reach::of(&file.path()));
        error.unwrap_err().to_string().split_once("model.gltf: ").map(|(_, reason)| reason.to_owned()).expect("names the file")
    };
    let none = "the model has no triangle to render";
    assert_eq!(refusal(&|f| f["nodes"] = json!([{}])), format!("{none} (no node of its scene shows a mesh)"));
    assert_eq!(
        refusal(&|f| {
            f.as_object_mut().unwrap().remove("meshes");
            f["nodes"] = json!([{}]);
        }),
        format!("{none} (the file has no mesh)")
    );
    assert_eq!(
        refusal(&|f| f["meshes"][0]["primitives"][0]["mode"] = json!(0)),
        format!("{none} (1 primitives of points or lines skipped)")
    );
    let mut wrong = document(&[(FLOAT, "VEC3", 3, false, bytes(&STRIP[..9])), (5121, "SCALAR", 3, false, vec![0, 1, 7])]);
    wrong["meshes"][0]["primitives"][0]["indices"] = json!(1);
    assert_eq!(
        refusal(&|f| *f = wrong.clone()),
        "the model's only triangle cannot be rendered: 1 has a vertex that does not exist (mesh \"mesh 0\": triangle 0 names vertex 7, there are 3)"
    );
}
