//! Inference: the network finds the buffers behind a picture.

use super::batch::write_input;
use super::graph::{CHANNELS, InverseConfig, InverseNet, MULTIPLE, place};
use super::head::{OUTPUTS, Pixel};
use crate::network::trained::{Described, Trained};
use crate::parameters::read;
use crate::{Error, Result};
use burn::tensor::{Device, Tensor, TensorData};
use rayon::prelude::*;
use renderflow_frame::image::{Image, Rgb};
use serde::{Deserialize, Serialize};

/// The header of a weights file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Header {
    /// The network.
    pub inverse: InverseConfig,
    /// Number of training steps; 0 for an untrained network.
    pub steps: u64,
    /// Seed of the training run.
    pub seed: u64,
}

#[cfg(shipped_inverse)]
static SHIPPED: Option<&[u8]> = Some(include_bytes!("../../weights/inverse.safetensors"));
#[cfg(not(shipped_inverse))]
static SHIPPED: Option<&[u8]> = None;

/// Longer side in pixels of the largest picture that the network reads as it is. It reads a larger one reduced to this. It
/// learned from pictures of 256 x 256, and would see too little of what is around a pixel.
pub const LONGEST: usize = 512;

/// What the network finds behind a picture, of the picture's size. Nothing is said about pixels that see no surface.
#[derive(Clone, Debug, PartialEq)]
pub struct Found {
    /// Base colour in sRGB, 0..=1.
    pub albedo: Rgb,
    /// Normals in camera space, of length 1; 0 where the network is undecided.
    pub normal: Rgb,
    /// Half the logarithm of depth, up to a shift.
    pub depth: Image<f32>,
    /// Roughness, metallic, specular, 0..=1.
    pub material: Rgb,
}

impl Described for InverseNet {
    type Header = Header;

    fn check(header: &Header) -> Result<()> {
        header.inverse.validate()
    }

    fn values(header: &Header) -> usize {
        header.inverse.values()
    }

    fn fresh(header: &Header, device: &Device) -> Result<Self> {
        Self::new(&header.inverse, header.seed, device)
    }

    fn shipped() -> Option<&'static [u8]> {
        SHIPPED
    }
}

/// The inverse network with its weights.
pub type Inverse = Trained<InverseNet>;

impl Trained<InverseNet> {
    /// An untrained network. It returns the picture as albedo, with a little less contrast ([`Pixel`]).
    ///
    /// # Errors
    /// When the configuration is invalid.
    pub fn untrained(config: &InverseConfig, seed: u64) -> Result<Self> {
        Self::fresh(Header { inverse: config.clone(), steps: 0, seed })
    }

    /// Finds the buffers behind a picture of display values. Values outside 0..=1 are clamped, and NaN counts as 0.
    ///
    /// A picture whose longer side has more than [`LONGEST`] pixels is read at a reduced size. What the network says about its
    /// pixels is then interpolated, and applied to the pixels of the picture itself, so that the albedo has all of its detail.
    ///
    /// # Errors
    /// When the picture is empty, and when the device fails.
    pub fn find(&self, picture: &Rgb) -> Result<Found> {
        let (width, height) = (picture.width, picture.height);
        if width == 0 || height == 0 || picture.pixels.len() != width * height {
            return Err(Error::Data { place: "picture".into(), reason: format!("has {width} x {height} pixels") });
        }
        let shown = picture.map(|p| p.map(|v| if v.is_nan() { 0.0 } else { v.clamp(0.0, 1.0) }));
        let size = working_size([width, height]);
        let outputs = if size == [width, height] { self.outputs(&shown)? } else { self.outputs(&reduced(&shown, size))? };
        let pixel = |i: usize| {
            let (x, y) = (i % width, i / width);
            let outputs = if size == [width, height] { outputs[i] } else { between(&outputs, size, [x, y], [width, height]) };
            Pixel::new(shown.pixels[i], &outputs)
        };
        let pixels: Vec<Pixel> = (0..width * height).into_par_iter().with_min_len(4096).map(pixel).collect();
        let three = |of: fn(&Pixel) -> [f32; 3]| Rgb { width, height, pixels: pixels.iter().map(of).collect() };
        Ok(Found {
            albedo: three(|pixel| pixel.albedo),
            normal: three(|pixel| pixel.normal),
            depth: Image { width, height, pixels: pixels.iter().map(|pixel| pixel.depth).collect() },
            material: three(|pixel| pixel.material),
        })
    }

