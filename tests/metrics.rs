//! The metrics against the programs everybody uses: scikit-image, flip-evaluator, lpips and scipy. Their numbers were made by the
//! scripts `tests/references/*_metrics.py`; the pictures come from a generator that is in `metrics_pairs.py` and here.

use renderflow::metrics::Networks;
use renderflow::metrics::bootstrap::{bootstrap, widened};
use renderflow::metrics::flip::{FlipMap, Seen, Viewing};
use renderflow::metrics::psnr::{psnr, psnr_masked};
use renderflow::metrics::ssim::{ssim, ssim_map};
use renderflow_frame::Image;
use renderflow_frame::image::Rgb;
use renderflow_model::lpips::{Backbone, weights_folder};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use std::path::Path;

fn flip(a: &Rgb, b: &Rgb, viewing: Viewing) -> Option<FlipMap> {
    Seen::new(a, viewing)?.compare(&Seen::new(b, viewing)?)
}

/// How a pair is named in the files.
#[derive(Debug, Deserialize)]
struct Pair {
    kind: String,
    width: usize,
    height: usize,
    amount: f64,
}

fn generator(seed: u32) -> impl FnMut() -> f64 {
    let mut state = seed;
    move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(state >> 8) / f64::from(1 << 24)
    }
}

/// Pixels of doubles, before they are rounded.
type Exact = Image<[f64; 3]>;

fn single(picture: &Exact) -> Rgb {
    picture.map(|p| p.map(|v| v as f32))
}

fn random(width: usize, height: usize, seed: u32) -> Exact {
    let mut next = generator(seed);
    Image::from_fn(width, height, |_, _| [0; 3].map(|_| next()))
}

/// A ramp mixed with noise.
fn mixed(width: usize, height: usize, seed: u32, smooth: f64) -> Rgb {
    let noise = random(width, height, seed);
    single(&Image::from_fn(width, height, |x, y| {
        let ramp = ((x * 3 + y * 5) % 64) as f64 / 64.0;
        noise.at(x, y).map(|v| smooth * ramp + (1.0 - smooth) * v)
    }))
}

fn disc(width: usize, height: usize) -> Image<f32> {
    let away = |at: usize, size: usize| (2 * at as i64 + 1 - size as i64).pow(2);
    let limit = 4 * (width.min(height) as i64).pow(2);
    Image::from_fn(width, height, |x, y| f32::from(u8::from(9 * (away(x, width) + away(y, height)) < limit)))
}

/// A coloured disc before a gradient, with a little noise.
fn scene(width: usize, height: usize) -> Rgb {
    let (noise, mask) = (random(width, height, 5), disc(width, height));
    single(&Image::from_fn(width, height, |x, y| {
        let (u, v) = (x as f64 / width as f64, y as f64 / height as f64);
        let behind = [u, v, (x + y) as f64 / (width + height) as f64];
        let before = [0.75, 0.5, 0.125].map(|c| c * (0.25 + 0.75 * v));
        let picture = if *mask.at(x, y) > 0.0 { before } else { behind };
        std::array::from_fn(|c| 0.9 * picture[c] + 0.1 * noise.at(x, y)[c])
    }))
}

