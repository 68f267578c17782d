//! MTL libraries: Phong parameters and the PBR extension, turned into the principled material.

use super::super::model::Model;
use crate::error::{Error, Result};
use crate::loaded::{Encoding, Wrap};
use crate::texture;
use crate::{Material, Texture, TextureSlot};
use glam::{Affine2, Mat2, Vec2};
use renderflow_frame::color::luminance;
use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

/// The MTL files of an OBJ file.
pub(super) struct Libraries<'a> {
    obj: &'a Path,
    notes: Vec<String>,
    error: Option<Error>,
}

impl<'a> Libraries<'a> {
    pub(super) fn new(obj: &'a Path) -> Self {
        Self { obj, notes: vec![], error: None }
    }

    fn folder(&self) -> &'a Path {
        self.obj.parent().unwrap_or(Path::new(""))
    }

    /// Reads the library that `mtllib` names. A missing one is noted, a broken one becomes an error of [`Self::finish`].
    pub(super) fn read(&mut self, name: &Path) -> tobj::MTLLoadResult {
        let mut materials = vec![];

        // One name with blanks in it, or several names.
        let text = name.to_string_lossy().replace('\\', "/");
        let whole = self.folder().join(&text);
        let names: Vec<PathBuf> =
            if whole.is_file() { vec![whole] } else { text.split_whitespace().map(|n| self.folder().join(n)).collect() };
        for path in names {
            // A pipe or a device would be read for ever.
            let regular =
                |m: std::fs::Metadata| if m.is_file() { Ok(()) } else { Err(std::io::Error::other("not a regular file")) };
            let bytes = match std::fs::metadata(&path).and_then(regular).and_then(|()| std::fs::read(&path)) {
                Ok(bytes) => bytes,
                Err(e) => {
                    self.notes.push(format!(
                        "the material library {} cannot be read ({e}); default materials are used",
                        path.display()
                    ));
                    continue;
                }
            };
            let mut line = 0;
            let cleaned: String = String::from_utf8_lossy(&bytes).lines().map(|l| format!("{}\n", clean(l))).collect();
            let mut reader = Counted { text: cleaned.as_bytes(), lines: &mut line };
            match tobj::load_mtl_buf(&mut reader) {
                Ok((more, _)) => materials.extend(more),
                Err(e) => self.error = self.error.take().or(Some(Error::model(&path, format!("line {line}"), e.to_string()))),
            }
        }
        let by_name = materials.iter().enumerate().map(|(i, m): (_, &tobj::Material)| (m.name.clone(), i)).collect();
        Ok((materials, by_name))
    }

    /// Puts the materials that are used, and their textures, into `model`, at the indices of `materials`.
    pub(super) fn finish(mut self, materials: &[tobj::Material], used: &[String], model: &mut Model) -> Result<()> {
        if let Some(error) = self.error.take() {
            return Err(error);
        }
        let known: HashSet<&str> = materials.iter().map(|m| m.name.as_str()).collect();
        let used: HashSet<&str> = used.iter().map(String::as_str).collect();
        let mut unknown: Vec<&str> = used.iter().filter(|n| !known.contains(*n)).copied().collect();
        unknown.sort_unstable();
        for name in unknown {
            self.notes.push(format!("no library defines the material {name:?}; the default material is used"));
        }
        let mut textures = Textures { folder: self.folder(), list: vec![], known: HashMap::new() };
        for material in materials {
            // Unused materials keep their place but are not read: their textures may be missing.
            let converted = if used.contains(material.name.as_str()) {
                if material.dissolve.is_some_and(|d| d < 1.0) || material.dissolve_texture.is_some() {
                    model.report.blend_as_opaque += 1;
                }
                convert(material, &mut textures, &mut self.notes)?
            } else {
                Material { name: material.name.clone(), ..Material::default() }
            };
            model.materials.push(converted);
        }
        model.textures = textures.list;
        model.report.notes.append(&mut self.notes);
        Ok(())
    }
}

