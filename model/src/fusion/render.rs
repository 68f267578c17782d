//! Inference: the network renders the frame of a record.

use super::batch::{Augmentation, Batch, Window};
use super::graph::{FusionConfig, FusionNet, MULTIPLE, Outputs};
use super::grow::grown;
use super::record::{Groups, Record, Selection, Stored};
use crate::network::trained::{Described, Trained};
use crate::ops::Products;
use crate::parameters::read;
use crate::{Error, Result};
use burn::tensor::{Device, Tensor, TensorData};
use serde::{Deserialize, Deserializer, Serialize};

/// The header of a weights file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Header {
    /// The network.
    #[serde(deserialize_with = "of_file")]
    pub fusion: FusionConfig,
    /// Number of training steps; 0 for an untrained network.
    pub steps: u64,
    /// Seed of the training run.
    pub seed: u64,
}

/// The configuration in a weights file. Those from before [`FusionConfig::paths`] lack it.
fn of_file<'de, D: Deserializer<'de>>(file: D) -> std::result::Result<FusionConfig, D::Error> {
    let mut fields = serde_json::Map::deserialize(file)?;
    fields.entry("paths").or_insert(false.into());
    serde_json::from_value(fields.into()).map_err(serde::de::Error::custom)
}

#[cfg(shipped_weights)]
static SHIPPED: Option<&[u8]> = Some(include_bytes!("../../weights/fusion.safetensors"));
#[cfg(not(shipped_weights))]
static SHIPPED: Option<&[u8]> = None;

/// Columns and rows of a tile. Larger pictures are rendered in tiles, one after another.
const TILE: usize = 768;
/// Columns and rows of the smallest tile that is tried on a device with little memory.
const SMALLEST_TILE: usize = 96;
/// The input of a tile takes at most this share of the largest tensor of a device, one part of so many. The input is the largest
/// tensor of the network itself; the rest is for what convolutions store between their steps.
const SHARE_OF_LARGEST: usize = 4;

impl Described for FusionNet {
    type Header = Header;

    fn check(header: &Header) -> Result<()> {
        header.fusion.validate()
    }

    fn values(header: &Header) -> usize {
        header.fusion.values()
    }

    fn fresh(header: &Header, device: &Device) -> Result<Self> {
        Self::new(&header.fusion, header.seed, device)
    }

    fn shipped() -> Option<&'static [u8]> {
        SHIPPED
    }
}

/// The fusion network with its weights.
pub type Fusion = Trained<FusionNet>;

/// The crops of a batch as the network renders them.
#[derive(Clone, Debug)]
pub struct Drawn {
    /// Outputs of the network at half size, `[items][height/2][width/2][head::fine(groups)]`.
    pub fine: Vec<f32>,
    /// Outputs at quarter size, `[items][height/4][width/4][head::KERNEL]`; empty without samples.
    pub coarse: Vec<f32>,
    /// Exposed linear radiance, `[items][height][width]`.
    pub pixels: Vec<[f32; 3]>,
}

impl Trained<FusionNet> {
    /// An untrained network. It returns the best of its input pictures.
    ///
    /// # Errors
    /// When the configuration is invalid.
    pub fn untrained(config: &FusionConfig, seed: u64) -> Result<Self> {
        Self::fresh(Header { fusion: config.clone(), steps: 0, seed })
    }

    /// This network with the configuration `config`, which gives the same pictures until it is trained: itself, both of its
    /// U-Nets with the weights of its only one, or one with more channels and more convolutions.
    ///
    /// # Errors
    /// [`Error::Config`] where a U-Net would have fewer channels or convolutions, or the only one would be for some frames.
    pub fn fitted(&self, config: &FusionConfig) -> Result<Self> {
        if self.header().fusion == *config {
            return Ok(self.clone());
        }
        let header = Header { fusion: config.clone(), ..self.header().clone() };
        let grown = grown(&self.header().fusion, &self.parameters(), config, Self::fresh(header.clone())?.parameters())?;
        Self::with_parameters(header, &grown)
    }

    /// Renders the frame of a record from all of its inputs. The result is exposed linear radiance.
    ///
    /// # Errors
    /// When the record is empty.
    pub fn render(&self, record: &Record<f32>) -> Result<Vec<[f32; 3]>> {
        self.draw(record, &Selection::all(record))
    }

    /// Renders the frame of a record from the selected inputs. Large pictures are rendered in tiles; their margins cover
    /// everything that the network reads, so the result does not depend on the tiles. Where a device runs out of memory, smaller
    /// tiles are tried.
    ///
    /// # Errors
    /// When the record is empty, and when the device fails.
    pub fn draw<T: Stored>(&self, record: &Record<T>, selection: &Selection) -> Result<Vec<[f32; 3]>> {
        let read = self.header().fusion.paths;
        let groups = Groups { paths: selection.groups.paths && read, ..selection.groups };
        let selection = &Selection { groups, ..*selection };
        let mut side = largest_tile(selection.groups.channels(), self.margin(), self.device.largest_tensor());
        loop {
            match self.draw_in_tiles(record, selection, side) {
                Err(Error::Device { .. }) if side > SMALLEST_TILE => side = smaller(side),
                drawn => return drawn,
            }
        }
    }

