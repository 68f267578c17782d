//! Colour curves between scene-linear Rec.709, the display, and the spaces networks work in.

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
