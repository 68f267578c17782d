//! The fusion network for programs that train it elsewhere: its weights, sequences to learn from, batches of them, and what this
//! program computes for a batch.

use crate::work::{self, failed};
use numpy::{Element, PyArray1, PyArrayMethods, PyReadonlyArrayDyn};
use pyo3::exceptions::{PyIndexError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use renderflow::dataset::learning::kept;
use renderflow_model::fusion::batch::{self, Augmentation, TIERS, Window};
use renderflow_model::fusion::graph::{FusionConfig, MULTIPLE};
use renderflow_model::fusion::head::{self, KERNEL};
use renderflow_model::fusion::loss::LossWeights;
use renderflow_model::fusion::record::{KEYS, NEIGHBOURS, PATHS, PixelInputs, Record, Selection, TERMS};
use renderflow_model::fusion::render::Header;
use renderflow_model::fusion::training::{FusionObjective, gradients, variants};
use renderflow_model::fusion::{Fusion, batch::Batch as Crops};
use renderflow_model::ops::Products;
use renderflow_model::parameters::{self, Parameter};
use renderflow_model::train::Share;
use renderflow_model::train::sequences::Crop;
use renderflow_model::weights::Precision;
use std::collections::HashMap;
use std::path::PathBuf;

/// The values as an array of this shape. Nothing is copied.
fn array<'py, T: Element>(py: Python<'py>, values: Vec<T>, shape: &[usize]) -> PyResult<Bound<'py, PyAny>> {
    Ok(PyArray1::from_vec(py, values).reshape(shape)?.into_any())
}

/// Names and weights of the tiers that are trained.
#[pyfunction]
pub fn tiers() -> Vec<(&'static str, f32)> {
    TIERS.iter().map(|tier| (tier.name, tier.weight)).collect()
}

/// The records of the frames of a sequence, in memory.
#[pyclass(frozen, module = "renderflow")]
pub struct Sequence {
    records: Vec<Record<half::f16>>,
}

#[pymethods]
impl Sequence {
    /// Reads a file that `renderflow train --keep` wrote.
    #[new]
    fn new(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let records = py.detach(|| kept::read(&path)).map_err(failed)?;
        Ok(Self { records })
    }

    fn __len__(&self) -> usize {
        self.records.len()
    }

    /// Columns and rows of the frames.
    #[getter]
    fn sizes(&self) -> Vec<(usize, usize)> {
        self.records.iter().map(|record| (record.width, record.height)).collect()
    }

    /// Names of the combinations of inputs from which frame `frame` can be rendered.
    fn variants(&self, frame: usize) -> PyResult<Vec<String>> {
        Ok(variants(self.record(frame)?, &TIERS).into_iter().map(|(name, _)| name).collect())
    }

    /// The whole frame `frame` with the inputs `variant`, padded on the right and below.
    fn whole(&self, py: Python<'_>, frame: usize, variant: &str) -> PyResult<Batch> {
        let (record, selection) = (self.record(frame)?, self.selection(frame, variant)?);
        let [width, height] = [record.width, record.height].map(|side| side.next_multiple_of(MULTIPLE));
        let window = Window { x: 0, y: 0, width, height };
        Ok(Batch { crops: py.detach(|| Crops::of(record, window, &selection, &Augmentation::NONE)) })
    }
}

impl Sequence {
    fn record(&self, frame: usize) -> PyResult<&Record<half::f16>> {
        let missing = || PyIndexError::new_err(format!("frame {frame} of a sequence of {}", self.records.len()));
        self.records.get(frame).ok_or_else(missing)
    }

    fn selection(&self, frame: usize, variant: &str) -> PyResult<Selection> {
        let found = variants(self.record(frame)?, &TIERS).into_iter().find(|(name, _)| name == variant);
        let unknown = || PyValueError::new_err(format!("frame {frame} cannot be rendered from {variant:?}"));
        found.map(|(_, selection)| selection).ok_or_else(unknown)
    }
}

/// Draws the batch of number `number` of a run with the seed `seed`: `items` crops of `size` x `size` pixels. With no names of
/// tiers, all but `deferred+keys` are drawn.
#[pyfunction]
pub fn draw(
    py: Python<'_>,
    sequences: Vec<Py<Sequence>>,
    tiers: Vec<String>,
    size: usize,
    items: usize,
    seed: u64,
    number: u64,
) -> PyResult<Batch> {
    Crop::check(&[Crop { size, batch: items, from: 0.0 }], MULTIPLE).map_err(|e| PyValueError::new_err(e.to_string()))?;
    let tiers = batch::tiers(&tiers).map_err(|e| PyValueError::new_err(e.to_string()))?;
    let crops = py.detach(|| {
        let records: Vec<&Record<half::f16>> = sequences.iter().flat_map(|sequence| &sequence.get().records).collect();
        Crops::numbered(&records, &tiers, Crop { size, batch: items, from: 0.0 }, Share::WHOLE, [seed, number])
    });
    Ok(Batch { crops: crops.map_err(failed)? })
}

