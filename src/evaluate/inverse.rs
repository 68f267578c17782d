//! `renderflow evaluate inverse`: what recovered buffers are worth.

use crate::dataset::Sequence;
use crate::evaluate::find::{self, TestSequence};
use crate::evaluate::inverter::{Inverter, WanOptions, image, set, unit};
use crate::evaluate::run;
use crate::metrics::bootstrap::{Interval, bootstrap};
use crate::metrics::intrinsics::{self, Buffers, COLUMNS, Column};
use crate::metrics::{Networks, median};
use crate::util::cancel::Cancel;
use crate::util::device::{DeviceArgs, recorded};
use crate::util::progress::Progress;
use crate::util::text::plural;
use crate::util::weights::digests;
use crate::util::{files, output, picture};
use anyhow::{Context, Result, ensure};
use clap::Args;
use renderflow_frame::image::Rgb;
use renderflow_frame::{DepthBounds, Image, file};
use renderflow_model::inverse::InverseNet;
use renderflow_model::wan::flow::Intrinsic;
use renderflow_model::wan::pictures::{EnvironmentView, Pictures};
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Measure recovered albedo, normals, depth and material
///
/// The recovered buffers are compared with the true ones. So is what needs no network: the picture itself as albedo, normals that
/// face the camera, one depth, half-rough dielectric. The command writes inverse.json and prints tables. Pixels that see no
/// surface do not count; brackets hold 95 % intervals over the sequences.
#[derive(Args)]
#[command(after_help = "\
Examples:
  renderflow evaluate inverse --data sets
  renderflow evaluate inverse --weights runs/inverse/weights.safetensors --vae runs/vae/weights.safetensors --data sets -o results-inverse
  renderflow evaluate inverse --buffers theirs/ --data sets -o results-theirs

A folder of --buffers is laid out as `invert --data` writes it: SEQUENCE/frame.NUMBER.albedo.png (sRGB), .normal.png (0.5 + 0.5 n, camera
space: x right, y up, z towards the camera), .depth.png (its logarithm, up to a scale above 0 and a shift), .material.png (roughness,
metallic, and a third channel that is not read). What is missing is left out.")]
pub struct Options {
    /// Weights of the inverse network, or of the paper's network with an inverse adapter; the file says which. Without it, the
    /// weights inside the program are used
    #[arg(long, conflicts_with = "buffers")]
    weights: Option<PathBuf>,
    /// Weights of the autoencoder of the paper's network; vae.safetensors beside --weights without it
    #[arg(long, requires = "weights")]
    vae: Option<PathBuf>,
    /// Buffers that another method recovered
    #[arg(long)]
    buffers: Option<PathBuf>,
    #[command(flatten)]
    device: DeviceArgs,
    /// Test sets, a dataset, a split of it, or one sequence
    #[arg(long)]
    data: PathBuf,
    /// Measure the first two of every n frames; 1 measures all
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..))]
    every: u32,
    /// Folder for the results
    #[arg(long, short = 'o', default_value = "results-inverse")]
    out: PathBuf,
    /// Print the tables as JSON
    #[arg(long)]
    json: bool,
}

/// Errors in a test set.
#[derive(Serialize)]
pub struct Set {
    /// Its name.
    pub name: String,
    /// Number of frames of which anything was measured.
    pub frames: usize,
    /// The method, and what needs no network.
    pub rows: Vec<Row>,
}

/// Errors of a method.
#[derive(Serialize)]
pub struct Row {
    /// Its name.
    pub method: &'static str,
    /// Median seconds of a picture, all buffers.
    pub seconds: Option<f64>,
    /// Means by [`Column::id`].
    pub values: BTreeMap<&'static str, Interval>,
}

#[derive(Serialize)]
struct Results<'a> {
    columns: &'a [Column],
    /// BLAKE3 of the weights, which are in files or inside the program; empty for buffers of another method.
    weights: Vec<String>,
    /// BLAKE3 of the names and the content of the files of another method.
    #[serde(skip_serializing_if = "Option::is_none")]
    buffers: Option<String>,
    /// BLAKE3 of what was read of each sequence, by set, class and name.
    data: BTreeMap<String, String>,
    /// The first two of every so many frames were measured.
    every: u32,
    /// Device of the network; `None` for the processor.
    #[serde(skip_serializing_if = "Option::is_none")]
    device: Option<String>,
    sets: Vec<Set>,
}

/// Errors of the frames of a sequence.
type Frames = Vec<BTreeMap<&'static str, f64>>;

/// Errors of a method, by sequence.
#[derive(Default)]
struct Tally {
    sequences: Vec<Frames>,
    seconds: Vec<f64>,
}

