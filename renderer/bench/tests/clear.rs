//! Clear and blended materials as other renderers are given them, and `renderflow-bench agree` with scripts that stand in for
//! them.

mod common;

use common::{bench, stderr, succeed};
use renderflow_bench::export::{self, Exported, ExportedObject};
use renderflow_bench::scenes;
use renderflow_frame::file;
use renderflow_scenes::loaded::{Encoding, Wrap};
use renderflow_scenes::{Material, Texture, TextureSlot};
use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

fn exported(name: &str) -> BTreeMap<String, ExportedObject> {
    let folder = tempfile::tempdir().unwrap();
    let loaded = scenes::open(name, Some(16), &[]).unwrap().loaded;
    let path = export::write(&loaded, 6, folder.path()).unwrap();
    let exported: Exported = file::read_json(&path).unwrap();
    for texture in exported.objects.iter().flat_map(|object| object.material.textures.values()) {
        assert!(folder.path().join(&texture.file).is_file(), "{texture:?}");
    }
    exported.objects.into_iter().map(|object| (object.name.clone(), object)).collect()
}

#[test]
fn clear_materials_are_exported() {
    let tinted = exported("tinted_glass");
    let amber = tinted["amber"].material.clear.as_ref().unwrap();
    assert_eq!((amber.form.as_str(), amber.share, amber.alpha), ("body", 1.0, 1e-3));
    // A reflectance of 0.04 is an index of 1.5; 0.8 m leave the colour [0.9, 0.5, 0.1].
    assert!((amber.ior - 1.5).abs() < 1e-6, "{amber:?}");
    for (absorption, color) in amber.absorption.iter().zip([0.9_f32, 0.5, 0.1]) {
        assert!((absorption + color.ln() / 0.8).abs() < 1e-5, "{amber:?}");
    }
    // 0.35 * 0.08 = 0.028 = (0.167332 / 1)^2.
    let bottle = &tinted["bottle"].material;
    assert!((bottle.clear.as_ref().unwrap().ior - 1.167_332 / 0.832_668).abs() < 1e-5 && bottle.base_color == [0.6, 0.9, 0.7]);
    assert_eq!((&tinted["floor"].material.clear, tinted["floor"].material.lambertian), (&None, true));
    let rough = exported("rough_glass").remove("rough").unwrap().material.clear.unwrap();
    assert!((rough.alpha - 0.01).abs() < 1e-6 && rough.absorption == [0.0; 3], "{rough:?}");
    let panes = exported("pane");
    assert_eq!(panes["stained"].material.clear.as_ref().unwrap().form, "pane");
    let cards = exported("leaf_cards");
    assert_eq!(cards["gauze"].material.opacity, Some(0.4));
    assert!(
        cards["card_0"].material.textures.contains_key("opacity") && !cards["gauze"].material.textures.contains_key("opacity")
    );
    let partly = exported("partly_clear");
    assert!((partly["milky"].material.clear.as_ref().unwrap().share - 0.6).abs() < 1e-6);
    let faded = exported("faded_glass");
    assert_eq!(faded["faded"].material.opacity, Some(0.5));
    // Light that passes the glass shows every back.
    assert!(faded.values().all(|object| object.seen_from_behind));
}

/// The share that covers is alpha times opacity, and the share that is clear is the texture's red times transmission.
#[test]
fn textures_of_shares_hold_the_factors() {
    let folder = tempfile::tempdir().unwrap();
    let mut loaded = scenes::open("glass_ball", Some(16), &[]).unwrap().loaded;
    let of = |name: &str| loaded.instances.iter().find(|i| i.name == name).unwrap().material;
    let glass = of("glass");
    let texels = vec![[100, 255, 255, 200], [200, 0, 0, 0]];
    // The alpha of a colour is linear, whatever its encoding is.
    for encoding in [Encoding::Srgb, Encoding::Linear] {
        loaded.textures.push(Texture::from_rgba8("two", [2, 1], texels.clone(), encoding, [Wrap::Clamp; 2]));
    }
    let slot = |back: usize| Some(TextureSlot { texture: loaded.textures.len() - back, uv_transform: glam::Affine2::IDENTITY });
    let (base_color_texture, transmission_texture) = (slot(2), slot(1));
    let material = &mut loaded.materials[glass];
    (material.base_color_texture, material.transmission_texture) = (base_color_texture, transmission_texture);
    material.opacity = Some(0.5);
    material.surface.transmission = 0.5;
    let path = export::write(&loaded, 6, folder.path()).unwrap();
    let exported: Exported = file::read_json(&path).unwrap();
    let textures = &exported.objects.iter().find(|o| o.name == "glass").unwrap().material.textures;
    for (name, values) in [("opacity", [200.0, 0.0]), ("transmission", [100.0, 200.0])] {
        let read = image::open(folder.path().join(&textures[name].file)).unwrap().into_luma16();
        for (pixel, value) in read.pixels().zip(values) {
            assert!((f64::from(pixel.0[0]) / 65535.0 - 0.5 * value / 255.0).abs() < 1e-4, "{name}: {pixel:?} for {value}");
        }
    }

    // What cannot be written is refused by name.
    let refused = |change: &dyn Fn(&mut Material)| {
        let mut other = loaded.clone();
        change(&mut other.materials[glass]);
        format!("{:#}", export::write(&other, 6, folder.path()).unwrap_err())
    };
    let error = refused(&|m| m.metallic_roughness_texture = m.base_color_texture.clone());
    assert!(error.contains("material glass") && error.contains("metallic and roughness"), "{error}");
    let error = refused(&|m| {
        m.thin_walled = true;
        m.normal_texture = m.base_color_texture.clone().map(|slot| (slot, 1.0));
    });
    assert!(error.contains("material glass") && error.contains("a pane with a normal map"), "{error}");
}

