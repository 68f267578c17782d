//! Pictures whose numbers of samples come from frames that are there.

use super::TruthSettings;
use crate::dataset::layout::frame_file;
use anyhow::{Context, Result, bail};
use renderflow_frame::frame_file::Profile;
use renderflow_frame::{Frame, exr};
use renderflow_renderer::{RenderScene, Settings};
use std::path::{Path, PathBuf};

impl TruthSettings {
    /// The settings and the sample map of frame `index` of `frames`.
    pub(super) fn mapped(&self, path: &Path, index: usize, frames: usize) -> Result<(Settings, Frame)> {
        let path = if path.is_dir() { path.join(frame_file(index, Profile::Full)) } else { path.to_owned() };
        if frames > 1 && path.file_name() != Some(frame_file(index, Profile::Full).as_ref()) {
            bail!("{}: is the map of one frame, the sequence has {frames}; name a folder of frames", path.display());
        }
        let map = exr::read(&path)?;
        let settings = self.render.with_sampling(&map.info.sampling);
        let settings = settings.with_context(|| format!("{}: was not sampled adaptively", path.display()))?;
        // The numbers of samples are multiples of the branches, and another number of branches would make another picture.
        let (branches, light_paths) = (map.info.branches.unwrap_or(1), map.info.light_paths);
        Ok((Settings { branches, light_paths, ..settings }, map))
    }

    /// These settings with the numbers of samples of the frame or the folder of frames `path`, for a sequence of `frames`.
    ///
    /// # Errors
    /// When there is no such frame, or OIDN is needed and not found.
    pub fn with_sample_map(mut self, path: PathBuf, frames: usize) -> Result<Self> {
        let (settings, _) = self.mapped(&path, 0, frames)?;
        if let Some(denoiser) = &mut self.denoiser {
            denoiser.reopen(&settings, 1)?;
        }
        Ok(Self { sample_map: Some(path), ..self })
    }

    /// The settings of the frame at which `scene` stands.
    pub(super) fn used(&self, scene: &RenderScene) -> Result<Settings> {
        Ok(match &self.sample_map {
            Some(path) => self.mapped(path, scene.frame(), scene.frames())?.0,
            None => self.render,
        })
    }
}
