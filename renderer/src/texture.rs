//! Texture lookups: trilinear between mip levels, with the level chosen by the width of the ray's cone.

use crate::number::{log2, whole};
use crate::simd;
use glam::{Affine2, Vec2, Vec4};
use renderflow_scenes::TextureSlot;
use renderflow_scenes::loaded::{Texture, Wrap};
use renderflow_scenes::mipmap::{self, Level, Texels};

/// Share of 1 that every 8-bit value stands for.
const ALPHAS: [f32; 256] = {
    let mut values = [0.0; 256];
    let mut i = 0;
    while i < 256 {
        values[i] = i as f32 / 255.0;
        i += 1;
    }
    values
};

/// A texture with what decoding its texels needs.
#[derive(Clone, Debug)]
pub(crate) struct Sampled {
    texture: Texture,
    /// Colour of every 8-bit value; unused for 16 bits.
    decode: Box<[f32; 256]>,
    /// `log2` of the image's edge length, the geometric mean of width and height: level of a footprint of one tile.
    size_log2: f32,
}

/// Where and how finely a texture is looked up.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lookup {
    /// Coordinates of the mesh, before the slot's transform.
    pub uv: Vec2,
    /// `log2` of the footprint's width in mesh coordinates; `NEG_INFINITY` = the image itself.
    pub footprint_log2: f32,
}

impl Lookup {
    /// Where nothing is looked up.
    pub const NOWHERE: Self = Self { uv: Vec2::ZERO, footprint_log2: f32::NEG_INFINITY };

    /// The image itself at `uv`.
    pub fn sharp(uv: Vec2) -> Self {
        Self { uv, ..Self::NOWHERE }
    }
}

impl Sampled {
    pub fn new(texture: &Texture) -> Self {
        let decode = Box::new(ALPHAS.map(|value| mipmap::decode(texture.encoding, value)));
        let area = texture.levels.first().map_or(1.0, |l| l.width as f32 * l.height as f32);
        Self { texture: texture.clone(), decode, size_log2: 0.5 * area.log2() }
    }

    /// Value at `lookup` through `slot`: decoded colour and alpha. White where the texture is empty.
    #[inline]
    pub fn value(&self, slot: &TextureSlot, lookup: Lookup) -> Vec4 {
        simd::run(Value { texture: self, slot, lookup })
    }

    #[inline(always)]
    fn value_here(&self, slot: &TextureSlot, lookup: Lookup) -> Vec4 {
        let levels = &self.texture.levels;
        if levels.is_empty() {
            return Vec4::ONE;
        }
        let uv = slot.uv_transform.transform_point2(lookup.uv);
        let level = lookup.footprint_log2 + self.size_log2 + scale_log2(&slot.uv_transform);
        // A NaN reads the image itself.
        if level.is_nan() || level <= 0.0 {
            return self.bilinear(&levels[0], uv);
        }
        let last = levels.len() - 1;
        let lower = whole(level).min(last);
        let coarse = self.bilinear(&levels[(lower + 1).min(last)], uv);
        self.bilinear(&levels[lower], uv).lerp(coarse, (level - lower as f32).min(1.0))
    }

    /// Alpha of the image itself at `uv`, 0..=1.
    #[inline]
    pub fn alpha(&self, slot: &TextureSlot, uv: Vec2) -> f32 {
        self.texture.levels.first().map_or(1.0, |level| self.bilinear(level, slot.uv_transform.transform_point2(uv)).w)
    }

    /// Bilinear value of one level; texel centres lie at half-integers. Coordinates that are not finite read the first texel.
    #[inline(always)]
    fn bilinear(&self, level: &Level, uv: Vec2) -> Vec4 {
        let (x0, x1, fx) = taps(uv.x, level.width, self.texture.wrap[0]);
        let (y0, y1, fy) = taps(uv.y, level.height, self.texture.wrap[1]);
        let texel = |x: usize, y: usize| self.texel(level, y * level.width + x);
        let top = texel(x0, y0).lerp(texel(x1, y0), fx);
        let bottom = texel(x0, y1).lerp(texel(x1, y1), fx);
        top.lerp(bottom, fy)
    }

    #[inline(always)]
    fn texel(&self, level: &Level, at: usize) -> Vec4 {
        match &level.texels {
            Texels::Bytes(texels) => {
                let [r, g, b, a] = texels[at].map(usize::from);
                Vec4::new(self.decode[r], self.decode[g], self.decode[b], ALPHAS[a])
            }
            Texels::Words(texels) => {
                let [r, g, b, a] = texels[at].map(|v| f32::from(v) / 65535.0);
                let decode = |v| mipmap::decode(self.texture.encoding, v);
                Vec4::new(decode(r), decode(g), decode(b), a)
            }
        }
    }

    /// Lowest alpha of the image, 0..=1; between texels it is never lower.
    pub fn lowest_alpha(&self) -> f32 {
        match self.texture.levels.first().map(|level| &level.texels) {
            Some(Texels::Bytes(texels)) => texels.iter().map(|t| t[3]).min().map_or(1.0, |a| f32::from(a) / 255.0),
            Some(Texels::Words(texels)) => texels.iter().map(|t| t[3]).min().map_or(1.0, |a| f32::from(a) / 65535.0),
            None => 1.0,
        }
    }
}

/// The arguments of [`Sampled::value`].
struct Value<'a> {
    texture: &'a Sampled,
    slot: &'a TextureSlot,
    lookup: Lookup,
}

impl simd::Work for Value<'_> {
    type Output = Vec4;
    #[inline(always)]
    fn run(self) -> Vec4 {
        self.texture.value_here(self.slot, self.lookup)
    }
}

