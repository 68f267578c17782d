//! A weights file, or a set of shards, as a list of tensors that can be read one by one.

use crate::weights::HEADER;
use crate::{Error, Result};
use half::slice::HalfFloatSliceExt;
use half::{bf16, f16};
use renderflow_frame::file;
use renderflow_frame::reach::plain_name;
use renderflow_frame::words::plain;
use safetensors::tensor::{Dtype, Metadata};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

/// Most bytes of a safetensors file's list of tensors, as the format defines.
const LARGEST_HEADER: u64 = 100_000_000;

/// Number format of a tensor in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ElementType {
    /// Double precision.
    F64,
    /// Single precision.
    F32,
    /// Half precision.
    F16,
    /// bfloat16.
    Bf16,
    /// Another format, which weights cannot have.
    Other,
}

impl fmt::Display for ElementType {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.pad(match self {
            Self::F64 => "f64",
            Self::F32 => "f32",
            Self::F16 => "f16",
            Self::Bf16 => "bf16",
            Self::Other => "other",
        })
    }
}

/// The place of a tensor's bytes.
enum Place {
    Range { file: Arc<(PathBuf, Mutex<File>)>, start: u64, length: usize },
    Torch(pytorch_reader::Tensor),
}

struct Stored {
    shape: Vec<usize>,
    element: ElementType,
    place: Place,
}

/// The tensors of a file or of a set of shards.
pub struct Source {
    path: PathBuf,
    tensors: BTreeMap<String, Stored>,
    header: Option<String>,
}

/// One line of [`Source::table`].
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Name of the tensor.
    pub name: String,
    /// Shape in the file.
    pub shape: Vec<usize>,
    /// Number format in the file.
    pub element: ElementType,
    /// Number of values.
    pub parameters: u64,
}

/// The tensors of a file. It displays as a table.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    /// Tensors in the order of their names.
    pub rows: Vec<Row>,
}

impl Table {
    /// Number of values in all tensors.
    pub fn parameters(&self) -> u64 {
        self.rows.iter().map(|row| row.parameters).sum()
    }
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let width = self.rows.iter().map(|row| row.name.len()).max().unwrap_or(0).max("tensors".len() + 8);
        writeln!(f, "{:width$}  {:22} {:5} {:>13}", "name", "shape", "type", "parameters")?;
        for row in &self.rows {
            writeln!(f, "{:width$}  {:22} {:5} {:>13}", row.name, format!("{:?}", row.shape), row.element, row.parameters)?;
        }
        write!(f, "{:width$}  {:22} {:5} {:>13}", format!("{} tensors", self.rows.len()), "", "", self.parameters())
    }
}

impl Source {
    /// Opens `path`: a `.safetensors` file, the `.safetensors.index.json` of a set of shards, a PyTorch file (`.pth`, `.pt`,
    /// `.bin`), or a folder with exactly one of these.
    ///
    /// # Errors
    /// When a file cannot be read, or is not in the format of its name. The message names the file.
    pub fn open(path: &Path) -> Result<Self> {
        if path.is_dir() {
            return Self::open(&only_weights(path)?);
        }
        let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        if name.ends_with(".index.json") {
            Self::shards(path)
        } else if name.ends_with(".safetensors") {
            let (tensors, header) = safetensors_file(path)?;
            Ok(Self { path: path.into(), tensors, header })
        } else if is_torch(name) {
            Ok(Self { path: path.into(), tensors: torch_file(path)?, header: None })
        } else {
            Err(Error::malformed(path, "not a .safetensors, .safetensors.index.json, .pth, .pt or .bin file"))
        }
    }

    fn shards(path: &Path) -> Result<Self> {
        #[derive(serde::Deserialize)]
        struct Index {
            weight_map: BTreeMap<String, String>,
        }
        let index: Index = file::read_json(path)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let mut files = BTreeMap::new();
        let mut tensors = BTreeMap::new();
        for (name, file) in index.weight_map {
            plain_name(&file)
                .map_err(|reason| Error::malformed(path, format!("/weight_map/{name}: {reason} beside the index")))?;
            if !files.contains_key(&file) {
                let shard = folder.join(&file);
                if !shard.exists() {
                    return Err(Error::malformed(path, format!("/weight_map/{name}: there is no {file} beside the index")));
                }
                files.insert(file.clone(), safetensors_file(&shard)?.0);
            }
            let stored = files.get_mut(&file).and_then(|tensors| tensors.remove(&name));
            let absent = || Error::malformed(path, format!("/weight_map/{name}: not in {file}"));
            let stored = stored.ok_or_else(absent)?;
            tensors.insert(name, stored);
        }
        let unlisted = files.iter().find_map(|(file, tensors)| Some((file, tensors.keys().next()?)));
        if let Some((file, tensor)) = unlisted {
            return Err(Error::malformed(path, format!("{file} holds {tensor}, which the index does not list there")));
        }
        Ok(Self { path: path.into(), tensors, header: None })
    }

