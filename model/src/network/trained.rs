//! A network with its weights, and the file that holds them. The header of the file says what network it is.

use crate::device::NetworkDevice;
use crate::ops::Products;
use crate::parameters::{self, Parameter};
use crate::weights::{self, Precision};
use crate::{Error, Result};
use burn::module::Module;
use burn::tensor::Device;
use renderflow_frame::file;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::fmt::Debug;
use std::path::Path;

/// Most bytes of a weights file: more than a hundred times the largest of the default networks in half precision.
const LARGEST: u64 = 1 << 30;

/// A network that the header of its weights file describes.
pub trait Described: Module + Debug {
    /// The header: the configuration of the network, and how it was trained. Headers of other networks do not parse.
    type Header: Serialize + DeserializeOwned + Clone + PartialEq + Debug + Send + Sync;

    /// Checks the configuration.
    ///
    /// # Errors
    /// [`Error::Config`] naming the option.
    fn check(header: &Self::Header) -> Result<()>;
    /// Number of values in all parameters.
    fn values(header: &Self::Header) -> usize;
    /// A network of this configuration with random weights.
    ///
    /// # Errors
    /// When the configuration is invalid.
    fn fresh(header: &Self::Header, device: &Device) -> Result<Self>;
    /// The bytes of the weights file inside the program; `None` when this build has none.
    fn shipped() -> Option<&'static [u8]>;
}

/// A network, ready to use. Results depend on the inputs alone, and not on threads, runs or earlier calls.
#[derive(Clone, Debug)]
pub struct Trained<N: Described> {
    pub(crate) network: N,
    header: N::Header,
    pub(crate) products: Products,
    pub(crate) device: NetworkDevice,
}

impl<N: Described> Trained<N> {
    /// The network of `header` with random weights.
    ///
    /// # Errors
    /// When the configuration is invalid.
    pub fn fresh(header: N::Header) -> Result<Self> {
        let device = NetworkDevice::cpu();
        Ok(Self { network: N::fresh(&header, device.device())?, header, products: device.products(), device })
    }

    /// The network with the weights that are built in.
    ///
    /// # Errors
    /// [`Error::NoShippedWeights`] when this build has no weights.
    pub fn shipped() -> Result<Self> {
        Self::decode(Path::new("shipped weights"), N::shipped().ok_or(Error::NoShippedWeights)?)
    }

    /// A network with these parameters, in the order of [`parameters::export`].
    ///
    /// # Errors
    /// When the configuration is invalid.
    pub fn with_parameters(header: N::Header, parameters: &[Parameter]) -> Result<Self> {
        let made = Self::fresh(header)?;
        let values: Vec<&[f32]> = parameters.iter().map(|parameter| parameter.values.as_slice()).collect();
        Ok(Self { network: parameters::import(made.network, &values, made.device.device()), ..made })
    }

    /// The same network with another kind of products in its convolutions than [`NetworkDevice::products`].
    pub fn with_products(self, products: Products) -> Self {
        Self { products, ..self }
    }

    /// The device of the network.
    pub fn device(&self) -> &NetworkDevice {
        &self.device
    }

    /// The same network on another device, with the products of that device.
    ///
    /// # Errors
    /// When the configuration is invalid.
    pub fn to(self, device: &NetworkDevice) -> Result<Self> {
        let network = if self.device.is_cpu() && device.is_cpu() { self.network } else { self.on(device.device())? };
        Ok(Self { network, header: self.header, products: device.products(), device: device.clone() })
    }

    /// Whether the header of the file at `path` is one of this network's weights.
    pub fn recognises(path: &Path) -> bool {
        let bytes = file::read_at_most(path, LARGEST);
        bytes.is_ok_and(|bytes| {
            weights::open(path, &bytes).is_ok_and(|(_, header)| serde_json::from_str::<N::Header>(&header).is_ok())
        })
    }

    /// Reads a weights file.
    ///
    /// # Errors
    /// When the file cannot be read, or does not hold weights of this network.
    pub fn load(path: &Path) -> Result<Self> {
        let bytes = file::read_at_most(path, LARGEST)?;
        Self::decode(path, &bytes)
    }

    /// Decodes the bytes of a weights file. `path` names it in messages.
    ///
    /// # Errors
    /// When the bytes are not weights of this network: when a tensor is missing, left over, of another shape or not finite, or
    /// when the header asks for more than the file has.
    pub fn decode(path: &Path, bytes: &[u8]) -> Result<Self> {
        let (tensors, header) = weights::open(path, bytes)?;
        let header: N::Header = serde_json::from_str(&header).map_err(|e| Error::malformed(path, e.to_string()))?;
        N::check(&header).map_err(|e| Error::malformed(path, format!("header: {e}")))?;
        // The network is made before its tensors are compared, so a wrong header could ask for too much memory.
        let (values, most) = (N::values(&header), bytes.len() / 2);
        if values > most {
            let reason = format!("the network its header describes has {values} values; {most} at most are in the file");
            return Err(Error::malformed(path, reason));
        }
        let fresh = parameters::export(&N::fresh(&header, NetworkDevice::cpu().device())?);
        if let Some(extra) = tensors.names().into_iter().find(|name| fresh.iter().all(|parameter| parameter.name != **name)) {
            let reason = "not part of the network its header describes".into();
            return Err(Error::Tensor { path: path.into(), tensor: extra.to_owned(), reason });
        }
        let read = |parameter: Parameter| -> Result<Parameter> {
            let values = weights::read_tensor(path, &tensors, &parameter.name, &parameter.shape)?;
            Ok(Parameter { values, ..parameter })
        };
        let parameters = fresh.into_iter().map(read).collect::<Result<Vec<Parameter>>>()?;
        Self::with_parameters(header, &parameters)
    }

    /// The bytes of a weights file.
    ///
    /// # Errors
    /// When a value is not finite.
    pub fn encode(&self, precision: Precision) -> Result<Vec<u8>> {
        let broken = |e: serde_json::Error| Error::malformed("weights to be written", e.to_string());
        weights::encode(&serde_json::to_string(&self.header).map_err(broken)?, &self.parameters(), precision)
    }

    /// Writes a weights file.
    ///
    /// # Errors
    /// When it cannot be written, or a value is not finite.
    pub fn save(&self, path: &Path, precision: Precision) -> Result<()> {
        Ok(file::write_atomic(path, &self.encode(precision)?)?)
    }

    /// The parameters, in the host's memory.
    pub fn parameters(&self) -> Vec<Parameter> {
        parameters::export(&self.network)
    }

    /// The header of the weights.
    pub fn header(&self) -> &N::Header {
        &self.header
    }

    /// The network on another device, to be trained further.
    ///
    /// # Errors
    /// When the configuration is invalid.
    pub(crate) fn on(&self, device: &Device) -> Result<N> {
        let values = self.parameters();
        let values: Vec<&[f32]> = values.iter().map(|parameter| parameter.values.as_slice()).collect();
        Ok(parameters::import(N::fresh(&self.header, device)?, &values, device))
    }
}