/// A colour given by one number has three equal channels (MTL specification); tobj (4.0) panics on it.
fn clean(line: &str) -> String {
    let words: Vec<&str> = line.split_whitespace().collect();
    match words[..] {
        [key @ ("Ka" | "Kd" | "Ks" | "Ke"), grey] => format!("{key} {grey} {grey} {grey}"),
        // No third number: not a colour, said by tobj as a parse error.
        [key @ ("Ka" | "Kd" | "Ks" | "Ke")] | [key @ ("Ka" | "Kd" | "Ks" | "Ke"), _, _] => format!("{key} missing number"),
        _ => line.to_owned(),
    }
}

/// Counts the lines handed out, so that an error knows where it is.
struct Counted<'a> {
    text: &'a [u8],
    lines: &'a mut usize,
}

impl std::io::Read for Counted<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        self.text.read(buffer)
    }
}

impl std::io::BufRead for Counted<'_> {
    fn fill_buf(&mut self) -> std::io::Result<&[u8]> {
        Ok(self.text)
    }

    fn consume(&mut self, count: usize) {
        *self.lines += self.text[..count].iter().filter(|&&b| b == b'\n').count();
        self.text = &self.text[count..];
    }
}

fn convert(material: &tobj::Material, textures: &mut Textures, notes: &mut Vec<String>) -> Result<Material> {
    let name = &material.name;
    let unit = |v: f32| if v.is_nan() { 0.0 } else { v.clamp(0.0, 1.0) };
    let extra = |key: &str| material.unknown_param.get(key);
    let number = |key: &str| extra(key).and_then(|v| v.split_whitespace().next()?.parse::<f32>().ok());
    let color_texture = match &material.diffuse_texture {
        Some(words) => Some(textures.slot(name, words, Encoding::Srgb)?.0),
        None => None,
    };
    let normal_texture = match extra("norm") {
        Some(words) => Some(textures.slot(name, words, Encoding::Normal)?),
        None => None,
    };
    for (there, what) in [
        (material.normal_texture.is_some(), "bump map (a height map; normal maps are read from `norm`)"),
        (material.specular_texture.is_some() || material.shininess_texture.is_some(), "specular map"),
        (extra("map_Pr").is_some() || extra("map_Pm").is_some(), "roughness or metallic map"),
        (material.dissolve_texture.is_some(), "opacity map"),
    ] {
        if there {
            notes.push(format!("material {name:?}: its {what} is not read"));
        }
    }
    let emissive = material.emissive.unwrap_or_default().map(|v| if v.is_finite() { v.max(0.0) } else { 0.0 });
    if emissive != [0.0; 3] {
        notes.push(format!("material {name:?} emits light, which is not rendered yet"));
    }
    // A black factor would hide the texture; exporters that write one mean the texture alone.
    let factor = material.diffuse.unwrap_or([0.8; 3]);
    let base_color =
        if color_texture.is_some() && (factor == [0.0; 3] || material.diffuse.is_none()) { [1.0; 3] } else { factor };
    Ok(Material {
        name: name.clone(),
        base_color: base_color.map(unit),
        metallic: unit(number("Pm").unwrap_or(0.0)),
        roughness: unit(number("Pr").unwrap_or_else(|| roughness(material.shininess))),
        specular: unit(specular(material)),
        base_color_texture: color_texture,
        metallic_roughness_texture: None,
        normal_texture,
        emissive,
        ..Material::default()
    })
}

/// Perceptual roughness of a Blinn-Phong exponent: alpha^2 = 2 / (Ns + 2) (Walter et al. 2007, section 5.2), roughness = sqrt(alpha).
fn roughness(exponent: Option<f32>) -> f32 {
    exponent.filter(|n| n.is_finite()).map_or(0.5, |n| (2.0 / (n.max(0.0) + 2.0)).powf(0.25))
}

/// Illumination models 0 and 1 have no highlight; else the luminance of `Ks`, which exporters fill with Disney's specular.
fn specular(material: &tobj::Material) -> f32 {
    match (material.illumination_model, material.specular) {
        (Some(0 | 1), _) => 0.0,
        (_, Some(color)) => luminance(color),
        (_, None) => 0.5,
    }
}

struct Textures<'a> {
    folder: &'a Path,
    list: Vec<Texture>,
    known: HashMap<(PathBuf, Encoding, Wrap), usize>,
}

