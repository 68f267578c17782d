//! MTL libraries: Phong parameters and the PBR extension, turned into the principled material.

use super::super::model::Model;
use super::texture::{Statement, Textures};
use crate::error::{Error, Result};
use crate::loaded::{AlphaMask, Encoding};
use crate::texture::Budget;
use crate::validate::MAX_VALUE;
use crate::{LoadReport, Material, Principled};
use renderflow_frame::color::luminance;
use renderflow_frame::file;
use renderflow_frame::reach::Reach;
use std::collections::HashSet;
use std::path::{Path, PathBuf};

/// Most bytes of libraries that are read more than once. Each time takes some two hundred times as much memory.
const MOST_REPEATED: usize = 4 << 20;

/// The MTL files of an OBJ file.
pub(super) struct Libraries<'a> {
    reach: &'a Reach,
    /// The files that were read so far, and the last one.
    seen: HashSet<PathBuf>,
    last: Option<PathBuf>,
    /// Bytes that were read again.
    repeated: usize,
    /// The materials of each statement `mtllib` that was read and not taken.
    found: Vec<Vec<tobj::Material>>,
    notes: Vec<String>,
    error: Option<Error>,
}

impl<'a> Libraries<'a> {
    pub(super) fn new(reach: &'a Reach) -> Self {
        Self { reach, seen: HashSet::new(), last: None, repeated: 0, found: vec![], notes: vec![], error: None }
    }

    /// Reads the library that `mtllib` names, and returns the names of its materials, if it was not the last one that was read. A
    /// missing one is noted, a broken one becomes an error of [`Self::finish`].
    pub(super) fn read(&mut self, name: &str) -> Vec<String> {
        let mut materials: Vec<tobj::Material> = vec![];

        // One name with blanks in it, or several names.
        let text = name.replace('\\', "/");
        let whole = self.reach.resolve(&text).is_ok_and(|path| path.is_file());
        let names = if whole { vec![text.as_str()] } else { text.split_whitespace().collect() };
        for name in names {
            let path = match self.reach.resolve(name) {
                Ok(path) => path,
                // Exporters write where the library was on their machine.
                Err(_) if !self.reach.base().join(name).exists() => {
                    self.notes.push(format!("the material library {name} is not there; default materials are used"));
                    continue;
                }
                Err(reason) => {
                    self.error = self.error.take().or(Some(Error::Name { reason: format!("mtllib: {reason}") }));
                    continue;
                }
            };
            // Some exporters name one library before every object.
            if self.last.replace(path.clone()).is_some_and(|last| last == path) {
                continue;
            }
            let bytes = match file::read_at_most(&path, file::LARGEST_TEXT) {
                Ok(bytes) => bytes,
                Err(e) => {
                    let (path, reason) = (path.display(), e.reason());
                    self.notes.push(format!("the material library {path} cannot be used ({reason}); default materials are used"));
                    continue;
                }
            };
            self.reach.note(&path);
            // Where libraries take turns, each defines its names again.
            if !self.seen.insert(path.clone()) {
                self.repeated += bytes.len();
                if self.repeated > MOST_REPEATED {
                    let reason = format!("the library {} is named too often", path.display());
                    self.error = self.error.take().or(Some(Error::Name { reason: format!("mtllib: {reason}") }));
                    continue;
                }
            }
            let mut line = 0;
            let cleaned: String = String::from_utf8_lossy(&bytes).lines().map(|l| format!("{}\n", clean(l))).collect();
            let mut reader = Counted { text: cleaned.as_bytes(), lines: &mut line };
            match tobj::load_mtl_buf(&mut reader) {
                Ok((more, _)) => materials.extend(more),
                Err(e) => self.error = self.error.take().or(Some(Error::model(&path, format!("line {line}"), e.to_string()))),
            }
        }
        let names = materials.iter().map(|m| m.name.clone()).collect();
        self.found.push(materials);
        names
    }

    /// The materials of the statement `mtllib` of this number, once.
    pub(super) fn take(&mut self, number: &Path) -> tobj::MTLLoadResult {
        let number = number.to_str().and_then(|number| number.parse::<usize>().ok());
        let materials = number.and_then(|number| self.found.get_mut(number)).map(std::mem::take).unwrap_or_default();
        let by_name = materials.iter().enumerate().map(|(i, m)| (m.name.clone(), i)).collect();
        Ok((materials, by_name))
    }

