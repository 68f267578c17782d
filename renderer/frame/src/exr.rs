//! Frame files: each frame is one single-part, scan-line, ZIP16 OpenEXR file with the channels of [`crate::channel`].

mod attributes;
mod open;

use crate::channel::{Access, Field, LAYERS, Layer as TableLayer, Storage};
use crate::file::write_atomic;
use crate::image::{Image, Rgb};
use crate::{Error, Frame, FrameInfo, Result, color, rgbe};
use ::exr::image::{AnyChannel, AnyChannels, Encoding, FlatSamples, Image as ExrImage, Layer};
use ::exr::math::Vec2;
use ::exr::meta::attribute::{Chromaticities, EnvironmentMap, IntegerBounds};
use ::exr::meta::header::{Header, LayerAttributes};
use ::exr::prelude::{Compression, LineOrder, ReadChannels, ReadLayers, WritableImage};
use glam::{Mat3A, Vec3A};
use half::f16;
use half::slice::HalfFloatSliceExt;
use std::io::Cursor;
use std::path::Path;

/// First bytes of every OpenEXR file.
pub(crate) const SIGNATURE: [u8; 4] = ::exr::meta::magic_number::BYTES;

/// Largest difference of a coordinate by which a primary is still the same one: Radiance's green is (0.29, 0.60).
const SAME_PRIMARY: f64 = 0.015;

/// Largest finite half float.
pub(crate) const HALF_MAX: f32 = 65504.0;

/// Writes a frame and returns the number of half-float values that were clamped to 65504.
///
/// The same frame always gives the same bytes. No layer `name` is set, because Blender would then show a single output instead of
/// the channels' layers.
///
/// # Errors
/// When a channel holds NaN, or an infinity that is not the depth of a miss; when a picture does not have the frame's size; when
/// the file cannot be written (nothing is left behind).
pub fn write(path: &Path, frame: &Frame) -> Result<usize> {
    let (bytes, clamped) = encode(path, frame)?;
    write_atomic(path, &bytes)?;
    Ok(clamped)
}

/// [`write()`] into memory. Returns the bytes and the number of values that were clamped; errors give `name` as the path.
///
/// # Errors
/// As [`write()`], except that no file is written.
pub fn encode(name: &Path, frame: &Frame) -> Result<(Vec<u8>, usize)> {
    let malformed = |reason: String| Error::malformed(name, reason);
    if frame.width == 0 || frame.height == 0 {
        return Err(malformed(format!("a frame of {} x {} pixels has nothing to write", frame.width, frame.height)));
    }
    let mut clamped = 0;
    let mut channels = Vec::new();
    for layer in LAYERS {
        channels.extend(layer_channels(frame, layer, &mut clamped).map_err(malformed)?);
    }
    let encoding =
        Encoding { compression: Compression::ZIP16, blocks: ::exr::image::Blocks::ScanLines, line_order: LineOrder::Increasing };
    let size = Vec2(frame.width, frame.height);
    let layer = Layer::new(size, LayerAttributes::default(), encoding, AnyChannels::sort(channels.into()));
    let mut image = ExrImage::from_layer(layer);
    attributes::write(&frame.info, &mut image.attributes, &mut image.layer_data.attributes).map_err(malformed)?;
    let mut bytes = Cursor::new(Vec::new());
    image.write().to_buffered(&mut bytes).map_err(|e| malformed(e.to_string()))?;
    let mut bytes = bytes.into_inner();
    attributes::sort(&mut bytes).ok_or_else(|| malformed("the header written is not a valid one".into()))?;
    Ok((bytes, clamped))
}

/// Reads a frame written by [`write()`]; optional channels may be absent.
///
/// # Errors
/// When the file is missing, is not OpenEXR, lacks a channel or holds NaN. The message names the channel.
pub fn read(path: &Path) -> Result<Frame> {
    decode(path, &crate::file::read(path)?)
}