/// A program in place of Python whose pictures are `value` everywhere; `load` is what it answers to a scene. `None`, with the
/// reason, where there is no Python.
fn stand_in(folder: &Path, value: f32, load: &str) -> Option<String> {
    if !Command::new("python3").arg("--version").output().is_ok_and(|o| o.status.success()) {
        eprintln!("skipped: no python3");
        return None;
    }
    let script = folder.join("stand_in.py");
    let text = format!(
        r#"
import array, json, sys
print(json.dumps({{"ready": {{"name": "stand-in", "version": "1.2.3"}}}}), flush=True)
for line in sys.stdin:
    command = json.loads(line)
    if "load" in command:
        print(json.dumps({load}), flush=True)
    else:
        array.array("f", [{value}] * (16 * 16 * 3)).tofile(open(command["render"]["file"], "wb"))
        print(json.dumps({{"wall": 1, "cpu": 1}}), flush=True)
"#
    );
    std::fs::write(&script, text).unwrap();
    let program = folder.join("python");
    std::fs::write(&program, format!("#!/bin/sh\nexec python3 {}\n", script.display())).unwrap();
    #[cfg(unix)]
    std::fs::set_permissions(&program, std::os::unix::fs::PermissionsExt::from_mode(0o755)).unwrap();
    Some(program.to_string_lossy().into_owned())
}

/// Under a sky of 0.5 that nothing hides, a picture of 0.5 agrees and one of 0.51 is 2 % brighter.
#[cfg(unix)]
#[test]
fn pictures_that_differ_fail_the_command() {
    for (value, agrees) in [(0.5, true), (0.51, false)] {
        let folder = tempfile::tempdir().unwrap();
        let Some(python) = stand_in(folder.path(), value, r#"{"loaded": True, "notes": ["stands in"]}"#) else { return };
        let scene = folder.path().join("empty.json");
        let text = r#"{"version": 1, "name": "empty", "resolution": [16, 16],
            "camera": {"type": "poses", "poses": [{"eye": [0, 0, 4], "target": [0, 0, 0]}], "vertical_fov": 40},
            "environment": {"source": {"constant": [0.5, 0.5, 0.5]}}, "objects": []}"#;
        std::fs::write(&scene, text).unwrap();
        let out = folder.path().join("out");
        let arguments = ["agree", "--threads", "2", "--resolution", "16", "--spp", "8", "--cycles-python", "/nowhere/python"];
        let named = ["--scene", scene.to_str().unwrap(), "--out", out.to_str().unwrap(), "--mitsuba-python", &python];
        let output = bench(&[&arguments[..], &named[..]].concat());
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        assert_eq!(output.status.success(), agrees, "{text}{}", stderr(&output));
        assert!(text.contains("skipped cycles") && text.contains("stands in"), "{text}");
        assert!(text.contains(if agrees { "0.000 %" } else { "2.000 %" }), "{text}");
        if !agrees {
            assert!(stderr(&output).contains("empty in mitsuba-multijitter"), "{}", stderr(&output));
        }
        let results: serde_json::Value = serde_json::from_slice(&std::fs::read(out.join("agree.json")).unwrap()).unwrap();
        assert!((results["rows"][0]["mean"].as_f64().unwrap() - (f64::from(value) / 0.5 - 1.0)).abs() < 1e-6, "{results}");
    }
}

#[cfg(unix)]
#[test]
fn a_renderer_without_a_counterpart_is_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let Some(python) = stand_in(folder.path(), 0.5, r#"{"error": "glass: rough sheets have no counterpart"}"#) else { return };
    let out = folder.path().join("out");
    let fixed = "agree --threads 2 --resolution 16 --spp 8 --scene glass_ball --cycles-python /nowhere/python";
    let named = ["--out", out.to_str().unwrap(), "--mitsuba-python", &python];
    let output = bench(&fixed.split(' ').chain(named).collect::<Vec<_>>());
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(text.contains("left out: glass_ball, mitsuba-multijitter: glass: rough sheets have no counterpart"), "{text}");
    assert!(!output.status.success() && stderr(&output).contains("nothing was compared"), "{}", stderr(&output));
}

#[test]
fn a_gallery_shows_the_models_that_can_be_read() {
    let folder = tempfile::tempdir().unwrap();
    let obj = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
    std::fs::create_dir(folder.path().join("deep")).unwrap();
    std::fs::write(folder.path().join("deep/triangle.obj"), obj).unwrap();
    std::fs::write(folder.path().join("broken.gltf"), "{").unwrap();
    let out = folder.path().join("sheet.png");
    let named = [folder.path().to_str().unwrap(), "--out", out.to_str().unwrap()];
    let text = succeed(&"gallery --size 16 --spp 1".split(' ').chain(named).collect::<Vec<_>>());
    assert!(text.contains("left out") && text.contains("broken.gltf") && text.contains("1 of 2 models"), "{text}");
    assert!(image::open(out).unwrap().width() >= 224);
}
