//! Reads dataset folders: `<split>/seq-000123/{scene.json, transforms.json, env.hdr, frame.0000.exr | .rff, ...}`.

use super::check;
use super::home::Home;
use super::record::Record;
use anyhow::{Context, Result, anyhow, ensure};
use rayon::prelude::*;
use renderflow_frame::frame_file::{self, Profile};
use renderflow_frame::reach::plain_name;
use renderflow_frame::{Camera, Environment, Frame, Light, file, hdr, transforms};
use renderflow_model::data::{Clip, ClipSource};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// File name of frame `number` of a sequence.
pub fn frame_file(number: usize, profile: Profile) -> String {
    format!("frame.{number:04}.{}", profile.extension())
}

/// Inverse of [`frame_file`].
pub(super) fn frame_number(file: &str) -> Option<usize> {
    let (number, ending) = file.strip_prefix("frame.")?.split_once('.')?;
    frame_file::EXTENSIONS.contains(&ending).then(|| number.parse().ok())?
}

/// Reads the cameras of the sequence in `folder`. Its frames and its environment lie beside them.
///
/// # Errors
/// As [`transforms::read`]; when a name would lead elsewhere.
pub fn read_transforms(folder: &Path) -> Result<transforms::Sequence> {
    let path = folder.join("transforms.json");
    let sequence = transforms::decode(&path, &file::read_at_most(&path, file::LARGEST_TEXT)?)?;
    let plain = |pointer: String, name: &str| {
        plain_name(name).map(drop).map_err(|reason| anyhow!("{}: {pointer}: {reason}", path.display()))
    };
    plain("/environment/file".into(), &sequence.environment)?;
    sequence.files.iter().enumerate().try_for_each(|(i, name)| plain(format!("/frames/{i}/file_path"), name))?;
    Ok(sequence)
}

/// One sequence on disk.
#[derive(Clone, Debug)]
pub struct SequenceFolder {
    /// The folder.
    pub path: PathBuf,
    /// Cameras, files, keyframes, exposure.
    pub sequence: transforms::Sequence,
    /// Number of each stored frame in its sequence; counts up by the plan's frame step.
    pub numbers: Vec<usize>,
    /// The light.
    pub light: Arc<Light>,
}

impl SequenceFolder {
    /// Reads `transforms.json` and the environment map; frames are read on demand.
    pub fn open(path: &Path) -> Result<Self> {
        let sequence = read_transforms(path)?;
        let environment = path.join(&sequence.environment);
        let map = hdr::decode(&environment, &file::read(&environment)?)?.map;
        let environment = Environment { map, rotation: sequence.environment_rotation, intensity: sequence.environment_intensity };
        let numbers = (sequence.files.iter().enumerate()).map(|(i, file)| frame_number(file).unwrap_or(i)).collect();
        let light = Arc::new(Light::with_exposure(environment, sequence.exposure));
        Ok(Self { path: path.to_owned(), sequence, numbers, light })
    }

    /// Name of the folder.
    pub fn name(&self) -> String {
        self.path.file_name().map_or_else(|| "sequence".into(), |n| n.to_string_lossy().into_owned())
    }

    /// Number of frames.
    pub fn len(&self) -> usize {
        self.sequence.cameras.len()
    }

    /// Whether there are no frames.
    pub fn is_empty(&self) -> bool {
        self.sequence.cameras.is_empty()
    }

    /// Reads frame `index`, which must have the size of its camera.
    pub fn frame(&self, index: usize) -> Result<Frame> {
        let path = self.file(index)?;
        self.decode(index, &file::read(&path)?)
    }

    /// File of frame `index`.
    fn file(&self, index: usize) -> Result<PathBuf> {
        let name = self.sequence.files.get(index).with_context(|| format!("{}: has no frame {index}", self.path.display()))?;
        Ok(self.path.join(name))
    }

    /// [`Self::frame`] from memory.
    fn decode(&self, index: usize, bytes: &[u8]) -> Result<Frame> {
        let path = self.file(index)?;
        let frame = frame_file::decode(&path, bytes)?;
        check::fits(&frame, self.camera(index)).with_context(|| path.display().to_string())?;
        Ok(frame)
    }

