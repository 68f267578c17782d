//! `renderflow-bench agree`: glass, panes and blended surfaces rendered by this program, Mitsuba 3 and Cycles, and how far the
//! pictures differ.

use super::contender::{Contender, Kind, OURS, Shot};
use super::reference::Reference;
use super::{FORMAT, Pythons};
use crate::{Machine, export, scenes};
use anyhow::{Context, Result, bail};
use clap::Args;
use renderflow::util::cancel::Interrupted;
use renderflow::util::console;
use renderflow::util::progress::Progress;
use renderflow_frame::file;
use renderflow_frame::image::Rgb;
use serde::Serialize;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

/// Name of the results.
const RESULTS: &str = "agree.json";
/// Who takes part; the last of a family that can be started.
const RENDERERS: [&str; 4] = [OURS, "mitsuba-scalar", "mitsuba-multijitter", "cycles"];
/// Edge of the squares whose means are compared, pixels.
const BLOCK: usize = 8;
/// Scattering events of a path: so many that those which are left out carry nothing.
const BOUNCES: u32 = 64;

/// Glass, panes and blended surfaces in this program, Mitsuba 3 and Cycles: the mean radiance of the pictures and the means of
/// their squares of 8 x 8 pixels must agree. Renderers that are not installed are skipped, and one that has no counterpart for a
/// material says so and is left out of that scene. Finished pictures are kept: run again, it goes on.
#[derive(Args)]
#[command(
    after_help = "Examples:\n  renderflow-bench agree --mitsuba-python venv-mitsuba/bin/python --cycles-python venv-bpy/bin/python --out agree\n  renderflow-bench agree --scene glass_ball --scene my/glass.json --spp 4096 --out agree\n\ndocs/benchmarks.md says what is compared."
)]
pub struct Options {
    /// Scene of the set, scene file or model; may be given several times; otherwise the nine scenes of glass and blending
    #[arg(long, value_name = "NAME|FILE")]
    scene: Vec<String>,
    /// Pixels along both sides, a multiple of 8
    #[arg(long, default_value_t = 64, value_parser = clap::value_parser!(u32).range(8..=4096))]
    resolution: u32,
    /// Samples a pixel, a multiple of 8
    #[arg(long, default_value_t = 1024, value_parser = clap::value_parser!(u32).range(8..))]
    spp: u32,
    /// Largest relative difference beyond noise
    #[arg(long, default_value_t = 0.002)]
    limit: f64,
    #[command(flatten)]
    pythons: Pythons,
    /// Folder for results (agree.json), pictures, exported scenes and messages of the scripts
    #[arg(long, default_value = "bench-agree")]
    out: PathBuf,
}

/// How far a picture is from ours. Everything is relative to our mean radiance.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct Agreement {
    scene: String,
    renderer: String,
    version: String,
    /// Mean radiance of the other over ours, less 1.
    mean: f64,
    /// Standard error of `mean`, from the noise of both pictures.
    mean_noise: f64,
    /// Mean absolute difference of the means of squares of 8 x 8 pixels.
    blocks: f64,
    /// What `blocks` would be of two pictures of one scene with the noise of these.
    blocks_noise: f64,
    /// Values that `blocks` is the mean of.
    count: f64,
}

#[derive(Serialize)]
struct Results<'a> {
    machine: Machine,
    resolution: u32,
    spp: u32,
    limit: f64,
    rows: &'a [Agreement],
}

