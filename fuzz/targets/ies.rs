//! Photometric profiles of lights.
#![no_main]

use glam::Vec3A;
use libfuzzer_sys::fuzz_target;
use renderflow_fuzz::{catch_in_readers, folder, names_file, put, watch};
use renderflow_scenes::ies::Profile;
use std::path::PathBuf;
use std::sync::LazyLock;

static FOLDER: LazyLock<PathBuf> = LazyLock::new(folder);

/// Directions along and between the axes, and one beside an axis.
fn directions() -> impl Iterator<Item = Vec3A> {
    let steps = [-1.0_f32, 0.0, 1.0];
    let all = steps.into_iter().flat_map(move |x| steps.into_iter().flat_map(move |y| steps.map(|z| Vec3A::new(x, y, z))));
    all.chain([Vec3A::new(1e-20, -1e-20, -1.0), Vec3A::new(0.3, -0.9, -0.1)]).filter_map(Vec3A::try_normalize)
}

fuzz_target!(
    init: catch_in_readers(),
    |bytes: &[u8]| watch(|| {
        let path = FOLDER.join("input.ies");
        put(&path, bytes);
        match Profile::read(&path) {
            Ok(profile) => {
                for direction in directions() {
                    let value = profile.value(direction);
                    assert!((0.0..=1.0).contains(&value), "{value} along {direction}");
                }
            }
            Err(error) => names_file(error, &["input.ies"]),
        }
    })
);
