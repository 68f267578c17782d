//! References: a picture of many samples in parts with seeds of their own, so that its noise is known, kept in a file and gone on
//! with.

use anyhow::{Result, bail};
use renderflow::util::cancel::Interrupted;
use renderflow_frame::file;
use renderflow_frame::image::Rgb;
use renderflow_renderer::{RenderScene, Settings, render};
use renderflow_scenes::LoadedScene;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// Parts of a reference: enough to know the variance of their mean to about a third a pixel, and far better over a picture.
pub const PARTS: u32 = 16;
/// Seeds of the parts begin here; measured pictures have small ones.
const FIRST_SEED: u64 = 1_000_003;

/// A picture to compare with.
pub struct Reference {
    /// Mean radiance.
    pub mean: Rgb,
    /// Variance of the mean, from the spread of its parts.
    pub variance: Rgb,
    /// Samples a pixel.
    pub spp: u32,
    /// Seconds that rendering it took.
    pub seconds: f64,
}

/// First line of a file; sums and sums of squares of the parts' means follow, three little-endian doubles a pixel each.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Header {
    format: String,
    key: String,
    width: usize,
    height: usize,
    part_spp: u32,
    parts: u32,
    seconds: f64,
}

const FORMAT: &str = "renderflow reference 1";

/// Parts added up so far.
struct Sums {
    header: Header,
    sums: Vec<[f64; 3]>,
    squares: Vec<[f64; 3]>,
}

impl Sums {
    fn new(key: &str, width: usize, height: usize, part_spp: u32) -> Self {
        let header = Header { format: FORMAT.into(), key: key.into(), width, height, part_spp, parts: 0, seconds: 0.0 };
        Self { header, sums: vec![[0.0; 3]; width * height], squares: vec![[0.0; 3]; width * height] }
    }

    fn add(&mut self, part: &Rgb, seconds: f64) {
        for ((sum, square), value) in self.sums.iter_mut().zip(&mut self.squares).zip(&part.pixels) {
            for c in 0..3 {
                let v = f64::from(value[c]);
                sum[c] += v;
                square[c] += v * v;
            }
        }
        self.header.parts += 1;
        self.header.seconds += seconds;
    }

    fn encode(&self) -> Result<Vec<u8>> {
        let mut bytes = serde_json::to_vec(&self.header)?;
        bytes.push(b'\n');
        bytes.extend(self.sums.iter().chain(&self.squares).flatten().flat_map(|v| v.to_le_bytes()));
        Ok(bytes)
    }

    /// `None` for bytes that are no such file.
    fn decode(bytes: &[u8]) -> Option<Self> {
        let line = bytes.iter().position(|&b| b == b'\n')?;
        let header: Header = serde_json::from_slice(&bytes[..line]).ok()?;
        let count = header.width.checked_mul(header.height)?;
        let data = &bytes[line + 1..];
        if header.format != FORMAT || Some(data.len()) != count.checked_mul(48) {
            return None;
        }
        let (doubles, _) = data.as_chunks::<8>();
        let (pixels, _) = doubles.as_chunks::<3>();
        let mut values = pixels.iter().map(|p| p.map(f64::from_le_bytes));
        let sums = values.by_ref().take(count).collect();
        Some(Self { header, sums, squares: values.collect() })
    }

    fn reference(&self) -> Reference {
        let n = f64::from(self.header.parts.max(1));
        let picture = |f: &dyn Fn(f64, f64) -> f64| {
            let pixel = |(sum, square): (&[f64; 3], &[f64; 3])| [0, 1, 2].map(|c| f(sum[c], square[c]) as f32);
            let pixels = self.sums.iter().zip(&self.squares).map(pixel).collect();
            Rgb { width: self.header.width, height: self.header.height, pixels }
        };
        Reference {
            mean: picture(&|sum, _| sum / n),
            variance: picture(&|sum, square| {
                // Means are single precision: rounding apart, the difference is not negative.
                ((square / n - (sum / n).powi(2)).max(0.0)) / (n - 1.0).max(1.0)
            }),
            spp: self.header.parts * self.header.part_spp,
            seconds: self.header.seconds,
        }
    }
}

/// Where references are kept and how they are made.
pub struct References {
    /// Folder of the files.
    pub folder: PathBuf,
    /// Samples a pixel, at least; a multiple of [`PARTS`] is taken.
    pub spp: u32,
    /// How to render; samples and seed apart.
    pub settings: Settings,
}

impl References {
    /// Samples a pixel of a part.
    fn part_spp(&self) -> u32 {
        self.spp.div_ceil(PARTS).max(1)
    }

    /// Samples a pixel that a reference has.
    pub fn total_spp(&self) -> u32 {
        PARTS * self.part_spp()
    }

