//! The network, and OIDN.

use crate::arrays;
use crate::render::shaded;
use crate::scene::Scene;
use crate::work::{self, failed};
use numpy::PyReadonlyArray3;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use renderflow::dataset::job::TruthSettings;
use renderflow_frame::frame_file::Profile;
use renderflow_frame::image::Rgb;
use renderflow_model::device::{DeviceChoice, NetworkDevice};
use renderflow_model::fusion::{Fusion, Record};
use renderflow_renderer::Settings;
use renderflow_renderer::denoise::{self as oidn, Denoiser, Options, Quality};
use std::path::PathBuf;
use std::sync::Arc;

/// The network that reads a G-buffer, deferred shading, and traced samples.
#[pyclass(frozen, module = "renderflow")]
pub struct Neural {
    network: Arc<Fusion>,
}

#[pymethods]
impl Neural {
    /// Reads weights; `None` takes those inside the program. `device` is where the network runs.
    #[new]
    #[pyo3(signature = (weights=None, device="cpu"))]
    fn new(weights: Option<PathBuf>, device: &str) -> PyResult<Self> {
        let choice: DeviceChoice =
            device.parse().map_err(|reason| PyValueError::new_err(format!("device {device}: {reason}")))?;
        let network = weights.map_or_else(Fusion::shipped, |path| Fusion::load(&path));
        let network = network.and_then(|network| network.to(&NetworkDevice::open(choice)?));
        Ok(Self { network: Arc::new(network.map_err(failed)?) })
    }

    /// Number of parameters.
    #[getter]
    fn parameters(&self) -> usize {
        self.network.parameters().iter().map(|parameter| parameter.values.len()).sum()
    }

    /// The picture of frame `frame` from `rays` samples per pixel, or from deferred shading where that is 0.
    #[pyo3(name = "_render")]
    fn render<'py>(
        &self,
        py: Python<'py>,
        scene: &Scene,
        frame: u32,
        rays: u32,
        denoiser: Option<&str>,
    ) -> PyResult<Bound<'py, PyAny>> {
        scene.check_frame(frame)?;
        let denoiser = denoiser.map(quality).transpose()?;
        let picture = work::run(py, |cancel| {
            scene.at(frame, |compiled| {
                if rays == 0 {
                    let exposure = compiled.scene.exposure();
                    let (gbuffer, shaded) = shaded(compiled, cancel)?;
                    let mut record = Record::of(&gbuffer, &shaded.surfaces, exposure);
                    record.add_deferred(&shaded.terms, exposure);
                    let pixels = self.network.render(&record)?.into_iter().map(|rgb| rgb.map(|v| v / exposure)).collect();
                    return Ok(Rgb { width: record.width, height: record.height, pixels });
                }
                let oidn =
                    denoiser.map(|quality| Denoiser::with_options(Options { quality, ..Options::default() })).transpose()?;
                let settings = Settings { spp: rays, ..Settings::default() };
                let truth = TruthSettings::with_network(settings, Arc::clone(&self.network), oidn);
                truth.ensure_memory(&compiled.scene, Profile::Full)?;
                let (frame, _) = truth.frame(&compiled.scene, &|_, _| (), cancel)?;
                anyhow::Context::context(frame.beauty, "the renderer made no picture")
            })
        })?;
        arrays::rgb(py, picture)
    }
}

fn quality(name: &str) -> PyResult<Quality> {
    Ok(match name {
        "fast" => Quality::Fast,
        "high" => Quality::High,
        _ => return Err(PyValueError::new_err(format!("quality: {name:?} is none of 'fast' and 'high'"))),
    })
}

/// Denoises a picture with OIDN.
#[pyfunction]
#[pyo3(signature = (color, albedo, normal, quality, clean_guides))]
pub fn denoise<'py>(
    py: Python<'py>,
    color: PyReadonlyArray3<'py, f32>,
    albedo: Option<PyReadonlyArray3<'py, f32>>,
    normal: Option<PyReadonlyArray3<'py, f32>>,
    quality: &str,
    clean_guides: bool,
) -> PyResult<Bound<'py, PyAny>> {
    let options = Options { quality: self::quality(quality)?, clean_guides };
    let color = arrays::picture(&color)?;
    let [albedo, normal] = [albedo, normal].map(|guide| guide.map(|guide| arrays::picture(&guide)).transpose());
    let (albedo, normal) = (albedo?, normal?);
    let denoised = work::run(py, |cancel| {
        let mut denoiser = Denoiser::with_options(options)?;
        Ok(denoiser.denoise_until(&color, albedo.as_ref(), normal.as_ref(), cancel)?)
    })?;
    arrays::rgb(py, denoised)
}

/// Where the library of OIDN was found; `None` where it was not.
#[pyfunction]
pub fn denoiser() -> Option<PathBuf> {
    oidn::library().ok().map(Into::into)
}
