//! Reference tensors of the wan networks and how results are compared with them.
#![allow(dead_code)]

pub mod account;
pub mod flow;
pub mod gradients;

use burn::tensor::{Device, Tensor, TensorData};
use renderflow_model::wan::weights::Source;
use std::path::{Path, PathBuf};

/// Environment variable that names a folder of fixtures; where it is set, anything missing is a failure.
pub const VARIABLE: &str = "RENDERFLOW_FIXTURES";

/// A folder of fixtures.
pub struct Fixtures {
    pub folder: PathBuf,
}

/// The folder in [`VARIABLE`] if that is set, else `shared/spec/fixtures` beside the repository; `None`, with the reason printed,
/// when the latter is not there.
pub fn fixtures() -> Option<Fixtures> {
    if let Some(folder) = std::env::var_os(VARIABLE) {
        let folder = PathBuf::from(folder);
        // Tests run in the folder of their package; whoever types a path is in that of the workspace.
        let from_workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(&folder);
        return Some(Fixtures { folder: if folder.is_dir() { folder } else { from_workspace } });
    }
    let folder = beside_repository("shared/spec/fixtures");
    if folder.is_dir() {
        return Some(Fixtures { folder });
    }
    println!("skipped: {} is not there and {VARIABLE} is not set", folder.display());
    None
}

/// A path beside the repository.
pub fn beside_repository(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(path)
}

impl Fixtures {
    /// A file that every set has.
    pub fn file(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// A file that some sets have.
    pub fn optional(&self, name: &str) -> Option<PathBuf> {
        let path = self.file(name);
        if !path.is_file() {
            println!("not in this set: {name}");
            return None;
        }
        Some(path)
    }

    /// Reference tensors.
    pub fn references(&self, name: &str) -> References {
        let source = Source::open(&self.file(name)).expect("reference tensors");
        References { source, compared: Vec::new() }
    }
}

/// Reference tensors, and which of them were used.
pub struct References {
    source: Source,
    compared: Vec<String>,
}

/// Values with their shape.
#[derive(Clone)]
pub struct Values {
    pub shape: Vec<usize>,
    pub values: Vec<f32>,
}

impl References {
    pub fn has(&self, name: &str) -> bool {
        self.source.shape(name).is_some()
    }

    pub fn names(&self) -> Vec<String> {
        self.source.names().map(str::to_string).collect()
    }

    /// What stands before `end` in the names that end so; there must be some.
    pub fn starts_of(&self, end: &str) -> Vec<String> {
        let starts: Vec<String> = self.source.names().filter_map(|name| name.strip_suffix(end).map(str::to_string)).collect();
        assert!(!starts.is_empty(), "{}: no tensor ends in {end}", self.source.path().display());
        starts
    }

    pub fn values(&mut self, name: &str) -> Values {
        self.compared.push(name.to_string());
        let values = self.source.read(name).unwrap_or_else(|e| panic!("{e}"));
        Values { shape: self.source.shape(name).expect("present").to_vec(), values }
    }

    pub fn tensor<const D: usize>(&mut self, name: &str) -> Tensor<D> {
        let Values { shape, values } = self.values(name);
        let shape: [usize; D] = shape.try_into().expect("rank");
        Tensor::from_data(TensorData::new(values, shape), &Device::flex())
    }

    /// Fails when a tensor of the file was never asked for.
    pub fn all_were_used(&self) {
        let unused: Vec<String> = self.names().into_iter().filter(|name| !self.compared.contains(name)).collect();
        assert!(unused.is_empty(), "not compared: {unused:?}");
    }
}

/// Values of a tensor.
pub fn values<const D: usize>(tensor: Tensor<D>) -> Values {
    Values { shape: tensor.dims().to_vec(), values: tensor.into_data().iter().collect() }
}

/// Collects comparisons and fails at the end with all that are too far off.
#[derive(Default)]
pub struct Comparison {
    lines: Vec<String>,
    wrong: Vec<String>,
}

impl Comparison {
    /// Largest absolute difference of `got` and `want`, which may be `tolerance` at most.
    pub fn check(&mut self, name: &str, got: &Values, want: &Values, tolerance: f32) {
        if got.shape != want.shape {
            self.wrong.push(format!("{name}: shape {:?} instead of {:?}", got.shape, want.shape));
            return;
        }
        let differences = got.values.iter().zip(&want.values).map(|(a, b)| (a - b).abs());
        // A difference that is not a number is as wrong as can be.
        let most = differences.fold(0.0, |most: f32, d| if d.is_nan() { f32::INFINITY } else { most.max(d) });
        let largest = want.values.iter().fold(0.0, |most: f32, v| most.max(v.abs()));
        let line = format!("{name}: max|diff| {most:.2e} of {largest:.2e}, tolerance {tolerance:.1e}");
        if most > tolerance {
            self.wrong.push(line.clone());
        }
        self.lines.push(line);
    }

    /// Prints every comparison; fails if one was wrong.
    pub fn finish(self) {
        self.lines.iter().for_each(|line| println!("{line}"));
        assert!(self.wrong.is_empty(), "too far off:\n{}", self.wrong.join("\n"));
    }
}