impl Pair {
    fn pictures(&self) -> [Rgb; 2] {
        let (width, height, amount) = (self.width, self.height, self.amount);
        let a = scene(width, height);
        let exact = a.map(|p| p.map(f64::from));
        let each = |f: &dyn Fn(usize, usize, usize) -> f64| {
            single(&Image::from_fn(width, height, |x, y| std::array::from_fn(|c| f(x, y, c))))
        };
        let at = |x: usize, y: usize, c: usize| exact.at(x, y)[c];
        let b = match self.kind.as_str() {
            "mixed" => return [(1, 1.0 - amount / 2.0), (2, 1.0 - amount)].map(|(seed, s)| mixed(width, height, seed, s)),
            "black_white" => return [0.0, 1.0].map(|v| Rgb::filled(width, height, [v; 3])),
            "checkers" => {
                let side = amount as usize;
                return [0, 1].map(|first| each(&|x, y, _| ((x / side + y / side + first) % 2) as f64));
            }
            "dark" => {
                let b = each(&|x, y, c| at(x, y, c) * amount * 0.5 + amount * 0.25);
                return [each(&|x, y, c| at(x, y, c) * amount), b];
            }
            "identical" => a.clone(),
            "noise" => {
                let noise = random(width, height, 9);
                each(&|x, y, c| (at(x, y, c) + amount * (noise.at(x, y)[c] - 0.5)).clamp(0.0, 1.0))
            }
            "blur" => each(&|x, y, c| {
                let near = |v: usize, d: usize, size: usize| (v + d).saturating_sub(1).min(size - 1);
                let taps = (0..3).flat_map(|dy| (0..3).map(move |dx| (dx, dy)));
                taps.map(|(dx, dy)| at(near(x, dx, width), near(y, dy, height), c)).sum::<f64>() / 9.0
            }),
            "shift" => each(&|x, y, c| at((x + width * amount as usize - amount as usize) % width, y, c)),
            "cast" => each(&|x, y, c| at(x, y, c) * (1.0 - amount * [0.0, 0.25, 1.0][c])),
            other => panic!("a pair of kind {other}"),
        };
        [a, b]
    }

    fn mask(&self) -> Image<f32> {
        disc(self.width, self.height)
    }
}

#[derive(Deserialize)]
struct File<T> {
    cases: Vec<T>,
}

fn read<T: DeserializeOwned>(text: &str) -> Vec<T> {
    let file: File<T> = serde_json::from_str(text).unwrap();
    assert!(file.cases.len() >= 6);
    file.cases
}

/// The largest difference of one metric over all pairs.
#[derive(Default)]
struct Worst {
    difference: f64,
    count: usize,
    place: String,
}

impl Worst {
    fn compare(&mut self, ours: Option<f64>, theirs: Option<f64>, place: impl std::fmt::Debug) {
        let (ours, theirs) = match (ours, theirs) {
            (None, None) => return,
            (Some(ours), Some(theirs)) => (ours, theirs),
            other => panic!("{place:?}: {other:?}"),
        };
        let difference = if ours == theirs { 0.0 } else { (ours - theirs).abs() };
        self.count += 1;
        if difference.is_nan() || difference >= self.difference {
            (self.difference, self.place) = (difference, format!("{place:?}: {ours} against {theirs}"));
        }
    }

    /// Whether there were enough pairs and none differed by more; says so.
    #[must_use]
    fn passes(&self, name: &str, pairs: usize, tolerance: f64) -> bool {
        let passes = self.count >= pairs && self.difference <= tolerance;
        let verdict = if passes { "" } else { "FAILED " };
        println!("{verdict}{name}: worst difference {:.2e} of {} pairs, at {}", self.difference, self.count, self.place);
        passes
    }
}

#[test]
fn equal_to_scikit_image() {
    #[derive(Deserialize)]
    struct Case {
        #[serde(flatten)]
        pair: Pair,
        psnr: Option<f64>,
        psnr_masked: Option<f64>,
        ssim: Option<f64>,
        ssim_masked: Option<f64>,
    }
    let mut worst: [Worst; 4] = Default::default();
    for case in read::<Case>(include_str!("references/skimage_metrics.json")) {
        let ([a, b], mask) = (case.pair.pictures(), case.pair.mask());
        let [full, masked, ours_ssim, ours_ssim_masked] = &mut worst;
        // JSON has no infinity: null is it.
        full.compare(Some(psnr(&a, &b)), Some(case.psnr.unwrap_or(f64::INFINITY)), &case.pair);
        let covered = mask.pixels.iter().any(|m| *m > 0.0);
        let theirs = covered.then(|| case.psnr_masked.unwrap_or(f64::INFINITY));
        masked.compare(psnr_masked(&a, &b, &mask), theirs, &case.pair);
        let map = ssim_map(&a, &b);
        ours_ssim.compare(map.as_ref().map(|m| m.mean), case.ssim, &case.pair);
        ours_ssim_masked.compare(map.and_then(|m| m.masked(&mask)), case.ssim_masked, &case.pair);
    }
    let [full, masked, ours_ssim, ours_ssim_masked] = worst;
    let passed = [
        full.passes("PSNR", 30, 1e-9),
        masked.passes("PSNR masked", 25, 1e-9),
        ours_ssim.passes("SSIM", 25, 1e-9),
        // The map is of single precision.
        ours_ssim_masked.passes("SSIM masked", 25, 1e-7),
    ];
    assert_eq!(passed, [true; 4]);
}

