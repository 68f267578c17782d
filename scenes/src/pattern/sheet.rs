//! From what a pattern says about a place to the three maps of a material.

use super::field;
use crate::mipmap::srgb_byte;

/// Where a texel lies.
#[derive(Clone, Copy)]
pub(super) struct Place {
    /// Column and row.
    pub x: usize,
    pub y: usize,
    /// Middle of the texel, 0..1; v runs down.
    pub u: f64,
    pub v: f64,
    /// Width of a texel.
    pub texel: f64,
}

/// What a surface is at a place.
#[derive(Clone, Copy)]
pub(super) struct Spot {
    /// Linear Rec.709, 0..=1; clamped.
    pub color: [f64; 3],
    /// 0..=1 between the pattern's smoothest and roughest; clamped.
    pub rough: f64,
    /// 0..=1; clamped.
    pub metallic: f64,
    /// 0..=1 of the pattern's depth; not clamped.
    pub height: f64,
}

/// One kind's parameters that all kinds have.
pub(super) struct Common {
    /// Texels along an edge.
    pub size: usize,
    pub roughness: [f64; 2],
    /// Depth of the relief in widths of the texture.
    pub depth: f64,
}

/// One of the three maps of a [`super::Pattern`].
#[derive(Clone, Debug, PartialEq)]
pub enum Map {
    /// The same everywhere; the decoded value (linear colour; 0, roughness, metallic; a direction).
    Constant([f32; 3]),
    /// RGBA, row by row from the top. Alpha is opaque, but in the colours of a pattern with holes.
    Bytes(Vec<[u8; 4]>),
    /// RGBA of 16 bits, as above.
    Words(Vec<[u16; 4]>),
}

/// The maps of a [`super::Pattern`], each of `size` by `size` texels; `None` where it was not asked for.
#[derive(Clone, Debug, PartialEq)]
pub struct Maps {
    /// Texels along an edge.
    pub size: usize,
    /// Base colour, RGB encoded with sRGB, 8 bits.
    pub base_color: Option<Map>,
    /// glTF's layout: green is roughness, blue metallic, 8 bits.
    pub metallic_roughness: Option<Map>,
    /// Tangent-space normals, OpenGL (+y up), 16 bits: 8 show steps on polished metal.
    pub normal: Option<Map>,
}

/// Which maps to make: base colour, roughness with metallic, normals.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MapSet {
    /// Base colour.
    pub base_color: bool,
    /// Roughness and metallic.
    pub metallic_roughness: bool,
    /// Normals.
    pub normal: bool,
}

impl MapSet {
    /// All of them.
    pub const ALL: Self = Self { base_color: true, metallic_roughness: true, normal: true };
}

impl Common {
    /// The maps of a surface.
    pub fn maps(&self, wanted: MapSet, spot: impl Fn(Place) -> Spot) -> Maps {
        self.maps_with_alpha(wanted, |place| (spot(place), 1.0))
    }

    /// As [`Self::maps`] for a surface with holes, where the second number is less than 1.
    pub fn maps_with_alpha(&self, wanted: MapSet, spot: impl Fn(Place) -> (Spot, f64)) -> Maps {
        let n = self.size;
        let room = |yes: bool| if yes { n * n } else { 0 };
        let mut colors = Vec::with_capacity(room(wanted.base_color));
        let mut surfaces = Vec::with_capacity(room(wanted.metallic_roughness));
        let bumpy = wanted.normal && self.depth > 0.0;
        let mut heights = Vec::with_capacity(room(bumpy));
        let texel = 1.0 / n as f64;
        for y in 0..n {
            for x in 0..n {
                let (spot, alpha) = spot(Place { x, y, u: (x as f64 + 0.5) * texel, v: (y as f64 + 0.5) * texel, texel });
                if wanted.base_color {
                    let [r, g, b] = spot.color.map(|v| srgb_byte(v as f32));
                    colors.push([r, g, b, byte(alpha)]);
                }
                if wanted.metallic_roughness {
                    let rough = field::mix(self.roughness[0], self.roughness[1], spot.rough.clamp(0.0, 1.0));
                    surfaces.push([255, byte(rough), byte(spot.metallic), 255]);
                }
                if bumpy {
                    heights.push(spot.height);
                }
            }
        }
        let unit = |v: u8| f32::from(v) / 255.0;
        let base_color = wanted.base_color.then(|| {
            let linear = |t: [u8; 4]| [t[0], t[1], t[2]].map(|v| renderflow_frame::color::srgb_to_linear(unit(v)));
            even(&colors).map(linear).map_or(Map::Bytes(colors), Map::Constant)
        });
        let metallic_roughness = wanted
            .metallic_roughness
            .then(|| even(&surfaces).map(|t| [0.0, unit(t[1]), unit(t[2])]).map_or(Map::Bytes(surfaces), Map::Constant));
        let normal = wanted.normal.then(|| {
            let flat = heights.windows(2).all(|h| h[0] == h[1]);
            if flat { Map::Constant([0.0, 0.0, 1.0]) } else { Map::Words(normals(n, &heights, self.depth)) }
        });
        Maps { size: n, base_color, metallic_roughness, normal }
    }
}

/// The value that all texels have.
fn even(texels: &[[u8; 4]]) -> Option<[u8; 4]> {
    let first = *texels.first()?;
    texels.iter().all(|t| *t == first).then_some(first)
}

fn byte(v: f64) -> u8 {
    (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}

/// Normals of a height field that repeats: heights times `depth`, both in widths of the texture, differences of both neighbours.
pub(super) fn normals(n: usize, heights: &[f64], depth: f64) -> Vec<[u16; 4]> {
    // A difference over two texels.
    let slope = 0.5 * depth * n as f64;
    let mut texels = Vec::with_capacity(n * n);
    for y in 0..n {
        let row = |y: usize| &heights[y % n * n..][..n];
        let (above, here, below) = (row(y + n - 1), row(y), row(y + 1));
        for x in 0..n {
            let (left, right) = (here[if x == 0 { n - 1 } else { x - 1 }], here[if x + 1 == n { 0 } else { x + 1 }]);
            // v runs down the image, the green of a normal map points up.
            let (nx, ny) = (-slope * (right - left), slope * (below[x] - above[x]));
            let scale = 1.0 / (nx * nx + ny * ny + 1.0).sqrt();
            let word = |v: f64| ((0.5 + 0.5 * v.clamp(-1.0, 1.0)) * 65535.0 + 0.5) as u16;
            texels.push([word(nx * scale), word(ny * scale), word(scale), u16::MAX]);
        }
    }
    texels
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ground that rises along v, which runs down the image: the normal leans back up, where green points.
    #[test]
    fn green_points_up_the_image() {
        let n = 8;
        let heights: Vec<f64> = (0..n * n).map(|i| field::wave((i / n) as f64 / n as f64)).collect();
        let texels = normals(n, &heights, 0.1);
        let green = |y: usize| f64::from(texels[y * n][1]) / 32767.5 - 1.0;
        // Steepest at row 0: the difference over two of eight rows of a sine is 2 sin(45 degrees).
        let slope = 0.5 * 0.1 * 8.0 * std::f64::consts::SQRT_2;
        assert!((green(0) - slope / (1.0 + slope * slope).sqrt()).abs() < 1e-4, "{}", green(0));
        assert!((green(4) + green(0)).abs() < 1e-4 && green(2).abs() < 1e-4);
        assert!(texels.iter().all(|t| t[0].abs_diff(32768) <= 1));
    }
}