    /// [`Self::draw`] in tiles of `side` columns and rows, a multiple of [`MULTIPLE`].
    fn draw_in_tiles<T: Stored>(&self, record: &Record<T>, selection: &Selection, side: usize) -> Result<Vec<[f32; 3]>> {
        let (width, height, margin) = (record.width, record.height, self.margin());
        if width == 0 || height == 0 {
            return Err(Error::Data { place: "frame".into(), reason: format!("has {width} x {height} pixels") });
        }
        let mut picture = vec![[0.0; 3]; width * height];
        for top in (0..height).step_by(side) {
            for left in (0..width).step_by(side) {
                let (right, bottom) = ((left + side).min(width), (top + side).min(height));
                let (x, y) = (left.saturating_sub(margin), top.saturating_sub(margin));
                let end =
                    |end: usize, whole: usize| (end + margin).min(whole.next_multiple_of(MULTIPLE)).next_multiple_of(MULTIPLE);
                let window = Window { x, y, width: end(right, width) - x, height: end(bottom, height) - y };
                let drawn = self.draw_window(record, selection, window)?;
                for row in top..bottom {
                    let from = (row - y) * window.width + left - x;
                    picture[row * width + left..row * width + right].copy_from_slice(&drawn[from..from + right - left]);
                }
            }
        }
        Ok(picture)
    }

    /// Number of pixels in the largest window that the network works on at a time.
    pub fn tile_pixels(&self) -> usize {
        (TILE + 2 * self.margin()).pow(2)
    }

    /// Columns and rows around a tile that the network reads for it.
    fn margin(&self) -> usize {
        self.header().fusion.reach()
    }

    fn draw_window<T: Stored>(&self, record: &Record<T>, selection: &Selection, window: Window) -> Result<Vec<[f32; 3]>> {
        Ok(self.draw_batch(Batch::of(record, window, selection, &Augmentation::NONE))?.pixels)
    }

    /// Renders the crops of a batch.
    ///
    /// # Errors
    /// When the device fails.
    pub fn draw_batch(&self, mut batch: Batch) -> Result<Drawn> {
        let outputs = forward(&self.network, self.products, &mut batch, self.device.device());
        let fine = read(outputs.fine)?;
        let coarse = outputs.coarse.map(read).transpose()?.unwrap_or_default();
        let pixels = (0..batch.items).flat_map(|item| batch.picture(item, &fine, &coarse).draw().0).collect();
        Ok(Drawn { fine, coarse, pixels })
    }
}

/// Side of the largest tile with so many input `channels` and this `margin` whose tensors a device takes. The `largest` tensor is
/// in bytes.
fn largest_tile(channels: usize, margin: usize, largest: u64) -> usize {
    let bytes = |side: usize| (SHARE_OF_LARGEST * size_of::<f32>() * channels * (side + 2 * margin).pow(2)) as u64;
    let mut side = TILE;
    while side > SMALLEST_TILE && bytes(side) > largest {
        side = smaller(side);
    }
    side
}

/// Side of the next smaller tile.
fn smaller(side: usize) -> usize {
    (side / 2).next_multiple_of(MULTIPLE)
}

/// Runs the network on a batch, and takes the input out of it.
pub(super) fn forward(network: &FusionNet, products: Products, batch: &mut Batch, device: &Device) -> Outputs {
    let shape = [batch.items, batch.height / 2, batch.width / 2, 4 * batch.groups.channels()];
    let input = Tensor::from_data(TensorData::new(std::mem::take(&mut batch.input), shape), device);
    network.forward(products, input, batch.groups)
}

#[cfg(test)]
mod tests {
    use super::super::record::{NEIGHBOURS, PARTS, PICTURES, at};
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    #[test]
    fn tiles_fit_the_device() {
        let input = |side: usize| (4 * 100 * (side + 2 * 96).pow(2)) as u64;
        let largest_tile = |bytes| largest_tile(100, 96, bytes);
        assert_eq!(largest_tile(u64::MAX), TILE);
        assert_eq!(largest_tile(4 * input(384)), 384);
        assert_eq!(largest_tile(4 * input(384) - 1), 192);
        assert_eq!(largest_tile(0), SMALLEST_TILE);
    }

    /// The margins of tiles are wide enough: the picture is the same to the last bit.
    #[test]
    fn tiles_leave_no_trace() {
        let mut rng = Pcg64Mcg::seed_from_u64(4);
        let mut record = Record::<f32>::new(550, 470);
        record.pixels.iter_mut().for_each(|v| *v = rng.random_range(0.0..1.0));
        record.pixels.chunks_exact_mut(at::COUNT).for_each(|stored| stored[at::ALPHA] = 1.0);
        record.parts = [2; PARTS];
        record.neighbours = [2; NEIGHBOURS];
        record.denoised = [true; PICTURES];
        // No weight is 0, so that distant pixels have an influence.
        let config = FusionConfig { widths: [16; 4], refines: [1, 2, 2, 2], ..FusionConfig::default() };
        assert_eq!((FusionConfig::default().reach(), config.reach()), (112, 144));
        let fresh = Fusion::untrained(&config, 5).expect("a network");
        let mut parameters = fresh.parameters();
        for parameter in &mut parameters {
            parameter.values.iter_mut().for_each(|v| *v += rng.random_range(-0.1..0.1));
        }
        let fusion = Fusion::with_parameters(fresh.header().clone(), &parameters).expect("a network");
        let selection = Selection::all(&record);
        let whole = fusion.draw_in_tiles(&record, &selection, 768).expect("a picture");
        assert!(whole == fusion.draw_in_tiles(&record, &selection, 128).expect("a picture"));
        let narrow = |x: usize| Window { x, y: 0, width: 560 - x, height: 480 };
        let without_margin = fusion.draw_window(&record, &selection, narrow(128)).expect("a picture");
        assert!(without_margin[5 * 432] != whole[5 * 550 + 128], "the test would not see a seam");
    }
}
