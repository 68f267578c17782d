//! The loss of one picture and its derivative. Its terms follow the errors by which recovered buffers are compared: PSNR of the
//! albedo, angles of normals, depth up to scale, and mean squares of the material.

use super::head::{OUTPUTS, Pixel};
use crate::Result;
use crate::train::config;
use serde::{Deserialize, Serialize};

/// Weights of the terms of the loss.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LossWeights {
    /// Absolute error of the albedo in sRGB.
    pub albedo: f32,
    /// Squared error of the albedo in sRGB.
    pub albedo_square: f32,
    /// Absolute error of the albedo's differences between neighbours.
    pub albedo_gradient: f32,
    /// Distance of the unit normals, which is about the angle between them.
    pub normal: f32,
    /// Absolute error of the normals' differences between neighbours.
    pub normal_gradient: f32,
    /// Absolute error of half the logarithm of depth after the best shift.
    pub depth: f32,
    /// Absolute error of the depth's differences between neighbours.
    pub depth_gradient: f32,
    /// Squared error of roughness.
    pub roughness: f32,
    /// Squared error of metallic.
    pub metallic: f32,
    /// Squared error of specular.
    pub specular: f32,
}

impl Default for LossWeights {
    fn default() -> Self {
        Self {
            albedo: 1.0,
            albedo_square: 3.0,
            albedo_gradient: 0.5,
            normal: 0.3,
            normal_gradient: 0.1,
            depth: 0.5,
            depth_gradient: 0.5,
            roughness: 1.5,
            metallic: 1.5,
            specular: 0.3,
        }
    }
}

impl LossWeights {
    /// Checks every weight.
    ///
    /// # Errors
    /// [`Error::Config`](crate::Error::Config) naming the first one that is not a number of at least 0.
    pub fn validate(&self) -> Result<()> {
        config::weights([
            ("loss.albedo", self.albedo),
            ("loss.albedo_square", self.albedo_square),
            ("loss.albedo_gradient", self.albedo_gradient),
            ("loss.normal", self.normal),
            ("loss.normal_gradient", self.normal_gradient),
            ("loss.depth", self.depth),
            ("loss.depth_gradient", self.depth_gradient),
            ("loss.roughness", self.roughness),
            ("loss.metallic", self.metallic),
            ("loss.specular", self.specular),
        ])
    }
}

/// True buffers of a pixel, and how much it counts.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Target {
    /// The buffers. The normal has the length 1, or 0 if it is not known.
    pub pixel: Pixel,
    /// Coverage, 0..=1.
    pub weight: f32,
}

/// Terms of the loss: means over the pixels that show a surface, weighted by coverage.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Loss {
    /// The loss that is minimised.
    pub total: f32,
    /// Mean squared error of the albedo in sRGB.
    pub albedo: f32,
    /// Mean distance of unit normals.
    pub normal: f32,
    /// Mean absolute error of half the logarithm of depth after the best shift.
    pub depth: f32,
    /// Mean squared errors of roughness, metallic and specular.
    pub material: [f32; 3],
}

/// Keeps the slope of a distance of 0 finite.
const NEAR: f32 = 1e-4;
/// Albedo, normal and depth of a pixel, whose differences between neighbours are compared.
const SMOOTH: usize = 7;

/// The loss of a picture of `width` columns that shows `display`, and its derivative with respect to `outputs`. `outputs` has
/// [`OUTPUTS`] numbers for each pixel, by rows.
pub fn loss(width: usize, display: &[[f32; 3]], outputs: &[f32], targets: &[Target], weights: &LossWeights) -> (Loss, Vec<f32>) {
    let found: Vec<Pixel> =
        display.iter().zip(outputs.chunks_exact(OUTPUTS)).map(|(display, outputs)| Pixel::new(*display, outputs)).collect();
    let sum: f64 = targets.iter().map(|target| f64::from(target.weight)).sum();
    let scale = 1.0 / sum.max(1e-6) as f32;
    // The shift of depth that the picture does not tell.
    let difference = |i: usize| found[i].depth - targets[i].pixel.depth;
    let shift = targets.iter().enumerate().map(|(i, target)| f64::from(target.weight * difference(i))).sum::<f64>();
    let shift = (shift * f64::from(scale)) as f32;

    let mut along = vec![Pixel::default(); found.len()];
    let mut errors = vec![[0.0; SMOOTH]; found.len()];
    let (mut total, mut terms, mut turn) = (0.0_f64, [0.0_f64; 6], 0.0_f64);
    let of_material = [weights.roughness, weights.metallic, weights.specular];
    for (i, target) in targets.iter().enumerate().filter(|(_, target)| target.weight > 0.0) {
        let (found, truth, along, part) = (&found[i], &target.pixel, &mut along[i], scale * target.weight);
        let mut add = |weight: f32, value: f32| total += f64::from(weight * part * value);
        for c in 0..3 {
            let e = found.albedo[c] - truth.albedo[c];
            errors[i][c] = e;
            terms[0] += f64::from(part * e * e / 3.0);
            add(weights.albedo, e.abs() / 3.0);
            add(weights.albedo_square, e * e / 3.0);
            along.albedo[c] = part / 3.0 * (weights.albedo * sign(e) + 2.0 * weights.albedo_square * e);
            let e = found.material[c] - truth.material[c];
            terms[3 + c] += f64::from(part * e * e);
            add(of_material[c], e * e);
            along.material[c] = 2.0 * part * of_material[c] * e;
        }
        if truth.normal != [0.0; 3] {
            let e: [f32; 3] = std::array::from_fn(|c| found.normal[c] - truth.normal[c]);
            errors[i][3..6].copy_from_slice(&e);
            let distance = (e.iter().map(|e| e * e).sum::<f32>() + NEAR).sqrt();
            terms[1] += f64::from(part * distance);
            add(weights.normal, distance);
            along.normal = e.map(|e| weights.normal * part * e / distance);
        }
        let e = difference(i) - shift;
        errors[i][6] = e;
        terms[2] += f64::from(part * e.abs());
        add(weights.depth, e.abs());
        along.depth = weights.depth * part * sign(e);
        turn += f64::from(along.depth);
    }
    // The shift depends on every depth.
    for (along, target) in along.iter_mut().zip(targets) {
        along.depth -= turn as f32 * scale * target.weight;
    }
    let of_smooth = |k: usize| match k {
        0..3 => weights.albedo_gradient / 3.0,
        3..6 => weights.normal_gradient / 3.0,
        _ => weights.depth_gradient,
    };
    let height = found.len() / width;
    for i in 0..found.len() {
        let right = (i % width + 1 < width).then_some(i + 1);
        let below = (i / width + 1 < height).then_some(i + width);
        for other in right.into_iter().chain(below) {
            let part = scale * targets[i].weight.min(targets[other].weight);
            if part <= 0.0 {
                continue;
            }
            let both = targets[i].pixel.normal != [0.0; 3] && targets[other].pixel.normal != [0.0; 3];
            for (k, (a, b)) in errors[i].into_iter().zip(errors[other]).enumerate() {
                if (3..6).contains(&k) && !both {
                    continue;
                }
                let e = a - b;
                let weight = part * of_smooth(k);
                total += f64::from(weight * e.abs());
                let slope = weight * sign(e);
                *smooth(&mut along[i], k) += slope;
                *smooth(&mut along[other], k) -= slope;
            }
        }
    }
    let mut slopes = vec![0.0; outputs.len()];
    for (i, slopes) in slopes.chunks_exact_mut(OUTPUTS).enumerate() {
        found[i].backward(display[i], &outputs[i * OUTPUTS..][..OUTPUTS], &along[i], slopes);
    }
    let [albedo, normal, depth, r, m, s] = terms.map(|term| term as f32);
    (Loss { total: total as f32, albedo, normal, depth, material: [r, m, s] }, slopes)
}