    /// Camera of frame `index`.
    pub fn camera(&self, index: usize) -> &Camera {
        &self.sequence.cameras[index]
    }
}

/// What to do about a sequence outside of a dataset with a plan, which nothing can mend.
const AS_IT_IS: &str = "remove its sequence.json to take the sequence as it is";

/// All sequences of one split of a dataset.
#[derive(Clone, Debug, Default)]
pub struct Dataset {
    /// Sequences, ordered by name.
    pub sequences: Vec<SequenceFolder>,
    /// The records that they are held to; empty where nobody asked for them, `None` for sequences without one.
    records: Vec<Option<Record>>,
    /// The dataset with a plan that they are of, where records are held to it.
    root: PathBuf,
}

impl Dataset {
    /// Opens every sequence under `folder` (a dataset's split, or a folder of sequences, or one sequence).
    pub fn open(folder: &Path) -> Result<Self> {
        if folder.join("transforms.json").is_file() {
            return Ok(Self::new(vec![SequenceFolder::open(folder)?]));
        }
        let entries = std::fs::read_dir(folder).with_context(|| format!("{}: cannot open dataset", folder.display()))?;
        let mut paths = Vec::new();
        for entry in entries {
            let path = entry.with_context(|| format!("{}: cannot list", folder.display()))?.path();
            if path.join("transforms.json").is_file() {
                paths.push(path);
            }
        }
        paths.sort();
        ensure!(!paths.is_empty(), "{}: no sequence (a folder with transforms.json) inside", folder.display());
        Ok(Self::new(paths.iter().map(|p| SequenceFolder::open(p)).collect::<Result<_>>()?))
    }

    fn new(sequences: Vec<SequenceFolder>) -> Self {
        Self { sequences, ..Self::default() }
    }

    /// As [`Self::open`], to learn from. Where the folder is a part of a dataset with a plan, every sequence in it must be complete, whole and
    /// in its place. Each frame is held to its record, where it has one, when it is read. Also what is worth saying.
    ///
    /// # Errors
    /// As [`Self::open`]; when a sequence is damaged, is not complete, or does not belong to the plan.
    pub fn open_to_learn(folder: &Path) -> Result<(Self, Vec<String>)> {
        let mut notes = Vec::new();
        let Some(home) = Home::of(folder)? else {
            let dataset = Self::open(folder)?;
            let record = |sequence: &SequenceFolder| {
                Record::read(&sequence.path).map_err(|error| anyhow!("{}; {AS_IT_IS}", crate::console::message(&error)))
            };
            let records = dataset.sequences.iter().map(record).collect::<Result<_>>()?;
            return Ok((Self { records, ..dataset }, notes));
        };
        let present = home.present();
        let records = home.accept(&present)?;
        if present.len() < home.indices.len() {
            notes.push(format!("{}: {} of {} sequences are there", folder.display(), present.len(), home.indices.len()));
        }
        let dataset = Self::open(folder)?;
        let record = |sequence: &SequenceFolder| {
            let path = std::path::absolute(&sequence.path).ok()?;
            let name = path.file_name()?.to_str()?;
            records.iter().find(|record| record.name == name).cloned()
        };
        let records = dataset.sequences.iter().map(record).collect();
        Ok((Self { records, root: home.root, ..dataset }, notes))
    }

    /// BLAKE3 of a file of a sequence: for frames the one that was recorded, to which they are held when they are read.
    fn hash_of(&self, index: usize, name: &str, frame: bool) -> Result<String> {
        let path = self.sequences[index].path.join(name);
        let recorded = self.record(index).and_then(|record| record.hash_of(name));
        match recorded.filter(|_| frame) {
            Some(recorded) => Ok(recorded.to_owned()),
            None => {
                let hash = super::damage::hash(&path)?;
                ensure!(recorded.is_none_or(|recorded| recorded == hash), self.damaged(index, name));
                Ok(hash)
            }
        }
    }

    /// Checks that the scene of a sequence is the one that was recorded.
    pub(crate) fn check_scene(&self, index: usize) -> Result<()> {
        self.hash_of(index, "scene.json", false).map(drop)
    }

