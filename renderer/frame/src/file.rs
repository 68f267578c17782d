//! Reads and writes whole files. A file is written under a temporary name and then renamed, so that a reader never sees half of
//! it. Only regular files are read, and only up to a limit: reading a pipe or a device might never end.

use crate::{Error, Result};
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};

/// Largest size in bytes of a file that is read whole: frames, maps, models, weights.
pub const LARGEST: u64 = 8 << 30;
/// Largest size in bytes of a text that is read whole: descriptions, records, plans, a line of a log.
pub const LARGEST_TEXT: u64 = 256 << 20;
/// Longest line in bytes of a larger JSON file: this program writes one number or one text on a line.
const LONGEST_LINE: u64 = 1 << 20;

/// Opens a regular file for reading. Pipes, sockets, devices and folders are refused without waiting for them.
///
/// # Errors
/// [`Error::Io`] naming `path`; [`Error::Malformed`] where it is not a regular file.
pub fn open(path: &Path) -> Result<File> {
    let mut options = File::options();
    options.read(true);
    #[cfg(unix)]
    {
        use std::os::unix::fs::OpenOptionsExt;
        // A pipe without a writer would keep the call waiting. Regular files ignore the flag.
        options.custom_flags(rustix::fs::OFlags::NONBLOCK.bits() as i32);
    }
    let file = options.open(path).map_err(Error::io(path, "read"))?;
    let about = file.metadata().map_err(Error::io(path, "read"))?;
    if about.is_dir() {
        return Err(Error::malformed(path, "is a folder, not a file"));
    }
    if !about.is_file() {
        return Err(Error::malformed(path, "is a pipe, a socket or a device, not a regular file"));
    }
    Ok(file)
}

/// Reads a regular file of at most [`LARGEST`] bytes.
///
/// # Errors
/// As [`open`]; when the file is larger.
pub fn read(path: &Path) -> Result<Vec<u8>> {
    read_at_most(path, LARGEST)
}

/// Reads a regular file of at most `limit` bytes.
///
/// # Errors
/// As [`open`]; when the file is larger.
pub fn read_at_most(path: &Path, limit: u64) -> Result<Vec<u8>> {
    let file = open(path)?;
    let length = file.metadata().map_err(Error::io(path, "read"))?.len();
    let mut bytes = Vec::new();
    if length <= limit {
        bytes
            .try_reserve_exact(length as usize)
            .map_err(|_| Error::malformed(path, format!("{length} bytes do not fit into memory")))?;
        // A file may grow while it is read, and virtual files of the system have no length.
        file.take(limit + 1).read_to_end(&mut bytes).map_err(Error::io(path, "read"))?;
    }
    if length.max(bytes.len() as u64) > limit {
        return Err(Error::malformed(path, format!("larger than the {limit} bytes that are read of such a file")));
    }
    Ok(bytes)
}

/// Reads a text of at most [`LARGEST_TEXT`] bytes in UTF-8, without its byte order mark.
///
/// # Errors
/// As [`open`]; when the file is larger or not UTF-8.
pub fn read_text(path: &Path) -> Result<String> {
    let bytes = read_at_most(path, LARGEST_TEXT)?;
    let text = String::from_utf8(bytes)
        .map_err(|error| Error::malformed(path, format!("byte {} is not UTF-8", error.utf8_error().valid_up_to())))?;
    Ok(match text.strip_prefix('\u{feff}') {
        Some(rest) => rest.to_owned(),
        None => text,
    })
}

/// The lines of a regular file, for files that grow without a bound, such as logs: at most [`LARGEST`] bytes of it are read.
/// Lines that are longer than [`LARGEST_TEXT`] or not UTF-8 are left out, and a byte order mark is skipped.
///
/// # Errors
/// As [`open`].
pub fn lines(path: &Path) -> Result<impl Iterator<Item = String> + use<>> {
    Ok(Lines { reader: BufReader::new(open(path)?.take(LARGEST)), longest: LARGEST_TEXT })
}

/// Lines of at most `longest` bytes.
struct Lines<R> {
    reader: R,
    longest: u64,
}

impl<R: BufRead> Iterator for Lines<R> {
    type Item = String;

