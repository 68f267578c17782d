//! The content of a sample.

use super::super::sequence::Sequence;
use super::super::whole::key;
use super::{Frames, Kind, Planned};
use crate::util::files;
use anyhow::{Context, Result, ensure};
use renderflow_frame::frame_file::{self, Profile};
use renderflow_frame::transforms::{Matrix, rows};
use renderflow_frame::{Camera, Distortion, compact};
use serde::Serialize;
use serde::de::IgnoredAny;
use std::collections::BTreeMap;
use std::path::Path;

/// A file of a sample: its ending and its bytes.
pub type Member = (&'static str, Vec<u8>);

/// `seq-000123_0007.json`.
#[derive(Serialize)]
struct Frame<'a> {
    key: String,
    split: &'a str,
    sequence: &'a str,
    /// Number in the sequence, and how many stored frames come before it.
    frame: usize,
    index: usize,
    keyframe: bool,
    /// Samples a pixel; 0 = G-buffer only.
    spp: u32,
    denoiser: Option<&'a str>,
    seed: u64,
    scene_hash: &'a str,
    /// Factor from radiance to display-linear.
    exposure: f32,
    camera: CameraEntry,
    environment: Environment<'a>,
    /// Object id to rows of object-to-world; only objects that move. `null` for an object whose movement is unknown.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    object_transforms: BTreeMap<u32, Option<Matrix>>,
    /// Ending of the frame's file in the sample, its length and hash.
    file: &'a str,
    bytes: usize,
    blake3: String,
}

/// The keys of `transforms.json`.
#[derive(Serialize)]
struct CameraEntry {
    camera_model: &'static str,
    convention: &'static str,
    fl_x: f32,
    fl_y: f32,
    cx: f32,
    cy: f32,
    w: usize,
    h: usize,
    /// Coefficients of a lens that bends straight lines.
    #[serde(skip_serializing_if = "Option::is_none", flatten)]
    lens: Option<Distortion>,
    transform_matrix: Matrix,
}

impl CameraEntry {
    fn of(camera: &Camera) -> Self {
        Self {
            camera_model: if camera.distortion.is_some() { "FULL_OPENCV" } else { "PINHOLE" },
            convention: "opengl_c2w",
            fl_x: camera.fl_x,
            fl_y: camera.fl_y,
            cx: camera.cx,
            cy: camera.cy,
            w: camera.width,
            h: camera.height,
            lens: camera.distortion,
            transform_matrix: rows(camera.camera_to_world, camera.origin),
        }
    }
}

#[derive(Serialize)]
struct Environment<'a> {
    /// Sample of `<split>-sequences.tar` whose `.hdr` it is.
    key: &'a str,
    /// Radians about +Y.
    rotation: f32,
    intensity: f32,
}

fn read(path: &Path) -> Result<Vec<u8>> {
    std::fs::read(path).with_context(|| format!("{}: cannot read", path.display()))
}

fn hex(bytes: &[u8]) -> String {
    blake3::hash(bytes).to_hex().to_string()
}

/// Reads a file of a sequence, which must be the one in its record.
fn read_recorded(sequence: &Sequence, file: &str) -> Result<(Vec<u8>, String)> {
    let path = sequence.folder.join(file);
    let bytes = read(&path)?;
    let hash = hex(&bytes);
    if let Some(recorded) = sequence.record.as_ref().and_then(|record| record.hash_of(file)) {
        ensure!(hash == recorded, "{}: has BLAKE3 {hash}, sequence.json says {recorded}", path.display());
    }
    Ok((bytes, hash))
}

