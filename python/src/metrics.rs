//! Comparisons of two pictures of display values in 0..=1.

use crate::arrays::{picture, scalars};
use crate::work::{self, failed};
use numpy::{PyReadonlyArray2, PyReadonlyArray3};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use renderflow::metrics::flip::{Seen, Viewing};
use renderflow::metrics::psnr as psnrs;
use renderflow::metrics::relmse::same_size;
use renderflow::metrics::ssim::ssim_map;
use renderflow_frame::image::{Image, Rgb};
use renderflow_model::lpips::{self, Backbone};
use std::path::PathBuf;

type Picture<'py> = PyReadonlyArray3<'py, f32>;
type Mask<'py> = Option<PyReadonlyArray2<'py, f32>>;

fn pair(a: &Picture<'_>, b: &Picture<'_>, mask: Option<&PyReadonlyArray2<'_, f32>>) -> PyResult<(Rgb, Rgb, Option<Image<f32>>)> {
    let (a, b, mask) = (picture(a)?, picture(b)?, mask.map(scalars).transpose()?);
    same_size(&a, &b).map_err(|error| PyValueError::new_err(error.to_string()))?;
    if a.pixels.is_empty() {
        return Err(PyValueError::new_err(format!("pictures with pixels are needed, not {} x {}", a.width, a.height)));
    }
    if let Some(mask) = mask.as_ref().filter(|mask| (mask.width, mask.height) != (a.width, a.height)) {
        let reason = format!("the mask has {} x {} pixels, the pictures {} x {}", mask.width, mask.height, a.width, a.height);
        return Err(PyValueError::new_err(reason));
    }
    Ok((a, b, mask))
}

fn defined(value: Option<f64>, needed: &str) -> PyResult<f64> {
    value.ok_or_else(|| PyValueError::new_err(format!("{needed} is needed")))
}

/// PSNR in dB.
#[pyfunction]
#[pyo3(signature = (a, b, mask))]
pub fn psnr(py: Python<'_>, a: Picture<'_>, b: Picture<'_>, mask: Mask<'_>) -> PyResult<f64> {
    let (a, b, mask) = pair(&a, &b, mask.as_ref())?;
    let value = py.detach(|| match &mask {
        Some(mask) => psnrs::psnr_masked(&a, &b, mask),
        None => Some(psnrs::psnr(&a, &b)),
    });
    defined(value, "a mask with a value above 0")
}

/// SSIM.
#[pyfunction]
#[pyo3(signature = (a, b, mask))]
pub fn ssim(py: Python<'_>, a: Picture<'_>, b: Picture<'_>, mask: Mask<'_>) -> PyResult<f64> {
    let (a, b, mask) = pair(&a, &b, mask.as_ref())?;
    let map = py.detach(|| ssim_map(&a, &b));
    let value = map.and_then(|map| mask.map_or(Some(map.mean), |mask| map.masked(&mask)));
    defined(value, "a picture of at least 11 x 11 pixels, and a window inside the mask,")
}

/// FLIP.
#[pyfunction]
#[pyo3(signature = (a, b, mask))]
pub fn flip(py: Python<'_>, a: Picture<'_>, b: Picture<'_>, mask: Mask<'_>) -> PyResult<f64> {
    let (a, b, mask) = pair(&a, &b, mask.as_ref())?;
    let seen = |picture| Seen::new(picture, Viewing::default());
    let map = py.detach(|| seen(&a)?.compare(&seen(&b)?));
    let value = map.and_then(|map| mask.map_or(Some(map.mean), |mask| map.masked(&mask)));
    defined(value, "a picture with pixels, and a mask with a value above 0,")
}

/// LPIPS with the weights of a folder.
#[pyclass(frozen, module = "renderflow")]
pub struct Lpips {
    network: lpips::Lpips,
}

#[pymethods]
impl Lpips {
    /// Reads `lpips_alex.safetensors` or `lpips_squeeze.safetensors` in `folder`.
    #[new]
    fn new(folder: PathBuf, net: &str) -> PyResult<Self> {
        let backbone = match net {
            "alex" => Backbone::Alex,
            "squeeze" => Backbone::Squeeze,
            _ => return Err(PyValueError::new_err(format!("net: {net:?} is none of 'alex' and 'squeeze'"))),
        };
        Ok(Self { network: lpips::Lpips::load(&folder, backbone).map_err(failed)? })
    }

    fn __call__(&self, py: Python<'_>, a: Picture<'_>, b: Picture<'_>) -> PyResult<f64> {
        let (a, b, _) = pair(&a, &b, None)?;
        work::run(py, |_| Ok(f64::from(self.network.distance(&a, &b)?)))
    }
}