/// Crops of records, with what the network, its head and the loss read.
#[pyclass(frozen, module = "renderflow")]
pub struct Batch {
    crops: Crops,
}

#[pymethods]
impl Batch {
    /// Name of the tier.
    #[getter]
    fn tier(&self) -> &'static str {
        self.crops.tier()
    }

    /// Which groups are given: deferred, keys, samples, neighbours, denoised, paths.
    #[getter]
    fn groups(&self) -> [bool; 6] {
        let [_, groups @ ..] = self.crops.groups.flags();
        groups
    }

    /// What the network, its head and the loss read, by name, each with the items first.
    fn arrays<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let Crops { items, width, height, groups, input, pixels, truth, raw } = &self.crops;
        let arrays = PyDict::new(py);
        let add = |name: &str, values: Vec<f32>, shape: &[usize]| {
            let shape = [&[*items, *height, *width], shape].concat();
            arrays.set_item(name, array(py, values, &shape)?)
        };
        let of = |field: fn(&PixelInputs) -> &[f32]| py.detach(|| pixels.iter().flat_map(field).copied().collect());
        add("alpha", of(|pixel| std::slice::from_ref(&pixel.alpha)), &[])?;
        add("background", of(|pixel| &pixel.background), &[3])?;
        add("tint", of(|pixel| &pixel.tint), &[3])?;
        add("truth", truth.as_flattened().to_vec(), &[3])?;
        add("raw", raw.as_flattened().to_vec(), &[3])?;
        if groups.deferred {
            add("terms", of(|pixel| pixel.terms.as_flattened()), &[TERMS, 3])?;
        }
        if groups.keys {
            add("keys", of(|pixel| pixel.keys.as_flattened()), &[KEYS, 3])?;
            add("trust", of(|pixel| &pixel.trust), &[KEYS])?;
        }
        if groups.samples {
            add("own", of(|pixel| &pixel.own), &[4])?;
            add("reflected", of(|pixel| &pixel.reflected), &[3])?;
        }
        if groups.paths {
            add("paths", of(|pixel| &pixel.paths), &[PATHS])?;
        }
        if groups.neighbours {
            add("others", of(|pixel| pixel.others.as_flattened()), &[NEIGHBOURS, 4])?;
            if groups.paths {
                add("others_indirect", of(|pixel| pixel.others_indirect.as_flattened()), &[NEIGHBOURS, 3])?;
            }
        }
        if groups.denoised {
            add("denoised", of(|pixel| pixel.denoised.as_ref().map_or(&[0.0; 3], |rgb| rgb)), &[3])?;
        }
        let shape = [*items, height / 2, width / 2, 4 * groups.channels()];
        arrays.set_item("input", array(py, input.clone(), &shape)?)?;
        Ok(arrays)
    }
}

/// Outputs of the network at half and at quarter size, and pictures.
type Outputs<'py> = (Bound<'py, PyAny>, Option<Bound<'py, PyAny>>, Bound<'py, PyAny>);

/// The fusion network with its weights. It multiplies in single precision on every processor, as PyTorch does.
#[pyclass(frozen, module = "renderflow")]
pub struct Network {
    network: Fusion,
}

impl Network {
    fn new(network: renderflow_model::Result<Fusion>) -> PyResult<Self> {
        Ok(Self { network: network.map_err(failed)?.with_products(Products::F32) })
    }
}

/// The header of a network of the configuration `config`, which is JSON as in configurations of training.
fn header(config: &str, steps: u64, seed: u64) -> PyResult<Header> {
    let fusion: FusionConfig = serde_json::from_str(config).map_err(|error| PyValueError::new_err(error.to_string()))?;
    Ok(Header { fusion, steps, seed })
}

#[pymethods]
impl Network {
    /// Reads a weights file; `None` takes the weights inside the program.
    #[staticmethod]
    fn load(path: Option<PathBuf>) -> PyResult<Self> {
        Self::new(path.map_or_else(Fusion::shipped, |path| Fusion::load(&path)))
    }

    /// Random weights, which the program begins with in a run with this seed.
    #[staticmethod]
    fn untrained(config: &str, seed: u64) -> PyResult<Self> {
        Self::new(Fusion::fresh(header(config, 0, seed)?))
    }

