//! URIs of glTF buffers and images: data URIs and files beside the model. Nothing is fetched from a network.

use base64::Engine;
use base64::alphabet::STANDARD;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
use std::path::{Path, PathBuf};

/// Some exporters leave out the padding.
const BASE64: GeneralPurpose = GeneralPurpose::new(
    &STANDARD,
    GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent).with_decode_allow_trailing_bits(true),
);

/// Bytes behind `uri` as written in the glTF file `model`; the error says what is wrong, in words.
pub(super) fn read(model: &Path, uri: &str) -> Result<Vec<u8>, String> {
    if let Some(rest) = uri.strip_prefix("data:") {
        let (kind, data) = rest.split_once(',').ok_or("the data URI has no comma")?;
        return if kind.ends_with(";base64") {
            BASE64.decode(data.trim()).map_err(|e| format!("the data URI is not base64: {e}"))
        } else {
            Ok(unescaped(data))
        };
    }
    let path = file(model, uri)?;
    // A pipe or a device would be read for ever.
    let kind = std::fs::metadata(&path).map_err(|e| format!("cannot read {}: {e}", path.display()))?;
    if !kind.is_file() {
        return Err(format!("{} is not a regular file", path.display()));
    }
    std::fs::read(&path).map_err(|e| format!("cannot read {}: {e}", path.display()))
}

/// File a relative URI refers to.
pub(super) fn file(model: &Path, uri: &str) -> Result<PathBuf, String> {
    let scheme = uri.split_once(':').is_some_and(|(s, _)| !s.contains('/'));
    if scheme || uri.starts_with(['/', '\\']) {
        return Err(format!("{:?} is not a path relative to the file", shortened(uri)));
    }
    let name = String::from_utf8(unescaped(uri)).map_err(|_| format!("{:?} is not UTF-8", shortened(uri)))?;
    if name.is_empty() || name.contains('\0') {
        return Err(format!("{:?} is not a file name", shortened(uri)));
    }
    Ok(model.parent().unwrap_or(Path::new("")).join(name))
}

/// The beginning of a URI, for messages.
pub(super) fn shortened(uri: &str) -> String {
    if uri.chars().count() <= 60 { uri.into() } else { uri.chars().take(57).chain("...".chars()).collect() }
}

/// Percent-encoding undone (RFC 3986, section 2.1); a stray `%` stays.
fn unescaped(text: &str) -> Vec<u8> {
    let bytes = text.as_bytes();
    let digit = |i: usize| bytes.get(i).and_then(|&b| char::from(b).to_digit(16));
    let mut result = Vec::with_capacity(bytes.len());
    let mut i = 0;
    while i < bytes.len() {
        match (bytes[i], digit(i + 1), digit(i + 2)) {
            (b'%', Some(high), Some(low)) => {
                result.push((16 * high + low) as u8);
                i += 3;
            }
            (byte, ..) => {
                result.push(byte);
                i += 1;
            }
        }
    }
    result
}
