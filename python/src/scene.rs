//! Scenes: from a seed, from a file, or from a description.

use crate::work::{self, failed};
use pyo3::exceptions::{PyIndexError, PyValueError};
use pyo3::prelude::*;
use renderflow::dataset::job::with_absolute_paths;
use renderflow::dataset::source::{Described, SceneSource};
use renderflow_frame::reach::Reach;
use renderflow_renderer::RenderScene;
use renderflow_renderer::deferred::{LIGHTS, Lighting};
use renderflow_scenes::description::{self, Animation, NameOrNumber};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// A scene. It is loaded and compiled when the first picture of it is made, and kept.
#[pyclass(frozen, module = "renderflow")]
pub struct Scene {
    description: description::Scene,
    reach: Reach,
    compiled: Mutex<Option<Compiled>>,
    /// What was decided about it that a person should know.
    #[pyo3(get)]
    notes: Vec<String>,
}

/// A scene in the form that the renderers read.
pub struct Compiled {
    /// The scene, at the frame that was asked for.
    pub scene: RenderScene,
    lighting: Option<Arc<Lighting>>,
}

impl Compiled {
    /// The lights that deferred shading finds in the environment.
    pub fn lighting(&mut self) -> Arc<Lighting> {
        let light = Arc::clone(self.scene.light());
        Arc::clone(self.lighting.get_or_insert_with(|| Arc::new(Lighting::new(light, LIGHTS))))
    }
}

impl Scene {
    fn new(Described { scene, reach, notes }: Described) -> Self {
        Self { description: scene, reach, compiled: Mutex::new(None), notes }
    }

    /// Refuses a frame that the scene does not have.
    pub fn check_frame(&self, frame: u32) -> PyResult<()> {
        let frames = self.description.frames;
        if frame < frames {
            return Ok(());
        }
        Err(PyIndexError::new_err(format!("frame {frame} of a scene with {frames} frames")))
    }

    /// Does `work` with the compiled scene at frame `frame`. Other threads that want this scene wait.
    ///
    /// # Errors
    /// When the scene cannot be loaded, and what `work` returns.
    pub fn at<T>(&self, frame: u32, work: impl FnOnce(&mut Compiled) -> anyhow::Result<T>) -> anyhow::Result<T> {
        let mut compiled = self.compiled.lock().unwrap_or_else(PoisonError::into_inner);
        if compiled.is_none() {
            let loaded = renderflow_scenes::load::load(&self.description, &self.reach)?;
            *compiled = Some(Compiled { scene: RenderScene::compile(&loaded)?, lighting: None });
        }
        let Some(compiled) = compiled.as_mut() else { anyhow::bail!("the scene was not compiled") };
        compiled.scene.set_frame(frame as usize);
        work(compiled)
    }
}

#[pymethods]
impl Scene {
    /// Number of frames.
    #[getter]
    fn frames(&self) -> u32 {
        self.description.frames
    }

    /// Columns and rows of its pictures.
    #[getter]
    fn resolution(&self) -> (u32, u32) {
        let [width, height] = self.description.resolution;
        (width, height)
    }

    /// Seed of its random numbers.
    #[getter]
    fn seed(&self) -> u64 {
        self.description.seed
    }

    /// BLAKE3 of its description. Equal scenes have equal hashes.
    #[getter]
    fn hash(&self) -> String {
        self.description.hash()
    }

    /// Its description as JSON.
    fn to_json(&self) -> String {
        self.description.canonical_json()
    }

    /// Its description as JSON, for a scene file in `folder`. Names of files that do not start from there become full paths.
    fn json_in(&self, folder: PathBuf) -> PyResult<String> {
        let [there, here] = [folder.as_path(), self.reach.base()].map(|folder| std::path::absolute(folder).ok());
        if there.is_some() && there == here {
            return Ok(self.to_json());
        }
        let scene = with_absolute_paths(&self.description, self.reach.base()).map_err(failed)?;
        Ok(scene.canonical_json())
    }

    fn __repr__(&self) -> String {
        let description::Scene { resolution: [width, height], frames, seed, objects, .. } = &self.description;
        let plural = if *frames == 1 { "" } else { "s" };
        format!("<renderflow.Scene {width}x{height}, {frames} frame{plural}, {} objects, seed {seed}>", objects.len())
    }
}

/// The scene of a description in JSON. Relative paths in it start from `folder`, and it may name files there and in `allowed`.
#[pyfunction]
pub fn describe(json: &str, folder: PathBuf, allowed: Vec<PathBuf>) -> PyResult<Scene> {
    let scene = description::Scene::from_json(Path::new("description"), json).map_err(failed)?;
    Ok(Scene::new(Described { scene, reach: Reach::folder(folder).allow(allowed), notes: Vec::new() }))
}

/// Composes a scene from a seed.
#[pyfunction]
pub fn compose(py: Python<'_>, seed: u64, resolution: [u32; 2], frames: u32) -> PyResult<Scene> {
    let source = SceneSource { seed: Some(seed), resolution: Some(resolution), frames: Some(frames), ..SceneSource::default() };
    work::run(py, move |_| Ok(Scene::new(source.describe(&[])?)))
}

/// The keyword arguments of `renderflow.load`.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Asked {
    file: PathBuf,
    hdri: Option<String>,
    hdri_rotation: Option<f32>,
    seed: Option<u64>,
    resolution: Option<[u32; 2]>,
    frames: Option<u32>,
    camera: Option<String>,
    cameras: Option<PathBuf>,
    animation: Option<String>,
    allowed: Vec<PathBuf>,
    set: Vec<String>,
}

/// The scene in a file, or around a model.
#[pyfunction]
pub fn load(py: Python<'_>, asked: Asked) -> PyResult<Scene> {
    let Asked { file, hdri, hdri_rotation, seed, resolution, frames, camera, cameras, animation, allowed, set } = asked;
    let set = set.iter().map(|text| text.parse()).collect::<Result<_, String>>().map_err(PyValueError::new_err)?;
    let camera = camera.map(NameOrNumber::Name);
    let animation = animation.map(|clip| Animation { clip: Some(NameOrNumber::Name(clip)), ..Animation::default() });
    let file = Some(file);
    let source = SceneSource { file, hdri, hdri_rotation, seed, resolution, frames, camera, cameras, animation, set };
    work::run(py, move |_| Ok(Scene::new(source.describe(&allowed)?)))
}
