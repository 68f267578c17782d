//! Dataset plans.
#![no_main]

use libfuzzer_sys::fuzz_target;
use renderflow_fuzz::{catch_in_readers, folder, names_file, put, watch};
use std::path::PathBuf;
use std::sync::LazyLock;

/// The file itself: the crate it stands in takes minutes to build.
#[allow(dead_code)]
#[path = "../../src/dataset/plan.rs"]
mod plan;
use plan::Plan;

static FOLDER: LazyLock<PathBuf> = LazyLock::new(folder);

fuzz_target!(
    init: catch_in_readers(),
    |bytes: &[u8]| watch(|| {
        let path = FOLDER.join("plan.json");
        put(&path, bytes);
        match Plan::read(&path) {
            Ok(plan) => {
                if let Ok(composed) = plan.compose(&plan.catalog(), plan.total() - 1) {
                    composed.scene.validate().expect("a plan that was accepted makes valid scenes");
                }
            }
            Err(error) => names_file(format!("{error:#}"), &["plan.json"]),
        }
    })
);
