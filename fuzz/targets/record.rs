//! `sequence.json` of a finished sequence, and after a NUL `failures.json`; the sequence is the only one of its plan.
#![no_main]

use libfuzzer_sys::fuzz_target;
use renderflow::dataset::check::Part;
use renderflow::dataset::damage::{self, Depth};
use renderflow::dataset::home::Home;
use renderflow::dataset::layout::{FAILURES, RECORD};
use renderflow::dataset::manifest::{self, Manifest};
use renderflow::dataset::record::{self, Record};
use renderflow::dataset::{Plan, stats};
use renderflow::util::cancel::Cancel;
use renderflow_fuzz::{catch_in_readers, folder, names_file, parts, plain, put, same_again, watch};
use std::path::PathBuf;
use std::sync::LazyLock;

/// A dataset and the folder of its sequence.
static FOLDERS: LazyLock<(PathBuf, PathBuf, Plan)> = LazyLock::new(|| {
    let dataset = folder().join("dataset");
    let sequence = dataset.join("train/seq-000000");
    std::fs::create_dir_all(&sequence).expect("the folder of a sequence can be made");
    put(&dataset.join("plan.json"), include_bytes!("../seeds/plan/small.json"));
    let plan = Plan::read(&dataset.join("plan.json")).expect("the plan of the seeds is valid");
    (dataset, sequence, plan)
});

fuzz_target!(
    init: catch_in_readers(),
    |bytes: &[u8]| watch(|| {
        let (dataset, sequence, plan) = &*FOLDERS;
        let [found, failed] = parts(bytes);
        put(&sequence.join(RECORD), found);
        put(&sequence.join(FAILURES), failed);
        match record::failures(sequence) {
            Ok(failures) => same_again(&failures),
            Err(error) => names_file(format!("{error:#}"), &[FAILURES]),
        }
        // The one judgement of datasets: where it finds no fault with the record, the record is this program's own.
        let judged = damage::sequence(plan, dataset, 0, None, Depth::Sizes);
        match Record::read(sequence) {
            Ok(record) => {
                let record = record.expect("the record is there");
                record.frames.iter().for_each(|frame| plain(&frame.file));
                record.descriptions.iter().for_each(|(file, _)| plain(file));
                if !judged.damage.iter().any(|damage| damage.part == Part::Record) {
                    assert!(record.misfits(plan, 0).is_empty());
                    assert!(record.environment.concentration.is_finite() && record.environment.exposure.is_finite());
                    same_again(&record);
                }
                let mut two = plan.clone();
                two.sequences.test = 1;
                let leaks = manifest::leaks(&two, [(0, &record), (1, &record)]);
                assert!(!leaks.is_empty(), "a scene in two splits is a leak");
            }
            Err(error) => {
                assert!(!judged.is_whole(), "a record that cannot be read is no damage");
                return names_file(format!("{error:#}"), &[RECORD]);
            }
        }
        // What reads whole datasets answers, too.
        if let Ok(numbers) = stats::numbers(dataset, &Cancel::default()) {
            serde_json::to_string(&numbers).expect("the numbers of a dataset can be written");
        }
        let home = Home::of(dataset).ok().flatten();
        if let Some(Ok(records)) = home.map(|home| home.accept(&home.indices)) {
            same_again(&Manifest::new(plan, dataset, &records).expect("records make a manifest"));
        }
    })
);
