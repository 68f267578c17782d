//! `manifest.json` of a dataset, and `set.json` of a test set.
#![no_main]

use libfuzzer_sys::fuzz_target;
use renderflow::dataset::layout::MANIFEST;
use renderflow::dataset::manifest::Manifest;
use renderflow::dataset::testset::{SET, SetFile};
use renderflow_frame::file::parse_json;
use renderflow_fuzz::{names_file, same_again, watch};
use std::path::Path;

fuzz_target!(|bytes: &[u8]| watch(|| {
    match parse_json::<Manifest>(Path::new(MANIFEST), bytes) {
        Ok(manifest) => same_again(&manifest),
        Err(error) => names_file(error, &[MANIFEST]),
    }
    match parse_json::<SetFile>(Path::new(SET), bytes) {
        Ok(set) => same_again(&set),
        Err(error) => names_file(error, &[SET]),
    }
}));
