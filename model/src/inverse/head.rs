//! The buffers of a pixel from the outputs of the network, and the derivative.
//!
//! The albedo is `sigmoid((1 + gain) logit(picture) + offset)` in sRGB values. In the logit, light of another strength or colour
//! is about an offset, and the gain can take the picture away where it shows a reflection. Black and white have finite logits,
//! `ln((v + .02) / (1 - v + .02))`, so without offset and gain the albedo is `(v + .02) / 1.04`.

/// Numbers that the network predicts for a pixel: three offsets and a gain of the albedo, a vector along the normal, the
/// logarithm of depth, and three logits of the material.
pub const OUTPUTS: usize = 11;

/// Index of the gain.
const GAIN: usize = 3;
/// Index of the normal.
const NORMAL: usize = 4;
/// Index of the depth.
const DEPTH: usize = 7;
/// Index of the material.
const MATERIAL: usize = 8;

/// Logits of roughness, metallic and specular where the network predicts 0: few surfaces are metals.
const USUAL: [f32; 3] = [0.0, -2.0, 0.0];
/// Keeps the logits of black and white finite.
const MARGIN: f32 = 0.02;
/// Keeps the direction of a vector of length 0 finite.
const SHORTEST: f32 = 1e-6;

/// The buffers of a pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pixel {
    /// Base colour in sRGB, 0..=1.
    pub albedo: [f32; 3],
    /// Normal in camera space. It has the length 1, or less where the network is undecided.
    pub normal: [f32; 3],
    /// Half the logarithm of depth, up to a shift.
    pub depth: f32,
    /// Roughness, metallic, specular, 0..=1.
    pub material: [f32; 3],
}

fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

fn logit(display: f32) -> f32 {
    ((display + MARGIN) / (1.0 - display + MARGIN)).ln()
}

/// The vector that is normalised, and its length.
fn vector(outputs: &[f32]) -> ([f32; 3], f32) {
    let v = [outputs[NORMAL], outputs[NORMAL + 1], outputs[NORMAL + 2] + 1.0];
    (v, (v.iter().map(|v| v * v).sum::<f32>() + SHORTEST).sqrt())
}

impl Pixel {
    /// From the [`OUTPUTS`] numbers of a pixel that shows `display`, 0..=1.
    pub fn new(display: [f32; 3], outputs: &[f32]) -> Self {
        let (v, length) = vector(outputs);
        Self {
            albedo: std::array::from_fn(|c| sigmoid((1.0 + outputs[GAIN]) * logit(display[c]) + outputs[c])),
            normal: v.map(|v| v / length),
            depth: outputs[DEPTH],
            material: std::array::from_fn(|c| sigmoid(outputs[MATERIAL + c] + USUAL[c])),
        }
    }

    /// Writes the derivative with respect to the outputs to `slopes`. `along` is the derivative with respect to the buffers of
    /// this pixel, which [`Self::new`] computed from `display` and `outputs`.
    pub fn backward(&self, display: [f32; 3], outputs: &[f32], along: &Self, slopes: &mut [f32]) {
        slopes[GAIN] = 0.0;
        for c in 0..3 {
            slopes[c] = along.albedo[c] * self.albedo[c] * (1.0 - self.albedo[c]);
            slopes[GAIN] += slopes[c] * logit(display[c]);
            slopes[MATERIAL + c] = along.material[c] * self.material[c] * (1.0 - self.material[c]);
        }
        let (_, length) = vector(outputs);
        let dot: f32 = self.normal.iter().zip(along.normal).map(|(n, along)| n * along).sum();
        for c in 0..3 {
            slopes[NORMAL + c] = (along.normal[c] - dot * self.normal[c]) / length;
        }
        slopes[DEPTH] = along.depth;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    #[test]
    fn derivatives_agree_with_differences() {
        let mut rng = Pcg64Mcg::seed_from_u64(3);
        for _ in 0..50 {
            let display = [(); 3].map(|()| rng.random_range(0.0..1.0));
            let outputs: Vec<f32> = (0..OUTPUTS).map(|_| rng.random_range(-1.0..1.0)).collect();
            let mut draw = || [(); 3].map(|()| rng.random_range(-1.0..1.0_f32));
            let along = Pixel { albedo: draw(), normal: draw(), depth: draw()[0], material: draw() };
            let dot = |a: [f32; 3], b: [f32; 3]| -> f32 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
            let value = |outputs: &[f32]| {
                let found = Pixel::new(display, outputs);
                let depth = found.depth * along.depth;
                dot(found.albedo, along.albedo) + dot(found.normal, along.normal) + dot(found.material, along.material) + depth
            };
            let mut slopes = [0.0; OUTPUTS];
            Pixel::new(display, &outputs).backward(display, &outputs, &along, &mut slopes);
            for (i, slope) in slopes.into_iter().enumerate() {
                let moved = |step: f32| {
                    let mut moved = outputs.clone();
                    moved[i] += step;
                    value(&moved)
                };
                let expected = (moved(1e-2) - moved(-1e-2)) / 2e-2;
                assert!((slope - expected).abs() < 3e-3 * (1.0 + expected.abs()), "{i}: {slope} and {expected}");
            }
        }
    }

    #[test]
    fn the_untrained_albedo_is_the_picture() {
        for value in [0.1, 0.5, 0.9] {
            let found = Pixel::new([value; 3], &[0.0; OUTPUTS]);
            assert!(found.albedo.iter().all(|v| (v - value).abs() < 0.02), "{found:?}");
            assert!((found.normal[2] - 1.0).abs() < 1e-5);
        }
    }
}
