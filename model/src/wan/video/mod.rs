//! Rendering with the paper's network: sequences of any length in overlapping clips, and inverse rendering of pictures.
//!
//! A clip has 1 + s frames, where s is the number of frames that a latent frame spans (4 with Wan's autoencoder). It begins with
//! the last frame of the clip before it, whose picture is VACE's masked reference (RenderFlow, section "Long video inference").
//! The position in the sequence alone decides where clips begin. Therefore the result does not depend on how frames arrive, or on
//! stops between clips. Memory holds one clip. If a sequence ends inside a clip, its last frame is repeated to the end of the
//! clip. A single frame is a clip of one frame, for which the autoencoder is two-dimensional.

mod clips;
mod invert;
mod pixels;

pub use clips::ClipSession;

use super::flow::{Flow, FlowConfig, mask_cells};
use super::pictures::BridgeStart;
use super::vae::{Tiling, Vae};
use super::weights::{Header, Source};
use crate::device::NetworkDevice;
use crate::renderer::{About, Options, Renderer, Sequence, Session};
use crate::{Error, Result};
use burn::tensor::{Device, Tensor, TensorData};
use std::path::Path;

/// Name of the autoencoder's file in the folder of the renderer's file.
pub const AUTOENCODER_FILE: &str = "vae.safetensors";

/// The paper's renderer with its autoencoder.
#[derive(Debug)]
pub struct WanRenderer {
    flow: Flow,
    vae: Vae,
    header: Header,
    tiling: Option<Tiling>,
    device: Device,
}

impl WanRenderer {
    /// Whether a file holds a network of [`crate::wan`] that this program wrote.
    pub fn recognises(path: &Path) -> bool {
        Source::open(path).and_then(|source| source.header()).is_ok_and(|header| header.is_some())
    }

    /// Opens the renderer in the file `path` on a device. Its autoencoder is in the file `autoencoder` (of this program, or
    /// published in either layout), or in [`AUTOENCODER_FILE`] beside the renderer.
    ///
    /// # Errors
    /// When a file cannot be read, when it holds another network, or when the two do not belong together.
    pub fn load(path: &Path, autoencoder: Option<&Path>, device: &NetworkDevice) -> Result<Self> {
        let device = device.device().clone();
        let (flow, header, _) = Flow::read(&Source::open(path)?, |config| config, 0, &device)?;
        let beside = path.parent().unwrap_or(Path::new("")).join(AUTOENCODER_FILE);
        if autoencoder.is_none() && !beside.is_file() {
            let reason = format!("no {AUTOENCODER_FILE} beside it: name the file of its autoencoder");
            return Err(Error::malformed(path, reason));
        }
        let autoencoder = autoencoder.unwrap_or(&beside);
        let (vae, _) = Vae::open(autoencoder, &flow.config().vae, &device)?;
        if vae.config() != &flow.config().vae {
            let reason = format!("not the autoencoder on whose latents {} was trained", path.display());
            return Err(Error::malformed(autoencoder, reason));
        }
        Self::new(flow, vae, header, device)
    }

    /// A renderer from networks in memory, which are on `device`.
    ///
    /// # Errors
    /// When the two do not belong together.
    pub fn new(flow: Flow, vae: Vae, header: Header, device: Device) -> Result<Self> {
        if vae.config() != &flow.config().vae {
            return Err(Error::config("autoencoder", "is not the one whose latents the renderer was made for"));
        }
        Ok(Self { flow, vae, header, tiling: None, device })
    }

    /// The same renderer, which encodes and decodes pictures of more than `pixels` pixels a side in tiles of that size. A quarter
    /// of each tile overlaps with the next. The autoencoder then needs memory for one tile; [`Tiling`] describes how results
    /// change. Tokens still attend to the whole picture.
    ///
    /// # Errors
    /// When a tile would be smaller than four latent pixels.
    pub fn tiled(self, pixels: usize) -> Result<Self> {
        let size = pixels / self.config().vae.spatial_factor();
        if size < 4 {
            return Err(Error::config("tile", format!("{pixels} pixels are fewer than four latent pixels")));
        }
        Ok(Self { tiling: Some(Tiling { size, overlap: size / 4 }), ..self })
    }

    /// The configuration of the network.
    pub fn config(&self) -> &FlowConfig {
        self.flow.config()
    }

    /// The header of the weights.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// Normalised latents of pictures `[1, 3, f, height, width]`.
    fn encode(&self, pictures: Tensor<5>) -> Result<Tensor<5>> {
        match self.tiling {
            Some(tiling) => Ok(self.vae.normalise(self.vae.encode_tiled(pictures, tiling)?)),
            None => self.vae.encode_normalised(pictures),
        }
    }

    /// Pictures from normalised latents, clamped to -1..=1.
    fn decode(&self, latents: Tensor<5>) -> Result<Tensor<5>> {
        match self.tiling {
            Some(tiling) => Ok(self.vae.decode_tiled(self.vae.denormalise(latents), tiling)?.clamp(-1.0, 1.0)),
            None => self.vae.decode_normalised(latents),
        }
    }

    /// The mask of a clip, `[1, s s, f, h, w]` for latents `[1, z, f, h, w]`. `known` says for each frame whether it is given.
    fn mask(&self, known: &[bool], latents: &Tensor<5>) -> Tensor<5> {
        let [b, _, f, h, w] = latents.dims();
        let cells = self.config().mask_channels();
        Tensor::from_data(TensorData::new(mask_cells(known, f, cells, h * w), [b, cells, f, h, w]), &self.device)
    }
}

/// The autoencoder of the paper's renderer.
#[derive(Clone, Copy, Debug, Default)]
pub struct Autoencoder<'a> {
    /// Its weights file, or `None` for [`AUTOENCODER_FILE`] beside the weights of the renderer.
    pub file: Option<&'a Path>,
    /// Side of the tiles, in pixels, in which larger pictures are encoded and decoded, or `None` to process pictures whole.
    pub tile: Option<usize>,
}

/// Opens weights of the paper's renderer on a device.
///
/// # Errors
/// When a file cannot be read or holds another network. The message names the file and the tensor.
pub fn open(path: &Path, autoencoder: Autoencoder, device: &NetworkDevice) -> Result<Box<dyn Renderer>> {
    let renderer = WanRenderer::load(path, autoencoder.file, device)?;
    Ok(match autoencoder.tile {
        Some(pixels) => Box::new(renderer.tiled(pixels)?),
        None => Box::new(renderer),
    })
}

impl Renderer for WanRenderer {
    fn about(&self) -> About {
        let header = serde_json::to_string(&self.header).unwrap_or_default();
        let clip = 1 + self.config().vae.temporal_factor();
        let (keyframes, shaded) = (self.config().keyframes.is_some(), self.config().bridge_start == BridgeStart::Deferred);
        About { name: "wan", header, keyframes, hdr: false, shaded, clip }
    }

    fn begin<'a>(&'a self, sequence: &'a dyn Sequence, options: Options) -> Result<Box<dyn Session + 'a>> {
        Ok(Box::new(ClipSession::new(self, sequence, options)?))
    }
}
