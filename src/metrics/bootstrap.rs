//! Intervals of means over sequences, by the bootstrap (Efron 1979). Sequences were drawn at random, and the frames of one
//! sequence are alike, so whole sequences are resampled.

use rand_pcg::Pcg64Mcg;
use rand_pcg::rand_core::{Rng, SeedableRng};
use serde::{Deserialize, Serialize};

/// Number of resamples.
pub const RESAMPLES: usize = 2000;
/// Share of the means that the interval holds.
pub const CONFIDENCE: f64 = 0.95;
/// All methods and metrics use the same draws, so that their intervals do not differ by chance alone.
const SEED: u64 = 0x5eed;

/// A mean with its 95 % interval: the percentile interval of the means of resampled sequences, widened about the mean by
/// [`widened`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    /// Mean over the sequences.
    pub mean: f64,
    /// Lower and upper end; `None` for a single sequence, which says nothing about others.
    pub range: Option<[f64; 2]>,
    /// Number of sequences.
    pub sequences: usize,
}

impl Interval {
    /// Whether the interval excludes 0. Where the true difference is 0, this happens for one of twenty draws of sequences.
    pub fn is_clear(&self) -> bool {
        self.range.is_some_and(|[low, high]| low > 0.0 || high < 0.0)
    }

    /// The mean with so many `digits` behind the point, and the range in brackets if there is one.
    pub fn shown(&self, digits: usize) -> String {
        let range = self.range.map_or(String::new(), |[low, high]| format!(" ({low:.digits$} to {high:.digits$})"));
        format!("{:.digits$}{range}", self.mean)
    }
}

/// By how much percentile intervals of the means of `count` values, 2 or more, are too narrow. The means of resampled values
/// spread as if the variance were that of the values about their own mean, which is (n - 1) / n of the best estimate, and as if
/// that estimate were exact. Student's t knows that it is not (Hesterberg, "What Teachers Should Know about the Bootstrap",
/// 2015). Unwidened, intervals of three, eight and 23 normally distributed values hold the true mean in 76, 89 and 93 % of all
/// draws.
pub fn widened(count: usize) -> f64 {
    /// Half a normal distribution's 95 % interval.
    const Z: f64 = 1.959_963_985;
    /// The same of Student's t distribution, from one degree of freedom on.
    const T: [f64; 10] =
        [12.706_205, 4.302_653, 3.182_446, 2.776_445, 2.570_582, 2.446_912, 2.364_624, 2.306_004, 2.262_157, 2.228_139];
    let freedom = count.max(2) - 1;
    let t = T.get(freedom - 1).copied().unwrap_or_else(|| {
        // Cornish and Fisher's expansion (Abramowitz and Stegun 26.7.5).
        let f = freedom as f64;
        let [z3, z5, z7] = [3, 5, 7].map(|power| Z.powi(power));
        Z + (z3 + Z) / (4.0 * f)
            + (5.0 * z5 + 16.0 * z3 + 3.0 * Z) / (96.0 * f.powi(2))
            + (3.0 * z7 + 19.0 * z5 + 17.0 * z3 - 15.0 * Z) / (384.0 * f.powi(3))
    });
    t / Z * ((freedom + 1) as f64 / freedom as f64).sqrt()
}

/// The interval of the mean of `sequences`; each value is the mean of a sequence's frames. `None` when there are none, or one is
/// not finite.
pub fn bootstrap(sequences: &[f64]) -> Option<Interval> {
    if sequences.is_empty() || sequences.iter().any(|v| !v.is_finite()) {
        return None;
    }
    let count = sequences.len();
    let mean = sequences.iter().sum::<f64>() / count as f64;
    if count == 1 {
        return Some(Interval { mean, range: None, sequences: 1 });
    }
    let mut rng = Pcg64Mcg::seed_from_u64(SEED);
    // The high half of a product is an index below `count` without a division; its bias of count / 2^64 does not matter.
    let mut draw = || sequences[((u128::from(rng.next_u64()) * count as u128) >> 64) as usize];
    let mut means: Vec<f64> = (0..RESAMPLES).map(|_| (0..count).map(|_| draw()).sum::<f64>() / count as f64).collect();
    means.sort_by(f64::total_cmp);
    let tail = 0.5 * (1.0 - CONFIDENCE);
    let range = [tail, 1.0 - tail].map(|share| mean + widened(count) * (super::relmse::percentile(&means, share) - mean));
    Some(Interval { mean, range: Some(range), sequences: count })
}

/// The interval of the mean difference `a - b` of two methods on the same sequences, in the same order. Sequences without both
/// values are left out. It is much narrower than the intervals of the two methods, since a hard sequence is hard for both. `None`
/// when no sequence has both values, the lists differ in length, or a value is not finite.
pub fn bootstrap_difference(a: &[Option<f64>], b: &[Option<f64>]) -> Option<Interval> {
    if a.len() != b.len() {
        return None;
    }
    let both: Vec<f64> = a.iter().zip(b).filter_map(|(a, b)| Some((*a)? - (*b)?)).collect();
    bootstrap(&both)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_difference_is_surer_than_two_means() {
        let hard: Vec<f64> = (0..20).map(|i| f64::from(i * 7 % 20)).collect();
        let [a, b] =
            [0.5, 0.0].map(|d| hard.iter().enumerate().map(|(i, v)| Some(v + d + 0.1 * (i % 3) as f64 * d)).collect::<Vec<_>>());
        let present = |v: &[Option<f64>]| bootstrap(&v.iter().flatten().copied().collect::<Vec<_>>()).unwrap();
        let [low, high] = present(&a).range.unwrap();
        let difference = bootstrap_difference(&a, &b).unwrap();
        let [from, to] = difference.range.unwrap();
        assert!(to - from < 0.05 * (high - low) && difference.is_clear());
        assert!((difference.mean - (present(&a).mean - present(&b).mean)).abs() < 1e-9);
        assert!(from < difference.mean && difference.mean < to && !bootstrap_difference(&b, &b).unwrap().is_clear());
        let some = bootstrap_difference(&[Some(2.0), None, Some(3.0)], &[Some(1.0), Some(9.0), None]).unwrap();
        assert_eq!((some.mean, some.sequences), (1.0, 1));
    }

    #[test]
    fn nothing_is_made_up() {
        assert_eq!(bootstrap(&[]), None);
        assert_eq!(bootstrap(&[1.0, f64::NAN]), None);
        assert_eq!(bootstrap(&[1.0, f64::INFINITY]), None);
        assert_eq!(bootstrap_difference(&[Some(1.0)], &[]), None);
        assert_eq!(bootstrap_difference(&[Some(1.0)], &[None]), None);
        let one = bootstrap(&[4.0]).unwrap();
        assert_eq!((one.mean, one.range, one.is_clear()), (4.0, None, false));
        assert_eq!(bootstrap(&[4.0; 7]).unwrap().range, Some([4.0; 2]));
        let values = [1.0, 5.0, 2.0];
        assert_eq!(bootstrap(&values), bootstrap(&values));
        let text = serde_json::to_string(&one).unwrap();
        assert_eq!(serde_json::from_str::<Interval>(&text).unwrap(), one, "{text}");
    }
}
