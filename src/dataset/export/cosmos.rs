//! Cosmos DiffusionRenderer (github.com/nv-tlabs/cosmos-transfer1-diffusion-renderer, commit 0f3e2dc, 2025-10):
//! `OUT/<split>/<clip>.<frame>.<label>.png`, 8 bits, which `VideoGBufferDataset` groups by what stands before the first dot.
//!
//! | label | content |
//! |---|---|
//! | `rgb` | the picture, sRGB |
//! | `basecolor` | sRGB |
//! | `metallic`, `roughness` | linear, grey |
//! | `normal` | camera space (+x right, +y up, +z to the viewer), n / 2 + 1/2; a miss is 128 |
//! | `depth` | planar, from the nearest (0) to the farthest (1) surface of the clip; a miss is 1 |
//! | `env_ldr` | sRGB(Reinhard(E, white 16)) |
//! | `env_log` | sRGB(log(1 + E) / log(1 + 10000)) |
//! | `env_nrm` | the direction of each pixel of the two maps, as normals; one a clip |
//!
//! Maps are in camera space: column gx in -1..1 and row gy in 0..1 look along (sin(pi gy) sin(pi gx), cos(pi gy), sin(pi gy)
//! cos(pi gx)), its `envmap_vec`. Its own loader mirrors the map it is given (its `process_environment_map` says so); these are
//! not mirrored. `<clip>.cameras.json` has its `frames[].transform_matrix` (OpenGL camera-to-world, +Y up) and the range of
//! depth.

use super::picture::{byte, png};
use super::{Job, displayed};
use crate::dataset::Sequence;
use anyhow::Result;
use glam::Vec3A;
use renderflow_frame::transforms::{Matrix, rows};
use renderflow_frame::{Camera, Environment, color, file, hdr};
use serde::Serialize;
use std::f32::consts::PI;
use std::path::Path;

#[derive(Serialize)]
struct Cameras {
    /// Metres that are 0 and 1 in the depth pictures.
    depth_range: [f32; 2],
    frames: Vec<Pose>,
}

#[derive(Serialize)]
struct Pose {
    transform_matrix: Matrix,
}

/// Camera-space direction of a pixel of a map.
fn direction(width: usize, height: usize, x: usize, y: usize) -> Vec3A {
    let (gx, gy) = ((2 * x + 1) as f32 / width as f32 - 1.0, (2 * y + 1) as f32 / (2 * height) as f32);
    let ((sin_phi, cos_phi), (sin_theta, cos_theta)) = ((PI * gx).sin_cos(), (PI * gy).sin_cos());
    Vec3A::new(sin_theta * sin_phi, cos_theta, sin_theta * cos_phi)
}

