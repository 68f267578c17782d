//! The camera that the page moves, in the form that scene files have. What the page does not change stays as the scene has it:
//! the lens, the principal point, and the motion of a camera that was not moved.

use super::state::{FIELDS, State, Viewpoint, fitting};
use glam::{DMat3, DVec3};
use renderflow_scenes::description::{CameraFrame, CameraPath, Pose, Scene, same_shape};

/// The camera of the first frame as the page sees it.
pub fn viewpoint(scene: &Scene) -> Viewpoint {
    let (Pose { eye, target, up }, vertical_fov) = scene.camera.pose(0);
    // A camera with its own focal length may lie outside; its focal length stays while the page does not change the field.
    Viewpoint { eye, target, up, vertical_fov: vertical_fov.clamp(*FIELDS.start(), *FIELDS.end()) }
}

/// Columns and rows of what is saved: the scene's own while the page shows the scene's own size.
pub fn resolution(scene: &Scene, state: &State) -> [u32; 2] {
    if state.resolution == fitting(scene.resolution) { scene.resolution } else { state.resolution }
}

/// The camera that is shown. Only its first frame counts, because the page holds the camera still.
pub fn shown(scene: &Scene, state: &State) -> CameraPath {
    path(scene, state, state.resolution, 1)
}

/// The camera that is saved.
pub fn saved(scene: &Scene, state: &State) -> CameraPath {
    path(scene, state, resolution(scene, state), usize::MAX)
}

/// The camera of `state` for pictures of `resolution`, with `most` frames of its own at most.
fn path(scene: &Scene, state: &State, resolution: [u32; 2], most: usize) -> CameraPath {
    let home = viewpoint(scene);
    let moved = state.camera != home;
    match &scene.camera {
        CameraPath::Frames { size, frames } if !frames.is_empty() => {
            let frames = &frames[..if moved { 1 } else { frames.len().min(most) }];
            let placed = |frame: &CameraFrame| if moved { placed(frame, &home, &state.camera) } else { frame.clone() };
            if same_shape(resolution, *size) {
                return CameraPath::Frames { size: *size, frames: frames.iter().map(placed).collect() };
            }
            let cut = |frame: &CameraFrame| cut(placed(frame), *size, resolution);
            CameraPath::Frames { size: resolution, frames: frames.iter().map(cut).collect() }
        }
        whole if !moved => whole.clone(),
        _ => {
            let Viewpoint { eye, target, up, vertical_fov } = state.camera;
            CameraPath::Poses { poses: vec![Pose { eye, target, up }], vertical_fov }
        }
    }
}

/// `frame` at the place of `camera`. Its focal lengths change as the field of view does between `home` and `camera`.
fn placed(frame: &CameraFrame, home: &Viewpoint, camera: &Viewpoint) -> CameraFrame {
    let (eye, up) = (DVec3::from(camera.eye), glam::Vec3::from(camera.up).as_dvec3());
    let back = (eye - DVec3::from(camera.target)).normalize_or(DVec3::Z);
    let right = up.cross(back).try_normalize().unwrap_or_else(|| back.any_orthonormal_vector());
    let axes = DMat3::from_cols(right, back.cross(right), back).transpose();
    let half = |view: &Viewpoint| (0.5 * f64::from(view.vertical_fov).to_radians()).tan();
    let nearer = half(home) / half(camera);
    let row = |axis: DVec3, place: f64| [axis.x, axis.y, axis.z, place];
    CameraFrame {
        camera_to_world: [row(axes.x_axis, eye.x), row(axes.y_axis, eye.y), row(axes.z_axis, eye.z)],
        fl_x: frame.fl_x * nearer,
        fl_y: frame.fl_y * nearer,
        ..frame.clone()
    }
}

/// `frame` for pictures of `resolution`, which has another shape than `size`: the largest part of that shape about the middle. So
/// no place of the picture lies outside of what the lens shows.
fn cut(frame: CameraFrame, size: [u32; 2], resolution: [u32; 2]) -> CameraFrame {
    let ([w, h], [width, height]) = (size.map(f64::from), resolution.map(f64::from));
    let scale = (width / w).max(height / h);
    CameraFrame {
        fl_x: frame.fl_x * scale,
        fl_y: frame.fl_y * scale,
        cx: 0.5 * width + (frame.cx - 0.5 * w) * scale,
        cy: 0.5 * height + (frame.cy - 0.5 * h) * scale,
        ..frame
    }
}

#[cfg(test)]
mod tests {
    use super::super::stage::home;
    use super::*;
    use crate::dataset::source::SceneSource;
    use renderflow_frame::distortion::Distortion;

