//! Materials and textures of a glTF file, read as they are used.

use super::access::Buffers;
use super::extension;
use super::glossiness::Glossiness;
use super::uri;
use crate::error::{Error, Result};
use crate::loaded::{AlphaMask, Encoding, Wrap};
use crate::mipmap::{self, Texels};
use crate::texture::{self, Budget, uv_transform};
use crate::validate::MAX_VALUE;
use crate::{LoadReport, Material, Principled, Texture, TextureSlot};
use glam::{Affine2, Vec3A};
use gltf::material::AlphaMode;
use gltf::texture::{MagFilter, MinFilter, WrappingMode};
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
    /// The material of the file behind each, and what it looks like by specular and glossiness.
    origins: Vec<(Option<usize>, Option<Glossiness>)>,
    wanted: Vec<Wanted>,
    found: HashMap<(usize, Encoding, [u8; 2]), usize>,
    /// Textures that have no image, each told once.
    empty: HashSet<usize>,
    /// Textures whose samplers ask for the nearest texel.
    nearest: HashSet<usize>,
}

/// A texture to decode.
struct Wanted {
    image: usize,
    encoding: Encoding,
    wrap: [Wrap; 2],
    user: String,
}

/// A texture reference as it stands in a material.
pub(super) struct Reference<'a> {
    texture: gltf::Texture<'a>,
    encoding: Encoding,
    set: u32,
    uv_transform: Affine2,
}

impl<'a> Materials<'a> {
    pub(super) fn new(path: &'a Path, reach: &'a Reach, document: &'a gltf::Document) -> Self {
        let (known, found, empty, nearest) = (HashMap::new(), HashMap::new(), HashSet::new(), HashSet::new());
        Self { path, reach, document, list: vec![], known, origins: vec![], wanted: vec![], found, empty, nearest }
    }

    /// Sets of texture coordinates (`TEXCOORD_n`) that the textures of `material` are looked up with, at least one. The first is
    /// that of the normal map.
    pub(super) fn texture_sets(&self, material: &gltf::Material) -> Vec<u32> {
        references(self.document, material).sets()
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
        let (read, glossiness) = self.read(material, name, report);
        self.list.push(read);
        self.origins.push((material.index(), glossiness));
        self.known.insert(material.index(), self.list.len() - 1);
        self.list.len() - 1
    }

    fn read(&mut self, material: &gltf::Material, name: String, report: &mut LoadReport) -> (Material, Option<Glossiness>) {
        let pbr = material.pbr_metallic_roughness();
        let glossiness = material.extension_value(GLOSSINESS).map(Glossiness::read);
        let ([r, g, b], metallic, roughness) = match &glossiness {
            Some(glossiness) => glossiness.factors(),
            None => {
                let [r, g, b, _] = pbr.base_color_factor();
                ([r, g, b], pbr.metallic_factor(), pbr.roughness_factor())
            }
        };
        let alpha = glossiness.as_ref().map_or(pbr.base_color_factor()[3], |glossiness| glossiness.diffuse[3]);
        let alpha_mask = match material.alpha_mode() {
            AlphaMode::Opaque | AlphaMode::Blend => None,
            AlphaMode::Mask => {
                let cutoff = material.alpha_cutoff().unwrap_or(0.5);
                Some(AlphaMask { cutoff: if cutoff.is_finite() { cutoff } else { 0.5 }, factor: unit(alpha) })
            }
        };
        let opacity = (material.alpha_mode() == AlphaMode::Blend).then(|| unit(alpha));
        let used = references(self.document, material);
        let sets = used.sets();
        let uneven = glossiness.filter(|glossiness| !glossiness.is_even(&used));
        let mut slot = |reference: Option<Reference>| reference.and_then(|r| self.slot(&r, &sets, &name, report));
        let scale = material.normal_texture().map_or(1.0, |t| t.scale());
        let read = Material {
            surface: Principled {
                base_color: Vec3A::from_array([r, g, b].map(unit)),
                metallic: unit(metallic),
                roughness: unit(roughness),
                ..Principled::default()
            },
            base_color_texture: slot(used.color),
            // Made into metallic and roughness where the textures are decoded.
            metallic_roughness_texture: slot(used.data.or(used.specular)),
            normal_texture: slot(used.normal).map(|s| (s, if scale.is_finite() { scale } else { 1.0 })),
            emissive_texture: slot(used.emissive),
            transmission_texture: slot(used.transmission),
            emissive: emissive(material, &name, report),
            alpha_mask,
            opacity,
            double_sided: material.double_sided(),
            ..Material::default()
        };
        (Material { name, ..read }, uneven)
    }

