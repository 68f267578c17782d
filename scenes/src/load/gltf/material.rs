//! Materials and textures of a glTF file, read as they are used.

use super::access::Buffers;
use super::uri;
use crate::error::{Error, Result};
use crate::loaded::{Encoding, Wrap};
use crate::texture;
use crate::{LoadReport, Material, Texture, TextureSlot};
use glam::{Affine2, Mat2, Vec2};
use gltf::material::AlphaMode;
use gltf::texture::WrappingMode;
use rayon::prelude::*;
use serde_json::Value;
use std::collections::HashMap;
use std::path::Path;

/// Materials used so far, with the textures they need (not yet decoded).
pub(super) struct Materials<'a> {
    path: &'a Path,
    document: &'a gltf::Document,
    pub(super) list: Vec<Material>,
    known: HashMap<Option<usize>, usize>,
    wanted: Vec<Wanted>,
    found: HashMap<(usize, Encoding, [u8; 2]), usize>,
}

/// A texture to decode.
struct Wanted {
    image: usize,
    encoding: Encoding,
    wrap: [Wrap; 2],
    user: String,
}

/// A texture reference as it stands in a material.
struct Reference<'a> {
    texture: gltf::Texture<'a>,
    encoding: Encoding,
    set: u32,
    uv_transform: Affine2,
}

impl<'a> Materials<'a> {
    pub(super) fn new(path: &'a Path, document: &'a gltf::Document) -> Self {
        Self { path, document, list: vec![], known: HashMap::new(), wanted: vec![], found: HashMap::new() }
    }

    /// Set of texture coordinates (`TEXCOORD_n`) that the textures of `material` are looked up with.
    pub(super) fn texture_set(material: &gltf::Material) -> u32 {
        references(material).first().map_or(0, |r| r.set)
    }

    /// Index in [`Self::list`] of a material, read now if this is its first use.
    pub(super) fn index(&mut self, material: &gltf::Material, report: &mut LoadReport) -> usize {
        if let Some(&known) = self.known.get(&material.index()) {
            return known;
        }
        let name = match (material.index(), material.name()) {
            (_, Some(name)) if !name.trim().is_empty() => name.to_owned(),
            (Some(index), _) => format!("material {index}"),
            (None, _) => "default".to_owned(),
        };
        let read = self.read(material, name, report);
        self.list.push(read);
        self.known.insert(material.index(), self.list.len() - 1);
        self.list.len() - 1
    }

    fn read(&mut self, material: &gltf::Material, name: String, report: &mut LoadReport) -> Material {
        match material.alpha_mode() {
            AlphaMode::Blend => report.blend_as_opaque += 1,
            AlphaMode::Mask => report.mask_as_opaque += 1,
            AlphaMode::Opaque => {}
        }
        let references = references(material);
        if references.iter().any(|r| r.set != references[0].set) {
            let note = format!(
                "material {name:?} uses several sets of texture coordinates; TEXCOORD_{} is used for all",
                references[0].set
            );
            report.notes.push(note);
        }
        let mut slots: HashMap<Encoding, TextureSlot> = HashMap::new();
        for reference in references {
            slots.insert(reference.encoding, self.slot(&reference, &name));
        }
        let pbr = material.pbr_metallic_roughness();
        let gain = material.emissive_strength().unwrap_or(1.0);
        let emissive = material.emissive_factor().map(|v| v * gain);
        if emissive.iter().any(|&v| v > 0.0) {
            report.notes.push(format!("material {name:?} emits light, which is not rendered yet"));
        }
        let [r, g, b, _] = pbr.base_color_factor();
        let scale = material.normal_texture().map_or(1.0, |t| t.scale());
        let unit = |v: f32| if v.is_nan() { 0.0 } else { v.clamp(0.0, 1.0) };
        Material {
            specular: specular(material, &name, report),
            base_color: [r, g, b].map(unit),
            metallic: unit(pbr.metallic_factor()),
            roughness: unit(pbr.roughness_factor()),
            base_color_texture: slots.remove(&Encoding::Srgb),
            metallic_roughness_texture: slots.remove(&Encoding::Linear),
            normal_texture: slots.remove(&Encoding::Normal).map(|s| (s, if scale.is_finite() { scale } else { 1.0 })),
            emissive: emissive.map(|v| if v.is_finite() { v.max(0.0) } else { 0.0 }),
            name,
            ..Material::default()
        }
    }

