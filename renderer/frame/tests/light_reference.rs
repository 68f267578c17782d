//! Tables of real skies against values computed in NumPy and SciPy by `references/light_ibl.py`, which shares no code with this
//! crate.

use glam::Vec3A;
use renderflow_frame::environment::Environment;
use renderflow_frame::ibl::{IblTables, LEVELS, environment_brdf, exposure};
use renderflow_frame::image::Rgb;
use serde_json::Value;
use std::path::Path;

fn reference() -> Value {
    serde_json::from_str(include_str!("references/light_ibl.json")).expect("reference file")
}

fn vector(value: &Value) -> [f32; 3] {
    std::array::from_fn(|i| value[i].as_f64().expect("number") as f32)
}

#[test]
fn tables_of_real_skies_agree_with_brute_force() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/assets/hdri");
    let reference = reference();
    let axes: Vec<Vec3A> =
        reference["directions"].as_array().expect("directions").iter().map(|d| Vec3A::from_array(vector(d))).collect();
    for (name, expected) in reference["maps"].as_object().expect("maps") {
        let path = folder.join(name);
        if !path.is_file() {
            println!("skipped {name}: {} is not there", path.display());
            continue;
        }
        let picture = ::image::open(&path).expect("readable map").to_rgb32f();
        let map = Rgb {
            width: picture.width() as usize,
            height: picture.height() as usize,
            pixels: picture.pixels().map(|p| p.0).collect(),
        };
        let rotation = reference["rotation"].as_f64().expect("rotation") as f32;
        let environment = Environment { map, rotation, intensity: 1.0 };
        let factor = expected["exposure"].as_f64().expect("exposure") as f32;
        assert!((exposure(&environment) / factor - 1.0).abs() < 1e-4, "{name}: exposure {}", exposure(&environment));

        // Differences as a share of the sky's mean value of the same table.
        let tables = IblTables::new(&environment);
        for level in 0..LEVELS {
            let rows = if level == 0 { &expected["irradiance"] } else { &expected["prefiltered"][level - 1] };
            let rows: Vec<[f32; 3]> = rows.as_array().expect("table").iter().map(vector).collect();
            let mean = rows.iter().flatten().sum::<f32>() / (3 * rows.len()) as f32;
            let (mut worst, mut square) = (0.0_f32, 0.0);
            for (axis, row) in axes.iter().zip(&rows) {
                let found = if level == 0 {
                    tables.irradiance(*axis)
                } else {
                    tables.prefiltered(*axis, level as f32 / (LEVELS - 1) as f32)
                };
                for i in 0..3 {
                    // A share of the value itself where it is above the mean.
                    let error = (found[i] - row[i]).abs() / row[i].max(mean);
                    worst = worst.max(error);
                    square += error * error;
                }
            }
            let rms = (square / (3 * rows.len()) as f32).sqrt();
            let what = if level == 0 { "irradiance".to_owned() } else { format!("level {level}") };
            println!("{name} {what}: root mean square {:.3} %, worst {:.3} %", 100.0 * rms, 100.0 * worst);
            let (rms_limit, worst_limit) = (0.004, 0.02);
            assert!(rms < rms_limit && worst < worst_limit, "{name} {what}: {rms} {worst}");
        }
    }
}

#[test]
fn environment_brdf_agrees_with_adaptive_quadrature() {
    for row in reference()["brdf"].as_array().expect("brdf") {
        let value = |i: usize| row[i].as_f64().expect("number") as f32;
        let found = environment_brdf(value(0), value(1));
        // The reference has scale and bias on f0 by Schlick's formula.
        for (found, expected) in [(found.whole - found.parts.x, value(2)), (found.parts.x, value(3))] {
            assert!((found - expected).abs() < 2e-3, "n.v {} roughness {}: {found} {expected}", value(0), value(1));
        }
    }
}
