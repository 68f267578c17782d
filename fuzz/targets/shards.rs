//! `manifest.json` of a folder of shards; `unfinished.json` where the input begins with a bracket or says that it was adopted.
#![no_main]

use libfuzzer_sys::fuzz_target;
use renderflow::dataset::pack::{MANIFEST, list};
use renderflow_fuzz::{catch_in_readers, folder, names_file, plain, put, watch};
use std::path::PathBuf;
use std::sync::LazyLock;

static FOLDERS: LazyLock<[PathBuf; 2]> = LazyLock::new(|| {
    let folders = ["finished", "unfinished"].map(|name| folder().join(name));
    folders.iter().for_each(|folder| std::fs::create_dir_all(folder).expect("a folder of shards can be made"));
    folders
});
const UNFINISHED: &str = "unfinished.json";

fuzz_target!(
    init: catch_in_readers(),
    |bytes: &[u8]| watch(|| {
        let [finished, unfinished] = &*FOLDERS;
        let going = bytes.trim_ascii_start().starts_with(b"[") || bytes.windows(9).any(|word| word == b"\"adopted\"");
        let (folder, name) = if going { (unfinished, UNFINISHED) } else { (finished, MANIFEST) };
        put(&folder.join(name), bytes);
        match list::find(folder) {
            Ok(found) => {
                assert_eq!(found.finished, !going);
                // Only these are ever removed.
                for shard in &found.shards {
                    plain(&shard.file);
                    assert!(shard.file.ends_with(".tar") && shard.file.starts_with(&shard.split), "{}", shard.file);
                }
            }
            Err(error) => names_file(format!("{error:#}"), &[name]),
        }
    })
);
