//! nerfstudio: `OUT/<split>/seq-000123/{transforms.json, images, depths, masks}`, as its `nerfstudio_dataparser.py` reads them
//! (commit 50e0e3c, 2025-07): camera-to-world in OpenGL axes, the world's +Z up, pixel centres at +0.5.
//!
//! Depths are planar, 16 bits, millimetres; 0 = unknown: a miss, or beyond 65.535 m. Masks are white where the picture shows a
//! surface that stands still, black where it shows the sky or a moving object, which a static scene cannot explain.

use super::picture::{byte, png};
use super::{Job, displayed};
use crate::dataset::Sequence;
use anyhow::{Result, ensure};
use renderflow_frame::transforms::{Matrix, rows};
use renderflow_frame::{Distortion, file};
use serde::Serialize;
use std::path::Path;

#[derive(Serialize)]
struct Transforms {
    camera_model: &'static str,
    #[serde(skip_serializing_if = "Option::is_none", flatten)]
    intrinsics: Option<Intrinsics>,
    /// The world is as it should be: no guess at what is up.
    orientation_override: &'static str,
    /// From this program's world (+Y up) to the one of the file.
    applied_transform: [[f64; 4]; 3],
    frames: Vec<Entry>,
}

#[derive(Clone, Copy, PartialEq, Serialize)]
struct Intrinsics {
    fl_x: f32,
    fl_y: f32,
    cx: f32,
    cy: f32,
    w: usize,
    h: usize,
    #[serde(flatten)]
    lens: Distortion,
}

#[derive(Serialize)]
struct Entry {
    file_path: String,
    depth_file_path: String,
    mask_path: String,
    #[serde(skip_serializing_if = "Option::is_none", flatten)]
    intrinsics: Option<Intrinsics>,
    transform_matrix: Matrix,
}

/// +Y up to +Z up.
const UPRIGHT: [[f64; 4]; 3] = [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, 0.0]];

/// Turns the world of a camera-to-world matrix.
fn upright([x, y, z, w]: Matrix) -> Matrix {
    [x, z.map(|v| 0.0 - v), y, w]
}

/// Millimetres, 0 where unknown.
fn millimetres(depth: f32) -> u16 {
    let rounded = (f64::from(depth) * 1000.0).round();
    if (1.0..=65535.0).contains(&rounded) { rounded as u16 } else { 0 }
}

pub fn sequence(sequence: &Sequence, out: &Path, job: &Job) -> Result<()> {
    let folder = out.join(sequence.split.name()).join(&sequence.name);
    let transforms = &sequence.transforms;
    let rational = |lens: &Distortion| [lens.k4, lens.k5, lens.k6] != [0.0; 3];
    let known = !transforms.cameras.iter().filter_map(|camera| camera.distortion.as_ref()).any(rational);
    ensure!(known, "{}: nerfstudio has no lenses with the coefficients k4 to k6", sequence.name);
    let name = |kind: &str, index: usize| format!("{kind}/frame_{:04}.png", sequence.numbers[index]);
    job.frames(sequence, |index, frame| {
        let (width, height) = (frame.width, frame.height);
        let picture = displayed(&frame, transforms.exposure)?;
        let image = png(width, height, picture.pixels.iter().map(|pixel| pixel.map(byte)))?;
        let depth = png(width, height, frame.depth.pixels.iter().map(|&depth| [millimetres(depth)]))?;
        let still = |id: u32| id != 0 && !transforms.tracks.objects.contains_key(&id);
        let mask = png(width, height, frame.object_id.pixels.iter().map(|&id| [if still(id) { 255u8 } else { 0 }]))?;
        job.write(folder.join(name("images", index)), &image)?;
        job.write(folder.join(name("depths", index)), &depth)?;
        job.write(folder.join(name("masks", index)), &mask)
    })?;
    let intrinsics: Vec<_> = (transforms.cameras.iter())
        .map(|camera| Intrinsics {
            fl_x: camera.fl_x,
            fl_y: camera.fl_y,
            cx: camera.cx,
            cy: camera.cy,
            w: camera.width,
            h: camera.height,
            lens: camera.distortion.unwrap_or_default(),
        })
        .collect();
    let shared = intrinsics.iter().all(|own| *own == intrinsics[0]);
    let frames = transforms.cameras.iter().enumerate().map(|(index, camera)| Entry {
        file_path: name("images", index),
        depth_file_path: name("depths", index),
        mask_path: name("masks", index),
        intrinsics: (!shared).then(|| intrinsics[index]),
        transform_matrix: upright(rows(camera.camera_to_world, camera.origin)),
    });
    let transforms = Transforms {
        camera_model: if transforms.cameras.iter().any(|camera| camera.distortion.is_some()) { "OPENCV" } else { "PINHOLE" },
        intrinsics: intrinsics.first().filter(|_| shared).copied(),
        orientation_override: "none",
        applied_transform: UPRIGHT,
        frames: frames.collect(),
    };
    let path = folder.join("transforms.json");
    job.write(path.clone(), &file::json(&path, &transforms)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn up_becomes_z_and_depths_are_rounded() {
        let applied = UPRIGHT.map(|row| row[0] * 1.0 + row[1] * 2.0 + row[2] * 3.0);
        assert_eq!(applied, [1.0, -3.0, 2.0]);
        let column = |v: [f64; 3]| [[v[0], 0.0, 0.0, 0.0], [v[1], 0.0, 0.0, 0.0], [v[2], 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
        assert_eq!(upright(column([1.0, 2.0, 3.0])), column(applied));
        let cases = [(1.2344, 1234), (0.0004, 0), (65.535, 65535), (65.5356, 0), (f32::INFINITY, 0), (0.0006, 1)];
        for (depth, expected) in cases {
            assert_eq!(millimetres(depth), expected, "{depth}");
        }
    }
}