/// [`read`] from memory; `name` stands for the path in errors.
///
/// # Errors
/// As [`read`].
pub fn decode(name: &Path, bytes: &[u8]) -> Result<Frame> {
    let malformed = |reason: String| Error::malformed(name, reason);
    let meta = open::meta_data(name, bytes, rgbe::MAXIMUM_PIXELS)?;
    let [header] = &meta.headers[..] else {
        return Err(malformed(format!("a frame file has one part, this one has {}", meta.headers.len())));
    };
    check_pixel_grid(header).map_err(malformed)?;
    let info = attributes::read(header).map_err(malformed)?;
    // One thread, because in the exr crate's own pool a panic on damaged data would end the program.
    let reader = ::exr::prelude::read().no_deep_data().largest_resolution_level().all_channels().first_valid_layer();
    let reader = reader.all_attributes().non_parallel();
    let image = open::guarded(name, bytes, |source| reader.from_buffered(source))?;
    let mut channels = image.layer_data.channel_data.list.into_vec();
    let mut frame = Frame { width: image.layer_data.size.0, height: image.layer_data.size.1, info, ..Frame::default() };
    for layer in LAYERS {
        read_layer(&mut frame, layer, &mut channels).map_err(malformed)?;
    }
    Ok(frame)
}

/// The values of a frame's header; no pixel is decompressed. Errors give `name` as the path.
///
/// # Errors
/// When the bytes are not an OpenEXR file of one part, or the header does not belong to a frame.
pub fn info(name: &Path, bytes: &[u8]) -> Result<FrameInfo> {
    let meta = open::meta_data(name, bytes, rgbe::MAXIMUM_PIXELS)?;
    let [header] = &meta.headers[..] else {
        return Err(Error::malformed(name, format!("a frame file has one part, this one has {}", meta.headers.len())));
    };
    attributes::read(header).map_err(|reason| Error::malformed(name, reason))
}

/// Reads the root channels `R`, `G`, `B`, half or float, of an OpenEXR file from any program, as linear Rec.709. Values are as
/// stored and may be NaN. Where the file names other primaries, they are converted, and colours beyond Rec.709 have negative
/// components.
///
/// # Errors
/// When the file is missing or damaged, lacks a channel, covers only a part of its display window, or names primaries that make
/// no space of colours.
pub fn read_rgb(path: &Path) -> Result<Rgb> {
    decode_rgb(path, &crate::file::read(path)?)
}

/// [`read_rgb`] from memory; `name` stands for the path in errors.
///
/// # Errors
/// As [`read_rgb`].
pub fn decode_rgb(name: &Path, bytes: &[u8]) -> Result<Rgb> {
    let (mut picture, header) = decode_stored(name, bytes)?;
    if let Some(matrix) = to_rec709(&header).map_err(|reason| Error::malformed(name, reason))? {
        picture.pixels.iter_mut().for_each(|pixel| *pixel = (matrix * Vec3A::from_array(*pixel)).to_array());
    }
    Ok(picture)
}

/// As [`decode_rgb`] for an environment map; cube maps are refused. Components that conversion made negative become 0.
pub(crate) fn decode_environment(name: &Path, bytes: &[u8]) -> Result<Rgb> {
    let (mut picture, header) = decode_stored(name, bytes)?;
    if let Some(matrix) = to_rec709(&header).map_err(|reason| Error::malformed(name, reason))? {
        for texel in picture.pixels.iter_mut().filter(|texel| texel.iter().all(|v| v.is_finite() && *v >= 0.0)) {
            *texel = (matrix * Vec3A::from_array(*texel)).max(Vec3A::ZERO).to_array();
        }
    }
    match header.own_attributes.environment_map {
        Some(EnvironmentMap::Cube) => Err(Error::malformed(name, "a cube map; only equirectangular maps are supported")),
        _ => Ok(picture),
    }
}

/// Columns and rows of the picture that [`decode_rgb`] reads; pixels are not decompressed.
pub(crate) fn rgb_size(name: &Path, bytes: &[u8]) -> Result<[usize; 2]> {
    let size = rgb_header(name, bytes)?.layer_size;
    Ok([size.width(), size.height()])
}

