//! The error of an autoencoder: pictures of clips are encoded and decoded.

use super::clip_pictures::ClipPictures;
use crate::Result;
use crate::data::ClipSource;
use crate::parameters::read;
use crate::wan::pictures::{BridgeStart, Kind};
use crate::wan::vae::Vae;
use burn::module::Module;
use burn::tensor::{Tensor, TensorData};

/// What is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Measured {
    /// Pictures of a kind after encoding and decoding.
    Kind(Kind),
    /// The truth, if the autoencoder codes its change from deferred shading.
    Change,
    /// Deferred shading itself, beside the truth. No autoencoder is used.
    Deferred,
}

/// PSNR of pictures that were encoded and decoded.
#[derive(Clone, Debug, PartialEq)]
pub struct RoundTrip {
    /// What is measured.
    pub of: Measured,
    /// PSNR in dB for each position in the clip, from the mean squared error over all clips, of values scaled to 0..=1.
    pub psnr: Vec<f32>,
}

/// Encodes and decodes clips of `frames` consecutive frames, at most `most` for each sequence of `source`. `frames` is 1 for
/// single pictures; training and rendering of videos use clips of 5 frames with Wan's autoencoder. If the clips come with
/// deferred shading, what begins with it is measured too. `done` is called after each sequence with the number of sequences so
/// far; its error ends the work.
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
    const KINDS: usize = Kind::ALL.len();
    let mut sums = vec![[0.0f64; KINDS + 2]; frames];
    let mut with_deferred = true;
    let mut count = 0.0;
    for index in 0..source.len() {
        let loaded = source.load(index)?;
        let clip = ClipPictures::new(&loaded, None, factor, factor)?;
        with_deferred &= !loaded.shaded.is_empty();
        let deferred =
            with_deferred.then(|| ClipPictures::starting(BridgeStart::Deferred, &loaded, None, factor, factor)).transpose()?;
        let (h, w) = (clip.height, clip.width);
        let (mut next, mut taken) = (0, 0);
        for start in clip.starts(frames.saturating_sub(1)) {
            if start < next || taken == most {
                continue;
            }
            (next, taken) = (start + frames, taken + 1);
            count += (3 * h * w) as f64;
            let coded = |pictures: &[f32]| -> Result<Vec<f32>> {
                let tensor = Tensor::from_data(TensorData::new(pictures.to_vec(), [1, 3, frames, h, w]), &vae.device());
                read(vae.decode_normalised(vae.encode_normalised(tensor)?)?)
            };
            let mut add = |row: usize, a: &[f32], b: &[f32]| {
                for (i, (a, b)) in a.chunks_exact(h * w).zip(b.chunks_exact(h * w)).enumerate() {
                    let squares = a.iter().zip(b).map(|(a, b)| f64::from(0.5 * (a - b)).powi(2));
                    sums[i % frames][row] += squares.sum::<f64>();
                }
            };
            let mut truth = (Vec::new(), Vec::new());
            for kind in Kind::ALL {
                let pictures = clip.clip(start, frames, kind, clip.whole());
                let back = coded(&pictures)?;
                add(kind as usize, &pictures, &back);
                if kind == Kind::Target {
                    truth = (pictures, back);
                }
            }
            if let Some(deferred) = &deferred {
                let ((truth, back), begun) = (truth, deferred.clip(start, frames, Kind::Albedo, deferred.whole()));
                let lost = coded(&begun)?;
                let change =
                    begun.iter().zip(&back).zip(&lost).map(|((start, back), lost)| (start + back - lost).clamp(-1.0, 1.0));
                add(KINDS, &truth, &change.collect::<Vec<f32>>());
                add(KINDS + 1, &truth, &begun);
            }
        }
        done(index + 1)?;
    }
    if count == 0.0 {
        let reason = format!("no {frames} frames in a row in any clip");
        return Err(crate::Error::Data { place: "clips".into(), reason });
    }
    let psnr = |row: usize| sums.iter().map(|s| decibel(s[row] / count)).collect();
    let rows = Kind::ALL.map(Measured::Kind).into_iter().chain([Measured::Change, Measured::Deferred]);
    let measured = if with_deferred { KINDS + 2 } else { KINDS };
    Ok(rows.take(measured).enumerate().map(|(row, of)| RoundTrip { of, psnr: psnr(row) }).collect())
}

/// PSNR in dB of a mean squared error, at most 100. NaN stays NaN: the larger of NaN and a number is the number.
fn decibel(error: f64) -> f32 {
    (-10.0 * error.clamp(1e-10, f64::INFINITY).log10()) as f32
}

#[cfg(test)]
mod tests {
    use super::decibel;

    #[test]
    fn a_broken_picture_is_not_perfect() {
        assert_eq!([decibel(0.01), decibel(0.0)], [20.0, 100.0]);
        assert!(decibel(f64::NAN).is_nan());
    }
}
