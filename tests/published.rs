//! The published mode of the material, value by value and picture by picture, against Mitsuba 3's `principled`.
//!
//! Values come from `tests/references/mitsuba_principled.py`, pictures from `tests/references/mitsuba_published.py`.
//! Both programs implement Burley's formulae (2012 notes, 2014 masking); with `c` the cosine between half vector and light, `D`,
//! `G` the distribution and the separable masking, `w(x) = (1 - x)^5`, they differ in three places, each applied here in double
//! precision:
//!
//! 1. Fresnel of the dielectric. Burley: Schlick, `F0 + (1 - F0) w(c)`, `F0 = 0.08 specular`. Mitsuba: the exact unpolarised
//!    reflectance at the index `2 / (1 - sqrt(F0)) - 1` in the share `1 - spec_tint` of the lobe, Schlick in the rest. Value
//!    added by Mitsuba: `(1 - metallic) (1 - spec_tint) (F_exact - F_schlick) D G / (4 cos_o)`.
//! 2. `specular` = 0. Mitsuba drops the whole specular lobe wherever its exact reflectance is 0, metal included; Burley keeps
//!    `w(c)` at grazing angles. Value added: minus the lobe.
//! 3. Clearcoat. Burley: `clearcoat / 4 D F G / (4 cos_o cos_i)`; his explorer's `smithG_GGX` holds the denominator. Mitsuba
//!    lacks it. Value added: `clearcoat / 4 D F G (1 - 1 / (4 cos_o cos_i)) cos_i`.
//!
//! Mitsuba forms the denominator of the clearcoat's distribution in single precision as `1 + (alpha^2 - 1) cos^2`: at gloss 1
//! (alpha 0.001) it is wrong by up to 18 %. The test allows for that rounding, and for nothing else.
//! The same: smallest GGX alpha 0.001, anisotropic aspect, luminance (Rec.709), sheen, tints, and the diffuse lobe, whose 2015
//! split into `(1 - F/2)(1 - F/2)` and a retro-reflective part equals the product of 2012 exactly. `flatness` is Burley's
//! `subsurface`.
//!
//! The pictures use `spec_tint` 1 where a dielectric shows, so that difference 1 is 0, and no clearcoat (difference 3 is 40 % of
//! that lobe and more, and held by the values alone).

mod pictures;

use glam::{DVec3, Vec3A};
use pictures::{Description, Reference, blocks, compare};
use renderflow_renderer::Settings;
use renderflow_renderer::material::{Bsdf, Mode, Principled};
use renderflow_scenes::description::Material;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::path::{Path, PathBuf};

#[derive(Deserialize)]
struct Values {
    wo: Vec<[f32; 3]>,
    wi: Vec<[f32; 3]>,
    materials: Vec<Entry>,
}

#[derive(Deserialize)]
struct Entry {
    name: String,
    material: Parameters,
    f_cos: Vec<[f64; 3]>,
}

#[derive(Deserialize, Default)]
#[serde(default, deny_unknown_fields)]
struct Parameters {
    base_color: [f32; 3],
    metallic: f32,
    roughness: f32,
    specular: Option<f32>,
    specular_tint: f32,
    anisotropic: f32,
    sheen: f32,
    sheen_tint: f32,
    clearcoat: f32,
    clearcoat_gloss: f32,
    subsurface: f32,
}

impl Parameters {
    fn surface(&self) -> Principled {
        Principled::from(&Material {
            base_color: self.base_color,
            metallic: self.metallic,
            roughness: self.roughness,
            specular: self.specular.unwrap_or(0.5),
            specular_tint: self.specular_tint,
            anisotropic: self.anisotropic,
            sheen: self.sheen,
            sheen_tint: self.sheen_tint,
            clearcoat: self.clearcoat,
            clearcoat_gloss: self.clearcoat_gloss,
            subsurface: self.subsurface,
            ..Material::default()
        })
    }
}

fn weight(cos: f64) -> f64 {
    (1.0 - cos).clamp(0.0, 1.0).powi(5)
}

