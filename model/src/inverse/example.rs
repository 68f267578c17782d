//! What is learned from a frame: its picture, and the buffers behind it. It takes a seventh of the memory of a [`Record`].

use crate::fusion::Record;
use crate::fusion::record::at;
use half::f16;

/// Numbers that are kept for a pixel: exposed linear radiance, linear albedo, normal, depth, material, coverage.
const KEPT: usize = 14;
/// Index in a record of the numbers of a pixel after its radiance.
const BUFFERS: [usize; KEPT - 3] = [
    at::ALBEDO,
    at::ALBEDO + 1,
    at::ALBEDO + 2,
    at::NORMAL,
    at::NORMAL + 1,
    at::NORMAL + 2,
    at::DEPTH,
    at::MATERIAL,
    at::MATERIAL + 1,
    at::MATERIAL + 2,
    at::ALPHA,
];

/// A frame to learn from.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Example {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    pixels: Vec<[f16; KEPT]>,
}

/// What is known about a pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Truth {
    /// Exposed linear radiance, with the environment where no surface is.
    pub radiance: [f32; 3],
    /// Linear base colour.
    pub albedo: [f32; 3],
    /// Mean normal in camera space. It is shorter than 1 where normals vary.
    pub normal: [f32; 3],
    /// Half the logarithm of depth over the frame's median depth.
    pub depth: f32,
    /// Roughness, metallic, specular.
    pub material: [f32; 3],
    /// Coverage.
    pub alpha: f32,
}

impl Example {
    /// The example of a record.
    pub fn of(record: &Record<f16>) -> Self {
        let pixel = |stored: &[f16]| {
            let mut kept = [f16::ZERO; KEPT];
            kept[..3].copy_from_slice(&stored[at::TRUTH..at::TRUTH + 3]);
            for (kept, from) in kept[3..].iter_mut().zip(BUFFERS) {
                *kept = stored[from];
            }
            kept
        };
        Self { width: record.width, height: record.height, pixels: record.pixels.chunks_exact(at::COUNT).map(pixel).collect() }
    }

    /// The pixel in column `x` and row `y`.
    pub fn at(&self, x: usize, y: usize) -> Truth {
        let stored = self.pixels[y * self.width + x].map(f16::to_f32);
        let three = |from: usize| [stored[from], stored[from + 1], stored[from + 2]];
        Truth { radiance: three(0), albedo: three(3), normal: three(6), depth: stored[9], material: three(10), alpha: stored[13] }
    }

    /// Coverage of the pixel in column `x` and row `y`.
    pub fn alpha(&self, x: usize, y: usize) -> f32 {
        self.pixels[y * self.width + x][KEPT - 1].to_f32()
    }
}
