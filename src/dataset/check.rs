//! Reads a sequence back: hashes every file, decodes every frame, and compares it with the plan, its camera and its neighbours.

use super::agreement::View;
use super::plan::Plan;
use super::record::{Checked, FrameEntry};
use super::sequence::Sequence;
use super::sequence::fits;
use crate::dataset::layout::DESCRIPTIONS;
use crate::dataset::plan::is_keyframe;
use crate::util::text::plural;
use anyhow::{Result, bail, ensure};
use rayon::prelude::*;
use renderflow_frame::{Camera, Frame, FrameInfo, file, frame_file};
use std::path::Path;

/// A thread reads this many frames one after the other. The first frame of the next run is read a second time.
const RUN: usize = 8;

/// The part of a sequence that is damaged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// `sequence.json`: what it says about files cannot be trusted.
    Record,
    /// The scene, the cameras or the environment.
    Description,
    /// The frame of this number.
    Frame(usize),
    /// The frames together: they contradict each other.
    Sequence,
}

/// What the header of every frame of a sequence must say.
#[derive(Clone, Copy, Debug)]
pub struct Header<'a> {
    /// BLAKE3 of the scene.
    pub scene: &'a str,
    /// Seed of its rendering.
    pub seed: u64,
    /// BLAKE3 of the files that the scene names, where it is known.
    pub files: Option<&'a str>,
}

impl Header<'_> {
    /// Checks that a frame with the header `info` belongs to this scene and was seen by `camera`.
    ///
    /// # Errors
    /// Says what the frame belongs to instead.
    pub fn hold(&self, info: &FrameInfo, camera: &Camera) -> Result<()> {
        ensure!(info.scene_hash == self.scene, "is of another scene ({:.64})", info.scene_hash);
        if let Some(files) = self.files {
            info.check_scene(self.scene, files).map_err(anyhow::Error::msg)?;
        }
        ensure!(info.seed == self.seed, "has the seed {}, the sequence has {}", info.seed, self.seed);
        ensure!(same_camera(&info.camera, camera), "was seen by another camera: it is another frame of the sequence");
        Ok(())
    }
}

/// Whether two cameras are equal up to the rounding of numbers in text.
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

/// The result of reading a sequence back.
#[derive(Clone, Debug, Default)]
pub struct Reading {
    /// What the frames without faults are like.
    pub checked: Checked,
    /// What is wrong, and with which part: first faults between frames, then faults of single frames.
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
        Some(((_, first), rest)) => bail!("{first} (and {})", plural(rest.len(), "more fault")),
    }
}

/// As [`sequence`], but continues after a fault.
///
/// # Errors
/// When the descriptions cannot be read or differ from the plan: then frames cannot be compared with anything.
pub fn read(plan: &Plan, folder: &Path, header: Header<'_>) -> Result<Reading> {
    let opened = Sequence::open_without_record(folder)?;
    opened.light()?;
    let numbers: Vec<usize> = plan.numbers().collect();
    ensure!(opened.len() == numbers.len(), "transforms.json: {}, the plan has {}", plural(opened.len(), "frame"), numbers.len());
    ensure!(opened.numbers == numbers, "transforms.json: its frames are not those of the plan");
    let keyframes: Vec<usize> = opened.transforms.keyframes.iter().filter_map(|&i| numbers.get(i).copied()).collect();
    ensure!(keyframes == plan.keyframe_numbers().collect::<Vec<_>>(), "transforms.json: its keyframes are not those of the plan");
    let starts: Vec<usize> = (0..numbers.len()).step_by(RUN).collect();
    let reader = Reader { plan, sequence: &opened, header };
    let parts: Vec<Reading> =
        starts.par_iter().with_max_len(1).map(|&start| reader.run(start..(start + RUN).min(numbers.len()))).collect();
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
struct Reader<'a> {
    plan: &'a Plan,
    sequence: &'a Sequence,
    header: Header<'a>,
}