/// Smith's masking of one direction under GGX.
fn masking(v: DVec3, ax: f64, ay: f64) -> f64 {
    let slope2 = ((ax * v.x).powi(2) + (ay * v.y).powi(2)) / (v.z * v.z);
    2.0 / (1.0 + (1.0 + slope2).sqrt())
}

/// Unpolarised reflectance of a dielectric of relative index `eta` > 1, from outside.
fn exact_fresnel(cos: f64, eta: f64) -> f64 {
    let inside = (1.0 - (1.0 - cos * cos) / (eta * eta)).sqrt();
    let s = (cos - eta * inside) / (cos + eta * inside);
    let p = (eta * cos - inside) / (eta * cos + inside);
    0.5 * (s * s + p * p)
}

/// What Mitsuba adds to Burley's value times cosine (differences 1 to 3), and how far its rounding of the clearcoat may be off.
fn difference(m: &Parameters, wo: DVec3, wi: DVec3) -> (DVec3, f64) {
    let h = (wo + wi).normalize();
    let c = h.dot(wi);
    let (metallic, tint) = (f64::from(m.metallic), f64::from(m.specular_tint));
    let f0 = 0.08 * f64::from(m.specular.unwrap_or(0.5));
    let (alpha, aspect) = (f64::from(m.roughness).powi(2), (1.0 - 0.9 * f64::from(m.anisotropic)).sqrt());
    let (ax, ay) = ((alpha / aspect).max(0.001), (alpha * aspect).max(0.001));
    let d = 1.0 / (PI * ax * ay * ((h.x / ax).powi(2) + (h.y / ay).powi(2) + h.z * h.z).powi(2));
    let lobe = d * masking(wo, ax, ay) * masking(wi, ax, ay) / (4.0 * wo.z);
    let schlick = |f0: f64| f0 + (1.0 - f0) * weight(c);
    let specular = if f0 == 0.0 {
        // F0 is 0 whatever its tint.
        let base = DVec3::from(m.base_color.map(f64::from));
        base.to_array().map(|b| -lobe * (metallic * schlick(b) + (1.0 - metallic) * schlick(0.0)))
    } else {
        let eta = 2.0 / (1.0 - f0.sqrt()) - 1.0;
        [(1.0 - metallic) * (1.0 - tint) * (exact_fresnel(c, eta) - schlick(f0)) * lobe; 3]
    };

    let a2 = (0.1 + (0.001 - 0.1) * f64::from(m.clearcoat_gloss)).powi(2);
    let denominator = a2 * h.z * h.z + h.x * h.x + h.y * h.y;
    let d = (a2 - 1.0) / (PI * a2.ln() * denominator);
    let coat = 0.25 * f64::from(m.clearcoat) * schlick(0.04) * d * masking(wo, 0.25, 0.25) * masking(wi, 0.25, 0.25) * wi.z;
    let rounding = coat * 3.0 * f64::from(f32::EPSILON) / denominator;
    (DVec3::from(specular) + DVec3::splat(coat * (1.0 - 1.0 / (4.0 * wo.z * wi.z))), rounding)
}

#[test]
fn published_values_equal_mitsubas() {
    let values: Values = serde_json::from_str(include_str!("references/mitsuba_principled.json")).unwrap();
    let mut failures = Vec::new();
    for entry in &values.materials {
        let bsdf = Bsdf::<true>::new(&entry.material.surface(), Mode::Published);
        let (mut worst, mut untouched) = (0.0f64, 0);
        for ((wo, wi), expected) in values.wo.iter().zip(&values.wi).zip(&entry.f_cos) {
            let ours = bsdf.eval(Vec3A::from(*wo), Vec3A::from(*wi)).f_cos.as_dvec3();
            let (added, rounding) = difference(&entry.material, DVec3::from(wo.map(f64::from)), DVec3::from(wi.map(f64::from)));
            untouched += usize::from(added == DVec3::ZERO);
            let ours = ours + added;
            for channel in 0..3 {
                let (ours, expected) = (ours[channel], expected[channel]);
                assert!(ours.is_finite(), "{}: {ours} for {wo:?} {wi:?}", entry.name);
                // Where a lobe was taken away, single precision rounds that lobe and not what is left.
                let scale = expected + added[channel].abs() + 1e-6;
                worst = worst.max(((ours - expected).abs() - rounding).max(0.0) / scale);
            }
        }
        println!("{:24} differs by {worst:.1e}; {untouched} of {} pairs needed no difference", entry.name, values.wo.len());
        if worst > 1e-3 {
            failures.push(format!("{}: {worst:.3e}", entry.name));
        }
    }
    assert!(values.materials.len() >= 14 && values.wo.len() >= 100);
    assert!(failures.is_empty(), "{failures:#?}");
}