    /// The next line without its end; `None` also where the rest cannot be read.
    fn next(&mut self) -> Option<String> {
        loop {
            let mut line = Vec::new();
            if self.reader.by_ref().take(self.longest + 1).read_until(b'\n', &mut line).ok()? == 0 {
                return None;
            }
            if line.last() == Some(&b'\n') {
                line.pop();
            } else if line.len() as u64 > self.longest {
                self.reader.skip_until(b'\n').ok()?;
                continue;
            }
            if let Ok(text) = String::from_utf8(line) {
                return Some(text.strip_prefix('\u{feff}').map(str::to_owned).unwrap_or(text));
            }
        }
    }
}

/// Beginning and end of the names of temporary files, with six letters and digits between them.
const DRAFT: [&str; 2] = [".renderflow-", ".tmp"];

/// A file that is being written. It has a temporary name in the destination's folder until [`finish`](Self::finish) renames it. A
/// draft that is dropped earlier leaves nothing behind, and a file at the destination stays unchanged.
#[derive(Debug)]
pub struct Draft {
    path: PathBuf,
    temporary: tempfile::TempPath,
    /// `None` once it is closed.
    file: Option<File>,
}

impl Draft {
    /// Starts a file whose destination is `path`; the folder is created if it is missing.
    ///
    /// # Errors
    /// [`Error::Io`] naming `path`; [`Error::Malformed`] where a folder, a pipe, a socket or a device has that name.
    pub fn new(path: &Path) -> Result<Self> {
        // A rename would take its place.
        match std::fs::metadata(path) {
            Ok(about) if about.is_dir() => return Err(Error::malformed(path, "is a folder, not a file that can be written")),
            Ok(about) if !about.is_file() => {
                return Err(Error::malformed(path, "is a pipe, a socket or a device, not a file that can be written"));
            }
            _ => {}
        }
        let folder = folder_of(path);
        std::fs::create_dir_all(folder).map_err(Error::io(folder, "create folder"))?;
        let mut builder = tempfile::Builder::new();
        builder.prefix(DRAFT[0]).suffix(DRAFT[1]);
        // As any new file: the process's umask takes away what others must not do. Temporary files are for their owner alone.
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
        let named = builder.tempfile_in(folder);
        let (file, temporary) = named.map_err(Error::io(path, "write"))?.into_parts();
        Ok(Self { path: path.into(), temporary, file: Some(file) })
    }

    /// The path of the temporary file, for writers that take a path. The file exists and is empty at first.
    pub fn temporary(&self) -> &Path {
        &self.temporary
    }

    /// Flushes what was written and closes the file, so that fewer files are open at a time.
    ///
    /// # Errors
    /// [`Error::Io`] naming the destination, for instance on a full disk.
    pub fn close(&mut self) -> Result<()> {
        let Some(file) = self.file.take() else { return Ok(()) };
        file.sync_all().map_err(Error::io(&self.path, "write"))
    }

    /// Moves the file to its destination and replaces the file that is there.
    ///
    /// # Errors
    /// As [`close`](Self::close), and when it cannot be renamed.
    pub fn finish(mut self) -> Result<()> {
        self.close()?;
        self.temporary.persist(&self.path).map_err(|e| Error::io(&self.path, "rename")(e.error))
    }

    /// Moves the file to its destination, unless another file is there. Returns whether it was moved.
    ///
    /// # Errors
    /// As [`finish`](Self::finish).
    fn finish_as_first(mut self) -> Result<bool> {
        self.close()?;
        match self.temporary.persist_noclobber(&self.path) {
            Ok(()) => Ok(true),
            Err(e) if e.error.kind() == std::io::ErrorKind::AlreadyExists => Ok(false),
            // Some file systems can only replace.
            Err(e) => e.path.persist(&self.path).map(|()| true).map_err(|e| Error::io(&self.path, "rename")(e.error)),
        }
    }
}

impl Write for Draft {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.file.as_mut().ok_or(std::io::ErrorKind::BrokenPipe)?.write(bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.file.as_mut().map_or(Ok(()), File::flush)
    }
}