    /// `None` for a texture without an image: one that only an extension tells.
    fn slot(&mut self, reference: &Reference, sets: &[u32], user: &str, report: &mut LoadReport) -> Option<TextureSlot> {
        let index = reference.texture.index();
        let Some(image) = self.image(index) else {
            if self.empty.insert(index) {
                let texture = &self.document.as_json().textures[index];
                let others = texture.extensions.iter().flat_map(|e| e.others.keys()).cloned().collect::<Vec<_>>().join(", ");
                let why =
                    if others.is_empty() { "it has no image".into() } else { format!("its image is given by {others} only") };
                report.notes.push(format!("/textures/{index} is not used: {why}"));
            }
            return None;
        };
        let sampler = reference.texture.sampler();
        if sampler.mag_filter() == Some(MagFilter::Nearest) || sampler.min_filter() == Some(MinFilter::Nearest) {
            self.nearest.insert(index);
        }
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
        let set = sets.iter().position(|&set| set == reference.set).unwrap_or(0);
        Some(TextureSlot { texture, uv_transform: reference.uv_transform, set })
    }

    /// The image of a texture of the file, else the one that EXT_texture_webp names; `None` where there is neither.
    fn image(&self, texture: usize) -> Option<usize> {
        let (json, texture) = (self.document.as_json(), self.document.as_json().textures.get(texture)?);
        let webp = texture.extensions.as_ref().and_then(|e| e.others.get("EXT_texture_webp")?.get("source")?.as_u64());
        let webp = webp.and_then(|image| usize::try_from(image).ok());
        [Some(texture.source.value()), webp].into_iter().flatten().find(|image| *image < json.images.len())
    }

    /// Reads and decodes all textures, where they fit into `budget`, and brings what extensions say into the materials.
    pub(super) fn finish(
        mut self,
        buffers: &Buffers,
        budget: &Budget,
        report: &mut LoadReport,
    ) -> Result<(Vec<Material>, Vec<Texture>)> {
        if !self.nearest.is_empty() {
            let count = self.nearest.len();
            report.notes.push(format!("{count} textures ask for the nearest texel (NEAREST); they are filtered like the others"));
        }
        let about = |wanted: &Wanted| {
            let image = &self.document.as_json().images[wanted.image];
            let file = image.uri.as_ref().filter(|uri| image.buffer_view.is_none() && !uri.starts_with("data:"));
            let name = file.or(image.name.as_ref()).cloned().unwrap_or_else(|| format!("image {}", wanted.image));
            texture::Wanted { name, encoding: wanted.encoding, wrap: wanted.wrap }
        };
        let mut textures = texture::decode_all(
            &self.wanted,
            budget,
            about,
            |wanted| self.bytes(wanted, buffers),
            |wanted, e| self.fail(wanted, e),
        )?;
        let mut list = std::mem::take(&mut self.list);
        let mut means = HashMap::new();
        for (read, (index, glossiness)) in list.iter_mut().zip(&self.origins) {
            if let Some(glossiness) = glossiness {
                let place = || format!("/materials/{}", index.unwrap_or(0));
                by_glossiness(read, glossiness, &mut textures, budget, report)
                    .map_err(|reason| Error::model(self.path, place(), reason))?;
            }
            let Some(material) = index.and_then(|index| self.document.materials().nth(index)) else { continue };
            let name = read.name.clone();
            let mut mean = |texture: usize, encoding: Encoding| {
                *means.entry((texture, encoding)).or_insert_with(|| self.mean(texture, encoding, &name, buffers, budget, report))
            };
            let (with, notes) = extension::apply(&material, read.clone(), &mut mean);
            *read = with;
            report.notes.extend(notes);
        }
        Ok((list, textures))
    }

