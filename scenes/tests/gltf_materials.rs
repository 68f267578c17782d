//! Materials of glTF: emission, alpha, sides, and the extensions that Burley's parameters can express.

mod common;

use common::anywhere;
use common::gltf::{FLOAT, File, STRIP, bytes, document, png};
use common::{asset, grey, model_scene};
use renderflow_scenes::loaded::{AlphaMask, Encoding};
use renderflow_scenes::mipmap::Texels;
use renderflow_scenes::{LoadReport, LoadedScene, Material, Principled, load};
use serde_json::{Value, json};

/// A square with texture coordinates, the given material, and textures of images with these pixels.
fn with_material(material: Value, images: &[&[[u8; 4]]]) -> Value {
    let mut file = document(&[
        (FLOAT, "VEC3", 4, false, bytes(&STRIP)),
        (FLOAT, "VEC2", 4, false, bytes(&[0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 1.0])),
    ]);
    file["meshes"][0]["primitives"][0] = json!({ "mode": 5, "material": 0, "attributes": { "POSITION": 0, "TEXCOORD_0": 1 } });
    if !images.is_empty() {
        file["images"] = images.iter().map(|pixels| json!({ "uri": png(pixels) })).collect();
        file["textures"] = (0..images.len()).map(|i| json!({ "source": i })).collect();
    }
    file["materials"] = json!([material]);
    if let Some(extensions) = file["materials"][0].get("extensions") {
        let names: Vec<String> = extensions.as_object().unwrap().keys().cloned().collect();
        file["extensionsUsed"] = json!(names);
    }
    file
}

fn read(material: Value, images: &[&[[u8; 4]]]) -> (Material, LoadReport, LoadedScene) {
    let scene = File::new(&with_material(material, images)).load().unwrap();
    (scene.materials[scene.instances[0].material].clone(), scene.report.clone(), scene)
}

const OPAQUE: [[u8; 4]; 2] = [[10, 20, 30, 255], [40, 50, 60, 255]];
const HOLES: [[u8; 4]; 2] = [[10, 20, 30, 255], [40, 50, 60, 100]];

#[test]
fn emission_is_factor_times_texture_times_strength() {
    let (material, report, scene) = read(
        json!({
            "emissiveFactor": [1.0, 0.5, 0.25],
            "emissiveTexture": { "index": 0 },
            "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 }, "metallicRoughnessTexture": { "index": 0 } },
            "extensions": { "KHR_materials_emissive_strength": { "emissiveStrength": 8 } }
        }),
        &[&OPAQUE],
    );
    assert_eq!(material.emissive, [8.0, 4.0, 2.0]);
    // Colour and emission are one texture, decoded from sRGB; data is another.
    let slots = [&material.base_color_texture, &material.emissive_texture, &material.metallic_roughness_texture];
    let [color, light, data] = slots.map(|s| s.as_ref().unwrap().texture);
    assert_eq!((color == light, scene.textures.len()), (true, 2));
    assert_eq!((scene.textures[color].encoding, scene.textures[data].encoding), (Encoding::Srgb, Encoding::Linear));
    assert_eq!(report.notes, [""; 0]);
    let (dark, ..) = read(json!({ "emissiveTexture": { "index": 0 } }), &[&OPAQUE]);
    assert_eq!(dark.emissive, [0.0; 3]);
    let (limited, report, _) = read(
        json!({ "emissiveFactor": [1, 0, 0], "extensions": { "KHR_materials_emissive_strength": { "emissiveStrength": 1e30 } } }),
        &[],
    );
    assert_eq!((limited.emissive, report.notes.len()), ([1e9, 0.0, 0.0], 1));
}

