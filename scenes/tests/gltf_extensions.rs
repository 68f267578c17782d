//! Material extensions of glTF with their textures, several sets of texture coordinates, and materials of other models.

mod common;

use common::gltf::{FLOAT, File, STRIP, bytes, document, png};
use glam::{Vec2, Vec3A};
use renderflow_scenes::mipmap::Texels;
use renderflow_scenes::{LoadedScene, Material};
use serde_json::{Value, json};

/// A square with two sets of texture coordinates, the given material, and textures of images with these pixels.
fn with_material(material: Value, images: &[&[[u8; 4]]]) -> Value {
    let mut file = document(&[
        (FLOAT, "VEC3", 4, false, bytes(&STRIP)),
        (FLOAT, "VEC2", 4, false, bytes(&[0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 1.0])),
        (FLOAT, "VEC2", 4, false, bytes(&[0.5, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0, 1.0])),
    ]);
    let attributes = json!({ "POSITION": 0, "TEXCOORD_0": 1, "TEXCOORD_1": 2 });
    file["meshes"][0]["primitives"][0] = json!({ "mode": 5, "material": 0, "attributes": attributes });
    file["images"] = images.iter().map(|pixels| json!({ "uri": png(pixels) })).collect();
    file["textures"] = (0..images.len()).map(|i| json!({ "source": i })).collect();
    file["materials"] = json!([material]);
    file
}

fn load(material: Value, images: &[&[[u8; 4]]]) -> LoadedScene {
    File::new(&with_material(material, images)).load().unwrap()
}

/// The material with one extension, and what is said of it.
fn extended(name: &str, value: Value, images: &[&[[u8; 4]]]) -> (Material, String) {
    let scene = load(json!({ "name": "m", "extensions": { name: value } }), images);
    assert!(scene.textures.is_empty(), "only the mean is kept");
    (scene.materials[scene.instances[0].material].clone(), scene.report.notes.join("\n"))
}

/// sRGB 188 is 0.503 linear (IEC 61966-2-1); 51 of 255 is 0.2.
const EVEN: [[u8; 4]; 2] = [[188, 51, 0, 51], [188, 51, 0, 51]];
const UNEVEN: [[u8; 4]; 2] = [[255, 255, 0, 0], [0, 51, 255, 102]];

#[test]
fn textures_of_extensions_count_by_their_mean() {
    let coat = |images: &[&[[u8; 4]]]| {
        let textures = json!({ "index": 0 });
        let value = json!({ "clearcoatFactor": 0.5, "clearcoatRoughnessFactor": 0.5, "clearcoatTexture": textures,
            "clearcoatRoughnessTexture": textures, "clearcoatNormalTexture": textures });
        extended("KHR_materials_clearcoat", value, images)
    };
    let (even, notes) = coat(&[&EVEN]);
    assert!((even.surface.clearcoat - 0.5 * 188.0 / 255.0).abs() < 1e-6);
    // Roughness 0.5 * 0.2 is a width of 0.01 = mix(0.1, 0.001, gloss).
    assert!((0.1 + (0.001 - 0.1) * even.surface.clearcoat_gloss - 0.01).abs() < 1e-6);
    assert!(!notes.contains("mean") && notes.contains("clearcoatNormalTexture is not read"), "{notes}");
    let (uneven, notes) = coat(&[&UNEVEN]);
    assert!((uneven.surface.clearcoat - 0.25).abs() < 1e-6);
    assert!(notes.contains("material \"m\": clearcoatTexture is replaced by its mean"), "{notes}");
    assert!(notes.contains("clearcoatRoughnessTexture is replaced by its mean"), "{notes}");

    let value =
        json!({ "sheenColorFactor": [1, 1, 1], "sheenColorTexture": { "index": 0 }, "sheenRoughnessTexture": { "index": 0 } });
    let (sheen, notes) = extended("KHR_materials_sheen", value, &[&EVEN]);
    assert!((sheen.surface.sheen - 0.5029).abs() < 1e-3, "{}", sheen.surface.sheen);
    assert!(notes.contains("sheenRoughnessTexture are not read"), "{notes}");

    // Reflectance 0.04 * 0.2: a fifth of the default.
    let (specular, notes) = extended("KHR_materials_specular", json!({ "specularTexture": { "index": 0 } }), &[&EVEN]);
    assert!((specular.surface.specular - 0.1).abs() < 1e-6 && notes.is_empty(), "{notes}");
    let grey = [[188, 188, 188, 255]];
    let (specular, notes) = extended("KHR_materials_specular", json!({ "specularColorTexture": { "index": 0 } }), &[&grey]);
    assert!((specular.surface.specular - 0.5 * 0.5029).abs() < 1e-3 && notes.is_empty(), "{notes}");
}