    /// The mean of a texture that only its mean is used of; `None`, and a note, where it cannot be read.
    fn mean(
        &self,
        texture: usize,
        encoding: Encoding,
        user: &str,
        buffers: &Buffers,
        budget: &Budget,
        report: &mut LoadReport,
    ) -> Option<Mean> {
        let image = self.image(texture);
        let wanted = Wanted { image: image.unwrap_or_default(), encoding, wrap: Default::default(), user: user.into() };
        let decoded = match image {
            None if texture >= self.document.as_json().textures.len() => Err("it does not exist".into()),
            None => Err("it has no image".into()),
            Some(_) => self.bytes(&wanted, buffers).map_err(|e| e.to_string()).and_then(|bytes| {
                let about = texture::Wanted { name: user.into(), encoding, wrap: wanted.wrap };
                texture::decode_one(&bytes, about, budget)
            }),
        };
        match decoded {
            Ok(texture) => Some(Mean::of(&texture)),
            Err(reason) => {
                report.notes.push(format!("material {user:?}: /textures/{texture} is not used: {reason}"));
                None
            }
        }
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
                let file = uri::file(self.reach, text).map_err(&fail)?;
                let bytes = texture::read(&file).map_err(fail)?;
                self.reach.note(&file);
                Ok(Cow::Owned(bytes))
            }
            (None, None) => Err(fail("it has neither uri nor bufferView".into())),
        }
    }
}

/// The extension whose materials are told by specular and glossiness.
const GLOSSINESS: &str = "KHR_materials_pbrSpecularGlossiness";

/// Gives a material whose textures are those of specular and glossiness textures of base colour, metallic and roughness. The
/// error says, in words, that they do not fit.
fn by_glossiness(
    read: &mut Material,
    glossiness: &Glossiness,
    textures: &mut Vec<Texture>,
    budget: &Budget,
    report: &mut LoadReport,
) -> std::result::Result<(), String> {
    let [diffuse, specular] = [&read.base_color_texture, &read.metallic_roughness_texture].map(Option::clone);
    let same = |a: &TextureSlot, b: &TextureSlot| (a.uv_transform, a.set) == (b.uv_transform, b.set);
    if let (Some(a), Some(b)) = (&diffuse, &specular)
        && !same(a, b)
    {
        let what = "the textures of specular and glossiness lie differently on the surface; the specular one is not used";
        report.notes.push(format!("material {:?}: {what}", read.name));
        read.metallic_roughness_texture = None;
    } else {
        // Both are as large as the larger of those that they are made of.
        let larger = [&diffuse, &specular].into_iter().flatten().map(|slot| textures[slot.texture].bytes()).max();
        budget.take(&read.name, 2 * larger.unwrap_or(0) as u64)?;
        let texture = |slot: &Option<TextureSlot>| slot.as_ref().map(|slot| &textures[slot.texture]);
        let made = glossiness.textures(texture(&diffuse), texture(&specular), &read.name);
        let Some(lie) = diffuse.or(specular) else { return Ok(()) };
        let first = textures.len();
        textures.extend(made);
        read.base_color_texture = Some(TextureSlot { texture: first, ..lie.clone() });
        read.metallic_roughness_texture = Some(TextureSlot { texture: first + 1, ..lie });
        (read.surface.base_color, read.surface.metallic, read.surface.roughness) = (Vec3A::ONE, 1.0, 1.0);
    }
    Ok(())
}

/// What a texture is on the whole.
#[derive(Clone, Copy, Debug)]
pub(super) struct Mean {
    /// Decoded colour and alpha.
    pub value: [f32; 4],
    /// Whether it is the same everywhere.
    pub even: [bool; 4],
}

impl Mean {
    fn of(texture: &Texture) -> Self {
        let (mut sums, mut low, mut high) = ([0.0_f64; 4], [u16::MAX; 4], [0; 4]);
        let decode = |channel: usize, v: f32| if channel < 3 { mipmap::decode(texture.encoding, v) } else { v };
        let mut count = |texel: [u16; 4], values: [f32; 4]| {
            for channel in 0..4 {
                sums[channel] += f64::from(values[channel]);
                low[channel] = low[channel].min(texel[channel]);
                high[channel] = high[channel].max(texel[channel]);
            }
        };
        let Some(level) = texture.levels.first() else { return Self { value: [1.0; 4], even: [true; 4] } };
        match &level.texels {
            Texels::Bytes(texels) => {
                let table: [f32; 256] = std::array::from_fn(|i| decode(0, i as f32 / 255.0));
                for texel in texels {
                    let [r, g, b, a] = texel.map(usize::from);
                    count(texel.map(u16::from), [table[r], table[g], table[b], a as f32 / 255.0]);
                }
            }
            Texels::Words(texels) => {
                texels.iter().for_each(|t| count(*t, std::array::from_fn(|i| decode(i, f32::from(t[i]) / 65535.0))));
            }
        }
        let total = (level.width * level.height) as f64;
        Self { value: sums.map(|sum| (sum / total) as f32), even: std::array::from_fn(|i| low[i] == high[i]) }
    }
}