/// The textures of a second model come behind those of the first.
#[test]
fn textures_of_several_models_keep_apart() {
    let glowing = |pixels: &[[u8; 4]]| {
        File::new(&with_material(json!({ "emissiveFactor": [1, 1, 1], "emissiveTexture": { "index": 0 } }), &[pixels]))
    };
    let files = [glowing(&OPAQUE), glowing(&HOLES)];
    let mut scene = model_scene(&files[0].path(), None);
    let second = model_scene(&files[1].path(), None).objects.remove(0);
    scene.objects.push(renderflow_scenes::description::Object { name: "second".into(), ..second });
    let loaded = load::load(&scene, &anywhere()).unwrap();
    for (instance, pixels) in loaded.instances.iter().zip([OPAQUE, HOLES]) {
        let slot = loaded.materials[instance.material].emissive_texture.as_ref().unwrap();
        assert_eq!(loaded.textures[slot.texture].levels[0].texels, Texels::Bytes(pixels.to_vec()));
    }
}

/// Two objects may write the name of one file differently: the second has the file's material, which the first does not ask for.
#[test]
fn a_file_may_be_named_in_two_ways() {
    let file = File::new(&with_material(json!({ "emissiveFactor": [1, 0.5, 0] }), &[]));
    let path = file.path();
    let other = path.parent().unwrap().join(".").join(path.file_name().unwrap());
    let mut scene = model_scene(&path, Some(grey("grey")));
    let second = model_scene(&other, None).objects.remove(0);
    scene.objects.push(renderflow_scenes::description::Object { name: "second".into(), ..second });
    assert_ne!(scene.objects[0].geometry, scene.objects[1].geometry);
    let loaded = load::load(&scene, &anywhere()).unwrap();
    let emissive = [0, 1].map(|i| loaded.materials[loaded.instances[i].material].emissive);
    assert_eq!(emissive, [[0.0; 3], [1.0, 0.5, 0.0]]);
}

/// glTF 2.0, section 3.9.4: OPAQUE ignores alpha, MASK compares factor times texture with the cutoff (0.5 when absent).
#[test]
fn alpha_modes() {
    let read = |mode: &str, cutoff: Option<f32>, factor: f32, image: &[[u8; 4]]| {
        let mut material = json!({
            "alphaMode": mode,
            "pbrMetallicRoughness": { "baseColorFactor": [1, 1, 1, factor], "baseColorTexture": { "index": 0 } }
        });
        if let Some(cutoff) = cutoff {
            material["alphaCutoff"] = json!(cutoff);
        }
        let (material, report, _) = read(material, &[image]);
        (material.alpha_mask, report.alpha_masked, report.blended)
    };
    assert_eq!(read("OPAQUE", None, 0.1, &HOLES), (None, 0, 0));
    assert_eq!(read("BLEND", None, 0.1, &HOLES), (None, 0, 1));
    assert_eq!(read("MASK", None, 1.0, &HOLES), (Some(AlphaMask { cutoff: 0.5, factor: 1.0 }), 1, 0));
    assert_eq!(read("MASK", Some(0.75), 0.875, &HOLES), (Some(AlphaMask { cutoff: 0.75, factor: 0.875 }), 1, 0));
    // A mask that cuts nothing is none: 100/255 is above 0.25; an image without holes.
    assert_eq!(read("MASK", Some(0.25), 1.0, &HOLES), (None, 0, 0));
    assert_eq!(read("MASK", None, 1.0, &OPAQUE), (None, 0, 0));
    // A factor below the cutoff hides everything.
    assert_eq!(read("MASK", None, 0.25, &OPAQUE), (Some(AlphaMask { cutoff: 0.5, factor: 0.25 }), 1, 0));
    // BLEND covers the share that factor times texture says.
    let blended = |factor: f32, image: &[[u8; 4]]| {
        let material = json!({
            "alphaMode": "BLEND",
            "pbrMetallicRoughness": { "baseColorFactor": [1, 1, 1, factor], "baseColorTexture": { "index": 0 } }
        });
        let (material, report, _) = self::read(material, &[image]);
        (material.opacity, report.blended)
    };
    assert_eq!(blended(0.25, &OPAQUE), (Some(0.25), 1));
    assert_eq!(blended(1.0, &HOLES), (Some(1.0), 1));
    // What covers everything is opaque.
    assert_eq!(blended(1.0, &OPAQUE), (None, 0));
    // More than 1 hides everything, too (section 3.9.4), and needs no texture.
    let (material, ..) = self::read(json!({ "alphaMode": "MASK", "alphaCutoff": 1.5 }), &[]);
    assert_eq!(material.alpha_mask, Some(AlphaMask { cutoff: 1.5, factor: 1.0 }));
}

