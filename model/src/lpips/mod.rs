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

/// Most bytes of a weights file. The weights of these networks have about 10 million.
const LARGEST: u64 = 1 << 30;

/// Environment variable that names the folder with the weights.
pub const WEIGHTS_VARIABLE: &str = "RENDERFLOW_LPIPS_WEIGHTS";

/// The folder that [`WEIGHTS_VARIABLE`] names, with `lpips_alex.safetensors` and `lpips_squeeze.safetensors`. `None` where nobody
/// named one; LPIPS is left out then.
pub fn weights_folder() -> Option<PathBuf> {
    std::env::var_os(WEIGHTS_VARIABLE).filter(|folder| !folder.is_empty()).map(PathBuf::from)
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
    /// Name of the weights file.
    pub fn file_name(self) -> &'static str {
        match self {
            Self::Alex => "lpips_alex.safetensors",
            Self::Squeeze => "lpips_squeeze.safetensors",
        }
    }

    /// Smallest width and height of a picture: the deepest features have one pixel.
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
    /// One weight for each channel of each tap, at least 0.
    heads: Vec<Vec<f32>>,
    shift: [f32; 3],
    scale: [f32; 3],
}

/// The features of one picture, which are half of the work of a comparison; see [`Lpips::reference`].
#[derive(Debug)]
pub struct Reference {
    backbone: Backbone,
    width: usize,
    height: usize,
    /// Features of each tap, channels last.
    taps: Vec<Vec<f32>>,
}

impl Lpips {
    /// Reads the weights of `backbone` from `folder`.
    ///
    /// # Errors
    /// [`Error::Frame`] when the file cannot be read or is not a safetensors file, and [`Error::Tensor`] when a tensor is
    /// missing, cut off, of another shape or type, or holds a value that is not finite.
    pub fn load(folder: &Path, backbone: Backbone) -> Result<Self> {
        Self::load_file(&folder.join(backbone.file_name()), backbone)
    }

    /// Reads the weights of `backbone` from the file `path`.
    ///
    /// # Errors
    /// As [`Lpips::load`].
    pub fn load_file(path: &Path, backbone: Backbone) -> Result<Self> {
        // Metrics always run on the CPU, so that they do not depend on the device of training or rendering.
        Self::load_on(path, backbone, &Device::flex())
    }

    /// Reads the weights of `backbone` from the file `path` to a device: the one of the tensors for [`Self::loss`].
    ///
    /// # Errors
    /// As [`Lpips::load`].
    pub fn load_on(path: &Path, backbone: Backbone, device: &Device) -> Result<Self> {
        let bytes = renderflow_frame::file::read_at_most(path, LARGEST)?;
        let weights = Weights::parse(path, &bytes)?;
        let network = Network::read(backbone, &weights, device)?;
        let heads = network.tap_channels().iter().enumerate();
        let heads = heads.map(|(i, &channels)| weights.values(&format!("lin.{i}.weight"), &[channels])).collect::<Result<_>>()?;
        let triple = |name: &str| weights.values(name, &[3]).map(|v| [v[0], v[1], v[2]]);
        let (shift, scale) = (triple("scaling.shift")?, triple("scaling.scale")?);
        if scale.contains(&0.0) {
            return Err(weights.error("scaling.scale", "holds a zero"));
        }
        Ok(Self { backbone, network, heads, shift, scale })
    }

    /// The network for a loss, with SqueezeNet as the faster backbone, from `folder` or else from [`weights_folder`].
    ///
    /// # Errors
    /// [`Error::Config`] when there is no folder, or as [`Lpips::load`].
    pub fn for_loss(folder: Option<&Path>, device: &Device) -> Result<Self> {
        let folder = folder.map(Path::to_path_buf).or_else(weights_folder);
        let folder = folder.ok_or_else(|| Error::config("lpips_weights", format!("name a folder, or set {WEIGHTS_VARIABLE}")))?;
        Self::load_on(&folder.join(Backbone::Squeeze.file_name()), Backbone::Squeeze, device)
    }

    /// The network whose features are compared.
    pub fn backbone(&self) -> Backbone {
        self.backbone
    }

    /// LPIPS distance of two pictures of display values (sRGB-encoded, 0 to 1): 0 for equal pictures, about 1 for unrelated
    /// pictures.
    ///
    /// # Errors
    /// [`Error::Data`] when the sizes differ, a side is shorter than [`Backbone::smallest_side`], or a value is not finite.
    pub fn distance(&self, a: &Rgb, b: &Rgb) -> Result<f32> {
        // Both are checked before the network runs.
        same_size((a.width, a.height), (b.width, b.height))?;
        self.distance_to(a, &self.reference(b)?)
    }

