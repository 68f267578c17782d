//! The sequences of one split, for training. Every frame is compared with its record when it is read.

use super::check;
use super::damage;
use super::home::Home;
use super::record::Record;
use super::sequence::{Sequence, folders};
use super::shading::Shading;
use crate::dataset::layout::TRANSFORMS;
use crate::util::{console, files};
use anyhow::{Result, anyhow, ensure};
use rayon::prelude::*;
use renderflow_frame::{Frame, Light, file};
use renderflow_model::data::{Clip, ClipSource};
use std::path::{Path, PathBuf};

/// What to do about a sequence outside of a dataset with a plan, which cannot be repaired.
const AS_IT_IS: &str = "remove its sequence.json to take the sequence as it is";

/// All sequences of one split of a dataset.
#[derive(Debug, Default)]
pub struct Dataset {
    /// Sequences, ordered by name.
    pub sequences: Vec<Sequence>,
    /// The root of the dataset, if it has a plan and was opened for training.
    root: Option<PathBuf>,
    /// How clips are shaded, if they come with deferred shading.
    shaded: Option<Shaded>,
}

/// How clips are shaded.
#[derive(Debug)]
struct Shaded {
    /// Folders in which scenes may name files.
    allowed: Vec<PathBuf>,
    /// Distance in frame numbers of the frames that are carried to all others.
    gap: Option<usize>,
}

impl Dataset {
    /// Opens every sequence in `folder`: a dataset's split, a folder of sequences, or one sequence.
    ///
    /// # Errors
    /// When there is none, and as [`Sequence::open`].
    pub fn open(folder: &Path) -> Result<Self> {
        let paths = folders(folder)?;
        ensure!(!paths.is_empty(), "{}: no sequence (a folder with {TRANSFORMS}) inside", folder.display());
        Ok(Self { sequences: paths.iter().map(|path| Sequence::open(path)).collect::<Result<_>>()?, ..Self::default() })
    }

    /// As [`Self::open`], for training. In a dataset with a plan, every sequence must be complete, whole and in its place. Also
    /// returns notes for the user.
    ///
    /// # Errors
    /// As [`Self::open`]; when a sequence is damaged, is not complete, or does not belong to the plan.
    pub fn open_to_learn(folder: &Path) -> Result<(Self, Vec<String>)> {
        let mut notes = Vec::new();
        let Some(home) = Home::of(folder)? else {
            for path in folders(folder)? {
                Record::read(&path).map_err(|error| anyhow!("{}; {AS_IT_IS}", console::message(&error)))?;
            }
            return Ok((Self::open(folder)?, notes));
        };
        let present = home.present();
        home.accept(&present)?;
        if present.len() < home.indices.len() {
            notes.push(format!("{}: {} of {} sequences are there", folder.display(), present.len(), home.indices.len()));
        }
        Ok((Self { root: Some(home.root), ..Self::open(folder)? }, notes))
    }

    /// The same dataset, whose clips come with deferred shading. Scenes may name files in the folders `allowed` too. With `gap`,
    /// the first frame of each clip and those whose numbers are a multiple of it higher are keyframes, and are carried over
    /// deferred shading.
    pub fn shaded(self, allowed: &[PathBuf], gap: Option<usize>) -> Self {
        Self { shaded: Some(Shaded { allowed: allowed.into(), gap }), ..self }
    }

    /// BLAKE3 of a file of a sequence. For frames, it comes from the record; the frame is compared with it when it is read.
    fn hash_of(&self, index: usize, name: &str, frame: bool) -> Result<String> {
        let sequence = &self.sequences[index];
        let recorded = sequence.record.as_ref().and_then(|record| record.hash_of(name));
        match recorded.filter(|_| frame) {
            Some(recorded) => Ok(recorded.to_owned()),
            None => {
                let hash = files::hash(&sequence.folder.join(name))?;
                ensure!(recorded.is_none_or(|recorded| recorded == hash), self.damaged(index, name));
                Ok(hash)
            }
        }
    }

    /// Checks that the scene of a sequence is the one in its record.
    pub(crate) fn check_scene(&self, index: usize) -> Result<()> {
        self.hash_of(index, "scene.json", false).map(drop)
    }

