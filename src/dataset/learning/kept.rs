//! Sequences for training that were made once and are kept in a folder, so that later runs read them instead of rendering them.
//!
//! A sequence is one safetensors file: a tensor of bytes for each frame, and what else a [`Record`] holds as JSON in the
//! metadata. The bytes are one zstd frame with a checksum. They are the planes of `[at::COUNT][height][width]` half floats, first
//! the high byte of every number and then the low byte, which makes them a third smaller.

use super::Indexed;
use crate::util::files::is_at;
use anyhow::{Context, Result, ensure};
use half::f16;
use rayon::prelude::*;
use renderflow_frame::file;
use renderflow_model::fusion::Record;
use renderflow_model::fusion::record::{KEYS, NEIGHBOURS, PARTS, PICTURES, at};
use renderflow_model::fusion::training::Source;
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::fs::{File, TryLockError};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Changes when sequences of the same plan and recipe get other numbers.
const VERSION: u32 = 11;
/// The entry of the metadata.
const HEADER: &str = "renderflow_records";
/// Strength of the compression; more is slower and hardly smaller.
const LEVEL: i32 = 1;

/// Time between two looks at a sequence that another process makes.
const WAIT: Duration = Duration::from_millis(100);

/// A sequence that this process makes. The claim is a lock on a file beside the sequence's, which ends with the process.
struct Claim {
    /// `None` where files cannot be locked. Then each process makes the sequence.
    lock: Option<(PathBuf, File)>,
}

impl Claim {
    /// Claims the sequence in the file `path`, unless another process makes it.
    fn of(path: &Path) -> Option<Self> {
        let path = path.with_extension("lock");
        loop {
            let Ok(file) = File::options().create(true).append(true).open(&path) else { return Some(Self { lock: None }) };
            match file.try_lock() {
                Ok(()) if is_at(&file, &path) => return Some(Self { lock: Some((path, file)) }),
                // The process that had the lock removed its file after this one opened it.
                Ok(()) => {}
                Err(TryLockError::WouldBlock) => return None,
                Err(TryLockError::Error(_)) => return Some(Self { lock: None }),
            }
        }
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        if let Some((path, file)) = self.lock.take() {
            // A file that stays does no harm, and the lock ends with the handle.
            let _ = std::fs::remove_file(path);
            drop(file);
        }
    }
}

/// A record without its pixels.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Header {
    width: usize,
    height: usize,
    deferred: bool,
    distances: [Option<f32>; KEYS],
    parts: [u32; PARTS],
    neighbours: [u32; NEIGHBOURS],
    denoised: [bool; PICTURES],
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    paths: bool,
    /// Whether [`Record::spread`] follows the pixels.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    spread: bool,
}

/// A source whose sequences are kept in a folder.
pub struct Kept<'a> {
    source: &'a dyn Indexed,
    folder: PathBuf,
    /// Number of processes that ask for the same sequences, at least 1.
    processes: u64,
}

impl<'a> Kept<'a> {
    /// Keeps the sequences of `source` inside `folder`. Sources that differ have folders of their own there.
    ///
    /// # Errors
    /// When the folder cannot be made.
    pub fn new(source: &'a dyn Indexed, folder: &Path) -> Result<Self> {
        let name = blake3::hash(format!("{VERSION} {} {}", at::COUNT, source.content()).as_bytes()).to_hex();
        let folder = folder.join(&name[..16]);
        std::fs::create_dir_all(&folder).with_context(|| format!("{}: cannot be made", folder.display()))?;
        Ok(Self { source, folder, processes: 1 })
    }

    /// Tells that so many `processes` ask for the same sequences in the same order, at least 1. They share the work: while one
    /// makes a sequence, the others make those that come next.
    pub fn shared_by(self, processes: usize) -> Self {
        Self { processes: processes as u64, ..self }
    }

    fn path(&self, i: u64) -> PathBuf {
        self.folder.join(format!("{:06}.safetensors", self.source.index(i)))
    }

