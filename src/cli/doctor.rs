use crate::util::machine;
use crate::util::text::plural;
use anyhow::Result;
use clap::Args;
use renderflow_model::device::{self, FoundDevice};
use renderflow_model::fusion::Fusion;
use renderflow_model::inverse::Inverse;
use renderflow_model::kernels;
use renderflow_model::lpips::{Backbone, WEIGHTS_VARIABLE, weights_folder};
use renderflow_renderer::accel::Level;
use renderflow_renderer::denoise::{self, Denoiser};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Shows what this program found on this machine: the denoiser, weights, processor, memory and disk.
#[derive(Args)]
#[command(after_help = "Examples:\n  renderflow doctor\n  renderflow doctor --json | jq .denoiser")]
pub struct Doctor {
    /// Print the findings as JSON
    #[arg(long)]
    json: bool,
}

/// What was found.
#[derive(Debug, Serialize)]
struct Findings {
    version: &'static str,
    denoiser: Denoising,
    /// LPIPS with each of its networks.
    lpips: Vec<Weights>,
    /// The network inside the program that reads samples.
    network: Network,
    /// The network inside the program that inverts pictures.
    inverse: Network,
    /// GPUs that networks can run on; empty in a build for the processor alone.
    gpus: Vec<FoundDevice>,
    processor: String,
    cores: usize,
    /// Widest vector instructions that are used.
    simd: &'static str,
    /// Instructions by which networks multiply in bf16; `null` where they multiply in 32-bit floats.
    bf16: Option<&'static str>,
    /// Bytes that this process may still take; `null` where the system does not tell.
    memory: Option<u64>,
    /// Bytes that are free in the current folder; `null` where the system does not tell.
    disk: Option<u64>,
}

/// A GPU for a user: how it is chosen, what it is, and why it cannot be used.
fn shown(gpu: &FoundDevice) -> String {
    let driver = if gpu.driver.is_empty() { String::new() } else { format!(", {}", gpu.driver) };
    let problem = gpu.problem.as_ref().map_or(String::new(), |problem| format!(" (cannot be used: {problem})"));
    format!("{}: {}{driver}{problem}", gpu.choice, gpu.name)
}

/// Intel Open Image Denoise.
#[derive(Debug, Serialize)]
struct Denoising {
    works: bool,
    /// File of the library that is loaded.
    library: Option<PathBuf>,
    /// Why it does not work.
    problem: Option<String>,
}

/// A file of weights outside of the program.
#[derive(Debug, Serialize)]
struct Weights {
    file: PathBuf,
    found: bool,
}

/// A network inside the program.
#[derive(Debug, Serialize)]
struct Network {
    works: bool,
    /// Steps of its training.
    steps: Option<u64>,
    problem: Option<String>,
}

impl Doctor {
    pub fn run(self) -> Result<()> {
        let found = Findings::new();
        if self.json {
            println!("{}", serde_json::to_string_pretty(&found)?);
        } else {
            found.rows().iter().for_each(|(name, value)| println!("{name:>10}  {value}"));
        }
        Ok(())
    }
}

impl Network {
    /// A network of so many steps, or why there is none.
    fn of(steps: renderflow_model::Result<u64>) -> Self {
        match steps {
            Ok(steps) => Self { works: true, steps: Some(steps), problem: None },
            Err(error) => Self { works: false, steps: None, problem: Some(error.to_string()) },
        }
    }

    fn shown(&self) -> String {
        match (self.steps, &self.problem) {
            (Some(steps), _) => format!("inside the program, {} of training", plural(steps, "step")),
            (None, problem) => format!("missing: {}", problem.as_deref().unwrap_or("unknown")),
        }
    }
}

impl Findings {
    fn new() -> Self {
        let denoiser = Denoiser::new();
        let folder = weights_folder();
        let weights = |backbone: Backbone| {
            let file = folder.as_ref().map_or_else(|| backbone.file_name().into(), |folder| folder.join(backbone.file_name()));
            Weights { found: folder.is_some() && file.is_file(), file }
        };
        Self {
            version: env!("CARGO_PKG_VERSION"),
            denoiser: Denoising {
                works: denoiser.is_ok(),
                library: denoise::library().ok().map(Path::to_owned),
                problem: denoiser.err().map(|error| error.to_string()),
            },
            lpips: [Backbone::Alex, Backbone::Squeeze].map(weights).into(),
            network: Network::of(Fusion::shipped().map(|network| network.header().steps)),
            inverse: Network::of(Inverse::shipped().map(|network| network.header().steps)),
            gpus: device::found(),
            processor: machine::processor(),
            cores: std::thread::available_parallelism().map_or(1, usize::from),
            simd: Level::best().name(),
            bf16: kernels::bf16_instructions(),
            memory: machine::available(),
            disk: machine::free_disk(Path::new(".")),
        }
    }

    /// One line for each finding.
    fn rows(&self) -> Vec<(&'static str, String)> {
        let size = |bytes: Option<u64>| bytes.map_or_else(|| "the system does not tell".into(), machine::gigabytes);
        let denoiser = match (&self.denoiser.problem, &self.denoiser.library) {
            (Some(problem), _) => format!("OIDN is missing: {problem}"),
            (None, Some(library)) => format!("OIDN, {}", library.display()),
            (None, None) => "OIDN".into(),
        };
        let missing: Vec<String> =
            self.lpips.iter().filter(|weights| !weights.found).map(|weights| weights.file.display().to_string()).collect();
        let lpips = match missing.as_slice() {
            [] => self.lpips.iter().map(|weights| weights.file.display().to_string()).collect::<Vec<_>>().join(", "),
            missing => format!("missing: {} ({WEIGHTS_VARIABLE} names their folder)", missing.join(", ")),
        };
        let gpus = match self.gpus.as_slice() {
            [] if cfg!(any(feature = "vulkan", feature = "cuda")) => "none are found".to_owned(),
            [] => "this build runs networks on the processor (--features vulkan builds one for GPUs)".to_owned(),
            gpus => gpus.iter().map(shown).collect::<Vec<String>>().join("; "),
        };
        vec![
            ("version", self.version.to_owned()),
            ("denoiser", denoiser),
            ("network", self.network.shown()),
            ("inverse", self.inverse.shown()),
            ("LPIPS", lpips),
            ("GPUs", gpus),
            ("processor", format!("{}, {}, {}", self.processor, plural(self.cores, "core"), self.simd)),
            ("networks", format!("multiply in {}", self.bf16.map_or("32-bit floats".into(), |by| format!("bf16 by {by}")))),
            ("memory", format!("{} available", size(self.memory))),
            ("disk", format!("{} free in the current folder", size(self.disk))),
        ]
    }
}
