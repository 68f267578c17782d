//! Renders the sequences of a plan: idempotent, resumable, the same bytes for any shard and thread count.

use crate::dataset::{Plan, Shard};
use crate::progress::Progress;
use crate::truth::{Interrupted, SequenceJob, TruthSettings};
use anyhow::{Context, Result};
use serde::Serialize;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

/// What `manifest.json` says of a finished dataset.
#[derive(Serialize)]
struct Manifest<'a> {
    version: u32,
    program: &'static str,
    plan: &'a Plan,
    denoiser: Option<String>,
    sequences: Vec<SequenceEntry>,
}

#[derive(Serialize)]
struct SequenceEntry {
    name: String,
    scene_hash: String,
    environment: String,
    /// Numbers of the keyframes.
    keyframes: Vec<usize>,
    /// File name and BLAKE3 of every frame.
    frames: Vec<(String, String)>,
}

/// Renders `shard` of `plan` into `out/<split>/`. Finished frames are kept. Writes `manifest.json` once all sequences are complete.
pub fn run(plan: &Plan, out: &Path, shard: Shard, settings: &TruthSettings, cancel: &AtomicBool) -> Result<()> {
    let split_folder = out.join(plan.split.name());
    let mine: Vec<u32> = (0..plan.sequences).filter(|&s| shard.owns(s)).collect();
    let progress = Progress::new("dataset", mine.len() as u64 * numbers(plan).count() as u64 * 1000);
    for &index in &mine {
        if cancel.load(Ordering::Relaxed) {
            return Err(Interrupted.into());
        }
        let name = Plan::sequence_name(index);
        progress.message(name.clone());
        let job = SequenceJob {
            scene: plan.scene(index),
            base: ".".into(),
            out: split_folder.join(&name),
            keyframe_gap: plan.keyframe_gap,
            frame_step: plan.frame_step,
        };
        job.run(settings, &progress, cancel).with_context(|| format!("sequence {name}"))?;
    }
    progress.finish();
    write_manifest(plan, out, &split_folder, settings)
}

/// Numbers of the frames that are rendered.
fn numbers(plan: &Plan) -> impl Iterator<Item = usize> {
    (0..plan.frames as usize).step_by(plan.frame_step as usize)
}

fn write_manifest(plan: &Plan, out: &Path, split_folder: &Path, settings: &TruthSettings) -> Result<()> {
    let mut sequences = Vec::new();
    for index in 0..plan.sequences {
        let name = Plan::sequence_name(index);
        let folder = split_folder.join(&name);
        let mut frames = Vec::new();
        for frame in numbers(plan) {
            let file = super::folder::frame_file(frame);
            // Another shard is still at work: it, or the last one, writes the manifest.
            let Ok(bytes) = std::fs::read(folder.join(&file)) else { return Ok(()) };
            frames.push((file, blake3::hash(&bytes).to_hex().to_string()));
        }
        let scene = plan.scene(index);
        sequences.push(SequenceEntry {
            name,
            scene_hash: scene.hash(),
            environment: serde_json::to_string(&scene.environment)?,
            keyframes: numbers(plan).filter(|n| n % plan.keyframe_gap as usize == 0).collect(),
            frames,
        });
    }
    let manifest = Manifest {
        version: 1,
        program: concat!("renderflow ", env!("CARGO_PKG_VERSION")),
        plan,
        denoiser: settings.denoiser_name(),
        sequences,
    };
    Ok(renderflow_frame::file::write_json(&out.join(format!("manifest-{}.json", plan.split.name())), &manifest)?)
}