/// Opacity in the colours of vertices counts (glTF 2.0, section 3.9.2: they multiply the base colour, alpha included), for the
/// materials that are on such a mesh.
#[test]
fn opacity_of_vertices_is_kept() {
    let read = |mode: &str, alphas: [f32; 4], factor: f32| {
        let colors: Vec<f32> = alphas.iter().flat_map(|&alpha| [1.0, 1.0, 1.0, alpha]).collect();
        let mut file = document(&[(FLOAT, "VEC3", 4, false, bytes(&STRIP)), (FLOAT, "VEC4", 4, false, bytes(&colors))]);
        let square = |material: usize, attributes: Value| json!({ "mode": 5, "material": material, "attributes": attributes });
        file["meshes"][0]["primitives"] =
            json!([square(0, json!({ "POSITION": 0, "COLOR_0": 1 })), square(1, json!({ "POSITION": 0 }))]);
        let material = json!({ "alphaMode": mode, "pbrMetallicRoughness": { "baseColorFactor": [1, 1, 1, factor] } });
        file["materials"] = json!([material, material]);
        let scene = File::new(&file).load().unwrap();
        let [with, without] = [0, 1].map(|i| scene.materials[scene.instances[i].material].clone());
        assert_eq!((without.alpha_mask, without.opacity), (None, None), "no colours, no holes");
        (with.alpha_mask, with.opacity, scene.report.alpha_masked, scene.report.blended)
    };
    assert_eq!(read("BLEND", [0.3; 4], 1.0), (None, Some(1.0), 0, 1));
    assert_eq!(read("MASK", [0.3; 4], 1.0), (Some(AlphaMask { cutoff: 0.5, factor: 1.0 }), None, 1, 0));
    // The least of them decides.
    assert_eq!(read("BLEND", [1.0, 1.0, 0.9, 1.0], 1.0), (None, Some(1.0), 0, 1));
    assert_eq!(read("MASK", [1.0, 0.7, 1.0, 1.0], 0.75).0, None);
    assert_eq!(read("MASK", [1.0, 0.6, 1.0, 1.0], 0.75).0, Some(AlphaMask { cutoff: 0.5, factor: 0.75 }));
    assert_eq!(read("BLEND", [1.0; 4], 1.0), (None, None, 0, 0));
    assert_eq!(read("OPAQUE", [0.3; 4], 1.0), (None, None, 0, 0));
}

