//! A sequence on disk: the folder `<split>/seq-000123/{scene.json, transforms.json, env.hdr, sequence.json, frame.0000.exr |
//! .rff, ...}`.

use super::record::Record;
use crate::dataset::layout::{SCENE, TRANSFORMS, frame_number, is_aside, is_sequence};
use crate::util::files;
use anyhow::{Context, Result, anyhow, ensure};
use rayon::prelude::*;
use renderflow_frame::frame_file;
use renderflow_frame::reach::plain_name;
use renderflow_frame::{Camera, DepthBounds, Environment, Frame, Light, file, hdr, transforms};
use renderflow_model::renderer::{self, KeyframePlace};
use renderflow_scenes::procedural::Split;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

/// The folders of sequences in `root`, by path; only `root` itself, if it is a sequence. Sequences deeper inside are not found.
///
/// # Errors
/// When `root` cannot be listed.
pub fn folders(root: &Path) -> Result<Vec<PathBuf>> {
    if is_sequence(root) {
        return Ok(vec![root.to_owned()]);
    }
    Ok(files::list(root)?.into_iter().filter(|path| is_sequence(path)).collect())
}

/// The folders of all sequences at or below `root`, at any depth, by path. A sequence inside of another one is part of it, and
/// what a dataset below `root` has put aside is part of nothing.
///
/// # Errors
/// When a folder cannot be listed.
pub fn find_folders(root: &Path) -> Result<Vec<PathBuf>> {
    let descriptions = files::walk(root, &["json"])?.into_iter().filter(|path| path.ends_with(TRANSFORMS));
    let counts = |folder: &PathBuf| !folder.ancestors().take_while(|above| *above != root).any(is_aside);
    let mut all: Vec<PathBuf> = descriptions.filter_map(|path| Some(path.parent()?.to_owned())).filter(counts).collect();
    // A folder comes before the folders inside of it.
    all.sort();
    let mut found: Vec<PathBuf> = Vec::new();
    for folder in all {
        if found.last().is_none_or(|outer| !folder.starts_with(outer)) {
            found.push(folder);
        }
    }
    Ok(found)
}

/// Every sequence at or below `root`, at any depth, by path.
///
/// # Errors
/// When there is none, when a folder cannot be listed, and as [`Sequence::open`].
pub fn find(root: &Path) -> Result<Vec<Sequence>> {
    let folders = find_folders(root)?;
    ensure!(!folders.is_empty(), "{}: no sequence (a folder with {TRANSFORMS}) inside", root.display());
    folders.iter().map(|folder| Sequence::open(folder)).collect()
}

/// A sequence on disk. Its descriptions are read when it is opened; its light and its frames are read when they are needed.
#[derive(Debug)]
pub struct Sequence {
    /// The folder.
    pub folder: PathBuf,
    /// Name of the folder.
    pub name: String,
    /// The split that its folder lies in; otherwise the split in its record; otherwise the training split.
    pub split: Split,
    /// Cameras, files, keyframes, exposure.
    pub transforms: transforms::Sequence,
    /// Number of each stored frame in the sequence, ascending. A plan may store only every fourth frame, for instance.
    pub numbers: Vec<usize>,
    /// `sequence.json`, if there is one.
    pub record: Option<Record>,
    keyframes: Vec<KeyframePlace>,
    light: OnceLock<Arc<Light>>,
    depths: OnceLock<DepthBounds>,
}

impl Sequence {
    /// Reads `transforms.json` and `sequence.json`.
    ///
    /// # Errors
    /// When one of them cannot be read, names files outside of the folder, or names frames in another way than this program does.
    pub fn open(folder: &Path) -> Result<Self> {
        let record = Record::read(folder)?;
        let sequence = Self::open_without_record(folder)?;
        let split = split_of(folder).or(record.as_ref().map(|record| record.split)).unwrap_or(Split::Train);
        Ok(Self { split, record, ..sequence })
    }

