//! Cameras of `transforms.json`, as nerfstudio and instant-ngp write them, and as this program does.

use crate::description::{CameraFrame, CameraPath};
use crate::error::{Error, Result};
use crate::validate::{MAX_CENTRE, MAX_COEFFICIENT, MAX_COORDINATE, MAX_FRAMES, MAX_RESOLUTION, MAX_VALUE, MIN_FOCAL};
use glam::{DAffine3, DMat3, DVec3};
use renderflow_frame::words::{number, shortened};
use renderflow_frame::{Distortion, file};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Axes of the matrices of this program's own files, which it names there.
const CONVENTION: &str = "opengl_c2w";
/// Camera models that are read: pinholes, and lenses whose distortion is OpenCV's.
const MODELS: [&str; 6] = ["PINHOLE", "SIMPLE_PINHOLE", "OPENCV", "FULL_OPENCV", "RADIAL", "SIMPLE_RADIAL"];
/// Angles that a picture may span, radians.
const ANGLES: std::ops::RangeInclusive<f64> = 1e-4..=3.1;
/// The model with all of OpenCV's coefficients, and those that only it has.
const FULL: &str = "FULL_OPENCV";
const RATIONAL: [&str; 3] = ["k4", "k5", "k6"];
/// Range of the coefficients of lens distortion.
const COEFFICIENTS: std::ops::RangeInclusive<f64> = -MAX_COEFFICIENT..=MAX_COEFFICIENT;
/// Largest cosine between two axes of a camera, whose matrix may be rounded in the file.
const SLANT: f64 = 1e-3;
/// Differences from a rotation that come from single precision.
const ROUNDED: f64 = 1e-6;

#[derive(Deserialize)]
struct File {
    convention: Option<String>,
    frames: Vec<Frame>,
    #[serde(flatten)]
    lens: Lens,
}

#[derive(Deserialize)]
struct Frame {
    transform_matrix: Vec<Vec<f64>>,
    #[serde(flatten)]
    lens: Lens,
}

/// Values that stand at the top, for all frames, or in a frame.
#[derive(Default, Deserialize)]
struct Lens {
    camera_model: Option<String>,
    is_fisheye: Option<bool>,
    distortion_params: Option<Vec<f64>>,
    /// Numbers by their names; other names are not looked at.
    #[serde(flatten)]
    numbers: BTreeMap<String, serde_json::Value>,
}

impl Lens {
    fn number(&self, path: &Path, place: &str, key: &str) -> Result<Option<f64>> {
        match self.numbers.get(key) {
            None | Some(serde_json::Value::Null) => Ok(None),
            Some(value) => match value.as_f64() {
                Some(value) => Ok(Some(value)),
                None => Err(Error::model(path, format!("{place}/{key}"), "a number is needed")),
            },
        }
    }

    /// Refuses cameras that are none of [`MODELS`].
    fn check(&self, path: &Path, place: &str) -> Result<()> {
        const ADVICE: &str = "undistort the pictures first (COLMAP's image_undistorter and OpenCV's undistort do it), and use the \
cameras that belong to the result";
        let fail = |key: &str, reason: String| Err(Error::model(path, format!("{place}/{key}"), reason));
        if let Some(model) = self.camera_model.as_deref().filter(|model| !MODELS.contains(model)) {
            return fail("camera_model", format!("{:?} is not a camera that is read; {ADVICE}", shortened(model)));
        }
        if self.is_fisheye == Some(true) {
            return fail("is_fisheye", format!("a fisheye is not read; {ADVICE}"));
        }
        if self.distortion_params.iter().flatten().any(|value| *value != 0.0) {
            let names = Distortion::NAMES.join(", ");
            return fail("distortion_params", format!("they have no names; {names} are read"));
        }
        Ok(())
    }
}

/// Numbers of a camera, where they are known.
#[derive(Clone, Copy, Debug)]
struct Intrinsics {
    focal: [Option<f64>; 2],
    /// Whole angles along x and y, radians.
    angle: [Option<f64>; 2],
    center: [Option<f64>; 2],
    distortion: Option<Distortion>,
}

/// The cameras of a `transforms.json`.
///
/// Matrices are camera-to-world in OpenGL axes and are used as they stand: in the world of the scene, or in the coordinates of a
/// model file. `applied_transform` and what else a file says about its world are not looked at, and no file is opened that it
/// names.
#[derive(Clone, Debug)]
pub struct Capture {
    path: PathBuf,
    frames: Vec<(DAffine3, Intrinsics)>,
    size: Option<[u32; 2]>,
    in_world: bool,
}

