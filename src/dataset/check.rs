//! Reads a sequence back: every file is hashed, every frame decoded and held against the plan, its camera and its neighbours.

use super::agreement::View;
use super::damage::Part;
use super::folder::SequenceFolder;
use super::plan::Plan;
use super::record::{Checked, DESCRIPTIONS, FrameEntry};
use crate::truth::is_keyframe;
use anyhow::{Result, bail, ensure};
use rayon::prelude::*;
use renderflow_frame::{Camera, Frame, FrameInfo, file, frame_file};
use std::path::Path;

/// Frames that a thread reads one after the other; the next one's first is read once more.
const RUN: usize = 8;

/// What the header of every frame of a sequence must say.
#[derive(Clone, Copy, Debug)]
pub struct Header<'a> {
    /// BLAKE3 of the scene.
    pub scene: &'a str,
    /// Seed of its rendering.
    pub seed: u64,
}

impl Header<'_> {
    /// That a frame with the header `info` is one of this scene, seen by `camera`.
    ///
    /// # Errors
    /// Says what it is of instead.
    pub fn hold(&self, info: &FrameInfo, camera: &Camera) -> Result<()> {
        ensure!(info.scene_hash == self.scene, "is of another scene ({:.64})", info.scene_hash);
        ensure!(info.seed == self.seed, "has the seed {}, the sequence has {}", info.seed, self.seed);
        ensure!(same_camera(&info.camera, camera), "was seen by another camera: it is another frame of the sequence");
        Ok(())
    }
}

/// Whether two cameras are the same but for the rounding of numbers in text.
pub fn same_camera(a: &Camera, b: &Camera) -> bool {
    let near = |a: f32, b: f32| (a - b).abs() <= 1e-5 * a.abs().max(b.abs());
    let reach = a.position_in_world().length().max(1.0);
    (a.width, a.height) == (b.width, b.height)
        && near(a.fl_x, b.fl_x)
        && near(a.fl_y, b.fl_y)
        && near(a.cx, b.cx)
        && near(a.cy, b.cy)
        && a.camera_to_world.matrix3.abs_diff_eq(b.camera_to_world.matrix3, 1e-5)
        && (a.position_in_world() - b.position_in_world()).length() <= 1e-6 * reach
}

/// What reading a sequence back gave.
#[derive(Clone, Debug, Default)]
pub struct Reading {
    /// What was found of the frames without a fault.
    pub checked: Checked,
    /// What is wrong, and with what: first what frames say about one another, then frame by frame.
    pub faults: Vec<(Part, String)>,
}

/// Reads every file of the sequence in `folder`; it must be a complete one of `plan`.
///
/// # Errors
/// The first fault, and how many more there are.
pub fn sequence(plan: &Plan, folder: &Path, header: Header<'_>) -> Result<Checked> {
    let Reading { checked, faults } = read(plan, folder, header)?;
    match faults.split_first() {
        None => Ok(checked),
        Some(((_, first), [])) => bail!("{first}"),
        Some(((_, first), rest)) => bail!("{first} (and {} more faults)", rest.len()),
    }
}

/// As [`sequence`], but goes on after a fault.
///
/// # Errors
/// When the descriptions cannot be read or are not those of the plan: then frames have nothing to be held against.
pub fn read(plan: &Plan, folder: &Path, header: Header<'_>) -> Result<Reading> {
    let opened = SequenceFolder::open(folder)?;
    let numbers: Vec<usize> = plan.numbers().collect();
    ensure!(opened.len() == numbers.len(), "transforms.json: {} frames, the plan has {}", opened.len(), numbers.len());
    ensure!(opened.numbers == numbers, "transforms.json: its frames are not those of the plan");
    let keyframes: Vec<usize> = opened.sequence.keyframes.iter().filter_map(|&i| numbers.get(i).copied()).collect();
    ensure!(keyframes == plan.keyframe_numbers().collect::<Vec<_>>(), "transforms.json: its keyframes are not those of the plan");
    let starts: Vec<usize> = (0..numbers.len()).step_by(RUN).collect();
    let sequence = Opened { plan, folder: &opened, header };
    let parts: Vec<Reading> =
        starts.par_iter().with_max_len(1).map(|&start| sequence.run(start..(start + RUN).min(numbers.len()))).collect();
    let mut all = Reading::default();
    let mut of_frames = Vec::new();
    for part in parts {
        all.checked.frames.extend(part.checked.frames);
        all.checked.statistics.add(&part.checked.statistics);
        all.checked.agreement.add(&part.checked.agreement);
        of_frames.extend(part.faults);
    }
    for name in DESCRIPTIONS {
        let bytes = file::read(&folder.join(name))?;
        all.checked.descriptions.push((name.to_owned(), blake3::hash(&bytes).to_hex().to_string()));
    }
    all.faults.extend(all.checked.agreement.faults().into_iter().map(|fault| (Part::Sequence, fault)));
    all.faults.extend(of_frames);
    Ok(all)
}

