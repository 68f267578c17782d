//! Materials and textures of a glTF file, read as they are used.

use super::access::Buffers;
use super::extension;
use super::uri;
use crate::error::{Error, Result};
use crate::loaded::{AlphaMask, Encoding, Wrap};
use crate::texture::{self, Budget, uv_transform};
use crate::validate::MAX_VALUE;
use crate::{LoadReport, Material, Principled, Texture, TextureSlot};
use glam::{Affine2, Vec3A};
use gltf::material::AlphaMode;
use gltf::texture::WrappingMode;
use renderflow_frame::reach::Reach;
use serde_json::Value;
use std::borrow::Cow;
use std::collections::{HashMap, HashSet};
use std::path::Path;

/// Materials used so far, with the textures they need (not yet decoded).
pub(super) struct Materials<'a> {
    path: &'a Path,
    reach: &'a Reach,
    document: &'a gltf::Document,
    pub(super) list: Vec<Material>,
    known: HashMap<Option<usize>, usize>,
    wanted: Vec<Wanted>,
    found: HashMap<(usize, Encoding, [u8; 2]), usize>,
    /// Textures that have no image, each told once.
    empty: HashSet<usize>,
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
    pub(super) fn new(path: &'a Path, reach: &'a Reach, document: &'a gltf::Document) -> Self {
        let (known, found, empty) = (HashMap::new(), HashMap::new(), HashSet::new());
        Self { path, reach, document, list: vec![], known, wanted: vec![], found, empty }
    }

    /// Set of texture coordinates (`TEXCOORD_n`) that the textures of `material` are looked up with.
    pub(super) fn texture_set(&self, material: &gltf::Material) -> u32 {
        references(self.document, material).set()
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
        let pbr = material.pbr_metallic_roughness();
        let [r, g, b, alpha] = pbr.base_color_factor();
        let alpha_mask = match material.alpha_mode() {
            AlphaMode::Opaque | AlphaMode::Blend => None,
            AlphaMode::Mask => {
                let cutoff = material.alpha_cutoff().unwrap_or(0.5);
                Some(AlphaMask { cutoff: if cutoff.is_finite() { cutoff } else { 0.5 }, factor: unit(alpha) })
            }
        };
        let opacity = (material.alpha_mode() == AlphaMode::Blend).then(|| unit(alpha));
        let used = references(self.document, material);
        let set = used.set();
        if used.all().any(|r| r.set != set) {
            report
                .notes
                .push(format!("material {name:?} uses several sets of texture coordinates; TEXCOORD_{set} is used for all"));
        }
        let mut slot = |reference: Option<Reference>| reference.and_then(|r| self.slot(&r, &name, report));
        let scale = material.normal_texture().map_or(1.0, |t| t.scale());
        let read = Material {
            surface: Principled {
                base_color: Vec3A::from_array([r, g, b].map(unit)),
                metallic: unit(pbr.metallic_factor()),
                roughness: unit(pbr.roughness_factor()),
                ..Principled::default()
            },
            base_color_texture: slot(used.color),
            metallic_roughness_texture: slot(used.data),
            normal_texture: slot(used.normal).map(|s| (s, if scale.is_finite() { scale } else { 1.0 })),
            emissive_texture: slot(used.emissive),
            transmission_texture: slot(used.transmission),
            emissive: emissive(material, &name, report),
            alpha_mask,
            opacity,
            double_sided: material.double_sided(),
            ..Material::default()
        };
        Material { name: name.clone(), ..extension::apply(material, read, &name, report) }
    }

    /// `None` for a texture without an image: one that only an extension tells.
    fn slot(&mut self, reference: &Reference, user: &str, report: &mut LoadReport) -> Option<TextureSlot> {
        let index = reference.texture.index();
        let texture = &self.document.as_json().textures[index];
        let image = texture.source.value();
        if image >= self.document.as_json().images.len() {
            if self.empty.insert(index) {
                let others = texture.extensions.iter().flat_map(|e| e.others.keys()).cloned().collect::<Vec<_>>().join(", ");
                let why =
                    if others.is_empty() { "it has no image".into() } else { format!("its image is given by {others} only") };
                report.notes.push(format!("/textures/{index} is not used: {why}"));
            }
            return None;
        }
        let sampler = reference.texture.sampler();
        let wrap = [sampler.wrap_s(), sampler.wrap_t()].map(|mode| match mode {
            WrappingMode::ClampToEdge => Wrap::Clamp,
            WrappingMode::MirroredRepeat => Wrap::Mirror,
            WrappingMode::Repeat => Wrap::Repeat,
        });
        let key = (image, reference.encoding, wrap.map(|w| w as u8));
        let texture = *self.found.entry(key).or_insert_with(|| {
            self.wanted.push(Wanted { image, encoding: reference.encoding, wrap, user: user.into() });
            self.wanted.len() - 1
        });
        Some(TextureSlot { texture, uv_transform: reference.uv_transform })
    }

    /// Reads and decodes all textures, where they fit into `budget`.
    pub(super) fn finish(self, buffers: &Buffers, budget: &Budget) -> Result<(Vec<Material>, Vec<Texture>)> {
        let about = |wanted: &Wanted| {
            let image = &self.document.as_json().images[wanted.image];
            let file = image.uri.as_ref().filter(|uri| image.buffer_view.is_none() && !uri.starts_with("data:"));
            let name = file.or(image.name.as_ref()).cloned().unwrap_or_else(|| format!("image {}", wanted.image));
            texture::Wanted { name, encoding: wanted.encoding, wrap: wanted.wrap }
        };
        let textures = texture::decode_all(
            &self.wanted,
            budget,
            about,
            |wanted| self.bytes(wanted, buffers),
            |wanted, e| self.fail(wanted, e),
        )?;
        Ok((self.list, textures))
    }

    /// An image that cannot be used.
    fn fail(&self, wanted: &Wanted, reason: String) -> Error {
        let image = &self.document.as_json().images[wanted.image];
        let uri = image.uri.as_ref().filter(|uri| image.buffer_view.is_none() && !uri.starts_with("data:"));
        let file = uri.and_then(|uri| uri::file(self.reach, uri).ok());
        let user = format!("material {:?}, /images/{}", wanted.user, wanted.image);
        Error::Texture { user, path: file.unwrap_or_else(|| self.path.into()), reason }
    }

    /// The file of an image.
    fn bytes<'b>(&self, wanted: &Wanted, buffers: &'b Buffers) -> Result<Cow<'b, [u8]>> {
        let fail = |reason: String| self.fail(wanted, reason);
        // Through the JSON: the crate's `Image::source` panics on images without uri and without buffer view (1.4).
        let image = &self.document.as_json().images[wanted.image];
        match (&image.buffer_view, &image.uri) {
            (Some(view), _) => {
                let view = self.document.views().nth(view.value());
                let view = view.ok_or_else(|| fail("its buffer view does not exist".into()))?;
                Ok(Cow::Borrowed(buffers.view(&view)?))
            }
            (None, Some(text)) if text.starts_with("data:") => Ok(Cow::Owned(uri::read(self.reach, text).map_err(fail)?)),
            (None, Some(text)) => {
                let file = uri::file(self.reach, text);
                Ok(Cow::Owned(file.and_then(|file| texture::read(&file)).map_err(fail)?))
            }
            (None, None) => Err(fail("it has neither uri nor bufferView".into())),
        }
    }
}

