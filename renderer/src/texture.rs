//! Texture lookups: trilinear between mip levels, with the level chosen by the width of the ray's cone.

use crate::number::{log2, whole};
use crate::simd;
use glam::{Affine2, Vec2, Vec4};
use renderflow_scenes::TextureSlot;
use renderflow_scenes::loaded::{Encoding, Texture, Wrap};
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
    /// Colour of every 8-bit value; used for sRGB of 8 bits only.
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
        self.read::<true>(&self.place(slot, lookup))
    }

    /// Whether every look-up through `slot` is at the place of one in `other` through `other_slot`.
    pub fn shares_places(&self, slot: &TextureSlot, (other, other_slot): (&Self, &TextureSlot)) -> bool {
        let sizes = |sampled: &Self| sampled.texture.levels.iter().map(|level| (level.width, level.height)).collect::<Vec<_>>();
        *slot == TextureSlot { texture: slot.texture, ..other_slot.clone() }
            && self.texture.wrap == other.texture.wrap
            && sizes(self) == sizes(other)
    }

    /// The place of `lookup` through `slot`.
    #[inline]
    pub fn place(&self, slot: &TextureSlot, lookup: Lookup) -> Place {
        simd::run(Find { texture: self, slot, lookup })
    }

    #[inline(always)]
    fn place_here(&self, slot: &TextureSlot, lookup: Lookup) -> Place {
        let levels = &self.texture.levels;
        if levels.is_empty() {
            return Place::default();
        }
        let uv = slot.uv_transform.transform_point2(lookup.uv);
        let level = lookup.footprint_log2 + self.size_log2 + scale_log2(&slot.uv_transform);
        // A NaN reads the image itself.
        if level.is_nan() || level <= 0.0 {
            return Place { fine: self.taps(0, uv), ..Place::default() };
        }
        let last = levels.len() - 1;
        let lower = whole(level).min(last);
        let (fine, coarse) = (self.taps(lower, uv), self.taps((lower + 1).min(last), uv));
        Place { fine, coarse: Some((coarse, (level - lower as f32).min(1.0))) }
    }

    /// Texels of a level around `uv`; their centres lie at half-integers. Coordinates that are not finite read the first texel.
    #[inline(always)]
    fn taps(&self, level: usize, uv: Vec2) -> Taps {
        let Level { width, height, .. } = self.texture.levels[level];
        let (x0, x1, fx) = taps(uv.x, width, self.texture.wrap[0]);
        let (y0, y1, fy) = taps(uv.y, height, self.texture.wrap[1]);
        Taps { level, at: [y0 * width + x0, y0 * width + x1, y1 * width + x0, y1 * width + x1], fx, fy }
    }

    /// Decoded colour at a place, and alpha; without `ALPHA`, the fourth number may be any. White where the texture is empty.
    #[inline]
    pub fn read<const ALPHA: bool>(&self, place: &Place) -> Vec4 {
        simd::run(Read::<ALPHA> { texture: self, place })
    }

    #[inline(always)]
    fn read_here<const ALPHA: bool>(&self, place: &Place) -> Vec4 {
        if self.texture.levels.is_empty() {
            return Vec4::ONE;
        }
        let fine = self.bilinear::<ALPHA>(&place.fine);
        match &place.coarse {
            Some((coarse, share)) => fine.lerp(self.bilinear::<ALPHA>(coarse), *share),
            None => fine,
        }
    }

    /// Alpha of the image itself at `uv`, 0..=1.
    #[inline]
    pub fn alpha(&self, slot: &TextureSlot, uv: Vec2) -> f32 {
        if self.texture.levels.is_empty() {
            return 1.0;
        }
        self.bilinear::<true>(&self.taps(0, slot.uv_transform.transform_point2(uv))).w
    }

    /// Value between four texels.
    #[inline(always)]
    fn bilinear<const ALPHA: bool>(&self, taps: &Taps) -> Vec4 {
        let encoding = self.texture.encoding;
        // What is linear in the stored numbers is decoded after they are mixed.
        let linear = |mixed: Vec4, most: f32| {
            let shares = mixed / most;
            match encoding {
                Encoding::Normal => Vec4::from((2.0 * shares.truncate() - 1.0, shares.w)),
                _ => shares,
            }
        };
        match (&self.texture.levels[taps.level].texels, encoding) {
            (Texels::Bytes(texels), Encoding::Srgb) => taps.mix(|at| {
                let [r, g, b, a] = texels[at].map(usize::from);
                Vec4::new(self.decode[r], self.decode[g], self.decode[b], if ALPHA { ALPHAS[a] } else { 0.0 })
            }),
            (Texels::Bytes(texels), _) => linear(taps.mix(|at| Vec4::from(texels[at].map(f32::from))), 255.0),
            (Texels::Words(texels), Encoding::Srgb) => taps.mix(|at| {
                let [r, g, b, a] = texels[at].map(|v| f32::from(v) / 65535.0);
                let decode = |v| mipmap::decode(Encoding::Srgb, v);
                Vec4::new(decode(r), decode(g), decode(b), a)
            }),
            (Texels::Words(texels), _) => linear(taps.mix(|at| Vec4::from(texels[at].map(f32::from))), 65535.0),
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

/// Where a texture is read: in one level, or between two.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Place {
    fine: Taps,
    /// In the next coarser level, and its share.
    coarse: Option<(Taps, f32)>,
}

/// Four texels of a level, by rows, and the shares of the second column and row.
#[derive(Clone, Copy, Debug, Default)]
struct Taps {
    level: usize,
    at: [usize; 4],
    fx: f32,
    fy: f32,
}

impl Taps {
    /// The mean of the texels by their shares.
    #[inline(always)]
    fn mix(&self, texel: impl Fn(usize) -> Vec4) -> Vec4 {
        let [a, b, c, d] = self.at;
        let (top, bottom) = (texel(a).lerp(texel(b), self.fx), texel(c).lerp(texel(d), self.fx));
        top.lerp(bottom, self.fy)
    }
}

/// The arguments of [`Sampled::place`].
struct Find<'a> {
    texture: &'a Sampled,
    slot: &'a TextureSlot,
    lookup: Lookup,
}

