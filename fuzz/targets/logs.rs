//! Logs: of a training run that goes on from an interruption, and of the shards of a dataset.
#![no_main]

use libfuzzer_sys::fuzz_target;
use renderflow::dataset::log::costs;
use renderflow::util::cancel::Cancel;
use renderflow_fuzz::{catch_in_readers, folder, names_file, put, same_again, text, watch};
use renderflow_model::train::log::Log;
use renderflow_model::train::runner::LogRecord;
use std::path::PathBuf;
use std::sync::LazyLock;

static FOLDER: LazyLock<PathBuf> = LazyLock::new(|| {
    let folder = folder().join("data");
    std::fs::create_dir_all(folder.join("logs")).expect("the folder of logs can be made");
    folder
});

/// Steps of the checkpoint that training goes on from.
const RESUMED: u64 = 40;

fuzz_target!(
    init: catch_in_readers(),
    |bytes: &[u8]| watch(|| {
        put(&FOLDER.join("logs/log.jsonl"), bytes);
        let costs = costs(&FOLDER, &Cancel::default()).expect("nobody stops it");
        assert!(costs.frames + costs.failures <= bytes.split(|&b| b == b'\n').count());

        let path = FOLDER.join("log.jsonl");
        put(&path, bytes);
        match Log::open(&path, RESUMED) {
            Ok(_) => {
                let kept = std::fs::read_to_string(&path).expect("a log can be read");
                for line in kept.lines() {
                    assert!(text(bytes).is_some_and(|text| text.lines().any(|before| before.trim() == line)), "a new line {line}");
                    if let Ok(record) = serde_json::from_str::<LogRecord>(line) {
                        assert!(record.step <= RESUMED);
                        same_again(&record);
                    }
                }
                drop(Log::open(&path, RESUMED).expect("a log can be opened again"));
                assert_eq!(std::fs::read_to_string(&path).expect("a log can be read"), kept);
            }
            Err(error) => names_file(error, &["log.jsonl"]),
        }
    })
);