/// A sequence that is being read.
struct Opened<'a> {
    plan: &'a Plan,
    folder: &'a SequenceFolder,
    header: Header<'a>,
}

impl Opened<'_> {
    /// Reads the frames `range` and compares each with the next.
    fn run(&self, range: std::ops::Range<usize>) -> Reading {
        let folder = self.folder;
        let mut found = Reading::default();
        let checked = &mut found.checked;
        let mut before: Option<(usize, Frame)> = None;
        // One more than the run, to compare its last with.
        for index in range.start..(range.end + 1).min(folder.len()) {
            let (frame, entry) = match self.frame(index) {
                Ok(read) => read,
                Err(error) => {
                    if range.contains(&index) {
                        let reason = format!("{}: {}", folder.sequence.files[index], crate::console::message(&error));
                        found.faults.push((Part::Frame(folder.numbers[index]), reason));
                    }
                    before = None;
                    continue;
                }
            };
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
        found
    }

    fn frame(&self, index: usize) -> Result<(Frame, FrameEntry)> {
        let (plan, folder) = (self.plan, self.folder);
        let (name, number) = (&folder.sequence.files[index], folder.numbers[index]);
        let path = folder.path.join(name);
        let bytes = match file::read(&path) {
            Err(renderflow_frame::Error::Io { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => {
                bail!("is not there")
            }
            bytes => bytes.map_err(|error| without_name(&error, &path))?,
        };
        let frame = frame_file::decode(&path, &bytes).map_err(|error| without_name(&error, &path))?;
        let camera = folder.camera(index);
        fits(&frame, camera)?;
        let [width, height] = plan.resolution.map(|v| v as usize);
        ensure!(
            (frame.width, frame.height) == (width, height),
            "{} x {} pixels, the plan has {width} x {height}",
            frame.width,
            frame.height
        );
        self.header.hold(&frame.info, camera)?;
        let wanted = plan.samples(number);
        ensure!(
            frame.info.spp == wanted || plan.render.adaptive && wanted > 0 && frame.info.spp > 0,
            "{} samples a pixel, the plan has {wanted}",
            frame.info.spp
        );
        ensure!((wanted == 0) == frame.beauty.is_none(), "has a beauty where the plan has none, or none where it has one");
        crate::inspect::verify_frame(&frame)?;
        let entry = FrameEntry {
            file: name.clone(),
            number,
            keyframe: is_keyframe(plan.keyframe_gap(), number),
            spp: frame.info.spp,
            bytes: bytes.len() as u64,
            blake3: blake3::hash(&bytes).to_hex().to_string(),
        };
        Ok((frame, entry))
    }
}

/// That a frame has the size of its camera.
///
/// # Errors
/// Gives both sizes.
pub fn fits(frame: &Frame, camera: &Camera) -> Result<()> {
    ensure!(
        (frame.width, frame.height) == (camera.width, camera.height),
        "{} x {} pixels where the camera has {} x {}",
        frame.width,
        frame.height,
        camera.width,
        camera.height
    );
    Ok(())
}

/// The error without the path that it begins with.
fn without_name(error: &renderflow_frame::Error, path: &Path) -> anyhow::Error {
    let text = error.to_string();
    anyhow::Error::msg(text.strip_prefix(&format!("{}: ", path.display())).unwrap_or(&text).to_owned())
}