/// Red and green are the cosine and the sine of the direction, blue a share of the strength; a factor turns it further.
#[test]
fn the_direction_of_highlights_comes_from_the_texture() {
    let value = json!({ "anisotropyStrength": 0.5, "anisotropyRotation": 0.25, "anisotropyTexture": { "index": 0 } });
    let (along_v, notes) = extended("KHR_materials_anisotropy", value.clone(), &[&[[128, 255, 204, 255]]]);
    let angle = (1.0_f32).atan2(2.0 * 128.0 / 255.0 - 1.0) + 0.25;
    assert!((along_v.anisotropy_rotation - angle).abs() < 1e-6 && (along_v.surface.anisotropic - 0.4).abs() < 1e-6);
    assert_eq!(notes, "");
    // Two directions across each other have a mean between them, of 0.707 of the length.
    let (mixed, notes) = extended("KHR_materials_anisotropy", value, &[&[[128, 255, 255, 255], [255, 128, 255, 255]]]);
    assert!((mixed.anisotropy_rotation - (std::f32::consts::FRAC_PI_4 + 0.25)).abs() < 1e-6);
    assert!((mixed.surface.anisotropic - 0.5 * 0.7099).abs() < 2e-3, "{}", mixed.surface.anisotropic);
    assert!(notes.contains("anisotropyTexture is replaced by its mean"), "{notes}");
}

#[test]
fn unlit_surfaces_emit_their_base_colour() {
    let file = json!({
        "pbrMetallicRoughness": { "baseColorFactor": [0.25, 0.5, 1, 1], "baseColorTexture": { "index": 0 } },
        "emissiveFactor": [0, 0, 0],
        "extensions": { "KHR_materials_unlit": {} }
    });
    let scene = load(file, &[&EVEN]);
    let material = &scene.materials[scene.instances[0].material];
    assert_eq!((material.emissive, material.surface.base_color, material.surface.specular), ([0.25, 0.5, 1.0], Vec3A::ZERO, 0.0));
    assert!(material.emissive_texture.is_some());
    assert!(scene.report.notes.join("\n").contains("it is unlit: it emits its base colour"), "{:?}", scene.report.notes);
    assert!(!scene.report.notes.join("\n").contains("KHR_materials_unlit is not read"));
}

/// Numbers of Khronos' conversion, worked out from its formulae in double precision by another program.
#[test]
fn specular_and_glossiness_become_metallic_and_roughness() {
    let convert = |diffuse: [f32; 3], specular: f32, more: [f32; 2], gloss: f32| {
        let value = json!({ "diffuseFactor": [diffuse[0], diffuse[1], diffuse[2], 1],
            "specularFactor": [specular, more[0], more[1]], "glossinessFactor": gloss });
        let surface = extended("KHR_materials_pbrSpecularGlossiness", value, &[]).0.surface;
        (surface.base_color, surface.metallic, surface.roughness)
    };
    #[track_caller]
    fn close((color, metallic, roughness): (Vec3A, f32, f32), expected: [f32; 5]) {
        let found = [color.x, color.y, color.z, metallic, roughness];
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-5), "{found:?}, not {expected:?}");
    }
    close(convert([0.5, 0.25, 0.1], 0.02, [0.02, 0.02], 0.75), [0.510_416_7, 0.255_208_3, 0.102_083_3, 0.0, 0.25]);
    close(convert([0.1, 0.2, 0.3], 0.6, [0.5, 0.4], 0.4), [0.592_815_5, 0.583_956_2, 0.575_096_9, 0.866_159_9, 0.6]);
    close(convert([0.0; 3], 0.9, [0.8, 0.7], 1.0), [0.9, 0.8, 0.7, 1.0, 0.0]);
}

