//! A frame with every channel, whose values are known in closed form.
#![allow(dead_code)]

use glam::Vec3A;
use renderflow_frame::{Camera, Frame, FrameInfo, Image};
use std::path::{Path, PathBuf};

/// A camera that looks down at the origin, off every axis, with a principal point off the middle.
pub fn camera(width: usize, height: usize) -> Camera {
    let camera = Camera::look_at(Vec3A::new(1.5, 2.25, 3.1), Vec3A::new(0.1, 0.4, -0.2), Vec3A::Y, 0.8, width, height);
    Camera { cx: 0.47 * width as f32, cy: 0.55 * height as f32, ..camera }
}

/// Every channel filled; the leftmost column is a miss.
pub fn frame(width: usize, height: usize) -> Frame {
    let hit = |x: usize| x > 0;
    let ramp = |scale: f32| {
        Image::from_fn(width, height, move |x, y| {
            [scale * x as f32 / width as f32, scale * y as f32 / height as f32, scale * (0.1 + (x * y) as f32 / 777.0)]
        })
    };
    let material = ramp(0.7).map(|m| m.map(|v| v.min(1.0)));
    Frame {
        width,
        height,
        beauty: Some(ramp(3.0)),
        alpha: Image::from_fn(width, height, |x, _| if hit(x) { 1.0 } else { 0.0 }),
        raw: Some(ramp(3.5)),
        variance: Some(ramp(1e-7)),
        samples: Some(Image::from_fn(width, height, |x, y| 64 + 4 * (x * y) as u32)),
        light: std::array::from_fn(|group| Some(ramp(1.0 + group as f32))),
        indirect: Some(ramp(0.9)),
        hidden: Some(ramp(0.4)),
        albedo: material.clone(),
        normal: Image::from_fn(width, height, |x, _| if hit(x) { [0.6, 0.0, 0.8] } else { [0.0; 3] }),
        depth: Image::from_fn(width, height, |x, y| if hit(x) { 1.0 + (x + 3 * y) as f32 / 7.0 } else { f32::INFINITY }),
        distance: Some(Image::from_fn(width, height, |x, y| if hit(x) { 1.5 + (x + 3 * y) as f32 / 6.0 } else { f32::INFINITY })),
        material,
        transmittance: Some(ramp(0.7).map(|m| m.map(|v| v.clamp(0.0, 1.0)))),
        through: Some(Image::from_fn(width, height, |x, y| if hit(x) && y % 2 == 0 { [0.0, 0.6, -0.8] } else { [0.0; 3] })),
        irradiance: Some(ramp(1.25)),
        guide_albedo: Some(ramp(0.5)),
        guide_normal: Some(ramp(-0.3)),
        motion: Some(Image::from_fn(width, height, |x, y| [x as f32 - 3.5, 0.25 * y as f32])),
        motion_prev: Some(Image::from_fn(width, height, |x, y| [-(y as f32), 1.0 / (1.0 + x as f32)])),
        object_id: Image::from_fn(width, height, |x, y| if hit(x) { 70_000 + (x * y) as u32 } else { 0 }),
        material_id: Image::from_fn(width, height, |x, _| if hit(x) { u32::MAX - x as u32 } else { 0 }),
        info: FrameInfo {
            camera: camera(width, height),
            spp: 256,
            seed: u64::MAX - 12,
            scene_hash: "00ff".repeat(16),
            scene_files: "ff00".repeat(16),
            exposure: 0.123_456_79,
            bsdf: "conserving".into(),
            sampling: "average 256".into(),
            lens: "aperture 0.02 focus 3".into(),
            shutter: "open 0.5 moments 32".into(),
            max_bounces: Some(6),
            branches: None,
            indirect_limit: None,
            light_paths: false,
            denoiser: Some("oidn 2.5".into()),
        },
    }
}

/// `name` below the assets folder beside the repository, or `None` with a line that says why the test is skipped.
pub fn asset(name: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/assets").join(name);
    if !path.exists() {
        eprintln!("skipped: {} is not there", path.display());
        return None;
    }
    Some(path)
}

/// Every file below `folder`, sorted.
pub fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() { folders.push(path) } else { found.push(path) }
        }
    }
    found.sort();
    found
}