/// Mean and largest relative difference of `name`'s blocks from Mitsuba's picture `label` of it.
fn picture(name: &str, label: &str, assets: Option<&Path>, spp: u32) -> (f64, f64) {
    let scenes: BTreeMap<String, Description> = serde_json::from_str(include_str!("references/published_scenes.json")).unwrap();
    let reference: Reference = serde_json::from_str(include_str!("references/mitsuba_published.json")).unwrap();
    let settings = Settings { spp, max_bounces: 6, bsdf: Mode::Published, ..Settings::default() };
    let ours = blocks(name, &scenes[name], assets, reference.size, &settings);
    compare(label, &ours, &reference.scenes[label])
}

fn assert_close(name: &str, assets: Option<&Path>, spp: u32, limit: f64) {
    let (mean, worst) = picture(name, name, assets, spp);
    assert!(mean < limit && worst < 6.0 * limit, "{name}: mean {mean}, worst {worst}");
}

#[test]
fn spheres_on_a_plane_agree_with_mitsuba() {
    assert_close("plain", None, 64, 0.005);
}

#[test]
fn interreflecting_room_agrees_with_mitsuba() {
    assert_close("room", None, 256, 0.005);
}

#[test]
fn brushed_metal_and_lacquer_agree_with_mitsuba() {
    assert_close("brushed", None, 256, 0.005);
}

#[test]
fn textured_sphere_and_plane_agree_with_mitsuba() {
    assert_close("textured", None, 64, 0.005);
}

fn model() -> Option<PathBuf> {
    let assets = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/assets/gltf/pbr/Suzanne");
    if !assets.exists() {
        println!("skipped: {} is not there", assets.display());
        return None;
    }
    Some(assets)
}

#[test]
fn textured_model_agrees_with_mitsuba() {
    if let Some(assets) = model() {
        assert_close("model", Some(&assets), 64, 0.005);
    }
}

/// Difference 1 in a picture: the same grey spheres with Schlick's Fresnel in both, then against Mitsuba's exact one. Schlick
/// lies below the exact curve by up to 0.02 at 40 to 75 degrees for `F0` 0.02 to 0.08: Mitsuba's two pictures differ by 0.79 % in
/// the mean and by 2.26 % in the darkest block, ours from its second by the same.
#[test]
fn grey_dielectrics_differ_from_mitsubas_exact_fresnel_by_that_alone() {
    assert_close("fresnel", None, 64, 0.005);
    let reference: Reference = serde_json::from_str(include_str!("references/mitsuba_published.json")).unwrap();
    let (exact, _) = compare("Mitsuba, Schlick, and", &reference.scenes["fresnel"].blocks, &reference.scenes["fresnel_exact"]);
    let (ours, _) = picture("fresnel", "fresnel_exact", None, 64);
    assert!((ours - exact).abs() < 0.0015, "{ours} where Mitsuba's own differ by {exact}");
}

/// The same with noise far below the limit: at 2048 samples per pixel the means were 0.042 % (plain), 0.042 % (fresnel), 0.070 %
/// (brushed) and 0.042 % (textured), which is the noise of the references.
#[test]
#[ignore = "heavy"]
fn pictures_agree_with_mitsuba_closely() {
    for name in ["plain", "fresnel", "brushed", "textured"] {
        assert_close(name, None, 1024, 0.0015);
    }
    assert_close("room", None, 1024, 0.003);
    if let Some(assets) = model() {
        assert_close("model", Some(&assets), 1024, 0.0025);
    }
}
