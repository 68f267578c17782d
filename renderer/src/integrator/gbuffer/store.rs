//! A frame from what its pixels see.

use super::Centre;
use crate::camera::Projector;
use crate::compile::RenderScene;
use crate::film::GuideStatistics;
use crate::settings::Settings;
use renderflow_frame::{Frame, FrameInfo, Image};

/// A frame with the requested pictures.
pub(super) fn empty_frame(scene: &RenderScene, settings: &Settings) -> Frame {
    let (width, height) = (scene.camera().width, scene.camera().height);
    let wanted = settings.channels;
    let rgb = || Image::filled(width, height, [0.0f32; 3]);
    let flow = || Image::filled(width, height, [0.0f32; 2]);
    let mut frame = Frame {
        width,
        height,
        alpha: Image::filled(width, height, 0.0),
        irradiance: settings.irradiance.then(rgb),
        guide_albedo: wanted.guides.then(rgb),
        guide_normal: wanted.guides.then(rgb),
        motion: wanted.motion.then(flow),
        motion_prev: wanted.motion.then(flow),
        info: FrameInfo {
            camera: *scene.camera(),
            spp: 0,
            seed: scene.seed,
            scene_hash: scene.hash.clone(),
            scene_files: scene.files.clone(),
            exposure: scene.exposure(),
            bsdf: String::new(),
            sampling: String::new(),
            lens: settings.lens.map(|lens| lens.to_string()).unwrap_or_default(),
            shutter: String::new(),
            max_bounces: None,
            branches: None,
            indirect_limit: None,
            light_paths: false,
            denoiser: None,
        },
        ..Frame::default()
    };
    if wanted.gbuffer {
        (frame.albedo, frame.normal, frame.material) = (rgb(), rgb(), rgb());
        frame.depth = Image::filled(width, height, f32::INFINITY);
        (frame.object_id, frame.material_id) = (Image::filled(width, height, 0), Image::filled(width, height, 0));
        let features = scene.features();
        let clear = features.clear || features.blended;
        (frame.transmittance, frame.through) = (clear.then(rgb), clear.then(rgb));
    }
    frame
}

/// Stores the guides of pixel `at`.
pub(super) fn store_guides(frame: &mut Frame, at: usize, guides: &GuideStatistics, projector: &Projector) {
    frame.alpha.pixels[at] = guides.coverage();
    if let Some(image) = &mut frame.guide_albedo {
        image.pixels[at] = guides.albedo();
    }
    if let Some(image) = &mut frame.guide_normal {
        image.pixels[at] = guide_normal(guides, projector);
    }
}

/// The mean normal of guides, in camera space.
pub(super) fn guide_normal(guides: &GuideStatistics, projector: &Projector) -> [f32; 3] {
    // The mean normal is turned to camera space once, since turning is linear.
    projector.direction_to_camera(guides.normal()).to_array()
}

/// Stores what the centre of pixel `at` sees.
pub(super) fn store(frame: &mut Frame, at: usize, centre: &Centre) {
    fn set<T>(image: &mut Image<T>, at: usize, value: T) {
        if let Some(pixel) = image.pixels.get_mut(at) {
            *pixel = value;
        }
    }
    set(&mut frame.albedo, at, centre.albedo);
    set(&mut frame.normal, at, centre.normal);
    set(&mut frame.depth, at, centre.depth);
    set(&mut frame.material, at, centre.material);
    set(&mut frame.object_id, at, centre.object_id);
    set(&mut frame.material_id, at, centre.material_id);
    let pictures = [
        (&mut frame.irradiance, centre.irradiance),
        (&mut frame.transmittance, centre.transmittance),
        (&mut frame.through, centre.through),
    ];
    for (image, value) in pictures {
        if let Some(image) = image {
            image.pixels[at] = value;
        }
    }
    for (image, value) in [(&mut frame.motion, centre.motion), (&mut frame.motion_prev, centre.motion_prev)] {
        if let Some(image) = image {
            image.pixels[at] = value;
        }
    }
}