/// The files of a frame.
pub fn frame(sequence: &Sequence, index: usize, profile: Frames) -> Result<Vec<Member>> {
    let path = sequence.file(index);
    let (mut bytes, _) = read_recorded(sequence, &sequence.transforms.files[index])?;
    let info = frame_file::info(&path, &bytes)?;
    let is_compact = bytes.starts_with(&compact::SIGNATURE);
    if profile == Frames::Compact && !is_compact {
        bytes = compact::encode(&path, &frame_file::decode(&path, &bytes)?)?.0;
    }
    let form = if profile == Frames::Compact || is_compact { Profile::Compact } else { Profile::Full };
    let transforms = &sequence.transforms;
    let camera = transforms.cameras[index];
    let json = Frame {
        key: key(sequence, index),
        split: sequence.split.name(),
        sequence: &sequence.name,
        frame: sequence.numbers[index],
        index,
        keyframe: transforms.keyframes.contains(&index),
        spp: info.spp,
        denoiser: info.denoiser.as_deref(),
        seed: info.seed,
        scene_hash: &info.scene_hash,
        exposure: transforms.exposure,
        camera: CameraEntry::of(&camera),
        environment: Environment {
            key: &sequence.name,
            rotation: transforms.environment_rotation,
            intensity: transforms.environment_intensity,
        },
        object_transforms: (transforms.tracks.objects.iter())
            .map(|(&id, track)| (id, track.get(index).map(|&transform| rows(transform, camera.origin))))
            .collect(),
        file: form.extension(),
        bytes: bytes.len(),
        blake3: hex(&bytes),
    };
    let json = serde_json::to_vec(&json)?;
    Ok(vec![(form.extension(), bytes), ("json", json)])
}

/// The files of a sequence: its environment, and its descriptions as one object.
pub fn sequence(sequence: &Sequence) -> Result<Vec<Member>> {
    let (environment, hash) = read_recorded(sequence, &sequence.transforms.environment)?;
    let mut json =
        format!("{{\"key\": \"{}\", \"split\": \"{}\", \"environment\": \"{hash}\"", sequence.name, sequence.split).into_bytes();
    for (key, file) in [("scene", "scene.json"), ("transforms", "transforms.json"), ("sequence", "sequence.json")] {
        if file == "sequence.json" && sequence.record.is_none() {
            continue;
        }
        let (text, _) = read_recorded(sequence, file)?;
        // The description's own bytes are used, so that hashes and numbers stay the same. A broken file must not break the
        // sample.
        serde_json::from_slice::<IgnoredAny>(&text).with_context(|| sequence.folder.join(file).display().to_string())?;
        json.extend_from_slice(format!(", \"{key}\": ").as_bytes());
        json.extend_from_slice(text.trim_ascii());
    }
    json.extend_from_slice(b"}");
    let ending = if sequence.transforms.environment.ends_with(".exr") { "exr" } else { "hdr" };
    Ok(vec![(ending, environment), ("json", json)])
}

/// Hash of everything that a shard is made from. Recorded hashes are trusted here, where a shard is only compared with an earlier
/// one; files that are written were read and compared.
pub fn source_hash(planned: &Planned, profile: Frames) -> Result<String> {
    let mut hasher = blake3::Hasher::new();
    let mut put = |text: &str| {
        hasher.update(&(text.len() as u64).to_le_bytes());
        hasher.update(text.as_bytes());
    };
    put(concat!("renderflow ", env!("CARGO_PKG_VERSION"), " shard 1"));
    put(if profile == Frames::Compact { "compact" } else { "stored" });
    let hash_of = |sequence: &Sequence, file: &str| -> Result<String> {
        let path = sequence.folder.join(file);
        ensure!(path.is_file(), "{}: is not there", path.display());
        let recorded = sequence.record.as_ref().and_then(|record| record.hash_of(file));
        recorded.map_or_else(|| files::hash(&path), |hash| Ok(hash.to_owned()))
    };
    let mut last: Option<&Sequence> = None;
    for &(sequence, index) in &planned.samples {
        if last.is_none_or(|last| !std::ptr::eq(last, sequence)) {
            put(&sequence.name);
            put(&hash_of(sequence, "transforms.json")?);
            // Earlier versions left both out of the descriptions of frames, so such shards are written again.
            let transforms = &sequence.transforms;
            let bent = transforms.cameras.iter().any(|camera| camera.distortion.is_some());
            if planned.kind == Kind::Frames && (bent || transforms.tracks.objects.values().any(Vec::is_empty)) {
                put("lens, unknown movement");
            }
            last = Some(sequence);
        }
        match planned.kind {
            Kind::Frames => {
                put(&key(sequence, index));
                put(&hash_of(sequence, &sequence.transforms.files[index])?);
            }
            Kind::Sequences => {
                put(&hash_of(sequence, &sequence.transforms.environment)?);
                put(&hash_of(sequence, "scene.json")?);
                if sequence.record.is_some() {
                    put(&hash_of(sequence, "sequence.json")?);
                }
            }
        }
    }
    Ok(hasher.finalize().to_hex().to_string())
}