    /// As [`Self::open`], for code that is about to write the record or to judge it.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub(super) fn open_without_record(folder: &Path) -> Result<Self> {
        let transforms = read_transforms(folder)?;
        let number = |file: &String| {
            frame_number(file).with_context(|| format!("{}: {file} is not a frame of this program", folder.display()))
        };
        let numbers: Vec<usize> = transforms.files.iter().map(number).collect::<Result<_>>()?;
        ensure!(numbers.is_sorted_by(|a, b| a < b), "{}: its frames are not in order", folder.display());
        let keyframes = places(&transforms.keyframes, &numbers);
        let full = std::path::absolute(folder).with_context(|| folder.display().to_string())?;
        Ok(Self {
            folder: folder.to_owned(),
            name: full.file_name().map_or_else(|| "sequence".into(), |name| name.to_string_lossy().into_owned()),
            split: split_of(folder).unwrap_or(Split::Train),
            transforms,
            numbers,
            record: None,
            keyframes,
            light: OnceLock::new(),
            depths: OnceLock::new(),
        })
    }

    /// BLAKE3 of what tells the stored frames `indices` from those of other data: of the descriptions, of these frames, and of
    /// the keyframes. Of a frame whose size is the recorded one, the recorded BLAKE3 is taken, so that large sets need not be
    /// read again.
    ///
    /// # Errors
    /// When a file cannot be read.
    pub fn digest(&self, indices: &[usize]) -> Result<String> {
        let keyframes = &self.transforms.keyframes;
        let hash = |name: &str| -> Result<Option<String>> {
            let path = self.folder.join(name);
            let Ok(about) = std::fs::metadata(&path) else { return Ok(None) };
            let mut recorded = self.record.iter().flat_map(|record| &record.frames);
            let known = recorded.find(|frame| frame.file == name && frame.bytes == about.len());
            known.map_or_else(|| files::hash(&path), |frame| Ok(frame.blake3.clone())).map(Some)
        };
        let read: BTreeSet<usize> = indices.iter().chain(keyframes).copied().collect();
        let frames = read.into_iter().filter_map(|index| self.transforms.files.get(index)).map(String::as_str);
        let names = [TRANSFORMS, SCENE, self.transforms.environment.as_str()].into_iter().chain(frames);
        let hashes = names.map(|name| Ok((name, hash(name)?))).collect::<Result<Vec<_>>>()?;
        Ok(blake3::hash(&serde_json::to_vec(&(hashes, keyframes))?).to_hex().to_string())
    }

    /// Takes the frames whose number is a multiple of `gap`, at least 1, as keyframes instead of those of the files.
    pub fn set_keyframes(&mut self, gap: usize) {
        self.transforms.keyframes = (0..self.len()).filter(|&index| self.numbers[index].is_multiple_of(gap)).collect();
        self.keyframes = places(&self.transforms.keyframes, &self.numbers);
    }

    /// Number of stored frames.
    pub fn len(&self) -> usize {
        self.numbers.len()
    }

    /// Whether there are no frames.
    pub fn is_empty(&self) -> bool {
        self.numbers.is_empty()
    }

    /// Factor from radiance to display-linear.
    pub fn exposure(&self) -> f32 {
        self.transforms.exposure
    }

    /// Camera of stored frame `index`.
    pub fn camera(&self, index: usize) -> &Camera {
        &self.transforms.cameras[index]
    }

    /// File of stored frame `index`.
    ///
    /// # Panics
    /// When there is no such frame.
    pub fn file(&self, index: usize) -> PathBuf {
        self.folder.join(&self.transforms.files[index])
    }

    /// Reads stored frame `index`, which must have the size of its camera.
    ///
    /// # Errors
    /// When there is no such frame, or it cannot be read or has another size.
    pub fn frame(&self, index: usize) -> Result<Frame> {
        ensure!(index < self.len(), "{}: has no frame {index}", self.folder.display());
        self.decode(index, &file::read(&self.file(index))?)
    }

    /// [`Self::frame`] from memory.
    pub(super) fn decode(&self, index: usize, bytes: &[u8]) -> Result<Frame> {
        let path = self.file(index);
        let frame = frame_file::decode(&path, bytes)?;
        fits(&frame, self.camera(index)).with_context(|| path.display().to_string())?;
        Ok(frame)
    }

    /// The light, which is read when it is first needed.
    ///
    /// # Errors
    /// When the environment map cannot be read.
    pub fn light(&self) -> Result<&Arc<Light>> {
        if let Some(light) = self.light.get() {
            return Ok(light);
        }
        let path = self.folder.join(&self.transforms.environment);
        let map = hdr::decode(&path, &file::read(&path)?)?.map;
        let (rotation, intensity) = (self.transforms.environment_rotation, self.transforms.environment_intensity);
        let light = Light::with_exposure(Environment { map, rotation, intensity }, self.transforms.exposure);
        Ok(self.light.get_or_init(|| Arc::new(light)))
    }

    /// The error of a network that cannot read the sequence.
    fn unreadable(&self, error: &anyhow::Error) -> renderflow_model::Error {
        renderflow_model::Error::Data { place: self.folder.display().to_string(), reason: crate::util::console::message(error) }
    }
}

