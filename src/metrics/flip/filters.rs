//! The filters of FLIP: how far the eye resolves each opponent channel, and detectors of edges and points.

use crate::metrics::convolve::{Taps, add_columns, columns, rows};
use std::f64::consts::PI;

/// One Gaussian of a contrast sensitivity function in degrees: `a sqrt(pi / b) exp(-pi^2 x^2 / b)` (Johnson and Fairchild 2003,
/// table 1 of the paper).
struct Sensitivity {
    a: f64,
    b: f64,
}

const LIGHT: [Sensitivity; 1] = [Sensitivity { a: 1.0, b: 0.0047 }];
const RED_GREEN: [Sensitivity; 1] = [Sensitivity { a: 1.0, b: 0.0053 }];
const BLUE_YELLOW: [Sensitivity; 2] = [Sensitivity { a: 34.1, b: 0.04 }, Sensitivity { a: 13.5, b: 0.025 }];
/// The widest of them sets the size of all kernels, three standard deviations.
const WIDEST: f64 = 0.04;
/// Width of the edge and point detectors, degrees.
const FEATURE_WIDTH: f64 = 0.082;
/// A tap this much smaller than the centre changes nothing in single precision.
const NEGLIGIBLE: f64 = 1e-9;

/// A kernel over the plane as a sum of products of a horizontal and a vertical one.
struct Separable(Vec<[Taps<f32>; 2]>);

/// The filters at one number of pixels per degree.
pub struct Filters {
    /// For lightness, red-green and blue-yellow.
    channels: [Separable; 3],
    gaussian: Taps<f32>,
    edge: Taps<f32>,
    point: Taps<f32>,
}

impl Filters {
    pub fn new(pixels_per_degree: f64) -> Self {
        let radius = (3.0 * (WIDEST / (2.0 * PI * PI)).sqrt() * pixels_per_degree).ceil() as usize;
        let channel = |terms: &[Sensitivity]| {
            let halves: Vec<Vec<f64>> = terms
                .iter()
                .map(|s| (0..=radius).map(|i| (-(PI * i as f64 / pixels_per_degree).powi(2) / s.b).exp()).collect())
                .collect();
            let height = |s: &Sensitivity| s.a * (PI / s.b).sqrt();
            let total: f64 = terms.iter().zip(&halves).map(|(s, half)| height(s) * sum(half).powi(2)).sum();
            let product = |(s, half): (&Sensitivity, &Vec<f64>)| [even(half, height(s) / total), even(half, 1.0)];
            Separable(terms.iter().zip(&halves).map(product).collect())
        };
        let channels = [channel(&LIGHT), channel(&RED_GREEN), channel(&BLUE_YELLOW)];

        let deviation = 0.5 * FEATURE_WIDTH * pixels_per_degree;
        let offsets = || (0..=(3.0 * deviation).ceil() as usize).map(|i| i as f64);
        let bell = |x: f64| (-x * x / (2.0 * deviation * deviation)).exp();
        let gaussian: Vec<f64> = offsets().map(bell).collect();
        // Weights above 0 sum to 1 and those below to -1, over the whole kernel; the Gaussian across leaves that as it is.
        let slope: Vec<f64> = offsets().map(|x| x * bell(x)).collect();
        let curve: Vec<f64> = offsets().map(|x| ((x / deviation).powi(2) - 1.0) * bell(x)).collect();
        let side = |keep: fn(f64) -> f64| sum(&curve.iter().map(|v| keep(*v)).collect::<Vec<_>>());
        let (above, below) = (side(|v| v.max(0.0)), side(|v| -v.min(0.0)));
        // At very few pixels per degree the kernel is a single pixel and there is nothing above 0.
        let ratio = |v: f64, by: f64| if by > 0.0 { (v / by) as f32 } else { 0.0 };
        Self {
            channels,
            gaussian: even(&gaussian, 1.0 / sum(&gaussian)),
            edge: Taps::Odd(slope.iter().map(|v| ratio(*v, slope.iter().sum())).collect()),
            point: Taps::Even(curve.iter().map(|v| ratio(*v, if *v > 0.0 { above } else { below })).collect()),
        }
    }

    /// The opponent planes as the eye resolves them.
    pub fn spatial(&self, opponent: [Vec<f32>; 3], width: usize) -> [Vec<f32>; 3] {
        let mut out = opponent;
        for (plane, Separable(terms)) in out.iter_mut().zip(&self.channels) {
            let mut sum = vec![0.0; plane.len()];
            for [across, down] in terms {
                add_columns(&rows(plane, width, across), width, down, &mut sum);
            }
            *plane = sum;
        }
        out
    }

    /// Lengths of (horizontal, vertical) response of the edge and of the point detector on lightness `[-16, 100]`, which the
    /// detectors take as 0..=1.
    pub fn features(&self, lightness: &[f32], width: usize) -> Vec<[f32; 2]> {
        let unit: Vec<f32> = lightness.iter().map(|v| (v + 16.0) / 116.0).collect();
        let across = |taps: &Taps<f32>| rows(&unit, width, taps);
        let smooth = across(&self.gaussian);
        let length = |derivative: &Taps<f32>| -> Vec<f32> {
            let horizontal = columns(&across(derivative), width, &self.gaussian);
            let vertical = columns(&smooth, width, derivative);
            horizontal.iter().zip(&vertical).map(|(h, v)| (h * h + v * v).sqrt()).collect()
        };
        length(&self.edge).into_iter().zip(length(&self.point)).map(|(edge, point)| [edge, point]).collect()
    }
}

/// Sum of a whole even kernel of which `half` is the centre and one side.
fn sum(half: &[f64]) -> f64 {
    half.first().map_or(0.0, |centre| 2.0 * half.iter().sum::<f64>() - centre)
}

fn even(half: &[f64], factor: f64) -> Taps<f32> {
    let end = half.iter().rposition(|v| *v > NEGLIGIBLE).map_or(half.len(), |last| last + 1);
    Taps::Even(half[..end].iter().map(|v| (v * factor) as f32).collect())
}
