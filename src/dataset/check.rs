//! Reads a sequence back: every file is hashed, every frame decoded and held against the plan, its camera and its neighbours.

use super::agreement::View;
use super::folder::SequenceFolder;
use super::plan::Plan;
use super::record::{Checked, DESCRIPTIONS, FrameEntry};
use super::storage;
use crate::truth::is_keyframe;
use anyhow::{Context, Result, ensure};
use rayon::prelude::*;
use renderflow_frame::Frame;
use std::path::Path;

/// Frames that a thread reads one after the other; the next one's first is read once more.
const RUN: usize = 8;

/// Reads every file of sequence `index` in `folder`.
pub fn sequence(plan: &Plan, folder: &Path) -> Result<Checked> {
    let opened = SequenceFolder::open(folder)?;
    let numbers: Vec<usize> = plan.numbers().collect();
    ensure!(opened.len() == numbers.len(), "transforms.json: {} frames, the plan has {}", opened.len(), numbers.len());
    ensure!(opened.numbers == numbers, "transforms.json: its frames are not those of the plan");
    let keyframes: Vec<usize> = opened.sequence.keyframes.iter().filter_map(|&i| numbers.get(i).copied()).collect();
    ensure!(keyframes == plan.keyframe_numbers().collect::<Vec<_>>(), "transforms.json: its keyframes are not those of the plan");
    let starts: Vec<usize> = (0..numbers.len()).step_by(RUN).collect();
    let parts: Vec<Result<Checked>> =
        starts.par_iter().with_max_len(1).map(|&start| run(plan, &opened, start..(start + RUN).min(numbers.len()))).collect();
    let mut all = Checked::default();
    for part in parts {
        let part = part?;
        all.frames.extend(part.frames);
        all.statistics.add(&part.statistics);
        all.agreement.add(&part.agreement);
    }
    for file in DESCRIPTIONS {
        let bytes = std::fs::read(folder.join(file)).with_context(|| format!("{file}: cannot read"))?;
        all.descriptions.push((file.to_owned(), blake3::hash(&bytes).to_hex().to_string()));
    }
    let faults = all.agreement.faults();
    ensure!(faults.is_empty(), "{}", faults.join("; "));
    Ok(all)
}

/// Reads the frames `range` and compares each with the next.
fn run(plan: &Plan, folder: &SequenceFolder, range: std::ops::Range<usize>) -> Result<Checked> {
    let mut checked = Checked::default();
    let mut before: Option<(usize, Frame)> = None;
    // One more than the run, to compare its last with.
    for index in range.start..(range.end + 1).min(folder.len()) {
        let (frame, entry) = read(plan, folder, index).with_context(|| folder.sequence.files[index].clone())?;
        if let Some((previous, last)) = &before
            && folder.numbers[index] == folder.numbers[*previous] + 1
        {
            let movement = folder.sequence.tracks.between(*previous, index);
            let view = |frame, index| View { frame, camera: folder.camera(index) };
            checked.agreement.add_pair(view(last, *previous), view(&frame, index), &|id| movement.of(id));
        }
        if range.contains(&index) {
            checked.agreement.add_frame(View { frame: &frame, camera: folder.camera(index) });
            checked.statistics.add_frame(&frame);
            checked.frames.push(entry);
        }
        before = Some((index, frame));
    }
    Ok(checked)
}

fn read(plan: &Plan, folder: &SequenceFolder, index: usize) -> Result<(Frame, FrameEntry)> {
    let (file, number) = (&folder.sequence.files[index], folder.numbers[index]);
    let path = folder.path.join(file);
    let bytes = std::fs::read(&path).context("cannot read")?;
    let frame = storage::decode(&path, &bytes)?;
    let camera = folder.camera(index);
    ensure!(
        (frame.width, frame.height) == (camera.width, camera.height),
        "{} x {} pixels where the camera has {} x {}",
        frame.width,
        frame.height,
        camera.width,
        camera.height
    );
    let [width, height] = plan.resolution.map(|v| v as usize);
    ensure!(
        (frame.width, frame.height) == (width, height),
        "{} x {} pixels, the plan has {width} x {height}",
        frame.width,
        frame.height
    );
    let wanted = plan.samples(number);
    ensure!(
        frame.info.spp == wanted || plan.render.adaptive && wanted > 0 && frame.info.spp > 0,
        "{} samples a pixel, the plan has {wanted}",
        frame.info.spp
    );
    ensure!((wanted == 0) == frame.beauty.is_none(), "has a beauty where the plan has none, or none where it has one");
    crate::inspect::verify_frame(&frame)?;
    let entry = FrameEntry {
        file: file.clone(),
        number,
        keyframe: is_keyframe(plan.keyframe_gap(), number),
        spp: frame.info.spp,
        bytes: bytes.len() as u64,
        blake3: blake3::hash(&bytes).to_hex().to_string(),
    };
    Ok((frame, entry))
}