/// Textures of a material that are rendered.
struct References<'a> {
    color: Option<Reference<'a>>,
    normal: Option<Reference<'a>>,
    data: Option<Reference<'a>>,
    emissive: Option<Reference<'a>>,
    transmission: Option<Reference<'a>>,
}

impl References<'_> {
    fn all(&self) -> impl Iterator<Item = &Reference<'_>> {
        [&self.color, &self.normal, &self.data, &self.emissive, &self.transmission].into_iter().flatten()
    }

    /// Set of texture coordinates for all of them: the first one's.
    fn set(&self) -> u32 {
        self.all().next().map_or(0, |r| r.set)
    }
}

fn references<'a>(document: &'a gltf::Document, material: &gltf::Material<'a>) -> References<'a> {
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
        let (set, uv_transform) = lie(info.extension_value("KHR_texture_transform"));
        Reference { encoding: Encoding::Normal, set: set.unwrap_or(info.tex_coord()), uv_transform, texture: info.texture() }
    });
    References {
        color: pbr.base_color_texture().map(|info| simple(info, Encoding::Srgb)),
        normal,
        data: pbr.metallic_roughness_texture().map(|info| simple(info, Encoding::Linear)),
        emissive: material.emissive_texture().map(|info| simple(info, Encoding::Srgb)),
        transmission: material
            .extension_value("KHR_materials_transmission")
            .and_then(|extension| plain(document, extension.get("transmissionTexture")?)),
    }
}

/// Set of texture coordinates and their transform as KHR_texture_transform has them.
fn lie(transform: Option<&Value>) -> (Option<u32>, Affine2) {
    let pair = |key: &str, otherwise: [f32; 2]| -> [f32; 2] {
        let numbers = transform.and_then(|t| t.get(key)).and_then(Value::as_array);
        let number = |i: usize| numbers.and_then(|n| n.get(i)).and_then(Value::as_f64).map(|v| v as f32);
        [number(0).unwrap_or(otherwise[0]), number(1).unwrap_or(otherwise[1])]
    };
    let rotation = transform.and_then(|t| t.get("rotation")).and_then(Value::as_f64).unwrap_or(0.0);
    let set = transform.and_then(|t| t.get("texCoord")).and_then(Value::as_u64).and_then(|s| u32::try_from(s).ok());
    (set, uv_transform(pair("offset", [0.0; 2]), rotation as f32, pair("scale", [1.0; 2])))
}

/// The reference to a texture of numbers in an extension that the gltf crate does not know; `None` where it leads nowhere.
fn plain<'a>(document: &'a gltf::Document, info: &Value) -> Option<Reference<'a>> {
    let number = |key: &str| info.get(key).and_then(Value::as_u64);
    let texture = document.textures().nth(usize::try_from(number("index")?).ok()?)?;
    let (set, uv_transform) = lie(info.get("extensions").and_then(|extensions| extensions.get("KHR_texture_transform")));
    let own = number("texCoord").and_then(|set| u32::try_from(set).ok()).unwrap_or(0);
    Some(Reference { texture, encoding: Encoding::Linear, set: set.unwrap_or(own), uv_transform })
}

/// Limits a factor; what is not a number becomes 0.
fn unit(v: f32) -> f32 {
    if v.is_nan() { 0.0 } else { v.clamp(0.0, 1.0) }
}

/// Radiance without the texture: the factor times KHR_materials_emissive_strength.
fn emissive(material: &gltf::Material, name: &str, report: &mut LoadReport) -> [f32; 3] {
    let gain = material.emissive_strength().unwrap_or(1.0);
    let asked = material.emissive_factor().map(|v| v * gain);
    let given = asked.map(|v| if v.is_nan() { 0.0 } else { v.clamp(0.0, MAX_VALUE) });
    if asked.iter().zip(given).any(|(&a, g)| a > g || a.is_nan()) {
        report.notes.push(format!("material {name:?} emits {asked:?}; {given:?} is used"));
    }
    given
}