/// The header of the first part that holds `R`, `G`, `B` on a full grid.
fn rgb_header(name: &Path, bytes: &[u8]) -> Result<Header> {
    let malformed = |reason: String| Error::malformed(name, reason);
    let meta = open::meta_data(name, bytes, rgbe::MAXIMUM_TEXELS)?;
    let has = |header: &Header, channel: &str| header.channels.list.iter().any(|c| c.name == *channel);
    let Some(header) = meta.headers.iter().find(|header| ["R", "G", "B"].iter().all(|c| has(header, c))) else {
        let found = meta.headers.iter().flat_map(|header| &header.channels.list);
        let found: Vec<String> = found.take(20).map(|c| c.name.to_string().chars().take(40).collect()).collect();
        return Err(malformed(format!("no channels R, G, B; found {}", found.join(", "))));
    };
    check_pixel_grid(header).map_err(malformed)?;
    let window = IntegerBounds { position: header.own_attributes.layer_position, size: header.layer_size };
    let display = header.shared_attributes.display_window;
    if window != display {
        let place =
            |b: IntegerBounds| format!("{} x {} from ({}, {})", b.size.width(), b.size.height(), b.position.x(), b.position.y());
        return Err(malformed(format!(
            "its dataWindow, {}, is not its displayWindow, {}: a part of the picture only",
            place(window),
            place(display)
        )));
    }
    to_rec709(header).map_err(malformed)?;
    Ok(header.clone())
}

/// The matrix from the colours of a file to linear Rec.709; `None` if it has these, or names none. The file's white is white.
fn to_rec709(header: &Header) -> std::result::Result<Option<Mat3A>, String> {
    let Some(Chromaticities { red, green, blue, white }) = header.shared_attributes.chromaticities else { return Ok(None) };
    let [red, green, blue, white] = [red, green, blue, white].map(|Vec2(x, y)| [f64::from(x), f64::from(y)]);
    let near = |(found, expected): ([f64; 2], [f64; 2])| (0..2).all(|k| (found[k] - expected[k]).abs() <= SAME_PRIMARY);
    if [red, green, blue].into_iter().zip(color::REC709).all(near) {
        return Ok(None);
    }
    let Some(matrix) = color::rgb_to_rec709([red, green, blue], white) else {
        return Err(format!(
            "its primaries, red {red:?}, green {green:?} and blue {blue:?} with white {white:?}, make no colours"
        ));
    };
    Ok(Some(matrix.as_mat3().into()))
}

/// The picture as it is stored.
fn decode_stored(name: &Path, bytes: &[u8]) -> Result<(Rgb, Header)> {
    let header = rgb_header(name, bytes)?;
    let reader = ::exr::prelude::read().no_deep_data().largest_resolution_level().rgb_channels(
        |size, _| Rgb::filled(size.width(), size.height(), [0.0; 3]),
        |picture, at, (r, g, b): (f32, f32, f32)| picture.pixels[at.y() * picture.width + at.x()] = [r, g, b],
    );
    let reader = reader.first_valid_layer().all_attributes().non_parallel();
    let image = open::guarded(name, bytes, |source| reader.from_buffered(source))?;
    Ok((image.layer_data.channel_data.pixels, header))
}

fn check_pixel_grid(header: &Header) -> std::result::Result<(), String> {
    match header.channels.list.iter().find(|c| c.sampling != Vec2(1, 1)) {
        Some(channel) => Err(format!("channel {} is subsampled", channel.name)),
        None => Ok(()),
    }
}

/// The channels of one layer of the table; none where the frame lacks the layer.
fn layer_channels(
    frame: &Frame,
    layer: &TableLayer,
    clamped: &mut usize,
) -> std::result::Result<Vec<AnyChannel<FlatSamples>>, String> {
    let components: Vec<Vec<f32>> = match &layer.field {
        Field::Id(access) => {
            let ids = (access.get)(frame).map(|ids| sized(frame, layer, ids)).transpose()?;
            return Ok(layer
                .channel_names()
                .zip(ids)
                .map(|(name, ids)| AnyChannel::new(name.as_str(), FlatSamples::U32(ids.pixels.clone())))
                .collect());
        }
        Field::Rgb(access) => split(frame, layer, access, |pixel: &[f32; 3], i| pixel[i])?,
        Field::Vec2(access) => split(frame, layer, access, |pixel: &[f32; 2], i| pixel[i])?,
        Field::Scalar(access) => split(frame, layer, access, |pixel: &f32, _| *pixel)?,
    };
    let mut channels = Vec::with_capacity(components.len());
    for (name, mut values) in layer.channel_names().zip(components) {
        check_values(&name, layer, frame.width, &values)?;
        let samples = match layer.storage {
            Storage::Half => {
                for value in values.iter_mut().filter(|v| v.abs() > HALF_MAX) {
                    *value = value.clamp(-HALF_MAX, HALF_MAX);
                    *clamped += 1;
                }
                let mut halves = vec![f16::ZERO; values.len()];
                halves.convert_from_f32_slice(&values);
                FlatSamples::F16(halves)
            }
            Storage::Float | Storage::Uint => FlatSamples::F32(values),
        };
        channels.push(AnyChannel::new(name.as_str(), samples));
    }
    Ok(channels)
}