    /// Said of a file that differs from its record.
    fn damaged(&self, index: usize, name: &str) -> String {
        let path = self.sequences[index].folder.join(name);
        let remedy = match &self.root {
            None => AS_IT_IS.to_owned(),
            Some(root) => format!("to repair it: {}", damage::remedy(root)),
        };
        format!("{}: is not the file that sequence.json has recorded; {remedy}", path.display())
    }

    /// BLAKE3 over the names, the cameras, the environments and the frames of all sequences.
    pub(crate) fn digest(&self) -> Result<String> {
        let sequence = |index: usize| -> Result<Vec<String>> {
            let sequence = &self.sequences[index];
            let mut parts = vec![sequence.name.clone()];
            parts.push(self.hash_of(index, TRANSFORMS, false)?);
            parts.push(self.hash_of(index, &sequence.transforms.environment, false)?);
            for name in &sequence.transforms.files {
                parts.extend([name.clone(), self.hash_of(index, name, true)?]);
            }
            Ok(parts)
        };
        let parts: Vec<Vec<String>> = (0..self.sequences.len()).into_par_iter().map(sequence).collect::<Result<_>>()?;
        Ok(blake3::hash(&serde_json::to_vec(&parts)?).to_hex().to_string())
    }

    /// A frame for training, after a comparison with its record and its camera.
    pub(crate) fn frame(&self, index: usize, at: usize) -> Result<Frame> {
        let sequence = &self.sequences[index];
        let path = sequence.file(at);
        let bytes = file::read(&path)?;
        let name = &sequence.transforms.files[at];
        if let Some(recorded) = sequence.record.as_ref().and_then(|record| record.hash_of(name)) {
            ensure!(blake3::hash(&bytes).to_hex().as_str() == recorded, self.damaged(index, name));
        }
        let frame = sequence.decode(at, &bytes)?;
        let seen = check::same_camera(&frame.info.camera, sequence.camera(at));
        ensure!(seen, "{}: was seen by another camera than {TRANSFORMS} has for it", path.display());
        Ok(frame)
    }

    /// The frames of a sequence, and its light.
    fn clip(&self, index: usize) -> Result<Clip> {
        let sequence = &self.sequences[index];
        let frames: Vec<Frame> = (0..sequence.len()).map(|at| self.frame(index, at)).collect::<Result<_>>()?;
        let other = frames.iter().position(|frame| frame.info.scene_hash != frames[0].info.scene_hash);
        let names = &sequence.transforms.files;
        ensure!(other.is_none(), "{} is of another scene than {}", names[other.unwrap_or(0)], names[0]);
        let mut shaded = Vec::new();
        if let Some(Shaded { allowed, gap }) = &self.shaded {
            self.check_scene(index)?;
            let numbers = &sequence.numbers;
            let is_key = |at: &usize| gap.is_some_and(|gap| (numbers[*at] - numbers[0]).is_multiple_of(gap));
            let keys: Vec<usize> = (0..numbers.len()).filter(is_key).collect();
            let mut shading = Shading::new(sequence, allowed, &keys)?;
            shaded = frames.iter().enumerate().map(|(at, frame)| shading.picture(at, frame)).collect::<Result<_>>()?;
        }
        Ok(Clip {
            name: sequence.name.clone(),
            frames,
            shaded,
            numbers: sequence.numbers.clone(),
            light: Light::clone(sequence.light()?),
        })
    }
}

impl ClipSource for Dataset {
    fn len(&self) -> usize {
        self.sequences.len()
    }

    fn load(&self, index: usize) -> renderflow_model::Result<Clip> {
        let folder = &self.sequences[index].folder;
        self.clip(index).map_err(|error| renderflow_model::Error::Data {
            place: folder.display().to_string(),
            reason: damage::relative(folder, &console::message(&error)),
        })
    }

    fn identity(&self) -> renderflow_model::Result<Option<String>> {
        let unreadable = |error: anyhow::Error| renderflow_model::Error::Data {
            place: "training data".into(),
            reason: console::message(&error),
        };
        self.digest().map(Some).map_err(unreadable)
    }
}
