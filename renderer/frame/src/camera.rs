//! A pinhole camera, whose lens may bend straight lines. Camera space is OpenGL's: +x right, +y up, the view along -z. Pixel
//! centres lie at +0.5.

use crate::distortion::Distortion;
use glam::{Affine3A, DVec2, DVec3, Mat3A, Vec2, Vec3A};
use serde::{Deserialize, Serialize};

/// Pinhole camera of one frame; `camera_to_world` is rigid (no scale).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Camera space (OpenGL axes) to world space relative to [`Self::origin`], metres.
    pub camera_to_world: Affine3A,
    /// The point of the world that all positions are counted from, metres: zero unless the sequence lies so far out that single
    /// precision would lose its digits (see [`near_origin`]). All cameras and objects of a sequence share it.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub origin: DVec3,
    /// Focal length in pixels along x.
    pub fl_x: f32,
    /// Focal length in pixels along y.
    pub fl_y: f32,
    /// Principal point, pixels from the left edge of the image.
    pub cx: f32,
    /// Principal point, pixels from the top edge of the image.
    pub cy: f32,
    /// Image width in pixels.
    pub width: usize,
    /// Image height in pixels.
    pub height: usize,
    /// How the lens bends straight lines; `None` = not at all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub distortion: Option<Distortion>,
}

impl Default for Camera {
    /// A camera at the world's origin with a picture without pixels.
    fn default() -> Self {
        Self {
            camera_to_world: Affine3A::IDENTITY,
            origin: DVec3::ZERO,
            fl_x: 1.0,
            fl_y: 1.0,
            cx: 0.0,
            cy: 0.0,
            width: 0,
            height: 0,
            distortion: None,
        }
    }
}

fn is_zero(v: &DVec3) -> bool {
    *v == DVec3::ZERO
}

/// The point that positions of a sequence are counted from, for a camera at `eye` that looks at something `reach` metres away:
/// zero where single precision places the camera to a millionth of the reach, and otherwise the camera.
pub fn near_origin(eye: DVec3, reach: f64) -> DVec3 {
    if eye.length() <= 16.0 * reach { DVec3::ZERO } else { eye }
}

impl Camera {
    /// A camera at `eye` looking at `target`; `vertical_fov` in radians, principal point in the middle.
    /// Where `up` is parallel to the view direction, another axis replaces it.
    pub fn look_at(eye: Vec3A, target: Vec3A, up: Vec3A, vertical_fov: f32, width: usize, height: usize) -> Self {
        let back = (eye - target).normalize_or(Vec3A::Z);
        let right = up.cross(back).try_normalize().unwrap_or_else(|| back.any_orthonormal_vector());
        let rotation = Mat3A::from_cols(right, back.cross(right), back);
        let focal = 0.5 * height as f32 / (0.5 * vertical_fov).tan();
        Self {
            camera_to_world: Affine3A { matrix3: rotation, translation: eye },
            origin: DVec3::ZERO,
            fl_x: focal,
            fl_y: focal,
            cx: 0.5 * width as f32,
            cy: 0.5 * height as f32,
            width,
            height,
            distortion: None,
        }
    }

    /// Whether every number is finite.
    pub(crate) fn is_finite(&self) -> bool {
        self.camera_to_world.is_finite()
            && self.origin.is_finite()
            && [self.fl_x, self.fl_y, self.cx, self.cy].iter().all(|v| v.is_finite())
            && self.distortion.iter().flat_map(Distortion::coefficients).all(f64::is_finite)
    }

    /// Camera position, relative to [`Self::origin`].
    pub fn position(&self) -> Vec3A {
        self.camera_to_world.translation
    }

    /// Camera position in the world.
    pub fn position_in_world(&self) -> DVec3 {
        self.origin + self.position().as_dvec3()
    }

    /// Direction (camera space, z = -1, not normalised) through the image point `pixel` (pixels from the top left). Where the
    /// lens shows nothing, it is the direction of a pinhole camera.
    #[inline]
    pub fn direction_cam(&self, pixel: Vec2) -> Vec3A {
        let straight = Vec3A::new((pixel.x - self.cx) / self.fl_x, (self.cy - pixel.y) / self.fl_y, -1.0);
        match &self.distortion {
            None => straight,
            Some(lens) => bent(lens, straight),
        }
    }

    /// Unit direction in world space through the image point `pixel`.
    #[inline]
    pub fn ray_direction(&self, pixel: Vec2) -> Vec3A {
        (self.camera_to_world.matrix3 * self.direction_cam(pixel)).normalize()
    }

    /// Image point and planar depth (metres along -z) of a point relative to [`Self::origin`]; `None` behind or in the camera
    /// plane.
    pub fn project(&self, p_world: Vec3A) -> Option<(Vec2, f32)> {
        let p_cam = self.world_to_camera().transform_point3a(p_world);
        let depth = -p_cam.z;
        if let Some(lens) = &self.distortion {
            let shown = lens.distort(DVec2::new(p_cam.x.into(), (-p_cam.y).into()) / f64::from(depth)).as_vec2();
            return (depth > 0.0).then(|| (Vec2::new(self.cx + self.fl_x * shown.x, self.cy + self.fl_y * shown.y), depth));
        }
        (depth > 0.0).then(|| (Vec2::new(self.cx + self.fl_x * p_cam.x / depth, self.cy - self.fl_y * p_cam.y / depth), depth))
    }

    /// Point, relative to [`Self::origin`], at planar depth `depth` metres behind the image point `pixel`.
    pub fn unproject(&self, pixel: Vec2, depth: f32) -> Vec3A {
        self.camera_to_world.transform_point3a(self.direction_cam(pixel) * depth)
    }

    /// World space relative to [`Self::origin`] to camera space.
    pub fn world_to_camera(&self) -> Affine3A {
        self.camera_to_world.inverse()
    }

    /// The same view at another resolution (intrinsics scaled).
    pub fn resized(&self, width: usize, height: usize) -> Self {
        let (sx, sy) = (width as f32 / self.width as f32, height as f32 / self.height as f32);
        Self { fl_x: self.fl_x * sx, fl_y: self.fl_y * sy, cx: self.cx * sx, cy: self.cy * sy, width, height, ..*self }
    }
}

/// The direction that appears where a pinhole camera would show `straight`.
#[inline(never)]
fn bent(lens: &Distortion, straight: Vec3A) -> Vec3A {
    let shown = DVec2::new(straight.x.into(), (-straight.y).into());
    lens.undistort(shown).map_or(straight, |p| Vec3A::new(p.x as f32, -p.y as f32, -1.0))
}
