//! Weights of the network.
#![no_main]

use libfuzzer_sys::fuzz_target;
use renderflow_fuzz::{catch_in_readers, names_file, watch};
use renderflow_model::fusion::Fusion;
use std::path::Path;

fuzz_target!(
    init: catch_in_readers(),
    |bytes: &[u8]| watch(|| match Fusion::decode(Path::new("input.safetensors"), bytes) {
        Ok(fusion) => assert!(fusion.parameters().iter().flat_map(|p| &p.values).all(|v| v.is_finite())),
        Err(error) => names_file(error, &["input.safetensors"]),
    })
);