    /// The file that was opened.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// All files that were opened: [`Self::path`], and the shards if it is their index.
    pub fn files(&self) -> BTreeSet<&Path> {
        let mut files = BTreeSet::from([self.path.as_path()]);
        for stored in self.tensors.values() {
            if let Place::Range { file, .. } = &stored.place {
                files.insert(&file.0);
            }
        }
        files
    }

    /// Names of the tensors, in order.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.tensors.keys().map(String::as_str)
    }

    /// Shape of a tensor in the file.
    pub fn shape(&self, name: &str) -> Option<&[usize]> {
        self.tensors.get(name).map(|stored| stored.shape.as_slice())
    }

    /// Number format of a tensor.
    pub fn element(&self, name: &str) -> Option<ElementType> {
        self.tensors.get(name).map(|stored| stored.element)
    }

    /// The header of this program, if there is one.
    pub(super) fn header_text(&self) -> Option<&str> {
        self.header.as_deref()
    }

    /// The list of all tensors.
    pub fn table(&self) -> Table {
        let row = |(name, stored): (&String, &Stored)| Row {
            name: name.clone(),
            shape: stored.shape.clone(),
            element: stored.element,
            parameters: stored.shape.iter().map(|&n| n as u64).product(),
        };
        Table { rows: self.tensors.iter().map(row).collect() }
    }

    /// Reads the values of a tensor in the order of the file.
    ///
    /// # Errors
    /// When there is no such tensor, when its numbers are not floating-point or not finite, or when the file cannot be read.
    pub fn read(&self, name: &str) -> Result<Vec<f32>> {
        let broken = |reason: String| Error::Tensor { path: self.path.clone(), tensor: name.into(), reason };
        let stored = self.tensors.get(name).ok_or_else(|| broken("missing".into()))?;
        let bytes = match &stored.place {
            Place::Torch(tensor) => tensor.read().map_err(|e| broken(e.to_string()))?,
            Place::Range { file, start, length } => {
                let (path, handle) = &**file;
                let mut bytes = vec![0; *length];
                let mut handle = handle.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
                let read = handle.seek(SeekFrom::Start(*start)).and_then(|_| handle.read_exact(&mut bytes));
                read.map_err(Error::io(path, "read"))?;
                bytes
            }
        };
        let values: Vec<f32> = match stored.element {
            ElementType::F32 => bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect(),
            ElementType::F64 => {
                let value = |b: &[u8]| f64::from_le_bytes([b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]]) as f32;
                bytes.chunks_exact(8).map(value).collect()
            }
            ElementType::F16 => {
                let halves: Vec<f16> = bytes.chunks_exact(2).map(|b| f16::from_le_bytes([b[0], b[1]])).collect();
                let mut values = vec![0.0; halves.len()];
                halves.convert_to_f32_slice(&mut values);
                values
            }
            ElementType::Bf16 => bytes.chunks_exact(2).map(|b| bf16::from_le_bytes([b[0], b[1]]).to_f32()).collect(),
            ElementType::Other => return Err(broken("its numbers are not floating-point".into())),
        };
        if values.iter().any(|v| !v.is_finite()) {
            return Err(broken("holds NaN or infinity".into()));
        }
        Ok(values)
    }
}

impl fmt::Debug for Source {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "Source({}, {} tensors)", self.path.display(), self.tensors.len())
    }
}

fn is_torch(name: &str) -> bool {
    [".pth", ".pt", ".bin"].iter().any(|end| name.ends_with(end))
}

