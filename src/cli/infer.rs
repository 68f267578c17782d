use crate::dataset::Dataset;
use crate::evaluate::keyframes::{keyframes_for, prepare_keyframes};
use crate::progress::Progress;
use crate::report::picture;
use crate::truth::Interrupted;
use anyhow::Result;
use clap::Args;
use renderflow_frame::ibl::IblTables;
use renderflow_frame::{color, exr, file};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};

/// Renders every frame of a sequence folder with the network, from its G-buffers alone or with its keyframes.
#[derive(Args)]
#[command(after_help = "Example: renderflow infer --data data/test/seq-000000 --keyframes --out neural")]
pub struct Infer {
    /// A sequence folder, or a folder of them
    #[arg(long)]
    data: PathBuf,
    /// Weights; those inside the program without it
    #[arg(long)]
    weights: Option<PathBuf>,
    /// Use the beauty of the sequence's keyframes
    #[arg(long)]
    keyframes: bool,
    /// Folder to write to: an EXR with the picture as beauty and a PNG for every frame
    #[arg(long)]
    out: PathBuf,
}

impl Infer {
    pub fn run(self, cancel: &AtomicBool) -> Result<()> {
        let dataset = Dataset::open(&self.data)?;
        let renderer = super::network(self.weights.as_deref())?;
        let progress = Progress::new("infer", dataset.sequences.iter().map(|s| s.len() as u64).sum());
        for folder in &dataset.sequences {
            let tables = IblTables::new(&folder.environment);
            let exposure = folder.sequence.exposure;
            let prepared = if self.keyframes { prepare_keyframes(folder, &tables)? } else { Vec::new() };
            for index in 0..folder.len() {
                if cancel.load(Ordering::Relaxed) {
                    return Err(Interrupted.into());
                }
                let path = self.out.join(folder.name()).join(&folder.sequence.files[index]);
                if path.is_file() {
                    progress.resume(1);
                    continue;
                }
                let mut frame = folder.frame(index)?;
                let keys = keyframes_for(folder, &prepared, index);
                let rendered = renderer.render(&frame, folder.camera(index), &folder.environment, &tables, exposure, &keys)?;
                file::write_atomic(&path.with_extension("png"), &picture::png(&rendered.map(|p| color::display(*p, exposure)))?)?;
                frame.beauty = Some(rendered);
                frame.raw = None;
                frame.variance = None;
                frame.info.denoiser = None;
                frame.info.spp = 0;
                exr::write(&path, &frame)?;
                progress.add(1);
            }
        }
        progress.finish();
        Ok(())
    }
}
