//! Reads dataset folders: `<split>/seq-000123/{scene.json, transforms.json, env.hdr, frame.0000.exr | .rff, ...}`.

use anyhow::{Context, Result, ensure};
use renderflow_frame::frame_file::{self, Profile};
use renderflow_frame::{Camera, Environment, Frame, hdr, transforms};
use renderflow_model::data::{Clip, ClipSource};
use std::path::{Path, PathBuf};

/// File name of frame `number` of a sequence.
pub fn frame_file(number: usize, profile: Profile) -> String {
    format!("frame.{number:04}.{}", profile.extension())
}

/// Inverse of [`frame_file`].
pub(super) fn frame_number(file: &str) -> Option<usize> {
    let (number, ending) = file.strip_prefix("frame.")?.split_once('.')?;
    frame_file::EXTENSIONS.contains(&ending).then(|| number.parse().ok())?
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
    pub environment: Environment,
}

impl SequenceFolder {
    /// Reads `transforms.json` and the environment map; frames are read on demand.
    pub fn open(path: &Path) -> Result<Self> {
        let sequence = transforms::read(&path.join("transforms.json"))?;
        let map = hdr::read(&path.join(&sequence.environment))?.map;
        let environment = Environment { map, rotation: sequence.environment_rotation, intensity: sequence.environment_intensity };
        let numbers = (sequence.files.iter().enumerate()).map(|(i, file)| frame_number(file).unwrap_or(i)).collect();
        Ok(Self { path: path.to_owned(), sequence, numbers, environment })
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

    /// Reads frame `index`.
    pub fn frame(&self, index: usize) -> Result<Frame> {
        let file = self.sequence.files.get(index).with_context(|| format!("{}: has no frame {index}", self.path.display()))?;
        Ok(frame_file::read(&self.path.join(file))?)
    }

    /// Camera of frame `index`.
    pub fn camera(&self, index: usize) -> &Camera {
        &self.sequence.cameras[index]
    }
}

/// All sequences of one split of a dataset.
#[derive(Clone, Debug)]
pub struct Dataset {
    /// Sequences, ordered by name.
    pub sequences: Vec<SequenceFolder>,
}

impl Dataset {
    /// Opens every sequence under `folder` (a dataset's split, or a folder of sequences, or one sequence).
    pub fn open(folder: &Path) -> Result<Self> {
        if folder.join("transforms.json").is_file() {
            return Ok(Self { sequences: vec![SequenceFolder::open(folder)?] });
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
        Ok(Self { sequences: paths.iter().map(|p| SequenceFolder::open(p)).collect::<Result<_>>()? })
    }
}

impl ClipSource for Dataset {
    fn len(&self) -> usize {
        self.sequences.len()
    }

    fn load(&self, index: usize) -> renderflow_model::Result<Clip> {
        let folder = &self.sequences[index];
        let files = folder.sequence.files.iter();
        let frames = files.map(|f| frame_file::read(&folder.path.join(f))).collect::<std::result::Result<_, _>>()?;
        Ok(Clip {
            name: folder.name(),
            frames,
            numbers: folder.numbers.clone(),
            tracks: folder.sequence.tracks.clone(),
            cameras: folder.sequence.cameras.clone(),
            environment: folder.environment.clone(),
            exposure: folder.sequence.exposure,
            keyframes: folder.sequence.keyframes.clone(),
        })
    }
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
