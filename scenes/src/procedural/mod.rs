//! Seeded scenes: a floor, objects that stand on it without touching each other, materials, a light and an orbiting camera.
//!
//! The same [`ComposeOptions`] give the same scene, to the byte of its JSON, on every machine.

mod camera_path;
mod layout;
mod lighting;
pub mod materials;
pub mod varied;

use crate::description::{Geometry, Object, Scene};
use crate::seed::Seed;
use serde::{Deserialize, Serialize};

/// Which part of a dataset a scene belongs to. The same seed gives unrelated scenes in different splits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Split {
    /// Random skies; what networks learn from.
    #[default]
    Train,
    /// Random skies; for choosing settings.
    Val,
    /// Only the named maps of `hdri/`, which no random sky ever equals; for the numbers that are reported.
    Test,
}

impl Split {
    /// `train`, `val` or `test`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::Val => "val",
            Self::Test => "test",
        }
    }
}

impl std::fmt::Display for Split {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(self.name())
    }
}

/// What [`compose`] makes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ComposeOptions {
    /// Everything random follows from it and `split`.
    pub seed: u64,
    /// Image size in pixels, width then height.
    pub resolution: [u32; 2],
    /// Frames of the sequence, at least 1.
    pub frames: u32,
    /// Turn of the camera from a frame to the next; 3.6 turns once in 100 frames.
    pub degrees_per_frame: f32,
    /// Part of the dataset.
    pub split: Split,
    /// Fewest and most objects (the floor not counted), 1..=64.
    pub objects: [u32; 2],
    /// Share of scenes in which one to three objects move, 0..=1.
    pub moving_share: f64,
}

impl Default for ComposeOptions {
    fn default() -> Self {
        Self {
            seed: 0,
            resolution: [256, 256],
            frames: 1,
            degrees_per_frame: 3.6,
            split: Split::Train,
            objects: [4, 16],
            moving_share: 0.25,
        }
    }
}

/// A random scene. It passes `Scene::validate` for a resolution and a camera turn within their ranges.
pub fn compose(options: &ComposeOptions) -> Scene {
    let root = Seed::root(options.seed).child(options.split.name(), 0);
    let frames = options.frames.max(1);
    let camera_seed = root.child("camera", 0);
    let mut layout = layout::layout(&root, options.objects);
    if layout::wants_motion(&root, options.moving_share) && frames > 1 {
        layout.set_in_motion(&mut root.child("motion", 0).rng(), frames);
    }
    let camera = camera_path::orbit(&mut camera_seed.rng(), &layout, options.resolution, options.degrees_per_frame);

    let mut materials = vec![materials::ground(&mut root.child("ground material", 0).rng())];
    let mut objects = vec![Object {
        name: "ground".into(),
        geometry: Geometry::Shape(layout.floor.clone()),
        material: Some("ground".into()),
        transform: layout.floor_transform.clone(),
        motion: None,
    }];
    for (index, placed) in layout.objects.iter().enumerate() {
        let name = format!("{}_{:02}", placed.shape.family(), index + 1);
        let mut rng = root.child("material", index as u64).rng();
        materials.push(materials::material(&mut rng, &name));
        objects.push(Object {
            geometry: Geometry::Shape(placed.shape.clone()),
            material: Some(name.clone()),
            name,
            transform: placed.transform.clone(),
            motion: placed.motion.clone(),
        });
    }
    Scene {
        version: 1,
        name: format!("{}_{}", options.split, options.seed),
        // 53 bits survive every JSON reader.
        seed: root.child("render", 0).u64() >> 11,
        resolution: options.resolution,
        frames,
        camera,
        environment: lighting::environment(&mut root.child("light", 0).rng(), options.split),
        materials,
        objects,
    }
}