impl Textures<'_> {
    /// Slot and bump factor of a texture statement (`-s 2 2 -clamp on wood.png`).
    fn slot(&mut self, material: &str, words: &str, encoding: Encoding) -> Result<(TextureSlot, f32)> {
        let options = Options::parse(words);
        let path = self.folder.join(options.file.replace('\\', "/"));
        let wrap = if options.clamp { Wrap::Clamp } else { Wrap::Repeat };
        let texture = match self.known.get(&(path.clone(), encoding, wrap)) {
            Some(&known) => known,
            None => {
                let fail = |reason| Error::Texture { user: format!("material {material:?}"), path: path.clone(), reason };
                let bytes = std::fs::read(&path).map_err(|e| fail(format!("cannot read: {e}")))?;
                self.list.push(texture::decode(&bytes, options.file.clone(), encoding, [wrap; 2]).map_err(fail)?);
                self.known.insert((path, encoding, wrap), self.list.len() - 1);
                self.list.len() - 1
            }
        };
        Ok((TextureSlot { texture, uv_transform: options.uv_transform() }, options.bump))
    }
}

/// Options of a texture statement (MTL specification, "Texture map statements").
#[derive(Debug, PartialEq)]
struct Options {
    file: String,
    scale: Vec2,
    offset: Vec2,
    clamp: bool,
    bump: f32,
}

impl Options {
    /// Options stand before the file name, which may hold blanks; some exporters write them behind it.
    fn parse(text: &str) -> Self {
        let mut options = Self { file: String::new(), scale: Vec2::ONE, offset: Vec2::ZERO, clamp: false, bump: 1.0 };
        let mut file = vec![];
        let mut words = text.split_whitespace().peekable();
        while let Some(word) = words.next() {
            let count = match word {
                "-blendu" | "-blendv" | "-cc" | "-clamp" | "-boost" | "-bm" | "-texres" | "-imfchan" | "-type"
                | "-colorspace" => 1,
                "-mm" => 2,
                "-o" | "-s" | "-t" => 3,
                _ => {
                    file.push(word);
                    continue;
                }
            };
            let mut values = vec![];
            // Up to three numbers follow -o, -s and -t; the rest have a fixed count.
            while values.len() < count && words.peek().is_some_and(|w| count < 3 || w.parse::<f32>().is_ok()) {
                values.extend(words.next());
            }
            let number = |i: usize| values.get(i).and_then(|v| v.parse::<f32>().ok()).filter(|v| v.is_finite());
            match word {
                "-clamp" => options.clamp = values == ["on"],
                "-bm" => options.bump = number(0).unwrap_or(1.0),
                "-o" => options.offset = Vec2::new(number(0).unwrap_or(0.0), number(1).unwrap_or(0.0)),
                "-s" => options.scale = Vec2::new(number(0).unwrap_or(1.0), number(1).unwrap_or(1.0)),
                _ => {}
            }
        }
        options.file = file.join(" ");
        options
    }

    /// `uv * scale + offset` with v running up, expressed for v running down.
    fn uv_transform(&self) -> Affine2 {
        let translation = Vec2::new(self.offset.x, 1.0 - self.scale.y - self.offset.y);
        Affine2 { matrix2: Mat2::from_diagonal(self.scale), translation }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texture_options() {
        let plain = Options { file: "a b.png".into(), scale: Vec2::ONE, offset: Vec2::ZERO, clamp: false, bump: 1.0 };
        assert_eq!(Options::parse("a b.png"), plain);
        let options = Options::parse("-s 2 3 -o 0.5 -clamp on -mm 0 1 wood.png -bm 1.5");
        let expected =
            Options { file: "wood.png".into(), scale: Vec2::new(2.0, 3.0), offset: Vec2::new(0.5, 0.0), clamp: true, bump: 1.5 };
        assert_eq!(options, expected);
        // The point (0.25, 0.25) of the file, v up, looks at (1, 0.75) v up.
        let uv = options.uv_transform().transform_point2(Vec2::new(0.25, 0.75));
        assert!(uv.distance(Vec2::new(1.0, 0.25)) < 1e-6, "{uv}");
    }
}
