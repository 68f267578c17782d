//! Mixes what the network makes of samples with keyframes that are carried along. Their errors have different causes: noise, and
//! light that has changed. So their mean is better than either, where they say nearly the same.

use rayon::prelude::*;
use renderflow_frame::color::linear_to_srgb;
use renderflow_frame::image::{Image, Rgb};

/// Largest share of the keyframes, where both pictures are equal.
const SHARE: f32 = 0.5;
/// Up to so many samples for each pixel, they have that share. From there on it falls as one through the samples: the noise gets
/// less, and changes of light do not (docs/measurements/fusion-training.md, keyframes and more samples).
const NOISY: u32 = 4;
/// Root mean square of the difference, in sRGB's curve, that leaves 1/e of the share. On 16 sequences of two seeds, .02
/// and .03 gain most with 4 samples, and .05 gains more than they do with 1.
const TOLERANCE: f32 = 0.025;
/// The difference is taken over so many pixels to each side.
const REACH: usize = 2;

/// `picture`, made from `spp` samples for each pixel, with a share of `carried`; both are scene-linear and of one size.
/// `exposure` is the factor to display-linear. The share is that of equal pictures ([`SHARE`], [`NOISY`]) times
/// exp(-d^2 / [`TOLERANCE`]^2), where d is the root mean square of their difference around the pixel. A pixel that would not be
/// finite stays as it is in `picture`.
pub fn mixture(picture: &Rgb, carried: &Rgb, spp: u32, exposure: f32) -> Rgb {
    let equal = SHARE * NOISY as f32 / spp.max(NOISY) as f32;
    let (width, height) = (picture.width, picture.height);
    let square = |(a, b): (&[f32; 3], &[f32; 3])| {
        // Not clipped at white, so that light which no display shows does not mix either.
        let [a, b] = [a, b].map(|linear| linear.map(|v| linear_to_srgb((exposure * v).max(0.0))));
        (0..3).map(|c| (a[c] - b[c]).powi(2)).sum::<f32>() / 3.0
    };
    let squares: Vec<f32> = picture.pixels.par_iter().zip(&carried.pixels).map(square).collect();
    let pixel = |i: usize| {
        let around = |at: usize, size: usize| at.saturating_sub(REACH)..(at + REACH + 1).min(size);
        let (columns, rows) = (around(i % width, width), around(i / width, height));
        let number = columns.len() * rows.len();
        let sum: f32 = rows.map(|y| squares[y * width..][columns.clone()].iter().sum::<f32>()).sum();
        let share = equal * (-sum / number as f32 / TOLERANCE.powi(2)).exp();
        let (own, other) = (picture.pixels[i], carried.pixels[i]);
        // A share that is not finite, or light that is not, leaves the picture as it is.
        let mixed = [0, 1, 2].map(|c| own[c] + share * (other[c] - own[c]));
        if mixed.iter().all(|v| v.is_finite()) { mixed } else { own }
    };
    Image { width, height, pixels: (0..width * height).into_par_iter().map(pixel).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Equal pictures stay, near ones meet half way, and far ones do not mix; light that is not finite changes nothing.
    #[test]
    fn pictures_mix_where_they_are_near() {
        let plain = |v: f32| Rgb::from_fn(7, 5, |_, _| [v; 3]);
        let first = |picture: Rgb| picture.pixels[17][0];
        assert_eq!(mixture(&plain(0.2), &plain(0.2), 4, 1.0), plain(0.2));
        assert!((first(mixture(&plain(0.2), &plain(0.2001), 4, 1.0)) - 0.20005).abs() < 1e-6);
        assert_eq!(first(mixture(&plain(0.2), &plain(0.8), 4, 1.0)), 0.2);
        // Values 1 / 255 apart in sRGB's curve, in every channel; and light above white.
        assert_eq!(first(mixture(&plain(2.0), &plain(3.0), 4, 1.0)), 2.0);
        let [a, b] = [100.0_f32, 101.0].map(|v| renderflow_frame::color::srgb_to_linear(v / 255.0));
        let share = (first(mixture(&plain(a), &plain(b), 4, 1.0)) - a) / (b - a);
        assert!((share - SHARE * (-(1.0 / 255.0 / TOLERANCE).powi(2)).exp()).abs() < 1e-3, "{share}");
        for wrong in [f32::NAN, f32::INFINITY] {
            assert_eq!(mixture(&plain(0.2), &plain(wrong), 4, 1.0), plain(0.2));
        }
        // Less noise leaves less to the keyframes.
        for (spp, share) in [(1, 0.5), (4, 0.5), (8, 0.25), (64, 0.03125)] {
            let mixed = first(mixture(&plain(0.2), &plain(0.2001), spp, 1.0));
            assert!(((mixed - 0.2) / 1e-4 - share).abs() < 2e-3, "{spp}: {mixed}");
        }
        // One pixel that differs is seen by its window alone.
        let mut other = plain(0.2001);
        other.pixels[0] = [5.0; 3];
        let mixed = mixture(&plain(0.2), &other, 4, 1.0);
        assert_eq!(mixed.pixels[0], [0.2; 3]);
        assert_eq!(mixed.pixels[2 * 7 + 2], [0.2; 3]);
        assert!(mixed.pixels[3] != [0.2; 3]);
    }
}
