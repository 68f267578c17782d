//! Dataset plans: JSON where the input begins with a brace, else TOML.
#![no_main]

use libfuzzer_sys::fuzz_target;
use renderflow::dataset::plan::Plan;
use renderflow_fuzz::{catch_in_readers, folder, names_file, put, same_again, watch};
use std::path::PathBuf;
use std::sync::LazyLock;

static FOLDER: LazyLock<PathBuf> = LazyLock::new(folder);

fuzz_target!(
    init: catch_in_readers(),
    |bytes: &[u8]| watch(|| {
        let name = if bytes.trim_ascii_start().starts_with(b"{") { "plan.json" } else { "plan.toml" };
        let path = FOLDER.join(name);
        put(&path, bytes);
        match Plan::read(&path) {
            Ok(plan) => {
                same_again(&plan);
                // TOML has no numbers above those with a sign.
                if plan.seed <= i64::MAX as u64 {
                    let text = toml::to_string_pretty(&plan).expect("a plan that was accepted can be written as TOML");
                    assert_eq!(toml::from_str::<Plan>(&text).expect("a plan that was written can be read"), plan);
                }
                if let Ok(composed) = plan.compose(&plan.catalog(), plan.total() - 1) {
                    composed.scene.validate().expect("a plan that was accepted makes valid scenes");
                }
            }
            Err(error) => names_file(format!("{error:#}"), &[name]),
        }
    })
);
