//! Material extensions of glTF, brought into Burley's parameters. Exact where the two models agree, the nearest of his lobes and
//! a note where they do not. Where an extension has a texture for a parameter that has none here, the mean of the texture is
//! used, with a note where it is not the same everywhere.

use super::material::{Mean, array, finite};
use crate::Material;
use crate::load::build::absorption;
use crate::loaded::Encoding;
use glam::Vec3A;
use renderflow_frame::color::luminance;
use serde_json::Value;

/// A material on its way, and what is to be told of it.
struct Work<'a> {
    result: Material,
    notes: Vec<String>,
    /// The mean of a texture, by its number.
    mean: &'a mut dyn FnMut(usize, Encoding) -> Option<Mean>,
}

/// `read` with what the extensions of `material` add to it, and what a person should know; `mean` tells what a texture is on the
/// whole.
pub(super) fn apply(
    material: &gltf::Material,
    read: Material,
    mean: &mut dyn FnMut(usize, Encoding) -> Option<Mean>,
) -> (Material, Vec<String>) {
    let mut work = Work { result: read, notes: vec![], mean };
    if material.extension_value("KHR_materials_unlit").is_some() {
        unlit(&mut work);
        return (work.result, work.notes);
    }
    specular(material, &mut work);
    if let Some(extension) = material.extension_value("KHR_materials_clearcoat") {
        clearcoat(extension, &mut work);
    }
    if let Some(extension) = material.extension_value("KHR_materials_sheen") {
        sheen(extension, &mut work);
    }
    if let Some(extension) = material.extension_value("KHR_materials_anisotropy") {
        anisotropy(extension, &mut work);
    }
    if let Some(extension) = material.extension_value("KHR_materials_transmission") {
        let volume = material.extension_value("KHR_materials_volume");
        transmission(extension, volume, &mut work);
    }
    (work.result, work.notes)
}

impl Work<'_> {
    fn note(&mut self, what: impl std::fmt::Display) {
        self.notes.push(format!("material {:?}: {what}", self.result.name));
    }

    /// The mean of texture number `index`; says so where some of the given channels differs from place to place.
    fn mean_of(&mut self, index: usize, encoding: Encoding, channels: &[usize], key: &str) -> Option<Mean> {
        let mean = (self.mean)(index, encoding)?;
        if !channels.iter().all(|&channel| mean.even[channel]) {
            self.note(format!("{key} is replaced by its mean"));
        }
        Some(mean)
    }

    /// As [`Self::mean_of`], for the texture of an extension that is called `key`.
    fn mean(&mut self, extension: &Value, key: &str, encoding: Encoding, channels: &[usize]) -> Option<Mean> {
        let index = extension.get(key)?.get("index")?.as_u64()?;
        self.mean_of(usize::try_from(index).ok()?, encoding, channels, key)
    }
}

/// The surface sends out its base colour and reflects nothing: it looks the same in every light, and lights what is around it.
fn unlit(work: &mut Work) {
    let result = &mut work.result;
    result.emissive = result.surface.base_color.to_array();
    result.emissive_texture = result.base_color_texture.clone();
    // Its alpha is still looked at.
    result.surface.base_color = Vec3A::ZERO;
    (result.surface.metallic, result.surface.specular, result.surface.roughness) = (0.0, 0.0, 1.0);
    (result.metallic_roughness_texture, result.normal_texture) = (None, None);
    work.note("it is unlit: it emits its base colour as light, and reflects nothing");
}

/// Without a thickness the surface is a sheet; with one it bounds a body, through which paths travel as far as its other side
/// is, whatever number the thickness has.
fn transmission(extension: &Value, volume: Option<&Value>, work: &mut Work) {
    work.result.surface.transmission = unit(extension, "transmissionFactor");
    if work.result.surface.transmission == 0.0 {
        work.result.transmission_texture = None;
        return;
    }
    let thickness = finite(volume.and_then(|v| v.get("thicknessFactor")));
    work.result.thin_walled = thickness.is_none_or(|thickness| thickness <= 0.0);
    if work.result.thin_walled {
        return;
    }
    let color = array(volume.and_then(|v| v.get("attenuationColor")), 1.0);
    let distance = volume.and_then(|v| v.get("attenuationDistance")).and_then(Value::as_f64).map_or(f32::INFINITY, |v| v as f32);
    if distance > 0.0 {
        work.result.absorption = absorption(color, distance.max(1e-9));
    } else if color != [1.0; 3] {
        work.note(format!("the attenuation distance {distance} of KHR_materials_volume is not used"));
    }
}

/// A number of an extension, limited to 0..=1.
fn unit(extension: &Value, key: &str) -> f32 {
    finite(extension.get(key)).map_or(0.0, |v| v.clamp(0.0, 1.0))
}

