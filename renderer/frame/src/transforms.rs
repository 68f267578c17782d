//! `transforms.json`: the cameras of a sequence in nerfstudio's format, with the convention stated in the file.
//!
//! Matrices are rows of camera-to-world in OpenGL axes and pixel centres lie at +0.5, which is nerfstudio's own convention; the
//! world's up axis is +Y here but +Z in nerfstudio. `camera_angle_x` (radians) is what 3D Gaussian Splatting's loader asks for.

use crate::file::{json, parse_json, write_atomic};
use crate::reach::plain_name;
use crate::tracks::Tracks;
use crate::{Camera, Distortion, Error, Result};
use glam::{Affine3A, DVec3, Mat3A, Vec3A};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// The cameras of one sequence, and the files of its frames.
#[derive(Clone, Debug, PartialEq)]
pub struct Sequence {
    /// Camera of each frame.
    pub cameras: Vec<Camera>,
    /// File of each frame beside `transforms.json`: a plain name.
    pub files: Vec<String>,
    /// Indices of the keyframes.
    pub keyframes: Vec<usize>,
    /// Exposure factor of the sequence.
    pub exposure: f32,
    /// Environment map beside `transforms.json`: a plain name.
    pub environment: String,
    /// Rotation of the environment, radians about +Y.
    pub environment_rotation: f32,
    /// Gain of the environment.
    pub environment_intensity: f32,
    /// Transforms of the objects that move, one for each frame, or none where the movement is unknown.
    pub tracks: Tracks,
}

/// Axes of the matrices in the file.
const CONVENTION: &str = "opengl_c2w";
/// Names of cameras without and with distortion.
const MODELS: [&str; 2] = ["PINHOLE", "FULL_OPENCV"];

/// The content of the file. Intrinsics stand at the top where all frames share them, and otherwise in each frame (nerfstudio
/// reads both).
#[derive(Serialize, Deserialize)]
struct File {
    camera_model: String,
    convention: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    camera_angle_x: Option<f64>,
    #[serde(flatten)]
    intrinsics: Intrinsics,
    exposure: f32,
    environment: EnvironmentEntry,
    keyframes: Vec<usize>,
    /// Point that the reader counts positions from, for sequences far from the world's origin. The matrices stay in world space.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    origin: Option<DVec3>,
    frames: Vec<FrameEntry>,
    /// Rows of object-to-world by object id, one matrix for each frame; only for objects that move. The list is empty for an
    /// object whose movement is unknown.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    object_transforms: BTreeMap<u32, Vec<Matrix>>,
}

/// Rows of a 4x4 matrix.
pub type Matrix = [[f64; 4]; 4];

#[derive(Serialize, Deserialize)]
struct EnvironmentEntry {
    file: String,
    /// Radians about +Y.
    rotation: f32,
    intensity: f32,
}

#[derive(Serialize, Deserialize)]
struct FrameEntry {
    file_path: String,
    #[serde(flatten)]
    intrinsics: Intrinsics,
    transform_matrix: Matrix,
}

#[derive(Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
struct Intrinsics {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    fl_x: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    fl_y: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    cx: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    cy: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    w: Option<usize>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    h: Option<usize>,
    /// Coefficients of [`Distortion`], in the order of its names; those that are 0 are left out.
    #[serde(flatten)]
    lens: Lens,
}

macro_rules! lens {
    ($($name:ident)*) => {
        #[derive(Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
        struct Lens {
            $(#[serde(default, skip_serializing_if = "Option::is_none")]
            $name: Option<f64>,)*
        }

        impl Lens {
            fn of(lens: &Distortion) -> Self {
                Self { $($name: Some(lens.$name).filter(|v| *v != 0.0),)* }
            }

            /// The coefficients, those that are missing from `common`.
            fn or(&self, common: &Self) -> Option<Distortion> {
                let lens = Distortion { $($name: self.$name.or(common.$name).unwrap_or_default(),)* };
                (lens != Distortion::default()).then_some(lens)
            }
        }
    };
}
lens!(k1 k2 k3 k4 k5 k6 p1 p2);

impl Intrinsics {
    fn of(camera: &Camera) -> Self {
        Self {
            fl_x: Some(camera.fl_x),
            fl_y: Some(camera.fl_y),
            cx: Some(camera.cx),
            cy: Some(camera.cy),
            w: Some(camera.width),
            h: Some(camera.height),
            lens: camera.distortion.as_ref().map(Lens::of).unwrap_or_default(),
        }
    }
}

/// Writes `transforms.json`.
///
/// # Errors
/// When cameras and files differ in number, a matrix is not rigid, a keyframe does not exist, a number is not finite, or the file
/// cannot be written.
pub fn write(path: &Path, sequence: &Sequence) -> Result<()> {
    write_atomic(path, &encode(path, sequence)?)
}

