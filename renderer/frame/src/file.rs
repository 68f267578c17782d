//! Files are written beside their place and renamed, so that a reader never sees half of one.

use crate::{Error, Result};
use std::io::Write;
use std::path::Path;

/// Writes `bytes` to a temporary file in the folder of `path` (created if missing), then renames it over `path`.
/// On any error the temporary file is removed and `path` is as it was.
///
/// # Errors
/// [`Error::Io`] naming `path`, for instance on a full disk.
pub fn write_atomic(path: &Path, bytes: &[u8]) -> Result<()> {
    let folder = match path.parent() {
        Some(p) if !p.as_os_str().is_empty() => p,
        _ => Path::new("."),
    };
    std::fs::create_dir_all(folder).map_err(Error::io(folder, "create folder"))?;
    let mut temporary =
        tempfile::Builder::new().prefix(".").suffix(".tmp").tempfile_in(folder).map_err(Error::io(path, "write"))?;
    temporary.write_all(bytes).map_err(Error::io(path, "write"))?;
    temporary.as_file().sync_all().map_err(Error::io(path, "write"))?;
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let readable = std::fs::Permissions::from_mode(0o644);
        temporary.as_file().set_permissions(readable).map_err(Error::io(path, "write"))?;
    }
    temporary.persist(path).map_err(|e| Error::io(path, "rename")(e.error))?;
    Ok(())
}

/// Reads a JSON file.
///
/// # Errors
/// When the file cannot be read, or does not hold a `T`; the message gives file, line and column.
pub fn read_json<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T> {
    parse_json(path, &std::fs::read(path).map_err(Error::io(path, "read"))?)
}

/// [`read_json`] from memory; `name` stands for the path in errors.
pub(crate) fn parse_json<T: serde::de::DeserializeOwned>(name: &Path, json: &[u8]) -> Result<T> {
    // serde_json's message ends with "at line L column C".
    serde_json::from_slice(json).map_err(|error| Error::malformed(name, error.to_string()))
}

/// Writes a value as indented JSON by [`write_atomic`]. NaN and infinities would become `null`: check them before.
///
/// # Errors
/// When the value has no JSON form (a map whose keys are not strings) or the file cannot be written.
pub fn write_json<T: serde::Serialize + ?Sized>(path: &Path, value: &T) -> Result<()> {
    let mut json = serde_json::to_vec_pretty(value).map_err(|error| Error::malformed(path, error.to_string()))?;
    json.push(b'\n');
    write_atomic(path, &json)
}
