//! Buffers and accessors of a glTF file, every offset checked.
//!
//! The reader of the gltf crate is not used here: on malformed files (1.4) its offsets wrap around and its sparse values panic.

use super::draco::{self, Decompressed};
use super::uri;
use crate::error::{Error, Result};
use gltf::accessor::{Accessor, DataType};
use gltf::{Document, buffer};
use renderflow_frame::reach::Reach;
use std::collections::hash_map::Entry;
use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Bytes that the accessors in use may take beside [`SHARE`] times those of the buffers. Accessors without bytes behind them are
/// zeros in any number, and many primitives may read one accessor: a kilobyte of JSON could fill any memory.
const ALLOWANCE: usize = 256 << 20;
/// How often all buffers may be read, on average.
const SHARE: usize = 4;

/// Where the elements of an accessor lie in a buffer view.
#[derive(Clone, Copy)]
struct Elements {
    /// Byte of the first element.
    offset: usize,
    /// Bytes from one element to the next.
    stride: usize,
    /// Bytes of one element.
    size: usize,
    count: usize,
}

/// All buffers of a file, in memory.
pub(super) struct Buffers<'a> {
    path: &'a Path,
    /// At least as many as each buffer has. Buffers of one file share them.
    bytes: Vec<Arc<Vec<u8>>>,
    decompressed: Decompressed,
    /// Bytes of accessors that may still be read.
    left: AtomicUsize,
}

impl<'a> Buffers<'a> {
    /// Reads every buffer: the binary chunk of a `.glb`, a data URI, or a file that `reach` allows.
    pub(super) fn read(path: &'a Path, reach: &Reach, document: &Document, mut blob: Option<Vec<u8>>) -> Result<Self> {
        let mut files: HashMap<PathBuf, Arc<Vec<u8>>> = HashMap::new();
        let bytes = document
            .buffers()
            .map(|buffer| {
                let fail = |reason| Error::model(path, format!("/buffers/{}", buffer.index()), reason);
                let bytes = match buffer.source() {
                    buffer::Source::Uri(text) if text.starts_with("data:") => Arc::new(uri::read(reach, text).map_err(fail)?),
                    buffer::Source::Uri(text) => match files.entry(uri::file(reach, text).map_err(fail)?) {
                        Entry::Occupied(known) => Arc::clone(known.get()),
                        Entry::Vacant(free) => Arc::clone(free.insert(Arc::new(uri::read(reach, text).map_err(fail)?))),
                    },
                    buffer::Source::Bin => {
                        Arc::new(blob.take().ok_or_else(|| fail("has no uri, and the file has no binary chunk".into()))?)
                    }
                };
                if bytes.len() < buffer.length() {
                    return Err(fail(format!("holds {} bytes where byteLength says {}", bytes.len(), buffer.length())));
                }
                Ok(bytes)
            })
            .collect::<Result<Vec<_>>>()?;
        let mut read = Self { path, bytes, decompressed: Decompressed::default(), left: AtomicUsize::new(0) };
        read.decompressed = draco::decompress(path, document, &read)?;
        read.left = AtomicUsize::new(ALLOWANCE + SHARE * (read.bytes() + read.decompressed.bytes()));
        Ok(read)
    }

    /// Bytes of all buffers.
    pub(super) fn bytes(&self) -> usize {
        let mut counted = HashSet::new();
        self.bytes.iter().filter(|bytes| counted.insert(Arc::as_ptr(bytes))).map(|bytes| bytes.len()).sum()
    }

    /// The triangles of a compressed primitive, by the numbers of its mesh and of the primitive.
    pub(super) fn decompressed(&self, mesh: usize, primitive: usize) -> Option<&[[u32; 3]]> {
        self.decompressed.triangles.get(&(mesh, primitive)).map(Vec::as_slice)
    }

    /// Bytes of a buffer view.
    pub(super) fn view(&self, view: &buffer::View) -> Result<&[u8]> {
        let bytes = &self.bytes[view.buffer().index()];
        let end = view.offset().checked_add(view.length()).filter(|end| *end <= view.buffer().length());
        let range = end.and_then(|end| bytes.get(view.offset()..end));
        range.ok_or_else(|| {
            let reason = format!(
                "{} bytes from {} leave the {} bytes of buffer {}",
                view.length(),
                view.offset(),
                view.buffer().length(),
                view.buffer().index()
            );
            Error::model(self.path, format!("/bufferViews/{}", view.index()), reason)
        })
    }

    /// The bytes of `elements` of a view, without the gaps.
    fn gather(&self, place: &str, view: &buffer::View, elements: Elements) -> Result<Vec<u8>> {
        let Elements { offset, stride, size, count } = elements;
        if count == 0 {
            return Ok(vec![]);
        }
        let fail = |reason| Err(Error::model(self.path, place, reason));
        let bytes = self.view(view)?;
        if stride < size {
            return fail(format!("a stride of {stride} bytes is less than an element of {size}"));
        }
        let length = stride.checked_mul(count - 1).and_then(|l| l.checked_add(size));
        let Some(used) = length.and_then(|l| offset.checked_add(l)).and_then(|end| bytes.get(offset..end)) else {
            let reason =
                format!("{count} elements of {size} bytes leave the {} bytes of buffer view {}", bytes.len(), view.index());
            return fail(reason);
        };
        if stride == size {
            return Ok(used.to_vec());
        }
        let mut packed = Vec::with_capacity(size * count);
        used.chunks(stride).for_each(|element| packed.extend_from_slice(&element[..size]));
        Ok(packed)
    }

