//! Finds out what a file is and whether this program can use it, for `renderflow check`.
//!
//! The content decides the kind, since endings may be wrong or missing. The ending only decides where the content could be
//! several things. A file that is accepted was read in full, by the same code that uses it.

mod data;
mod picture;
mod scene;

use crate::util::files;
use anyhow::{Context, Result, bail};
use renderflow_frame::reach::Reach;
use renderflow_frame::{compact, file};
use renderflow_scenes::load::Format;
use serde::Serialize;
use serde::de::IgnoredAny;
use serde_json::Value;
use std::collections::HashMap;
use std::io::Read;
use std::path::{Path, PathBuf};

/// What a file is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// A scene description.
    Scene,
    /// A dataset plan.
    Plan,
    /// Cameras of a sequence.
    Transforms,
    /// glTF, as text or binary.
    Gltf,
    /// Wavefront OBJ.
    Obj,
    /// Stanford PLY.
    Ply,
    /// An environment map, Radiance or OpenEXR.
    Map,
    /// A frame with its channels, OpenEXR or compact.
    Frame,
    /// An image for textures: PNG, JPEG or WebP.
    Texture,
    /// Weights of a network.
    Weights,
    /// Weights of LPIPS.
    Lpips,
    /// A folder of sequences.
    Dataset,
}

impl Kind {
    /// As the JSON form writes it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Scene => "scene",
            Self::Plan => "plan",
            Self::Transforms => "transforms",
            Self::Gltf => "gltf",
            Self::Obj => "obj",
            Self::Ply => "ply",
            Self::Map => "map",
            Self::Frame => "frame",
            Self::Texture => "texture",
            Self::Weights => "weights",
            Self::Lpips => "lpips",
            Self::Dataset => "dataset",
        }
    }
}

/// What an accepted file holds.
#[derive(Debug, Default)]
pub struct Counts {
    /// Name and value, in the order to show them.
    pub counts: Vec<(&'static str, Value)>,
    /// Notes for the user, one sentence each.
    pub notes: Vec<String>,
}

impl Counts {
    fn add(&mut self, name: &'static str, value: impl Into<Value>) {
        self.counts.push((name, value.into()));
    }
}

/// The kind of a file, if it was found, and what the file holds or why it is refused.
#[derive(Debug)]
pub struct Inspected {
    /// `None` for kinds that this program does not know.
    pub kind: Option<Kind>,
    /// Counts, or the reason with the place in the file.
    pub verdict: Result<Counts>,
}

/// Reads the file or folder `path` in full. A scene or model may name files in its own folder and in the folders `allowed`.
pub fn inspect(path: &Path, allowed: &[PathBuf]) -> Inspected {
    let kind = match kind(path) {
        Ok(kind) => kind,
        Err(error) => return Inspected { kind: None, verdict: Err(error) },
    };
    let verdict = match kind {
        Kind::Scene => scene::scene(path, &Reach::of(path).allow(allowed)),
        Kind::Gltf | Kind::Obj | Kind::Ply => scene::model(path, &Reach::of(path).allow(allowed)),
        Kind::Plan => data::plan(path),
        Kind::Transforms => data::transforms(path),
        Kind::Map => picture::map(path),
        Kind::Frame => picture::frame(path),
        Kind::Texture => picture::texture(path),
        Kind::Weights => data::weights(path),
        Kind::Lpips => data::lpips(path),
        Kind::Dataset => data::dataset(path),
    };
    Inspected { kind: Some(kind), verdict }
}

/// The kind is found from this many bytes at the start of a file.
const HEAD: usize = 1 << 16;

/// Finds the kind of a file or folder.
fn kind(path: &Path) -> Result<Kind> {
    if path.is_dir() {
        return Ok(Kind::Dataset);
    }
    let mut head = Vec::with_capacity(HEAD);
    file::open(path)?.take(HEAD as u64).read_to_end(&mut head).with_context(|| format!("{}: cannot read", path.display()))?;
    let ending = files::ending(path);
    if let Some(kind) = by_signature(path, &head)? {
        return Ok(kind);
    }
    let text = head.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&head).trim_ascii_start();
    if text.starts_with(b"{") {
        return json_kind(path, &ending);
    }
    match Format::sniff(text) {
        Some(Format::Obj) => return Ok(Kind::Obj),
        Some(Format::Ply) => return Ok(Kind::Ply),
        _ => {}
    }
    let by_ending = match ending.as_str() {
        "json" => Some(Kind::Scene),
        "toml" => Some(Kind::Plan),
        "gltf" | "glb" => Some(Kind::Gltf),
        "obj" => Some(Kind::Obj),
        "ply" => Some(Kind::Ply),
        "hdr" | "exr" => Some(Kind::Map),
        compact::EXTENSION => Some(Kind::Frame),
        "png" | "jpg" | "jpeg" | "webp" => Some(Kind::Texture),
        "safetensors" => Some(Kind::Weights),
        _ => None,
    };
    if let Some(kind) = by_ending {
        return Ok(kind);
    }
    if head.is_empty() {
        bail!("{}: the file is empty", path.display());
    }
    bail!(
        "{}: unknown kind of file; known: scene, plan and transforms JSON, glTF, GLB, OBJ, PLY, HDR, EXR, RFF, PNG, JPEG, safetensors, dataset folder",
        path.display()
    )
}

/// Binary formats, by their first bytes.
fn by_signature(path: &Path, head: &[u8]) -> Result<Option<Kind>> {
    const EXR: &[u8] = &[0x76, 0x2f, 0x31, 0x01];
    let starts = |signature: &[u8]| head.starts_with(signature);
    Ok(if starts(b"glTF") {
        Some(Kind::Gltf)
    } else if starts(EXR) {
        // Frames carry a G-buffer; anything else may be a map.
        Some(if picture::is_frame(head) { Kind::Frame } else { Kind::Map })
    } else if starts(&compact::SIGNATURE) {
        Some(Kind::Frame)
    } else if starts(b"#?") {
        Some(Kind::Map)
    } else if starts(b"\x89PNG") || starts(&[0xff, 0xd8, 0xff]) {
        Some(Kind::Texture)
    } else if head.get(8) == Some(&b'{') && head.first_chunk().is_some_and(|l| u64::from_le_bytes(*l) < 1 << 32) {
        // A length and a JSON header: safetensors.
        Some(if data::is_lpips(path)? { Kind::Lpips } else { Kind::Weights })
    } else {
        None
    })
}

/// Finds which JSON format a file holds, by its top-level keys.
fn json_kind(path: &Path, ending: &str) -> Result<Kind> {
    let keys = match file::read_json::<HashMap<String, IgnoredAny>>(path) {
        Ok(keys) => keys,
        // The JSON is broken, and its reader will say where. Only the ending is left to go by.
        Err(_) if ending == "gltf" => return Ok(Kind::Gltf),
        Err(_) if path.file_stem().is_some_and(|stem| stem == "transforms") => return Ok(Kind::Transforms),
        Err(_) => return Ok(Kind::Scene),
    };
    let has = |key: &str| keys.contains_key(key);
    Ok(if has("asset") {
        Kind::Gltf
    } else if has("sequences") && has("render") {
        Kind::Plan
    } else if has("camera_model") || (has("frames") && ["convention", "camera_angle_x", "fl_x"].into_iter().any(has)) {
        Kind::Transforms
    } else if ending == "gltf" {
        Kind::Gltf
    } else {
        Kind::Scene
    })
}
