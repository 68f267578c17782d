//! A small analytic scene: a sphere on a plane under a sky with a bright spot, its truth a known function of the split sum.
#![allow(dead_code)]

pub mod checkpoint;
pub mod sequence;

use glam::{Vec2, Vec3A};
use renderflow_frame::ibl;
use renderflow_frame::image::{Image, Rgb};
use renderflow_frame::{Camera, Environment, Frame, FrameInfo, Light};
use renderflow_model::Clip;
use renderflow_model::device::NetworkDevice;
use renderflow_model::lpips::weights_folder;
use renderflow_model::train::Team;
use renderflow_model::train::runner::{Progress, RunContext, Summary};
use renderflow_model::wan::Vae;
use renderflow_model::wan::pictures::BridgeStart;
use renderflow_model::wan::train::latents::Encoder;
use renderflow_model::wan::train::{Config, run};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

/// An encoder of clips at one size: stills, clips and references, without pictures beside the latents.
pub fn encoder(vae: &Vae, size: usize) -> Encoder<'_> {
    Encoder {
        vae,
        sizes: vec![size],
        start: BridgeStart::Albedo,
        multiple: 16,
        stills: true,
        clips: true,
        references: true,
        pictures: &[],
        store: None,
    }
}

/// Trains a stage of the paper's network in this process alone, on the processor. The run stops where `stop` says so.
pub fn learn(config: &Config, clips: &[Clip], stop: &(dyn Fn(&Progress) -> bool + Sync)) -> renderflow_model::Result<Summary> {
    let cancel = AtomicBool::new(false);
    let progress = |progress: &Progress| cancel.store(cancel.load(Ordering::Relaxed) || stop(progress), Ordering::Relaxed);
    let context = RunContext { device: &NetworkDevice::cpu(), progress: &progress, cancel: &cancel, team: &Team::alone() };
    run(config, &clips.to_vec(), context)
}

/// The folder with the weights of LPIPS: the one that the environment names, or the one of the test assets.
pub fn lpips_folder() -> PathBuf {
    weights_folder().unwrap_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/assets/lpips"))
}

/// A blue-white gradient with a warm spot.
pub fn sky() -> Environment {
    let map = Rgb::from_fn(64, 32, |x, y| {
        let up = 1.0 - y as f32 / 31.0;
        // One texel is the brightest, so that mirroring the sky mirrors its dominant light.
        let away = (x as f32 - 19.0).powi(2) + (y as f32 - 9.0).powi(2);
        let sun = 20.0 * (-0.7 * away).exp();
        [0.3 + 0.3 * up + sun, 0.4 + 0.4 * up + 0.9 * sun, 0.5 + 0.7 * up + 0.7 * sun]
    });
    Environment { map, rotation: 0.3, intensity: 1.0 }
}

/// A camera on a circle around the sphere.
pub fn camera(angle: f32, size: usize) -> Camera {
    let eye = Vec3A::new(3.0 * angle.sin(), 1.6, 3.0 * angle.cos());
    Camera::look_at(eye, Vec3A::new(0.0, 0.4, 0.0), Vec3A::Y, 0.8, size, size)
}

/// Distance along a ray, normal, albedo, object.
fn hit(origin: Vec3A, direction: Vec3A) -> Option<(f32, Vec3A, [f32; 3], u32)> {
    let centre = Vec3A::new(0.0, 0.6, 0.0);
    let oc = origin - centre;
    let (b, c) = (oc.dot(direction), oc.length_squared() - 0.36);
    let discriminant = b * b - c;
    if discriminant > 0.0 {
        let t = -b - discriminant.sqrt();
        if t > 0.0 {
            return Some((t, (origin + direction * t - centre).normalize(), [0.7, 0.3, 0.2], 1));
        }
    }
    let t = -origin.y / direction.y;
    let p = origin + direction * t;
    (t > 0.0 && p.x.abs() < 2.0 && p.z.abs() < 2.0).then(|| {
        let dark = (p.x.floor() as i32 + p.z.floor() as i32).rem_euclid(2) == 0;
        (t, Vec3A::Y, if dark { [0.3; 3] } else { [0.6, 0.6, 0.55] }, 2)
    })
}

/// The G-buffer, without beauty.
pub fn gbuffer(camera: &Camera) -> Frame {
    let (width, height) = (camera.width, camera.height);
    let to_camera = camera.camera_to_world.matrix3.transpose();
    let hits = Image::from_fn(width, height, |x, y| {
        let direction = camera.ray_direction(Vec2::new(x as f32 + 0.5, y as f32 + 0.5));
        hit(camera.position(), direction).map(|(t, n, albedo, id)| {
            let depth = -(to_camera * direction).z * t;
            (depth, to_camera * n, albedo, id)
        })
    });
    Frame {
        width,
        height,
        alpha: hits.map(|h| if h.is_some() { 1.0 } else { 0.0 }),
        albedo: hits.map(|h| h.map_or([0.0; 3], |h| h.2)),
        normal: hits.map(|h| h.map_or([0.0; 3], |h| h.1.to_array())),
        depth: hits.map(|h| h.map_or(f32::INFINITY, |h| h.0)),
        material: hits.map(|h| h.map_or([0.0; 3], |h| if h.3 == 1 { [0.3, 0.0, 0.5] } else { [0.7, 0.0, 0.5] })),
        object_id: hits.map(|h| h.map_or(0, |h| h.3)),
        material_id: hits.map(|h| h.map_or(0, |h| h.3)),
        info: FrameInfo { camera: *camera, exposure: 1.0, ..FrameInfo::default() },
        ..Frame::default()
    }
}

/// A clip on an arc; its truth is the split sum, darkened towards the sphere's foot and tinted elsewhere.
pub fn clip(frames: usize, size: usize) -> Clip {
    let light = Light::new(sky());
    let cameras: Vec<Camera> = (0..frames).map(|i| camera(0.06 * i as f32, size)).collect();
    let frames = cameras.iter().map(|camera| with_truth(camera, &light)).collect::<Vec<_>>();
    Clip { name: "analytic".into(), numbers: (0..frames.len()).collect(), frames, shaded: Vec::new(), light }
}

fn with_truth(camera: &Camera, light: &Light) -> Frame {
    let mut frame = gbuffer(camera);
    let shading = ibl::shade(&frame, light);
    frame.beauty = Some(Rgb::from_fn(frame.width, frame.height, |x, y| {
        let start = *shading.image.at(x, y);
        if *frame.alpha.at(x, y) == 0.0 {
            return start;
        }
        let p = camera.unproject(Vec2::new(x as f32 + 0.5, y as f32 + 0.5), *frame.depth.at(x, y));
        let occlusion = (0.25 + 0.6 * Vec2::new(p.x, p.z).length()).min(1.0);
        [start[0] * occlusion, start[1] * occlusion * 0.9, start[2] * occlusion * 0.8]
    }));
    frame
}

/// PSNR of the display pictures over covered pixels.
pub fn psnr(a: &Rgb, b: &Rgb, frame: &Frame, exposure: f32) -> f32 {
    let (mut sum, mut count) = (0.0f64, 0.0);
    for i in (0..a.pixels.len()).filter(|&i| frame.alpha.pixels[i] > 0.0) {
        let (x, y) =
            (renderflow_frame::color::display(a.pixels[i], exposure), renderflow_frame::color::display(b.pixels[i], exposure));
        for c in 0..3 {
            sum += f64::from(x[c] - y[c]).powi(2);
            count += 1.0;
        }
    }
    (-10.0 * (sum / count).log10()) as f32
}