impl Tally {
    fn row(self, method: &'static str) -> Row {
        let value = |id: &str| {
            let mean = |frames: &Frames| {
                let values: Vec<f64> = frames.iter().filter_map(|frame| frame.get(id).copied()).collect();
                (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
            };
            bootstrap(&self.sequences.iter().filter_map(mean).collect::<Vec<f64>>())
        };
        let values = COLUMNS.iter().filter_map(|column| Some((column.id, value(column.id)?))).collect();
        let seconds = Some(median(&self.seconds)).filter(|s| s.is_finite());
        Row { method, seconds, values }
    }
}

/// Where recovered buffers come from.
pub enum Method<'a> {
    /// A network.
    Network(Inverter),
    /// Files of another method.
    Folder(&'a Path),
}

/// The errors of `method` in each set of `tests`, on the first two of every `every` frames, beside those of what needs no
/// network.
///
/// # Errors
/// When stopped; when a frame cannot be read or has no beauty.
pub fn measure(method: &Method, tests: &[TestSequence], every: u32, networks: &Networks, cancel: &Cancel) -> Result<Vec<Set>> {
    let chosen = |test: &TestSequence| run::chosen(test.sequence.len(), every);
    let progress = Progress::new("inverse", tests.iter().map(|test| chosen(test).len() as u64).sum());
    let mut sets: BTreeMap<&str, [Tally; 2]> = BTreeMap::new();
    for test in tests {
        let tallies = sets.entry(&test.set).or_default();
        let [mut found, mut start] = [Frames::new(), Frames::new()];
        for index in chosen(test) {
            cancel.check()?;
            let name = || test.sequence.folder.join(&test.sequence.transforms.files[index]).display().to_string();
            let errors = frame(method, &test.sequence, index, networks, &mut tallies[0].seconds);
            let [ours, mut others] = errors.with_context(name)?;
            // Both rows are means over the same frames.
            others.retain(|id, _| ours.contains_key(id));
            found.push(ours);
            start.push(others);
            progress.add(1);
        }
        tallies[0].sequences.push(found);
        tallies[1].sequences.push(start);
    }
    progress.finish();
    let name = if matches!(method, Method::Network(_)) { "network" } else { "buffers" };
    let sets = sets.into_iter().map(|(set, [found, start])| {
        let frames = found.sequences.iter().flatten().filter(|errors| !errors.is_empty()).count();
        Set { name: set.to_owned(), frames, rows: vec![found.row(name), start.row("no network")] }
    });
    Ok(sets.collect())
}

impl Options {
    /// Measures and prints.
    pub fn run(self, cancel: &Cancel) -> Result<()> {
        let (method, device) = match &self.buffers {
            None => {
                let options = WanOptions { vae: self.vae.as_deref(), tile: None };
                let device = self.device.open()?;
                (Method::Network(Inverter::open(self.weights.as_deref(), options, &device)?), recorded(&device))
            }
            Some(folder) => (Method::Folder(folder), None),
        };
        let path = self.out.join("inverse.json");
        output::absent(&path)?;
        let tests = find::find(&self.data)?;
        if let Method::Folder(_) = method {
            let mut names = BTreeSet::new();
            let twice = tests.iter().map(|test| test.sequence.name.clone()).find(|name| !names.insert(name.clone()));
            ensure!(twice.is_none(), "two sequences are called {}: name one class of scenes", twice.unwrap_or_default());
        }
        let (weights, buffers) = match &method {
            Method::Network(_) => (digests::<InverseNet>(self.weights.as_deref(), self.vae.as_deref())?, None),
            Method::Folder(folder) => (Vec::new(), Some(digest(folder, &tests, self.every)?)),
        };
        let data = run::digests(&tests, |sequence| run::chosen(sequence.len(), self.every), cancel)?;
        let sets = measure(&method, &tests, self.every, &Networks::find()?, cancel)?;
        if let Method::Folder(folder) = method {
            let any = sets.iter().any(|set| !set.rows[0].values.is_empty());
            ensure!(any, "{}: no buffers of any frame of {}", folder.display(), self.data.display());
        }
        std::fs::create_dir_all(&self.out)?;
        let results = Results { columns: &COLUMNS, weights, buffers, data, every: self.every, device, sets };
        file::write_json(&path, &results)?;
        if self.json {
            println!("{}", serde_json::to_string_pretty(&results)?);
        } else {
            results.sets.iter().for_each(print);
            println!("{}", path.display());
        }
        Ok(())
    }
}

/// Errors of one frame: those of the method, and those of no network.
fn frame(
    method: &Method,
    sequence: &Sequence,
    index: usize,
    networks: &Networks,
    seconds: &mut Vec<f64>,
) -> Result<[BTreeMap<&'static str, f64>; 2]> {
    let frame = sequence.frame(index)?;
    // Not looked at: the smallest there is.
    let light = sequence.light()?;
    let view = EnvironmentView::new(&light.environment, 2, 1);
    let bounds = DepthBounds::of([&frame]);
    let pictures = Pictures::new(&frame, light, &view, bounds)?;
    let picture = pictures.target.as_deref().context("has no beauty")?;
    let (width, height) = (pictures.width, pictures.height);
    let shown = image(width, height, picture).map(|p| p.map(unit));
    let depth = frame.depth.map(|z| if is_depth(*z) { z.ln() } else { 0.0 });
    let truth = Buffers { depth: Some(depth), ..buffers(width, height, &pictures) };
    let covered = pictures.mask.iter().zip(&frame.depth.pixels);
    let mask = covered.map(|(m, z)| if is_depth(*z) { *m } else { 0.0 }).collect();
    let mask = Image { width, height, pixels: mask };
    let found = match method {
        Method::Network(network) => {
            let started = Instant::now();
            let mut found = network.find(std::slice::from_ref(&shown), &Intrinsic::ALL, 1)?;
            seconds.push(started.elapsed().as_secs_f64());
            found.swap_remove(0)
        }
        Method::Folder(root) => read(&root.join(name(sequence, index)))?,
    };
    let start = Buffers {
        albedo: Some(shown),
        normal: Some(Rgb::from_fn(width, height, |_, _| [0.0, 0.0, 1.0])),
        depth: Some(Image { width, height, pixels: vec![0.0; width * height] }),
        material: Some(Rgb::from_fn(width, height, |_, _| [0.5, 0.0, 0.5])),
    };
    Ok([intrinsics::measure(&found, &truth, &mask, networks)?, intrinsics::measure(&start, &truth, &mask, networks)?])
}

/// Pictures of -1..=1 in planes as buffers.
fn buffers(width: usize, height: usize, pictures: &Pictures) -> Buffers {
    let mut buffers = Buffers::default();
    let planes = [&pictures.albedo, &pictures.normal, &pictures.depth, &pictures.material];
    for (intrinsic, planes) in Intrinsic::ALL.into_iter().zip(planes) {
        set(&mut buffers, intrinsic, &image(width, height, planes));
    }
    buffers
}

fn is_depth(z: f32) -> bool {
    z > 0.0 && z.is_finite()
}

/// What the paths of a frame's buffers begin with, in the folder of a method.
fn name(sequence: &Sequence, index: usize) -> PathBuf {
    Path::new(&sequence.name).join(&sequence.transforms.files[index]).with_extension("")
}

/// The file of a buffer whose path begins with `name`.
fn buffer(name: &Path, intrinsic: Intrinsic) -> PathBuf {
    let mut path = name.to_owned().into_os_string();
    path.push(format!(".{}.png", intrinsic.name()));
    PathBuf::from(path)
}

/// BLAKE3 of the names and the content of the buffers in the folder `root`, of the first two of every `every` frames.
fn digest(root: &Path, tests: &[TestSequence], every: u32) -> Result<String> {
    let mut found = BTreeMap::new();
    for TestSequence { sequence, .. } in tests {
        for index in run::chosen(sequence.len(), every) {
            for intrinsic in Intrinsic::ALL {
                let file = buffer(&name(sequence, index), intrinsic);
                let path = root.join(&file);
                if path.is_file() {
                    found.insert(file, files::hash(&path)?);
                }
            }
        }
    }
    Ok(blake3::hash(&serde_json::to_vec(&found)?).to_hex().to_string())
}

/// The buffers in files whose paths begin with `name`.
fn read(name: &Path) -> Result<Buffers> {
    let read = |intrinsic: Intrinsic| -> Result<Option<Rgb>> {
        let path = buffer(name, intrinsic);
        if path.is_file() { picture::display_values(&path).map(Some) } else { Ok(None) }
    };
    Ok(Buffers {
        albedo: read(Intrinsic::Albedo)?,
        normal: read(Intrinsic::Normal)?.map(|normal| normal.map(|p| p.map(|v| 2.0 * v - 1.0))),
        depth: read(Intrinsic::Depth)?.map(|depth| depth.map(|p| p[0])),
        material: read(Intrinsic::Material)?,
    })
}

fn print(set: &Set) {
    println!("{}: {}", set.name, plural(set.frames, "frame"));
    for column in &COLUMNS {
        let cell = |row: &Row| row.values.get(column.id).map_or_else(|| "-".to_owned(), |value| value.shown(column.digits));
        let cells: Vec<String> = set.rows.iter().map(|row| format!("{} {:26}", row.method, cell(row))).collect();
        println!("  {:78} {}", column.name, cells.join(" "));
    }
    if let Some(seconds) = set.rows[0].seconds {
        println!("  {:78} {seconds:.3}", "seconds a picture");
    }
}
