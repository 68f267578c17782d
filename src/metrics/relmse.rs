//! Relative squared error of scene-linear radiance, for methods whose pictures have more range than a screen.

use anyhow::{Result, bail};
use renderflow_frame::image::Rgb;
use serde::{Deserialize, Serialize};

/// Keeps dark pixels from ruling the relative error (Rousselle et al. 2011 use it too).
const FLOOR: f64 = 0.01;

/// Squared difference over squared reference, in forms that differ in what a few very wrong pixels count.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RelMse {
    /// Mean over pixels and channels of (I - R)^2 / (R^2 + 0.01).
    pub mean: f64,
    /// Mean over the 99 % of pixels with the least error.
    pub trimmed: f64,
    /// Mean with what is above the 99.9th percentile set to it.
    pub clipped: f64,
    /// Error of the median pixel.
    pub median: f64,
}

/// Relative squared error of every pixel, mean of the channels.
///
/// # Errors
/// When the sizes differ.
pub fn relative_errors(image: &Rgb, reference: &Rgb) -> Result<Vec<f64>> {
    same_size(image, reference)?;
    let error = |(i, r): (&f32, &f32)| {
        let (i, r) = (f64::from(*i), f64::from(*r));
        (i - r).powi(2) / (r * r + FLOOR)
    };
    let pixel = |(i, r): (&[f32; 3], &[f32; 3])| i.iter().zip(r).map(error).sum::<f64>() / 3.0;
    Ok(image.pixels.iter().zip(&reference.pixels).map(pixel).collect())
}

/// What the noise of the reference adds to the relative error of every pixel; `variance` is of the reference's mean.
///
/// # Errors
/// When the sizes differ.
pub fn reference_noise(reference: &Rgb, variance: &Rgb) -> Result<Vec<f64>> {
    same_size(variance, reference)?;
    let share = |(v, r): (&f32, &f32)| f64::from(*v) / (f64::from(*r).powi(2) + FLOOR);
    let pixel = |(v, r): (&[f32; 3], &[f32; 3])| v.iter().zip(r).map(share).sum::<f64>() / 3.0;
    Ok(variance.pixels.iter().zip(&reference.pixels).map(pixel).collect())
}

/// Checks that two pictures can be compared.
///
/// # Errors
/// When the sizes differ or there are no pixels.
pub fn same_size(image: &Rgb, reference: &Rgb) -> Result<()> {
    let size = |i: &Rgb| (i.width, i.height);
    if size(image) != size(reference) {
        let ((w, h), (rw, rh)) = (size(image), size(reference));
        bail!("the picture has {w} x {h} pixels, the reference {rw} x {rh}");
    }
    if image.pixels.is_empty() {
        bail!("a picture without pixels has no error");
    }
    Ok(())
}

/// The relative error of `image`. Where the variance of the reference's mean is known, what it adds is taken off again from every
/// form but the median (which may turn a mean below 0 where both are equally noisy).
///
/// # Errors
/// When the sizes differ.
pub fn relmse(image: &Rgb, reference: &Rgb, variance: Option<&Rgb>) -> Result<RelMse> {
    let errors = relative_errors(image, reference)?;
    let noise = match variance {
        Some(variance) => reference_noise(reference, variance)?,
        None => vec![0.0; errors.len()],
    };
    let mut order: Vec<usize> = (0..errors.len()).collect();
    order.sort_by(|&a, &b| errors[a].total_cmp(&errors[b]).then(a.cmp(&b)));
    let sorted: Vec<f64> = order.iter().map(|&i| errors[i]).collect();
    let count = errors.len() as f64;
    let top = percentile(&sorted, 0.999);
    let noise_sum: f64 = noise.iter().sum();
    // At least one pixel, for pictures of less than a hundred.
    let kept = ((count * 0.99) as usize).max(1);
    let kept_noise: f64 = order[..kept].iter().map(|&i| noise[i]).sum();
    Ok(RelMse {
        mean: (sorted.iter().sum::<f64>() - noise_sum) / count,
        trimmed: (sorted[..kept].iter().sum::<f64>() - kept_noise) / kept as f64,
        clipped: (sorted.iter().map(|e| e.min(top)).sum::<f64>() - noise_sum) / count,
        median: percentile(&sorted, 0.5),
    })
}

