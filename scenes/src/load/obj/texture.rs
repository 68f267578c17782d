//! Textures of MTL libraries: statements with their options, and images put together from grey maps.

use crate::error::{Error, Result};
use crate::loaded::{Encoding, Wrap};
use crate::texture::{self, Budget, Wanted};
use crate::{Texture, TextureSlot};
use glam::{Affine2, Mat2, Vec2};
use image::RgbaImage;
use renderflow_frame::reach::Reach;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Textures read so far.
pub(super) struct Textures<'a> {
    reach: &'a Reach,
    budget: &'a Budget,
    pub(super) list: Vec<Texture>,
    known: HashMap<Key, usize>,
}

/// What makes a texture: one file, or two put together.
#[derive(Clone, PartialEq, Eq, Hash)]
struct Key {
    files: [Option<PathBuf>; 2],
    what: What,
    wrap: Wrap,
}

#[derive(Clone, Copy, PartialEq, Eq, Hash)]
enum What {
    Image(Encoding),
    /// Colour and opacity.
    Masked,
    /// Roughness and metallic.
    MetallicRoughness,
}

impl<'a> Textures<'a> {
    pub(super) fn new(reach: &'a Reach, budget: &'a Budget) -> Self {
        Self { reach, budget, list: vec![], known: HashMap::new() }
    }

    /// The image of one statement.
    pub(super) fn slot(&mut self, material: &str, statement: &Statement, encoding: Encoding) -> Result<TextureSlot> {
        let path = self.path(material, statement)?;
        let key = Key { files: [Some(path.clone()), None], what: What::Image(encoding), wrap: statement.wrap() };
        let budget = self.budget;
        let made = self.once(key, || {
            let fail = |reason| failure(material, &path, reason);
            let bytes = texture::read(&path).map_err(fail)?;
            let wanted = Wanted { name: statement.file.clone(), encoding, wrap: [statement.wrap(); 2] };
            Ok(Some(texture::decode_one(&bytes, wanted, budget).map_err(fail)?))
        })?;
        let texture = made.ok_or_else(|| failure(material, &path, "no image".into()))?;
        Ok(TextureSlot { texture, uv_transform: statement.uv_transform(), set: 0 })
    }

    /// The colour map with the opacity map as its alpha; white without one. `None` where the two differ in size or in how they
    /// lie. An opacity map with an alpha channel means that, any other its red.
    pub(super) fn masked(
        &mut self,
        material: &str,
        color: Option<&Statement>,
        opacity: &Statement,
    ) -> Result<Option<TextureSlot>> {
        if color.is_some_and(|c| !c.lies_like(opacity)) {
            return Ok(None);
        }
        let path = self.path(material, opacity)?;
        let color = color.map(|c| self.path(material, c)).transpose()?;
        let key = Key { files: [color, Some(path.clone())], what: What::Masked, wrap: opacity.wrap() };
        let (files, budget) = (key.files.clone(), self.budget);
        let texture = self.once(key, || {
            let color = match &files[0] {
                Some(path) => Some(rgba8(material, path, budget)?.0),
                None => None,
            };
            let (mask, has_alpha) = rgba8(material, &path, budget)?;
            let white = || RgbaImage::from_pixel(mask.width(), mask.height(), image::Rgba([255; 4]));
            let mut image = color.unwrap_or_else(white);
            if image.dimensions() != mask.dimensions() {
                return Ok(None);
            }
            image.pixels_mut().zip(mask.pixels()).for_each(|(texel, mask)| texel.0[3] = mask.0[if has_alpha { 3 } else { 0 }]);
            Ok(Some(whole(opacity, image, Encoding::Srgb)))
        })?;
        Ok(texture.map(|texture| TextureSlot { texture, uv_transform: opacity.uv_transform(), set: 0 }))
    }

    /// glTF's layout (G = roughness, B = metallic) from one or two grey maps; `None` without any, or where the two differ in size
    /// or in how they lie.
    pub(super) fn metallic_roughness(
        &mut self,
        material: &str,
        rough: Option<&Statement>,
        metal: Option<&Statement>,
    ) -> Result<Option<TextureSlot>> {
        let Some(first) = rough.or(metal) else { return Ok(None) };
        if metal.is_some_and(|m| !m.lies_like(first)) {
            return Ok(None);
        }
        let path = |s: Option<&Statement>| s.map(|s| self.path(material, s)).transpose();
        let files = [path(rough)?, path(metal)?];
        let key = Key { files: files.clone(), what: What::MetallicRoughness, wrap: first.wrap() };
        let budget = self.budget;
        let texture = self.once(key, || {
            let mut image: Option<RgbaImage> = None;
            for (channel, path) in [1, 2].into_iter().zip(&files) {
                let Some(path) = path else { continue };
                let grey = rgba8(material, path, budget)?.0;
                let image =
                    image.get_or_insert_with(|| RgbaImage::from_pixel(grey.width(), grey.height(), image::Rgba([255; 4])));
                if image.dimensions() != grey.dimensions() {
                    return Ok(None);
                }
                image.pixels_mut().zip(grey.pixels()).for_each(|(texel, grey)| texel.0[channel] = grey.0[0]);
            }
            Ok(image.map(|image| whole(first, image, Encoding::Linear)))
        })?;
        Ok(texture.map(|texture| TextureSlot { texture, uv_transform: first.uv_transform(), set: 0 }))
    }