impl renderer::Sequence for Sequence {
    fn light(&self) -> renderflow_model::Result<&Light> {
        self.light().map(Arc::as_ref).map_err(|error| self.unreadable(&error))
    }

    fn depth_bounds(&self) -> renderflow_model::Result<DepthBounds> {
        if let Some(bounds) = self.depths.get() {
            return Ok(*bounds);
        }
        let extremes = |index: usize| -> renderflow_model::Result<[f32; 2]> {
            let frame = self.keyframe(index)?;
            let seen = frame.depth.pixels.iter().copied().filter(|d| *d > 0.0 && d.is_finite());
            Ok(seen.fold([f32::INFINITY, 0.0], |[near, far], d| [near.min(d), far.max(d)]))
        };
        let extremes: Vec<[f32; 2]> = (0..self.len()).into_par_iter().map(extremes).collect::<renderflow_model::Result<_>>()?;
        Ok(*self.depths.get_or_init(|| DepthBounds::of_depths(extremes.into_iter().flatten())))
    }

    fn keyframes(&self) -> &[KeyframePlace] {
        &self.keyframes
    }

    fn keyframe(&self, index: usize) -> renderflow_model::Result<Frame> {
        self.frame(index).map_err(|error| self.unreadable(&error))
    }
}

/// The keyframes at the stored indices `keyframes` of frames with these numbers, in order.
fn places(keyframes: &[usize], numbers: &[usize]) -> Vec<KeyframePlace> {
    let mut places: Vec<_> = keyframes.iter().map(|&index| KeyframePlace { number: numbers[index], index }).collect();
    places.sort_by_key(|place| place.number);
    places
}

/// Checks that a frame has the size of its camera.
///
/// # Errors
/// The message has both sizes.
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

/// Reads the cameras of the sequence in `folder`. The frames and the environment must lie in the same folder.
fn read_transforms(folder: &Path) -> Result<transforms::Sequence> {
    let path = folder.join(TRANSFORMS);
    let sequence = transforms::decode(&path, &file::read_at_most(&path, file::LARGEST_TEXT)?)?;
    let plain = |pointer: String, name: &str| {
        plain_name(name).map(drop).map_err(|reason| anyhow!("{}: {pointer}: {reason}", path.display()))
    };
    plain("/environment/file".into(), &sequence.environment)?;
    sequence.files.iter().enumerate().try_for_each(|(i, name)| plain(format!("/frames/{i}/file_path"), name))?;
    Ok(sequence)
}

/// The split whose folder the sequence lies in.
fn split_of(folder: &Path) -> Option<Split> {
    let full = std::path::absolute(folder).ok()?;
    split_named(full.parent()?)
}

