//! Finds files, and tells them apart.

use anyhow::{Context, Result};
use renderflow_frame::file;
use std::collections::BTreeSet;
use std::fs::File;
use std::path::{Path, PathBuf};

/// The ending of a file's name in lower case, without the dot; empty where there is none.
pub fn ending(path: &Path) -> String {
    path.extension().map(|ending| ending.to_string_lossy().to_lowercase()).unwrap_or_default()
}

/// Whether a file's name has one of `endings`, which are in lower case.
pub fn has_ending(path: &Path, endings: &[&str]) -> bool {
    endings.contains(&ending(path).as_str())
}

/// The content of a folder, by path.
///
/// # Errors
/// When it cannot be listed.
pub fn list(folder: &Path) -> Result<Vec<PathBuf>> {
    let unreadable = || format!("{}: cannot list", folder.display());
    let entries = std::fs::read_dir(folder).with_context(unreadable)?;
    let mut paths = entries.map(|entry| Ok(entry.with_context(unreadable)?.path())).collect::<Result<Vec<_>>>()?;
    paths.sort();
    Ok(paths)
}

/// The files that have one of `endings`, in a folder and in all folders below it, by path. A folder that links lead to more than
/// once is visited once.
///
/// # Errors
/// When a folder cannot be listed.
pub fn walk(folder: &Path, endings: &[&str]) -> Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    let (mut folders, mut visited) = (vec![folder.to_owned()], BTreeSet::new());
    while let Some(folder) = folders.pop() {
        let full = folder.canonicalize().with_context(|| format!("{}: cannot list", folder.display()))?;
        if !visited.insert(full) {
            continue;
        }
        for path in list(&folder)? {
            if path.is_dir() {
                folders.push(path);
            } else if has_ending(&path, endings) {
                files.push(path);
            }
        }
    }
    files.sort();
    Ok(files)
}

/// BLAKE3 of a regular file, hexadecimal.
///
/// # Errors
/// When it cannot be read.
pub fn hash(path: &Path) -> Result<String> {
    let mut hasher = blake3::Hasher::new();
    hasher.update_reader(file::open(path)?).map_err(renderflow_frame::Error::io(path, "read"))?;
    Ok(hasher.finalize().to_hex().to_string())
}

/// Whether `file` is what lies at `path`, and not a file or a folder that was removed.
pub fn is_at(file: &File, path: &Path) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        let number = |found: std::io::Result<std::fs::Metadata>| found.map(|found| (found.dev(), found.ino())).ok();
        number(file.metadata()).is_some_and(|own| number(std::fs::metadata(path)) == Some(own))
    }
    #[cfg(not(unix))]
    {
        // Files have no numbers here, so another file that lies there now counts as the same.
        let _ = file;
        path.exists()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_found_by_their_endings_at_any_depth() {
        let folder = tempfile::tempdir().unwrap();
        let make = |name: &str| {
            let path = folder.path().join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(&path, name).unwrap();
            path
        };
        let expected = [make("a/deep/er/x.PNG"), make("a/y.exr"), make("b.png")];
        make("a/z.txt");
        std::fs::create_dir(folder.path().join("folder.png")).unwrap();
        assert_eq!(walk(folder.path(), &["png", "exr"]).unwrap(), expected);
        #[cfg(unix)]
        for (to, link) in [("..", "a/deep/up"), (".", "self")] {
            std::os::unix::fs::symlink(to, folder.path().join(link)).unwrap();
        }
        assert_eq!(walk(folder.path(), &["png", "exr"]).unwrap(), expected);
        assert!(format!("{:#}", walk(&folder.path().join("none"), &[]).unwrap_err()).contains("none: cannot list"));
        assert_eq!(hash(&expected[2]).unwrap(), blake3::hash(b"b.png").to_hex().as_str());
    }
}
