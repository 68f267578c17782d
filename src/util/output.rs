//! Decides what may be written before the first byte is written. The user's files stay, unless the user asks to replace them. A
//! folder is written to only if it is empty or holds the mark of work that continues.

use super::files;
use anyhow::{Context, Result, bail, ensure};
use renderflow_frame::file;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::fs::{File, TryLockError};
use std::path::{Component, Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Said after the reason by commands with the option `--overwrite`.
pub const OVERWRITE: &str = "choose another path, or use --overwrite to replace it";

/// Whether there is anything at `path`; a broken link counts too.
pub fn exists(path: &Path) -> bool {
    std::fs::symlink_metadata(path).is_ok()
}

/// Whether the folder `path` is missing, or holds nothing but temporary files of this program.
///
/// # Errors
/// When it cannot be listed, or is not a folder.
pub fn is_empty(path: &Path) -> Result<bool> {
    if !exists(path) {
        return Ok(true);
    }
    for entry in std::fs::read_dir(path).with_context(|| format!("{}: cannot list", path.display()))? {
        let name = entry.with_context(|| format!("{}: cannot list", path.display()))?.file_name();
        if !name.to_str().is_some_and(file::is_leftover) {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Refuses a path at which there is anything, for a command that writes there when its work is done.
///
/// # Errors
/// When there is something.
pub fn absent(path: &Path) -> Result<()> {
    anyhow::ensure!(!exists(path), "{}: already exists; choose another folder", path.display());
    Ok(())
}

/// Checks all files, then writes them. A file that holds these bytes already is not touched; a different file is replaced only
/// with `overwrite`.
///
/// # Errors
/// When a different file is there without `overwrite` (then nothing was written), or when a file cannot be written.
pub fn write(files: &[(PathBuf, Vec<u8>)], overwrite: bool) -> Result<()> {
    let mut changed = Vec::new();
    for (path, bytes) in files {
        if !exists(path) {
            changed.push((path, bytes));
        } else if !std::fs::metadata(path).is_ok_and(|about| about.is_file()) {
            bail!("{}: already exists and is not a regular file; choose another path", path.display());
        } else if !file::holds(path, bytes)? {
            anyhow::ensure!(overwrite, "{}: already exists with other content; {OVERWRITE}", path.display());
            changed.push((path, bytes));
        }
    }
    for (path, bytes) in changed {
        file::write_atomic(path, bytes)?;
    }
    Ok(())
}

/// The full path of `path`. Links are followed as far as there are files; the rest of the path is taken as it is.
///
/// # Errors
/// When a link cannot be followed, or there is no working folder.
pub fn resolved(path: &Path) -> Result<PathBuf> {
    let full = std::path::absolute(path).with_context(|| path.display().to_string())?;
    let mut found = PathBuf::new();
    for component in full.components() {
        match component {
            Component::ParentDir => drop(found.pop()),
            Component::CurDir => {}
            other => found.push(other),
        }
        if found.is_symlink() || found.is_dir() {
            found = found.canonicalize().with_context(|| format!("{}: cannot follow", found.display()))?;
        }
    }
    Ok(found)
}

/// The right to write to a folder: a file (the mark) that says what the folder holds. It is checked at once, and written before
/// the first other file. While the claim lives, no other process can claim the folder.
pub struct Claim {
    path: PathBuf,
    held: Mutex<Held>,
}

/// What a [`Claim`] has so far.
struct Held {
    /// The bytes of the mark, until they are written.
    mark: Option<Vec<u8>>,
    hold: Hold,
}

/// Keeps other processes from a folder for as long as it lives.
pub struct Hold {
    folder: PathBuf,
    /// Whether there was no folder.
    missing: bool,
    /// Whether the folder was made since.
    made: bool,
    /// `None` while there is no folder, and where folders cannot be locked.
    lock: Option<File>,
}

/// Keeps those from a folder who would [`Hold`] it, for as long as it lives. Any number of processes may share a folder.
pub struct Share {
    _lock: Option<File>,
}

impl Share {
    /// Shares the folder, if there is one. Nothing is written.
    ///
    /// # Errors
    /// When another process holds it.
    pub fn new(folder: &Path) -> Result<Self> {
        Ok(Self { _lock: lock(folder, File::try_lock_shared)? })
    }
}

impl Hold {
    /// Holds the folder, if there is one. Nothing is written.
    ///
    /// # Errors
    /// When another process holds or shares it.
    pub fn new(folder: &Path) -> Result<Self> {
        let lock = lock(folder, File::try_lock)?;
        Ok(Self { folder: folder.to_owned(), missing: !exists(folder), made: false, lock })
    }

    /// Makes the folder, if there was none. Must be called before the first file is written.
    ///
    /// # Errors
    /// When it cannot be made, or when another process wrote to it meanwhile.
    pub fn begin(&mut self) -> Result<()> {
        self.begin_beside(|| Ok(false))
    }

    /// As [`begin`](Self::begin), but `known` may accept what is in the folder.
    fn begin_beside(&mut self, known: impl FnOnce() -> Result<bool>) -> Result<()> {
        if !self.missing || self.made {
            return Ok(());
        }
        let folder = self.folder.display();
        std::fs::create_dir_all(&self.folder).with_context(|| format!("{folder}: cannot create folder"))?;
        self.lock = lock(&self.folder, File::try_lock)?;
        ensure!(
            is_empty(&self.folder)? || known()?,
            "{folder}: another process has written to this folder; run the same command again"
        );
        self.made = true;
        Ok(())
    }
}

impl Drop for Hold {
    fn drop(&mut self) {
        if self.made {
            // Only an empty folder is removed: then the work was refused after all.
            let _ = std::fs::remove_dir(&self.folder);
        }
    }
}

/// Locks a folder itself with `try_lock`, so that no other file is needed. The lock ends with the process. `None` where there is
/// no folder, and where there are no locks, as on some network file systems.
fn lock(folder: &Path, try_lock: fn(&File) -> Result<(), TryLockError>) -> Result<Option<File>> {
    // Elsewhere folders are not opened as files.
    while cfg!(unix) && folder.is_dir() {
        let Ok(file) = File::open(folder) else { break };
        match try_lock(&file) {
            Ok(()) if files::is_at(&file, folder) => return Ok(Some(file)),
            // The process that held it removed it meanwhile.
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                bail!("{}: another process writes to this folder; wait for its end, or choose another folder", folder.display())
            }
            Err(TryLockError::Error(_)) => break,
        }
    }
    Ok(None)
}

impl Claim {
    /// Checks that the folder `out` is empty, or holds a mark `name` equal to `record`. If the mark differs, the error says that
    /// the folder holds `other`.
    ///
    /// # Errors
    /// When the mark differs or cannot be read, when the folder holds other files, or when another process has claimed it.
    pub fn new<R: Serialize + DeserializeOwned + PartialEq>(out: &Path, name: &str, record: &R, other: &str) -> Result<Self> {
        let claim = Self::agreed(out, name, record, |there| {
            anyhow::ensure!(there == record, "the folder holds {other}; choose another folder");
            Ok(())
        })?;
        // The mark is there already, perhaps written a little differently.
        if exists(&claim.path) {
            claim.held().mark = None;
        }
        Ok(claim)
    }

    /// As [`new`](Self::new), but `agrees` decides whether work continues from a mark that is there. The mark is then written
    /// again.
    ///
    /// # Errors
    /// As [`new`](Self::new), and the errors of `agrees`.
    pub fn agreed<R: Serialize + DeserializeOwned>(
        out: &Path,
        name: &str,
        record: &R,
        agrees: impl FnOnce(&R) -> Result<()>,
    ) -> Result<Self> {
        let path = out.join(name);
        let hold = Hold::new(out)?;
        if exists(&path) {
            agrees(&file::read_json(&path)?).with_context(|| path.display().to_string())?;
        } else if !is_empty(out)? {
            bail!("{}: not empty, and no {name} says what made its files; choose another folder", out.display());
        }
        let mark = Some(file::json(&path, record)?);
        Ok(Self { path, held: Mutex::new(Held { mark, hold }) })
    }

    fn held(&self) -> MutexGuard<'_, Held> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Writes the mark, once. Must be called before the first other file is written.
    ///
    /// # Errors
    /// When it cannot be written, or when another process claimed the folder before it was there.
    pub fn write(&self) -> Result<()> {
        let mut held = self.held();
        let Held { mark, hold } = &mut *held;
        if let Some(bytes) = mark {
            hold.begin_beside(|| Ok(exists(&self.path) && file::holds(&self.path, bytes)?))?;
            file::write_atomic(&self.path, bytes)?;
            *mark = None;
        }
        Ok(())
    }
}

/// Every page has this in its head, so that the program knows its own pages.
pub const GENERATOR: &str = concat!("<meta name=\"generator\" content=\"renderflow ", env!("CARGO_PKG_VERSION"), "\">");

/// Pages of versions without [`GENERATOR`] are known by these.
const EARLIER: [&str; 2] = [
    "<meta name=\"color-scheme\" content=\"light dark\">\n<link rel=\"icon\" href=\"data:,\">\n<title>",
    "<title>Dataset</title><style>body{font:15px/1.45 system-ui,sans-serif;",
];

/// Checks that the file at `path`, if there is one, is a page of this program.
///
/// # Errors
/// When it is something else.
pub fn check_page(path: &Path) -> Result<()> {
    if !exists(path) {
        return Ok(());
    }
    let of_any_version = GENERATOR.split_inclusive("renderflow").next().unwrap_or_default();
    let mut beginning = Vec::new();
    std::io::Read::read_to_end(&mut std::io::Read::take(file::open(path)?, 4096), &mut beginning)
        .with_context(|| format!("{}: cannot read", path.display()))?;
    let beginning = String::from_utf8_lossy(&beginning);
    let own = beginning.contains(of_any_version) || EARLIER.iter().any(|mark| beginning.contains(mark));
    anyhow::ensure!(own, "{}: already exists and is not a page of this program; choose another path", path.display());
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_files_stay_unless_they_are_to_be_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let files = [(path("a"), b"a".to_vec()), (path("b"), b"b".to_vec())];
        write(&files, false).unwrap();
        let before = std::fs::metadata(path("a")).unwrap().modified().unwrap();
        write(&files, false).unwrap();
        assert_eq!(std::fs::metadata(path("a")).unwrap().modified().unwrap(), before, "the same bytes were written again");
        std::fs::remove_file(path("a")).unwrap();
        std::fs::write(path("b"), b"edited").unwrap();
        let refused = write(&files, false).unwrap_err().to_string();
        assert!(refused.contains("/b: already exists") && refused.contains("--overwrite"), "{refused}");
        assert!(!path("a").exists(), "written before all was decided");
        write(&files, true).unwrap();
        assert_eq!((std::fs::read(path("a")).unwrap(), std::fs::read(path("b")).unwrap()), (b"a".to_vec(), b"b".to_vec()));
        assert!(write(&[(folder.path().to_owned(), Vec::new())], true).is_err());
    }

    #[test]
    fn a_folder_is_claimed_where_it_is_empty_or_marked() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("out");
        let claim = |record: u32| Claim::new(&out, "mark.json", &record, "other things");
        let first = claim(1).unwrap();
        assert!(!out.exists(), "nothing is written before it is needed");
        first.write().unwrap();
        drop(first);
        std::fs::write(out.join("x"), b"x").unwrap();
        claim(1).unwrap().write().unwrap();
        let refused = crate::util::console::message(&claim(2).map(drop).unwrap_err());
        assert!(refused.contains("mark.json: the folder holds other things"), "{refused}");
        std::fs::remove_file(out.join("mark.json")).unwrap();
        assert!(crate::util::console::message(&claim(1).map(drop).unwrap_err()).contains("not empty"));
    }

    #[cfg(unix)]
    #[test]
    fn one_claim_at_a_time_holds_a_folder() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("out");
        let claim = |record: u32| Claim::new(&out, "mark.json", &record, "other things");
        let taken = |result: Result<()>| assert!(result.unwrap_err().to_string().contains("another process writes"));
        // All of them find no folder.
        let [first, second, third] = [1, 1, 2].map(|record| claim(record).unwrap());
        first.write().unwrap();
        first.write().unwrap();
        taken(second.write());
        taken(claim(1).map(drop));
        drop(first);
        // Its work goes on, other work does not begin beside it.
        assert!(third.write().unwrap_err().to_string().contains("another process has written"));
        drop(third);
        second.write().unwrap();
        taken(claim(1).map(drop));
        drop(second);
        claim(1).unwrap().write().unwrap();
        assert_eq!(std::fs::read_dir(&out).unwrap().count(), 1);

        // A folder that stays empty goes with its hold.
        let inner = out.join("inner");
        let mut hold = Hold::new(&inner).unwrap();
        hold.begin().unwrap();
        taken(Hold::new(&inner).map(drop));
        drop(hold);
        assert!(!inner.exists());
        let mut hold = Hold::new(&inner).unwrap();
        hold.begin().unwrap();
        std::fs::write(inner.join("x"), b"x").unwrap();
        drop(hold);
        assert!(inner.join("x").exists() && Hold::new(&inner).is_ok());

        // Whoever shares a folder keeps out who would hold it, and the other way round.
        let (one, other) = (Share::new(&inner).unwrap(), Share::new(&inner).unwrap());
        drop(one);
        taken(Hold::new(&inner).map(drop));
        drop(other);
        let hold = Hold::new(&inner).unwrap();
        taken(Share::new(&inner).map(drop));
        drop(hold);
        assert!(Share::new(&inner).is_ok() && Share::new(&out.join("none")).is_ok());
    }

    #[cfg(unix)]
    #[test]
    fn paths_are_resolved_through_links_and_before_they_exist() {
        let folder = tempfile::tempdir().unwrap();
        let real = folder.path().canonicalize().unwrap();
        std::fs::create_dir(real.join("data")).unwrap();
        std::os::unix::fs::symlink("data", real.join("link")).unwrap();
        for (path, expected) in [
            ("link", "data"),
            ("link/new/x", "data/new/x"),
            ("link/../data/./x", "data/x"),
            ("none/../data", "data"),
            ("none", "none"),
        ] {
            assert_eq!(resolved(&real.join(path)).unwrap(), real.join(expected), "{path}");
        }
    }

    #[test]
    fn pages_are_known_by_their_head() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("index.html");
        check_page(&path).unwrap();
        std::fs::write(&path, format!("<!doctype html><head>{GENERATOR}")).unwrap();
        check_page(&path).unwrap();
        std::fs::write(&path, "<!doctype html><title>renderflow</title>").unwrap();
        assert!(check_page(&path).is_err());
    }
}