/// `log2` of the factor by which a transform scales lengths, on average over directions.
fn scale_log2(transform: &Affine2) -> f32 {
    if *transform == Affine2::IDENTITY { 0.0 } else { 0.5 * log2(transform.matrix2.determinant().abs()) }
}

/// The two texels around coordinate `u` (1 = one tile) and the weight of the second.
#[inline(always)]
fn taps(u: f32, size: usize, wrap: Wrap) -> (usize, usize, f32) {
    // Wrapping before scaling keeps the fraction's precision far from the origin; a tile of a mirrored texture is two wide.
    let n = size as f32;
    let (position, period) = match wrap {
        Wrap::Repeat => ((u - u.floor()) * n, size),
        Wrap::Mirror => (u.rem_euclid(2.0) * n, 2 * size),
        Wrap::Clamp => (u.clamp(0.0, 1.0) * n, size),
    };
    let position = if position.is_finite() { position - 0.5 } else { 0.0 };
    let base = position.floor();
    let index = |i: i64| match wrap {
        // Positions lie within half a texel of 0..=size.
        Wrap::Repeat => {
            (if i < 0 {
                i + size as i64
            } else if i >= size as i64 {
                i - size as i64
            } else {
                i
            }) as usize
        }
        Wrap::Mirror => {
            let i = i.rem_euclid(period as i64) as usize;
            if i < size { i } else { period - 1 - i }
        }
        Wrap::Clamp => i.clamp(0, size as i64 - 1) as usize,
    };
    (index(base as i64), index(base as i64 + 1), position - base)
}

#[cfg(test)]
mod tests {
    use super::*;
    use renderflow_scenes::loaded::Encoding;

    /// 4 x 2 texels, red = column, green = row, in 255ths.
    fn ramp(wrap: Wrap) -> Sampled {
        let texels = (0..8).map(|i| [i % 4, i / 4, 255, 255]).collect();
        Sampled::new(&Texture::from_rgba8("ramp", [4, 2], texels, Encoding::Linear, [wrap; 2]))
    }
    const IDENTITY: TextureSlot = TextureSlot { texture: 0, uv_transform: Affine2::IDENTITY, set: 0 };

    fn at(wrap: Wrap, u: f32, v: f32) -> [f32; 2] {
        let c = 255.0 * ramp(wrap).value(&IDENTITY, Lookup { uv: Vec2::new(u, v), footprint_log2: f32::NEG_INFINITY });
        [c.x, c.y].map(|v| (v * 1e4).round() / 1e4)
    }

    #[test]
    fn texel_centres_are_exact_and_between_is_linear() {
        assert_eq!(at(Wrap::Repeat, 0.125, 0.25), [0.0, 0.0]);
        assert_eq!(at(Wrap::Repeat, 0.375, 0.75), [1.0, 1.0]);
        assert_eq!(at(Wrap::Clamp, 0.5, 0.5), [1.5, 0.5]);
    }

    #[test]
    fn wraps() {
        // Half way between the last and the first texel.
        assert_eq!(at(Wrap::Repeat, 0.0, 0.25), [1.5, 0.0]);
        assert_eq!(at(Wrap::Repeat, 1.0, 0.25), [1.5, 0.0]);
        assert_eq!(at(Wrap::Clamp, -3.0, 0.25), [0.0, 0.0]);
        assert_eq!(at(Wrap::Clamp, 9.0, 9.0), [3.0, 1.0]);
        assert_eq!(at(Wrap::Mirror, 0.0, 0.25), [0.0, 0.0]);
        assert_eq!(at(Wrap::Mirror, 1.125, 0.25), [3.0, 0.0]);
        assert_eq!(at(Wrap::Mirror, -0.375, 0.25), [1.0, 0.0]);
    }

    #[test]
    fn strange_coordinates_do_not_panic() {
        for wrap in [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp] {
            for u in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e30, -1e30, -1e-30, -1e-8] {
                for footprint_log2 in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 0.0, 200.0] {
                    let value = ramp(wrap).value(&IDENTITY, Lookup { uv: Vec2::splat(u), footprint_log2 });
                    assert!(value.is_finite(), "{wrap:?} {u} {footprint_log2}");
                }
            }
        }
    }

    #[test]
    fn transform_is_applied() {
        let uv_transform = Affine2::from_scale_angle_translation(Vec2::new(2.0, 1.0), 0.0, Vec2::new(0.125, 0.25));
        let slot = TextureSlot { texture: 0, uv_transform, set: 0 };
        let lookup = Lookup { uv: Vec2::new(0.125, 0.0), footprint_log2: f32::NEG_INFINITY };
        assert_eq!(255.0 * ramp(Wrap::Repeat).value(&slot, lookup).x, 1.0);
    }

    #[test]
    fn wide_footprints_read_means_and_levels_blend() {
        let texture = ramp(Wrap::Repeat);
        let red = |footprint: f32| {
            255.0 * texture.value(&IDENTITY, Lookup { uv: Vec2::new(0.3, 0.4), footprint_log2: footprint.log2() }).x
        };
        // A footprint of the whole tile: the mean of 0, 1, 2, 3, stored in 8 bits.
        assert!((red(1e6) - 1.5).abs() <= 1.0, "{}", red(1e6));
        // Texels are 1 / sqrt(8) of a tile wide; below that the image itself is read.
        assert_eq!(red(0.3), red(1e-9));
        let (fine, coarse) = (red(0.36), red(0.70));
        let between = red((0.36f32 * 0.70).sqrt());
        assert!((between - 0.5 * (fine + coarse)).abs() < 0.2, "{fine} {between} {coarse}");
    }
}