/// The weights file in a folder. An index has priority over single files, and safetensors over PyTorch files.
fn only_weights(folder: &Path) -> Result<PathBuf> {
    let entries = std::fs::read_dir(folder).map_err(Error::io(folder, "read"))?;
    let mut names: Vec<String> = Vec::new();
    for entry in entries {
        let entry = entry.map_err(Error::io(folder, "read"))?;
        names.extend(entry.file_name().into_string().ok());
    }
    names.sort();
    let kinds: [fn(&str) -> bool; 3] = [|n| n.ends_with(".safetensors.index.json"), |n| n.ends_with(".safetensors"), is_torch];
    for kind in kinds {
        match names.iter().filter(|name| kind(name)).collect::<Vec<_>>()[..] {
            [] => {}
            [name] => return Ok(folder.join(name)),
            [first, second, ..] => {
                return Err(Error::malformed(folder, format!("holds {first} and {second}: name the file")));
            }
        }
    }
    Err(Error::malformed(folder, "no weights (.safetensors.index.json, .safetensors, .pth, .pt, .bin) in this folder"))
}

/// The tensors of a safetensors file, and the header of this program.
fn safetensors_file(path: &Path) -> Result<(BTreeMap<String, Stored>, Option<String>)> {
    let malformed = |reason: String| Error::malformed(path, format!("not a safetensors file: {reason}"));
    let mut file = file::open(path)?;
    let size = file.metadata().map_err(Error::io(path, "read"))?.len();
    let mut length = [0; 8];
    file.read_exact(&mut length).map_err(|_| malformed("shorter than its own length".into()))?;
    let length = u64::from_le_bytes(length);
    if length > LARGEST_HEADER || length > size.saturating_sub(8) {
        return Err(malformed(format!("a list of tensors of {length} bytes in a file of {size}")));
    }
    let mut text = vec![0; length as usize];
    file.read_exact(&mut text).map_err(Error::io(path, "read"))?;
    let metadata: Metadata = serde_json::from_slice(&text).map_err(|e| malformed(plain(&e.to_string())))?;
    let header = metadata.metadata().as_ref().and_then(|entries| entries.get(HEADER)).cloned();
    let (data, mut tensors) = (8 + length, BTreeMap::new());
    let file = Arc::new((path.to_path_buf(), Mutex::new(file)));
    for (name, info) in metadata.tensors() {
        let broken = |reason: String| Error::Tensor { path: path.into(), tensor: name.clone(), reason };
        let (start, end) = info.data_offsets;
        let bits = info.shape.iter().try_fold(info.dtype.bitsize(), |bits, &n| bits.checked_mul(n));
        if bits.is_none_or(|bits| end.checked_sub(start) != Some(bits.div_ceil(8))) {
            return Err(broken(format!("shape {:?} of {:?} does not take the {start}..{end} it has", info.shape, info.dtype)));
        }
        if end as u64 > size - data {
            return Err(broken(format!("cut off: its last byte is {} of {size}", data + end as u64)));
        }
        let element = match info.dtype {
            Dtype::F64 => ElementType::F64,
            Dtype::F32 => ElementType::F32,
            Dtype::F16 => ElementType::F16,
            Dtype::BF16 => ElementType::Bf16,
            _ => ElementType::Other,
        };
        let place = Place::Range { file: file.clone(), start: data + start as u64, length: end - start };
        tensors.insert(name.clone(), Stored { shape: info.shape.clone(), element, place });
    }
    Ok((tensors, header))
}

/// The tensors of a PyTorch file, which holds a dictionary of tensors, or one under `state_dict` or `model`.
fn torch_file(path: &Path) -> Result<BTreeMap<String, Stored>> {
    use pytorch_reader::DType;
    // This distinguishes a missing file or a pipe from a broken file.
    file::open(path)?;
    let malformed = |e: pytorch_reader::PytorchError| Error::malformed(path, format!("not a PyTorch file: {e}"));
    let tensors = pytorch_reader::PytorchReader::new(path).map_err(malformed)?.into_tensors();
    let wrapped = |prefix: &str| !tensors.is_empty() && tensors.keys().all(|name| name.starts_with(prefix));
    let prefix = ["state_dict.", "model."].into_iter().find(|prefix| wrapped(prefix)).unwrap_or("");
    let stored = |(name, tensor): (String, pytorch_reader::Tensor)| {
        let element = match tensor.dtype() {
            DType::F64 => ElementType::F64,
            DType::F32 => ElementType::F32,
            DType::F16 => ElementType::F16,
            DType::BF16 => ElementType::Bf16,
            _ => ElementType::Other,
        };
        let name = name.strip_prefix(prefix).map(str::to_string).unwrap_or(name);
        (name, Stored { shape: tensor.shape().to_vec(), element, place: Place::Torch(tensor) })
    };
    Ok(tensors.into_iter().map(stored).collect())
}