/// What is transparent takes the colour of what covers beside it, in the texture that holes are seen in and nowhere else.
#[test]
fn colours_in_holes_are_not_mixed_in() {
    let pixels = [[200, 100, 50, 255], [0, 0, 0, 0]];
    let filled = Texels::Bytes(vec![[200, 100, 50, 255], [200, 100, 50, 0]]);
    let texture = |scene: &LoadedScene, slot: &Option<renderflow_scenes::TextureSlot>| {
        scene.textures[slot.as_ref().unwrap().texture].levels.iter().map(|level| level.texels.clone()).collect::<Vec<_>>()
    };
    for mode in ["MASK", "BLEND"] {
        let mut described = json!({ "alphaMode": mode, "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } });
        let (material, _, scene) = read(described.clone(), &[&pixels]);
        let levels = texture(&scene, &material.base_color_texture);
        assert_eq!(
            (&levels, scene.textures.len()),
            (&vec![filled.clone(), Texels::Bytes(vec![[200, 100, 50, 128]])], 1),
            "{mode}"
        );
        // Light of the same image that lies alike has the same holes; light that lies otherwise is seen where they are not.
        described["emissiveFactor"] = json!([1, 1, 1]);
        described["emissiveTexture"] = json!({ "index": 0 });
        let (material, _, scene) = read(described.clone(), &[&pixels]);
        assert_eq!((&material.emissive_texture, scene.textures.len()), (&material.base_color_texture, 1), "{mode}");
        assert_eq!(texture(&scene, &material.emissive_texture), levels, "{mode}");
        described["emissiveTexture"]["extensions"] = json!({ "KHR_texture_transform": { "offset": [0.5, 0] } });
        let (material, _, scene) = read(described, &[&pixels]);
        assert_eq!((texture(&scene, &material.base_color_texture), scene.textures.len()), (levels, 2), "{mode}");
        assert_eq!(texture(&scene, &material.emissive_texture)[0], Texels::Bytes(pixels.to_vec()), "{mode}");
    }
    // What is opaque has none.
    let opaque = json!({ "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } });
    let (material, _, scene) = read(opaque, &[&pixels]);
    assert_eq!(texture(&scene, &material.base_color_texture)[0], Texels::Bytes(pixels.to_vec()));
}

#[test]
fn alpha_of_the_image_is_kept() {
    let color = json!({ "alphaMode": "MASK", "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } });
    let (material, _, scene) = read(color, &[&HOLES]);
    let texture = &scene.textures[material.base_color_texture.unwrap().texture];
    assert_eq!(texture.levels[0].texels, Texels::Bytes(HOLES.to_vec()));
}

#[test]
fn sides_are_the_files() {
    for (material, double_sided) in [(json!({}), false), (json!({ "doubleSided": true }), true)] {
        assert_eq!(read(material, &[]).0.double_sided, double_sided);
    }
    // Without a material, glTF's default one: single-sided, metal of roughness 1 (section 3.9).
    let mut file = with_material(json!({}), &[]);
    file["meshes"][0]["primitives"][0].as_object_mut().unwrap().remove("material");
    let scene = File::new(&file).load().unwrap();
    let material = &scene.materials[scene.instances[0].material];
    assert_eq!((material.double_sided, material.surface.metallic, material.surface.roughness), (false, 1.0, 1.0));
}

#[test]
fn extensions_become_burleys_parameters() {
    let extended = |name: &str, value: Value| {
        let (material, report, _) = read(json!({ "name": "m", "extensions": { name: value } }), &[]);
        (material, report.notes.join("\n"))
    };
    // Roughness 0.2 is a width of 0.04 = mix(0.1, 0.001, gloss).
    let (coat, notes) = extended("KHR_materials_clearcoat", json!({ "clearcoatFactor": 0.75, "clearcoatRoughnessFactor": 0.2 }));
    assert_eq!(coat.surface.clearcoat, 0.75);
    let width = |gloss: f32| 0.1 + (0.001 - 0.1) * gloss;
    assert!((width(coat.surface.clearcoat_gloss) - 0.04).abs() < 1e-6);
    assert!(notes.contains("a quarter"), "{notes}");
    let (satin, notes) = extended(
        "KHR_materials_clearcoat",
        json!({ "clearcoatFactor": 1, "clearcoatRoughnessFactor": 0.8, "clearcoatTexture": { "index": 0 } }),
    );
    assert_eq!(satin.surface.clearcoat_gloss, 0.0);
    assert!(notes.contains("smoother") && notes.contains("/textures/0 is not used: it does not exist"), "{notes}");
    assert_eq!(extended("KHR_materials_clearcoat", json!({})), (Material { name: "m".into(), ..says_nothing() }, String::new()));

    let (cloth, notes) =
        extended("KHR_materials_sheen", json!({ "sheenColorFactor": [0.2, 0.6, 0.4], "sheenRoughnessFactor": 0.3 }));
    assert_eq!((cloth.surface.sheen, cloth.surface.sheen_tint), (0.6, 1.0));
    assert!(notes.contains("Burley's lobe in the base colour's hue"), "{notes}");
    assert_eq!(extended("KHR_materials_sheen", json!({ "sheenColorFactor": [0.5, 0.5, 0.5] })).0.surface.sheen_tint, 0.0);

    let (brushed, notes) = extended("KHR_materials_anisotropy", json!({ "anisotropyStrength": 0.8 }));
    assert_eq!((brushed.surface.anisotropic, notes.as_str()), (0.8, ""));
    let turned = json!({ "anisotropyStrength": 0.8, "anisotropyRotation": 1.5 });
    let (turned, notes) = extended("KHR_materials_anisotropy", turned);
    assert_eq!((turned.surface.anisotropic, turned.anisotropy_rotation, notes.as_str()), (0.8, 1.5, ""));

    assert!(extended("KHR_materials_iridescence", json!({})).1.contains("KHR_materials_iridescence is not read"));
    // Required extensions that are read are no reason to refuse a file.
    let mut file = with_material(json!({ "extensions": { "KHR_materials_sheen": {} } }), &[]);
    file["extensionsRequired"] = json!(["KHR_materials_sheen"]);
    assert!(File::new(&file).load().is_ok());
}

/// A glTF material that says nothing.
fn says_nothing() -> Material {
    Material {
        double_sided: false,
        surface: Principled { base_color: glam::Vec3A::ONE, metallic: 1.0, roughness: 1.0, ..Principled::default() },
        ..Material::default()
    }
}

/// KHR_materials_specular multiplies F0 = 0.04 with its colour; Burley's is 0.08 specular mix(1, base / luminance, tint).
#[test]
fn a_tint_of_the_base_colours_hue_is_specular_tint() {
    let tinted = |base: [f32; 3], color: [f32; 3]| {
        let material = json!({
            "pbrMetallicRoughness": { "baseColorFactor": [base[0], base[1], base[2], 1] },
            "extensions": { "KHR_materials_specular": { "specularColorFactor": color } }
        });
        let (material, report, _) = read(material, &[]);
        (material, report.notes.len())
    };
    let base = [0.8, 0.4, 0.2];
    let luminance = 0.2126 * 0.8 + 0.7152 * 0.4 + 0.0722 * 0.2;
    for share in [1.0, 0.5, 0.25] {
        let color = base.map(|v| 0.5 * (1.0 + share * (v / luminance - 1.0)));
        let (material, notes) = tinted(base, color);
        assert_eq!(notes, 0);
        for (v, c) in base.iter().zip(color) {
            let f0 = 0.08 * material.surface.specular * (1.0 + material.surface.specular_tint * (v / luminance - 1.0));
            assert!((f0 - 0.04 * c).abs() < 1e-5, "{share}: {f0} but {}", 0.04 * c);
        }
    }
    let (other, notes) = tinted(base, [0.2, 0.4, 0.8]);
    assert_eq!((other.surface.specular_tint, notes), (0.0, 1));
    assert_eq!(tinted([0.5; 3], [0.2, 0.4, 0.8]).1, 1);
    assert_eq!(tinted([0.0; 3], [0.2, 0.4, 0.8]).1, 1);
}

/// A stretched highlight follows the tangents, so the mesh gets them: growing u is +x here.
#[test]
fn anisotropy_asks_for_tangents() {
    let material = json!({ "extensions": { "KHR_materials_anisotropy": { "anisotropyStrength": 0.5 } } });
    let (.., scene) = read(material.clone(), &[]);
    let mesh = &scene.meshes[0];
    assert!(!mesh.tangents.is_empty() && mesh.tangents.iter().all(|t| t.x > 0.999));
    let mut file = with_material(material, &[]);
    file["meshes"][0]["primitives"][0]["attributes"].as_object_mut().unwrap().remove("TEXCOORD_0");
    let scene = File::new(&file).load().unwrap();
    assert!(scene.report.notes[0].contains("the anisotropy of") && scene.meshes[0].tangents.is_empty());
}

/// Numbers out of their ranges, in files that say so: limited, never NaN.
#[test]
fn wild_numbers_are_limited() {
    let (material, ..) = read(
        json!({
            "alphaMode": "MASK",
            "emissiveFactor": [-1, 1e30, 2],
            "pbrMetallicRoughness": { "baseColorFactor": [7, -7, 1e30, 9], "metallicFactor": 5, "roughnessFactor": -5 },
            "extensions": {
                "KHR_materials_clearcoat": { "clearcoatFactor": 9, "clearcoatRoughnessFactor": -9 },
                "KHR_materials_sheen": { "sheenColorFactor": [9, "x", null] },
                "KHR_materials_anisotropy": { "anisotropyStrength": 1e300, "anisotropyRotation": "east" },
                "KHR_materials_emissive_strength": { "emissiveStrength": 1e30 },
                "KHR_materials_ior": { "ior": -1 }
            }
        }),
        &[],
    );
    assert_eq!(material.surface.out_of_range(), None, "{material:?}");
    assert_eq!(material.emissive, [0.0, 1e9, 1e9]);
}

/// Real files: the emissive map of the Boom Box, sides and masks as their JSON says.
#[test]
fn real_files_keep_what_they_say() {
    for folder in ["BoomBoxWithAxes", "TwoSidedPlane", "Avocado", "Suzanne"] {
        let Some(path) = asset(&format!("gltf/pbr/{folder}/{folder}.gltf")) else { return };
        let stated: Value = serde_json::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap();
        let scene = load::load(&model_scene(&path, None), &anywhere()).unwrap();
        assert_eq!(scene.report.triangles.dropped(), 0, "{folder}: {:?}", scene.report.triangles);
        for material in stated["materials"].as_array().unwrap() {
            let Some(name) = material["name"].as_str() else { continue };
            let Some(read) = scene.materials.iter().find(|m| m.name == name) else { continue };
            assert_eq!(read.double_sided, material["doubleSided"] == true, "{folder}/{name}");
            assert_eq!(read.emissive_texture.is_some(), material.get("emissiveTexture").is_some(), "{folder}/{name}");
            assert_eq!(read.alpha_mask.is_some(), material["alphaMode"] == "MASK", "{folder}/{name}");
        }
    }
}

/// KHR_materials_transmission without a volume is a sheet, with one a body that absorbs: color = exp(-absorption distance).
#[test]
fn glass_is_read() {
    let read = |extensions: Value| read(json!({ "extensions": extensions }), &[&OPAQUE]);
    let (pane, report, _) = read(json!({ "KHR_materials_transmission": { "transmissionFactor": 0.75 } }));
    assert_eq!((pane.surface.transmission, pane.thin_walled, pane.absorption), (0.75, true, [0.0; 3]));
    assert!(report.notes.is_empty(), "{:?}", report.notes);
    let (glass, ..) = read(json!({
        "KHR_materials_transmission": { "transmissionFactor": 1, "transmissionTexture": { "index": 0 } },
        "KHR_materials_volume": { "thicknessFactor": 0.1, "attenuationDistance": 2, "attenuationColor": [1, 0.5, 0] },
        "KHR_materials_ior": { "ior": 1.33 }
    }));
    assert_eq!((glass.surface.transmission, glass.thin_walled), (1.0, false));
    assert!(glass.transmission_texture.is_some());
    // 2 m leave a half; nothing at all would be an infinite absorption.
    let expected = [0.0, 0.5 * std::f32::consts::LN_2, 0.5 * 1e6_f32.ln()];
    assert!(glass.absorption.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-5), "{:?}", glass.absorption);
    assert!((glass.surface.specular - (0.33_f32 / 2.33).powi(2) / 0.08).abs() < 1e-5);
    // A thickness of zero is a sheet; values that make no sense are not used.
    for (volume, thin) in [
        (json!({ "thicknessFactor": 0, "attenuationDistance": 1, "attenuationColor": [0, 0, 0] }), true),
        (json!({ "thicknessFactor": 1, "attenuationDistance": -1, "attenuationColor": [0, 0, 0] }), false),
        (json!({ "thicknessFactor": 1, "attenuationDistance": 0, "attenuationColor": "red" }), false),
        (json!({ "thicknessFactor": "thick" }), true),
        (json!(7), true),
    ] {
        let (odd, ..) =
            read(json!({ "KHR_materials_transmission": { "transmissionFactor": 9 }, "KHR_materials_volume": volume }));
        assert_eq!((odd.surface.transmission, odd.thin_walled, odd.absorption), (1.0, thin, [0.0; 3]), "{volume}");
    }
    let (odd, ..) =
        read(json!({ "KHR_materials_transmission": { "transmissionFactor": 1, "transmissionTexture": { "index": 99 } } }));
    assert!(odd.transmission_texture.is_none());
}

/// A pyramid of glass without a thickness is thin-walled by the rules of glTF and looks hollow: one note says so.
#[test]
fn closed_glass_without_a_thickness_is_told() {
    let load = |indices: &[u8], volume: bool| {
        let corners = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
        let mut file =
            document(&[(FLOAT, "VEC3", 4, false, bytes(&corners)), (5121, "SCALAR", indices.len(), false, indices.to_vec())]);
        file["meshes"][0]["primitives"][0] = json!({ "mode": 4, "material": 0, "indices": 1, "attributes": { "POSITION": 0 } });
        let mut extensions = json!({ "KHR_materials_transmission": { "transmissionFactor": 1 } });
        if volume {
            extensions["KHR_materials_volume"] = json!({ "thicknessFactor": 0.1 });
        }
        file["materials"] = json!([{ "name": "Ball", "extensions": extensions }]);
        file["extensionsUsed"] = json!(["KHR_materials_transmission", "KHR_materials_volume"]);
        File::new(&file).load().unwrap().report.notes
    };
    const CLOSED: [u8; 12] = [0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3];
    let notes = load(&CLOSED, false);
    assert_eq!(notes.len(), 1, "{notes:?}");
    let parts = ["looks hollow", "\"Ball\"", "KHR_materials_volume", "--set objects/0/material=solid", "materials/-={"];
    assert!(parts.iter().all(|part| notes[0].contains(part)), "{notes:?}");
    assert_eq!(load(&CLOSED, true), [""; 0]);
    // An open one is a sheet.
    assert_eq!(load(&CLOSED[..9], false), [""; 0]);
}

/// The same of a scene's own material; a plate as flat as a pane is one.
#[test]
fn closed_shapes_with_thin_walls_are_told() {
    let notes = |shape: Value, thin_walled: bool| {
        let scene = json!({
            "version": 1, "name": "bubble", "resolution": [4, 4],
            "camera": { "type": "poses", "poses": [{ "eye": [0, 0, 4], "target": [0, 0, 0] }], "vertical_fov": 40 },
            "environment": { "source": { "constant": [1, 1, 1] } },
            "materials": [{ "name": "grey" }, { "name": "soap", "transmission": 1, "thin_walled": thin_walled }],
            "objects": [{ "name": "bubble", "geometry": { "shape": shape }, "material": "soap" }]
        });
        let scene = renderflow_scenes::Scene::from_json(std::path::Path::new("scene.json"), &scene.to_string()).unwrap();
        load::load(&scene, &anywhere()).unwrap().report.notes
    };
    let ball = notes(json!({ "family": "sphere", "radius": 1 }), true);
    assert!(ball.len() == 1 && ball[0].contains("bubble") && ball[0].contains("--set materials/1/thin_walled=false"), "{ball:?}");
    assert_eq!(notes(json!({ "family": "sphere", "radius": 1 }), false), [""; 0]);
    assert_eq!(notes(json!({ "family": "box", "size": [1, 1, 0.03] }), true), [""; 0]);
    assert_eq!(notes(json!({ "family": "plane", "size": 1 }), true), [""; 0]);
}