/// The bytes of `transforms.json`; errors give `name` as the path.
///
/// # Errors
/// As [`write()`], except that no file is written.
pub fn encode(name: &Path, sequence: &Sequence) -> Result<Vec<u8>> {
    let malformed = |reason: String| Error::malformed(name, reason);
    if sequence.cameras.len() != sequence.files.len() {
        return Err(malformed(format!("{} cameras for {} files", sequence.cameras.len(), sequence.files.len())));
    }
    check(sequence).map_err(malformed)?;
    let origin = sequence.cameras.first().map_or(DVec3::ZERO, |camera| camera.origin);
    let first = sequence.cameras.first().map(Intrinsics::of).unwrap_or_default();
    let shared = sequence.cameras.iter().all(|camera| Intrinsics::of(camera) == first);
    let frames = sequence.cameras.iter().zip(&sequence.files).map(|(camera, file)| FrameEntry {
        file_path: file.clone(),
        intrinsics: if shared { Intrinsics::default() } else { Intrinsics::of(camera) },
        transform_matrix: rows(camera.camera_to_world, origin),
    });
    let file = File {
        camera_model: MODELS[usize::from(sequence.cameras.iter().any(|camera| camera.distortion.is_some()))].into(),
        convention: CONVENTION.into(),
        camera_angle_x: sequence
            .cameras
            .first()
            .filter(|_| shared)
            .map(|c| 2.0 * (0.5 * c.width as f64 / f64::from(c.fl_x)).atan()),
        intrinsics: if shared { first } else { Intrinsics::default() },
        exposure: sequence.exposure,
        environment: EnvironmentEntry {
            file: sequence.environment.clone(),
            rotation: sequence.environment_rotation,
            intensity: sequence.environment_intensity,
        },
        keyframes: sequence.keyframes.clone(),
        origin: (origin != DVec3::ZERO).then_some(origin),
        frames: frames.collect(),
        object_transforms: (sequence.tracks.objects.iter())
            .map(|(&id, track)| (id, track.iter().map(|&transform| rows(transform, origin)).collect()))
            .collect(),
    };
    json(name, &file)
}

/// Reads `transforms.json`.
///
/// # Errors
/// When the file cannot be read or lacks a key (the message names it), or as in [`write()`].
pub fn read(path: &Path) -> Result<Sequence> {
    decode(path, &crate::file::read_at_most(path, crate::file::LARGEST_TEXT)?)
}

/// [`read`] from memory; errors give `name` as the path.
///
/// # Errors
/// As [`read`].
pub fn decode(name: &Path, json: &[u8]) -> Result<Sequence> {
    let malformed = |reason: String| Error::malformed(name, reason);
    let file: File = parse_json(name, json)?;
    if file.convention != CONVENTION {
        return Err(malformed(format!("/convention is {:?}, only {CONVENTION:?} is read", file.convention)));
    }
    if !MODELS.contains(&file.camera_model.as_str()) {
        let [pinhole, distorted] = MODELS;
        return Err(malformed(format!("/camera_model is {:?}, only {pinhole:?} and {distorted:?} are read", file.camera_model)));
    }
    let origin = file.origin.unwrap_or_default();
    let cameras = file.frames.iter().enumerate().map(|(index, frame)| camera(&file, frame, index));
    let sequence = Sequence {
        cameras: cameras.collect::<std::result::Result<_, _>>().map_err(malformed)?,
        files: file.frames.iter().map(|frame| frame.file_path.clone()).collect(),
        keyframes: file.keyframes,
        exposure: file.exposure,
        environment: file.environment.file,
        environment_rotation: file.environment.rotation,
        environment_intensity: file.environment.intensity,
        tracks: Tracks {
            objects: (file.object_transforms.into_iter())
                .map(|(id, track)| (id, track.into_iter().map(|rows| affine(rows, origin)).collect()))
                .collect(),
        },
    };
    check(&sequence).map_err(malformed)?;
    Ok(sequence)
}

fn camera(file: &File, frame: &FrameEntry, index: usize) -> std::result::Result<Camera, String> {
    let (own, common) = (&frame.intrinsics, &file.intrinsics);
    let missing = |key: &str| format!("missing key {key}, neither at the top nor in /frames/{index}");
    let rows = frame.transform_matrix;
    if rows[3] != [0.0, 0.0, 0.0, 1.0] {
        return Err(format!("/frames/{index}/transform_matrix: the last row is {:?}, not [0, 0, 0, 1]", rows[3]));
    }
    Ok(Camera {
        camera_to_world: affine(rows, file.origin.unwrap_or_default()),
        origin: file.origin.unwrap_or_default(),
        fl_x: own.fl_x.or(common.fl_x).ok_or_else(|| missing("fl_x"))?,
        fl_y: own.fl_y.or(common.fl_y).ok_or_else(|| missing("fl_y"))?,
        cx: own.cx.or(common.cx).ok_or_else(|| missing("cx"))?,
        cy: own.cy.or(common.cy).ok_or_else(|| missing("cy"))?,
        width: own.w.or(common.w).ok_or_else(|| missing("w"))?,
        height: own.h.or(common.h).ok_or_else(|| missing("h"))?,
        distortion: own.lens.or(&common.lens),
    })
}