#[test]
fn equal_to_flip_evaluator() {
    #[derive(Deserialize)]
    struct Case {
        #[serde(flatten)]
        pair: Pair,
        pixels_per_degree: Option<f64>,
        flip: f64,
        largest: f64,
        flip_masked: Option<f64>,
    }
    let [mut mean, mut largest, mut masked]: [Worst; 3] = Default::default();
    for case in read::<Case>(include_str!("references/flip_metrics.json")) {
        let [a, b] = case.pair.pictures();
        let viewing = case.pixels_per_degree.map_or_else(Viewing::default, |pixels_per_degree| Viewing { pixels_per_degree });
        let ours = flip(&a, &b, viewing).unwrap();
        let place = (&case.pair, viewing);
        mean.compare(Some(ours.mean), Some(case.flip), place);
        largest.compare(Some(ours.map.pixels.iter().copied().fold(0.0, f32::max).into()), Some(case.largest), place);
        masked.compare(ours.masked(&case.pair.mask()), case.flip_masked, place);
    }
    // Where edges agree but for rounding (a board and its negative) the square root of their difference makes 1e-8 to 1e-4.
    let passed = [
        mean.passes("FLIP", 30, 5e-5),
        largest.passes("FLIP of the worst pixel", 30, 1e-4),
        masked.passes("FLIP masked", 25, 5e-5),
    ];
    assert_eq!(passed, [true; 3]);
    let text: serde_json::Value = serde_json::from_str(include_str!("references/flip_metrics.json")).unwrap();
    let default = text["default_pixels_per_degree"].as_f64().unwrap();
    assert!((Viewing::default().pixels_per_degree - default).abs() < 1e-5 * default);
}

#[test]
fn equal_to_lpips() {
    #[derive(Deserialize)]
    struct Case {
        #[serde(flatten)]
        pair: Pair,
        alex: Option<f64>,
        squeeze: Option<f64>,
    }
    let text: serde_json::Value = serde_json::from_str(include_str!("references/lpips_metrics.json")).unwrap();
    for (backbone, key) in [(Backbone::Alex, "alex"), (Backbone::Squeeze, "squeeze")] {
        assert_eq!(text["smallest"][key].as_u64(), Some(backbone.smallest_side() as u64), "{key}");
    }
    let folder = weights_folder().unwrap_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/assets/lpips"));
    if !folder.join(Backbone::Alex.file_name()).is_file() {
        println!("skipped: no LPIPS weights at {}", folder.display());
        return;
    }
    let Networks { alex: Some(alex), squeeze: Some(squeeze) } = Networks::read(&folder).unwrap() else { panic!("both are read") };
    let [mut by_alex, mut by_squeeze]: [Worst; 2] = Default::default();
    for case in read::<Case>(include_str!("references/lpips_metrics.json")) {
        let [a, b] = case.pair.pictures();
        for (network, theirs, worst) in [(&alex, case.alex, &mut by_alex), (&squeeze, case.squeeze, &mut by_squeeze)] {
            worst.compare(network.distance(&a, &b).ok().map(f64::from), theirs, &case.pair);
            if theirs.is_some() {
                let kept = network.reference(&b).unwrap();
                assert_eq!(network.distance_to(&a, &kept).unwrap(), network.distance(&a, &b).unwrap(), "{:?}", case.pair);
            }
        }
    }
    assert_eq!([by_alex.passes("LPIPS alex", 15, 1e-6), by_squeeze.passes("LPIPS squeeze", 20, 1e-6)], [true; 2]);
    // Features of one network mean nothing to the other.
    let picture = scene(40, 40);
    assert!(alex.distance_to(&picture, &squeeze.reference(&picture).unwrap()).is_err());
}

