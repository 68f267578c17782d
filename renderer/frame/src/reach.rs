//! Decides which files a file may name. This is the only place where a name that was read from a file becomes a path.
//!
//! Datasets, scenes and models are downloaded from strangers. A name in one of them must not make this program read, write or
//! delete a file that its owner did not hand over. A name must therefore stay inside the folder of the file that contains it,
//! unless the user has allowed another folder. Symbolic links are followed, because only the owner of a folder can put one there.

use crate::words;
use std::collections::BTreeSet;
use std::path::{Component, Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// Largest size in bytes of a name that is read from a file.
const LONGEST: usize = 4096;

/// The folder of a file, and the folders that the user allows its names to lead to.
#[derive(Clone, Debug)]
pub struct Reach {
    folder: PathBuf,
    allowed: Vec<PathBuf>,
    /// The files that were read; copies share the list.
    noted: Option<Arc<Mutex<BTreeSet<PathBuf>>>>,
}

impl Reach {
    /// Names may lead to `folder` and everything below it.
    pub fn folder(folder: impl Into<PathBuf>) -> Self {
        let folder: PathBuf = folder.into();
        Self { folder: if folder.as_os_str().is_empty() { ".".into() } else { folder }, allowed: Vec::new(), noted: None }
    }

    /// Names may lead to the folder of `file` and everything below it.
    pub fn of(file: &Path) -> Self {
        Self::folder(file.parent().unwrap_or(Path::new("")))
    }

    /// Names may lead to `folders` as well, or to single files; `/` allows everything.
    #[must_use]
    pub fn allow(mut self, folders: impl IntoIterator<Item = impl Into<PathBuf>>) -> Self {
        self.allowed.extend(folders.into_iter().map(Into::into));
        self
    }

    /// The same allowed folders, for the names in `file`.
    #[must_use]
    pub fn at(&self, file: &Path) -> Self {
        Self { allowed: self.allowed.clone(), noted: self.noted.clone(), ..Self::of(file) }
    }

    /// A copy that keeps a list of the files that are read through it and through its own copies.
    #[must_use]
    pub fn noting(&self) -> Self {
        Self { noted: Some(Arc::default()), ..self.clone() }
    }

    /// Notes that the file `path` was read. Without [`noting`](Self::noting) nothing happens.
    pub fn note(&self, path: &Path) {
        if let Some(noted) = &self.noted {
            noted.lock().unwrap_or_else(PoisonError::into_inner).insert(path.into());
        }
    }

    /// The files that were noted.
    pub fn noted(&self) -> BTreeSet<PathBuf> {
        self.noted.as_ref().map(|noted| noted.lock().unwrap_or_else(PoisonError::into_inner).clone()).unwrap_or_default()
    }

    /// All folders that names may lead to: the one that relative names start from, and the allowed ones.
    pub fn folders(&self) -> impl Iterator<Item = &Path> {
        std::iter::once(&self.folder).chain(&self.allowed).map(PathBuf::as_path)
    }

    /// The folder that relative names start from.
    pub fn base(&self) -> &Path {
        &self.folder
    }

    /// The path that `name` stands for. `.` and `..` are resolved in the name itself, so that links do not
    /// change its meaning.
    ///
    /// # Errors
    /// A text that tells why the name is refused: it is empty, too long, holds a NUL, or leads out of every allowed folder.
    pub fn resolve(&self, name: &str) -> Result<PathBuf, String> {
        if name.is_empty() || name.len() > LONGEST || name.contains('\0') {
            return Err(format!("{} is not a file name", quoted(name)));
        }
        let inside = |folder: &Path, path: &Path| absolute(folder).is_some_and(|folder| path.starts_with(folder));
        let Some(path) = absolute(&self.folder.join(name)) else {
            return Err(format!("{} is not a file name", quoted(name)));
        };
        if !self.folders().any(|folder| inside(folder, &path)) {
            return Err(format!(
                "{} leads out of the folder {}; if it is meant, allow the other folder with --allow-files {}",
                quoted(name),
                self.folder.display(),
                in_shells(&path.parent().unwrap_or(&path).to_string_lossy())
            ));
        }
        // As the user would write it in a command: relative where the folder is relative.
        Ok(absolute(&self.folder).and_then(|base| Some(self.folder.join(path.strip_prefix(base).ok()?))).unwrap_or(path))
    }
}

/// A folder as a shell reads it; `FOLDER` where nobody should paste the name into a command.
fn in_shells(folder: &str) -> String {
    if folder.len() > 255 || folder.chars().any(char::is_control) { "FOLDER".into() } else { words::shell(folder) }
}

/// The path from the root, `.` and `..` resolved; `None` without a working folder.
fn absolute(path: &Path) -> Option<PathBuf> {
    let mut plain = PathBuf::new();
    for component in std::path::absolute(path).ok()?.components() {
        match component {
            Component::CurDir => {}
            // The root's parent is the root.
            Component::ParentDir => drop(plain.pop()),
            other => plain.push(other),
        }
    }
    Some(plain)
}

/// Checks that `name` is the plain name of a file: one component without a separator. Files that lie beside the file that names
/// them have such names.
///
/// # Errors
/// A text that tells that it is not a plain name.
pub fn plain_name(name: &str) -> Result<&str, String> {
    let separators = ['/', '\\', ':'];
    let bad = name.is_empty()
        || name.len() > 255
        || name.starts_with('.')
        || name.contains(separators)
        || name.chars().any(char::is_control);
    if bad { Err(format!("{} is not the plain name of a file", quoted(name))) } else { Ok(name) }
}

/// The beginning of a name, quoted, for messages.
fn quoted(name: &str) -> String {
    if name.chars().count() <= 80 { format!("{name:?}") } else { format!("{:?}...", name.chars().take(77).collect::<String>()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_stay_in_their_folder() {
        let reach = Reach::of(Path::new("data/scene.json"));
        for (name, path) in [
            ("a.png", "data/a.png"),
            ("./a.png", "data/a.png"),
            ("maps/../a.png", "data/a.png"),
            ("maps/a b.png", "data/maps/a b.png"),
            ("..a", "data/..a"),
        ] {
            assert_eq!(reach.resolve(name).as_deref(), Ok(Path::new(path)), "{name}");
        }
        let here = std::env::current_dir().unwrap();
        assert_eq!(reach.resolve(here.join("data/x").to_str().unwrap()), Ok("data/x".into()), "the folder by its full name");
        for name in ["../a", "maps/../../a", "/a", "//a", "../database/a", "", "a\0b", "..", "x/../.."] {
            assert!(reach.resolve(name).is_err(), "{name}: {:?}", reach.resolve(name));
        }
        assert!(reach.resolve(&"a/".repeat(4000)).is_err());
    }

    #[test]
    fn copies_note_what_is_read() {
        let reach = Reach::folder("data");
        let noting = reach.noting();
        reach.note(Path::new("data/b"));
        noting.note(Path::new("data/a"));
        noting.at(Path::new("models/a.obj")).note(Path::new("models/a.png"));
        assert_eq!(noting.noted(), ["data/a", "models/a.png"].map(PathBuf::from).into());
        assert!(reach.noted().is_empty() && noting.noting().noted().is_empty());
    }

    #[test]
    fn the_user_allows_folders_by_name() {
        let reach = Reach::folder("data").allow(["models"]);
        assert!(reach.resolve("../models/a.obj").is_ok());
        assert!(reach.at(Path::new("models/a.obj")).resolve("wood.png").is_ok());
        assert!(reach.resolve("../models2/a.obj").is_err());
        assert!(reach.resolve("../models/../secret").is_err());
        let refusal = reach.resolve("/some where/it's/a.obj").unwrap_err();
        assert!(refusal.contains(r"--allow-files '/some where/it'\''s'"), "{refusal}");
        assert!(reach.resolve("/b\u{1b}[2J/a.obj").unwrap_err().ends_with("with --allow-files FOLDER"));
        assert!(reach.resolve("/b/c/a.obj").unwrap_err().ends_with("with --allow-files /b/c"));
        let file = Reach::folder("data").allow(["maps/sky.hdr"]);
        assert!(file.resolve("../maps/sky.hdr").is_ok() && file.resolve("../maps/sky2.hdr").is_err());
        assert_eq!(Reach::folder("data").allow(["/"]).resolve("/some/where"), Ok("/some/where".into()));
    }

    #[test]
    fn plain_names_have_one_component() {
        for name in ["train-000000.tar", "frame.0001.exr", "a b"] {
            assert_eq!(plain_name(name), Ok(name));
        }
        for name in ["", ".", "..", ".hidden", "a/b", "/a", "../a", "a\\b", "C:a", "a\nb", "a\0", &"a".repeat(256)] {
            assert!(plain_name(name).is_err(), "{name:?}");
        }
    }
}
