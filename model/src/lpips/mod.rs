//! Learned perceptual image patch similarity (LPIPS, Zhang et al. 2018, version 0.1) with AlexNet and SqueezeNet 1.1 features.
//!
//! The weights do not ship with the program: `lpips_alex.safetensors` and `lpips_squeeze.safetensors` hold the convolutions under
//! their torchvision names (`net.features.<i>.weight`, output-input-height-width), the heads as `lin.<i>.weight` (`[channels]`)
//! and the input normalisation as `scaling.shift` and `scaling.scale` (`[3]`).
mod backbone;
mod weights;

use crate::error::{Error, Result};
use backbone::Network;
use burn::tensor::{Device, Tensor, TensorData};
use renderflow_frame::image::Rgb;
use std::path::{Path, PathBuf};
use weights::Weights;

/// Environment variable that names the folder with the weights.
pub const WEIGHTS_VARIABLE: &str = "RENDERFLOW_LPIPS_WEIGHTS";

/// Where the weights are looked for; see [`weights_folder`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WeightsLocation {
    /// Folder with `lpips_alex.safetensors` and `lpips_squeeze.safetensors`.
    pub folder: PathBuf,
    /// Somebody named this folder ([`WEIGHTS_VARIABLE`]): what is missing there is a failure, not a reason to do without.
    pub named: bool,
}

/// The folder in [`WEIGHTS_VARIABLE`] if that is set, else `shared/assets/lpips` beside the repository.
pub fn weights_folder() -> WeightsLocation {
    match std::env::var_os(WEIGHTS_VARIABLE) {
        Some(folder) => WeightsLocation { folder: folder.into(), named: true },
        None => {
            let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/assets/lpips");
            WeightsLocation { folder, named: false }
        }
    }
}

/// The network whose features are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Backbone {
    /// AlexNet, five taps: the usual choice in papers.
    Alex,
    /// SqueezeNet 1.1, seven taps: a quarter of the weights.
    Squeeze,
}

impl Backbone {
    /// Name of its weights file.
    pub fn file_name(self) -> &'static str {
        match self {
            Self::Alex => "lpips_alex.safetensors",
            Self::Squeeze => "lpips_squeeze.safetensors",
        }
    }

    /// Smallest width and height whose deepest features still have a pixel.
    pub fn smallest_side(self) -> usize {
        match self {
            Self::Alex => 31,
            Self::Squeeze => 17,
        }
    }
}

/// A loaded LPIPS network.
#[derive(Debug)]
pub struct Lpips {
    backbone: Backbone,
    network: Network,
    /// One weight a channel of each tap, not negative.
    heads: Vec<Vec<f32>>,
    shift: [f32; 3],
    scale: [f32; 3],
}

impl Lpips {
    /// Reads the weights of `backbone` from `folder`.
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be read, [`Error::Malformed`] when it is no safetensors file, and [`Error::Tensor`]
    /// with the tensor's name when one is missing, cut off, of another shape or type, or holds a value that is not finite.
    pub fn load(folder: &Path, backbone: Backbone) -> Result<Self> {
        Self::load_file(&folder.join(backbone.file_name()), backbone)
    }

    /// Reads the weights of `backbone` from the file `path`.
    ///
    /// # Errors
    /// As [`Lpips::load`].
    pub fn load_file(path: &Path, backbone: Backbone) -> Result<Self> {
        let bytes = std::fs::read(path).map_err(Error::io(path, "read"))?;
        let weights = Weights::parse(path, &bytes)?;
        // Metrics are always measured on the CPU: the same number whatever device trained or rendered.
        let network = Network::read(backbone, &weights, &Device::flex())?;
        let heads = network.tap_channels().iter().enumerate();
        let heads = heads.map(|(i, &channels)| weights.values(&format!("lin.{i}.weight"), &[channels])).collect::<Result<_>>()?;
        let triple = |name: &str| weights.values(name, &[3]).map(|v| [v[0], v[1], v[2]]);
        let (shift, scale) = (triple("scaling.shift")?, triple("scaling.scale")?);
        if scale.contains(&0.0) {
            return Err(weights.error("scaling.scale", "holds a zero"));
        }
        Ok(Self { backbone, network, heads, shift, scale })
    }

    /// LPIPS distance of two pictures of display values (sRGB-encoded, 0 to 1): 0 for equal ones, about 1 for unrelated ones.
    ///
    /// # Errors
    /// [`Error::Data`] when the sizes differ, a side is shorter than [`Backbone::smallest_side`], or a value is not finite.
    pub fn distance(&self, a: &Rgb, b: &Rgb) -> Result<f32> {
        let data = |reason: String| Error::Data { place: "LPIPS".into(), reason };
        if (a.width, a.height) != (b.width, b.height) {
            return Err(data(format!("a picture of {}x{} against one of {}x{}", a.width, a.height, b.width, b.height)));
        }
        let smallest = self.backbone.smallest_side();
        if a.width.min(a.height) < smallest {
            return Err(data(format!("{}x{} is too small, this network needs {smallest}x{smallest}", a.width, a.height)));
        }
        for image in [a, b] {
            if image.pixels.len() != image.width * image.height {
                return Err(data(format!("{} pixels in a picture of {}x{}", image.pixels.len(), image.width, image.height)));
            }
            if let Some(i) = image.pixels.iter().position(|p| p.iter().any(|v| !v.is_finite())) {
                return Err(data(format!("pixel ({}, {}) is not finite", i % image.width, i / image.width)));
            }
        }
        let taps = self.network.taps(self.input(a, b));
        let distance: f64 = taps.into_iter().zip(&self.heads).map(|(tap, head)| tap_distance(tap, head)).sum();
        if !distance.is_finite() {
            return Err(data("the distance is not finite: the pictures hold values far outside 0..=1".into()));
        }
        Ok(distance as f32)
    }

    /// Both pictures as one batch `[2, 3, h, w]`, normalised as the networks were trained.
    fn input(&self, a: &Rgb, b: &Rgb) -> Tensor<4> {
        let values: Vec<f32> = [a, b]
            .into_iter()
            .flat_map(|image| (0..3).map(move |c| (image, c)))
            .flat_map(|(image, c)| image.pixels.iter().map(move |p| (p[c] * 2.0 - 1.0 - self.shift[c]) / self.scale[c]))
            .collect();
        Tensor::from_data(TensorData::new(values, [2, 3, a.height, a.width]), &Device::flex())
    }
}

/// Mean over pixels of the weighted squared difference of the two unit-length feature vectors. `tap` is `[2, c, h, w]`.
fn tap_distance(tap: Tensor<4>, head: &[f32]) -> f64 {
    let channels = head.len();
    let values: Vec<f32> = tap.permute([0, 2, 3, 1]).into_data().iter::<f32>().collect();
    let (a, b) = values.split_at(values.len() / 2);
    let inverse_norm = |f: &[f32]| 1.0 / (f.iter().map(|&v| f64::from(v) * f64::from(v)).sum::<f64>().sqrt() + 1e-10);
    let pixels = a.chunks_exact(channels).zip(b.chunks_exact(channels));
    let count = pixels.len();
    let sum: f64 = pixels
        .map(|(fa, fb)| {
            let (na, nb) = (inverse_norm(fa), inverse_norm(fb));
            let terms = fa.iter().zip(fb).zip(head);
            terms.map(|((&x, &y), &w)| f64::from(w) * (f64::from(x) * na - f64::from(y) * nb).powi(2)).sum::<f64>()
        })
        .sum();
    sum / count as f64
}
