//! The error of an autoencoder: pictures of clips are encoded and decoded.

use super::clip_pictures::ClipPictures;
use crate::Result;
use crate::data::ClipSource;
use crate::parameters::read;
use crate::wan::pictures::Kind;
use crate::wan::vae::Vae;
use burn::module::Module;
use burn::tensor::{Tensor, TensorData};

/// PSNR of pictures of one kind after encoding and decoding.
#[derive(Clone, Debug, PartialEq)]
pub struct RoundTrip {
    /// Kind of the pictures.
    pub kind: Kind,
    /// PSNR in dB for each position in the clip, from the mean squared error over all clips, of values scaled to 0..=1.
    pub psnr: Vec<f32>,
}

/// Encodes and decodes clips of `frames` consecutive frames, at most `most` for each sequence of `source`. `frames` is 1 for
/// single pictures; training and rendering of videos use clips of 5 frames with Wan's autoencoder. `done` is called after each
/// sequence with the number of sequences so far; its error ends the work.
///
/// # Errors
/// When `done` fails, when a clip cannot be used, when no sequence has that many frames in a row, or when the autoencoder cannot
/// encode that many frames.
pub fn round_trip(
    vae: &Vae,
    source: &dyn ClipSource,
    frames: usize,
    most: usize,
    done: &mut dyn FnMut(usize) -> Result<()>,
) -> Result<Vec<RoundTrip>> {
    let vae = vae.valid();
    let factor = vae.config().spatial_factor();
    let mut sums = vec![[0.0f64; Kind::ALL.len()]; frames];
    let mut count = 0.0;
    for index in 0..source.len() {
        let clip = ClipPictures::new(&source.load(index)?, None, factor, factor)?;
        let (h, w) = (clip.height, clip.width);
        let (mut next, mut taken) = (0, 0);
        for start in clip.starts(frames.saturating_sub(1)) {
            if start < next || taken == most {
                continue;
            }
            (next, taken) = (start + frames, taken + 1);
            count += (3 * h * w) as f64;
            for kind in Kind::ALL {
                let pictures = clip.clip(start, frames, kind, clip.whole());
                let tensor = Tensor::from_data(TensorData::new(pictures.clone(), [1, 3, frames, h, w]), &vae.device());
                let back = read(vae.decode_normalised(vae.encode_normalised(tensor)?)?)?;
                for (i, (a, b)) in pictures.chunks_exact(h * w).zip(back.chunks_exact(h * w)).enumerate() {
                    let squares = a.iter().zip(b).map(|(a, b)| f64::from(0.5 * (a - b)).powi(2));
                    sums[i % frames][kind as usize] += squares.sum::<f64>();
                }
            }
        }
        done(index + 1)?;
    }
    if count == 0.0 {
        let reason = format!("no {frames} frames in a row in any clip");
        return Err(crate::Error::Data { place: "clips".into(), reason });
    }
    let psnr = |kind: Kind| sums.iter().map(|s| (-10.0 * (s[kind as usize] / count).max(1e-10).log10()) as f32).collect();
    Ok(Kind::ALL.into_iter().map(|kind| RoundTrip { kind, psnr: psnr(kind) }).collect())
}
