//! Structural similarity (Wang et al. 2004): Gaussian window 11x11, sigma 1.5, population covariance, peak 1, mean of the three
//! channels.

use super::convolve::{Taps, accumulate};
use renderflow_frame::Image;
use renderflow_frame::image::Rgb;

/// Half the window.
const RADIUS: usize = 5;
const WINDOW: usize = 2 * RADIUS + 1;
const SIGMA: f64 = 1.5;
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;

/// SSIM of every window that lies inside the picture, and their mean.
#[derive(Clone, Debug, PartialEq)]
pub struct SsimMap {
    /// `(width - 10) x (height - 10)` values in -1..=1, mean of the channels; pixel (x, y) is the window centred on (x + 5, y +
    /// 5).
    pub map: Image<f32>,
    /// Mean of the map, before it was rounded to single precision.
    pub mean: f64,
}

impl SsimMap {
    /// Mean over the windows whose centre has `mask` above 0; `None` when there are none. `mask` is of the picture's size.
    pub fn masked(&self, mask: &Image<f32>) -> Option<f64> {
        let centre = |i: usize| (i % self.map.width + RADIUS, i / self.map.width + RADIUS);
        let (mut sum, mut count) = (0.0, 0usize);
        for (i, &value) in self.map.pixels.iter().enumerate() {
            let (x, y) = centre(i);
            if x < mask.width && mask.pixels.get(y * mask.width + x).is_some_and(|m| *m > 0.0) {
                sum += f64::from(value);
                count += 1;
            }
        }
        (count > 0).then(|| sum / count as f64)
    }
}

/// SSIM of two pictures of display values in 0..=1, as scikit-image computes it with `gaussian_weights=True, sigma=1.5,
/// use_sample_covariance=False, data_range=1`: the mean over pixels whose whole window lies inside the picture.
/// `None` for pictures smaller than the window, or of two sizes.
pub fn ssim(a: &Rgb, b: &Rgb) -> Option<f64> {
    Some(ssim_map(a, b)?.mean)
}

/// [`ssim`] with the value of every window.
pub fn ssim_map(a: &Rgb, b: &Rgb) -> Option<SsimMap> {
    let (width, height) = (a.width, a.height);
    if width < WINDOW || height < WINDOW || (width, height) != (b.width, b.height) {
        return None;
    }
    let (inner, rows) = (width - 2 * RADIUS, height - 2 * RADIUS);
    let taps = window();
    let mut map = vec![0.0f64; inner * rows];
    // The last eleven blurred rows of both means, the sum of both squares (SSIM needs no more of them), and the product.
    let mut ring: [Vec<f64>; 4] = std::array::from_fn(|_| vec![0.0; WINDOW * inner]);
    let mut line: [Vec<f64>; 4] = std::array::from_fn(|_| vec![0.0; width]);
    let mut column: [Vec<f64>; 4] = std::array::from_fn(|_| vec![0.0; inner]);
    for channel in 0..3 {
        for y in 0..height {
            let row = y * width..(y + 1) * width;
            let [x_line, y_line, squares, products] = &mut line;
            for (i, (a, b)) in a.pixels[row.clone()].iter().zip(&b.pixels[row]).enumerate() {
                let (a, b) = (f64::from(a[channel]), f64::from(b[channel]));
                (x_line[i], y_line[i], squares[i], products[i]) = (a, b, a * a + b * b, a * b);
            }
            for (ring, line) in ring.iter_mut().zip(&line) {
                let slot = &mut ring[y % WINDOW * inner..][..inner];
                slot.fill(0.0);
                accumulate(&taps, |i| &line[RADIUS.wrapping_add_signed(i)..], slot);
            }
            let Some(top) = y.checked_sub(2 * RADIUS) else { continue };
            for (ring, column) in ring.iter().zip(&mut column) {
                column.fill(0.0);
                accumulate(&taps, |i| &ring[(top + RADIUS.wrapping_add_signed(i)) % WINDOW * inner..], column);
            }
            let [mx, my, squares, products] = &column;
            for (i, value) in map[top * inner..][..inner].iter_mut().enumerate() {
                let (product, sum) = (mx[i] * my[i], mx[i] * mx[i] + my[i] * my[i]);
                *value += (2.0 * product + C1) * (2.0 * (products[i] - product) + C2) / ((sum + C1) * (squares[i] - sum + C2));
            }
        }
    }
    map.iter_mut().for_each(|v| *v /= 3.0);
    let mean = map.iter().sum::<f64>() / map.len() as f64;
    let pixels = map.iter().map(|v| *v as f32).collect();
    Some(SsimMap { map: Image { width: inner, height: rows, pixels }, mean })
}

/// The Gaussian from its centre outwards, the whole window summing to 1.
fn window() -> Taps<f64> {
    let half: Vec<f64> = (0..=RADIUS).map(|i| (-0.5 * (i as f64 / SIGMA).powi(2)).exp()).collect();
    let norm = half[0] + 2.0 * half[1..].iter().sum::<f64>();
    Taps::Even(half.iter().map(|v| v / norm).collect())
}