/// The folder that holds a file.
fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Whether this is the name of a file that a [`Draft`] left behind when its process was killed.
pub fn is_leftover(name: &str) -> bool {
    let random = name.strip_prefix(DRAFT[0]).and_then(|rest| rest.strip_suffix(DRAFT[1]));
    random.is_some_and(|random| random.len() == 6 && random.bytes().all(|b| b.is_ascii_alphanumeric()))
}

/// Removes the temporary files that killed processes of this program left behind in `folder`. No other file is touched, and files
/// that cannot be removed stay.
pub fn remove_leftovers(folder: &Path) {
    let Ok(entries) = std::fs::read_dir(folder) else { return };
    for entry in entries.flatten() {
        let is_file = entry.file_type().is_ok_and(|kind| kind.is_file());
        if is_file && entry.file_name().to_str().is_some_and(is_leftover) {
            let _ = std::fs::remove_file(entry.path());
        }
    }
}

/// Writes `bytes` to a temporary file in the folder of `path` (created if missing), then renames it over `path`.
/// On any error the temporary file is removed and `path` is as it was.
///
/// # Errors
/// [`Error::Io`] naming `path`, for instance on a full disk; as [`Draft::new`].
pub fn write_atomic(path: &Path, bytes: &[u8]) -> Result<()> {
    let mut draft = Draft::new(path)?;
    draft.write_all(bytes).map_err(Error::io(path, "write"))?;
    draft.finish()
}

/// As [`write_atomic`], but a file that is there stays. Returns whether the file was written. Of two processes that write at the
/// same time, one does, as far as the file system can tell them apart.
///
/// # Errors
/// As [`write_atomic`].
pub fn write_first(path: &Path, bytes: &[u8]) -> Result<bool> {
    let mut draft = Draft::new(path)?;
    draft.write_all(bytes).map_err(Error::io(path, "write"))?;
    draft.finish_as_first()
}

/// Whether the file at `path` holds exactly `bytes`.
///
/// # Errors
/// As [`open`].
pub fn holds(path: &Path, bytes: &[u8]) -> Result<bool> {
    let mut file = open(path)?;
    if file.metadata().map_err(Error::io(path, "read"))?.len() != bytes.len() as u64 {
        return Ok(false);
    }
    let (mut rest, mut buffer) = (bytes, vec![0; 1 << 16]);
    loop {
        let count = file.read(&mut buffer).map_err(Error::io(path, "read"))?;
        match rest.strip_prefix(&buffer[..count]) {
            Some(after) if count > 0 => rest = after,
            Some(after) => return Ok(after.is_empty()),
            None => return Ok(false),
        }
    }
}

/// Reads a JSON file of at most [`LARGEST_TEXT`] bytes; a byte order mark is skipped.
///
/// # Errors
/// When the file cannot be read, or does not hold a `T`; the message gives file, line and column.
pub fn read_json<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T> {
    parse_json(path, &read_at_most(path, LARGEST_TEXT)?)
}

/// As [`read_json`], but a file that [`write_json`] wrote may have up to `limit` bytes. One that is larger than [`LARGEST_TEXT`]
/// is not held in memory, and its lines must be short.
///
/// # Errors
/// As [`read_json`]; when the file is larger than `limit`, or a line of a large one is too long.
pub fn read_long_json<T: serde::de::DeserializeOwned>(path: &Path, limit: u64) -> Result<T> {
    read_json_in_lines(path, [LARGEST_TEXT, limit.max(LARGEST_TEXT)], LONGEST_LINE)
}

/// [`read_long_json`] with the sizes of files that are read whole, and in lines of at most `longest` bytes.
fn read_json_in_lines<T: serde::de::DeserializeOwned>(path: &Path, [whole, limit]: [u64; 2], longest: u64) -> Result<T> {
    let file = open(path)?;
    let length = file.metadata().map_err(Error::io(path, "read"))?.len();
    if length <= whole {
        return parse_json(path, &read_at_most(path, whole)?);
    }
    if length > limit {
        return Err(Error::malformed(path, format!("larger than the {limit} bytes that are read of such a file")));
    }
    let reader = ShortLines { reader: file.take(limit), longest, line: 0 };
    serde_json::from_reader(BufReader::new(reader))
        .map_err(|error| Error::malformed(path, crate::words::plain(&error.to_string())))
}