impl simd::Work for Find<'_> {
    type Output = Place;
    #[inline(always)]
    fn run(self) -> Place {
        self.texture.place_here(self.slot, self.lookup)
    }
}

/// The arguments of [`Sampled::read`].
struct Read<'a, const ALPHA: bool> {
    texture: &'a Sampled,
    place: &'a Place,
}

impl<const ALPHA: bool> simd::Work for Read<'_, ALPHA> {
    type Output = Vec4;
    #[inline(always)]
    fn run(self) -> Vec4 {
        self.texture.read_here::<ALPHA>(self.place)
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
    fn texels_are_decoded() {
        for encoding in [Encoding::Srgb, Encoding::Linear, Encoding::Normal] {
            let (bytes, words) = ([0u8, 10, 128, 255], [0u16, 2570, 32896, 65535]);
            let images = [
                Texture::from_rgba8("bytes", [1, 1], vec![bytes], encoding, [Wrap::Clamp; 2]),
                Texture::from_rgba16("words", [1, 1], vec![words], encoding, [Wrap::Clamp; 2]),
            ];
            for texture in images {
                let value = Sampled::new(&texture).value(&IDENTITY, Lookup::sharp(Vec2::splat(0.3)));
                let wanted = [0.0, 10.0 / 255.0, 128.0 / 255.0].map(|v: f32| mipmap::decode(encoding, v));
                let far = value.truncate().to_array().iter().zip(wanted).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
                assert!(far < 3e-7 && (value.w - 1.0).abs() < 3e-7, "{encoding:?}, {}: {value}", texture.name);
            }
        }
    }

    #[test]
    fn a_place_serves_every_texture_that_shares_it() {
        let image = |size: [usize; 2], encoding, wrap| {
            let texels = (0..size[0] * size[1]).map(|i| [7 * i as u8, 255 - 5 * i as u8, 90, 255]).collect();
            Sampled::new(&Texture::from_rgba8("image", size, texels, encoding, wrap))
        };
        let usual = [Wrap::Repeat, Wrap::Mirror];
        let (color, normal) = (image([8, 4], Encoding::Srgb, usual), image([8, 4], Encoding::Normal, usual));
        let slot = TextureSlot { texture: 0, uv_transform: Affine2::from_scale(Vec2::new(3.0, 0.7)), set: 0 };
        let other = TextureSlot { texture: 1, ..slot.clone() };
        assert!(color.shares_places(&slot, (&normal, &other)));
        for (u, footprint_log2) in [(0.1, -9.0), (0.77, -1.5), (3.2, -0.4), (-0.6, 5.0), (0.5, f32::NAN)] {
            let lookup = Lookup { uv: Vec2::new(u, 0.3 * u), footprint_log2 };
            assert_eq!(normal.read::<true>(&color.place(&slot, lookup)), normal.value(&other, lookup), "{lookup:?}");
        }
        for (image, slot) in [
            (image([4, 8], Encoding::Normal, usual), other.clone()),
            (image([8, 4], Encoding::Normal, [Wrap::Repeat; 2]), other.clone()),
            (normal.clone(), TextureSlot { set: 1, ..other.clone() }),
            (normal.clone(), TextureSlot { uv_transform: Affine2::IDENTITY, ..other.clone() }),
        ] {
            assert!(!color.shares_places(
                &TextureSlot { uv_transform: Affine2::from_scale(Vec2::new(3.0, 0.7)), texture: 0, set: 0 },
                (&image, &slot)
            ));
        }
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
