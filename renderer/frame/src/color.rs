//! Colour curves between scene-linear Rec.709, the display, and the spaces networks work in.

use glam::{DMat3, DVec3};

/// Chromaticities (x, y) of the primaries of Rec.709 (ITU-R BT.709).
pub const REC709: [[f64; 2]; 3] = [[0.64, 0.33], [0.30, 0.60], [0.15, 0.06]];
/// Chromaticity (x, y) of D65, the white of Rec.709.
pub const D65: [f64; 2] = [0.3127, 0.3290];
/// The responses of Bradford's cones to XYZ (Lam 1985).
const BRADFORD: DMat3 = DMat3::from_cols(
    DVec3::new(0.8951, -0.7502, 0.0389),
    DVec3::new(0.2664, 1.7135, -0.0685),
    DVec3::new(-0.1614, 0.0367, 1.0296),
);

/// XYZ of a colour of luminance `y` for the chromaticity (x, y).
fn xyz([x, y]: [f64; 2]) -> DVec3 {
    DVec3::new(x, y, 1.0 - x - y)
}

/// The matrix from linear RGB with these primaries and white (x, y) to XYZ, in which white has the luminance 1. It has infinite
/// or undefined numbers if the primaries lie on a line.
pub fn rgb_to_xyz(primaries: [[f64; 2]; 3], white: [f64; 2]) -> DMat3 {
    let primaries = DMat3::from_cols_array_2d(&primaries.map(|primary| xyz(primary).to_array()));
    let gains = primaries.inverse() * (xyz(white) / white[1]);
    primaries * DMat3::from_diagonal(gains)
}

/// The matrix from linear RGB with these primaries and white (x, y) to linear Rec.709: white stays white (Bradford's adaptation).
/// `None` if they make no space of colours.
pub fn rgb_to_rec709(primaries: [[f64; 2]; 3], white: [f64; 2]) -> Option<DMat3> {
    let [from, to] = [white, D65].map(|white| BRADFORD * (xyz(white) / white[1]));
    let adapted = BRADFORD.inverse() * DMat3::from_diagonal(to / from) * BRADFORD;
    let matrix = rgb_to_xyz(REC709, D65).inverse() * adapted * rgb_to_xyz(primaries, white);
    matrix.is_finite().then_some(matrix).filter(|matrix| matrix.determinant().abs() > 1e-9)
}

/// sRGB transfer function (IEC 61966-2-1) of a linear value; the value should lie in 0..=1, and the curve continues smoothly
/// above 1.
pub fn linear_to_srgb(linear: f32) -> f32 {
    if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}

/// Inverse of [`linear_to_srgb`].
pub fn srgb_to_linear(srgb: f32) -> f32 {
    if srgb <= 0.040_45 { srgb / 12.92 } else { ((srgb + 0.055) / 1.055).powf(2.4) }
}

/// The display value, on which every metric is computed: sRGB(clamp(exposure * linear, 0, 1)).
pub fn display(linear: [f32; 3], exposure: f32) -> [f32; 3] {
    linear.map(|v| linear_to_srgb((exposure * v).clamp(0.0, 1.0)))
}

/// Extended Reinhard curve (Reinhard 2002, eq. 4) with white point `white`.
pub fn reinhard(linear: f32, white: f32) -> f32 {
    linear * (1.0 + linear / (white * white)) / (1.0 + linear)
}

/// Rec.709 luminance of a linear colour.
pub fn luminance(rgb: [f32; 3]) -> f32 {
    0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2]
}