impl Capture {
    /// Reads the file.
    ///
    /// # Errors
    /// When it cannot be read, has no or too many frames, or when a camera cannot be used: it is a fisheye, its
    /// matrix is mirrored, slanted or flat, or a number is missing, not finite or out of range. The message names the place.
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = file::read_at_most(path, file::LARGEST_TEXT)?;
        let file: File = file::parse_json(path, &bytes)?;
        drop(bytes);
        let fail = |place: &str, reason: String| Err(Error::model(path, place, reason));
        if let Some(other) = file.convention.as_deref().filter(|convention| *convention != CONVENTION) {
            return fail("/convention", format!("{:?} is not {CONVENTION:?}, which is read", shortened(other)));
        }
        if file.frames.is_empty() || file.frames.len() > MAX_FRAMES as usize {
            return fail("/frames", format!("has {} cameras; 1 to {MAX_FRAMES} are needed", file.frames.len()));
        }
        file.lens.check(path, "")?;
        let mut size = None;
        let mut frames = Vec::with_capacity(file.frames.len());
        for (index, frame) in file.frames.iter().enumerate() {
            let place = format!("/frames/{index}");
            frame.lens.check(path, &place)?;
            let read = |key: &str, range: std::ops::RangeInclusive<f64>| -> Result<Option<f64>> {
                let own = frame.lens.number(path, &place, key)?.map(|value| (format!("{place}/{key}"), value));
                let common = file.lens.number(path, "", key)?.map(|value| (format!("/{key}"), value));
                let Some((place, value)) = own.or(common) else { return Ok(None) };
                if range.contains(&value) {
                    return Ok(Some(value));
                }
                let (low, high) = (number(*range.start()), number(*range.end()));
                Err(Error::model(path, place, format!("{} is outside {low}..={high}", number(value))))
            };
            let edges = 1.0..=f64::from(MAX_RESOLUTION);
            let edges = [read("w", edges.clone())?, read("h", edges)?];
            if let Some(fraction) = edges.into_iter().flatten().find(|edge| edge.fract() != 0.0) {
                return fail(&place, format!("a picture cannot have {} pixels along an edge", number(fraction)));
            }
            let own = match edges {
                [Some(width), Some(height)] => Some([width as u32, height as u32]),
                _ => None,
            };
            if index > 0 && own != size {
                let pixels = |size: Option<[u32; 2]>| size.map_or("no size".into(), |[w, h]| format!("{w} x {h} pixels"));
                let reason = format!("has {}, frame 0 has {}; all frames need one size", pixels(own), pixels(size));
                return fail(&place, reason);
            }
            size = own;
            let pair = |keys: [&str; 2], range: std::ops::RangeInclusive<f64>| -> Result<[Option<f64>; 2]> {
                Ok([read(keys[0], range.clone())?, read(keys[1], range)?])
            };
            let intrinsics = Intrinsics {
                focal: pair(["fl_x", "fl_y"], MIN_FOCAL..=f64::from(MAX_VALUE))?,
                angle: pair(["camera_angle_x", "camera_angle_y"], ANGLES)?,
                center: pair(["cx", "cy"], -MAX_CENTRE..=MAX_CENTRE)?,
                distortion: {
                    let mut coefficients = [0.0; 8];
                    let model = frame.lens.camera_model.as_ref().or(file.lens.camera_model.as_ref());
                    for (coefficient, name) in coefficients.iter_mut().zip(Distortion::NAMES) {
                        *coefficient = read(name, COEFFICIENTS)?.unwrap_or(0.0);
                        // nerfstudio's k4 is another number than OpenCV's.
                        if *coefficient != 0.0 && RATIONAL.contains(&name) && model.is_none_or(|model| model != FULL) {
                            let reason =
                                format!("programs disagree about {name}; OpenCV's is read where camera_model is {FULL:?}");
                            return fail(&place, reason);
                        }
                    }
                    Distortion::new(coefficients)
                },
            };
            if intrinsics.focal.iter().chain(&intrinsics.angle).all(Option::is_none) {
                return fail(&place, "neither fl_x nor camera_angle_x is there, and not at the top either".into());
            }
            if size.is_none() && intrinsics.focal.iter().chain(&intrinsics.center).any(Option::is_some) {
                return fail(&place, "w and h are missing, which its pixels are counted by".into());
            }
            let pose = rigid(&frame.transform_matrix)
                .map_err(|reason| Error::model(path, format!("{place}/transform_matrix"), reason))?;
            frames.push((pose, intrinsics));
        }
        Ok(Self { path: path.to_owned(), frames, size, in_world: file.convention.is_some() })
    }

    /// Number of cameras; at least one.
    #[expect(clippy::len_without_is_empty, reason = "it is never empty")]
    pub fn len(&self) -> usize {
        self.frames.len()
    }

    /// Columns and rows of the pictures, where the file says them.
    pub fn size(&self) -> Option<[u32; 2]> {
        self.size
    }

    /// Whether the matrices are in the world of a scene, as those that this program writes are, and not in the coordinates of a
    /// model file.
    pub fn in_world(&self) -> bool {
        self.in_world
    }

    /// The cameras for a scene with pictures of `resolution`, which matters where the file does not say the size of its own.
    /// `placement` is where the scene shows the model that the cameras were captured around; identity for cameras in the world.
    ///
    /// # Errors
    /// When the placement carries a camera out of every range, or a lens shows nothing at the border of its picture.
    pub fn path(&self, resolution: [u32; 2], placement: DAffine3) -> Result<CameraPath> {
        let size = self.size.unwrap_or(resolution);
        let [width, height] = size.map(f64::from);
        let frames = self.frames.iter().enumerate().map(|(index, (pose, own))| {
            let place = format!("/frames/{index}/transform_matrix");
            let carried = placement * *pose;
            let axes = orthonormal(carried.matrix3).map_err(|reason| Error::model(&self.path, &place, reason))?;
            if carried.translation.abs().max_element().partial_cmp(&MAX_COORDINATE).is_none_or(|order| order.is_gt()) {
                let reason = format!("the camera is further than {} metres from the middle", number(MAX_COORDINATE));
                return Err(Error::model(&self.path, &place, reason));
            }
            let wide = |angle: f64, edge: f64| 0.5 * edge / (0.5 * angle).tan();
            let [x, y] = [0, 1].map(|i| own.focal[i].or(own.angle[i].map(|angle| wide(angle, [width, height][i]))));
            // One of them is there, and pixels are square unless both are.
            let fl_x = x.or(y).unwrap_or(width);
            let fl_y = y.unwrap_or(fl_x);
            let row = |i: usize| [axes.x_axis[i], axes.y_axis[i], axes.z_axis[i], carried.translation[i]];
            let camera = CameraFrame {
                camera_to_world: [0, 1, 2].map(row),
                fl_x: fl_x.max(MIN_FOCAL),
                fl_y: fl_y.max(MIN_FOCAL),
                cx: own.center[0].unwrap_or(0.5 * width),
                cy: own.center[1].unwrap_or(0.5 * height),
                distortion: own.distortion,
            };
            match camera.folds(size) {
                None => Ok(camera),
                Some(reason) => Err(Error::model(&self.path, format!("/frames/{index}"), reason)),
            }
        });
        Ok(CameraPath::Frames { size, frames: frames.collect::<Result<_>>()? })
    }
}