    /// The network with the parameters in arrays, whose names and shapes must be those of [`Self::parameters`].
    #[staticmethod]
    fn of(config: &str, steps: u64, seed: u64, arrays: HashMap<String, PyReadonlyArrayDyn<'_, f32>>) -> PyResult<Self> {
        let fresh = Fusion::fresh(header(config, steps, seed)?).map_err(failed)?;
        let mut parameters = Vec::new();
        for Parameter { name, shape, .. } in fresh.parameters() {
            let array = arrays.get(&name).ok_or_else(|| PyValueError::new_err(format!("{name}: missing")))?;
            let found = array.as_array().shape().to_vec();
            if found != shape {
                return Err(PyValueError::new_err(format!("{name}: shape {found:?} where {shape:?} is expected")));
            }
            parameters.push(Parameter { values: array.as_array().iter().copied().collect(), name, shape });
        }
        if let Some(extra) = arrays.keys().find(|name| parameters.iter().all(|parameter| parameter.name != **name)) {
            return Err(PyValueError::new_err(format!("{extra}: no parameter of this network")));
        }
        Self::new(Fusion::with_parameters(fresh.header().clone(), &parameters))
    }

    /// Size of the network, in JSON as in configurations of training.
    #[getter]
    fn config(&self) -> String {
        serde_json::to_string(&self.network.header().fusion).expect("numbers and names")
    }

    /// Number of training steps.
    #[getter]
    fn steps(&self) -> u64 {
        self.network.header().steps
    }

    /// Seed of the training run.
    #[getter]
    fn seed(&self) -> u64 {
        self.network.header().seed
    }

    /// The parameters by name. Kernels of convolutions have the shape (rows, columns, inputs, outputs).
    fn parameters<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let arrays = PyDict::new(py);
        for Parameter { name, shape, values } in self.network.parameters() {
            arrays.set_item(name, array(py, values, &shape)?)?;
        }
        Ok(arrays)
    }

    /// Writes a weights file in half or single precision.
    fn save(&self, path: PathBuf, half: bool) -> PyResult<()> {
        self.network.save(&path, if half { Precision::F16 } else { Precision::F32 }).map_err(failed)
    }

    /// What this program computes for a batch: the outputs of the network at half and at quarter size, and the pictures.
    fn outputs<'py>(&self, py: Python<'py>, batch: &Batch) -> PyResult<Outputs<'py>> {
        let Crops { items, width, height, groups, .. } = batch.crops;
        let drawn = work::run(py, |_| Ok(self.network.draw_batch(batch.crops.clone())?))?;
        let fine = head::fine(groups);
        let coarse = groups.samples.then(|| array(py, drawn.coarse, &[items, height / 4, width / 4, KERNEL])).transpose()?;
        Ok((
            array(py, drawn.fine, &[items, height / 2, width / 2, fine])?,
            coarse,
            array(py, drawn.pixels.into_flattened(), &[items, height, width, 3])?,
        ))
    }

    /// The picture of a frame as this program renders it with the device cpu:f32, (height, width, 3), exposed and linear.
    fn picture<'py>(&self, py: Python<'py>, sequence: &Sequence, frame: usize, variant: &str) -> PyResult<Bound<'py, PyAny>> {
        let (record, selection) = (sequence.record(frame)?, sequence.selection(frame, variant)?);
        let drawn = work::run(py, |_| Ok(self.network.draw(record, &selection)?))?;
        array(py, drawn.into_flattened(), &[record.height, record.width, 3])
    }

    /// The loss of a batch and its gradients by name, as a training step of this program computes them in single precision.
    fn gradients<'py>(&self, py: Python<'py>, batch: &Batch, weights: [f32; 4]) -> PyResult<(f32, Bound<'py, PyDict>)> {
        let [psnr, display, log, gradient] = weights;
        let loss = LossWeights { psnr, display, log, gradient, lpips: 0.0 };
        let objective = FusionObjective { loss, lpips: None, products: Products::F32 };
        let (loss, gradients) = work::run(py, |_| {
            let step = gradients(&self.network, batch.crops.clone(), objective)?;
            Ok((step.total, parameters::read_gradients(step.gradients)?))
        })?;
        let arrays = PyDict::new(py);
        for (Parameter { name, shape, values }, gradient) in self.network.parameters().into_iter().zip(gradients) {
            arrays.set_item(name, array(py, gradient.unwrap_or_else(|| vec![0.0; values.len()]), &shape)?)?;
        }
        Ok((loss, arrays))
    }
}