    /// Mean distance of two batches of pictures `[b, 3, h, w]` with values -1..=1, on the device of the network, `[1]`. It is
    /// differentiable with respect to both batches, with a gradient of zero where the features of both are zero.
    ///
    /// # Errors
    /// [`Error::Data`] when the shapes differ, when there are not three channels, or when a side is shorter than
    /// [`Backbone::smallest_side`].
    pub fn loss(&self, a: Tensor<4>, b: Tensor<4>) -> Result<Tensor<1>> {
        let ([n, channels, height, width], smallest) = (a.dims(), self.backbone.smallest_side());
        if b.dims() != a.dims() || n == 0 || channels != 3 || width.min(height) < smallest {
            return Err(data(format!(
                "pictures {:?} and {:?}; [b, 3, {smallest}.., {smallest}..] is needed",
                a.dims(),
                b.dims()
            )));
        }
        let device = a.device();
        let triple = |v: [f32; 3]| Tensor::<1>::from_data(v, &device).reshape([1, 3, 1, 1]);
        let (shift, scale) = (triple(self.shift), triple(self.scale));
        let taps = |x: Tensor<4>| self.network.taps((x - shift.clone()) / scale.clone());
        // The bound is added inside the root, so that the slope of a pixel without features is finite.
        let unit = |f: Tensor<4>| f.clone() / (f.clone() * f).sum_dim(1).add_scalar(1e-20).sqrt();
        let mut sum: Option<Tensor<1>> = None;
        for ((a, b), head) in taps(a).into_iter().zip(taps(b)).zip(&self.heads) {
            let [_, c, h, w] = a.dims();
            let head = Tensor::<1>::from_data(head.as_slice(), &device).reshape([1, c, 1, 1]);
            let difference = unit(a) - unit(b);
            let distance = (difference.clone() * difference * head).sum().div_scalar((n * h * w) as f32);
            sum = Some(match sum {
                Some(sum) => sum + distance,
                None => distance,
            });
        }
        sum.ok_or_else(|| data("a network without features".into()))
    }

    /// The features of a picture, for several comparisons with it.
    ///
    /// # Errors
    /// [`Error::Data`] when a side is shorter than [`Backbone::smallest_side`], or a value is not finite.
    pub fn reference(&self, picture: &Rgb) -> Result<Reference> {
        let (width, height) = (picture.width, picture.height);
        let smallest = self.backbone.smallest_side();
        if width.min(height) < smallest {
            return Err(data(format!("{width}x{height} is too small, this network needs {smallest}x{smallest}")));
        }
        if picture.pixels.len() != width * height {
            return Err(data(format!("{} pixels in a picture of {width}x{height}", picture.pixels.len())));
        }
        if let Some(i) = picture.pixels.iter().position(|p| p.iter().any(|v| !v.is_finite())) {
            return Err(data(format!("pixel ({}, {}) is not finite", i % width, i / width)));
        }
        let channels_last = |tap: Tensor<4>| tap.permute([0, 2, 3, 1]).into_data().iter::<f32>().collect();
        let taps = self.network.taps(self.input(picture)).into_iter().map(channels_last).collect();
        Ok(Reference { backbone: self.backbone, width, height, taps })
    }

    /// The [`Lpips::distance`] of `picture` and the picture of `reference`, equal to the last bit.
    ///
    /// # Errors
    /// When `reference` is of the other backbone, or as for [`Lpips::distance`].
    pub fn distance_to(&self, picture: &Rgb, reference: &Reference) -> Result<f32> {
        same_size((picture.width, picture.height), (reference.width, reference.height))?;
        if reference.backbone != self.backbone {
            return Err(data(format!("{:?} features compared by {:?}", reference.backbone, self.backbone)));
        }
        let features = self.reference(picture)?;
        let pairs = features.taps.iter().zip(&reference.taps);
        let distance: f64 = pairs.zip(&self.heads).map(|((a, b), head)| tap_distance(a, b, head)).sum();
        if !distance.is_finite() {
            return Err(data("the distance is not finite: the pictures hold values far outside 0..=1".into()));
        }
        Ok(distance as f32)
    }

    /// A picture as a batch `[1, 3, h, w]`, normalised as in the training of the networks.
    fn input(&self, picture: &Rgb) -> Tensor<4> {
        let plane = |c: usize| picture.pixels.iter().map(move |p| (p[c] * 2.0 - 1.0 - self.shift[c]) / self.scale[c]);
        let values: Vec<f32> = (0..3).flat_map(plane).collect();
        Tensor::from_data(TensorData::new(values, [1, 3, picture.height, picture.width]), &Device::flex())
    }
}

fn data(reason: String) -> Error {
    Error::Data { place: "LPIPS".into(), reason }
}

fn same_size(a: (usize, usize), b: (usize, usize)) -> Result<()> {
    if a == b { Ok(()) } else { Err(data(format!("a picture of {}x{} against one of {}x{}", a.0, a.1, b.0, b.1))) }
}

/// Mean over pixels of the weighted squared difference of the two unit-length feature vectors, channels last.
fn tap_distance(a: &[f32], b: &[f32], head: &[f32]) -> f64 {
    let channels = head.len();
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
