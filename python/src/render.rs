//! Pictures of scenes, and frames in files.

use crate::arrays;
use crate::scene::{Compiled, Scene};
use crate::work::{self, failed};
use pyo3::exceptions::{PyKeyError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyAny, PyDict};
use renderflow::dataset::denoise::Denoise;
use renderflow::dataset::job::TruthSettings;
use renderflow::util::cancel::Cancel;
use renderflow_frame::Frame;
use renderflow_frame::frame_file::Profile;
use renderflow_frame::{compact, frame_file, words};
use renderflow_model::device::NetworkDevice;
use renderflow_renderer::deferred::{Deferred, Options, shade, shadow_maps};
use renderflow_renderer::{RenderScene, Settings, render_gbuffer_until};
use serde_json::Value;
use std::path::Path;

type Layers<'py> = (Bound<'py, PyDict>, String);

/// The settings of the renderer with the values that `json` names.
pub fn settings(json: &str) -> PyResult<Settings> {
    let named: Value = serde_json::from_str(json).map_err(failed)?;
    let mut all = serde_json::to_value(Settings::default()).map_err(failed)?;
    for (name, value) in named.as_object().into_iter().flatten() {
        let Some(place) = all.get_mut(name) else {
            return Err(PyValueError::new_err(format!("{name} is no setting of the renderer")));
        };
        *place = value.clone();
        if let Err(error) = serde_json::from_value::<Settings>(all.clone()) {
            return Err(PyValueError::new_err(format!("{name}: {}", words::plain(&error.to_string()))));
        }
    }
    serde_json::from_value(all).map_err(|error| PyValueError::new_err(error.to_string()))
}

/// Path-traces frame `frame`.
#[pyfunction]
pub fn render<'py>(
    py: Python<'py>,
    scene: &Scene,
    frame: u32,
    options: &str,
    denoiser: &str,
    distance: bool,
) -> PyResult<Layers<'py>> {
    scene.check_frame(frame)?;
    let mode: Denoise = serde_json::from_value(Value::from(denoiser)).map_err(|_| unknown(denoiser))?;
    let options = settings(options)?;
    if options.spp == 0 {
        return Err(PyValueError::new_err("spp must be at least 1; gbuffer renders without samples"));
    }
    let rendered = work::run(py, |cancel| {
        let mut truth = TruthSettings::quiet(options, mode)?;
        truth.distance = distance;
        scene.at(frame, |compiled| {
            truth.ensure_memory(&compiled.scene, Profile::Full)?;
            Ok(truth.frame(&compiled.scene, &|_, _| (), cancel)?.0)
        })
    })?;
    arrays::frame(py, rendered)
}

fn unknown(denoiser: &str) -> PyErr {
    PyValueError::new_err(format!("denoise: {denoiser:?} is none of 'auto', 'oidn', 'neural' and 'none'"))
}

/// Makes the G-buffer of frame `frame`, without a beauty.
#[pyfunction]
pub fn gbuffer<'py>(py: Python<'py>, scene: &Scene, frame: u32, options: &str) -> PyResult<Layers<'py>> {
    scene.check_frame(frame)?;
    let options = settings(options)?;
    let made = work::run(py, |cancel| scene.at(frame, |compiled| features(&compiled.scene, &options, cancel)))?;
    arrays::frame(py, made)
}

/// The G-buffer of the frame at which `scene` stands.
fn features(scene: &RenderScene, options: &Settings, cancel: &Cancel) -> anyhow::Result<Frame> {
    TruthSettings::new(Settings { spp: 0, ..*options }, Denoise::None, &NetworkDevice::cpu())?
        .ensure_memory(scene, Profile::Full)?;
    let made = render_gbuffer_until(scene, options, cancel);
    cancel.check()?;
    Ok(made?)
}

/// The G-buffer and the deferred picture of the frame at which `scene` stands.
///
/// # Errors
/// When stopped, or when the G-buffer cannot be made.
pub fn shaded(scene: &mut Compiled, cancel: &Cancel) -> anyhow::Result<(Frame, Deferred)> {
    let lighting = scene.lighting();
    let gbuffer = features(&scene.scene, &Settings::default(), cancel)?;
    let shadows = shadow_maps(&scene.scene, &lighting, &gbuffer);
    let shaded = shade(&gbuffer, &lighting, &shadows, &Options::default());
    Ok((gbuffer, shaded))
}

/// Shades frame `frame` as a game engine would.
#[pyfunction]
pub fn deferred<'py>(py: Python<'py>, scene: &Scene, frame: u32) -> PyResult<Bound<'py, PyAny>> {
    scene.check_frame(frame)?;
    let picture = work::run(py, |cancel| scene.at(frame, |compiled| Ok(shaded(compiled, cancel)?.1.image)))?;
    arrays::rgb(py, picture)
}

/// Decodes the bytes of a frame file. `names` selects layers.
#[pyfunction]
#[pyo3(signature = (name, bytes, names))]
pub fn decode_frame<'py>(py: Python<'py>, name: &str, bytes: &[u8], names: Option<Vec<String>>) -> PyResult<Layers<'py>> {
    let name = Path::new(name);
    let known: Vec<String> = arrays::names().collect();
    if let Some(unknown) = names.iter().flatten().find(|name| !known.contains(name)) {
        return Err(PyKeyError::new_err(format!("{unknown}: no frame has such a layer; there are {}", known.join(", "))));
    }
    let decoded = py.detach(|| match &names {
        Some(names) if bytes.starts_with(&compact::SIGNATURE) => {
            let names: Vec<&str> = names.iter().map(String::as_str).collect();
            compact::decode_layers(name, bytes, &names)
        }
        _ => frame_file::decode(name, bytes),
    });
    let (layers, info) = arrays::frame(py, decoded.map_err(failed)?)?;
    if let Some(names) = names {
        for found in layers.keys() {
            if !names.contains(&found.extract()?) {
                layers.del_item(found)?;
            }
        }
        if let Some(missing) = names.iter().find(|name| !layers.contains(name.as_str()).unwrap_or(false)) {
            return Err(PyKeyError::new_err(format!("{missing}: the frame does not have this layer")));
        }
    }
    Ok((layers, info))
}
