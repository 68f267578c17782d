//! Material extensions of glTF, brought into Burley's parameters. Exact where the two models agree, the nearest of his lobes and
//! a note where they do not.

use crate::load::build::absorption;
use crate::{LoadReport, Material};
use renderflow_frame::color::luminance;
use serde_json::Value;

/// `read` with what the extensions of `material` add to it.
pub(super) fn apply(material: &gltf::Material, read: Material, name: &str, report: &mut LoadReport) -> Material {
    let mut result = Material { name: name.into(), ..read };
    specular(material, &mut result, report);
    if let Some(extension) = material.extension_value("KHR_materials_clearcoat") {
        clearcoat(extension, &mut result, report);
    }
    if let Some(extension) = material.extension_value("KHR_materials_sheen") {
        sheen(extension, &mut result, report);
    }
    if let Some(extension) = material.extension_value("KHR_materials_anisotropy") {
        anisotropy(extension, &mut result, report);
    }
    if let Some(extension) = material.extension_value("KHR_materials_transmission") {
        let volume = material.extension_value("KHR_materials_volume");
        transmission(extension, volume, &mut result, report);
    }
    result
}

/// Without a thickness the surface is a sheet; with one it bounds a body, through which paths travel as far as its other side
/// is, whatever number the thickness has.
fn transmission(extension: &Value, volume: Option<&Value>, result: &mut Material, report: &mut LoadReport) {
    result.surface.transmission = unit(extension, "transmissionFactor");
    if result.surface.transmission == 0.0 {
        result.transmission_texture = None;
        return;
    }
    let number = |key: &str| volume.and_then(|v| v.get(key)).and_then(Value::as_f64);
    result.thin_walled = number("thicknessFactor").is_none_or(|thickness| thickness <= 0.0);
    if result.thin_walled {
        return;
    }
    let color = numbers(volume.and_then(|v| v.get("attenuationColor")), 1.0);
    let distance = number("attenuationDistance").map_or(f32::INFINITY, |v| v as f32);
    if distance > 0.0 {
        result.absorption = absorption(color, distance.max(1e-9));
    } else if color != [1.0; 3] {
        note(report, result, format!("the attenuation distance {distance} of KHR_materials_volume is not used"));
    }
}

/// Three numbers of an extension, limited to 0..=1.
fn numbers(value: Option<&Value>, otherwise: f32) -> [f32; 3] {
    let list = value.and_then(Value::as_array);
    let number = |i: usize| list.and_then(|n| n.get(i)).and_then(Value::as_f64).map_or(otherwise, |v| v.clamp(0.0, 1.0) as f32);
    [number(0), number(1), number(2)]
}

fn note(report: &mut LoadReport, material: &Material, what: impl std::fmt::Display) {
    report.notes.push(format!("material {:?}: {what}", material.name));
}

/// A number of an extension, limited to 0..=1.
fn unit(extension: &Value, key: &str) -> f32 {
    extension.get(key).and_then(Value::as_f64).map_or(0.0, |v| v.clamp(0.0, 1.0) as f32)
}

fn has(extension: &Value, keys: &[&str]) -> bool {
    keys.iter().any(|key| extension.get(key).is_some())
}

/// Disney's `specular` (F0 = 0.08 specular) and `specular_tint` of KHR_materials_ior and KHR_materials_specular, whose
/// F0 = min(((ior - 1) / (ior + 1))^2 * colour, 1) * factor. Burley's F0 has the hue of the base colour or none.
fn specular(material: &gltf::Material, result: &mut Material, report: &mut LoadReport) {
    // In double precision an index of 1.5 is a specular of exactly one half.
    let ior = f64::from(material.ior().unwrap_or(1.5));
    let mut f0 = ((ior - 1.0) / (ior + 1.0)).powi(2);
    if let Some(extension) = material.specular() {
        let color = extension.specular_color_factor();
        f0 = (f0 * f64::from(luminance(color))).min(1.0) * f64::from(extension.specular_factor());
        if extension.specular_texture().is_some() || extension.specular_color_texture().is_some() {
            note(report, result, "the textures of KHR_materials_specular are not read");
        }
        if color.iter().any(|&c| (c - color[0]).abs() > 1e-3) {
            match tint(color, result).filter(|_| result.base_color_texture.is_none()) {
                Some(share) => result.surface.specular_tint = share,
                None => {
                    note(report, result, "the colour of KHR_materials_specular is not the base colour's and is reduced to grey")
                }
            }
        }
    }
    let specular = f0 / 0.08;
    if !(0.0..=1.0001).contains(&specular) {
        note(report, result, format!("reflects {f0} at normal incidence; 0.08 is the most a dielectric can have here"));
    }
    result.surface.specular = if specular.is_nan() { 0.5 } else { specular.clamp(0.0, 1.0) as f32 };
}

