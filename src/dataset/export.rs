//! Datasets in the names and conventions that other tools read.
//!
//! What each form holds is written in its module; none loses anything that the tool could read, and every one states its ranges in JSON.

mod coco;
mod cosmos;
mod nerfstudio;
pub(crate) mod picture;
mod png;

use super::source::{self, Source};
use crate::progress::Progress;
use crate::truth::Interrupted;
use anyhow::{Context, Result};
use clap::{Args, ValueEnum};
use rayon::prelude::*;
use renderflow_frame::image::Rgb;
use renderflow_frame::{Frame, color, file, frame_file};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

/// Writes a dataset in the names and conventions that another tool reads.
#[derive(Args)]
#[command(after_help = "Example: renderflow dataset export data --to nerfstudio --out nerf\n\
nerfstudio: a folder a sequence: transforms.json (world +Z up), images, 16-bit depths in millimetres, masks of what stands still\n\
cosmos:     <clip>.<frame>.{rgb,basecolor,metallic,roughness,normal,depth,env_ldr,env_log}.png of DiffusionRenderer\n\
png:        every channel as a PNG that can be looked at, 16 bits where 8 would lose something, with data_ranges.json\n\
coco:       images and instances with run lengths; categories are mesh families")]
pub struct Options {
    /// Dataset folder, or a split or sequence of it
    dataset: PathBuf,
    /// Tool to write for
    #[arg(long, value_enum)]
    to: Form,
    /// Folder to write to
    #[arg(long)]
    out: PathBuf,
}

/// What can be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Form {
    /// nerfstudio's data parser
    Nerfstudio,
    /// Cosmos DiffusionRenderer
    Cosmos,
    /// PNG files
    Png,
    /// COCO instances
    Coco,
}

impl Options {
    /// Exports.
    pub fn run(self, cancel: &AtomicBool) -> Result<()> {
        let (sequences, frames) = export(&self.dataset, self.to, &self.out, cancel)?;
        println!("{sequences} sequences, {frames} frames: {}", self.out.display());
        Ok(())
    }
}

/// Writes the dataset in `dataset` to `out`; returns how many sequences and frames.
///
/// # Errors
/// When the dataset is not complete, a frame cannot be read or lacks what the form needs, or a file cannot be written.
pub fn export(dataset: &Path, to: Form, out: &Path, cancel: &AtomicBool) -> Result<(usize, usize)> {
    let sources = source::open(dataset)?.sequences;
    let frames = sources.iter().map(|source| source.numbers.len()).sum();
    let progress = Progress::new("export", frames as u64);
    let job = Job { progress: Some(&progress), cancel };
    match to {
        Form::Nerfstudio => sources.iter().try_for_each(|source| nerfstudio::sequence(source, out, &job))?,
        Form::Cosmos => sources.iter().try_for_each(|source| cosmos::sequence(source, out, &job))?,
        Form::Png => sources.iter().try_for_each(|source| png::sequence(source, out, &job))?,
        Form::Coco => sources.chunk_by(|a, b| a.split == b.split).try_for_each(|split| coco::split(split, out, &job))?,
    }
    progress.finish();
    Ok((sources.len(), frames))
}

/// What all forms do with frames.
struct Job<'a> {
    /// Frames done; `None` where they are only looked at.
    progress: Option<&'a Progress>,
    cancel: &'a AtomicBool,
}

impl Job<'_> {
    /// Calls `f` with every frame of a sequence, in parallel; the results are in order.
    fn frames<T: Send>(&self, source: &Source, f: impl Fn(usize, Frame) -> Result<T> + Sync) -> Result<Vec<T>> {
        if let Some(progress) = self.progress {
            progress.message(source.name.clone());
        }
        let results = (0..source.numbers.len()).into_par_iter().map(|index| {
            if self.cancel.load(Ordering::Relaxed) {
                return Err(Interrupted.into());
            }
            let path = source.file(index);
            let result = f(index, frame_file::read(&path)?).with_context(|| path.display().to_string())?;
            if let Some(progress) = self.progress {
                progress.add(1);
            }
            Ok(result)
        });
        results.collect()
    }
}

/// The picture that people look at: exposure, clamp, sRGB.
fn displayed(frame: &Frame, exposure: f32) -> Result<Rgb> {
    let beauty = frame.beauty.as_ref().context("has no beauty (a frame of G-buffers only)")?;
    Ok(beauty.map(|pixel| color::display(*pixel, exposure)))
}

fn write(path: PathBuf, bytes: &[u8]) -> Result<()> {
    Ok(file::write_atomic(&path, bytes)?)
}
