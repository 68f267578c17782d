//! What an autoencoder loses: pictures of clips there and back.

use super::album::Album;
use crate::Result;
use crate::data::ClipSource;
use crate::parameters::to_vec;
use crate::wan::pictures::Kind;
use crate::wan::vae::Vae;
use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};

/// PSNR, dB, of pictures of one kind after the round trip, by their place in the clip.
#[derive(Clone, Debug, PartialEq)]
pub struct RoundTrip {
    /// What was shown.
    pub kind: Kind,
    /// Of all first frames, all second frames, .. from the mean squared error of values of 0..=1 over all clips.
    pub psnr: Vec<f32>,
}

/// Takes clips of `frames` consecutive frames of `source` through the autoencoder, one after another and at most `most` of a sequence.
/// A picture by itself is `frames` 1; a clip is what training and rendering of videos work on, 5 frames with Wan's autoencoder.
/// `told` is called with the number of sequences done after each; its error ends the work.
///
/// # Errors
/// That of `told`, when a clip cannot be used, there are no such frames in a row, or their number is none the autoencoder takes.
pub fn round_trip(
    vae: &Vae,
    source: &dyn ClipSource,
    frames: usize,
    most: usize,
    told: &mut dyn FnMut(usize) -> Result<()>,
) -> Result<Vec<RoundTrip>> {
    let vae = vae.valid();
    let factor = vae.config().spatial_factor();
    let mut sums = vec![[0.0f64; Kind::ALL.len()]; frames];
    let mut count = 0.0;
    for index in 0..source.len() {
        let clip = source.load(index)?;
        let album = Album::new(&clip, None, factor, factor)?;
        let (h, w) = (album.height, album.width);
        let (mut next, mut taken) = (0, 0);
        for page in album.stretches(frames.saturating_sub(1)) {
            if page < next || taken == most {
                continue;
            }
            (next, taken) = (page + frames, taken + 1);
            count += (3 * h * w) as f64;
            for kind in Kind::ALL {
                let pictures = album.clip(page, frames, kind, album.whole());
                let tensor = Tensor::from_data(TensorData::new(pictures.clone(), [1, 3, frames, h, w]), &Device::flex());
                let back = to_vec(vae.decode_normalised(vae.encode_normalised(tensor)?)?);
                for (i, (a, b)) in pictures.chunks_exact(h * w).zip(back.chunks_exact(h * w)).enumerate() {
                    let squares = a.iter().zip(b).map(|(a, b)| f64::from(0.5 * (a - b)).powi(2));
                    sums[i % frames][kind as usize] += squares.sum::<f64>();
                }
            }
        }
        told(index + 1)?;
    }
    if count == 0.0 {
        let reason = format!("no {frames} frames in a row in any clip");
        return Err(crate::Error::Data { place: "clips".into(), reason });
    }
    let psnr = |kind: Kind| sums.iter().map(|s| (-10.0 * (s[kind as usize] / count).max(1e-10).log10()) as f32).collect();
    Ok(Kind::ALL.into_iter().map(|kind| RoundTrip { kind, psnr: psnr(kind) }).collect())
}
