//! Checks that the channels of a sequence agree with one another. Depth, cameras and moving objects are projected into the next
//! frame and compared with its motion vectors and depth; normals are compared with the slope of the depth.
//!
//! The checks find wrong conventions: distance instead of planar depth, flipped axes, world-space normals, motion with the wrong
//! sign, unit or direction, cameras of another frame.

use glam::{Vec2, Vec3, Vec3A};
use renderflow_frame::warp::correspond;
use renderflow_frame::{Camera, Frame, Image};
use serde::{Deserialize, Serialize};

/// A motion vector may differ from the projection by this many pixels ...
const MOTION_TOLERANCE: f32 = 0.05;
/// ... plus this share of its length: half floats have 11 bits, and the depth of compact files has a few more.
const MOTION_SHARE: f32 = 2e-3;
/// The largest share of motion vectors that may be off.
const MOTION_OFF: f64 = 1e-3;
/// Of the points that stay inside the picture, the next frame must show at least this share; the others are hidden there. In
/// pictures with fewer pixels on a side, too much is near an edge: of 20 sequences of 16 x 16 pixels, three showed 21 to 29 %.
const SEEN: f64 = 0.3;
const SEEN_FROM: usize = 32;
/// The largest median angle between normals and the slope of the depth, degrees. Textures and smooth shading bend normals.
const NORMAL_ANGLE: f64 = 25.0;
/// Normals are also wrong where another convention ([`RIVALS`]) makes that angle smaller by this many degrees.
const RIVAL: f64 = 2.0 * BIN;
/// At least this share of normals must face the camera. Smooth shading and normal maps turn a few of them away.
const FACING: f64 = 0.98;
/// A share is judged only over this many pixels or more.
const FEWEST: u64 = 256;
/// Width of the bins of angles, degrees.
const BIN: f64 = 2.5;

/// Turns normals of another convention into camera-space normals.
type Reading = fn(Vec3A, &Camera) -> Vec3A;

/// Other conventions that normals may be in by mistake.
const RIVALS: [(&str, Reading); 3] = [
    ("world space", |n, camera| camera.camera_to_world.matrix3.transpose() * n),
    ("y down", |n, _| n * Vec3A::new(1.0, -1.0, 1.0)),
    ("x to the left", |n, _| n * Vec3A::new(-1.0, 1.0, 1.0)),
];

/// Counts of pixels over a sequence.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Agreement {
    /// Motion vectors compared with the projection of the depth.
    pub motion: u64,
    /// Motion vectors that differ from it.
    pub motion_off: u64,
    /// Points that lie inside the next frame.
    pub projected: u64,
    /// Points that the next frame shows at their depth.
    pub seen: u64,
    /// Normals compared with the slope of the depth, by the angle between them, in bins of 2.5 degrees.
    pub angles: Vec<u64>,
    /// The same with normals read by each of the other conventions.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub rivals: Vec<Vec<u64>>,
    /// Covered pixels.
    pub covered: u64,
    /// Covered pixels whose normal faces the camera.
    pub facing: u64,
}

/// A frame, its camera and its number in the sequence.
#[derive(Clone, Copy)]
pub struct View<'a> {
    /// The frame.
    pub frame: &'a Frame,
    /// Camera of the sequence's description.
    pub camera: &'a Camera,
}

impl Agreement {
    /// Adds the counts of one frame by itself.
    pub fn add_frame(&mut self, view: View<'_>) {
        let (frame, camera) = (view.frame, view.camera);
        let (width, height) = (frame.width, frame.height);
        let bins = (180.0 / BIN) as usize;
        self.angles.resize(bins, 0);
        self.rivals.resize(RIVALS.len(), vec![0; bins]);
        let at = |x: usize, y: usize| {
            let depth = frame.depth.pixels[y * width + x];
            camera.direction_cam(Vec2::new(x as f32 + 0.5, y as f32 + 0.5)) * depth
        };
        for y in 0..height {
            for x in 0..width {
                let i = y * width + x;
                if !frame.depth.pixels[i].is_finite() {
                    continue;
                }
                let normal = Vec3A::from(frame.normal.pixels[i]);
                let view = camera.direction_cam(Vec2::new(x as f32 + 0.5, y as f32 + 0.5)).normalize();
                self.covered += 1;
                self.facing += u64::from(normal.dot(view) < 0.1);
                if x == 0 || y == 0 || x + 1 == width || y + 1 == height || !smooth(frame, x, y) {
                    continue;
                }
                let (across, up) = (at(x + 1, y) - at(x - 1, y), at(x, y - 1) - at(x, y + 1));
                let slope = across.cross(up).normalize_or_zero();
                let bin = |normal: Vec3A| {
                    let angle = f64::from(slope.dot(normal).clamp(-1.0, 1.0).acos().to_degrees());
                    ((angle / BIN) as usize).min(bins - 1)
                };
                self.angles[bin(normal)] += 1;
                for (counts, (_, read)) in self.rivals.iter_mut().zip(RIVALS) {
                    counts[bin(read(normal, camera))] += 1;
                }
            }
        }
    }

