//! `renderflow evaluate autoencoder`: what an autoencoder of the paper's network loses.

use super::find::{self, TestSequence};
use super::run;
use crate::dataset::Dataset;
use crate::util::cancel::Cancel;
use crate::util::device::{DeviceArgs, recorded};
use crate::util::output;
use crate::util::progress::Progress;
use crate::util::text::plural;
use crate::util::weights::digest;
use anyhow::{Result, ensure};
use clap::Args;
use renderflow_frame::file;
use renderflow_model::Error;
use renderflow_model::wan::train::{Measured, RoundTrip, round_trip};
use renderflow_model::wan::{Vae, VaeConfig};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Measure what an autoencoder of the paper's network loses, by kind of picture and by frame of a clip
///
/// The command encodes and decodes pictures, measures their PSNR, writes autoencoder.json, which names the weights and the data,
/// and prints tables.
#[derive(Args)]
#[command(
    after_help = "Example: renderflow evaluate autoencoder --vae runs/vae/weights.safetensors --data sets -o results-autoencoder"
)]
pub struct Options {
    /// Weights of the autoencoder, of this program or published ones
    #[arg(long)]
    vae: PathBuf,
    #[command(flatten)]
    device: DeviceArgs,
    /// Test sets, a dataset, a split of it, or one sequence
    #[arg(long)]
    data: PathBuf,
    /// Frames of a clip, beside pictures by themselves
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(2..=4096))]
    frames: u32,
    /// Clips of each sequence, from its first frame on
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    clips: u32,
    /// Also measure the truth coded as a change of deferred shading, and deferred shading itself; this needs the scenes
    #[arg(long)]
    deferred: bool,
    /// Folder for the results
    #[arg(long, short = 'o', default_value = "results-autoencoder")]
    out: PathBuf,
    /// Print the tables as JSON
    #[arg(long)]
    json: bool,
}

/// One test set in the JSON file.
#[derive(Serialize)]
struct Set {
    name: String,
    /// Those that have a clip.
    sequences: usize,
    /// Number of sequences that are too short for a clip.
    left_out: usize,
    /// PSNR, dB, of pictures by themselves, and of each frame of clips, by kind.
    kinds: BTreeMap<String, [Vec<f32>; 2]>,
}

#[derive(Serialize)]
struct Results {
    /// BLAKE3 of the weights.
    weights: Vec<String>,
    /// BLAKE3 of what was read of each sequence, by set, class and name.
    data: BTreeMap<String, String>,
    /// Frames of a clip.
    frames: u32,
    /// The most clips of a sequence.
    clips: u32,
    /// Device of the network; `None` for the processor.
    #[serde(skip_serializing_if = "Option::is_none")]
    device: Option<String>,
    sets: Vec<Set>,
}

impl Options {
    /// Measures and prints.
    pub fn run(self, allowed: &[PathBuf], cancel: &Cancel) -> Result<()> {
        let path = self.out.join("autoencoder.json");
        output::absent(&path)?;
        let device = self.device.open()?;
        let (vae, _) = Vae::open(&self.vae, &VaeConfig::wan(), device.device())?;
        let mut sets: BTreeMap<String, Dataset> = BTreeMap::new();
        let mut short: BTreeMap<String, usize> = BTreeMap::new();
        let has_clip = |test: &TestSequence| has_clip(&test.sequence.numbers, self.frames as usize);
        let (tests, without): (Vec<TestSequence>, Vec<TestSequence>) = find::find(&self.data)?.into_iter().partition(has_clip);
        ensure!(!tests.is_empty(), "{}: no sequence has {} frames in a row", self.data.display(), self.frames);
        without.into_iter().for_each(|test| *short.entry(test.set).or_default() += 1);
        for (set, count) in &short {
            eprintln!("note: {set}: {} without {} frames in a row left out", plural(*count, "sequence"), self.frames);
        }
        let weights = vec![digest(&self.vae)?];
        // Every frame counts: depth is shown between the bounds of the whole sequence.
        let data = run::digests(&tests, |sequence| (0..sequence.len()).collect(), cancel)?;
        for test in tests {
            sets.entry(test.set).or_default().sequences.push(test.sequence);
        }
        if self.deferred {
            sets = sets.into_iter().map(|(name, data)| (name, data.shaded(allowed, None))).collect();
        }
        let total: usize = sets.values().map(|set| set.sequences.len()).sum();
        let progress = Progress::new("autoencoder", 2 * total as u64);
        let mut found = Vec::new();
        for (name, data) in &sets {
            let trips = |frames: u32| {
                let before = progress.position();
                let mut told = |done: usize| {
                    progress.set(before + done as u64);
                    if cancel.is_set() {
                        return Err(Error::Data { place: "autoencoder".into(), reason: "interrupted".into() });
                    }
                    Ok(())
                };
                let measured = round_trip(&vae, data, frames as usize, self.clips as usize, &mut told);
                // What `told` says then is no failure.
                cancel.check()?;
                Ok::<_, anyhow::Error>(measured?)
            };
            let [stills, clips] = [trips(1)?, trips(self.frames)?];
            found.push(Set {
                name: name.clone(),
                sequences: data.sequences.len(),
                left_out: short.get(name).copied().unwrap_or(0),
                kinds: table(stills, clips),
            });
        }
        progress.finish();
        std::fs::create_dir_all(&self.out)?;
        let (frames, clips, device) = (self.frames, self.clips, recorded(&device));
        let results = Results { weights, data, frames, clips, device, sets: found };
        file::write_json(&path, &results)?;
        if self.json {
            println!("{}", serde_json::to_string_pretty(&results)?);
            return Ok(());
        }
        for set in &results.sets {
            println!(
                "{}, sequences {}: PSNR in dB of pictures by themselves, and of the frames of clips",
                set.name, set.sequences
            );
            for (kind, [still, clip]) in &set.kinds {
                let row = |values: &[f32]| values.iter().map(|v| format!("{v:6.2}")).collect::<Vec<_>>().join(" ");
                println!("  {kind:16} {} | {}", row(still), row(clip));
            }
        }
        println!("{}", path.display());
        Ok(())
    }
}

/// Whether a clip of `frames` frames is among those of these numbers: as [`round_trip`] takes them, without a gap.
fn has_clip(numbers: &[usize], frames: usize) -> bool {
    let distances = numbers.windows(2).map(|pair| pair[1].saturating_sub(pair[0]));
    let length = (frames - 1) * distances.min().unwrap_or(1).max(1);
    numbers.windows(frames).any(|clip| clip[0] + length == clip[frames - 1])
}

fn table(stills: Vec<RoundTrip>, clips: Vec<RoundTrip>) -> BTreeMap<String, [Vec<f32>; 2]> {
    let name = |trip: &RoundTrip| match trip.of {
        Measured::Kind(kind) => format!("{kind:?}").to_lowercase(),
        Measured::Change => "target as change".into(),
        Measured::Deferred => "deferred".into(),
    };
    stills.into_iter().zip(clips).map(|(still, clip)| (name(&still), [still.psnr, clip.psnr])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clips_have_no_gaps() {
        for (numbers, frames, found) in [
            (&[0, 1, 2, 3, 4][..], 5, true),
            (&[0, 1, 2, 3], 5, false),
            (&[0, 2, 4, 6, 9], 4, true),
            (&[0, 2, 4, 7, 9], 4, false),
            (&[3], 2, false),
            (&[], 2, false),
        ] {
            assert_eq!(has_clip(numbers, frames), found, "{numbers:?}");
        }
    }
}