/// Fails where a line is longer than `longest` bytes, so that no text in it can be longer.
struct ShortLines<R> {
    reader: R,
    longest: u64,
    /// Bytes of the line so far.
    line: u64,
}

impl<R: Read> Read for ShortLines<R> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let count = self.reader.read(buffer)?;
        for &byte in &buffer[..count] {
            self.line = if byte == b'\n' { 0 } else { self.line + 1 };
            if self.line > self.longest {
                return Err(std::io::Error::other(format!("a line has more than {} bytes", self.longest)));
            }
        }
        Ok(count)
    }
}

/// [`read_json`] from memory; errors give `name` as the path.
///
/// # Errors
/// When the bytes do not hold a `T`; the message gives `name`, line and column.
pub fn parse_json<T: serde::de::DeserializeOwned>(name: &Path, json: &[u8]) -> Result<T> {
    let json = json.strip_prefix(b"\xef\xbb\xbf").unwrap_or(json);
    // serde_json's message ends with "at line L column C".
    serde_json::from_slice(json).map_err(|error| Error::malformed(name, crate::words::plain(&error.to_string())))
}

/// Writes a value as indented JSON with [`write_atomic`]. NaN and infinities become `null`, so callers must check for them first.
///
/// # Errors
/// When the value has no JSON form (a map whose keys are not strings) or the file cannot be written.
pub fn write_json<T: serde::Serialize + ?Sized>(path: &Path, value: &T) -> Result<()> {
    write_atomic(path, &json(path, value)?)
}

