//! Writes one tar file to a draft, which is renamed at the end.

use super::sample::{self, Member};
use super::{Frames, Kind, Planned, Shard};
use crate::dataset::sequence::Sequence;
use crate::dataset::whole::key;
use crate::util::cancel::Cancel;
use crate::util::progress::Progress;
use anyhow::{Context, Result};
use rayon::prelude::*;
use renderflow_frame::file::Draft;
use std::io::{BufWriter, Write};
use std::path::Path;

/// Samples in memory at the same time: enough to keep all cores busy.
const AT_ONCE: usize = 32;

/// Counts and hashes everything that is written.
struct Hashing<W> {
    inner: W,
    hasher: blake3::Hasher,
    bytes: u64,
}

impl<W: Write> Write for Hashing<W> {
    fn write(&mut self, buffer: &[u8]) -> std::io::Result<usize> {
        let written = self.inner.write(buffer)?;
        self.hasher.update(&buffer[..written]);
        self.bytes += written as u64;
        Ok(written)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.inner.flush()
    }
}

/// Writes a shard.
pub fn shard(
    out: &Path,
    planned: &Planned,
    profile: Frames,
    source: String,
    progress: &Progress,
    cancel: &Cancel,
) -> Result<Shard> {
    let path = out.join(&planned.file);
    let cannot = || format!("{}: cannot write", path.display());
    let mut draft = Draft::new(&path)?;
    let inner = BufWriter::with_capacity(1 << 20, &mut draft);
    let mut archive = tar::Builder::new(Hashing { inner, hasher: blake3::Hasher::new(), bytes: 0 });
    for samples in planned.samples.chunks(AT_ONCE) {
        cancel.check()?;
        let members: Vec<(String, Vec<Member>)> = samples
            .par_iter()
            .map(|&(sequence, index)| match planned.kind {
                Kind::Frames => Ok((key(sequence, index), sample::frame(sequence, index, profile)?)),
                Kind::Sequences => Ok((sequence.name.clone(), sample::sequence(sequence)?)),
            })
            .collect::<Result<_>>()?;
        for (key, files) in &members {
            for (ending, bytes) in files {
                append(&mut archive, &format!("{key}.{ending}"), bytes).with_context(cannot)?;
            }
        }
        progress.add(samples.len() as u64);
    }
    let mut hashing = archive.into_inner().with_context(cannot)?;
    hashing.flush().with_context(cannot)?;
    let (bytes, blake3) = (hashing.bytes, hashing.hasher.finalize().to_hex().to_string());
    drop(hashing);
    draft.finish()?;
    let name = |&(sequence, index): &(&Sequence, usize)| match planned.kind {
        Kind::Frames => key(sequence, index),
        Kind::Sequences => sequence.name.clone(),
    };
    let ends = [planned.samples.first(), planned.samples.last()].map(|sample| sample.map(name).unwrap_or_default());
    let (file, split) = (planned.file.clone(), planned.split.to_owned());
    Ok(Shard { file, kind: planned.kind, split, samples: planned.samples.len() as u64, keys: ends, bytes, blake3, source })
}

/// Appends a file; its header says nothing about this machine, this user or this day.
fn append<W: Write>(archive: &mut tar::Builder<W>, name: &str, bytes: &[u8]) -> std::io::Result<()> {
    let mut header = tar::Header::new_ustar();
    header.set_entry_type(tar::EntryType::Regular);
    header.set_mode(0o644);
    header.set_uid(0);
    header.set_gid(0);
    header.set_mtime(0);
    header.set_size(bytes.len() as u64);
    archive.append_data(&mut header, name, bytes)
}