/// A camera-to-world matrix as a rotation and a translation.
fn rigid(rows: &[Vec<f64>]) -> std::result::Result<DAffine3, String> {
    if !matches!(rows.len(), 3 | 4) || rows.iter().any(|row| row.len() != 4) {
        return Err("4 rows of 4 numbers are needed".into());
    }
    if rows.iter().flatten().any(|value| !value.is_finite()) {
        return Err("a number is not finite".into());
    }
    if rows.get(3).is_some_and(|last| **last != [0.0, 0.0, 0.0, 1.0]) {
        return Err(format!("the last row is {:?}, not [0, 0, 0, 1]", rows[3]));
    }
    let column = |i: usize| DVec3::new(rows[0][i], rows[1][i], rows[2][i]);
    let matrix3 = orthonormal(DMat3::from_cols(column(0), column(1), column(2)))?;
    let translation = column(3);
    if translation.abs().max_element() > MAX_COORDINATE {
        return Err(format!("the camera is further than {} from the origin", number(MAX_COORDINATE)));
    }
    Ok(DAffine3 { matrix3, translation })
}

/// The axes without their scale and rounding.
fn orthonormal(axes: DMat3) -> std::result::Result<DMat3, String> {
    // What single precision rounded stays as it stands, so that cameras of this program come back in every bit.
    if (axes.transpose() * axes).abs_diff_eq(DMat3::IDENTITY, ROUNDED) && axes.determinant() > 0.0 {
        return Ok(axes);
    }
    let unit = |v: DVec3| {
        // In two steps: the square of a small number may have no digits.
        let largest = v.abs().max_element();
        if largest > 0.0 && largest.is_finite() { Ok((v / largest).normalize()) } else { Err("an axis of the camera is zero") }
    };
    let [x, y, z] = [unit(axes.x_axis)?, unit(axes.y_axis)?, unit(axes.z_axis)?];
    let slant = x.dot(y).abs().max(y.dot(z).abs()).max(z.dot(x).abs());
    if slant > SLANT {
        return Err("it is no rotation: the axes of the camera are not at right angles".into());
    }
    if x.cross(y).dot(z) < 0.0 {
        return Err("it mirrors: the axes of the camera are left-handed".into());
    }
    // The view is kept, then what is up.
    let right = y.cross(z).normalize();
    Ok(DMat3::from_cols(right, z.cross(right), z))
}