#[test]
fn intervals_are_scipys() {
    #[derive(Deserialize)]
    struct Case {
        count: usize,
        seed: u32,
        /// Half the 95 % interval of Student's t distribution, in those of the normal distribution.
        t: f64,
        mean: f64,
        low: f64,
        high: f64,
    }
    let mut wider = Vec::new();
    for case in read::<Case>(include_str!("references/bootstrap_metrics.json")) {
        let mut next = generator(case.seed);
        let values: Vec<f64> = (0..case.count).map(|_| 20.0 + 10.0 * next() * next()).collect();
        let ours = bootstrap(&values).unwrap();
        let expected = case.t * (case.count as f64 / (case.count - 1) as f64).sqrt();
        assert!((widened(case.count) - expected).abs() < 1e-4 * expected, "{}: {expected}", case.count);
        let [low, high] = ours.range.unwrap().map(|end| ours.mean + (end - ours.mean) / widened(case.count));
        assert!((ours.mean - case.mean).abs() < 1e-12 && ours.sequences == case.count);
        // 2,000 draws leave an end about 1.5 % of the width unsure.
        let width = case.high - case.low;
        let off = ((low - case.low) / width, (high - case.high) / width);
        println!("{} sequences: ends off by {:+.3} and {:+.3} of the interval's width", case.count, off.0, off.1);
        assert!(off.0.abs() < 0.05 && off.1.abs() < 0.05, "{off:?} of {width}");
        // Means of two or three sequences take few values: their ends are exact.
        if case.count >= 8 {
            wider.push(off.1 - off.0);
        }
    }
    let wider = wider.iter().sum::<f64>() / wider.len() as f64;
    assert!(wider.abs() < 0.02, "intervals are wider by {wider:+.3} on average");
}

/// Intervals of few values, too: a percentile interval of three holds the true mean in three of four draws.
#[test]
fn intervals_hold_the_true_mean() {
    const DRAWS: u32 = 2000;
    let mut next = generator(7);
    let mut normal = || (0..12).map(|_| next()).sum::<f64>() - 6.0;
    for count in [2, 3, 5, 12] {
        let held = (0..DRAWS).filter(|_| {
            let values: Vec<f64> = (0..count).map(|_| normal()).collect();
            !bootstrap(&values).unwrap().is_clear()
        });
        let share = held.count() as f64 / f64::from(DRAWS);
        println!("{count} values: {share}");
        assert!((0.915..0.97).contains(&share), "{count} values: {share}");
    }
}

#[test]
fn edge_cases() {
    let a = mixed(16, 16, 3, 0.5);
    assert_eq!(psnr(&a, &a), f64::INFINITY);
    assert_eq!(ssim(&a, &a), Some(1.0));
    assert_eq!(flip(&a, &a, Viewing::default()).unwrap().mean, 0.0);
    assert_eq!(ssim(&mixed(10, 64, 1, 0.5), &mixed(10, 64, 1, 0.5)), None);
    let other = mixed(16, 17, 3, 0.5);
    assert_eq!(ssim(&a, &other), None);
    assert_eq!(flip(&a, &other, Viewing::default()), None);
    assert_eq!(flip(&Rgb::default(), &Rgb::default(), Viewing::default()), None);
    for pixels_per_degree in [0.0, -1.0, 1e-200, 1e9, f64::NAN, f64::INFINITY] {
        assert_eq!(flip(&a, &a, Viewing { pixels_per_degree }), None);
    }
    for pixels_per_degree in [0.1, 1.0, 1000.0] {
        let map = flip(&a, &mixed(16, 16, 4, 0.5), Viewing { pixels_per_degree }).unwrap().map;
        assert!(map.pixels.iter().all(|v| (0.0..=1.0).contains(v)), "{pixels_per_degree}: {:?}", map.pixels);
    }
}
