//! Scene files, and loading what needs no other file.
#![no_main]

use libfuzzer_sys::fuzz_target;
use renderflow_frame::reach::Reach;
use renderflow_fuzz::{catch_in_readers, check_scene, names_file, watch};
use renderflow_scenes::description::{EnvironmentSource, Geometry};
use renderflow_scenes::{Scene, load, sky};
use std::path::Path;

fuzz_target!(
    init: catch_in_readers(),
    |bytes: &[u8]| watch(|| {
        let Ok(text) = std::str::from_utf8(bytes) else { return };
        let mut scene = match Scene::from_json(Path::new("scene.json"), text) {
            Ok(scene) => scene,
            Err(error) => return names_file(error, &["scene.json"]),
        };
        let again = Scene::from_json(Path::new("scene.json"), &scene.canonical_json()).expect("a scene written out can be read");
        assert_eq!(again, scene);
        // Long sequences only repeat the work; maps of the usual size would take most of the time.
        scene.frames = scene.frames.min(9);
        match &scene.environment.source {
            EnvironmentSource::Sky(parameters) => {
                let map = sky::render(parameters, 16, 8);
                assert!(map.pixels.iter().flatten().all(|v| v.is_finite() && *v >= 0.0), "the sky is out of range");
                scene.environment.source = EnvironmentSource::Constant([1.0; 3]);
            }
            EnvironmentSource::Builtin(name) if sky::names().contains(&name.as_str()) => {
                scene.environment.source = EnvironmentSource::Constant([1.0; 3]);
            }
            _ => {}
        }
        // Files have targets of their own.
        scene.objects.retain(|object| !matches!(object.geometry, Geometry::File(_)));
        match load::load(&scene, &Reach::folder("/nowhere")) {
            Ok(loaded) => check_scene(&loaded),
            Err(error) => assert!(!error.to_string().is_empty()),
        }
    })
);