    fn slot(&mut self, reference: &Reference, user: &str) -> TextureSlot {
        let sampler = reference.texture.sampler();
        let wrap = [sampler.wrap_s(), sampler.wrap_t()].map(|mode| match mode {
            WrappingMode::ClampToEdge => Wrap::Clamp,
            WrappingMode::MirroredRepeat => Wrap::Mirror,
            WrappingMode::Repeat => Wrap::Repeat,
        });
        let image = self.document.as_json().textures[reference.texture.index()].source.value();
        let key = (image, reference.encoding, wrap.map(|w| w as u8));
        let texture = *self.found.entry(key).or_insert_with(|| {
            self.wanted.push(Wanted { image, encoding: reference.encoding, wrap, user: user.into() });
            self.wanted.len() - 1
        });
        TextureSlot { texture, uv_transform: reference.uv_transform }
    }

    /// Reads and decodes all textures, in parallel.
    pub(super) fn finish(self, buffers: &Buffers) -> Result<(Vec<Material>, Vec<Texture>)> {
        let textures = self.wanted.par_iter().map(|w| self.decode(w, buffers)).collect::<Result<_>>()?;
        Ok((self.list, textures))
    }

    fn decode(&self, wanted: &Wanted, buffers: &Buffers) -> Result<Texture> {
        let user = format!("material {:?}, /images/{}", wanted.user, wanted.image);
        let fail = |path: &Path, reason| Error::Texture { user: user.clone(), path: path.into(), reason };
        // Through the JSON: the crate's `Image::source` panics on images without uri and without buffer view (1.4).
        let image = &self.document.as_json().images[wanted.image];
        let decode = |bytes: &[u8], name: String| texture::decode(bytes, name, wanted.encoding, wanted.wrap);
        let texture = match (&image.buffer_view, &image.uri) {
            (Some(view), _) => {
                let view = self.document.views().nth(view.value());
                let view = view.ok_or_else(|| fail(self.path, "its buffer view does not exist".into()))?;
                let name = image.name.clone().unwrap_or_else(|| format!("image {}", wanted.image));
                decode(buffers.view(&view)?, name).map_err(|e| fail(self.path, e))?
            }
            (None, Some(text)) => {
                let inside = text.starts_with("data:");
                let file = if inside { self.path.into() } else { uri::file(self.path, text).map_err(|e| fail(self.path, e))? };
                let bytes = uri::read(self.path, text).map_err(|e| fail(&file, e))?;
                let name = if inside { format!("image {}", wanted.image) } else { text.clone() };
                decode(&bytes, name).map_err(|e| fail(&file, e))?
            }
            (None, None) => return Err(fail(self.path, "it has neither uri nor bufferView".into())),
        };
        Ok(texture)
    }
}