/// Texel by texel: a dielectric beside a metal.
#[test]
fn textures_of_specular_and_glossiness_are_converted() {
    let value = json!({ "diffuseTexture": { "index": 0 }, "specularGlossinessTexture": { "index": 1 } });
    let file = json!({ "name": "m", "extensions": { "KHR_materials_pbrSpecularGlossiness": value } });
    let scene = load(file, &[&[[188, 188, 188, 255], [0, 0, 0, 128]], &[[0, 0, 0, 51], [230, 188, 188, 255]]]);
    let material = &scene.materials[scene.instances[0].material];
    let texels =
        |slot: &Option<renderflow_scenes::TextureSlot>| match &scene.textures[slot.as_ref().unwrap().texture].levels[0].texels {
            Texels::Bytes(texels) => texels.clone(),
            Texels::Words(_) => panic!("8 bits"),
        };
    assert_eq!(scene.textures.len(), 2, "the textures of the file are not kept");
    assert_eq!((material.surface.base_color, material.surface.metallic, material.surface.roughness), (Vec3A::ONE, 1.0, 1.0));
    // 0.503 / 0.96 is 0.524, sRGB 191; a gloss of 0.2 is a roughness of 204. A metal has its specular colour.
    assert_eq!(texels(&material.base_color_texture), [[191, 191, 191, 255], [230, 188, 188, 128]]);
    assert_eq!(texels(&material.metallic_roughness_texture), [[255, 204, 0, 255], [255, 0, 255, 255]]);
    // Without metal, the diffuse texture is the base colour's as it is.
    let value = json!({ "diffuseTexture": { "index": 0 }, "specularFactor": [0, 0, 0], "glossinessFactor": 0.25 });
    let scene = load(json!({ "extensions": { "KHR_materials_pbrSpecularGlossiness": value } }), &[&EVEN]);
    let material = &scene.materials[scene.instances[0].material];
    assert_eq!(texels_of(&scene, material), EVEN);
    assert_eq!((material.surface.metallic, material.surface.roughness), (0.0, 0.75));
    assert!((material.surface.base_color.x - 1.0).abs() < 1e-6, "1 / 0.96 is held at 1");
}

fn texels_of(scene: &LoadedScene, material: &Material) -> Vec<[u8; 4]> {
    match &scene.textures[material.base_color_texture.as_ref().unwrap().texture].levels[0].texels {
        Texels::Bytes(texels) => texels.clone(),
        Texels::Words(_) => panic!("8 bits"),
    }
}

#[test]
fn variants_are_named() {
    let mut file = with_material(json!({}), &[]);
    file["extensionsUsed"] = json!(["KHR_materials_variants"]);
    file["extensions"] = json!({ "KHR_materials_variants": { "variants": [{ "name": "red" }, { "name": "blue" }] } });
    let notes = File::new(&file).load().unwrap().report.notes.join("\n");
    assert!(notes.contains("the materials have 2 variants (red, blue), which are not read"), "{notes}");
    assert!(!notes.contains("the extension"), "{notes}");
}