impl Reader<'_> {
    /// Reads the frames `range`, and compares each of them with the next.
    fn run(&self, range: std::ops::Range<usize>) -> Reading {
        let sequence = self.sequence;
        let mut found = Reading::default();
        let checked = &mut found.checked;
        let mut before: Option<(usize, Frame)> = None;
        // One frame more than the run, to compare its last frame with.
        for index in range.start..(range.end + 1).min(sequence.len()) {
            let (frame, entry) = match self.frame(index) {
                Ok(read) => read,
                Err(error) => {
                    if range.contains(&index) {
                        let reason = format!("{}: {}", sequence.transforms.files[index], crate::util::console::message(&error));
                        found.faults.push((Part::Frame(sequence.numbers[index]), reason));
                    }
                    before = None;
                    continue;
                }
            };
            if let Some((previous, last)) = &before
                && sequence.numbers[index] == sequence.numbers[*previous] + 1
            {
                let movement = sequence.transforms.tracks.between(*previous, index);
                let view = |frame, index| View { frame, camera: sequence.camera(index) };
                checked.agreement.add_pair(view(last, *previous), view(&frame, index), &|id| movement.of(id));
            }
            if range.contains(&index) {
                checked.agreement.add_frame(View { frame: &frame, camera: sequence.camera(index) });
                checked.statistics.add_frame(&frame);
                checked.frames.push(entry);
            }
            before = Some((index, frame));
        }
        found
    }

    fn frame(&self, index: usize) -> Result<(Frame, FrameEntry)> {
        let (plan, sequence) = (self.plan, self.sequence);
        let (name, number) = (&sequence.transforms.files[index], sequence.numbers[index]);
        let path = sequence.file(index);
        let bytes = match file::read(&path) {
            Err(renderflow_frame::Error::Io { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => {
                bail!("is not there")
            }
            bytes => bytes.map_err(|error| without_name(&error, &path))?,
        };
        let frame = frame_file::decode(&path, &bytes).map_err(|error| without_name(&error, &path))?;
        let camera = sequence.camera(index);
        fits(&frame, camera)?;
        let [width, height] = plan.resolution.map(|v| v as usize);
        ensure!(
            (frame.width, frame.height) == (width, height),
            "{} x {} pixels, the plan has {width} x {height}",
            frame.width,
            frame.height
        );
        self.header.hold(&frame.info, camera)?;
        let planned = plan.samples(number);
        ensure!(
            frame.info.spp == planned || plan.render.adaptive && planned > 0 && frame.info.spp > 0,
            "{} per pixel, the plan has {planned}",
            plural(frame.info.spp, "sample")
        );
        ensure!((planned == 0) == frame.beauty.is_none(), "has a beauty where the plan has none, or none where it has one");
        verify_frame(&frame)?;
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

/// Half floats change the length of a unit normal by up to this much.
const NORMAL: f32 = 2e-3;

/// Checks the conventions that a frame's header states, pixel by pixel: infinite depth and a zero normal at a miss, a positive
/// depth and a unit normal at a hit, coverage within 0..=1, no negative light. (The reader has refused NaN.)
pub(super) fn verify_frame(frame: &Frame) -> Result<()> {
    let place = |i: usize| format!("pixel ({}, {})", i % frame.width, i / frame.width);
    for i in 0..frame.depth.pixels.len() {
        let (depth, alpha) = (frame.depth.pixels[i], frame.alpha.pixels[i]);
        let length = glam::Vec3::from(frame.normal.pixels[i]).length();
        ensure!(depth > 0.0, "{}: depth.Z is {depth}, not above 0", place(i));
        ensure!((0.0..=1.0).contains(&alpha), "{}: A is {alpha}, outside 0..=1", place(i));
        if depth.is_finite() {
            ensure!((length - 1.0).abs() <= NORMAL, "{}: the normal has length {length}, not 1", place(i));
        } else {
            ensure!(length == 0.0, "{}: a miss (depth +inf) with a normal of length {length}", place(i));
        }
    }
    if let Some(distance) = &frame.distance {
        let mut expected = frame.clone();
        expected.fill_distance();
        let pairs = distance.pixels.iter().zip(expected.distance.iter().flat_map(|image| &image.pixels));
        if let Some(i) = pairs.into_iter().position(|(d, e)| !(d == e || (d - e).abs() <= 1e-5 * e)) {
            bail!("{}: distance.Z is {}, not that of the planar depth", place(i), distance.pixels[i]);
        }
    }
    let lights = [
        ("the beauty", &frame.beauty),
        ("raw", &frame.raw),
        ("variance", &frame.variance),
        ("indirect", &frame.indirect),
        ("hidden", &frame.hidden),
    ];
    for (name, image) in lights {
        if let Some(image) = image
            && let Some(i) = image.pixels.iter().position(|p| p.iter().any(|v| *v < 0.0))
        {
            bail!("{}: {name} is negative, {:?}", place(i), image.pixels[i]);
        }
    }
    Ok(())
}

/// The error without the path that it begins with.
fn without_name(error: &renderflow_frame::Error, path: &Path) -> anyhow::Error {
    let text = error.to_string();
    anyhow::Error::msg(text.strip_prefix(&format!("{}: ", path.display())).unwrap_or(&text).to_owned())
}
