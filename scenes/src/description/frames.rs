//! Cameras with intrinsics of their own, as photographs and other programs give them.

use super::exact;
use glam::{DMat3, DVec2, DVec3};
use renderflow_frame::words::number;
use renderflow_frame::{Camera, Distortion};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The camera of one frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CameraFrame {
    /// Rows of camera-to-world: a rotation and, in the last column, the position in metres. Camera space is OpenGL's: +x right,
    /// +y up, the view along -z.
    #[serde(serialize_with = "rows")]
    pub camera_to_world: [[f64; 4]; 3],
    /// Focal length along x, pixels, > 0.
    #[serde(serialize_with = "exact::number")]
    #[schemars(range(min = 1e-3, max = 1e9))]
    pub fl_x: f64,
    /// Focal length along y, pixels, > 0.
    #[serde(serialize_with = "exact::number")]
    #[schemars(range(min = 1e-3, max = 1e9))]
    pub fl_y: f64,
    /// Principal point, pixels from the left edge.
    #[serde(serialize_with = "exact::number")]
    #[schemars(range(min = -1e6, max = 1e6))]
    pub cx: f64,
    /// Principal point, pixels from the top edge.
    #[serde(serialize_with = "exact::number")]
    #[schemars(range(min = -1e6, max = 1e6))]
    pub cy: f64,
    /// How the lens bends straight lines, in OpenCV's coefficients; not at all without it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(with = "Option<Coefficients>")]
    pub distortion: Option<Distortion>,
}

/// How a lens bends straight lines: OpenCV's coefficients, each 0 by default.
#[derive(JsonSchema)]
#[schemars(rename = "Distortion", deny_unknown_fields)]
#[expect(dead_code, reason = "only its schema is used")]
struct Coefficients {
    /// Radial coefficients, numerator.
    #[schemars(default, range(min = -1e3, max = 1e3))]
    k1: f64,
    /// As k1, of the fourth power.
    #[schemars(default, range(min = -1e3, max = 1e3))]
    k2: f64,
    /// As k1, of the sixth power.
    #[schemars(default, range(min = -1e3, max = 1e3))]
    k3: f64,
    /// Radial coefficients, denominator.
    #[schemars(default, range(min = -1e3, max = 1e3))]
    k4: f64,
    /// As k4, of the fourth power.
    #[schemars(default, range(min = -1e3, max = 1e3))]
    k5: f64,
    /// As k4, of the sixth power.
    #[schemars(default, range(min = -1e3, max = 1e3))]
    k6: f64,
    /// Tangential coefficient, along x.
    #[schemars(default, range(min = -1e3, max = 1e3))]
    p1: f64,
    /// Tangential coefficient, along y.
    #[schemars(default, range(min = -1e3, max = 1e3))]
    p2: f64,
}

fn rows<S: serde::Serializer>(rows: &[[f64; 4]; 3], serializer: S) -> Result<S::Ok, S::Error> {
    struct Row([f64; 4]);
    impl Serialize for Row {
        fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
            serializer.collect_seq(self.0.map(exact::Number))
        }
    }
    serializer.collect_seq(rows.map(Row))
}

/// Places along each edge of a picture at which a lens is tried.
const BORDER: u32 = 64;

/// Two pictures have the same shape where one edge follows from the other up to this many pixels.
const ROUNDING: f64 = 0.501;

/// Whether a picture of `resolution` has the shape of one of `size`, up to the rounding to whole pixels.
pub fn same_shape(resolution: [u32; 2], size: [u32; 2]) -> bool {
    let ([w, h], [sw, sh]) = (resolution.map(f64::from), size.map(f64::from));
    (h - w * sh / sw).abs() <= ROUNDING || (w - h * sw / sh).abs() <= ROUNDING
}

impl CameraFrame {
    /// Camera axes in the world.
    pub(crate) fn rotation(&self) -> DMat3 {
        let [x, y, z] = self.camera_to_world;
        DMat3::from_cols_array_2d(&[0, 1, 2].map(|column| [x[column], y[column], z[column]]))
    }

    /// Position in the world, metres.
    pub(crate) fn position(&self) -> DVec3 {
        DVec3::from(self.camera_to_world.map(|row| row[3]))
    }

    /// Why the lens cannot be used for pictures of `size`: it shows nothing at some place of their border.
    pub(crate) fn folds(&self, size: [u32; 2]) -> Option<String> {
        let lens = self.distortion.as_ref()?;
        let [width, height] = size.map(f64::from);
        let along = |i: u32| f64::from(i) / f64::from(BORDER);
        let border = (0..=BORDER).flat_map(|i| {
            let (x, y) = (along(i) * width, along(i) * height);
            [[x, 0.0], [x, height], [0.0, y], [width, y]]
        });
        let nothing =
            |&[x, y]: &[f64; 2]| lens.undistort(DVec2::new((x - self.cx) / self.fl_x, (y - self.cy) / self.fl_y)).is_none();
        let [x, y] = border.into_iter().find(nothing)?.map(number);
        Some(format!("the lens shows nothing at ({x}, {y}) of the picture: its distortion folds there"))
    }

    /// The camera for a picture of `resolution`, where the numbers of this one are for `size`; placed relative to `origin`.
    pub(crate) fn camera(&self, size: [u32; 2], resolution: [u32; 2], origin: DVec3) -> Camera {
        let [sx, sy] = [0, 1].map(|i| f64::from(resolution[i]) / f64::from(size[i].max(1)));
        let [width, height] = resolution.map(|edge| edge as usize);
        let mut camera = Camera { origin, width, height, ..Camera::default() };
        camera.camera_to_world.matrix3 = self.rotation().as_mat3().into();
        camera.camera_to_world.translation = (self.position() - origin).as_vec3a();
        camera.fl_x = (self.fl_x * sx) as f32;
        camera.fl_y = (self.fl_y * sy) as f32;
        camera.cx = (self.cx * sx) as f32;
        camera.cy = (self.cy * sy) as f32;
        camera.distortion = self.distortion;
        camera
    }
}