    fn record(&self, index: usize) -> Option<&Record> {
        self.records.get(index)?.as_ref()
    }

    /// Said of a file that is not the one that was recorded.
    fn damaged(&self, index: usize, name: &str) -> String {
        let path = self.sequences[index].path.join(name);
        let remedy = if self.root.as_os_str().is_empty() {
            AS_IT_IS.to_owned()
        } else {
            format!("to mend it: {}", super::damage::remedy(&self.root))
        };
        format!("{}: is not the file that sequence.json has recorded; {remedy}", path.display())
    }

    /// BLAKE3 over the names, the cameras, the environments and the frames of all sequences.
    pub(crate) fn digest(&self) -> Result<String> {
        let sequence = |index: usize| -> Result<Vec<String>> {
            let folder = &self.sequences[index];
            let mut parts = vec![folder.name()];
            parts.push(self.hash_of(index, "transforms.json", false)?);
            parts.push(self.hash_of(index, &folder.sequence.environment, false)?);
            for name in &folder.sequence.files {
                parts.extend([name.clone(), self.hash_of(index, name, true)?]);
            }
            Ok(parts)
        };
        let parts: Vec<Vec<String>> = (0..self.sequences.len()).into_par_iter().map(sequence).collect::<Result<_>>()?;
        Ok(blake3::hash(&serde_json::to_vec(&parts)?).to_hex().to_string())
    }

    /// A frame to learn from, held to its record and to its camera.
    pub(crate) fn frame(&self, index: usize, at: usize) -> Result<Frame> {
        let folder = &self.sequences[index];
        let path = folder.file(at)?;
        let bytes = file::read(&path)?;
        let name = &folder.sequence.files[at];
        if let Some(recorded) = self.record(index).and_then(|record| record.hash_of(name)) {
            ensure!(blake3::hash(&bytes).to_hex().as_str() == recorded, self.damaged(index, name));
        }
        let frame = folder.decode(at, &bytes)?;
        let seen = check::same_camera(&frame.info.camera, folder.camera(at));
        ensure!(seen, "{}: was seen by another camera than transforms.json has for it", path.display());
        Ok(frame)
    }
}

impl ClipSource for Dataset {
    fn len(&self) -> usize {
        self.sequences.len()
    }

    fn load(&self, index: usize) -> renderflow_model::Result<Clip> {
        let folder = &self.sequences[index];
        let error = |error: anyhow::Error| unusable(folder, &error);
        let frames: Vec<Frame> = (0..folder.len()).map(|at| self.frame(index, at)).collect::<Result<_>>().map_err(error)?;
        let strange = frames.iter().position(|frame| frame.info.scene_hash != frames[0].info.scene_hash);
        if let Some(at) = strange {
            let of = anyhow!("{} is of another scene than {}", folder.sequence.files[at], folder.sequence.files[0]);
            return Err(unusable(folder, &of));
        }
        Ok(Clip {
            name: folder.name(),
            frames,
            numbers: folder.numbers.clone(),
            tracks: folder.sequence.tracks.clone(),
            light: Light::clone(&folder.light),
            keyframes: folder.sequence.keyframes.clone(),
        })
    }

    fn identity(&self) -> renderflow_model::Result<Option<String>> {
        let unreadable = |error: anyhow::Error| renderflow_model::Error::Data {
            place: "training data".into(),
            reason: crate::console::message(&error),
        };
        self.digest().map(Some).map_err(unreadable)
    }
}

/// The error of a sequence that cannot be learned from.
fn unusable(folder: &SequenceFolder, error: &anyhow::Error) -> renderflow_model::Error {
    let message = crate::console::message(error);
    let reason = super::damage::relative(&folder.path, &message);
    renderflow_model::Error::Data { place: folder.path.display().to_string(), reason }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_frame_files() {
        for number in [0, 7, 9999, 12345] {
            for profile in [Profile::Full, Profile::Compact] {
                assert_eq!(frame_number(&frame_file(number, profile)), Some(number));
            }
        }
        for other in ["frame.0001.png", "frame.0001", "frame.x.exr", "image.0001.exr", "frame.0001.exr.tmp"] {
            assert_eq!(frame_number(other), None, "{other}");
        }
    }
}
