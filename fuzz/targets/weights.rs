//! Weights of the network.
#![no_main]

use burn::tensor::Device;
use libfuzzer_sys::fuzz_target;
use renderflow_fuzz::{catch_in_readers, names_file, watch};
use renderflow_model::{parameters, weights};
use std::path::Path;

fuzz_target!(
    init: catch_in_readers(),
    |bytes: &[u8]| watch(|| match weights::decode(Path::new("input.safetensors"), bytes, &Device::flex()) {
        Ok((network, _)) => {
            let all = parameters::export(&network);
            assert!(all.iter().flat_map(|p| &p.values).all(|v| v.is_finite()));
        }
        Err(error) => names_file(error, &["input.safetensors"]),
    })
);