impl Options {
    /// Renders, prints the table, and fails if a picture differs by more than the limit.
    pub fn run(self, allowed: &[PathBuf], cancel: &AtomicBool) -> Result<()> {
        if self.limit.is_nan() || self.limit <= 0.0 {
            bail!("--limit {}: a difference is a positive number", self.limit);
        }
        if !(self.resolution as usize).is_multiple_of(BLOCK) {
            bail!("--resolution {}: squares of {BLOCK} x {BLOCK} pixels do not fill the picture", self.resolution);
        }
        let names = match self.scene.is_empty() {
            true => scenes::CLEAR.iter().map(|scene| scene.name.to_owned()).collect(),
            false => scenes::expand(&self.scene),
        };
        names.iter().try_for_each(|name| scenes::exists(name))?;
        for folder in ["references", "scenes", "messages"] {
            let path = self.out.join(folder);
            std::fs::create_dir_all(&path).with_context(|| path.display().to_string())?;
        }
        let chosen = |kind: &Kind| RENDERERS.contains(&kind.id);
        let mut contenders = self.pythons.contenders(chosen, rayon::current_num_threads(), &self.out, cancel)?;
        // Mitsuba scalar only where there is no LLVM.
        let llvm = contenders.iter().any(|c| c.kind.id == "mitsuba-multijitter");
        contenders.retain(|c| !(llvm && c.kind.id == "mitsuba-scalar"));
        if contenders.len() < 2 {
            bail!("there is no other renderer to compare with; docs/benchmarks.md says how to install them");
        }
        let samples = u64::from(self.spp.next_multiple_of(8));
        let progress = Progress::new("agree", (names.len() * contenders.len()) as u64 * samples);
        let mut rows = Vec::new();
        for name in &names {
            let subject = scenes::open(name, Some(self.resolution), allowed)?;
            let found = self.scene(&subject, &mut contenders, &progress, cancel)?;
            progress.hide(|| found.iter().for_each(|row| print!("{}", line(row, self.limit))));
            rows.extend(found);
            let (machine, resolution, spp, limit) = (Machine::current(), self.resolution, self.spp, self.limit);
            file::write_json(&self.out.join(RESULTS), &Results { machine, resolution, spp, limit, rows: &rows })?;
        }
        progress.finish();
        if rows.is_empty() {
            bail!("nothing was compared");
        }
        print!("\n{}", table(&rows, self.limit));
        println!("\nresults: {}", self.out.join(RESULTS).display());
        let beyond: Vec<String> =
            rows.iter().filter(|row| !row.agrees(self.limit)).map(|row| format!("{} in {}", row.scene, row.renderer)).collect();
        if !beyond.is_empty() {
            bail!("{} of {} pictures differ by more than {}: {}", beyond.len(), rows.len(), self.limit, beyond.join(", "));
        }
        Ok(())
    }

    fn scene(
        &self,
        subject: &scenes::Subject,
        contenders: &mut [Contender],
        progress: &Progress,
        cancel: &AtomicBool,
    ) -> Result<Vec<Agreement>> {
        let scenes::Subject { name, loaded } = subject;
        let folder = std::path::absolute(self.out.join("scenes").join(name))?;
        let exported = export::write(loaded, BOUNCES, &folder)?;
        let shot = Shot { size: [self.resolution as usize; 2], max_bounces: BOUNCES };
        let (mut ours, mut rows) = (None, Vec::new());
        for contender in contenders {
            let Kind { id, family, .. } = contender.kind;
            progress.message(format!("{name}: {id}"));
            let key = blake3::hash(format!("{FORMAT} {BOUNCES} {} {}", loaded.hash, contender.version).as_bytes()).to_hex();
            let file = format!("{name}-{id}-{}-{}-{}.f32", self.resolution, self.spp, &key.as_str()[..12]);
            let path = self.out.join("references").join(file);
            let step = |samples: u32| progress.add(u64::from(samples));
            let made = contender.load(loaded, &exported, cancel).and_then(|notes| {
                notes.iter().for_each(|note| progress.hide(|| println!("note: {name}, {id}: {note}")));
                Reference::get(&path, contender, self.spp, &shot, &step, cancel)
            });
            let picture = match made {
                Ok(picture) => picture,
                Err(error) if error.is::<Interrupted>() || family == OURS => return Err(error).with_context(|| name.clone()),
                Err(error) => {
                    progress.hide(|| println!("left out: {name}, {id}: {}", console::message(&error)));
                    progress.add(u64::from(self.spp.next_multiple_of(8)));
                    continue;
                }
            };
            match &ours {
                None => ours = Some(picture),
                Some(ours) => rows.push(Agreement::of(ours, &picture, name, id, &contender.version)),
            }
        }
        Ok(rows)
    }
}

impl Agreement {
    fn of(ours: &Reference, other: &Reference, scene: &str, renderer: &str, version: &str) -> Self {
        let sum = |values: &[f64]| values.iter().sum::<f64>();
        let [a, b] = [ours, other].map(|r| blocks(&r.mean));
        let [noise_a, noise_b] = [ours, other].map(|r| blocks(&r.variance));
        let (total, count) = (sum(&a), a.len() as f64);
        // The variance of a mean of n values is that of their mean over n.
        let pixels = (BLOCK * BLOCK) as f64;
        let variances: Vec<f64> = noise_a.iter().zip(&noise_b).map(|(a, b)| (a + b) / pixels).collect();
        let apart: f64 = a.iter().zip(&b).map(|(a, b)| (a - b).abs()).sum();
        // The mean absolute value of a normal distribution of deviation 1.
        let absolute = (2.0 / std::f64::consts::PI).sqrt();
        Self {
            scene: scene.into(),
            renderer: renderer.into(),
            version: version.into(),
            mean: sum(&b) / total - 1.0,
            mean_noise: sum(&variances).sqrt() / total,
            blocks: apart / total,
            count,
            blocks_noise: absolute * variances.iter().map(|v| v.sqrt()).sum::<f64>() / total.max(count * 1e-30),
        }
    }

