//! The JSON header of a compact file, and how each layer of the table is coded.

use super::{Keep, SIGNATURE, START, VERSION};
use crate::channel::{self, Field, LAYERS, Layer, Storage};
use crate::{FrameInfo, rgbe};
use serde::{Deserialize, Serialize};

/// How the numbers of a block become values; see the table in [`super`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Encoding {
    Half,
    Float,
    Unit8,
    Srgb8,
    Octahedral12,
    Depth16,
    U8,
    U16,
    U32,
}

impl Encoding {
    /// The encoding of a layer, where it does not depend on the values.
    pub fn of(layer: &Layer) -> Self {
        match (layer_name(layer), layer.storage) {
            ("alpha" | "material" | "transmittance", _) => Self::Unit8,
            ("albedo", _) => Self::Srgb8,
            ("normal" | "through", _) => Self::Octahedral12,
            ("depth", _) => Self::Depth16,
            (_, Storage::Half) => Self::Half,
            (_, Storage::Float) => Self::Float,
            (_, Storage::Uint) => Self::U32,
        }
    }

    /// Bytes of a number.
    pub fn bytes(self) -> usize {
        match self {
            Self::Unit8 | Self::Srgb8 | Self::U8 => 1,
            Self::Half | Self::Octahedral12 | Self::Depth16 | Self::U16 => 2,
            Self::Float | Self::U32 => 4,
        }
    }

    /// Number of stored numbers of a pixel with `components` components.
    pub fn samples(self, components: usize) -> usize {
        if self == Self::Octahedral12 { 2 } else { components }
    }

    /// Whether values of `layer` may have this encoding.
    fn suits(self, layer: &Layer) -> bool {
        match (self, &layer.field) {
            (Self::U8 | Self::U16 | Self::U32, Field::Id(_)) | (Self::Octahedral12, Field::Rgb(_)) => true,
            (Self::Depth16, Field::Scalar(_)) => true,
            (Self::U8 | Self::U16 | Self::U32 | Self::Octahedral12 | Self::Depth16, _) | (_, Field::Id(_)) => false,
            _ => true,
        }
    }
}

/// Name of a layer of the table in compact files: its own, or `beauty` and `alpha` for the two at the root.
pub fn layer_name(layer: &Layer) -> &'static str {
    match (layer.name, layer.components) {
        ("", ["A"]) => "alpha",
        ("", _) => "beauty",
        (name, _) => name,
    }
}

/// The layer of the table with this name.
pub(super) fn layer_named(name: &str) -> Option<&'static Layer> {
    LAYERS.iter().find(|layer| layer_name(layer) == name)
}

/// Whether `keep` keeps a layer.
pub(super) fn kept(layer: &Layer, keep: Keep) -> bool {
    // The distance follows from the depth.
    let extra = ["raw", "variance", "samples", "indirect", "hidden", "guide_albedo", "guide_normal", "distance"];
    keep == Keep::All || !(extra.contains(&layer.name) || layer.name.starts_with("light."))
}

#[derive(Serialize, Deserialize)]
pub(super) struct Header {
    pub width: usize,
    pub height: usize,
    pub info: FrameInfo,
    pub layers: Vec<Block>,
    /// Layers that the frame had but the file lacks.
    #[serde(default)]
    pub left_out: Vec<String>,
    /// JSON as text: [`channel::conventions`].
    pub conventions: String,
}

/// Where and how one layer is stored.
#[derive(Serialize, Deserialize)]
pub(super) struct Block {
    pub name: String,
    pub components: Vec<String>,
    pub encoding: Encoding,
    /// Whether numbers are differences from the pixel above.
    pub delta: bool,
    /// First byte, counted from the end of the header.
    pub offset: usize,
    pub bytes: usize,
    /// What the encoding loses, in words.
    pub precision: String,
    /// Bits of the smallest depth.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lowest: Option<u32>,
    /// Bits from a depth to the next.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub step: Option<u32>,
}

/// A block that was checked against the table, the file's length and the picture's size.
pub(super) struct Checked<'a> {
    pub layer: &'static Layer,
    pub block: &'a Block,
    pub bytes: &'a [u8],
    /// Decompressed length in bytes.
    pub raw: usize,
}

/// Largest size of a decompressed header in bytes; the headers of this crate have a few kilobytes.
const LONGEST: usize = 1 << 20;

/// Memory in bytes that every file may ask for, whatever its length: 5 million pixels of the training layers.
const FREE: usize = 1 << 29;

/// Memory in bytes that each byte of a file may ask for beyond [`FREE`], as for OpenEXR.
const PER_BYTE: usize = 1_100;

/// Number of bytes to add to a file of `length` bytes so that its reader accepts it. Only pictures of one colour need any.
pub(super) fn padding(width: usize, height: usize, layers: &[Block], length: usize) -> usize {
    let memory: usize =
        layers.iter().filter_map(|block| layer_named(&block.name)).map(|layer| memory(layer, width * height)).sum();
    (memory.saturating_sub(FREE) / PER_BYTE + 1).saturating_sub(length)
}

/// Bytes of a layer in a [`crate::Frame`].
fn memory(layer: &Layer, pixels: usize) -> usize {
    4 * layer.components.len() * pixels
}