/// The split that a folder is named after.
pub(super) fn split_named(folder: &Path) -> Option<Split> {
    let name = folder.file_name()?.to_str()?;
    super::plan::SPLITS.into_iter().find(|split| split.name() == name)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Cameras of one frame, as `transforms.json` has them.
    fn cameras(files: &[&str]) -> Vec<u8> {
        let camera = Camera::look_at(glam::Vec3A::Z, glam::Vec3A::ZERO, glam::Vec3A::Y, 0.8, 8, 8);
        let sequence = transforms::Sequence {
            cameras: vec![camera; files.len()],
            files: files.iter().map(|file| (*file).to_owned()).collect(),
            keyframes: vec![0],
            exposure: 1.0,
            environment: "env.hdr".into(),
            environment_rotation: 0.0,
            environment_intensity: 1.0,
            tracks: Default::default(),
        };
        transforms::encode(Path::new(TRANSFORMS), &sequence).unwrap()
    }

    /// Networks that ask for keyframes see those that were set.
    #[test]
    fn keyframes_may_be_set() {
        let root = tempfile::tempdir().unwrap();
        std::fs::write(root.path().join(TRANSFORMS), cameras(&["frame.0004.exr", "frame.0008.exr"])).unwrap();
        let mut sequence = Sequence::open(root.path()).unwrap();
        let places = |sequence: &Sequence| renderer::Sequence::keyframes(sequence).to_vec();
        assert_eq!(places(&sequence), [KeyframePlace { number: 4, index: 0 }]);
        sequence.set_keyframes(8);
        assert_eq!(places(&sequence), [KeyframePlace { number: 8, index: 1 }]);
        assert_eq!(sequence.transforms.keyframes, [1]);
        sequence.set_keyframes(3);
        assert!(places(&sequence).is_empty());
    }

    #[test]
    fn sequences_are_found_at_any_depth_but_not_inside_of_each_other() {
        let root = tempfile::tempdir().unwrap();
        for name in ["set/val/b", "a", "a/inner", "set/val/b-2"] {
            let folder = root.path().join(name);
            std::fs::create_dir_all(&folder).unwrap();
            std::fs::write(folder.join(TRANSFORMS), cameras(&["frame.0004.exr", "frame.0008.exr"])).unwrap();
        }
        let found = find(root.path()).unwrap();
        let names: Vec<(&str, Split)> = found.iter().map(|s| (s.name.as_str(), s.split)).collect();
        assert_eq!(names, [("a", Split::Train), ("b", Split::Val), ("b-2", Split::Val)]);
        assert_eq!((found[0].numbers.as_slice(), found[0].len()), (&[4, 8][..], 2));
        assert_eq!(folders(root.path()).unwrap(), [root.path().join("a")]);
        assert!(find(&root.path().join("a/inner/none")).is_err());
    }

    /// A repair moves what is in the way into the folder `aside` of the dataset.
    #[test]
    fn what_was_put_aside_does_not_count() {
        let root = tempfile::tempdir().unwrap();
        for name in ["set/test/a", "set/aside/test-a-1"] {
            let folder = root.path().join(name);
            std::fs::create_dir_all(&folder).unwrap();
            std::fs::write(folder.join(TRANSFORMS), cameras(&["frame.0000.exr"])).unwrap();
        }
        let names = |root: &Path| find(root).unwrap().into_iter().map(|sequence| sequence.name).collect::<Vec<_>>();
        // Any folder may be called so, if it does not lie beside a plan.
        assert_eq!(names(root.path()), ["test-a-1", "a"]);
        std::fs::write(root.path().join("set/plan.json"), "{}").unwrap();
        assert_eq!(names(root.path()), ["a"]);
        assert_eq!(names(&root.path().join("set")), ["a"]);
        // Who names it, means it.
        assert_eq!(names(&root.path().join("set/aside")), ["test-a-1"]);
    }

    #[test]
    fn frames_that_this_program_would_call_otherwise_are_refused() {
        let root = tempfile::tempdir().unwrap();
        for (files, reason) in
            [(["frame.0001.exr", "x.exr"], "x.exr is not a frame"), (["frame.0002.exr", "frame.0001.exr"], "order")]
        {
            std::fs::write(root.path().join(TRANSFORMS), cameras(&files)).unwrap();
            let refused = Sequence::open(root.path()).unwrap_err().to_string();
            assert!(refused.contains(reason), "{refused}");
        }
    }
}