/// The bytes that [`write_json`] writes; errors give `name` as the path.
///
/// # Errors
/// When the value has no JSON form.
pub fn json<T: serde::Serialize + ?Sized>(name: &Path, value: &T) -> Result<Vec<u8>> {
    let mut json = serde_json::to_vec_pretty(value).map_err(|error| Error::malformed(name, error.to_string()))?;
    json.push(b'\n');
    Ok(json)
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn only_regular_files_of_a_size_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let refusal = |name: &str| read_at_most(&path(name), 8).unwrap_err().to_string();
        std::fs::write(path("eight"), b"12345678").unwrap();
        std::fs::write(path("nine"), b"123456789").unwrap();
        assert_eq!(read_at_most(&path("eight"), 8).unwrap(), b"12345678");
        assert!(refusal("nine").contains("larger than the 8 bytes"), "{}", refusal("nine"));
        assert!(refusal("none").contains("cannot read"));
        rustix::fs::mknodat(rustix::fs::CWD, path("pipe"), rustix::fs::FileType::Fifo, rustix::fs::Mode::RUSR, 0).unwrap();
        assert!(refusal("pipe").contains("not a regular file"));
        std::os::unix::fs::symlink("pipe", path("link")).unwrap();
        assert!(refusal("link").contains("not a regular file"));
        let socket = std::os::unix::net::UnixListener::bind(path("socket")).unwrap();
        assert!(read(&path("socket")).is_err());
        drop(socket);
        assert!(read(folder.path()).unwrap_err().to_string().contains("a folder"));
    }

    #[test]
    fn drafts_leave_nothing_and_take_no_other_files_place() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new/x");
        let names = || std::fs::read_dir(path.parent().unwrap()).unwrap().map(|e| e.unwrap().file_name()).collect::<Vec<_>>();
        write_atomic(&path, b"old").unwrap();
        let mut draft = Draft::new(&path).unwrap();
        draft.write_all(b"new").unwrap();
        let name = draft.temporary().file_name().unwrap().to_str().unwrap().to_owned();
        assert!(is_leftover(&name), "{name}");
        drop(draft);
        assert_eq!((std::fs::read(&path).unwrap(), names()), (b"old".to_vec(), vec!["x".into()]));
        let mut draft = Draft::new(&path).unwrap();
        draft.write_all(b"new").unwrap();
        draft.close().unwrap();
        assert!(draft.write_all(b"more").is_err());
        draft.finish().unwrap();
        assert_eq!((std::fs::read(&path).unwrap(), names()), (b"new".to_vec(), vec!["x".into()]));
        assert!(holds(&path, b"new").unwrap() && !holds(&path, b"neu").unwrap() && !holds(&path, b"newer").unwrap());
        // A pipe stays one: a device of that name would be gone for the whole system.
        let pipe = folder.path().join("pipe");
        rustix::fs::mknodat(rustix::fs::CWD, &pipe, rustix::fs::FileType::Fifo, rustix::fs::Mode::RUSR, 0).unwrap();
        assert!(write_atomic(&pipe, b"x").unwrap_err().to_string().contains("a pipe"));
        assert!(!std::fs::symlink_metadata(&pipe).unwrap().is_file());
        assert!(write_atomic(path.parent().unwrap(), b"x").unwrap_err().to_string().contains("is a folder"));
    }

    #[test]
    fn the_first_file_stays() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new/x");
        assert!(write_first(&path, b"first").unwrap());
        assert!(!write_first(&path, b"second").unwrap());
        assert_eq!(std::fs::read(&path).unwrap(), b"first");
        assert_eq!(std::fs::read_dir(path.parent().unwrap()).unwrap().count(), 1);
    }

    #[test]
    fn only_own_leftovers_are_removed() {
        let folder = tempfile::tempdir().unwrap();
        let others = [".abc.tmp", ".renderflow-abc.tmp", ".renderflow-abc_12.tmp", "renderflow-abc123.tmp", ".renderflow-abc123"];
        for name in others.iter().chain(&[".renderflow-aB3d5f.tmp"]) {
            std::fs::write(folder.path().join(name), b"half").unwrap();
        }
        std::fs::create_dir(folder.path().join(".renderflow-folder.tmp")).unwrap();
        remove_leftovers(folder.path());
        let mut left: Vec<_> =
            std::fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        left.sort();
        let mut expected = [&others[..], &[".renderflow-folder.tmp"]].concat();
        expected.sort_unstable();
        assert_eq!(left, expected);
    }

    #[test]
    fn lines_are_read_one_by_one() {
        let lines = |bytes: &[u8]| Lines { reader: bytes, longest: 4 }.collect::<Vec<String>>();
        assert_eq!(lines(b"a\n\n1234\n12345\n\xffb\nlast"), ["a", "", "1234", "last"]);
        assert_eq!(lines(b"123456789\r\nab\r\n1234"), ["ab\r", "1234"]);
        assert_eq!(lines("\u{feff}a\n12345".as_bytes()), ["a"]);
        assert!(lines(b"").is_empty());
    }

    #[test]
    fn large_files_of_json_are_read_in_lines() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.json");
        let numbers: Vec<u32> = (0..100).collect();
        write_json(&path, &numbers).unwrap();
        let length = std::fs::metadata(&path).unwrap().len();
        let read = |sizes, longest| read_json_in_lines::<Vec<u32>>(&path, sizes, longest).map_err(|e| e.to_string());
        assert_eq!(read([8, length], 8).unwrap(), numbers);
        assert!(read([8, length - 1], 8).unwrap_err().contains("larger than"));
        assert!(read([8, length], 4).unwrap_err().contains("a line has more than 4 bytes"));
        // Whole files may have any lines.
        assert_eq!(read([length, length], 1).unwrap(), numbers);
        std::fs::write(&path, "[\n1,\n2\n").unwrap();
        assert!(read([4, 100], 8).unwrap_err().contains("line"));
        std::fs::write(&path, "[\n1,\n2\n]\nx").unwrap();
        assert!(read([4, 100], 8).is_err());
    }

    #[test]
    fn a_byte_order_mark_is_skipped() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.json");
        std::fs::write(&path, b"\xef\xbb\xbf[1, 2]").unwrap();
        assert_eq!(read_json::<Vec<u8>>(&path).unwrap(), [1, 2]);
        assert_eq!(read_text(&path).unwrap(), "[1, 2]");
        std::fs::write(&path, b"ab\xff").unwrap();
        assert!(read_text(&path).unwrap_err().to_string().contains("byte 2 is not UTF-8"));
    }
}