    /// A scene with two cameras that have a lens of their own.
    fn captured() -> Scene {
        let source = SceneSource { seed: Some(5), resolution: Some([48, 40]), frames: Some(3), ..SceneSource::default() };
        let mut scene = source.describe(&[]).unwrap().scene;
        let home = viewpoint(&scene);
        let lens = Distortion { k1: -0.1, p2: 0.003, ..Distortion::default() };
        let plain = CameraFrame {
            camera_to_world: [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]],
            fl_x: 100.0,
            fl_y: 104.0,
            cx: 44.0,
            cy: 41.0,
            distortion: Some(lens),
        };
        let frames = [home.eye, home.eye.map(|v| v + 0.5)].map(|eye| placed(&plain, &home, &Viewpoint { eye, ..home.clone() }));
        scene.camera = CameraPath::Frames { size: [96, 80], frames: frames.into() };
        scene.validate().unwrap();
        scene
    }

    #[test]
    fn a_camera_keeps_its_lens_wherever_it_goes() {
        let scene = captured();
        let mut state = home(&scene);
        state.camera.eye[1] += 0.7;
        let before = scene.camera.at(0, [48, 40]);
        for path in [shown(&scene, &state), saved(&scene, &state)] {
            let camera = path.at(0, [48, 40]);
            assert!(camera.distortion.is_some() && camera.distortion == before.distortion);
            for (now, then) in [(camera.fl_x, before.fl_x), (camera.fl_y, before.fl_y), (camera.cx, 22.0), (camera.cy, 20.5)] {
                assert!((now - then).abs() < 1e-4, "{now} {then}");
            }
            let (pose, _) = path.pose(0);
            let off = |a: [f64; 3], b: [f64; 3]| (DVec3::from(a) - DVec3::from(b)).length();
            assert!(off(pose.eye, state.camera.eye) < 1e-9);
            let ahead = |eye: [f64; 3], target: [f64; 3]| (DVec3::from(target) - DVec3::from(eye)).normalize().to_array();
            assert!(off(ahead(pose.eye, pose.target), ahead(state.camera.eye, state.camera.target)) < 1e-6);
            Scene { camera: path, ..scene.clone() }.validate().unwrap();
        }
        // Half the field of view doubles the focal lengths and nothing else.
        let half = f64::from(state.camera.vertical_fov).to_radians() / 2.0;
        state.camera.vertical_fov = (2.0 * (half.tan() / 2.0).atan()).to_degrees() as f32;
        let camera = shown(&scene, &state).at(0, [48, 40]);
        assert!(
            (camera.fl_x / before.fl_x - 2.0).abs() < 1e-4 && (camera.cx, camera.distortion) == (before.cx, before.distortion)
        );
    }

    #[test]
    fn a_camera_that_was_not_moved_stays_as_it_is() {
        let captured = captured();
        let mut orbit = captured.clone();
        orbit.camera = CameraPath::Orbit {
            target: [0.0; 3],
            distance: 4.0,
            elevation: 20.0,
            azimuth: 0.0,
            degrees_per_frame: 3.0,
            vertical_fov: 40.0,
        };
        // Larger than the page shows.
        orbit.resolution = [4096, 2048];
        for scene in [captured, orbit] {
            let mut state = home(&scene);
            state.rotation += 20.0;
            assert_eq!((saved(&scene, &state), resolution(&scene, &state)), (scene.camera.clone(), scene.resolution));
            let small = [48, 40];
            assert_eq!(shown(&scene, &state).at(0, small), scene.camera.at(0, small));
        }
    }

    #[test]
    fn a_picture_of_another_shape_is_a_part_of_what_the_lens_shows() {
        let scene = captured();
        let mut state = home(&scene);
        for (size, moved) in [([64, 64], false), ([512, 128], true), ([128, 512], true)] {
            state.resolution = size;
            state.camera.eye[0] += if moved { 0.1 } else { 0.0 };
            let path = saved(&scene, &state);
            let camera = path.at(0, size);
            let [w, h] = size.map(|edge| edge as f32);
            let before = scene.camera.at(0, [96, 80]);
            // The middle of the picture stays, and pixels keep their shape.
            assert!(
                (camera.direction_cam(glam::vec2(w / 2.0, h / 2.0)) - before.direction_cam(glam::vec2(48.0, 40.0))).length()
                    < 1e-4
            );
            assert!((camera.fl_x / camera.fl_y - before.fl_x / before.fl_y).abs() < 1e-5);
            let CameraPath::Frames { frames, .. } = &path else { panic!("{path:?}") };
            assert_eq!(frames.len(), if moved { 1 } else { 2 });
            Scene { camera: path, resolution: resolution(&scene, &state), ..scene.clone() }.validate().unwrap();
        }
    }
}
