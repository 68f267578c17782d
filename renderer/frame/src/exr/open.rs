//! Opens OpenEXR bytes that may be damaged or hostile.

use crate::words::shortened;
use crate::{Error, Result, guard, rgbe};
use ::exr::compression::Compression;
use ::exr::meta::MetaData;
use ::exr::meta::header::Header;
use std::cell::Cell;
use std::io::{Cursor, Read, Seek, SeekFrom};
use std::path::Path;

/// A reader of a file's bytes that records how far they have been read.
pub(super) struct Source<'a> {
    cursor: Cursor<&'a [u8]>,
    reached: &'a Cell<u64>,
}

impl Read for Source<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let count = self.cursor.read(buffer)?;
        self.reached.set(self.cursor.position());
        Ok(count)
    }
}

impl Seek for Source<'_> {
    fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
        let at = self.cursor.seek(to)?;
        self.reached.set(at);
        Ok(at)
    }
}

/// Runs a decoder of the `exr` crate on `bytes`; its errors and its panics become errors that name the file and the place in it.
///
/// The crate has no reader that is free of panics: damaged B44 blocks overflow its arithmetic (a panic with overflow checks), and
/// other places rely on `expect` and slice bounds.
pub(super) fn guarded<T>(name: &Path, bytes: &[u8], decode: impl FnOnce(Source) -> ::exr::error::Result<T>) -> Result<T> {
    let reached = Cell::new(0);
    let source = Source { cursor: Cursor::new(bytes), reached: &reached };
    let reason = match guard::guarded(|| decode(source)) {
        Some(Ok(value)) => return Ok(value),
        Some(Err(error)) => reason(&error),
        None => "damaged OpenEXR data".into(),
    };
    Err(Error::malformed(name, format!("{}: {reason}", place(bytes, reached.get()))))
}

/// What is wrong, in words.
fn reason(error: &::exr::error::Error) -> String {
    let text = error.to_string();
    match text.strip_prefix("invalid: ").unwrap_or(&text) {
        "reference to missing bytes" => "bytes that the file does not have are needed here".into(),
        "integer conversion failed: value out of range" => "a number out of its range".into(),
        "content size" => "a part that is as large as no file can be".into(),
        "file identifier missing" => "no OpenEXR signature".into(),
        "unexpected end of file" => "the file ends here".into(),
        other => other.to_owned(),
    }
}

/// Describes where byte `at` is: in which attribute of the header, or behind the header.
fn place(bytes: &[u8], at: u64) -> String {
    let at = usize::try_from(at).unwrap_or(usize::MAX);
    let text = |from: usize| {
        let rest = bytes.get(from..)?;
        let length = rest.iter().position(|&b| b == 0)?;
        Some((String::from_utf8_lossy(&rest[..length]).into_owned(), from + length + 1))
    };
    // Signature and version, then attributes (name, kind, size, value) until an empty name.
    let mut from = 8;
    let header = format!("byte {at}, in the header");
    loop {
        let Some((attribute, end)) = text(from) else { return header };
        if attribute.is_empty() {
            return if at <= end { header } else { format!("byte {at}, behind the first header") };
        }
        let value = text(end).and_then(|(_, end)| Some(end + 4 + little_endian(bytes.get(end..end + 4)?)));
        match value {
            Some(end) if end < at => from = end,
            _ => return format!("byte {at}, attribute {:?}", shortened(&attribute)),
        }
    }
}

fn little_endian(bytes: &[u8]) -> usize {
    bytes.iter().rev().fold(0, |number, &byte| number << 8 | usize::from(byte))
}

/// The headers of a file. It is checked that decoding asks for no more memory than the file can justify, and for at most `most`
/// pixels.
pub(super) fn meta_data(name: &Path, bytes: &[u8], most: usize) -> Result<MetaData> {
    let meta = guarded(name, bytes, |source| MetaData::read_from_buffered(source, false))?;
    // A contradiction between two attributes has no single place.
    match guard::guarded(|| MetaData::validate(&meta.headers, false)) {
        Some(Ok(_)) => {}
        Some(Err(error)) => return Err(Error::malformed(name, format!("header: {}", reason(&error)))),
        None => return Err(Error::malformed(name, "header: damaged OpenEXR data")),
    }
    for header in &meta.headers {
        check_size(header, bytes.len(), most).map_err(|reason| Error::malformed(name, reason))?;
    }
    Ok(meta)
}

fn check_size(header: &Header, file_bytes: usize, most: usize) -> std::result::Result<(), String> {
    let (width, height) = (header.layer_size.width(), header.layer_size.height());
    let sides = 1..=rgbe::MAXIMUM_SIDE;
    if !sides.contains(&width) || !sides.contains(&height) || width * height > most {
        return Err(format!("{width} x {height} is outside 1..={} a side and {most} pixels in all", rgbe::MAXIMUM_SIDE));
    }
    if matches!(header.compression, Compression::DWAA(_) | Compression::DWAB(_)) {
        // exr 1.74 allocates whatever a 64-bit count in each DWA block says, and a failed allocation ends the program.
        return Err("DWA compression is not supported; save it with ZIP".into());
    }
    // Each chunk has at least an offset (8 bytes), a place and a size (4 each).
    let pixel_bytes = width * height * header.channels.bytes_per_pixel;
    if header.chunk_count.saturating_mul(16) > file_bytes || pixel_bytes / largest_ratio(header.compression) > file_bytes {
        return Err(format!("{width} x {height} with {} channels cannot be in {file_bytes} bytes", header.channels.list.len()));
    }
    Ok(())
}

/// Upper bound of the bytes that one byte of the file can become.
fn largest_ratio(compression: Compression) -> usize {
    match compression {
        Compression::Uncompressed => 1,
        // Deflate reaches 1032; PIZ and RLE stay below.
        _ => 1_100,
    }
}