/// Textures of a material that are rendered: base colour, then normal, then metallic-roughness.
fn references<'a>(material: &gltf::Material<'a>) -> Vec<Reference<'a>> {
    let pbr = material.pbr_metallic_roughness();
    let simple = |info: gltf::texture::Info<'a>, encoding| {
        let transform = info.texture_transform();
        Reference {
            encoding,
            set: transform.as_ref().and_then(|t| t.tex_coord()).unwrap_or(info.tex_coord()),
            uv_transform: transform.map_or(Affine2::IDENTITY, |t| uv_transform(t.offset(), t.rotation(), t.scale())),
            texture: info.texture(),
        }
    };
    let normal = material.normal_texture().map(|info| {
        let transform = info.extension_value("KHR_texture_transform");
        let pair = |key: &str, otherwise: [f32; 2]| -> [f32; 2] {
            let numbers = transform.and_then(|t| t.get(key)).and_then(Value::as_array);
            let number = |i: usize| numbers.and_then(|n| n.get(i)).and_then(Value::as_f64).map(|v| v as f32);
            [number(0).unwrap_or(otherwise[0]), number(1).unwrap_or(otherwise[1])]
        };
        let rotation = transform.and_then(|t| t.get("rotation")).and_then(Value::as_f64).unwrap_or(0.0);
        let set = transform.and_then(|t| t.get("texCoord")).and_then(Value::as_u64).and_then(|s| u32::try_from(s).ok());
        Reference {
            encoding: Encoding::Normal,
            set: set.unwrap_or(info.tex_coord()),
            uv_transform: uv_transform(pair("offset", [0.0; 2]), rotation as f32, pair("scale", [1.0; 2])),
            texture: info.texture(),
        }
    });
    let color = pbr.base_color_texture().map(|info| simple(info, Encoding::Srgb));
    let data = pbr.metallic_roughness_texture().map(|info| simple(info, Encoding::Linear));
    color.into_iter().chain(normal).chain(data).collect()
}

/// KHR_texture_transform: scale, then a turn that looks counter-clockwise where v runs down, then the offset.
/// (The README's own example, the lower left quadrant, holds with this sign only.)
fn uv_transform(offset: [f32; 2], rotation: f32, scale: [f32; 2]) -> Affine2 {
    let turn = Mat2::from_angle(-rotation);
    let transform = Affine2 { matrix2: turn * Mat2::from_diagonal(Vec2::from(scale)), translation: Vec2::from(offset) };
    if transform.is_finite() { transform } else { Affine2::IDENTITY }
}

/// Disney's `specular` (F0 = 0.08 specular) of KHR_materials_ior and KHR_materials_specular, whose
/// F0 = min(((ior - 1) / (ior + 1))^2 * colour, 1) * factor; the tint of the colour is reduced to its luminance.
fn specular(material: &gltf::Material, name: &str, report: &mut LoadReport) -> f32 {
    let ior = material.ior().unwrap_or(1.5);
    let mut f0 = ((ior - 1.0) / (ior + 1.0)).powi(2);
    if let Some(extension) = material.specular() {
        let color = extension.specular_color_factor();
        f0 = (f0 * renderflow_frame::color::luminance(color)).min(1.0) * extension.specular_factor();
        if extension.specular_texture().is_some() || extension.specular_color_texture().is_some() {
            report.notes.push(format!("material {name:?}: the textures of KHR_materials_specular are not read"));
        }
        if color.iter().any(|&c| (c - color[0]).abs() > 1e-3) {
            report.notes.push(format!("material {name:?}: the tint of KHR_materials_specular is not rendered"));
        }
    }
    let specular = f0 / 0.08;
    if !(0.0..=1.0001).contains(&specular) {
        report
            .notes
            .push(format!("material {name:?} reflects {f0} at normal incidence; 0.08 is the most a dielectric can have here"));
    }
    if specular.is_nan() { 0.5 } else { specular.clamp(0.0, 1.0) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The two examples of the extension's README, in its own words.
    #[test]
    fn texture_transform_examples() {
        // "utilizes only the lower left quadrant of the source image, rotated clockwise 90 degrees"
        let quadrant = uv_transform([0.0, 1.0], std::f32::consts::FRAC_PI_2, [0.5, 0.5]);
        for corner in [Vec2::ZERO, Vec2::X, Vec2::Y, Vec2::ONE] {
            let uv = quadrant.transform_point2(corner);
            assert!((-1e-6..=0.5 + 1e-6).contains(&uv.x) && (0.5 - 1e-6..=1.0 + 1e-6).contains(&uv.y), "{corner} -> {uv}");
        }
        // "inverts the T axis, effectively defining a bottom-left origin"
        let flipped = uv_transform([0.0, 1.0], 0.0, [1.0, -1.0]);
        assert!(flipped.transform_point2(Vec2::new(0.25, 0.25)).distance(Vec2::new(0.25, 0.75)) < 1e-6);
    }
}
