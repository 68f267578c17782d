//! What the samples of one pixel add up to.
//!
//! Every sample belongs to exactly one pixel (the filter is importance sampled, never splatted), so pixels stay independent: that
//! is what makes the picture independent of threads and tiles, and what denoisers expect. Radiance is summed in twice double
//! precision (some 32 digits): at 65536 samples of a bright sun single-precision sums lose the dim samples, and double-precision
//! sums round differently in another order, which shows in the variance of pixels that have nearly none. It costs about one
//! instruction in a hundred (docs/measurements/renderer-notes.md, small).

use bytemuck::Zeroable;
use glam::{DVec3, Vec3A};
use renderflow_frame::frame::LIGHT_GROUPS;
use serde::{Deserialize, Serialize};

/// Running sums of one pixel's radiance.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Zeroable)]
pub struct PixelStatistics {
    count: u64,
    sum: Sum,
    sum_of_squares: Sum,
}

/// A sum in two parts, `high` the double next to it and `low` the rest: `high` does not depend on the order of the terms.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize, Zeroable)]
struct Sum {
    high: DVec3,
    low: DVec3,
}

impl Sum {
    /// Adds; only `low` is rounded (Dekker 1971; the first step is Knuth's TwoSum).
    #[inline]
    fn add(&mut self, value: DVec3, low: DVec3) {
        let sum = self.high + value;
        let part = sum - self.high;
        let lost = (self.high - (sum - part)) + (value - part);
        let low = self.low + low + lost;
        self.high = sum + low;
        self.low = low - (self.high - sum);
    }
}

/// Sums are equal where they are equal in double precision.
impl PartialEq for Sum {
    fn eq(&self, other: &Self) -> bool {
        self.high == other.high
    }
}

impl PixelStatistics {
    /// Adds one finite sample of radiance.
    #[inline]
    pub fn push(&mut self, radiance: Vec3A) {
        let value = radiance.as_dvec3();
        self.count += 1;
        self.sum.add(value, DVec3::ZERO);
        // Exact: a product of two single-precision numbers fits into double precision.
        self.sum_of_squares.add(value * value, DVec3::ZERO);
    }

    /// Adds the samples of `other`, as if they had been pushed here.
    pub fn merge(&mut self, other: &Self) {
        self.count += other.count;
        self.sum.add(other.sum.high, other.sum.low);
        self.sum_of_squares.add(other.sum_of_squares.high, other.sum_of_squares.low);
    }

    /// Number of samples so far.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Mean radiance, 0 without samples.
    pub fn mean(&self) -> [f32; 3] {
        mean(self.sum.high, self.count)
    }

    /// Mean radiance in double precision, 0 without samples.
    pub(crate) fn mean_f64(&self) -> DVec3 {
        self.sum.high / self.count.max(1) as f64
    }

    /// Variance of the mean, as if samples were independent: with low-discrepancy samples an upper estimate. 0 below two
    /// samples; a variance beyond single precision (radiance above some 1e19) is its largest number.
    pub fn variance_of_mean(&self) -> [f32; 3] {
        self.variance_of_mean_f64().min(DVec3::splat(f32::MAX.into())).as_vec3().to_array()
    }

    /// As [`Self::variance_of_mean`], in double precision.
    pub(crate) fn variance_of_mean_f64(&self) -> DVec3 {
        if self.count < 2 {
            return DVec3::ZERO;
        }
        let n = self.count as f64;
        // Squares less n times the squared mean, which cancel in double precision where samples are nearly equal: products with
        // their roundings (fused multiply-add gives these exactly).
        let (sum, squares) = (self.sum.high, self.sum_of_squares.high);
        let mean = sum / n;
        let rest = mean.mul_add(DVec3::splat(-n), sum) + self.sum.low;
        let product = mean * sum;
        let rounding = mean.mul_add(sum, -product);
        let spread = ((squares - product) + (self.sum_of_squares.low - rounding) - mean * (rest + self.sum.low)).max(DVec3::ZERO);
        spread / (n * (n - 1.0))
    }
}

