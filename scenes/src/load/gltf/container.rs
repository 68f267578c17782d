//! The container of binary glTF (glTF 2.0, section 4.4).
//!
//! The reader of the gltf crate is not used here: it (1.4) subtracts the header from the stated length unchecked, and refuses
//! chunks of unknown types and bytes behind the container, which readers are to ignore.

/// The JSON and the binary chunk of a file; a file that is no container is JSON as a whole. The error says what is wrong, in
/// words.
pub(super) fn split(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), String> {
    if !bytes.starts_with(b"glTF") {
        return Ok((bytes, None));
    }
    let word = |at: usize| bytes.get(at..at + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    let (Some(version), Some(length)) = (word(4), word(8)) else { return Err("the file ends in its header".into()) };
    if version != 2 {
        return Err(format!("binary glTF of version {version}, only 2 is read"));
    }
    let end = length as usize;
    if end < 12 || end > bytes.len() {
        return Err(format!("the header says {length} bytes, the file has {}", bytes.len()));
    }
    let (mut json, mut binary) = (None, None);
    let mut at = 12;
    while at < end {
        let (Some(size), Some(kind)) = (word(at), bytes.get(at + 4..at + 8)) else {
            return Err(format!("the chunk at byte {at} ends in its header"));
        };
        let chunk = bytes[..end].get(at + 8..at + 8 + size as usize);
        let chunk = chunk.ok_or_else(|| format!("the chunk at byte {at} of {size} bytes leaves the {end} bytes of the file"))?;
        let first = at == 12;
        match kind {
            b"JSON" if first => json = Some(chunk),
            b"JSON" => return Err(format!("a second JSON chunk at byte {at}")),
            b"BIN\0" if binary.is_none() && !first => binary = Some(chunk),
            b"BIN\0" => return Err(format!("a binary chunk out of place at byte {at}")),
            _ => {}
        }
        at += 8 + size as usize;
    }
    Ok((json.ok_or("the first chunk is not JSON")?, binary))
}

#[cfg(test)]
mod tests {
    use super::split;

    fn container(chunks: &[(&[u8; 4], &[u8])]) -> Vec<u8> {
        let chunks: Vec<u8> =
            chunks.iter().flat_map(|(kind, data)| [&(data.len() as u32).to_le_bytes(), &kind[..], data].concat()).collect();
        [&b"glTF\x02\0\0\0"[..], &(12 + chunks.len() as u32).to_le_bytes(), &chunks].concat()
    }

    #[test]
    fn chunks_of_unknown_types_and_bytes_behind_the_container_are_ignored() {
        let mut bytes = container(&[(b"JSON", b"{}  "), (b"BIN\0", &[1, 2, 3, 4]), (b"UNKN", &[5; 8])]);
        bytes.push(0);
        assert_eq!(split(&bytes), Ok((&b"{}  "[..], Some(&[1, 2, 3, 4][..]))));
        assert_eq!(split(b"{}"), Ok((&b"{}"[..], None)));
    }

    #[test]
    fn damage_is_named() {
        let good = container(&[(b"JSON", b"{}  "), (b"BIN\0", &[1, 2, 3, 4])]);
        for length in 4..good.len() {
            assert!(split(&good[..length]).is_err(), "{length}");
        }
        let error = |chunks: &[(&[u8; 4], &[u8])]| split(&container(chunks)).unwrap_err();
        assert_eq!(error(&[(b"UNKN", b"{}"), (b"JSON", b"{}")]), "a second JSON chunk at byte 22");
        assert_eq!(error(&[(b"JSON", b"{}"), (b"BIN\0", b"12"), (b"BIN\0", b"12")]), "a binary chunk out of place at byte 32");
        assert_eq!(error(&[]), "the first chunk is not JSON");
        let mut long = good.clone();
        long[12..16].copy_from_slice(&u32::MAX.to_le_bytes());
        assert_eq!(split(&long).unwrap_err(), "the chunk at byte 12 of 4294967295 bytes leaves the 36 bytes of the file");
        let mut old = good;
        old[4] = 1;
        assert_eq!(split(&old).unwrap_err(), "binary glTF of version 1, only 2 is read");
    }
}
