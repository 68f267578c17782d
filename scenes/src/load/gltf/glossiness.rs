//! Materials of KHR_materials_pbrSpecularGlossiness, turned into metallic and roughness by Khronos' own conversion (the script
//! convert-between-workflows of the extension's folder).

use super::material::{References, array, finite};
use crate::loaded::{Encoding, Texture, Wrap};
use crate::mipmap::{Texels, decode};
use glam::Vec3;
use renderflow_frame::color::linear_to_srgb;
use serde_json::Value;

/// Reflectance at normal incidence of what is no metal.
const DIELECTRIC: f32 = 0.04;

/// The factors of a material.
#[derive(Clone, Copy, Debug)]
pub(super) struct Glossiness {
    /// Diffuse colour and opacity.
    pub diffuse: [f32; 4],
    specular: [f32; 3],
    glossiness: f32,
}

impl Glossiness {
    pub(super) fn read(extension: &Value) -> Self {
        Self {
            diffuse: array(extension.get("diffuseFactor"), 1.0),
            specular: array(extension.get("specularFactor"), 1.0),
            glossiness: finite(extension.get("glossinessFactor")).map_or(1.0, |v| v.clamp(0.0, 1.0)),
        }
    }

    /// Base colour, metallic and roughness.
    pub(super) fn factors(&self) -> ([f32; 3], f32, f32) {
        let [r, g, b, _] = self.diffuse;
        convert(Vec3::new(r, g, b), Vec3::from(self.specular), self.glossiness)
    }

    /// Whether the conversion is the same at every point: no metal anywhere, and no texture but the diffuse one.
    pub(super) fn is_even(&self, textures: &References) -> bool {
        textures.specular.is_none() && (textures.color.is_none() || brightness(Vec3::from(self.specular)) < DIELECTRIC)
    }

    /// Textures of base colour and of roughness and metallic, whose factors are 1, from the textures of the extension. They are
    /// as large as the larger of the two. Wraps are those of the first.
    pub(super) fn textures(&self, diffuse: Option<&Texture>, specular: Option<&Texture>, name: &str) -> [Texture; 2] {
        let [diffuse, specular] = [diffuse, specular].map(|texture| texture.map(Pixels::new));
        let sizes = [&diffuse, &specular].map(|pixels| pixels.as_ref().map_or([1, 1], |pixels| pixels.size));
        let [width, height] = if sizes[0][0] * sizes[0][1] >= sizes[1][0] * sizes[1][1] { sizes[0] } else { sizes[1] };
        let wrap = diffuse.as_ref().or(specular.as_ref()).map_or([Wrap::Repeat; 2], |pixels| pixels.wrap);
        let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
        let [mut colors, mut data] = [0, 1].map(|_| Vec::with_capacity(width * height));
        for at in 0..width * height {
            let place = [at % width, at / width];
            let texel = |pixels: &Option<Pixels>| pixels.as_ref().map_or([1.0; 4], |p| p.texel(place, [width, height]));
            let (d, s) = (texel(&diffuse), texel(&specular));
            let times = |texel: [f32; 4], factor: [f32; 3]| Vec3::new(texel[0], texel[1], texel[2]) * Vec3::from(factor);
            // The factor of alpha stays with the material.
            let [r, g, b, _] = self.diffuse;
            let gloss = s[3] * self.glossiness;
            let (color, metallic, roughness) = convert(times(d, [r, g, b]), times(s, self.specular), gloss);
            let [r, g, b] = color.map(|v| byte(linear_to_srgb(v)));
            colors.push([r, g, b, byte(d[3])]);
            data.push([255, byte(roughness), byte(metallic), 255]);
        }
        let made = |what: &str, texels, encoding| {
            Texture::from_rgba8(format!("{name} ({what})"), [width, height], texels, encoding, wrap)
        };
        [made("base colour", colors, Encoding::Srgb), made("metallic and roughness", data, Encoding::Linear)]
    }
}

/// The image of a texture, decoded.
struct Pixels<'a> {
    texels: &'a Texels,
    size: [usize; 2],
    wrap: [Wrap; 2],
    table: [f32; 256],
    encoding: Encoding,
}

impl<'a> Pixels<'a> {
    fn new(texture: &'a Texture) -> Self {
        let level = &texture.levels[0];
        let table = std::array::from_fn(|i| decode(texture.encoding, i as f32 / 255.0));
        Self { texels: &level.texels, size: [level.width, level.height], wrap: texture.wrap, table, encoding: texture.encoding }
    }

    /// The texel nearest to the middle of one at `place` in an image of `size`.
    fn texel(&self, place: [usize; 2], size: [usize; 2]) -> [f32; 4] {
        let [x, y] = [0, 1].map(|axis| (2 * place[axis] + 1) * self.size[axis] / (2 * size[axis]));
        let at = y * self.size[0] + x;
        match self.texels {
            Texels::Bytes(texels) => {
                let [r, g, b, a] = texels[at];
                let color = |v: u8| self.table[usize::from(v)];
                [color(r), color(g), color(b), f32::from(a) / 255.0]
            }
            Texels::Words(texels) => {
                let [r, g, b, a] = texels[at].map(|v| f32::from(v) / 65535.0);
                let color = |v: f32| decode(self.encoding, v);
                [color(r), color(g), color(b), a]
            }
        }
    }
}

/// Base colour, metallic and roughness of a diffuse and a specular colour, linear, and a glossiness.
fn convert(diffuse: Vec3, specular: Vec3, glossiness: f32) -> ([f32; 3], f32, f32) {
    let rest = 1.0 - specular.max_element();
    let metallic = metallic(brightness(diffuse), brightness(specular), rest);
    let from_diffuse = diffuse * (rest / (1.0 - DIELECTRIC) / (1.0 - metallic).max(1e-6));
    let from_specular = (specular - DIELECTRIC * (1.0 - metallic)) / metallic.max(1e-6);
    let color = from_diffuse.lerp(from_specular, metallic * metallic).clamp(Vec3::ZERO, Vec3::ONE);
    (color.to_array(), metallic, (1.0 - glossiness).clamp(0.0, 1.0))
}

/// The share of metal for which a mixture of metal and of what is none has these brightnesses.
fn metallic(diffuse: f32, specular: f32, rest: f32) -> f32 {
    if specular < DIELECTRIC {
        return 0.0;
    }
    let a = DIELECTRIC;
    let b = diffuse * rest / (1.0 - DIELECTRIC) + specular - 2.0 * DIELECTRIC;
    let c = DIELECTRIC - specular;
    ((-b + (b * b - 4.0 * a * c).max(0.0).sqrt()) / (2.0 * a)).clamp(0.0, 1.0)
}

/// How bright a colour looks.
fn brightness(color: Vec3) -> f32 {
    (color * color).dot(Vec3::new(0.299, 0.587, 0.114)).sqrt()
}