fn mean(sum: DVec3, count: u64) -> [f32; 3] {
    (sum / count.max(1) as f64).as_vec3().to_array()
}

/// Base colour and world-space shading normal where a camera ray first hits.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FirstHit {
    pub albedo: Vec3A,
    pub ns: Vec3A,
}

/// Sums of what the camera rays of one pixel hit first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Zeroable)]
pub(crate) struct GuideStatistics {
    rays: u64,
    hits: u64,
    albedo: DVec3,
    normal: DVec3,
}

impl GuideStatistics {
    #[inline]
    pub fn push(&mut self, first: Option<FirstHit>) {
        self.rays += 1;
        if let Some(first) = first {
            self.hits += 1;
            self.albedo += first.albedo.as_dvec3();
            self.normal += first.ns.as_dvec3();
        }
    }

    /// Counts `count` rays that all meet one surface, or nothing; `first` is their mean first hit.
    #[inline]
    pub fn push_alike(&mut self, count: u64, first: Option<FirstHit>) {
        self.rays += count;
        if let Some(first) = first {
            self.hits += count;
            self.albedo += first.albedo.as_dvec3() * count as f64;
            self.normal += first.ns.as_dvec3() * count as f64;
        }
    }

    /// Counts rays that are known to hit nothing.
    pub fn push_misses(&mut self, count: u64) {
        self.rays += count;
    }

    pub fn merge(&mut self, other: &Self) {
        self.rays += other.rays;
        self.hits += other.hits;
        self.albedo += other.albedo;
        self.normal += other.normal;
    }

    pub fn coverage(&self) -> f32 {
        (self.hits as f64 / self.rays.max(1) as f64) as f32
    }

    /// Mean base colour, a miss counting as black.
    pub fn albedo(&self) -> [f32; 3] {
        // Rounding must not leave the range the channel promises.
        mean(self.albedo, self.rays).map(|v| v.min(self.coverage()))
    }

    /// Mean world-space normal, a miss counting as zero.
    pub fn normal(&self) -> Vec3A {
        Vec3A::from_array(mean(self.normal, self.rays))
    }
}

/// Sums of what light paths contribute to one pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Zeroable)]
pub(crate) struct LightStatistics {
    sum: Sum,
    squares: Sum,
}

impl LightStatistics {
    /// Adds the contribution of one light path.
    #[inline]
    pub fn push(&mut self, radiance: Vec3A) {
        let value = radiance.as_dvec3();
        self.sum.add(value, DVec3::ZERO);
        self.squares.add(value * value, DVec3::ZERO);
    }

    pub fn merge(&mut self, other: &Self) {
        self.sum.add(other.sum.high, other.sum.low);
        self.squares.add(other.squares.high, other.squares.low);
    }

    /// Radiance by the light paths of `samples` samples per pixel.
    pub fn mean(&self, samples: u32) -> DVec3 {
        self.sum.high / f64::from(samples.max(1))
    }

    /// Variance of [`Self::mean`], for few of many light paths reach a pixel.
    pub fn variance_of_mean(&self, samples: u32) -> DVec3 {
        self.squares.high / f64::from(samples.max(1)).powi(2)
    }
}

/// Sums of indirect and of hidden light of one pixel; see [`renderflow_frame::Frame::indirect`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Zeroable)]
pub(crate) struct PathStatistics {
    count: u64,
    indirect: DVec3,
    hidden: DVec3,
}

impl PathStatistics {
    #[inline]
    pub fn push(&mut self, [indirect, hidden]: [Vec3A; 2]) {
        self.count += 1;
        self.indirect += indirect.as_dvec3();
        self.hidden += hidden.as_dvec3();
    }

    pub fn merge(&mut self, other: &Self) {
        self.count += other.count;
        self.indirect += other.indirect;
        self.hidden += other.hidden;
    }

