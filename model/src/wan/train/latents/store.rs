//! Latents in files, one for each clip and size.

use super::{ClipLatents, FrameLatents, SecondLatents};
use crate::data::Clip;
use crate::parameters;
use crate::wan::pictures::Kind;
use crate::wan::vae::Vae;
use crate::weights::{open, write_safetensors};
use crate::{Error, Result};
use half::f16;
use safetensors::tensor::{Dtype, SafeTensors};
use serde::{Deserialize, Serialize};
use std::collections::hash_map::DefaultHasher;
use std::hash::{Hash, Hasher};
use std::path::{Path, PathBuf};

/// A folder of latents that one autoencoder made. The name of a file is a digest of its inputs, so that runs can share a folder.
#[derive(Clone, Debug)]
pub struct Store {
    folder: PathBuf,
    /// Digest of the autoencoder's weights and statistics.
    autoencoder: u64,
}

/// The header of a file.
#[derive(Serialize, Deserialize)]
struct Header {
    shape: [usize; 2],
    stride: usize,
    /// For each frame its index, its number, and whether a clip begins with it.
    #[serde(rename = "anchors")]
    frames: Vec<(usize, usize, bool)>,
}

impl Store {
    /// The latents that `vae` made, in `folder`.
    pub fn new(folder: &Path, vae: &Vae) -> Self {
        let mut hasher = DefaultHasher::new();
        let floats = |values: &[f32], hasher: &mut DefaultHasher| values.iter().for_each(|v| v.to_bits().hash(hasher));
        for parameter in parameters::export(vae) {
            parameter.name.hash(&mut hasher);
            floats(&parameter.values, &mut hasher);
        }
        let config = vae.config();
        floats(&config.latents_mean, &mut hasher);
        floats(&config.latents_std, &mut hasher);
        Self { folder: folder.into(), autoencoder: hasher.finish() }
    }

    /// The file of a clip. Its name depends on everything that the latents depend on.
    pub(super) fn file(&self, clip: &Clip, settings: &[usize]) -> PathBuf {
        let mut hasher = DefaultHasher::new();
        (self.autoencoder, settings, &clip.numbers, clip.light.exposure().to_bits()).hash(&mut hasher);
        let mut pixels = |picture: &[[f32; 3]]| picture.iter().for_each(|p| p.map(f32::to_bits).hash(&mut hasher));
        pixels(&clip.light.environment.map.pixels);
        for frame in &clip.frames {
            [&frame.albedo, &frame.normal, &frame.material].into_iter().for_each(|image| pixels(&image.pixels));
            frame.beauty.iter().for_each(|image| pixels(&image.pixels));
        }
        clip.shaded.iter().for_each(|image| pixels(&image.pixels));
        for frame in &clip.frames {
            frame.depth.pixels.iter().for_each(|v| v.to_bits().hash(&mut hasher));
        }
        let environment = &clip.light.environment;
        (environment.rotation.to_bits(), environment.intensity.to_bits()).hash(&mut hasher);
        for frame in &clip.frames {
            frame.info.camera.camera_to_world.to_cols_array().map(f32::to_bits).hash(&mut hasher);
        }
        let plain = |c: char| if c.is_ascii_alphanumeric() || c == '-' { c } else { '_' };
        let name: String = clip.name.chars().rev().take(48).map(plain).collect();
        let name: String = name.chars().rev().collect();
        self.folder.join(format!("{name}-{:016x}.safetensors", hasher.finish()))
    }
}

fn name(part: &str, frame: usize, kind: Kind) -> String {
    format!("{part}/{frame}/{}", kind.name())
}

/// Writes latents without the pictures that are kept beside them.
pub(super) fn write(path: &Path, latents: &ClipLatents) -> Result<()> {
    let mut entries: Vec<(String, &[f16])> = vec![("grey".into(), &latents.grey)];
    for (i, frame) in latents.frames.iter().enumerate() {
        entries.extend(Kind::ALL.map(|kind| (name("first", i, kind), frame.kinds[kind as usize].as_slice())));
        if let Some(next) = &frame.next {
            entries.extend(Kind::ALL.map(|kind| (name("second", i, kind), next.kinds[kind as usize].as_slice())));
            entries.push((format!("reference/{i}"), &next.reference));
        }
    }
    let header = Header {
        shape: [latents.height, latents.width],
        stride: latents.stride,
        frames: latents.frames.iter().map(|frame| (frame.index, frame.number, frame.next.is_some())).collect(),
    };
    let header = serde_json::to_string(&header).map_err(|e| Error::malformed(path, e.to_string()))?;
    let shapes: Vec<[usize; 1]> = entries.iter().map(|(_, values)| [values.len()]).collect();
    let tensors = entries.iter().zip(&shapes);
    let tensors =
        tensors.map(|((name, values), shape)| (name.as_str(), Dtype::F16, shape.as_slice(), bytemuck::cast_slice(values)));
    Ok(renderflow_frame::file::write_atomic(path, &write_safetensors(path, &header, tensors)?)?)
}

/// Reads what [`write`] wrote; `None` when there is no file.
pub(super) fn read(path: &Path) -> Result<Option<ClipLatents>> {
    let bytes = match renderflow_frame::file::read(path) {
        Ok(bytes) => bytes,
        Err(error) if error.is_missing() => return Ok(None),
        Err(error) => return Err(error.into()),
    };
    let (tensors, header) = open(path, &bytes)?;
    let header: Header = serde_json::from_str(&header)
        .map_err(|e| Error::malformed(path, format!("header: {}", renderflow_frame::words::plain(&e.to_string()))))?;
    let [height, width] = header.shape;
    let plane = height.saturating_mul(width);
    let values = |name: &str| halves(path, &tensors, name, plane);
    let kinds = |part: &str, i: usize| -> Result<[Vec<f16>; 6]> {
        let mut all: [Vec<f16>; 6] = Default::default();
        for kind in Kind::ALL {
            all[kind as usize] = values(&name(part, i, kind))?;
        }
        Ok(all)
    };
    let mut frames = Vec::with_capacity(header.frames.len());
    for (i, &(index, number, clip)) in header.frames.iter().enumerate() {
        let second =
            || Ok::<_, Error>(SecondLatents { kinds: kinds("second", i)?, reference: values(&format!("reference/{i}"))? });
        let next = clip.then(second).transpose()?;
        frames.push(FrameLatents { index, number, kinds: kinds("first", i)?, next });
    }
    let grey = values("grey")?;
    Ok(Some(ClipLatents { height, width, stride: header.stride, frames, grey, ..ClipLatents::default() }))
}

/// The values of a tensor, which must be whole planes.
fn halves(path: &Path, tensors: &SafeTensors, name: &str, plane: usize) -> Result<Vec<f16>> {
    let broken = |reason: &str| Error::Tensor { path: path.into(), tensor: name.into(), reason: reason.into() };
    let view = tensors.tensor(name).map_err(|_| broken("missing"))?;
    if view.dtype() != Dtype::F16 {
        return Err(broken("not of half precision"));
    }
    let values: Vec<f16> = view.data().chunks_exact(2).map(|b| f16::from_le_bytes([b[0], b[1]])).collect();
    match values.len().checked_rem(plane) {
        Some(0) if values.iter().all(|v| v.is_finite()) => Ok(values),
        Some(0) => Err(broken("holds NaN or infinity")),
        _ => Err(broken("not of whole planes")),
    }
}
