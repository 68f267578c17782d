//! Pictures of Lambertian and white metallic spheres against Blender's Cycles (numbers from `tests/references/cycles_means.py`).
//!
//! - `diffuse`: Lambert in both.
//! - `single`: one scattering off GGX at Fresnel 1. Cycles masks with the height-correlated `1 / (1 + L_o + L_i)`, Burley with
//!   the separable `1 / ((1 + L_o) (1 + L_i))`: Burley's is darker by the share `L_o L_i / ((1 + L_o) (1 + L_i))`, in which
//!   `L = (sqrt(1 + alpha^2 tan^2) - 1) / 2`. The share grows with the fourth power of alpha: up to roughness 0.35 it does not
//!   show.
//! - `rough`, `roughest`: one sphere of roughness 0.6 or 1, where it does. The test integrates both formulae over the sky, pixel
//!   by pixel, and their quotient must be the whole difference.
//! - `multiple`: Cycles' MULTI_GGX scales the single scattering to the energy of all scatterings as our conserving mode does
//!   (divided by its directional albedo where Fresnel is 1).

mod pictures;

use glam::DVec3;
use pictures::{Blocks, Description, Reference, blocks, compare, sky_radiance};
use renderflow_renderer::Settings;
use serde_json::json;
use std::collections::BTreeMap;
use std::f64::consts::PI;

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
    (blocks(name, &scene, None, reference.size, &settings), reference.scenes.remove(name).unwrap())
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

/// Smith's `L` for GGX of width `alpha` at cosine `cos`.
fn lambda(cos: f64, alpha: f64) -> f64 {
    0.5 * ((1.0 + alpha * alpha * (1.0 / (cos * cos) - 1.0)).sqrt() - 1.0)
}

/// Radiance towards the camera from the unit sphere of the scenes `rough` and `roughest`, or from the sky behind it, through the
/// image point (`x`, `y`) in -1..1 of half the picture: with separable and with correlated masking. Fresnel is 1, and a sphere
/// does not see itself.
fn masked_radiance(x: f64, y: f64, alpha: f64) -> [DVec3; 2] {
    let eye = DVec3::new(0.0, 0.0, 5.0);
    let slope = 15f64.to_radians().tan();
    let wo = -DVec3::new(x * slope, y * slope, -1.0).normalize();
    let along = eye.dot(wo);
    let inside = along * along - 24.0;
    if inside <= 0.0 {
        return [sky_radiance(-wo); 2];
    }
    let n = eye - wo * (along - inside.sqrt());
    let (t, b) = n.any_orthonormal_pair();
    let cos = wo.dot(n);
    let lo = lambda(cos, alpha);
    let steps = 24;
    let mut sums = [DVec3::ZERO; 2];
    for i in 0..steps * steps {
        // Half vectors by the projected area of their facets: density D cos.
        let u = (f64::from(i / steps) + 0.5) / f64::from(steps);
        let (sin_phi, cos_phi) = (2.0 * PI * (f64::from(i % steps) + 0.5) / f64::from(steps)).sin_cos();
        let h_cos = ((1.0 - u) / (1.0 + (alpha * alpha - 1.0) * u)).sqrt();
        let h_sin = (1.0 - h_cos * h_cos).sqrt();
        let h = t * (h_sin * cos_phi) + b * (h_sin * sin_phi) + n * h_cos;
        let wi = h * (2.0 * wo.dot(h)) - wo;
        let wi_cos = wi.dot(n);
        if wo.dot(h) > 0.0 && wi_cos > 0.0 {
            // D G / (4 cos_o cos_i) cos_i over the density D cos_h / (4 wo.h).
            let light = sky_radiance(wi) * (wo.dot(h) / (cos * h_cos) / f64::from(steps * steps));
            let li = lambda(wi_cos, alpha);
            sums[0] += light / ((1.0 + lo) * (1.0 + li));
            sums[1] += light / (1.0 + lo + li);
        }
    }
    sums
}

#[test]
fn masking_of_rough_metal_is_burleys_here_and_correlated_in_cycles() {
    for (name, roughness) in [("rough", 0.6f64), ("roughest", 1.0)] {
        let (ours, theirs) = picture(name);
        // 8 x 8 points a block.
        let mut expected = [vec![vec![[0.0; 3]; 8]; 8], vec![vec![[0.0; 3]; 8]; 8]];
        for i in 0..64 * 64 {
            let (px, py) = (i % 64, i / 64);
            let at = |p: usize| (p as f64 + 0.5) / 32.0 - 1.0;
            for (blocks, radiance) in expected.iter_mut().zip(masked_radiance(at(px), -at(py), roughness * roughness)) {
                let block: &mut [f64; 3] = &mut blocks[py / 8][px / 8];
                *block = (DVec3::from(*block) + radiance / 64.0).to_array();
            }
        }
        // The quotient of both integrals, in which the coarse silhouette and the quadrature at the rim cancel, takes Cycles'
        // picture to Burley's masking.
        let mut translated = Blocks { noise: theirs.noise, blocks: theirs.blocks.clone() };
        for (i, block) in translated.blocks.iter_mut().flatten().enumerate() {
            for (c, value) in block.iter_mut().enumerate() {
                *value *= expected[0][i / 8][i % 8][c] / expected[1][i / 8][i % 8][c];
            }
        }
        let (apart, _) = compare(&format!("{name}, as they are"), &ours, &theirs);
        let (mean, worst) = compare(&format!("{name}, with one masking"), &ours, &translated);
        assert!(mean < 0.002 && worst < 0.01 && apart > 2.0 * mean, "{name}: {mean} {worst} {apart}");
    }
}
