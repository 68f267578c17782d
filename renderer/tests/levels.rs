//! The picture does not depend on what the processor can do: other instructions, the same bits.

mod common;

use glam::{Affine3A, Vec3, Vec3A};
use renderflow_renderer::Settings;
use renderflow_scenes::{Material, Principled};
use std::fmt::Write;
use std::process::Command;

/// Set for the process that renders, with the level to render on in `RENDERFLOW_SIMD`.
const RENDERS: &str = "RENDERFLOW_TEST_LEVEL";

/// Hashes of pictures of a scene of plain materials and of one with every layer.
fn pictures() -> String {
    let layered = Material::from(Principled {
        base_color: Vec3A::from_array([0.7, 0.4, 0.2]),
        roughness: 0.4,
        sheen: 0.5,
        clearcoat: 0.6,
        clearcoat_gloss: 0.7,
        subsurface: 0.4,
        specular_tint: 0.5,
        ..Principled::default()
    });
    let metal = Material::from(Principled { metallic: 1.0, roughness: 0.15, ..Principled::default() });
    let mut hashes = String::new();
    for material in [metal, layered] {
        let parts = vec![
            (common::plane(6.0), common::diffuse([0.6, 0.5, 0.4]), Affine3A::IDENTITY),
            (common::sphere(24, true), material, Affine3A::from_translation(Vec3::new(-0.8, 1.0, 0.0))),
            (common::sphere(12, false), Material::default(), Affine3A::from_translation(Vec3::new(1.4, 1.0, 0.3))),
        ];
        let camera = common::camera([0.0, 2.0, 6.0], [0.0, 0.8, 0.0], 40.0, 40, 32);
        let scene = common::compile(&common::scene(parts, common::sunny(), camera));
        let (frame, _) = common::render_with(&scene, &Settings { spp: 40, ..Settings::default() });
        let raw = frame.raw.expect("a beauty was rendered");
        let bytes: Vec<u8> = raw.pixels.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
        let _ = write!(hashes, "{} ", blake3::hash(&bytes).to_hex());
    }
    hashes
}

#[test]
fn every_level_gives_the_same_picture() {
    if std::env::var_os(RENDERS).is_some() {
        println!("pictures: {}", pictures());
        return;
    }
    let expected = format!("pictures: {}", pictures());
    // The level is chosen once a process. One that the processor lacks is replaced by its best.
    for level in ["portable", "avx2", "avx512"] {
        let output = Command::new(std::env::current_exe().expect("this test's path"))
            .args(["--exact", "every_level_gives_the_same_picture", "--nocapture"])
            .env(RENDERS, "1")
            .env("RENDERFLOW_SIMD", level)
            .output()
            .expect("this test again");
        let text = String::from_utf8_lossy(&output.stdout);
        assert!(output.status.success() && text.contains(&expected), "{level}: {text} in place of {expected}");
    }
}