    /// Adds the counts of a frame and the next one. `objects` says how objects move from one to the other.
    pub fn add_pair(&mut self, this: View<'_>, next: View<'_>, objects: &renderflow_frame::warp::ObjectMotion<'_>) {
        let back = |id: u32| objects(id).map(|map| map.inverse());
        if let Some(motion) = &this.frame.motion {
            self.compare(this, next.camera, motion, objects);
        }
        if let Some(motion) = &next.frame.motion_prev {
            self.compare(next, this.camera, motion, &back);
        }
        if this.frame.width.min(this.frame.height) < SEEN_FROM {
            return;
        }
        let found = correspond(this.frame, next.frame, Some(objects));
        let inside = found.source.pixels.iter().filter(|p| **p != [0.0; 2]).count();
        self.projected += inside as u64;
        self.seen += found.valid.pixels.iter().filter(|v| **v >= 1.0).count() as u64;
    }

    fn compare(
        &mut self,
        view: View<'_>,
        other: &Camera,
        motion: &Image<[f32; 2]>,
        objects: &renderflow_frame::warp::ObjectMotion<'_>,
    ) {
        let (frame, camera) = (view.frame, view.camera);
        for (i, &depth) in frame.depth.pixels.iter().enumerate() {
            if !depth.is_finite() {
                continue;
            }
            let pixel = Vec2::new((i % frame.width) as f32 + 0.5, (i / frame.width) as f32 + 0.5);
            let mut p_world = camera.unproject(pixel, depth);
            if let Some(map) = objects(frame.object_id.pixels[i]) {
                p_world = map.transform_point3a(p_world);
            }
            let stored = Vec2::from(motion.pixels[i]);
            // A point that goes behind the camera has no place in the other picture.
            let Some((place, _)) = other.project(p_world) else { continue };
            let expected = place - pixel;
            // A point far outside of the other picture has none either.
            if expected.length() > 4.0 * (frame.width + frame.height) as f32 {
                continue;
            }
            self.motion += 1;
            let tolerance = MOTION_TOLERANCE + MOTION_SHARE * expected.length();
            self.motion_off += u64::from((stored - expected).length() > tolerance);
        }
    }

    /// Adds the counts of `other`.
    pub fn add(&mut self, other: &Self) {
        self.motion += other.motion;
        self.motion_off += other.motion_off;
        self.projected += other.projected;
        self.seen += other.seen;
        self.covered += other.covered;
        self.facing += other.facing;
        self.rivals.resize(self.rivals.len().max(other.rivals.len()), Vec::new());
        let rivals = self.rivals.iter_mut().zip(&other.rivals);
        for (counts, more) in std::iter::once((&mut self.angles, &other.angles)).chain(rivals) {
            counts.resize(counts.len().max(more.len()), 0);
            counts.iter_mut().zip(more).for_each(|(count, more)| *count += more);
        }
    }

    /// Median angle between normals and the slope of the depth, degrees; `None` where few pixels tell.
    pub fn median_angle(&self) -> Option<f64> {
        median(&self.angles)
    }

    /// Describes what is wrong with the normals.
    fn normals(&self) -> Option<String> {
        let angle = self.median_angle()?;
        let fitting = RIVALS.iter().zip(&self.rivals).filter_map(|((name, _), counts)| Some((name, median(counts)?)));
        let better = fitting.filter(|(_, other)| *other <= angle - RIVAL).min_by(|a, b| a.1.total_cmp(&b.1));
        let text = format!("normals differ from the slope of the depth by {angle:.0} degrees (median)");
        match better {
            Some((name, other)) => Some(format!("{text}, read as {name} by {other:.0}")),
            None => (angle > NORMAL_ANGLE).then_some(text),
        }
    }