    /// Mean indirect light of the samples, without that of light paths.
    pub fn indirect(&self) -> [f32; 3] {
        mean(self.indirect, self.count)
    }

    /// Mean hidden light.
    pub fn hidden(&self) -> [f32; 3] {
        mean(self.hidden, self.count)
    }
}

/// Sums of one pixel's light groups.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Zeroable)]
pub(crate) struct GroupStatistics {
    count: u64,
    sums: [DVec3; LIGHT_GROUPS],
}

impl GroupStatistics {
    #[inline]
    pub fn push(&mut self, groups: &[Vec3A; LIGHT_GROUPS]) {
        self.count += 1;
        for (sum, value) in self.sums.iter_mut().zip(groups) {
            *sum += value.as_dvec3();
        }
    }

    pub fn merge(&mut self, other: &Self) {
        self.count += other.count;
        for (sum, value) in self.sums.iter_mut().zip(&other.sums) {
            *sum += *value;
        }
    }

    /// Adds to one group alone.
    pub fn push_to(&mut self, group: usize, radiance: Vec3A) {
        if let Some(sum) = self.sums.get_mut(group) {
            *sum += radiance.as_dvec3();
        }
    }

    /// The sum of a group over `count`.
    pub fn sum_over(&self, group: usize, count: u32) -> DVec3 {
        self.sums[group] / f64::from(count.max(1))
    }

    pub fn mean(&self, group: usize) -> DVec3 {
        self.sums[group] / self.count.max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mean_and_variance_match_the_textbook() {
        let mut film = PixelStatistics::default();
        for v in [2.0, 4.0, 4.0, 4.0, 5.0, 5.0, 7.0, 9.0] {
            film.push(Vec3A::splat(v));
        }
        // Sample variance 32/7, divided by 8 samples.
        assert_eq!(film.mean(), [5.0; 3]);
        assert!((film.variance_of_mean()[1] - 32.0 / 56.0).abs() < 1e-6);
    }

    #[test]
    fn merging_equals_pushing() {
        let values: Vec<Vec3A> = (0..64).map(|i| Vec3A::new(i as f32, 1.0 / (i + 1) as f32, 1e4)).collect();
        let (mut whole, mut left, mut right) = <(PixelStatistics, PixelStatistics, PixelStatistics)>::default();
        values.iter().for_each(|&v| whole.push(v));
        values[..20].iter().for_each(|&v| left.push(v));
        values[20..].iter().for_each(|&v| right.push(v));
        left.merge(&right);
        assert_eq!((left.count(), left.mean()), (whole.count(), whole.mean()));
        assert_eq!(left.variance_of_mean(), whole.variance_of_mean());
    }

    #[test]
    fn a_bright_sample_does_not_swallow_dim_ones() {
        let mut film = PixelStatistics::default();
        film.push(Vec3A::splat(1e7));
        for _ in 1..65536 {
            film.push(Vec3A::splat(0.25));
        }
        let exact = (1e7 + 0.25 * 65535.0) / 65536.0;
        assert!((f64::from(film.mean()[0]) - exact).abs() < 1e-4);
    }

    #[test]
    fn guides_count_misses() {
        let mut guides = GuideStatistics::default();
        guides.push(Some(FirstHit { albedo: Vec3A::splat(0.8), ns: Vec3A::Z }));
        guides.push(None);
        guides.push_misses(2);
        assert_eq!(guides.coverage(), 0.25);
        assert!((guides.albedo()[1] - 0.2).abs() < 1e-7 && guides.normal() == Vec3A::Z * 0.25);
        let (mut alike, first) = (GuideStatistics::default(), FirstHit { albedo: Vec3A::splat(0.8), ns: Vec3A::Z });
        alike.push_alike(1, Some(first));
        alike.push_alike(3, None);
        assert!(alike == guides);
    }
}