    fn path(&self, material: &str, statement: &Statement) -> Result<PathBuf> {
        let path = self.reach.resolve(&statement.file.replace('\\', "/"));
        let path = path.map_err(|reason| Error::Name { reason: format!("material {material:?}: {reason}") })?;
        // It is read at once, or the load fails.
        self.reach.note(&path);
        Ok(path)
    }

    /// Index of the texture that `key` names, made by `make` at its first use.
    fn once(&mut self, key: Key, make: impl FnOnce() -> Result<Option<Texture>>) -> Result<Option<usize>> {
        if let Some(&known) = self.known.get(&key) {
            return Ok(Some(known));
        }
        let Some(made) = make()? else { return Ok(None) };
        self.list.push(made);
        self.known.insert(key, self.list.len() - 1);
        Ok(Some(self.list.len() - 1))
    }
}

fn failure(material: &str, path: &Path, reason: String) -> Error {
    Error::Texture { user: format!("material {material:?}"), path: path.into(), reason }
}

/// Texels of an image file, and whether it has an alpha channel.
fn rgba8(material: &str, path: &Path, budget: &Budget) -> Result<(RgbaImage, bool)> {
    let decoded = texture::read(path).and_then(|bytes| texture::decode_rgba8(&bytes, &path.display().to_string(), budget));
    decoded.map_err(|reason| failure(material, path, reason))
}

fn whole(statement: &Statement, image: RgbaImage, encoding: Encoding) -> Texture {
    let size = [image.width() as usize, image.height() as usize];
    let texels = image.pixels().map(|p| p.0).collect();
    Texture::from_rgba8(statement.file.clone(), size, texels, encoding, [statement.wrap(); 2])
}

/// A texture statement (`-s 2 2 -clamp on wood.png`; MTL specification, "Texture map statements").
#[derive(Debug, PartialEq)]
pub(super) struct Statement {
    file: String,
    scale: Vec2,
    offset: Vec2,
    clamp: bool,
    /// Strength of a normal map.
    pub(super) bump: f32,
}

impl Statement {
    /// Options stand before the file name, which may hold blanks; some exporters write them behind it.
    pub(super) fn parse(text: &str) -> Self {
        let mut statement = Self { file: String::new(), scale: Vec2::ONE, offset: Vec2::ZERO, clamp: false, bump: 1.0 };
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
                "-clamp" => statement.clamp = values == ["on"],
                "-bm" => statement.bump = number(0).unwrap_or(1.0),
                "-o" => statement.offset = Vec2::new(number(0).unwrap_or(0.0), number(1).unwrap_or(0.0)),
                "-s" => statement.scale = Vec2::new(number(0).unwrap_or(1.0), number(1).unwrap_or(1.0)),
                _ => {}
            }
        }
        statement.file = file.join(" ");
        statement
    }

    /// Does the image lie on the surface as that of `other` does?
    fn lies_like(&self, other: &Self) -> bool {
        (self.scale, self.offset, self.clamp) == (other.scale, other.offset, other.clamp)
    }

    fn wrap(&self) -> Wrap {
        if self.clamp { Wrap::Clamp } else { Wrap::Repeat }
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
    fn texture_statements() {
        let plain = Statement { file: "a b.png".into(), scale: Vec2::ONE, offset: Vec2::ZERO, clamp: false, bump: 1.0 };
        assert_eq!(Statement::parse("a b.png"), plain);
        let statement = Statement::parse("-s 2 3 -o 0.5 -clamp on -mm 0 1 wood.png -bm 1.5");
        let expected = Statement {
            file: "wood.png".into(),
            scale: Vec2::new(2.0, 3.0),
            offset: Vec2::new(0.5, 0.0),
            clamp: true,
            bump: 1.5,
        };
        assert_eq!(statement, expected);
        // The point (0.25, 0.25) of the file, v up, looks at (1, 0.75) v up.
        let uv = statement.uv_transform().transform_point2(Vec2::new(0.25, 0.75));
        assert!(uv.distance(Vec2::new(1.0, 0.25)) < 1e-6, "{uv}");
    }
}
