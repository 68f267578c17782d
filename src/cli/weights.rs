use crate::util::files;
use crate::util::output::{self, OVERWRITE};
use crate::util::text::plural;
use anyhow::{Result, bail, ensure};
use clap::{Args, Subcommand};
use renderflow_frame::file::Draft;
use renderflow_model::fusion::Fusion;
use renderflow_model::inverse::Inverse;
use renderflow_model::wan::names::Naming;
use renderflow_model::wan::video::WanRenderer;
use renderflow_model::wan::weights::{self as wan, Evidence, Found, Identity, Source};
use renderflow_model::weights;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Describe weights files, list their tensors, or convert them
///
/// Without a subcommand, the configuration and the training record of a weights file are printed.
#[derive(Args)]
#[command(
    args_conflicts_with_subcommands = true,
    after_help = "Examples:\n  renderflow weights            (those inside the program)\n  renderflow weights inspect Wan2.1_VAE.pth\n  \
renderflow weights convert Wan2.1_VAE.pth vae.safetensors --naming diffusers --precision bf16"
)]
pub struct Weights {
    /// A safetensors file; by default the weights inside the program
    file: Option<PathBuf>,
    /// Print the header as JSON
    #[arg(long)]
    json: bool,
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Subcommand)]
enum Command {
    Inspect(Inspect),
    Convert(Convert),
    Average(Average),
}

/// List the tensors of weights files: name, shape, number format, parameters, totals for each part, and the network
///
/// A weights file is a safetensors file, the index of a set of shards, a PyTorch file, or a folder with one of these.
#[derive(Args)]
#[command(
    after_help = "Example: renderflow weights inspect Wan2.1_VAE.pth transformer/\n\nThe network is recognised by what this \
program wrote into its own files, else by a config.json beside the file, else by names and shapes."
)]
struct Inspect {
    /// Weights files, or folders of them
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// Print one JSON array
    #[arg(long)]
    json: bool,
}

/// Write a network as one safetensors file, in another layout or precision
///
/// Networks of Wan and VACE are converted between the original and the diffusers layout, and from PyTorch files and shards.
/// Configuration and provenance stay. A file with a missing tensor, an extra one, or one of another shape is refused. The
/// networks inside the program have one layout, and are stored in f16 or f32.
#[derive(Args)]
#[command(
    after_help = "Examples:\n  renderflow weights convert Wan2.1_VAE.pth vae.safetensors\n  renderflow weights convert transformer/ \
dit.safetensors --naming original --precision bf16"
)]
struct Convert {
    /// Weights file, index of shards, or folder with one of these
    input: PathBuf,
    /// Safetensors file to write
    output: PathBuf,
    /// Names to use: those of the diffusers library, or the authors' own
    #[arg(long, value_enum, default_value_t)]
    naming: Naming,
    /// Number format; by default the format of the input, or f32 where its tensors have several
    #[arg(long, value_enum)]
    precision: Option<wan::Precision>,
    /// Replace the file if another one is there
    #[arg(long)]
    overwrite: bool,
}

/// Average the weights of several runs of the network that reads samples
///
/// The runs should have begun with the same weights. The mean of their weights then often keeps what each of the runs has learned
/// (Wortsman et al. 2022, "Model soups").
#[derive(Args)]
#[command(
    after_help = "Example: renderflow weights average runs/a/weights.safetensors runs/b/weights.safetensors -o mean.safetensors"
)]
struct Average {
    /// Weights files of one network
    #[arg(required = true, num_args = 2..)]
    files: Vec<PathBuf>,
    /// Safetensors file to write, in half precision
    #[arg(long, short = 'o')]
    out: PathBuf,
    /// Replace the file if another one is there
    #[arg(long)]
    overwrite: bool,
}

impl Weights {
    pub fn run(self) -> Result<()> {
        match self.command {
            Some(Command::Inspect(command)) => command.run(),
            Some(Command::Convert(command)) => command.run(),
            Some(Command::Average(command)) => command.run(),
            None => {
                let header = match &self.file {
                    None => {
                        let mut header = serde_json::to_value(Fusion::shipped()?.header())?;
                        header["inverse"] = serde_json::to_value(Inverse::shipped()?.header())?;
                        header
                    }
                    // Only its list of tensors is read: it may be large.
                    Some(path) if WanRenderer::recognises(path) => serde_json::to_value(Source::open(path)?.header()?)?,
                    Some(path) if Inverse::recognises(path) => serde_json::to_value(Inverse::load(path)?.header())?,
                    Some(path) => serde_json::to_value(Fusion::load(path)?.header())?,
                };
                if self.json {
                    println!("{}", serde_json::to_string_pretty(&header)?);
                    return Ok(());
                }
                let mut rows = Vec::new();
                flatten(String::new(), &header, &mut rows);
                let width = rows.iter().map(|(name, _)| name.len()).max().unwrap_or(0);
                rows.iter().for_each(|(name, value)| println!("{name:width$}  {value}"));
                Ok(())
            }
        }
    }
}