/// Mean of `errors` without the largest `share` of them (rounded down to whole ones): a few pixels that a path tracer got very
/// wrong can be most of a mean. NaN of an empty list.
pub fn trimmed_mean(errors: &[f64], share: f64) -> f64 {
    let dropped = ((errors.len() as f64 * share) as usize).min(errors.len().saturating_sub(1));
    if dropped == 0 {
        return errors.iter().sum::<f64>() / errors.len() as f64;
    }
    let kept = errors.len() - dropped;
    let mut order = errors.to_vec();
    let (_, &mut limit, _) = order.select_nth_unstable_by(kept - 1, f64::total_cmp);
    // Summed in the order of the pixels: the selection's is not specified.
    let below = || errors.iter().filter(|e| **e < limit);
    (below().sum::<f64>() + limit * (kept - below().count()) as f64) / kept as f64
}

/// Value at `share` of sorted values, linear between neighbours (numpy's default).
pub(crate) fn percentile(sorted: &[f64], share: f64) -> f64 {
    let place = share * (sorted.len() - 1) as f64;
    let (low, t) = (place.floor() as usize, place.fract());
    let high = (low + 1).min(sorted.len() - 1);
    sorted[low] + (sorted[high] - sorted[low]) * t
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Deserialize)]
    struct Case {
        width: usize,
        height: usize,
        with_variance: bool,
        relmse: RelMse,
    }

    /// The pictures of the script: a linear congruential generator, with a few pixels far off.
    fn pictures(width: usize, height: usize) -> [Rgb; 3] {
        let mut state = 7u32;
        let mut random = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(state >> 8) / f64::from(1 << 24)
        };
        let reference = Rgb::from_fn(width, height, |_, _| [0; 3].map(|_| (2.0 * random() * random()) as f32));
        let mut image = reference.map(|p| p.map(|v| (f64::from(v) * (0.5 + random())) as f32));
        for i in (0..image.pixels.len()).step_by(97) {
            image.pixels[i][1] += 30.0;
        }
        let variance = Rgb::from_fn(width, height, |_, _| [0; 3].map(|_| (0.01 * random()) as f32));
        [image, reference, variance]
    }

    #[test]
    fn equal_to_numpy() {
        let text = include_str!("../../tests/references/relmse.json");
        let cases: Vec<Case> = serde_json::from_str(text).unwrap();
        assert!(cases.len() >= 4);
        for case in cases {
            let [image, reference, variance] = pictures(case.width, case.height);
            let ours = relmse(&image, &reference, case.with_variance.then_some(&variance)).unwrap();
            let pairs = [
                (ours.mean, case.relmse.mean),
                (ours.trimmed, case.relmse.trimmed),
                (ours.clipped, case.relmse.clipped),
                (ours.median, case.relmse.median),
            ];
            for (ours, theirs) in pairs {
                assert!((ours - theirs).abs() <= 1e-9 * theirs.abs(), "{}x{}: {ours} {theirs}", case.width, case.height);
            }
        }
    }

    #[test]
    fn sizes_must_agree_and_equal_pictures_have_no_error() {
        let [image, reference, _] = pictures(16, 12);
        let none = relmse(&reference, &reference, None).unwrap();
        assert_eq!([none.mean, none.trimmed, none.clipped, none.median], [0.0; 4]);
        let small = image.crop(0, 0, 8, 8);
        let error = relmse(&small, &reference, None).unwrap_err().to_string();
        assert!(error.contains("8 x 8") && error.contains("16 x 12"), "{error}");
        assert!(relmse(&Rgb::default(), &Rgb::default(), None).is_err());
    }
    #[test]
    fn the_largest_are_left_out() {
        let errors: Vec<f64> = (0..2000).map(|i| f64::from(i * 7 % 2000)).collect();
        assert_eq!(trimmed_mean(&errors, 0.001), (0..1998).sum::<i32>() as f64 / 1998.0);
        assert_eq!(trimmed_mean(&errors[..10], 0.001), errors[..10].iter().sum::<f64>() / 10.0);
        assert_eq!(trimmed_mean(&[2.0, 2.0, 5.0, 2.0], 0.5), 2.0);
        assert_eq!(trimmed_mean(&[2.0], 1.0), 2.0);
        assert!(trimmed_mean(&[], 0.1).is_nan());
    }
}