    fn path(&self, name: &str, loaded: &LoadedScene) -> Result<(PathBuf, String)> {
        let settings = Settings { spp: self.part_spp(), ..self.settings };
        let camera = &loaded.cameras[0];
        let identity = (env!("CARGO_PKG_VERSION"), &loaded.hash, camera.width, camera.height, settings);
        let key = blake3::hash(&serde_json::to_vec(&identity)?).to_hex().to_string();
        Ok((self.folder.join(format!("{name}_{}.reference", &key[..12])), key))
    }

    /// The reference of the first frame: from its file, and what is missing rendered. `progress` is told the samples a pixel
    /// that are done.
    ///
    /// # Errors
    /// When the file is of something else or cannot be written, or the work was interrupted (finished parts are kept).
    pub fn get(
        &self,
        name: &str,
        loaded: &LoadedScene,
        progress: &(dyn Fn(u64) + Sync),
        cancel: &AtomicBool,
    ) -> Result<Reference> {
        let (path, key) = self.path(name, loaded)?;
        let camera = &loaded.cameras[0];
        let mut sums = Sums::new(&key, camera.width, camera.height, self.part_spp());
        if path.is_file() {
            match Sums::decode(&file::read(&path)?) {
                Some(found) if found.header.key == key => sums = found,
                _ => bail!("{}: damaged, or not a reference of this scene; remove it", path.display()),
            }
        }
        let settings = Settings { spp: self.part_spp(), ..self.settings };
        let spp = u64::from(settings.spp);
        progress(spp * u64::from(sums.header.parts));
        while sums.header.parts < PARTS {
            let part = sums.header.parts;
            let scene = RenderScene::compile(loaded)?.with_seed(FIRST_SEED + u64::from(part));
            let started = Instant::now();
            let tell = |done: u64, total: u64| progress(spp * u64::from(part) + spp * done / total.max(1));
            let rendered = render(&scene, &settings, &tell, cancel);
            if cancel.load(Ordering::Relaxed) {
                return Err(Interrupted.into());
            }
            sums.add(&raw(rendered?)?, started.elapsed().as_secs_f64());
            file::write_atomic(&path, &sums.encode()?)?;
        }
        Ok(sums.reference())
    }
}

/// The beauty as it was rendered.
pub(super) fn raw(frame: renderflow_frame::Frame) -> Result<Rgb> {
    match frame.raw {
        Some(raw) => Ok(raw),
        None => bail!("the renderer gave a frame without a beauty"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use renderflow::metrics::relmse::relmse;

    #[test]
    fn files_hold_what_was_added_and_refuse_what_was_cut() {
        let mut sums = Sums::new("key", 3, 2, 8);
        sums.add(&Rgb::from_fn(3, 2, |x, y| [x as f32, y as f32, 1.0]), 0.5);
        sums.add(&Rgb::from_fn(3, 2, |x, y| [x as f32 + 1.0, y as f32, 2.0]), 0.25);
        let bytes = sums.encode().unwrap();
        let read = Sums::decode(&bytes).unwrap();
        assert_eq!((&read.header, &read.sums, &read.squares), (&sums.header, &sums.sums, &sums.squares));
        let reference = read.reference();
        assert_eq!((reference.spp, reference.seconds), (16, 0.75));
        // Of two values that differ by 1: mean 1/2 higher, variance of the mean (1/2) / 2.
        assert_eq!((reference.mean.at(1, 1), reference.variance.at(1, 1)), (&[1.5, 1.0, 1.5], &[0.25, 0.0, 0.25]));
        for broken in [&bytes[..bytes.len() - 1], &bytes[..10], b"", &[&bytes[..], b"x"].concat()] {
            assert!(Sums::decode(broken).is_none());
        }
    }

    #[test]
    fn the_noise_taken_off_is_that_of_the_reference() {
        // Parts of known variance around a known picture: a perfect picture then has no error on average.
        let (width, height) = (96, 96);
        let mut state = 1u32;
        let mut random = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(state >> 8) / f64::from(1 << 24)
        };
        let truth = Rgb::from_fn(width, height, |x, y| [0.2 + x as f32 / 96.0, 0.5, y as f32 / 96.0]);
        let mut sums = Sums::new("key", width, height, 1);
        for _ in 0..PARTS {
            let noisy = truth.map(|p| p.map(|v| (f64::from(v) + 0.4 * (random() - 0.5)) as f32));
            sums.add(&noisy, 0.0);
        }
        let reference = sums.reference();
        let plain = relmse(&truth, &reference.mean, None).unwrap().mean;
        let corrected = relmse(&truth, &reference.mean, Some(&reference.variance)).unwrap().mean;
        assert!(plain > 1e-3 && corrected.abs() < 0.03 * plain, "{plain} {corrected}");
    }
}