/// Lists the values of a header, one a row, with the names that lead to each.
fn flatten(name: String, value: &Value, rows: &mut Vec<(String, String)>) {
    match value {
        Value::Object(fields) => {
            for (field, value) in fields {
                let dot = if name.is_empty() { "" } else { "." };
                flatten(format!("{name}{dot}{field}"), value, rows);
            }
        }
        Value::String(text) => rows.push((name, text.clone())),
        other => rows.push((name, other.to_string())),
    }
}

/// The files that `path` stands for: itself, or the weights files of a folder that is not one set of shards.
fn weights_files(path: &Path) -> Result<Vec<PathBuf>> {
    if !path.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let inside = files::list(path)?;
    let index = inside.iter().any(|file| file.to_string_lossy().ends_with(".index.json"));
    let weights: Vec<PathBuf> = inside.into_iter().filter(|file| files::has_ending(file, &["safetensors", "pth"])).collect();
    Ok(if index || weights.len() < 2 { vec![path.to_owned()] } else { weights })
}

impl Inspect {
    fn run(self) -> Result<()> {
        let (mut array, mut refused) = (Vec::new(), 0);
        let files = self.files.iter().map(|path| weights_files(path)).collect::<Result<Vec<_>>>()?.concat();
        for (i, path) in files.iter().enumerate() {
            match open(path) {
                Ok((source, identity)) if self.json => array.push(object(&source, &identity)),
                Ok((source, identity)) => {
                    if i > 0 {
                        println!();
                    }
                    print(&source, &identity);
                }
                Err(error) => {
                    refused += 1;
                    let error = crate::util::console::message(&error);
                    eprintln!("error: {error}");
                    array.push(json!({ "path": path.to_string_lossy(), "error": error }));
                }
            }
        }
        if self.json {
            println!("{}", serde_json::to_string_pretty(&array)?);
        }
        ensure!(refused == 0, "{refused} of {} cannot be read", plural(files.len(), "file"));
        Ok(())
    }
}

fn open(path: &Path) -> Result<(Source, Identity)> {
    let source = Source::open(path)?;
    let identity = wan::identify(&source)?;
    Ok((source, identity))
}

/// Whose names a file uses, for people.
fn naming(naming: Naming) -> &'static str {
    match naming {
        Naming::Diffusers => "diffusers",
        Naming::Original => "original",
    }
}

fn evidence(found: &Found) -> String {
    match &found.evidence {
        Evidence::Header => "its own header".into(),
        Evidence::Config(path) => path.display().to_string(),
        Evidence::Shapes => "names and shapes".into(),
    }
}

fn print(source: &Source, identity: &Identity) {
    let table = source.table();
    let path = source.path().display();
    println!("{table}\n");
    let parts = table.parts();
    let width = parts.iter().map(|(name, ..)| name.len()).max().unwrap_or(0);
    for (name, tensors, parameters) in parts {
        println!("{name:width$}  {tensors:>5} tensors {parameters:>13} parameters");
    }
    match identity {
        Identity::Fusion(header) => {
            println!("\n{path}: network that reads samples, {} of training", plural(header.steps, "step"))
        }
        Identity::Inverse(header) => {
            println!("\n{path}: network that inverts pictures, {} of training", plural(header.steps, "step"))
        }
        Identity::Unknown(reason) => println!("\n{path}: unknown network: {reason}"),
        Identity::Wan(found) => {
            let name = found.header.network.name();
            println!("\n{path}: {name}, {} names, told by {}", naming(found.naming), evidence(found));
            for assumed in &found.assumed {
                println!("assumed: {assumed}");
            }
            match wan::check(source, &found.header.network) {
                Ok(report) => println!("all {} tensors fit", report.read),
                Err(error) => println!("{error}"),
            }
        }
    }
}

