//! Inference: a record in, scene-linear radiance out.

use super::batch::{Batch, Change, Window};
use super::graph::{FusionConfig, FusionNet, MULTIPLE, Outputs};
use super::record::{Chosen, Record};
use crate::ops::Products;
use crate::parameters::{self, Parameter, to_vec};
use crate::weights::{self, Precision};
use crate::{Error, Result};
use burn::tensor::{Device, Tensor, TensorData};
use half::f16;
use renderflow_frame::file;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// What a weights file says about itself.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Header {
    /// The network.
    pub fusion: FusionConfig,
    /// Steps of training behind the weights; 0 = untrained.
    pub steps: u64,
    /// Seed of the run.
    pub seed: u64,
}

/// Most bytes of a weights file: some 400 times those of the default network in half precision.
const LARGEST: u64 = 1 << 30;

/// The network, ready to render. Results depend on the inputs only: never on threads, runs or earlier calls.
#[derive(Clone, Debug)]
pub struct Fusion {
    network: FusionNet,
    header: Header,
    products: Products,
    device: Device,
}

impl Fusion {
    /// An untrained network: it gives the best picture that it is handed.
    ///
    /// # Errors
    /// When the configuration is invalid.
    pub fn untrained(config: &FusionConfig, seed: u64) -> Result<Self> {
        let device = Device::flex();
        let header = Header { fusion: config.clone(), steps: 0, seed };
        Ok(Self { network: FusionNet::new(config, seed, &device)?, header, products: Products::F32, device })
    }

    /// With these parameters, in the order of the network's own.
    ///
    /// # Errors
    /// When the configuration is invalid.
    pub fn with_parameters(header: Header, parameters: &[Parameter]) -> Result<Self> {
        let device = Device::flex();
        let network = FusionNet::new(&header.fusion, header.seed, &device)?;
        let values: Vec<&[f32]> = parameters.iter().map(|parameter| parameter.values.as_slice()).collect();
        Ok(Self { network: parameters::import(network, &values, &device), header, products: Products::F32, device })
    }

    /// The same network, multiplying in this way.
    pub fn by(self, products: Products) -> Self {
        Self { products, ..self }
    }

    /// Whether the file at `path` says that it holds weights of this network.
    pub fn recognises(path: &Path) -> bool {
        let bytes = file::read_at_most(path, LARGEST);
        bytes.is_ok_and(|bytes| {
            weights::open(path, &bytes).is_ok_and(|(_, header)| serde_json::from_str::<Header>(&header).is_ok())
        })
    }

    /// Reads a weights file.
    ///
    /// # Errors
    /// When it cannot be read, or is not one of this network.
    pub fn load(path: &Path) -> Result<Self> {
        let bytes = file::read_at_most(path, LARGEST).map_err(Error::unreadable)?;
        Self::decode(path, &bytes)
    }

    /// Decodes a weights file; `path` names it in messages.
    ///
    /// # Errors
    /// When the bytes are no weights of this network.
    pub fn decode(path: &Path, bytes: &[u8]) -> Result<Self> {
        let (tensors, header) = weights::open(path, bytes)?;
        let header: Header = serde_json::from_str(&header).map_err(|e| Error::malformed(path, e.to_string()))?;
        header.fusion.validate().map_err(|e| Error::malformed(path, format!("header: {e}")))?;
        // The network is made before its tensors are compared: a short header could ask for much memory.
        let (values, most) = (header.fusion.values(), bytes.len() / 2);
        if values > most {
            let reason = format!("the network its header describes has {values} values; {most} at most are in the file");
            return Err(Error::malformed(path, reason));
        }
        let fresh = parameters::export(&FusionNet::new(&header.fusion, header.seed, &Device::flex())?);
        let read = |parameter: Parameter| -> Result<Parameter> {
            let values = weights::read_tensor(path, &tensors, &parameter.name, &parameter.shape)?;
            Ok(Parameter { values, ..parameter })
        };
        Self::with_parameters(header, &fresh.into_iter().map(read).collect::<Result<Vec<_>>>()?)
    }

    /// Its parameters on the host.
    pub fn parameters(&self) -> Vec<Parameter> {
        parameters::export(&self.network)
    }

    /// What the network is.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// Exposed linear radiance of the frame of `record`, from all that it has.
    ///
    /// # Errors
    /// When the record is empty.
    pub fn render(&self, record: &Record<f32>) -> Result<Vec<[f32; 3]>> {
        self.draw(record, &Chosen::all(record))
    }

    /// [`Self::render`] from a part of what the record has.
    ///
    /// # Errors
    /// When the record is empty.
    pub fn draw<T: super::batch::Stored>(&self, record: &Record<T>, chosen: &Chosen) -> Result<Vec<[f32; 3]>> {
        let (width, height) = (record.width, record.height);
        if width == 0 || height == 0 {
            return Err(Error::Data { place: "frame".into(), reason: format!("has {width} x {height} pixels") });
        }
        let window = Window { x: 0, y: 0, width: width.next_multiple_of(MULTIPLE), height: height.next_multiple_of(MULTIPLE) };
        let mut batch = Batch::of(record, window, chosen, &Change::NONE);
        let outputs = forward(&self.network, self.products, &mut batch, &self.device);
        let fine = to_vec(outputs.fine);
        let coarse = outputs.coarse.map(to_vec).unwrap_or_default();
        let (drawn, _) = batch.picture(0, &fine, &coarse).draw();
        Ok(drawn.chunks_exact(window.width).take(height).flat_map(|row| row[..width].iter().copied()).collect())
    }
}

/// Runs the network on a batch, whose input it takes.
pub(super) fn forward(network: &FusionNet, products: Products, batch: &mut Batch, device: &Device) -> Outputs {
    let shape = [batch.items, batch.height / 2, batch.width / 2, 4 * batch.groups.channels()];
    let input = Tensor::from_data(TensorData::new(std::mem::take(&mut batch.input), shape), device);
    network.forward(products, input, batch.groups)
}

/// Bytes of a weights file.
///
/// # Errors
/// When a value is not finite.
pub fn encode(header: &Header, parameters: &[Parameter], precision: Precision) -> Result<Vec<u8>> {
    let header = serde_json::to_string(header).map_err(|e| Error::malformed("weights to be written", e.to_string()))?;
    weights::encode_with(&header, parameters, precision)
}

/// A record in half precision is read as one in single precision is, up to rounding.
pub fn as_single(record: &Record<f16>) -> Record<f32> {
    let mut single = Record::new(record.width, record.height);
    <f16 as super::batch::Stored>::read(&record.pixels, &mut single.pixels);
    Record {
        pixels: single.pixels,
        width: record.width,
        height: record.height,
        deferred: record.deferred,
        distances: record.distances,
        parts: record.parts,
        neighbours: record.neighbours,
    }
}