/// One vector for each component of a layer; empty where the frame lacks the layer.
fn split<P>(
    frame: &Frame,
    layer: &TableLayer,
    access: &Access<Image<P>>,
    component: impl Fn(&P, usize) -> f32,
) -> std::result::Result<Vec<Vec<f32>>, String> {
    let Some(image) = (access.get)(frame) else { return Ok(Vec::new()) };
    let image = sized(frame, layer, image)?;
    Ok((0..layer.components.len()).map(|i| image.pixels.iter().map(|pixel| component(pixel, i)).collect()).collect())
}

pub(crate) fn sized<'a, P>(frame: &Frame, layer: &TableLayer, image: &'a Image<P>) -> std::result::Result<&'a Image<P>, String> {
    let pixels = frame.width * frame.height;
    if (image.width, image.height, image.pixels.len()) != (frame.width, frame.height, pixels) {
        return Err(format!(
            "channel {} is {} x {} with {} pixels in a frame of {} x {}",
            layer.channel_names().next().unwrap_or_default(),
            image.width,
            image.height,
            image.pixels.len(),
            frame.width,
            frame.height
        ));
    }
    Ok(image)
}

/// Refuses NaN, and infinities except +inf in depth (a miss).
pub(crate) fn check_values(name: &str, layer: &TableLayer, width: usize, values: &[f32]) -> std::result::Result<(), String> {
    let miss = layer.is_infinite_at_miss();
    match values.iter().position(|&v| !(v.is_finite() || miss && v == f32::INFINITY)) {
        Some(i) => Err(format!("channel {name} is {} at pixel ({}, {})", values[i], i % width, i / width)),
        None => Ok(()),
    }
}

/// Takes the channels of one layer of the table out of `channels` and stores them in `frame`.
fn read_layer(
    frame: &mut Frame,
    layer: &TableLayer,
    channels: &mut Vec<AnyChannel<FlatSamples>>,
) -> std::result::Result<(), String> {
    let mut found = Vec::new();
    let mut missing = None;
    for name in layer.channel_names() {
        match channels.iter().position(|channel| channel.name == *name.as_str()) {
            Some(at) => found.push((name, channels.swap_remove(at).sample_data)),
            None => missing = Some(name),
        }
    }
    if let Some(name) = missing {
        // A layer that has only some of its channels is damaged.
        return if layer.optional && found.is_empty() { Ok(()) } else { Err(format!("channel {name} is missing")) };
    }
    let (width, height) = (frame.width, frame.height);
    if let Field::Id(access) = &layer.field {
        for (name, samples) in found {
            let FlatSamples::U32(pixels) = samples else { return Err(format!("channel {name} is not of type uint")) };
            (access.set)(frame, Image { width, height, pixels });
        }
        return Ok(());
    }
    let mut values = Vec::with_capacity(found.len());
    for (name, samples) in found {
        let samples = match samples {
            FlatSamples::F16(halves) => halves.to_f32_vec(),
            FlatSamples::F32(floats) => floats,
            FlatSamples::U32(_) => return Err(format!("channel {name} is not of type half or float")),
        };
        check_values(&name, layer, width, &samples)?;
        values.push(samples);
    }
    match &layer.field {
        Field::Rgb(access) => {
            (access.set)(frame, Image::from_fn(width, height, |x, y| [0, 1, 2].map(|i| values[i][y * width + x])))
        }
        Field::Vec2(access) => {
            (access.set)(frame, Image::from_fn(width, height, |x, y| [0, 1].map(|i| values[i][y * width + x])))
        }
        Field::Scalar(access) => (access.set)(frame, Image { width, height, pixels: values.swap_remove(0) }),
        Field::Id(_) => {}
    }
    Ok(())
}