    /// The records of sequence `i`: from the folder, or made and then kept there.
    ///
    /// # Errors
    /// When the sequence is not there and cannot be made. A file that cannot be read or written is reported as a warning.
    pub fn records(&self, i: u64) -> renderflow_model::Result<Vec<Record<f16>>> {
        let path = self.path(i);
        let mut damaged = false;
        loop {
            if path.is_file() && !damaged {
                match read(&path) {
                    Ok(records) => return Ok(records),
                    Err(error) => tracing::warn!("{error:#}; it is made once more"),
                }
                damaged = true;
            }
            match Claim::of(&path) {
                // Another process has made it in between.
                Some(_) if path.is_file() && !damaged => {}
                Some(_claim) => return self.make_and_keep(i),
                None => {
                    damaged = false;
                    self.work_ahead(i)?;
                }
            }
        }
    }

    fn make_and_keep(&self, i: u64) -> renderflow_model::Result<Vec<Record<f16>>> {
        let records = self.source.make(i)?;
        if let Err(error) = encode(&records).and_then(|bytes| Ok(file::write_atomic(&self.path(i), &bytes)?)) {
            tracing::warn!("the sequence is used but not kept: {error:#}");
        }
        Ok(records)
    }

    /// Makes one of the sequences after `i` that no process works at, or waits a moment if there is none.
    fn work_ahead(&self, i: u64) -> renderflow_model::Result<()> {
        for next in i + 1..i + self.processes {
            let path = self.path(next);
            if path.is_file() {
                continue;
            }
            if let Some(_claim) = Claim::of(&path)
                && !path.is_file()
            {
                return self.make_and_keep(next).map(drop);
            }
        }
        std::thread::sleep(WAIT);
        Ok(())
    }
}

impl Source for Kept<'_> {
    fn make(&self, i: u64) -> renderflow_model::Result<Vec<Record<f16>>> {
        self.records(i)
    }

    fn identity(&self) -> String {
        self.source.identity()
    }
}

/// Reads the records of a sequence that was kept in the file `path`.
///
/// # Errors
/// When the file cannot be read, or does not hold a sequence of this version of the program.
pub fn read(path: &Path) -> Result<Vec<Record<f16>>> {
    let bytes = file::read(path)?;
    decode(&bytes).with_context(|| path.display().to_string())
}

/// The file of a sequence.
fn encode(records: &[Record<f16>]) -> Result<Vec<u8>> {
    let blocks = records.par_iter().map(pack).collect::<Result<Vec<_>>>()?;
    let headers: Vec<Header> = records
        .iter()
        .map(|record| Header {
            width: record.width,
            height: record.height,
            deferred: record.deferred,
            distances: record.distances,
            parts: record.parts,
            neighbours: record.neighbours,
            spread: !record.spread.is_empty(),
            denoised: record.denoised,
            paths: record.paths,
        })
        .collect();
    let mut tensors = Vec::new();
    for (i, block) in blocks.iter().enumerate() {
        tensors.push((format!("{i:03}"), TensorView::new(Dtype::U8, vec![block.len()], block)?));
    }
    let metadata = HashMap::from([(HEADER.to_owned(), serde_json::to_string(&headers)?)]);
    Ok(safetensors::serialize(tensors, Some(metadata))?)
}

/// The sequence in a file.
fn decode(bytes: &[u8]) -> Result<Vec<Record<f16>>> {
    let tensors = SafeTensors::deserialize(bytes)?;
    let (_, metadata) = SafeTensors::read_metadata(bytes)?;
    let header = metadata.metadata().as_ref().and_then(|entries| entries.get(HEADER));
    let headers: Vec<Header> = serde_json::from_str(header.context("does not hold sequences for training")?)?;
    let frame = |(i, header): (usize, Header)| unpack(header, tensors.tensor(&format!("{i:03}"))?.data());
    headers.into_iter().enumerate().collect::<Vec<_>>().into_par_iter().map(frame).collect()
}