/// Numbers of an extension, limited to 0..=1.
pub(super) fn array<const N: usize>(value: Option<&Value>, otherwise: f32) -> [f32; N] {
    let list = value.and_then(Value::as_array);
    std::array::from_fn(|i| finite(list.and_then(|n| n.get(i))).map_or(otherwise, |v| v.clamp(0.0, 1.0)))
}

/// A number of an extension.
pub(super) fn finite(value: Option<&Value>) -> Option<f32> {
    value.and_then(Value::as_f64).map(|v| v as f32).filter(|v| v.is_finite())
}

/// Textures of a material that are rendered.
pub(super) struct References<'a> {
    pub color: Option<Reference<'a>>,
    normal: Option<Reference<'a>>,
    data: Option<Reference<'a>>,
    /// Specular colour and glossiness, in place of `data`.
    pub specular: Option<Reference<'a>>,
    emissive: Option<Reference<'a>>,
    transmission: Option<Reference<'a>>,
    /// The set that the direction of highlights belongs to, where there is no normal map.
    stretched: Option<u32>,
}

impl References<'_> {
    fn all(&self) -> impl Iterator<Item = &Reference<'_>> {
        [&self.color, &self.normal, &self.data, &self.specular, &self.emissive, &self.transmission].into_iter().flatten()
    }

    /// Sets of texture coordinates for all of them: first the one that tangents belong to, then each as it comes.
    fn sets(&self) -> Vec<u32> {
        let tangents = self.normal.as_ref().map(|normal| normal.set).or(self.stretched);
        let mut sets: Vec<u32> = tangents.into_iter().collect();
        for reference in self.all() {
            if !sets.contains(&reference.set) {
                sets.push(reference.set);
            }
        }
        if sets.is_empty() {
            sets.push(0);
        }
        sets
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
    let glossiness = material.extension_value(GLOSSINESS);
    let of_glossiness = |key: &str| glossiness.and_then(|extension| plain(document, extension.get(key)?, Encoding::Srgb));
    let color = pbr.base_color_texture().map(|info| simple(info, Encoding::Srgb));
    let data = pbr.metallic_roughness_texture().map(|info| simple(info, Encoding::Linear));
    let stretched = material.extension_value("KHR_materials_anisotropy").and_then(|extension| {
        finite(extension.get("anisotropyStrength")).filter(|strength| *strength != 0.0)?;
        let texture = extension.get("anisotropyTexture").and_then(|info| plain(document, info, Encoding::Linear));
        Some(texture.map_or(0, |reference| reference.set))
    });
    References {
        color: if glossiness.is_some() { of_glossiness("diffuseTexture") } else { color },
        normal,
        data: data.filter(|_| glossiness.is_none()),
        specular: of_glossiness("specularGlossinessTexture"),
        stretched,
        emissive: material.emissive_texture().map(|info| simple(info, Encoding::Srgb)),
        transmission: material
            .extension_value("KHR_materials_transmission")
            .and_then(|extension| plain(document, extension.get("transmissionTexture")?, Encoding::Linear)),
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

/// The reference to a texture in an extension that the gltf crate does not know; `None` where it leads nowhere.
fn plain<'a>(document: &'a gltf::Document, info: &Value, encoding: Encoding) -> Option<Reference<'a>> {
    let number = |key: &str| info.get(key).and_then(Value::as_u64);
    let texture = document.textures().nth(usize::try_from(number("index")?).ok()?)?;
    let (set, uv_transform) = lie(info.get("extensions").and_then(|extensions| extensions.get("KHR_texture_transform")));
    let own = number("texCoord").and_then(|set| u32::try_from(set).ok()).unwrap_or(0);
    Some(Reference { texture, encoding, set: set.unwrap_or(own), uv_transform })
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
