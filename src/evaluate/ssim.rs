//! Structural similarity (Wang et al. 2004): Gaussian window 11x11, sigma 1.5, population covariance, peak 1, mean of the three channels.

use renderflow_frame::image::Rgb;

const RADIUS: usize = 5;
const SIGMA: f64 = 1.5;
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;

/// SSIM of two pictures of display values in 0..=1, as scikit-image computes it with `gaussian_weights=True, sigma=1.5,
/// use_sample_covariance=False, data_range=1`: the mean over pixels whose whole window lies inside the picture.
/// `None` for pictures smaller than the window.
pub fn ssim(a: &Rgb, b: &Rgb) -> Option<f64> {
    let (width, height) = (a.width, a.height);
    if width <= 2 * RADIUS || height <= 2 * RADIUS || (width, height) != (b.width, b.height) {
        return None;
    }
    let mut total = 0.0;
    for channel in 0..3 {
        let plane = |image: &Rgb| image.pixels.iter().map(|p| f64::from(p[channel])).collect::<Vec<_>>();
        let (x, y) = (plane(a), plane(b));
        let product = |p: &[f64], q: &[f64]| p.iter().zip(q).map(|(p, q)| p * q).collect::<Vec<_>>();
        let [mx, my, xx, yy, xy] =
            [x.clone(), y.clone(), product(&x, &x), product(&y, &y), product(&x, &y)].map(|p| blur(&p, width, height));
        let count = mx.len();
        total += (0..count)
            .map(|i| {
                let (vx, vy, cov) = (xx[i] - mx[i] * mx[i], yy[i] - my[i] * my[i], xy[i] - mx[i] * my[i]);
                (2.0 * mx[i] * my[i] + C1) * (2.0 * cov + C2) / ((mx[i] * mx[i] + my[i] * my[i] + C1) * (vx + vy + C2))
            })
            .sum::<f64>()
            / count as f64;
    }
    Some(total / 3.0)
}

/// Gaussian mean of every window inside the picture: `(width - 10) x (height - 10)` values.
fn blur(plane: &[f64], width: usize, height: usize) -> Vec<f64> {
    let weights: Vec<f64> = (0..=2 * RADIUS).map(|i| (-0.5 * ((i as f64 - RADIUS as f64) / SIGMA).powi(2)).exp()).collect();
    let norm: f64 = weights.iter().sum();
    let inner = width - 2 * RADIUS;
    let rows: Vec<f64> = (0..height)
        .flat_map(|y| (0..inner).map(move |x| (x, y)))
        .map(|(x, y)| weights.iter().zip(&plane[y * width + x..]).map(|(w, v)| w * v).sum::<f64>() / norm)
        .collect();
    (0..height - 2 * RADIUS)
        .flat_map(|y| (0..inner).map(move |x| (x, y)))
        .map(|(x, y)| weights.iter().enumerate().map(|(i, w)| w * rows[(y + i) * inner + x]).sum::<f64>() / norm)
        .collect()
}
