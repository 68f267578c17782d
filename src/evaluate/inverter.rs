//! The networks that find the buffers behind a picture.

use crate::metrics::intrinsics::Buffers;
use anyhow::{Result, ensure};
use renderflow_frame::Image;
use renderflow_frame::image::Rgb;
use renderflow_model::device::NetworkDevice;
use renderflow_model::inverse::{Found, Inverse};
use renderflow_model::wan::flow::Intrinsic;
use renderflow_model::wan::video::WanRenderer;
use std::path::Path;

/// A network that finds the buffers behind a picture.
pub enum Inverter {
    /// The inverse network.
    Compact(Box<Inverse>),
    /// The paper's network with an inverse adapter.
    Wan(Box<WanRenderer>),
}

/// Options of the paper's network.
#[derive(Clone, Copy, Debug, Default)]
pub struct WanOptions<'a> {
    /// Weights of the autoencoder; `None` finds them beside the network's.
    pub vae: Option<&'a Path>,
    /// Side in pixels of the tiles in which larger pictures are encoded.
    pub tile: Option<usize>,
}

impl Inverter {
    /// Opens the network in a file, which says which network it is, or the one inside the program, on a device.
    ///
    /// # Errors
    /// When the file holds no network that inverts, or when an option is not one of its network.
    pub fn open(weights: Option<&Path>, options: WanOptions, device: &NetworkDevice) -> Result<Self> {
        let path = match weights {
            Some(path) if !Inverse::recognises(path) => path,
            found => {
                for (flag, given) in [("--vae", options.vae.is_some()), ("--tile", options.tile.is_some())] {
                    ensure!(!given, "{flag} is an option of the paper's network, whose weights --weights names");
                }
                let network = found.map_or_else(Inverse::shipped, Inverse::load)?;
                return Ok(Self::Compact(Box::new(network.to(device)?)));
            }
        };
        let renderer = WanRenderer::load(path, options.vae, device)?;
        ensure!(renderer.inverts(), "{}: has no inverse adapter", path.display());
        Ok(Self::Wan(Box::new(match options.tile {
            Some(pixels) => renderer.tiled(pixels)?,
            None => renderer,
        })))
    }

    /// Finds the buffers `only` behind pictures of display values, which have one size. The paper's network sees them together,
    /// and takes `steps` steps.
    ///
    /// # Errors
    /// When a picture is empty or too large.
    pub fn find(&self, pictures: &[Rgb], only: &[Intrinsic], steps: usize) -> Result<Vec<Buffers>> {
        let Some(&Rgb { width, height, .. }) = pictures.first() else { return Ok(Vec::new()) };
        match self {
            Self::Compact(network) => pictures.iter().map(|picture| Ok(buffers(network.find(picture)?, only))).collect(),
            Self::Wan(renderer) => {
                let planes: Vec<Vec<f32>> = pictures.iter().map(planes).collect();
                let slices: Vec<&[f32]> = planes.iter().map(Vec::as_slice).collect();
                let found = renderer.invert(&slices, [width, height], only, steps)?;
                let mut all = vec![Buffers::default(); pictures.len()];
                for (intrinsic, found) in only.iter().zip(found) {
                    for (buffers, planes) in all.iter_mut().zip(found) {
                        set(buffers, *intrinsic, &image(width, height, &planes));
                    }
                }
                Ok(all)
            }
        }
    }

    /// Depth that this network found, as numbers of 0..=1: 0 is nearest.
    pub fn shown_depth(&self, depth: &Image<f32>) -> Image<f32> {
        match self {
            Self::Wan(_) => depth.map(|d| unit(*d)),
            Self::Compact(_) => {
                let (low, high) = depth.pixels.iter().fold((f32::MAX, f32::MIN), |(low, high), d| (low.min(*d), high.max(*d)));
                depth.map(|d| if high > low { (d - low) / (high - low) } else { 0.0 })
            }
        }
    }
}

/// The buffers that the inverse network found.
fn buffers(found: Found, only: &[Intrinsic]) -> Buffers {
    let wanted = |intrinsic: Intrinsic| only.contains(&intrinsic);
    Buffers {
        albedo: wanted(Intrinsic::Albedo).then_some(found.albedo),
        normal: wanted(Intrinsic::Normal).then_some(found.normal),
        // The network says half of it.
        depth: wanted(Intrinsic::Depth).then(|| found.depth.map(|half| 2.0 * half)),
        material: wanted(Intrinsic::Material).then_some(found.material),
    }
}

/// Sets a buffer to a picture of the paper's network, -1..=1.
pub fn set(buffers: &mut Buffers, intrinsic: Intrinsic, picture: &Rgb) {
    match intrinsic {
        Intrinsic::Albedo => buffers.albedo = Some(picture.map(|p| p.map(unit))),
        Intrinsic::Normal => buffers.normal = Some(picture.clone()),
        Intrinsic::Depth => buffers.depth = Some(picture.map(|p| p.iter().sum::<f32>() / 3.0)),
        Intrinsic::Material => buffers.material = Some(picture.map(|p| p.map(unit))),
    }
}

/// Planes of -1..=1 as a picture of the same values.
pub fn image(width: usize, height: usize, planes: &[f32]) -> Rgb {
    let count = width * height;
    Rgb::from_fn(width, height, |x, y| [0, 1, 2].map(|c| planes[c * count + y * width + x]))
}

/// Display values as planes of -1..=1.
fn planes(picture: &Rgb) -> Vec<f32> {
    (0..3).flat_map(|c| picture.pixels.iter().map(move |p| 2.0 * p[c].clamp(0.0, 1.0) - 1.0)).collect()
}

/// -1..=1 to 0..=1.
pub fn unit(value: f32) -> f32 {
    (0.5 + 0.5 * value).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Relighting takes the exponential of the depth for a distance.
    #[test]
    fn depth_is_a_logarithm() {
        let (nearest, farther) = (3.0_f32, [1.0_f32, 2.0, 8.0, 20.0]);
        let grey = Rgb::filled(4, 1, [0.5; 3]);
        let half = farther.map(|factor| 0.5 * (nearest * factor).ln() + 0.7);
        let depth = Image { width: 4, height: 1, pixels: half.to_vec() };
        let found = Found { albedo: grey.clone(), normal: grey.clone(), depth, material: grey };
        let depth = buffers(found, &Intrinsic::ALL).depth.expect("a depth");
        let first = depth.pixels[0].exp();
        for (depth, factor) in depth.pixels.iter().zip(farther) {
            assert!((depth.exp() / first - factor).abs() < 1e-4 * factor, "{depth} {factor}");
        }
    }
}
