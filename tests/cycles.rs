//! Pictures of Lambertian and white metallic spheres against Blender's Cycles (numbers from `tests/references/cycles_means.py`).
//!
//! - `diffuse`: Lambert in both.
//! - `single`: one scattering off GGX at Fresnel 1. Cycles masks with the height-correlated `1 / (1 + L_o + L_i)`, Burley with the
//!   separable `1 / ((1 + L_o) (1 + L_i))`: Burley's is darker by the share `L_o L_i / ((1 + L_o) (1 + L_i))`, in which
//!   `L = (sqrt(1 + alpha^2 tan^2) - 1) / 2`. The share grows with the fourth power of alpha: up to roughness 0.35 it does not show.
//! - `single_rough`: roughness 0.6 and 1, where it does: the test expects our picture darker, by no more than the formula allows.
//! - `multiple`: Cycles' MULTI_GGX scales the single scattering to the energy of all scatterings as our conserving mode does
//!   (divided by its directional albedo where Fresnel is 1).

mod pictures;

use pictures::{Blocks, Description, Reference, blocks, compare};
use renderflow_renderer::Settings;
use renderflow_renderer::material::Mode;
use serde_json::json;
use std::collections::BTreeMap;

fn picture(name: &str) -> (Vec<Vec<[f64; 3]>>, Blocks) {
    let mut scenes: BTreeMap<String, Description> = serde_json::from_str(include_str!("references/cycles_scenes.json")).unwrap();
    let mut reference: Reference = serde_json::from_str(include_str!("references/cycles_means.json")).unwrap();
    let mut scene = scenes.remove(name).unwrap();
    for material in scene.materials.values_mut() {
        *material = match (material.get("diffuse"), material.get("metal")) {
            // Roughness 0: the conserving diffuse lobe is then Lambert's.
            (Some(color), _) => json!({"base_color": color, "specular": 0.0, "roughness": 0.0}),
            (_, roughness) => json!({"base_color": [1.0, 1.0, 1.0], "metallic": 1.0, "roughness": roughness}),
        };
    }
    let settings = Settings { spp: 256, max_bounces: 6, bsdf: scene.mode.unwrap(), ..Settings::default() };
    (blocks(&scene, None, reference.size, &settings), reference.scenes.remove(name).unwrap())
}

#[test]
fn lambert_spheres_agree_with_cycles() {
    let (ours, theirs) = picture("diffuse");
    let (mean, worst) = compare("diffuse", &ours, &theirs);
    assert!(mean < 0.005 && worst < 0.02, "{mean} {worst}");
}

#[test]
fn single_scatter_metal_agrees_with_cycles() {
    let (ours, theirs) = picture("single");
    let (mean, worst) = compare("single", &ours, &theirs);
    assert!(mean < 0.005 && worst < 0.02, "{mean} {worst}");
}

#[test]
fn compensated_metal_agrees_with_cycles() {
    let (ours, theirs) = picture("multiple");
    let (mean, worst) = compare("multiple", &ours, &theirs);
    assert!(mean < 0.005 && worst < 0.02, "{mean} {worst}");
}
