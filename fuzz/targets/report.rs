//! The report of a results folder: `results.json`, a sequence and its scores, NULs between them. A picture of the truth lies
//! beside them.
#![no_main]

use libfuzzer_sys::fuzz_target;
use renderflow::evaluate::results::{ABOUT, Results, TRUTH, picture_file};
use renderflow::report::{self, table};
use renderflow::util::cancel::Cancel;
use renderflow::util::progress::Progress;
use renderflow_fuzz::{catch_in_readers, folder, parts, plain, put, watch};
use std::path::PathBuf;
use std::sync::LazyLock;

/// The results, and where their report goes.
static FOLDERS: LazyLock<[PathBuf; 2]> = LazyLock::new(|| {
    let folders = ["results", "report"].map(|name| folder().join(name));
    let pictures = folders[0].join("set/class/sequence");
    std::fs::create_dir_all(&pictures).expect("the folder of a sequence can be made");
    std::fs::create_dir_all(&folders[1]).expect("the folder of a report can be made");
    let picture = image::RgbImage::from_fn(3, 2, |x, y| image::Rgb([x as u8 * 90, y as u8 * 200, 7]));
    picture.save(pictures.join(picture_file(0, TRUTH))).expect("a picture can be written");
    folders
});

fuzz_target!(
    init: catch_in_readers(),
    |bytes: &[u8]| watch(|| {
        let [results, out] = &*FOLDERS;
        let [about, sequence, scores] = parts(bytes);
        let class = results.join("set/class");
        put(&results.join(ABOUT), about);
        put(&class.join("sequence.json"), sequence);
        put(&class.join("sequence.jsonl"), scores);
        let Ok(results) = Results::read(results) else { return };
        table::markdown(&results, table::Filter::default());
        let progress = Progress::new("report", 2);
        if report::build(&results, out, &progress, &Cancel::default()).is_err() {
            return;
        }
        let mut pages = 0;
        for entry in std::fs::read_dir(out).expect("the report can be listed") {
            let path = entry.expect("the report can be listed").path();
            plain(path.file_name().and_then(|name| name.to_str()).expect("made of text"));
            let page = std::fs::read_to_string(&path).expect("a page can be read");
            // Data and script of a sequence, script of the index: none that the results brought along.
            assert!(page.matches("<script").count() <= 2 && page.matches("</script").count() <= 2, "{}", path.display());
            std::fs::remove_file(&path).expect("a page can be removed");
            pages += 1;
        }
        assert_eq!(pages, 2, "an index and a page for the sequence");
    })
);