/// Rows of the world-space matrix of a transform relative to `origin`, as the file holds them in `transform_matrix`.
pub fn rows(transform: Affine3A, origin: DVec3) -> Matrix {
    // The shortest decimal that reads back as the same single-precision number, instead of 17 digits.
    let short = |v: f32| v.to_string().parse().unwrap_or(f64::from(v));
    let mut rows = glam::Mat4::from(transform).transpose().to_cols_array_2d().map(|row| row.map(short));
    if origin != DVec3::ZERO {
        for (row, (shift, at)) in rows.iter_mut().zip(origin.to_array().into_iter().zip(transform.translation.to_array())) {
            row[3] = shift + f64::from(at);
        }
    }
    rows
}

/// Inverse of [`rows`].
fn affine(rows: Matrix, origin: DVec3) -> Affine3A {
    let column = |i: usize| Vec3A::new(rows[0][i] as f32, rows[1][i] as f32, rows[2][i] as f32);
    let translation = DVec3::new(rows[0][3], rows[1][3], rows[2][3]) - origin;
    Affine3A { matrix3: Mat3A::from_cols(column(0), column(1), column(2)), translation: translation.as_vec3a() }
}

fn check(sequence: &Sequence) -> std::result::Result<(), String> {
    plain_name(&sequence.environment).map_err(|reason| format!("/environment/file: {reason}"))?;
    for (index, file) in sequence.files.iter().enumerate() {
        plain_name(file).map_err(|reason| format!("/frames/{index}/file_path: {reason}"))?;
    }
    let finite = |key: &str, value: f32| if value.is_finite() { Ok(()) } else { Err(format!("{key} is {value}")) };
    finite("/exposure", sequence.exposure)?;
    finite("/environment/rotation", sequence.environment_rotation)?;
    finite("/environment/intensity", sequence.environment_intensity)?;
    for (index, camera) in sequence.cameras.iter().enumerate() {
        if camera.origin != sequence.cameras[0].origin {
            return Err(format!(
                "frame {index} counts positions from {}, frame 0 from {}",
                camera.origin, sequence.cameras[0].origin
            ));
        }
        if let Some(c) = camera.distortion.iter().flat_map(Distortion::coefficients).find(|c| !c.is_finite()) {
            return Err(format!("a coefficient of the lens of frame {index} is {c}"));
        }
        if !camera.camera_to_world.is_finite() || !camera.origin.is_finite() {
            return Err(format!("/frames/{index}/transform_matrix holds NaN or infinity"));
        }
        // A scaled or mirrored matrix would silently give wrong depths and motion.
        let rotation = camera.camera_to_world.matrix3;
        if !(rotation.transpose() * rotation).abs_diff_eq(Mat3A::IDENTITY, 1e-3) || rotation.determinant() < 0.0 {
            return Err(format!("/frames/{index}/transform_matrix is not a rotation and a translation"));
        }
        for (key, value) in [("fl_x", camera.fl_x), ("fl_y", camera.fl_y)] {
            finite(&format!("{key} of frame {index}"), value)?;
            if value <= 0.0 {
                return Err(format!("{key} of frame {index} is {value}, not above 0"));
            }
        }
        finite(&format!("cx of frame {index}"), camera.cx)?;
        finite(&format!("cy of frame {index}"), camera.cy)?;
        if camera.width == 0 || camera.height == 0 {
            return Err(format!("frame {index} is {} x {} pixels", camera.width, camera.height));
        }
    }
    for (id, track) in &sequence.tracks.objects {
        if !track.is_empty() && track.len() != sequence.cameras.len() {
            return Err(format!("/object_transforms/{id}: {} matrices for {} frames", track.len(), sequence.cameras.len()));
        }
        if let Some(index) = track.iter().position(|transform| !transform.is_finite()) {
            return Err(format!("/object_transforms/{id}/{index} holds NaN or infinity"));
        }
    }
    match sequence.keyframes.iter().find(|&&key| key >= sequence.cameras.len()) {
        Some(key) => Err(format!("/keyframes: {key} is no frame, there are {}", sequence.cameras.len())),
        None => Ok(()),
    }
}