/// Disney's `specular` (F0 = 0.08 specular) and `specular_tint` of KHR_materials_ior and KHR_materials_specular, whose
/// F0 = min(((ior - 1) / (ior + 1))^2 * colour, 1) * factor. Burley's F0 has the hue of the base colour or none.
fn specular(material: &gltf::Material, work: &mut Work) {
    // In double precision an index of 1.5 is a specular of exactly one half.
    let ior = f64::from(material.ior().unwrap_or(1.5));
    let mut f0 = ((ior - 1.0) / (ior + 1.0)).powi(2);
    if let Some(extension) = material.specular() {
        let (mut color, mut factor) = (extension.specular_color_factor(), f64::from(extension.specular_factor()));
        let texture = extension.specular_texture().map(|info| info.texture().index());
        if let Some(mean) = texture.and_then(|index| work.mean_of(index, Encoding::Linear, &[3], "specularTexture")) {
            factor *= f64::from(mean.value[3]);
        }
        let texture = extension.specular_color_texture().map(|info| info.texture().index());
        if let Some(mean) = texture.and_then(|index| work.mean_of(index, Encoding::Srgb, &[0, 1, 2], "specularColorTexture")) {
            color = std::array::from_fn(|i| color[i] * mean.value[i]);
        }
        f0 = (f0 * f64::from(luminance(color))).min(1.0) * factor;
        if color.iter().any(|&c| (c - color[0]).abs() > 1e-3) {
            match tint(color, &work.result).filter(|_| work.result.base_color_texture.is_none()) {
                Some(share) => work.result.surface.specular_tint = share,
                None => {
                    work.note("the colour of KHR_materials_specular is not the base colour's and is reduced to grey");
                }
            }
        }
    }
    let specular = f0 / 0.08;
    if !(0.0..=1.0001).contains(&specular) {
        work.note(format!("reflects {f0} at normal incidence; 0.08 is the most a dielectric can have here"));
    }
    work.result.surface.specular = if specular.is_nan() { 0.5 } else { specular.clamp(0.0, 1.0) as f32 };
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
fn clearcoat(extension: &Value, work: &mut Work) {
    let strength = unit(extension, "clearcoatFactor");
    if strength == 0.0 {
        return;
    }
    let mean = work.mean(extension, "clearcoatTexture", Encoding::Linear, &[0]);
    work.result.surface.clearcoat = strength * mean.map_or(1.0, |mean| mean.value[0]);
    let mean = work.mean(extension, "clearcoatRoughnessTexture", Encoding::Linear, &[1]);
    let alpha = (unit(extension, "clearcoatRoughnessFactor") * mean.map_or(1.0, |mean| mean.value[1])).powi(2);
    work.result.surface.clearcoat_gloss = ((0.1 - alpha) / (0.1 - 0.001)).clamp(0.0, 1.0);
    work.note("the clear coat reflects a quarter of what glTF's does, as Burley's has it");
    if alpha > 0.1 {
        work.note("the clear coat is smoother than the file says: a roughness of 0.316 is the most it can have");
    }
    if extension.get("clearcoatNormalTexture").is_some() {
        work.note("clearcoatNormalTexture is not read: the clear coat has the normal of the surface");
    }
}

/// Strength is the largest channel of the sheen's colour; a coloured sheen takes the hue of the base colour.
fn sheen(extension: &Value, work: &mut Work) {
    let mut color: [f32; 3] = array(extension.get("sheenColorFactor"), 0.0);
    if color == [0.0; 3] {
        return;
    }
    if let Some(mean) = work.mean(extension, "sheenColorTexture", Encoding::Srgb, &[0, 1, 2]) {
        color = std::array::from_fn(|i| color[i] * mean.value[i]);
    }
    work.result.surface.sheen = color.into_iter().fold(0.0, f32::max);
    let grey = color.iter().all(|c| (c - color[0]).abs() < 1e-3);
    work.result.surface.sheen_tint = if grey { 0.0 } else { 1.0 };
    let hue = if grey { "" } else { " in the base colour's hue" };
    let unread = if extension.get("sheenRoughnessTexture").is_some() {
        "its roughness and sheenRoughnessTexture are"
    } else {
        "its roughness is"
    };
    work.note(format!("the sheen is rendered with Burley's lobe{hue}; {unread} not read"));
}

/// The strength becomes `anisotropic`: both stretch highlights along a direction in the surface, by somewhat different amounts.
/// The texture has the cosine and the sine of a turn in red and green, -1..=1, and a share of the strength in blue.
fn anisotropy(extension: &Value, work: &mut Work) {
    let mut strength = unit(extension, "anisotropyStrength");
    let mut angle = finite(extension.get("anisotropyRotation")).unwrap_or(0.0);
    if strength == 0.0 {
        return;
    }
    if let Some(mean) = work.mean(extension, "anisotropyTexture", Encoding::Linear, &[0, 1, 2]) {
        let [cos, sin] = [0, 1].map(|channel| 2.0 * mean.value[channel] - 1.0);
        angle += sin.atan2(cos);
        strength *= mean.value[2];
        // Directions that go every way stretch nothing.
        if !(mean.even[0] && mean.even[1]) {
            strength *= cos.hypot(sin).min(1.0);
        }
    }
    work.result.surface.anisotropic = strength;
    work.result.anisotropy_rotation = angle;
}
