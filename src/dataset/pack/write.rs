//! One tar file, written beside its place and renamed.

use super::sample::{self, Member};
use super::{Frames, Kind, Planned, Shard};
use crate::progress::Progress;
use crate::truth::Interrupted;
use anyhow::{Context, Result};
use rayon::prelude::*;
use renderflow_frame::file::Draft;
use std::io::{BufWriter, Write};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

/// Samples in memory at a time; enough to keep cores busy that convert them.
const AT_ONCE: usize = 32;

/// Counts and hashes what passes.
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
    cancel: &AtomicBool,
) -> Result<Shard> {
    let path = out.join(&planned.file);
    let cannot = || format!("{}: cannot write", path.display());
    let mut draft = Draft::new(&path)?;
    let inner = BufWriter::with_capacity(1 << 20, &mut draft);
    let mut archive = tar::Builder::new(Hashing { inner, hasher: blake3::Hasher::new(), bytes: 0 });
    for samples in planned.samples.chunks(AT_ONCE) {
        if cancel.load(Ordering::Relaxed) {
            return Err(Interrupted.into());
        }
        let members: Vec<(String, Vec<Member>)> = samples
            .par_iter()
            .map(|&(source, index)| match planned.kind {
                Kind::Frames => Ok((source.key(index), sample::frame(source, index, profile)?)),
                Kind::Sequences => Ok((source.name.clone(), sample::sequence(source)?)),
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
    let key = |&(source, index): &(&super::Source, usize)| match planned.kind {
        Kind::Frames => source.key(index),
        Kind::Sequences => source.name.clone(),
    };
    let ends = [planned.samples.first(), planned.samples.last()].map(|sample| sample.map(key).unwrap_or_default());
    let (file, split) = (planned.file.clone(), planned.split.to_owned());
    Ok(Shard { file, kind: planned.kind, split, samples: planned.samples.len() as u64, keys: ends, bytes, blake3, source })
}

/// Appends a file whose header says nothing of this machine, this user or this day.
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