/// Fewest bytes that zstd needs for `raw` bytes: each block of at most 128 KiB has a header of 3 bytes and one byte of content.
fn fewest(raw: usize) -> usize {
    4 * raw.div_ceil(1 << 17)
}

/// Splits a file into its header and what follows it.
pub(super) fn parse(bytes: &[u8]) -> Result<(Header, &[u8]), String> {
    let word = |at: usize| bytes.get(at..at + 4).and_then(|b| b.try_into().ok()).map(u32::from_le_bytes);
    if !bytes.starts_with(&SIGNATURE) {
        return Err("no compact frame file: its first bytes are not \\x93RFF".into());
    }
    let (Some(version), Some(stored), Some(length)) = (word(4), word(8), word(12)) else {
        return Err(format!("cut short: {} bytes, the header starts at byte {START}", bytes.len()));
    };
    if version != VERSION {
        return Err(format!("byte 4: version {version} of the layout is not the one read here ({VERSION})"));
    }
    let (stored, length) = (stored as usize, length as usize);
    if length > LONGEST || fewest(length) > stored {
        return Err(format!("byte 12: a header of {length} bytes cannot be in {stored}"));
    }
    let rest = &bytes[START..];
    let Some((header, blocks)) = rest.split_at_checked(stored) else {
        return Err(format!("cut short: the header ends at byte {}, the file at {}", START + stored, bytes.len()));
    };
    let mut json = vec![0; length];
    decompress(header, &mut json).map_err(|reason| format!("header: {reason}"))?;
    let header: Header = serde_json::from_slice(&json).map_err(|e| format!("header: {}", crate::words::plain(&e.to_string())))?;
    let sides = 1..=rgbe::MAXIMUM_SIDE;
    let (width, height) = (header.width, header.height);
    if !sides.contains(&width) || !sides.contains(&height) || width * height > rgbe::MAXIMUM_PIXELS {
        return Err(format!(
            "header: {width} x {height} is outside 1..={} a side and {} pixels in all",
            rgbe::MAXIMUM_SIDE,
            rgbe::MAXIMUM_PIXELS
        ));
    }
    channel::check_conventions(&header.conventions).map_err(|reason| format!("header: {reason}"))?;
    header.info.check().map_err(|reason| format!("header: {reason}"))?;
    Ok((header, blocks))
}

/// Checks every block of a header before any of them is decompressed. `file` is the length of the file in bytes.
pub(super) fn check<'a>(header: &'a Header, blocks: &'a [u8], file: usize) -> Result<Vec<Checked<'a>>, String> {
    let pixels = header.width * header.height;
    let mut found: Vec<Checked> = Vec::with_capacity(LAYERS.len());
    let (mut end, mut asked) = (0usize, 0usize);
    for (index, block) in header.layers.iter().enumerate() {
        let place = format!("header /layers/{index}");
        let layer = layer_named(&block.name).ok_or_else(|| format!("{place}: no layer is called {:?}", block.name))?;
        if found.iter().any(|checked| std::ptr::eq(checked.layer, layer)) {
            return Err(format!("{place}: a second layer {}", block.name));
        }
        if block.components != layer.components || !block.encoding.suits(layer) {
            return Err(format!("{place}: layer {} cannot be {:?} as {:?}", block.name, block.components, block.encoding));
        }
        if block.offset != end {
            return Err(format!("{place}: layer {} starts at {}, the one before it ends at {end}", block.name, block.offset));
        }
        let stored = end.checked_add(block.bytes).and_then(|next| blocks.get(end..next));
        let Some(bytes) = stored else {
            return Err(format!("cut short: layer {} has {} bytes, {} are left", block.name, block.bytes, blocks.len() - end));
        };
        let raw = pixels * block.encoding.bytes() * block.encoding.samples(layer.components.len());
        if fewest(raw) > bytes.len() {
            return Err(format!("{place}: layer {} of {raw} bytes cannot be in {}", block.name, bytes.len()));
        }
        end += block.bytes;
        asked += memory(layer, pixels);
        found.push(Checked { layer, block, bytes, raw });
    }
    if let Some(layer) = LAYERS.iter().find(|layer| !layer.optional && !found.iter().any(|c| std::ptr::eq(c.layer, *layer))) {
        return Err(format!("layer {} is missing", layer_name(layer)));
    }
    if blocks[end..].iter().any(|&b| b != 0) {
        return Err(format!("{} bytes stand after the last layer", blocks.len() - end));
    }
    if asked > FREE.saturating_add(PER_BYTE.saturating_mul(file)) {
        return Err(format!("{} x {} with {} layers cannot be in {file} bytes", header.width, header.height, found.len()));
    }
    Ok(found)
}

/// Decompresses one zstd frame that fills `out` exactly.
pub(super) fn decompress(bytes: &[u8], out: &mut [u8]) -> Result<(), String> {
    let mut decompressor = zstd::bulk::Decompressor::new().map_err(|e| e.to_string())?;
    match decompressor.decompress_to_buffer(bytes, out) {
        Ok(length) if length == out.len() => Ok(()),
        Ok(length) => Err(format!("{length} bytes decompressed where {} were expected", out.len())),
        Err(error) => Err(format!("damaged: {error}")),
    }
}
