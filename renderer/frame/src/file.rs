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