fn object(source: &Source, identity: &Identity) -> Value {
    let table = source.table();
    let tensor = |row: &wan::Row| json!({ "name": row.name, "shape": row.shape, "type": row.element.to_string(), "parameters": row.parameters });
    let part = |(name, tensors, parameters)| json!({ "name": name, "tensors": tensors, "parameters": parameters });
    let mut object = json!({
        "path": source.path().to_string_lossy(),
        "parameters": table.parameters(),
        "parts": table.parts().into_iter().map(part).collect::<Vec<Value>>(),
        "tensors": table.rows.iter().map(tensor).collect::<Vec<Value>>(),
    });
    let about = match identity {
        Identity::Fusion(header) => json!({ "kind": "fusion", "header": header }),
        Identity::Inverse(header) => json!({ "kind": "inverse", "header": header }),
        Identity::Unknown(reason) => json!({ "kind": null, "reason": reason }),
        Identity::Wan(found) => {
            let problem = wan::check(source, &found.header.network).err().map(|error| error.to_string());
            let network = serde_json::to_value(&found.header.network).unwrap_or_default();
            json!({
                "kind": network["kind"],
                "config": network["config"],
                "provenance": found.header.provenance,
                "naming": naming(found.naming),
                "evidence": evidence(found),
                "assumed": found.assumed,
                "fits": problem.is_none(),
                "problem": problem,
            })
        }
    };
    if let (Some(object), Value::Object(about)) = (object.as_object_mut(), about) {
        object.extend(about);
    }
    object
}

impl Average {
    fn run(self) -> Result<()> {
        let out = self.out.display();
        ensure!(self.overwrite || !output::exists(&self.out), "{out}: is there already; {OVERWRITE}");
        let networks = self.files.iter().map(|file| Ok(Fusion::load(file)?)).collect::<Result<Vec<Fusion>>>()?;
        let (Some(first), share) = (networks.first(), 1.0 / networks.len() as f32) else { bail!("no weights are named") };
        let mut mean = first.parameters();
        mean.iter_mut().flat_map(|parameter| &mut parameter.values).for_each(|value| *value *= share);
        for (network, file) in networks.iter().zip(&self.files).skip(1) {
            let config = &network.header().fusion;
            ensure!(*config == first.header().fusion, "{}: is a network of another configuration than the first", file.display());
            for (mean, added) in mean.iter_mut().zip(network.parameters()) {
                mean.values.iter_mut().zip(added.values).for_each(|(mean, added)| *mean += share * added);
            }
        }
        let header = networks.iter().map(Fusion::header).max_by_key(|header| header.steps).unwrap_or(first.header());
        Fusion::with_parameters(header.clone(), &mean)?.save(&self.out, weights::Precision::F16)?;
        println!("{out}");
        Ok(())
    }
}

impl Convert {
    fn run(self) -> Result<()> {
        let (source, identity) = open(&self.input)?;
        let from = source.path().display();
        // Another file may be there. It is compared with the new one, and stays.
        let beside = if output::exists(&self.output) && !self.overwrite { Some(Draft::new(&self.output)?) } else { None };
        let to_file = beside.as_ref().map_or(self.output.as_path(), Draft::temporary);
        let done = match identity {
            Identity::Unknown(reason) => bail!("{from}: {reason}"),
            Identity::Fusion(_) | Identity::Inverse(_) => {
                let precision = match self.precision.unwrap_or_else(|| stored(&source)) {
                    wan::Precision::F32 => weights::Precision::F32,
                    wan::Precision::F16 => weights::Precision::F16,
                    wan::Precision::Bf16 => bail!("{from}: this network is stored in f16 or f32"),
                };
                let what = if let Identity::Fusion(_) = identity {
                    Fusion::load(source.path())?.save(to_file, precision)?;
                    "network that reads samples"
                } else {
                    Inverse::load(source.path())?.save(to_file, precision)?;
                    "network that inverts pictures"
                };
                format!("{}: {what}", self.output.display())
            }
            Identity::Wan(found) => {
                let (to, precision) = (self.naming, self.precision.unwrap_or_else(|| stored(&source)));
                let report = wan::convert(&source, to_file, &found.header, precision, to)?;
                let (name, out) = (found.header.network.name(), self.output.display());
                format!("{out}: {name}, {}, {} names from {}", plural(report.read, "tensor"), naming(to), naming(report.naming))
            }
        };
        if beside.is_some() {
            let same = files::hash(to_file)? == files::hash(&self.output)?;
            ensure!(same, "{}: already exists with other content; {OVERWRITE}", self.output.display());
        }
        println!("{done}");
        Ok(())
    }
}

/// The number format all tensors share, else single precision.
fn stored(source: &Source) -> wan::Precision {
    let rows = source.table().rows;
    match rows.first().map(|row| row.element).filter(|first| rows.iter().all(|row| row.element == *first)) {
        Some(wan::ElementType::F16) => wan::Precision::F16,
        Some(wan::ElementType::Bf16) => wan::Precision::Bf16,
        _ => wan::Precision::F32,
    }
}
