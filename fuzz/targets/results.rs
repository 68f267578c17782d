//! A results folder of an evaluation: `results.json`, a sequence and its scores, NULs between them.
#![no_main]

use libfuzzer_sys::fuzz_target;
use renderflow_fuzz::{catch_in_readers, folder, names_file, parts, plain, put, same_again, watch};
use std::path::PathBuf;
use std::sync::LazyLock;

/// The files themselves: the crate they stand in takes minutes to build.
#[path = "../../src/util"]
mod util {
    #[allow(dead_code)]
    pub mod files;
}
#[allow(dead_code)]
#[path = "../../src/evaluate/results.rs"]
mod results;
use results::{ABOUT, Results};

static FOLDER: LazyLock<PathBuf> = LazyLock::new(|| {
    let folder = folder().join("results");
    std::fs::create_dir_all(folder.join("set/class")).expect("the folder of a class can be made");
    folder
});

fuzz_target!(
    init: catch_in_readers(),
    |bytes: &[u8]| watch(|| {
        let [about, sequence, scores] = parts(bytes);
        let class = FOLDER.join("set/class");
        put(&FOLDER.join(ABOUT), about);
        put(&class.join("sequence.json"), sequence);
        put(&class.join("sequence.jsonl"), scores);
        match Results::read(&FOLDER) {
            Ok(results) => {
                same_again(&results.about);
                // Pictures are called after their methods.
                results.about.methods.iter().for_each(|method| plain(&method.id));
                assert!(results.sequences.len() <= 1);
                for sequence in &results.sequences {
                    same_again(&sequence.about);
                    assert!(sequence.about.exposure.is_finite());
                    same_again(&sequence.scores);
                    assert!(sequence.scores.iter().flat_map(|score| score.values.values()).all(|value| value.is_finite()));
                }
            }
            Err(error) => names_file(format!("{error:#}"), &[ABOUT, "sequence.json", "sequence.jsonl"]),
        }
    })
);
