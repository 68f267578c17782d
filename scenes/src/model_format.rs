//! The formats of model files, by name and by content.

use crate::error::{Error, Result};
use std::path::Path;

/// Formats of model files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// glTF 2.0, `.gltf` or `.glb`.
    Gltf,
    /// Wavefront `.obj`.
    Obj,
    /// Stanford `.ply`.
    Ply,
}

impl Format {
    /// Format by the ending of the file name, in capitals or not; `None` for any other.
    pub fn of(path: impl AsRef<Path>) -> Option<Self> {
        let ending = path.as_ref().extension()?.to_str()?.to_ascii_lowercase();
        match ending.as_str() {
            "gltf" | "glb" => Some(Self::Gltf),
            "obj" => Some(Self::Obj),
            "ply" => Some(Self::Ply),
            _ => None,
        }
    }

    /// Format by the first bytes of a file (a few thousand are enough); `None` for what is neither.
    pub fn sniff(head: &[u8]) -> Option<Self> {
        let text = head.strip_prefix(b"\xef\xbb\xbf").unwrap_or(head).trim_ascii_start();
        if text.starts_with(b"glTF") || text.starts_with(b"{") {
            return Some(Self::Gltf);
        }
        if text.strip_prefix(b"ply").is_some_and(|rest| rest.first().is_none_or(u8::is_ascii_whitespace)) {
            return Some(Self::Ply);
        }
        let known = [&b"v "[..], b"vn ", b"vt ", b"f ", b"o ", b"g ", b"mtllib "];
        let mut lines = text.split(|&b| b == b'\n' || b == b'\r').map(<[u8]>::trim_ascii);
        let first = lines.find(|line| !line.is_empty() && !line.starts_with(b"#"))?;
        known.iter().any(|word| first.starts_with(word)).then_some(Self::Obj)
    }

    /// Format of a file: by its content, or else by its name.
    pub(crate) fn of_file(path: &Path) -> Result<Option<Self>> {
        let mut head = Vec::new();
        let file = renderflow_frame::file::open(path)?;
        std::io::Read::read_to_end(&mut std::io::Read::take(file, 4096), &mut head).map_err(Error::io(path, "read"))?;
        Ok(Self::sniff(&head).or(Self::of(path)))
    }
}
