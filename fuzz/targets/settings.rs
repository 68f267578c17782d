//! Settings: of training either network, and published ones of networks.
#![no_main]

use libfuzzer_sys::fuzz_target;
use renderflow_frame::file::parse_json;
use renderflow_fuzz::{catch_in_readers, names_file, same_again, text, watch};
use renderflow_model::wan::{DitConfig, VaceConfig, VaeConfig};
use renderflow_model::{fusion, wan};
use std::path::Path;

fuzz_target!(
    init: catch_in_readers(),
    |bytes: &[u8]| watch(|| {
        let name = Path::new("config.json");
        match parse_json::<fusion::training::Config>(name, bytes) {
            Ok(config) if config.validate().is_ok() => same_again(&config),
            Ok(_) => {}
            Err(error) => names_file(error, &["config.json"]),
        }
        match parse_json::<wan::train::Config>(name, bytes) {
            Ok(config) if config.validate().is_ok() => same_again(&config),
            Ok(_) => {}
            Err(error) => names_file(error, &["config.json"]),
        }
        let Some(text) = text(bytes) else { return };
        let published = [
            VaeConfig::parse(name, text).map(|config| config.validate()),
            DitConfig::parse(name, text).map(|config| config.validate()),
            VaceConfig::parse(name, text).map(|config| config.validate()),
        ];
        for read in published {
            match read {
                Ok(valid) => valid.expect("what was accepted is valid"),
                Err(error) => names_file(error, &["config.json"]),
            }
        }
    })
);