/// Each texture is looked up in its own set; the first set is that of the normal map, which tangents belong to.
#[test]
fn each_texture_has_its_own_set_of_coordinates() {
    let first = [Vec2::ZERO, Vec2::X, Vec2::Y, Vec2::ONE];
    let second = [Vec2::new(0.5, 0.0), Vec2::new(0.5, 1.0), Vec2::ZERO, Vec2::Y];
    let sets = |normal: u32, color: Value| {
        let scene = load(
            json!({
                "pbrMetallicRoughness": { "baseColorTexture": color },
                "normalTexture": { "index": 0, "texCoord": normal },
                "occlusionTexture": { "index": 0, "texCoord": 7 }
            }),
            &[&UNEVEN],
        );
        let material = scene.materials[scene.instances[0].material].clone();
        let mesh = scene.meshes[scene.instances[0].mesh].clone();
        let slots = [material.base_color_texture.unwrap().set, material.normal_texture.unwrap().0.set];
        (slots, mesh, scene.report.notes.join("\n"))
    };
    let sorted = |uvs: &[Vec2]| {
        let mut uvs: Vec<[u32; 2]> = uvs.iter().map(|uv| [(uv.x * 10.0) as u32, (uv.y * 10.0) as u32]).collect();
        uvs.sort_unstable();
        uvs.dedup();
        uvs
    };
    let (slots, mesh, notes) = sets(0, json!({ "index": 0, "texCoord": 1 }));
    assert_eq!((slots, notes.as_str()), ([1, 0], ""));
    assert_eq!((sorted(&mesh.uvs), sorted(mesh.uv_set(1))), (sorted(&first), sorted(&second)));
    assert_eq!((mesh.more_uvs.len(), mesh.uv_set(1).len()), (1, mesh.positions.len()));
    // u grows along +x in the first set; in the second one along -y, so that tangents differ.
    assert!(mesh.tangents.iter().all(|t| t.x > 0.99), "{:?}", mesh.tangents);
    // KHR_texture_transform may name the set.
    let moved = json!({ "index": 0, "texCoord": 1, "extensions": { "KHR_texture_transform": { "texCoord": 0 } } });
    let (slots, mesh, _) = sets(1, moved);
    assert_eq!(slots, [1, 0]);
    assert_eq!((sorted(&mesh.uvs), sorted(mesh.uv_set(1))), (sorted(&second), sorted(&first)));
    assert!(mesh.tangents.iter().all(|t| t.y < -0.99), "{:?}", mesh.tangents);
    // One set alone is all that is kept.
    let (slots, mesh, _) = sets(1, json!({ "index": 0, "texCoord": 1 }));
    assert_eq!((slots, mesh.more_uvs.len(), sorted(&mesh.uvs)), ([0, 0], 0, sorted(&second)));
    let (_, mesh, notes) = sets(0, json!({ "index": 0, "texCoord": 3 }));
    assert!(notes.contains("1 sets of texture coordinates that materials ask for are not there"), "{notes}");
    assert!(mesh.uv_set(1).is_empty());
}

/// Tangents that a file lacks are those of the coordinates that the normal map is looked up with; those that it has stay.
#[test]
fn a_turned_normal_map_turns_the_tangents_that_are_made() {
    let turned = json!({ "index": 0, "extensions": { "KHR_texture_transform": { "rotation": std::f32::consts::FRAC_PI_2 } } });
    let mut file = with_material(json!({ "normalTexture": turned }), &[&UNEVEN]);
    // The look-up is at (v, -u): its u grows where v does, along +y.
    let scene = File::new(&file).load().unwrap();
    let mesh = &scene.meshes[scene.instances[0].mesh];
    assert!(!mesh.tangents.is_empty() && mesh.tangents.iter().all(|t| t.y > 0.99), "{:?}", mesh.tangents);

    let vertices = [
        (FLOAT, "VEC3", 4, false, bytes(&STRIP)),
        (FLOAT, "VEC2", 4, false, bytes(&[0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 1.0])),
        (FLOAT, "VEC3", 4, false, bytes(&[0.0, 0.0, 1.0].repeat(4))),
        (FLOAT, "VEC4", 4, false, bytes(&[1.0, 0.0, 0.0, 1.0].repeat(4))),
    ];
    let with_tangents = document(&vertices);
    for part in ["buffers", "bufferViews", "accessors"] {
        file[part] = with_tangents[part].clone();
    }
    file["meshes"][0]["primitives"][0]["attributes"] = json!({ "POSITION": 0, "TEXCOORD_0": 1, "NORMAL": 2, "TANGENT": 3 });
    let scene = File::new(&file).load().unwrap();
    let mesh = &scene.meshes[scene.instances[0].mesh];
    assert!(!mesh.tangents.is_empty() && mesh.tangents.iter().all(|t| t.x > 0.99), "{:?}", mesh.tangents);
}