/// The pixels of a record, by planes and compressed.
fn pack(record: &Record<f16>) -> Result<Vec<u8>> {
    let count = record.width * record.height;
    let values = count * at::COUNT + record.spread.len();
    let mut planes = vec![0; 2 * values];
    let (high, low) = planes.split_at_mut(values);
    for (p, pixel) in record.pixels.chunks_exact(at::COUNT).enumerate() {
        for (channel, value) in pixel.iter().enumerate() {
            [low[channel * count + p], high[channel * count + p]] = value.to_le_bytes();
        }
    }
    for (p, spread) in record.spread.iter().enumerate() {
        [low[at::COUNT * count + p], high[at::COUNT * count + p]] = f16::from_f32(*spread).to_le_bytes();
    }
    let mut encoder = zstd::Encoder::new(Vec::new(), LEVEL)?;
    encoder.include_checksum(true)?;
    encoder.write_all(&planes)?;
    Ok(encoder.finish()?)
}

/// The record that [`pack`] compressed.
fn unpack(header: Header, block: &[u8]) -> Result<Record<f16>> {
    let Header { width, height, deferred, distances, parts, neighbours, denoised, paths, spread } = header;
    let channels = at::COUNT + usize::from(spread);
    let size = width.checked_mul(height).and_then(|count| count.checked_mul(2 * channels));
    let size = size.filter(|size| *size > 0 && *size <= 1 << 32).context("a frame of impossible size")?;
    let mut planes = Vec::new();
    zstd::Decoder::new(block)?.take(size as u64 + 1).read_to_end(&mut planes)?;
    ensure!(planes.len() == size, "a frame of {} bytes where its header says {size}", planes.len());
    let count = width * height;
    let (high, low) = planes.split_at(count * channels);
    let value_at = |at: usize| f16::from_le_bytes([low[at], high[at]]);
    let mut pixels = vec![f16::ZERO; count * at::COUNT];
    for (p, pixel) in pixels.chunks_exact_mut(at::COUNT).enumerate() {
        for (channel, value) in pixel.iter_mut().enumerate() {
            *value = value_at(channel * count + p);
        }
    }
    let spread = (at::COUNT * count..channels * count).map(|at| value_at(at).to_f32()).collect();
    Ok(Record { width, height, pixels, deferred, distances, parts, spread, neighbours, denoised, paths })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicU64, Ordering};

    /// Three frames a sequence, and the number of sequences that were made.
    struct Counted(AtomicU64);

    impl Source for Counted {
        fn make(&self, i: u64) -> renderflow_model::Result<Vec<Record<f16>>> {
            self.0.fetch_add(1, Ordering::Relaxed);
            let frame = |f: usize| {
                let mut record = Record::<f32>::new(16 + 16 * f, 8);
                record.pixels.iter_mut().enumerate().for_each(|(k, v)| *v = (k as f32 * 0.37 + i as f32 + f as f32).sin());
                record.pixels[3] = f32::NEG_INFINITY;
                Record {
                    deferred: f == 0,
                    distances: [Some(-3.0), None],
                    parts: [4, 1, 0, 0],
                    spread: if f == 1 { (0..32 * 8).map(|k| [0.5, 1.0, 4.0][k % 3]).collect() } else { Vec::new() },
                    neighbours: [1, 0, 0, 2],
                    denoised: [true, false, false, false, true, false],
                    paths: f == 1,
                    ..record.to_half()
                }
            };
            Ok((0..3).map(frame).collect())
        }

        fn identity(&self) -> String {
            "counted".into()
        }
    }

    impl Indexed for Counted {
        fn content(&self) -> String {
            "counted".into()
        }

        fn index(&self, i: u64) -> u64 {
            i + 7
        }
    }

    fn same(a: &[Record<f16>], b: &[Record<f16>]) -> bool {
        let bits = |record: &Record<f16>| -> Vec<u16> { record.pixels.iter().map(|v| v.to_bits()).collect() };
        a.len() == b.len()
            && a.iter().zip(b).all(|(a, b)| {
                (a.width, a.height, a.deferred, a.distances) == (b.width, b.height, b.deferred, b.distances)
                    && (a.parts, &a.spread, a.neighbours, a.denoised) == (b.parts, &b.spread, b.neighbours, b.denoised)
                    && a.paths == b.paths
                    && bits(a) == bits(b)
            })
    }

    #[test]
    fn a_sequence_is_made_once_and_read_to_the_last_bit() {
        let folder = tempfile::tempdir().unwrap();
        let source = Counted(AtomicU64::new(0));
        let kept = Kept::new(&source, folder.path()).unwrap();
        let made = kept.records(2).unwrap();
        assert!(same(&made, &source.make(2).unwrap()));
        assert!(same(&kept.records(2).unwrap(), &made));
        assert_eq!(source.0.load(Ordering::Relaxed), 2);
        assert!(kept.folder.join("000009.safetensors").is_file());
        // Another run finds it too.
        assert!(same(&Kept::new(&source, folder.path()).unwrap().records(2).unwrap(), &made));
        assert_eq!(source.0.load(Ordering::Relaxed), 2);
    }

    /// Takes its time, so that the others find it at work.
    struct Slow(Counted);

    impl Source for Slow {
        fn make(&self, i: u64) -> renderflow_model::Result<Vec<Record<f16>>> {
            std::thread::sleep(Duration::from_millis(20));
            self.0.make(i)
        }

        fn identity(&self) -> String {
            self.0.identity()
        }
    }

    impl Indexed for Slow {
        fn content(&self) -> String {
            self.0.content()
        }

        fn index(&self, i: u64) -> u64 {
            self.0.index(i)
        }
    }

    #[test]
    fn processes_make_each_sequence_once_and_all_of_them_together() {
        let folder = tempfile::tempdir().unwrap();
        let sources = [(); 3].map(|()| Slow(Counted(AtomicU64::new(0))));
        std::thread::scope(|scope| {
            for source in &sources {
                scope.spawn(|| {
                    let kept = Kept::new(source, folder.path()).unwrap().shared_by(3);
                    (0..12).for_each(|i| assert!(same(&kept.records(i).unwrap(), &source.0.make(i).unwrap())));
                });
            }
        });
        // Each has compared all sequences.
        let made = sources.map(|source| source.0.0.load(Ordering::Relaxed) - 12);
        let all = made.iter().sum::<u64>();
        // While the last are made, the others may go on with the two that come next.
        assert!((12..=14).contains(&all) && made.iter().all(|count| *count > 1), "{made:?}");
        let kept = Kept::new(&Counted(AtomicU64::new(0)), folder.path()).unwrap().folder;
        assert_eq!(std::fs::read_dir(kept).unwrap().count() as u64, all, "each is made once, and no lock stays");
    }

    #[test]
    fn a_claim_ends_with_its_process() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("000007.safetensors");
        let claim = Claim::of(&path).expect("nobody works at it");
        assert!(Claim::of(&path).is_none());
        drop(claim);
        // A process that was killed leaves the file, but no lock.
        std::fs::write(path.with_extension("lock"), b"").unwrap();
        assert!(Claim::of(&path).is_some());
    }

    #[test]
    fn a_damaged_sequence_is_made_once_more() {
        let folder = tempfile::tempdir().unwrap();
        let source = Counted(AtomicU64::new(0));
        let kept = Kept::new(&source, folder.path()).unwrap();
        let made = kept.records(0).unwrap();
        let path = kept.folder.join("000007.safetensors");
        let whole = std::fs::read(&path).unwrap();
        let flipped = |at: usize| {
            let mut bytes = whole.clone();
            bytes[at] ^= 0x10;
            bytes
        };
        let half = whole.len() / 2;
        let cases = [whole[..half].to_vec(), flipped(whole.len() - 9), flipped(half), b"{}".to_vec(), Vec::new()];
        for (case, damaged) in cases.into_iter().enumerate() {
            std::fs::write(&path, damaged).unwrap();
            assert!(same(&kept.records(0).unwrap(), &made), "case {case}");
            assert_eq!(source.0.load(Ordering::Relaxed), 2 + case as u64, "case {case}");
            assert!(std::fs::read(&path).unwrap() == whole, "case {case}: the file is whole again");
        }
    }

    #[test]
    fn a_folder_that_cannot_be_written_does_not_stop_a_run() {
        let folder = tempfile::tempdir().unwrap();
        let source = Counted(AtomicU64::new(0));
        let kept = Kept::new(&source, folder.path()).unwrap();
        std::fs::remove_dir(&kept.folder).unwrap();
        std::fs::write(&kept.folder, b"a file").unwrap();
        assert_eq!(kept.records(0).unwrap().len(), 3);
    }
}
