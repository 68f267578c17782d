//! URIs of glTF buffers and images: data URIs and files beside the model. Nothing is fetched from a network.

use base64::Engine;
use base64::alphabet::STANDARD;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
use renderflow_frame::reach::Reach;
use renderflow_frame::words::shortened;
use std::path::PathBuf;

/// Some exporters leave out the padding.
const BASE64: GeneralPurpose = GeneralPurpose::new(
    &STANDARD,
    GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent).with_decode_allow_trailing_bits(true),
);

/// Bytes behind `uri`; the error says what is wrong, in words.
pub(super) fn read(reach: &Reach, uri: &str) -> Result<Vec<u8>, String> {
    if let Some(rest) = uri.strip_prefix("data:") {
        let (kind, data) = rest.split_once(',').ok_or("the data URI has no comma")?;
        return if kind.ends_with(";base64") {
            BASE64.decode(data.trim()).map_err(|e| format!("the data URI is not base64: {e}"))
        } else {
            Ok(unescaped(data))
        };
    }
    let path = file(reach, uri)?;
    let bytes = renderflow_frame::file::read(&path).map_err(|e| match &e {
        renderflow_frame::Error::Io { source, .. } => format!("cannot read {}: {source}", path.display()),
        other => other.to_string(),
    })?;
    reach.note(&path);
    Ok(bytes)
}

/// File a relative URI refers to. Its name is what the percent-encoding stands for: what it hides is judged, not how it is
/// written.
pub(super) fn file(reach: &Reach, uri: &str) -> Result<PathBuf, String> {
    let relative = || format!("{:?} is not a path relative to the file", shortened(uri));
    if uri.split_once(':').is_some_and(|(scheme, _)| !scheme.contains('/')) {
        return Err(relative());
    }
    let name = String::from_utf8(unescaped(uri)).map_err(|_| format!("{:?} is not UTF-8", shortened(uri)))?;
    if name.starts_with(['/', '\\']) {
        return Err(relative());
    }
    reach.resolve(&name)
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