    /// Difference of the squares beyond noise: the two add up as squares do.
    fn excess(&self) -> f64 {
        (self.blocks.powi(2) - self.blocks_noise.powi(2)).max(0.0).sqrt()
    }

    /// Whether both differences keep to `limit`, each with two standard errors.
    fn agrees(&self, limit: f64) -> bool {
        // An absolute value of a normal distribution scatters by 0.756 of its mean.
        let scatter = (std::f64::consts::FRAC_PI_2 - 1.0).sqrt() / self.count.sqrt();
        let allowed = limit.hypot(self.blocks_noise) + 2.0 * scatter * self.blocks_noise;
        self.mean.abs() <= limit + 2.0 * self.mean_noise && self.blocks <= allowed
    }
}

/// Means of squares of [`BLOCK`] pixels, channel by channel.
fn blocks(picture: &Rgb) -> Vec<f64> {
    let across = picture.width / BLOCK;
    let mut sums = vec![0.0; across * (picture.height / BLOCK) * 3];
    for (at, pixel) in picture.pixels.iter().enumerate() {
        let block = at / picture.width / BLOCK * across + at % picture.width / BLOCK;
        for (channel, value) in pixel.iter().enumerate() {
            sums[3 * block + channel] += f64::from(*value) / (BLOCK * BLOCK) as f64;
        }
    }
    sums
}

fn line(row: &Agreement, limit: f64) -> String {
    let percent = |v: f64| format!("{:.3} %", 100.0 * v);
    format!(
        "{:14} {:20} {:>9} {:>9} {:>9} {:>9} {:>9}  {}\n",
        row.scene,
        row.renderer,
        percent(row.mean),
        percent(row.mean_noise),
        percent(row.blocks),
        percent(row.blocks_noise),
        percent(row.excess()),
        if row.agrees(limit) { "yes" } else { "NO" }
    )
}

fn table(rows: &[Agreement], limit: f64) -> String {
    let head = ["mean", "noise", "squares", "noise", "beyond"].map(|title| format!("{title:>9}")).join(" ");
    let lines: String = rows.iter().map(|row| line(row, limit)).collect();
    format!("{:14} {:20} {head}  agrees\n{lines}", "scene", "renderer")
}

#[cfg(test)]
mod tests {
    use super::*;
    use renderflow_frame::image::Image;

    fn flat(value: f32, variance: f32) -> Reference {
        Reference { mean: Rgb::filled(16, 8, [value; 3]), variance: Rgb::filled(16, 8, [variance; 3]) }
    }

    #[test]
    fn differences_are_relative_and_know_their_noise() {
        let row = Agreement::of(&flat(2.0, 0.0), &flat(2.01, 0.0), "s", "r", "1");
        assert!((row.mean - 0.005).abs() < 1e-6 && (row.blocks - 0.005).abs() < 1e-6 && row.blocks_noise == 0.0, "{row:?}");
        assert!(row.agrees(0.006) && !row.agrees(0.004));
        // One square brighter and one darker: the mean hides it, the squares do not.
        let halves = Image::from_fn(16, 8, |x, _| [if x < 8 { 2.2 } else { 1.8 }; 3]);
        let row = Agreement::of(&flat(2.0, 0.0), &Reference { mean: halves, ..flat(2.0, 0.0) }, "s", "r", "1");
        assert!(row.mean.abs() < 1e-6 && (row.blocks - 0.1).abs() < 1e-6 && !row.agrees(0.002), "{row:?}");
        // A deviation of 0.8 a pixel is 0.1 a square and 0.1 / sqrt(6) for their mean.
        let row = Agreement::of(&flat(2.0, 0.64), &flat(2.0, 0.0), "s", "r", "1");
        let expected = 0.05 / 6.0_f64.sqrt();
        assert!((row.mean_noise - expected).abs() < 1e-6, "{row:?}");
        assert!((row.blocks_noise - 0.05 * (2.0 / std::f64::consts::PI).sqrt()).abs() < 1e-6 && row.excess() == 0.0, "{row:?}");
    }
}
