//! Cameras of a sequence.
#![no_main]

use libfuzzer_sys::fuzz_target;
use renderflow_frame::transforms;
use renderflow_fuzz::{catch_in_readers, names_file, plain, watch};
use std::path::Path;

fuzz_target!(
    init: catch_in_readers(),
    |bytes: &[u8]| watch(|| match transforms::decode(Path::new("transforms.json"), bytes) {
        Ok(sequence) => {
            assert!(sequence.exposure.is_finite() && sequence.environment_rotation.is_finite());
            assert_eq!(sequence.cameras.len(), sequence.files.len());
            for camera in &sequence.cameras {
                let intrinsics = [camera.fl_x, camera.fl_y, camera.cx, camera.cy];
                assert!(camera.camera_to_world.is_finite() && intrinsics.iter().all(|v| v.is_finite()));
                assert!(camera.world_to_camera().is_finite());
                assert!(camera.position_in_world().is_finite());
            }
            assert!(sequence.tracks.objects.values().flatten().all(|t| t.is_finite()));
            plain(&sequence.environment);
            sequence.files.iter().for_each(|file| plain(file));
            let name = Path::new("transforms.json");
            let written = transforms::encode(name, &sequence).expect("what was accepted can be written");
            let again = transforms::decode(name, &written).expect("what was written can be read");
            assert_eq!((again.files, again.keyframes, again.environment), (sequence.files, sequence.keyframes, sequence.environment));
        }
        Err(error) => names_file(error, &["transforms.json"]),
    })
);