/// Number `k` of the [`SMOOTH`] numbers of a pixel.
fn smooth(pixel: &mut Pixel, k: usize) -> &mut f32 {
    match k {
        0..3 => &mut pixel.albedo[k],
        3..6 => &mut pixel.normal[k - 3],
        _ => &mut pixel.depth,
    }
}

/// The sign of a number. It is 0 for 0, which is a subgradient.
fn sign(v: f32) -> f32 {
    if v == 0.0 { 0.0 } else { v.signum() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    const WIDTH: usize = 6;

    /// Pictures, outputs and targets of 6 x 5 pixels.
    fn drawn(seed: u64) -> (Vec<[f32; 3]>, Vec<f32>, Vec<Target>) {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let count = 5 * WIDTH;
        let mut display = || -> Vec<[f32; 3]> { (0..count).map(|_| [(); 3].map(|()| rng.random_range(0.1..0.9))).collect() };
        let (shown, albedo, material) = (display(), display(), display());
        let outputs = (0..count * OUTPUTS).map(|_| rng.random_range(-1.0..1.0)).collect();
        let targets = (0..count).map(|i| {
            let v = glam::Vec3::new(rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0), rng.random_range(0.1..1.0));
            let normal = if i % 7 == 3 { [0.0; 3] } else { v.normalize().to_array() };
            let depth = rng.random_range(-1.0..1.0);
            let weight = if i % 5 == 2 { 0.0 } else { rng.random_range(0.2..1.0) };
            Target { pixel: Pixel { albedo: albedo[i], normal, depth, material: material[i] }, weight }
        });
        let targets = targets.collect();
        (shown, outputs, targets)
    }

    #[test]
    fn derivatives_agree_with_differences() {
        let (shown, outputs, targets) = drawn(11);
        let weights = LossWeights { depth: 0.7, depth_gradient: 0.2, ..LossWeights::default() };
        let (_, slopes) = loss(WIDTH, &shown, &outputs, &targets, &weights);
        let mut off = 0;
        for i in 0..outputs.len() {
            let step = 2e-3;
            let at = |delta: f32| {
                let mut moved = outputs.clone();
                moved[i] += delta;
                loss(WIDTH, &shown, &moved, &targets, &weights).0.total
            };
            let expected = (at(step) - at(-step)) / (2.0 * step);
            // An absolute value may turn between the two points.
            off += usize::from((slopes[i] - expected).abs() > 1e-3);
        }
        assert!(off <= outputs.len() / 50, "{off} of {} slopes are off", outputs.len());
    }

    #[test]
    fn depth_has_no_zero() {
        let (shown, outputs, targets) = drawn(2);
        let moved: Vec<f32> = outputs.iter().enumerate().map(|(i, v)| if i % OUTPUTS == 7 { v + 3.0 } else { *v }).collect();
        let of = |outputs: &[f32]| loss(WIDTH, &shown, outputs, &targets, &LossWeights::default()).0;
        assert!((of(&outputs).total - of(&moved).total).abs() < 1e-4);
    }

    #[test]
    fn what_sees_nothing_has_no_loss() {
        let (shown, outputs, mut targets) = drawn(5);
        targets.iter_mut().for_each(|target| target.weight = 0.0);
        let (found, slopes) = loss(WIDTH, &shown, &outputs, &targets, &LossWeights::default());
        assert_eq!(found, Loss::default());
        assert!(slopes.iter().all(|v| *v == 0.0));
    }
}