/// Both maps of an environment as the camera sees it.
fn maps(environment: &Environment, camera: &Camera) -> Result<[(&'static str, Vec<u8>); 2]> {
    let (width, height) = (camera.width, camera.height);
    let radiance: Vec<[f32; 3]> = (0..width * height)
        .map(|i| environment.radiance(camera.camera_to_world.matrix3 * direction(width, height, i % width, i / width)))
        .collect();
    let srgb = |v: f32| byte(color::linear_to_srgb(v.clamp(0.0, 1.0)));
    let log = |v: f32| srgb(v.max(0.0).ln_1p() / 10_000f32.ln_1p());
    Ok([
        ("env_ldr", png(width, height, radiance.iter().map(|e| e.map(|v| srgb(color::reinhard(v, 16.0)))))?),
        ("env_log", png(width, height, radiance.iter().map(|e| e.map(log)))?),
    ])
}

fn normal(n: [f32; 3]) -> [u8; 3] {
    n.map(|v| byte(0.5 * v + 0.5))
}

pub fn sequence(sequence: &Sequence, out: &Path, job: &Job) -> Result<()> {
    let (transforms, folder) = (&sequence.transforms, out.join(sequence.split.name()));
    let map = hdr::read(&sequence.folder.join(&transforms.environment))?.map;
    let environment = Environment { map, rotation: transforms.environment_rotation, intensity: transforms.environment_intensity };
    // The range of depth is the clip's, so that depth does not flicker; frames are read twice for it.
    let quiet = job.quiet();
    let ranges = quiet.frames(sequence, |_, frame| {
        let hits = frame.depth.pixels.iter().copied().filter(|d| d.is_finite());
        Ok(hits.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), d| (low.min(d), high.max(d))))
    })?;
    let (near, far) = ranges.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |all, own| (all.0.min(own.0), all.1.max(own.1)));
    let (near, far) = if near <= far { (near, far) } else { (0.0, 1.0) };
    let name = |index: usize, label: &str| folder.join(format!("{}.{:04}.{label}.png", sequence.name, sequence.numbers[index]));
    job.frames(sequence, |index, frame| {
        let (width, height) = (frame.width, frame.height);
        let picture = displayed(&frame, transforms.exposure)?;
        let grey = |v: f32| [byte(v); 3];
        let share = |depth: f32| if depth.is_finite() { (depth - near) / (far - near).max(f32::MIN_POSITIVE) } else { 1.0 };
        let mut files = vec![
            ("rgb", png(width, height, picture.pixels.iter().map(|p| p.map(byte)))?),
            ("basecolor", png(width, height, frame.albedo.pixels.iter().map(|p| p.map(|v| byte(color::linear_to_srgb(v)))))?),
            ("roughness", png(width, height, frame.material.pixels.iter().map(|m| grey(m[0])))?),
            ("metallic", png(width, height, frame.material.pixels.iter().map(|m| grey(m[1])))?),
            ("normal", png(width, height, frame.normal.pixels.iter().map(|&n| normal(n)))?),
            ("depth", png(width, height, frame.depth.pixels.iter().map(|&d| grey(share(d))))?),
        ];
        // Texels about as large as the pixels that look at them: a small sun is not missed.
        let coarse = environment.downsampled(environment.map.width.min(width), environment.map.height.min(height));
        files.extend(maps(&coarse, &transforms.cameras[index])?);
        files.iter().try_for_each(|(label, bytes)| job.write(name(index, label), bytes))
    })?;
    if let Some(camera) = transforms.cameras.first() {
        let (width, height) = (camera.width, camera.height);
        let directions = (0..width * height).map(|i| direction(width, height, i % width, i / width).to_array());
        job.write(name(0, "env_nrm"), &png(width, height, directions.map(normal))?)?;
    }
    let frames = transforms.cameras.iter().map(|c| Pose { transform_matrix: rows(c.camera_to_world, c.origin) });
    let cameras = Cameras { depth_range: [near, far], frames: frames.collect() };
    let path = folder.join(format!("{}.cameras.json", sequence.name));
    job.write(path.clone(), &file::json(&path, &cameras)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use renderflow_frame::Image;

    /// Middle of the picture: behind the camera; right edge of the middle: to the right; top: up.
    #[test]
    fn maps_look_where_their_directions_say() {
        let near = |a: Vec3A, b: [f32; 3]| assert!(a.abs_diff_eq(Vec3A::from_array(b), 0.05), "{a} {b:?}");
        near(direction(101, 101, 50, 50), [0.0, 0.0, 1.0]);
        near(direction(101, 101, 75, 50), [1.0, 0.0, 0.0]);
        near(direction(101, 101, 50, 0), [0.0, 1.0, 0.0]);
        near(direction(101, 101, 0, 50), [0.0, 0.0, -1.0]);
        // A map that is brighter towards world +X; a camera that looks along +X has it in front: at the edges of the picture.
        let map = Image::from_fn(64, 32, |_, _| [0.0; 3]);
        let dark = Environment { map, rotation: 0.0, intensity: 1.0 };
        let bright = Image::from_fn(64, 32, |x, y| [dark.texel_direction(x, y).x.max(0.0); 3]);
        let environment = dark.with_map(bright);
        let camera = Camera::look_at(Vec3A::ZERO, Vec3A::X, Vec3A::Y, 0.8, 32, 32);
        let [ldr, log] = maps(&environment, &camera).unwrap();
        let picture = image::load_from_memory(&ldr.1).unwrap().to_rgb8();
        assert!(picture.get_pixel(0, 16)[0] > 150 && picture.get_pixel(16, 16)[0] == 0);
        assert!(image::load_from_memory(&log.1).unwrap().to_rgb8().get_pixel(0, 16)[0] > 60);
        // Exactly to its side it is dark; half a pixel further to the front there is sin(pi / 32) = 0.098, which is 84 of 255.
        assert_eq!(picture.get_pixel(23, 16)[0], 0);
        assert!((82..=86).contains(&picture.get_pixel(24, 16)[0]), "{:?}", picture.get_pixel(24, 16));
    }
}
