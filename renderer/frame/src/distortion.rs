//! Lens distortion: how far a lens bends straight lines.

use glam::{DMat2, DVec2};
use serde::{Deserialize, Serialize};

/// Most steps of Newton's method. Lenses need three to six.
const STEPS: usize = 24;
/// Difference in the image plane, in focal lengths, at which it stops.
const EXACT: f64 = 1e-13;

/// OpenCV's model of a lens (Brown 1966; Zhang 2000 with the rational extension of OpenCV's `calibrateCamera`). A point at
/// (x, y) of the plane at distance 1, x to the right and y down, with r^2 = x^2 + y^2, appears at
///
/// ```text
/// q  = (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6)
/// x' = x q + 2 p1 x y + p2 (r^2 + 2 x^2)
/// y' = y q + p1 (r^2 + 2 y^2) + 2 p2 x y
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Distortion {
    /// Radial coefficients, numerator.
    pub k1: f64,
    /// As `k1`, of the fourth power.
    pub k2: f64,
    /// As `k1`, of the sixth power.
    pub k3: f64,
    /// Radial coefficients, denominator.
    pub k4: f64,
    /// As `k4`, of the fourth power.
    pub k5: f64,
    /// As `k4`, of the sixth power.
    pub k6: f64,
    /// Tangential coefficients.
    pub p1: f64,
    /// As `p1`, across.
    pub p2: f64,
}

impl Distortion {
    /// Names of the coefficients, in the order of [`Self::coefficients`].
    pub const NAMES: [&str; 8] = ["k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2"];

    /// The coefficients.
    pub fn coefficients(&self) -> [f64; 8] {
        [self.k1, self.k2, self.k3, self.k4, self.k5, self.k6, self.p1, self.p2]
    }

    /// The lens with these coefficients; `None` where all of them are 0, so that lines stay straight.
    pub fn new([k1, k2, k3, k4, k5, k6, p1, p2]: [f64; 8]) -> Option<Self> {
        let lens = Self { k1, k2, k3, k4, k5, k6, p1, p2 };
        lens.coefficients().iter().any(|c| *c != 0.0).then_some(lens)
    }

    /// Where the point `p` of the plane at distance 1 appears.
    pub fn distort(&self, p: DVec2) -> DVec2 {
        self.with_slope(p).0
    }

    /// The point of the plane at distance 1 that appears at `q`, the inverse of [`Self::distort`]. `None` where the lens shows
    /// nothing at `q`, or folds the plane before it.
    pub fn undistort(&self, q: DVec2) -> Option<DVec2> {
        let mut p = q;
        for _ in 0..STEPS {
            let (shown, slope) = self.with_slope(p);
            let error = shown - q;
            // Beyond a fold the determinant has the other sign; NaN fails as well.
            let before_fold = slope.determinant() > 1e-9;
            if !before_fold {
                return None;
            }
            let step = slope.inverse() * error;
            // Half the plane at most, so that it does not jump over a fold.
            let limit = 0.5 * (1.0 + p.length());
            p -= step.clamp_length_max(limit);
            if error.abs().max_element() < EXACT {
                break;
            }
        }
        let (shown, slope) = self.with_slope(p);
        (shown.distance(q) < 1e-9 * (1.0 + q.length()) && slope.determinant() > 0.0).then_some(p)
    }

    /// [`Self::distort`] with its derivative.
    fn with_slope(&self, p: DVec2) -> (DVec2, DMat2) {
        let Self { k1, k2, k3, k4, k5, k6, p1, p2 } = *self;
        let DVec2 { x, y } = p;
        let r2 = x * x + y * y;
        let (above, below) = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)), 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)));
        let q = above / below;
        // Derivative by r^2.
        let d = (k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3) - q * (k4 + r2 * (2.0 * k5 + 3.0 * r2 * k6))) / below;
        let shown =
            DVec2::new(x * q + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x), y * q + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y);
        let mixed = 2.0 * (x * y * d + p1 * x + p2 * y);
        let slope = DMat2::from_cols(
            DVec2::new(q + 2.0 * x * x * d + 2.0 * p1 * y + 6.0 * p2 * x, mixed),
            DVec2::new(mixed, q + 2.0 * y * y * d + 6.0 * p1 * y + 2.0 * p2 * x),
        );
        (shown, slope)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points projected by OpenCV 5 (`cv2.projectPoints` with the coefficients in its order k1 k2 p1 p2 k3 k4 k5 k6).
    #[test]
    fn points_appear_where_opencv_says() {
        for line in include_str!("../tests/references/distortion.csv").lines().skip(1) {
            let numbers: Vec<f64> = line.split(',').map(|v| v.parse().unwrap()).collect();
            let [k1, k2, p1, p2, k3, k4, k5, k6, x, y, u, v] = numbers.try_into().unwrap();
            let lens = Distortion { k1, k2, k3, k4, k5, k6, p1, p2 };
            let (point, shown) = (DVec2::new(x, y), DVec2::new(u, v));
            assert!(lens.distort(point).distance(shown) < 1e-12, "{line}: {}", lens.distort(point));
            let back = lens.undistort(shown).expect("inside the lens");
            assert!(back.distance(point) < 1e-9, "{line}: {back}");
        }
    }

    #[test]
    fn a_lens_that_folds_shows_nothing_beyond() {
        // x (1 - x^2 / 3) rises to 2/3 at 1 and falls beyond.
        let lens = Distortion { k1: -1.0 / 3.0, ..Distortion::default() };
        assert!(lens.undistort(DVec2::new(0.6, 0.0)).is_some());
        for q in [0.67, 0.7, 2.0, 1e30, f64::NAN] {
            assert_eq!(lens.undistort(DVec2::new(q, 0.0)), None, "{q}");
        }
        assert_eq!(Distortion::new([0.0; 8]), None);
    }
}