/// Share t for which 1 + t (base / luminance(base) - 1) is `color` / luminance(color); `None` where no share comes near.
fn tint(color: [f32; 3], result: &Material) -> Option<f32> {
    let hue = |c: [f32; 3]| {
        let grey = luminance(c);
        (grey > 0.0).then(|| c.map(|v| v / grey - 1.0))
    };
    let (asked, base) = (hue(color)?, hue(result.surface.base_color.to_array())?);
    let dot = |a: [f32; 3], b: [f32; 3]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>();
    let share = (dot(asked, base) / dot(base, base)).clamp(0.0, 1.0);
    let near = asked.iter().zip(base).all(|(a, b)| (a - share * b).abs() <= 0.02);
    (share.is_finite() && near).then_some(share)
}

/// The coat's width alpha = roughness^2 is Burley's alpha = mix(0.1, 0.001, gloss). His coat has a quarter of the strength.
fn clearcoat(extension: &Value, result: &mut Material, report: &mut LoadReport) {
    result.surface.clearcoat = unit(extension, "clearcoatFactor");
    if result.surface.clearcoat == 0.0 {
        return;
    }
    let alpha = unit(extension, "clearcoatRoughnessFactor").powi(2);
    result.surface.clearcoat_gloss = ((0.1 - alpha) / (0.1 - 0.001)).clamp(0.0, 1.0);
    note(report, result, "the clear coat reflects a quarter of what glTF's does, as Burley's has it");
    if alpha > 0.1 {
        note(report, result, "the clear coat is smoother than the file says: a roughness of 0.316 is the most it can have");
    }
    if has(extension, &["clearcoatTexture", "clearcoatRoughnessTexture", "clearcoatNormalTexture"]) {
        note(report, result, "the textures of KHR_materials_clearcoat are not read");
    }
}

/// Strength is the largest channel of the sheen's colour; a coloured sheen takes the hue of the base colour.
fn sheen(extension: &Value, result: &mut Material, report: &mut LoadReport) {
    let color = numbers(extension.get("sheenColorFactor"), 0.0);
    result.surface.sheen = color.into_iter().fold(0.0, f32::max);
    if result.surface.sheen == 0.0 {
        return;
    }
    let grey = color.iter().all(|c| (c - color[0]).abs() < 1e-3);
    result.surface.sheen_tint = if grey { 0.0 } else { 1.0 };
    let hue = if grey { "" } else { " in the base colour's hue" };
    note(report, result, format!("the sheen is rendered with Burley's lobe{hue}; its roughness is not read"));
    if has(extension, &["sheenColorTexture", "sheenRoughnessTexture"]) {
        note(report, result, "the textures of KHR_materials_sheen are not read");
    }
}

/// The strength becomes `anisotropic`: both stretch highlights along the tangent, by somewhat different amounts.
fn anisotropy(extension: &Value, result: &mut Material, report: &mut LoadReport) {
    result.surface.anisotropic = unit(extension, "anisotropyStrength");
    if result.surface.anisotropic == 0.0 {
        return;
    }
    if extension.get("anisotropyRotation").and_then(Value::as_f64).is_some_and(|r| r != 0.0) {
        note(report, result, "the rotation of KHR_materials_anisotropy is not read");
    }
    if has(extension, &["anisotropyTexture"]) {
        note(report, result, "the texture of KHR_materials_anisotropy is not read");
    }
}
