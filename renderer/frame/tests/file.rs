//! Writing beside and renaming: a failure leaves the old file and nothing else.

use renderflow_frame::file::{read_json, write_atomic, write_json};
use std::collections::BTreeMap;
use std::path::Path;

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn a_file_is_replaced_and_folders_are_made() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a/b/data.bin");
    write_atomic(&path, b"first").unwrap();
    write_atomic(&path, b"second").unwrap();
    assert_eq!(std::fs::read(&path).unwrap(), b"second");
    assert_eq!(names(path.parent().unwrap()), ["data.bin"]);
}

#[test]
fn a_failed_rename_leaves_no_temporary_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("taken");
    std::fs::create_dir(&path).unwrap();
    let error = write_atomic(&path, b"bytes").unwrap_err().to_string();
    assert_eq!(error, format!("{}: is a folder, not a file that can be written", path.display()));
    assert_eq!(names(folder.path()), ["taken"]);

    std::fs::write(folder.path().join("file"), b"").unwrap();
    let error = write_atomic(&folder.path().join("file/below"), b"bytes").unwrap_err().to_string();
    assert!(error.contains("cannot create folder"), "{error}");
}

const CHILD: &str = "RENDERFLOW_TEST_WRITE_BEYOND_LIMIT";

/// A full disk without one: a child of this test runs under a limit on the size of files, so that its write fails half way.
#[cfg(unix)]
#[test]
fn a_disk_that_fills_up_leaves_the_old_file() {
    if let Some(folder) = std::env::var_os(CHILD) {
        let path = Path::new(&folder).join("frame.exr");
        let error = write_atomic(&path, &vec![7; 1 << 20]).expect_err("the limit did not hold").to_string();
        assert!(error.starts_with(&format!("{}: cannot write: ", path.display())), "{error}");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("frame.exr");
    write_atomic(&path, b"old").unwrap();
    let status = std::process::Command::new("sh")
        // Without the trap the signal would end the child before write returns its error.
        .args(["-c", "trap '' XFSZ; ulimit -f 64; exec \"$0\" --exact a_disk_that_fills_up_leaves_the_old_file"])
        .arg(std::env::current_exe().unwrap())
        .env(CHILD, folder.path())
        .stdout(std::process::Stdio::null())
        .status()
        .unwrap();
    assert!(status.success());
    assert_eq!(std::fs::read(&path).unwrap(), b"old");
    assert_eq!(names(folder.path()), ["frame.exr"]);
}

#[test]
fn json_comes_back_and_errors_name_file_line_and_column() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("map.json");
    let map = BTreeMap::from([("a".to_owned(), 1.5f32), ("b".to_owned(), -0.1)]);
    write_json(&path, &map).unwrap();
    assert_eq!(read_json::<BTreeMap<String, f32>>(&path).unwrap(), map);
    assert_eq!(std::fs::read_to_string(&path).unwrap(), "{\n  \"a\": 1.5,\n  \"b\": -0.1\n}\n");

    for (text, expected) in
        [("{\n \"a\": true\n}", "line 2 column 10"), ("{\"a\": 1", "line 1 column 7"), ("", "line 1 column 0")]
    {
        std::fs::write(&path, text).unwrap();
        let error = read_json::<BTreeMap<String, f32>>(&path).unwrap_err().to_string();
        assert!(error.starts_with(path.to_str().unwrap()) && error.ends_with(expected), "{error}");
    }
    let error = read_json::<BTreeMap<String, f32>>(Path::new("no/such.json")).unwrap_err().to_string();
    assert!(error.starts_with("no/such.json: cannot read: "), "{error}");
}
