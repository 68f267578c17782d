//! Pictures and frames as numpy arrays, and back.

use numpy::{PyArray1, PyArrayMethods, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use renderflow_frame::Frame;
use renderflow_frame::channel::{LAYERS, Values};
use renderflow_frame::compact::layer_name;
use renderflow_frame::image::{Image, Rgb};

/// The picture as an array `[height, width, 3]`. Nothing is copied.
pub fn rgb(py: Python<'_>, picture: Rgb) -> PyResult<Bound<'_, PyAny>> {
    let shape = [picture.height, picture.width, 3];
    Ok(PyArray1::from_vec(py, picture.pixels.into_flattened()).reshape(shape)?.into_any())
}

/// The values of a layer as an array `[height, width]`, with a third axis where a pixel has several. Nothing is copied.
fn values(py: Python<'_>, values: Values) -> PyResult<Bound<'_, PyAny>> {
    Ok(match values {
        Values::Rgb(picture) => rgb(py, picture)?,
        Values::Vec2(Image { width, height, pixels }) => {
            PyArray1::from_vec(py, pixels.into_flattened()).reshape([height, width, 2])?.into_any()
        }
        Values::Scalar(Image { width, height, pixels }) => PyArray1::from_vec(py, pixels).reshape([height, width])?.into_any(),
        Values::Id(Image { width, height, pixels }) => PyArray1::from_vec(py, pixels).reshape([height, width])?.into_any(),
    })
}

/// The layers of a frame by name, and its header as JSON.
pub fn frame<'py>(py: Python<'py>, mut frame: Frame) -> PyResult<(Bound<'py, PyDict>, String)> {
    let layers = PyDict::new(py);
    for layer in LAYERS {
        // A compact frame of which some layers were read has no pixels in the others.
        match layer.take(&mut frame) {
            Some(taken) if !is_empty(&taken) || frame.width * frame.height == 0 => {
                layers.set_item(layer_name(layer), values(py, taken)?)?;
            }
            _ => {}
        }
    }
    Ok((layers, serde_json::to_string(&frame.info).unwrap_or_default()))
}

fn is_empty(values: &Values) -> bool {
    match values {
        Values::Rgb(image) => image.pixels.is_empty(),
        Values::Vec2(image) => image.pixels.is_empty(),
        Values::Scalar(image) => image.pixels.is_empty(),
        Values::Id(image) => image.pixels.is_empty(),
    }
}

/// The picture in an array `[height, width, 3]`.
pub fn picture(array: &PyReadonlyArray3<'_, f32>) -> PyResult<Rgb> {
    let &[height, width, channels] = array.shape() else { return Err(PyValueError::new_err("an array of three axes is needed")) };
    if channels != 3 {
        return Err(PyValueError::new_err(format!("an array of shape (height, width, 3) is needed, not (.., .., {channels})")));
    }
    let (pixels, _) = array.as_slice()?.as_chunks::<3>();
    Ok(Rgb { width, height, pixels: pixels.to_vec() })
}

/// The numbers in an array `[height, width]`.
pub fn scalars(array: &PyReadonlyArray2<'_, f32>) -> PyResult<Image<f32>> {
    let &[height, width] = array.shape() else { return Err(PyValueError::new_err("an array of two axes is needed")) };
    Ok(Image { width, height, pixels: array.as_slice()?.to_vec() })
}

/// Names of all layers that a frame can have.
pub fn names() -> impl Iterator<Item = String> {
    LAYERS.iter().map(|layer| layer_name(layer).to_owned())
}