    /// Describes what does not agree, one sentence each.
    pub fn faults(&self) -> Vec<String> {
        let share = |part: u64, whole: u64| (whole >= FEWEST).then(|| part as f64 / whole as f64);
        let mut faults = Vec::new();
        if let Some(off) = share(self.motion_off, self.motion).filter(|&off| off > MOTION_OFF) {
            faults.push(format!("{:.1} % of the motion vectors differ from the projection of the depth", 100.0 * off));
        }
        if let Some(seen) = share(self.seen, self.projected).filter(|&seen| seen < SEEN) {
            faults.push(format!("only {:.1} % of the projected points lie at the next frame's depth", 100.0 * seen));
        }
        faults.extend(self.normals());
        if let Some(facing) = share(self.facing, self.covered).filter(|&facing| facing < FACING) {
            faults.push(format!("only {:.1} % of the normals face the camera", 100.0 * facing));
        }
        faults
    }
}

/// Median of counts in bins of angles, degrees; `None` where there are too few.
fn median(counts: &[u64]) -> Option<f64> {
    let total: u64 = counts.iter().sum();
    let mut below = 0;
    let bin = counts.iter().position(|&count| {
        below += count;
        2 * below >= total
    })?;
    (total >= FEWEST).then_some((bin as f64 + 0.5) * BIN)
}

/// Whether the four neighbours of a pixel lie on the same surface, and the surface is almost flat there.
fn smooth(frame: &Frame, x: usize, y: usize) -> bool {
    let (width, i) = (frame.width, y * frame.width + x);
    let depth = frame.depth.pixels[i];
    let same = |j: usize| {
        frame.object_id.pixels[j] == frame.object_id.pixels[i]
            && frame.material_id.pixels[j] == frame.material_id.pixels[i]
            && frame.depth.pixels[j].is_finite()
            && Vec3::from(frame.normal.pixels[j]).dot(frame.normal.pixels[i].into()) > 0.95
    };
    // The inverse depth of a plane is linear in the picture, however steep the plane is.
    let inverse = |j: usize| depth / frame.depth.pixels[j];
    let bend = |a: usize, b: usize| (inverse(a) + inverse(b) - 2.0).abs() < 2e-3;
    let (left, right, above, below) = (i - 1, i + 1, i - width, i + width);
    [left, right, above, below].into_iter().all(same) && bend(left, right) && bend(above, below)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A plane seen from above at an angle, its normals turned aside by `bump` degrees one way and the other, then by
    /// `convention`.
    fn plane(bump: f32, convention: impl Fn(Vec3A, &Camera) -> Vec3A) -> Agreement {
        let camera = Camera::look_at(Vec3A::new(1.0, 0.5, 2.0), Vec3A::ZERO, Vec3A::Y, 0.8, 48, 48);
        let up = camera.camera_to_world.matrix3.transpose() * Vec3A::Y;
        let (sin, cos) = bump.to_radians().sin_cos();
        // Crosswise to the view: bumps that turn a normal away from the camera would count as facing away.
        let aside = up.cross(Vec3A::Z).normalize();
        let mut frame = Frame { width: 48, height: 48, ..Frame::default() };
        let ray = |x: usize, y: usize| camera.direction_cam(Vec2::new(x as f32 + 0.5, y as f32 + 0.5));
        let height = camera.camera_to_world.translation.y + 1.0;
        frame.depth = Image::from_fn(48, 48, |x, y| {
            let below = -ray(x, y).dot(up);
            if below > 1e-3 { height / below } else { f32::INFINITY }
        });
        frame.normal = Image::from_fn(48, 48, |x, _| {
            convention(up * cos + aside * if x / 8 % 2 == 0 { sin } else { -sin }, &camera).to_array()
        });
        frame.object_id = Image::filled(48, 48, 1);
        frame.material_id = Image::filled(48, 48, 1);
        let mut found = Agreement::default();
        found.add_frame(View { frame: &frame, camera: &camera });
        found
    }

    #[test]
    fn bumpy_normals_are_no_fault_and_wrong_ones_are_named() {
        for bump in [0.0, 5.0, 14.0, 20.0] {
            let found = plane(bump, |n, _| n);
            assert!((found.median_angle().unwrap() - f64::from(bump)).abs() <= BIN, "{:?}", found.median_angle());
            assert_eq!(found.faults(), Vec::<String>::new(), "{bump}");
            let world = plane(bump, |n, camera| camera.camera_to_world.matrix3 * n).faults().join("; ");
            // Under large bumps it shows in normals that face away.
            assert!(world.contains(if bump < 10.0 { "read as world space" } else { "normals" }), "{bump}: {world}");
            let down = plane(bump, |n, _| n * Vec3A::new(1.0, -1.0, 1.0)).faults().join("; ");
            assert!(down.contains("read as y down"), "{bump}: {down}");
        }
        assert!(plane(40.0, |n, _| n).faults().join("; ").contains("normals differ"));
    }
}