    /// Takes the bytes of an accessor, or of a copy of what was read, from what may still be read.
    pub(super) fn spend(&self, size: usize, count: usize, place: &str, why: &str) -> Result<()> {
        let spend = |left: usize| left.checked_sub(size.checked_mul(count)?);
        match self.left.fetch_update(Ordering::Relaxed, Ordering::Relaxed, spend) {
            Ok(_) => Ok(()),
            Err(_) => Err(Error::model(self.path, place, format!("{count} elements {why}"))),
        }
    }

    /// Bytes of all elements of `accessor`, tightly packed, sparse values put in.
    fn packed(&self, accessor: &Accessor) -> Result<Vec<u8>> {
        let place = format!("/accessors/{}", accessor.index());
        let (size, count) = (accessor.size(), accessor.count());
        if let Some(values) = self.decompressed.values.get(&accessor.index()) {
            self.spend(1, values.len(), &place, "read again and again")?;
            return Ok(values.clone());
        }
        let mut packed = match accessor.view() {
            Some(view) => {
                let elements = Elements { offset: accessor.offset(), stride: view.stride().unwrap_or(size), size, count };
                let packed = self.gather(&place, &view, elements)?;
                self.spend(size, count, &place, "read again and again")?;
                packed
            }
            None => {
                self.spend(size, count, &place, "without data")?;
                vec![0; size * count]
            }
        };
        if let Some(sparse) = accessor.sparse() {
            let place = format!("{place}/sparse");
            let exceptions = sparse.count();
            if exceptions > count {
                return Err(Error::model(self.path, place, format!("{exceptions} sparse values for {count} elements")));
            }
            let (indices, values) = (sparse.indices(), sparse.values());
            let width = indices.index_type().size();
            let packed_at = |offset, size| Elements { offset, stride: size, size, count: exceptions };
            let at = self.gather(&place, &indices.view(), packed_at(indices.offset(), width))?;
            let with = self.gather(&place, &values.view(), packed_at(values.offset(), size))?;
            for (index, value) in at.chunks_exact(width).zip(with.chunks_exact(size)) {
                let index = little_endian(index) as usize;
                let Some(element) = packed.chunks_exact_mut(size).nth(index) else {
                    return Err(Error::model(self.path, place, format!("index {index} is not below {count}")));
                };
                element.copy_from_slice(value);
            }
        }
        Ok(packed)
    }

    /// Elements of `N` numbers; integers become 0..=1 or -1..=1 where the accessor is normalised (glTF 2.0, section 3.6.2.2).
    pub(super) fn floats<const N: usize>(&self, accessor: &Accessor, place: &str) -> Result<Vec<[f32; N]>> {
        if accessor.dimensions().multiplicity() != N {
            let reason = format!(
                "accessor {} has {} components where {N} are needed",
                accessor.index(),
                accessor.dimensions().multiplicity()
            );
            return Err(Error::model(self.path, place, reason));
        }
        let packed = self.packed(accessor)?;
        let width = accessor.data_type().size();
        let one = match (accessor.normalized(), accessor.data_type()) {
            (false, _) | (_, DataType::F32) => 1.0,
            (_, DataType::I8) => 127.0,
            (_, DataType::U8) => 255.0,
            (_, DataType::I16) => 32767.0,
            (_, DataType::U16) => 65535.0,
            (_, DataType::U32) => u32::MAX as f32,
        };
        let component = |b: &[u8]| -> f32 {
            let raw = match accessor.data_type() {
                DataType::F32 => f32::from_bits(little_endian(b)),
                DataType::I8 => f32::from(little_endian(b) as u8 as i8),
                DataType::I16 => f32::from(little_endian(b) as u16 as i16),
                DataType::U8 | DataType::U16 | DataType::U32 => little_endian(b) as f32,
            };
            // The lowest signed integer lies one step below -1.
            if one == 1.0 { raw } else { (raw / one).max(-1.0) }
        };
        Ok(packed
            .chunks_exact(width * N)
            .map(|element| std::array::from_fn(|i| component(&element[i * width..(i + 1) * width])))
            .collect())
    }

    /// Unsigned scalars of 8, 16 or 32 bits.
    pub(super) fn indices(&self, accessor: &Accessor, place: &str) -> Result<Vec<u32>> {
        let width = accessor.data_type().size();
        if !matches!(accessor.data_type(), DataType::U8 | DataType::U16 | DataType::U32) || accessor.size() != width {
            let reason = format!("accessor {} does not hold unsigned integers", accessor.index());
            return Err(Error::model(self.path, place, reason));
        }
        Ok(self.packed(accessor)?.chunks_exact(width).map(little_endian).collect())
    }
}

/// At most four bytes, lowest first.
fn little_endian(bytes: &[u8]) -> u32 {
    bytes.iter().rev().fold(0, |number, &byte| (number << 8) | u32::from(byte))
}
