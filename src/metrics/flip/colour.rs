//! Colour spaces of FLIP.

use glam::{DMat3, DVec3, Mat3, Vec3};
use renderflow_frame::color;
use renderflow_frame::image::Rgb;

/// The white point that FLIP takes for D65.
const WHITE: [f64; 2] = [0.312_71, 0.329_02];

/// Linear Rec.709 to XYZ relative to white (white is (1, 1, 1)).
fn rgb_to_xyz() -> DMat3 {
    let matrix = color::rgb_to_xyz(color::REC709, WHITE);
    DMat3::from_diagonal((matrix * DVec3::ONE).recip()) * matrix
}

/// Linearised CIELAB (the paper's YCxCz) of XYZ relative to white, without the offset -16 of its first coordinate.
const OPPONENT: DMat3 =
    DMat3::from_cols(DVec3::new(0.0, 500.0, 0.0), DVec3::new(116.0, -500.0, 200.0), DVec3::new(0.0, 0.0, -200.0));

/// The three opponent planes of a picture of display values: lightness -16..=100, red-green, blue-yellow.
pub fn opponent(picture: &Rgb) -> [Vec<f32>; 3] {
    let matrix = (OPPONENT * rgb_to_xyz()).as_mat3();
    let mut planes: [Vec<f32>; 3] = std::array::from_fn(|_| Vec::with_capacity(picture.pixels.len()));
    for pixel in &picture.pixels {
        // `max` before `min`: NaN becomes 0.
        #[allow(clippy::manual_clamp)]
        let linear = pixel.map(|v| color::srgb_to_linear(v.max(0.0).min(1.0)));
        let value = matrix * Vec3::from_array(linear) - Vec3::new(16.0, 0.0, 0.0);
        planes.iter_mut().zip(value.to_array()).for_each(|(plane, v)| plane.push(v));
    }
    planes
}

/// CIELAB with Hunt's adjustment of every pixel of three opponent planes, colours that no screen shows clamped.
pub fn hunt_lab(opponent: &[Vec<f32>; 3]) -> Vec<[f32; 3]> {
    let to_xyz = rgb_to_xyz();
    let (to_linear, to_xyz) = ((OPPONENT * to_xyz).inverse().as_mat3(), to_xyz.as_mat3());
    let [light, red_green, blue_yellow] = opponent;
    let pixels = light.iter().zip(red_green).zip(blue_yellow);
    pixels
        .map(|((&y, &cx), &cz)| {
            let linear = (to_linear * Vec3::new(y + 16.0, cx, cz)).clamp(Vec3::ZERO, Vec3::ONE);
            adjusted(to_xyz * linear)
        })
        .collect()
}

/// CIELAB of XYZ relative to white, chroma scaled by lightness: it stands out more where it is bright (Hunt's effect).
fn adjusted(xyz: Vec3) -> [f32; 3] {
    const DELTA: f32 = 6.0 / 29.0;
    let f = |t: f32| if t > DELTA * DELTA * DELTA { t.cbrt() } else { t / (3.0 * DELTA * DELTA) + 4.0 / 29.0 };
    let [x, y, z] = xyz.to_array().map(f);
    let lightness = 116.0 * y - 16.0;
    [lightness, 0.01 * lightness * 500.0 * (x - y), 0.01 * lightness * 200.0 * (y - z)]
}

/// HyAB distance (Abasi et al. 2020): city block between lightness and chroma, Euclidean within chroma.
pub fn hyab(a: [f32; 3], b: [f32; 3]) -> f32 {
    (a[0] - b[0]).abs() + ((a[1] - b[1]).powi(2) + (a[2] - b[2]).powi(2)).sqrt()
}

/// The largest distance of two colours of a screen, that of green and blue.
pub fn largest_difference() -> f32 {
    let matrix: Mat3 = rgb_to_xyz().as_mat3();
    hyab(adjusted(matrix.y_axis), adjusted(matrix.z_axis))
}