    /// Puts the materials that are used, and their textures, into `model`, at the indices of `materials`.
    pub(super) fn finish(
        mut self,
        materials: &[tobj::Material],
        used: &[String],
        budget: &Budget,
        model: &mut Model,
    ) -> Result<()> {
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
        let mut textures = Textures::new(self.reach, budget);
        for material in materials {
            // Unused materials keep their place but are not read: their textures may be missing.
            let converted = if used.contains(material.name.as_str()) {
                convert(material, &mut textures, &mut model.report)?
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
        // Opacity as it is where the surface faces the viewer.
        ["d", "-halo", opacity] => format!("d {opacity}"),
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

fn convert(material: &tobj::Material, textures: &mut Textures, report: &mut LoadReport) -> Result<Material> {
    let name = &material.name;
    let unit = |v: f32| if v.is_nan() { 0.0 } else { v.clamp(0.0, 1.0) };
    let extra = |key: &str| material.unknown_param.get(key);
    let number = |key: &str| extra(key).and_then(|v| v.split_whitespace().next()?.parse::<f32>().ok());
    let statement = |words: Option<&String>| words.map(|w| Statement::parse(w));

    // Opacity: a map is cut at one half, a constant lets light straight through.
    let (color, map) = (statement(material.diffuse_texture.as_ref()), statement(material.dissolve_texture.as_ref()));
    let masked = match &map {
        Some(map) => textures.masked(name, color.as_ref(), map)?,
        None => None,
    };
    if map.is_some() && masked.is_none() {
        report.notes.push(format!("material {name:?}: its opacity map is not read: it does not lie like the colour map"));
    }
    // `d`, or else one less `Tr`: tobj knows the former alone.
    let constant = material.dissolve.or_else(|| number("Tr").map(|t| 1.0 - t)).map(unit);
    let opacity = constant.filter(|d| *d < 1.0 && masked.is_none());
    let alpha_mask = masked.is_some().then_some(AlphaMask { cutoff: 0.5, factor: 1.0 });
    let base_color_texture = match (masked, &color) {
        (Some(slot), _) => Some(slot),
        (None, Some(color)) => Some(textures.slot(name, color, Encoding::Srgb)?),
        (None, None) => None,
    };

    let (rough, metal) = (statement(extra("map_Pr")), statement(extra("map_Pm")));
    let metallic_roughness_texture = textures.metallic_roughness(name, rough.as_ref(), metal.as_ref())?;
    let maps = metallic_roughness_texture.is_some();
    let normal_texture = match statement(extra("norm")) {
        Some(statement) => Some((textures.slot(name, &statement, Encoding::Normal)?, statement.bump)),
        None => None,
    };
    let emissive_texture = match statement(extra("map_Ke")) {
        Some(statement) => Some(textures.slot(name, &statement, Encoding::Srgb)?),
        None => None,
    };
    // "Transparency: Glass on" or refraction (MTL specification, "Illumination models"); some exporters write 4 for everything.
    let glass = matches!(material.illumination_model, Some(4 | 6 | 7 | 9)) && material.optical_density.is_some_and(|n| n > 1.0);
    for (there, what) in [
        (material.normal_texture.is_some(), "bump map (a height map; normal maps are read from `norm`)"),
        (material.specular_texture.is_some() || material.shininess_texture.is_some(), "specular map"),
        ((rough.is_some() || metal.is_some()) && !maps, "pair of roughness and metallic maps of different sizes"),
        (number("anisor").is_some_and(|turn| turn != 0.0), "rotation of the anisotropy"),
        (extra("disp").is_some() || extra("decal").is_some() || extra("refl").is_some(), "displacement, decal or reflection map"),
        (glass && constant.is_none_or(|d| d >= 1.0), "glass"),
    ] {
        if there {
            report.notes.push(format!("material {name:?}: its {what} is not read"));
        }
    }
    // A factor of zero would hide the texture; exporters that write one mean the texture alone.
    let behind = |texture: bool, factor: Option<[f32; 3]>, without: [f32; 3]| match factor {
        Some(factor) if !texture || factor != [0.0; 3] => factor,
        _ if texture => [1.0; 3],
        _ => without,
    };
    let factor = |map: bool, key: &str, without: f32| {
        let given = number(key).filter(|v| !map || *v != 0.0);
        unit(given.unwrap_or(if map { 1.0 } else { without }))
    };
    let base_color = behind(color.is_some(), material.diffuse, if alpha_mask.is_some() { [1.0; 3] } else { [0.8; 3] });
    let emissive = behind(emissive_texture.is_some(), material.emissive, [0.0; 3]);
    Ok(Material {
        name: name.clone(),
        surface: Principled {
            base_color: base_color.map(unit).into(),
            metallic: factor(maps && metal.is_some(), "Pm", 0.0),
            roughness: factor(maps && rough.is_some(), "Pr", roughness(material.shininess)),
            specular: unit(specular(material)),
            anisotropic: factor(false, "aniso", 0.0),
            sheen: factor(false, "Ps", 0.0),
            clearcoat: factor(false, "Pc", 0.0),
            // Width alpha = roughness^2 of the coat is Burley's mix(0.1, 0.001, gloss).
            clearcoat_gloss: number("Pcr").map_or(1.0, |r| unit((0.1 - unit(r).powi(2)) / (0.1 - 0.001))),
            ..Principled::default()
        },
        base_color_texture,
        metallic_roughness_texture,
        normal_texture,
        emissive: emissive.map(|v| if v.is_nan() { 0.0 } else { v.clamp(0.0, MAX_VALUE) }),
        emissive_texture,
        alpha_mask,
        opacity,
        ..Material::default()
    })
}

/// Perceptual roughness of a Blinn-Phong exponent: alpha^2 = 2 / (Ns + 2) (Walter et al. 2007, section 5.2), roughness =
/// sqrt(alpha).
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
