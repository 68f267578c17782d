//! Texture lookups.

use glam::{Vec2, Vec3A};
use renderflow_frame::Image;
use renderflow_scenes::TextureSlot;
use renderflow_scenes::loaded::{Texture, Wrap};

/// Bilinear value of `slot` at the mesh coordinates `uv`; texel centres lie at half-integers. Coordinates that are not finite read
/// the first texel.
pub(crate) fn lookup(textures: &[Texture], slot: &TextureSlot, uv: Vec2) -> Vec3A {
    let Texture { image, wrap, .. } = &textures[slot.texture];
    if image.pixels.is_empty() {
        return Vec3A::ONE;
    }
    let uv = slot.uv_transform.transform_point2(uv);
    let (x0, x1, fx) = taps(uv.x, image.width, wrap[0]);
    let (y0, y1, fy) = taps(uv.y, image.height, wrap[1]);
    let texel = |x: usize, y: usize, image: &Image<[f32; 3]>| Vec3A::from_array(image.pixels[y * image.width + x]);
    let top = texel(x0, y0, image).lerp(texel(x1, y0, image), fx);
    let bottom = texel(x0, y1, image).lerp(texel(x1, y1, image), fx);
    top.lerp(bottom, fy)
}

/// The two texels around coordinate `u` (1 = one tile) and the weight of the second.
fn taps(u: f32, size: usize, wrap: Wrap) -> (usize, usize, f32) {
    // Wrapping before scaling keeps the fraction's precision far from the origin; a tile of a mirrored texture is two wide.
    let n = size as f32;
    let (position, period) = match wrap {
        Wrap::Repeat => (u.rem_euclid(1.0) * n, size),
        Wrap::Mirror => (u.rem_euclid(2.0) * n, 2 * size),
        Wrap::Clamp => (u.clamp(0.0, 1.0) * n, size),
    };
    let position = if position.is_finite() { position - 0.5 } else { 0.0 };
    let base = position.floor();
    let index = |i: i64| match wrap {
        Wrap::Repeat => i.rem_euclid(period as i64) as usize,
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

    fn texture(wrap: Wrap) -> Vec<Texture> {
        let image = Image::from_fn(4, 2, |x, y| [x as f32, y as f32, 1.0]);
        vec![Texture { name: "ramp".into(), image, wrap: [wrap; 2] }]
    }
    fn at(wrap: Wrap, u: f32, v: f32) -> [f32; 2] {
        let slot = TextureSlot { texture: 0, uv_transform: glam::Affine2::IDENTITY };
        let c = lookup(&texture(wrap), &slot, Vec2::new(u, v));
        [c.x, c.y]
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
            for u in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e30, -1e30, -1e-30] {
                assert!(at(wrap, u, u).iter().all(|v| v.is_finite()), "{wrap:?} {u}");
            }
        }
    }

    #[test]
    fn transform_is_applied() {
        let slot = TextureSlot {
            texture: 0,
            uv_transform: glam::Affine2::from_scale_angle_translation(Vec2::new(2.0, 1.0), 0.0, Vec2::new(0.125, 0.25)),
        };
        assert_eq!(lookup(&texture(Wrap::Repeat), &slot, Vec2::new(0.125, 0.0)).x, 1.0);
    }
}
