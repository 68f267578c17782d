//! Opens OpenEXR bytes that may be damaged or hostile.

use crate::{Error, Result, rgbe};
use ::exr::compression::Compression;
use ::exr::meta::MetaData;
use ::exr::meta::header::Header;
use std::path::Path;

/// Runs a decoder of the `exr` crate; its errors and its panics become errors that name the file.
///
/// The crate has no reader that is free of panics: damaged B44 blocks overflow its arithmetic (a panic with overflow checks), and other
/// places rely on `expect` and slice bounds. All such calls here work on bytes in memory in one thread and keep nothing, so unwinding leaves no broken state behind.
pub(super) fn guarded<T>(name: &Path, decode: impl FnOnce() -> ::exr::error::Result<T>) -> Result<T> {
    match std::panic::catch_unwind(std::panic::AssertUnwindSafe(decode)) {
        Ok(Ok(value)) => Ok(value),
        Ok(Err(error)) => Err(Error::malformed(name, error.to_string())),
        Err(_) => Err(Error::malformed(name, "damaged OpenEXR data")),
    }
}

/// The headers of a file, after checking that decoding cannot ask for more memory than the file can justify.
pub(super) fn meta_data(name: &Path, bytes: &[u8]) -> Result<MetaData> {
    let meta = guarded(name, || {
        let meta = MetaData::read_from_buffered(bytes, false)?;
        MetaData::validate(&meta.headers, false)?;
        Ok(meta)
    })?;
    for header in &meta.headers {
        check_size(header, bytes.len()).map_err(|reason| Error::malformed(name, reason))?;
    }
    Ok(meta)
}

fn check_size(header: &Header, file_bytes: usize) -> std::result::Result<(), String> {
    let (width, height) = (header.layer_size.width(), header.layer_size.height());
    let sides = 1..=rgbe::MAXIMUM_SIDE;
    if !sides.contains(&width) || !sides.contains(&height) || width * height > rgbe::MAXIMUM_PIXELS {
        return Err(format!(
            "{width} x {height} is outside 1..={} a side and {} pixels in all",
            rgbe::MAXIMUM_SIDE,
            rgbe::MAXIMUM_PIXELS
        ));
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

/// Bytes that one byte of the file can become at most, generously.
fn largest_ratio(compression: Compression) -> usize {
    match compression {
        Compression::Uncompressed => 1,
        // Deflate reaches 1032; PIZ and RLE stay below.
        _ => 1_100,
    }
}