    /// What the network predicts for each pixel. The picture is padded by its last row and column.
    fn outputs(&self, picture: &Rgb) -> Result<Vec<[f32; OUTPUTS]>> {
        let size = [picture.width, picture.height];
        let [width, height] = size.map(|side| side.next_multiple_of(MULTIPLE));
        let mut input = vec![0.0; width * height * CHANNELS];
        for y in 0..height {
            for x in 0..width {
                let rgb = *picture.at(x.min(size[0] - 1), y.min(size[1] - 1));
                write_input(&mut input[place(width, CHANNELS, x, y)..][..CHANNELS], rgb, [x, y], size, false);
            }
        }
        let input = TensorData::new(input, [1, height / 2, width / 2, 4 * CHANNELS]);
        let found = read(self.network.forward(self.products, Tensor::from_data(input, self.device.device())))?;
        let pixel = |i: usize| {
            let from = place(width, OUTPUTS, i % size[0], i / size[0]);
            std::array::from_fn(|k| found[from + k])
        };
        Ok((0..size[0] * size[1]).map(pixel).collect())
    }
}

/// The size at which a picture of `size` is read.
fn working_size(size: [usize; 2]) -> [usize; 2] {
    let longer = size[0].max(size[1]);
    if longer <= LONGEST {
        return size;
    }
    size.map(|side| ((side * LONGEST) as f64 / longer as f64).round().max(1.0) as usize)
}

/// The picture at a smaller size. Each pixel is the mean of the area that it covers.
fn reduced(picture: &Rgb, [width, height]: [usize; 2]) -> Rgb {
    // For each new pixel of a side: the old pixels that it covers, and how much of each.
    let shares = |old: usize, new: usize| -> Vec<Vec<(usize, f32)>> {
        let edge = |i: usize| i as f64 * old as f64 / new as f64;
        let cover = |i: usize| {
            let (from, to) = (edge(i), edge(i + 1));
            let pixels = (from as usize)..(to.ceil() as usize).min(old);
            let share = |pixel: usize| ((pixel + 1) as f64).min(to) - (pixel as f64).max(from);
            pixels.map(|pixel| (pixel, (share(pixel) / (to - from)) as f32)).collect()
        };
        (0..new).map(cover).collect()
    };
    let (columns, rows) = (shares(picture.width, width), shares(picture.height, height));
    let mean = |i: usize| {
        let mut sum = [0.0; 3];
        for (y, of_row) in &rows[i / width] {
            for (x, of_column) in &columns[i % width] {
                let value = picture.at(*x, *y);
                (0..3).for_each(|c| sum[c] += of_row * of_column * value[c]);
            }
        }
        sum
    };
    Rgb { width, height, pixels: (0..width * height).into_par_iter().with_min_len(256).map(mean).collect() }
}

/// The outputs of a picture of `size` at the pixel `at` of a picture of size `full`, interpolated.
fn between(outputs: &[[f32; OUTPUTS]], size: [usize; 2], at: [usize; 2], full: [usize; 2]) -> [f32; OUTPUTS] {
    let place = |axis: usize| {
        let at = (at[axis] as f32 + 0.5) * size[axis] as f32 / full[axis] as f32 - 0.5;
        let at = at.clamp(0.0, (size[axis] - 1) as f32);
        let first = at as usize;
        (first, (first + 1).min(size[axis] - 1), at - first as f32)
    };
    let ((x0, x1, u), (y0, y1, v)) = (place(0), place(1));
    let [a, b, c, d] = [(x0, y0), (x1, y0), (x0, y1), (x1, y1)].map(|(x, y)| &outputs[y * size[0] + x]);
    std::array::from_fn(|k| (1.0 - v) * ((1.0 - u) * a[k] + u * b[k]) + v * ((1.0 - u) * c[k] + u * d[k]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reducing_keeps_the_mean() {
        let picture = Rgb::from_fn(37, 23, |x, y| [(x * y % 7) as f32, x as f32, y as f32]);
        let small = reduced(&picture, [10, 6]);
        for c in 0..3 {
            let mean = |picture: &Rgb| picture.pixels.iter().map(|p| p[c]).sum::<f32>() / picture.pixels.len() as f32;
            assert!((mean(&picture) - mean(&small)).abs() < 1e-3);
        }
        assert_eq!(working_size([4000, 3000]), [512, 384]);
        assert_eq!(working_size([512, 7]), [512, 7]);
        assert_eq!(working_size([100_000, 1]), [512, 1]);
    }

    #[test]
    fn interpolation_reproduces_a_slope() {
        let size = [8, 4];
        let outputs: Vec<[f32; OUTPUTS]> = (0..32).map(|i| [(i % 8) as f32 + 10.0 * (i / 8) as f32; OUTPUTS]).collect();
        for (x, y) in [(5, 3), (10, 6), (17, 9)] {
            let found = between(&outputs, size, [x, y], [24, 12])[3];
            let expected = (x as f32 + 0.5) / 3.0 - 0.5 + 10.0 * ((y as f32 + 0.5) / 3.0 - 0.5);
            assert!((found - expected).abs() < 1e-4, "{found} {expected}");
        }
        assert_eq!(between(&outputs, size, [0, 0], [24, 12])[0], 0.0);
    }
}
