use super::WeightsArgs;
use crate::dataset::{Dataset, SequenceFolder, SequenceView};
use crate::evaluate::method::Method;
use crate::evaluate::renderer::{self, MethodRenderer};
use crate::output::Claim;
use crate::progress::Progress;
use crate::ranges::within;
use crate::report::picture;
use crate::truth::Interrupted;
use anyhow::{Context, Result, anyhow, bail, ensure};
use clap::{Args, ValueEnum};
use renderflow_frame::{color, exr, file, reach};
use renderflow_model::fusion::Fusion;
use renderflow_model::renderer::{Options, Rendered, Renderer, Session, State, View};
use renderflow_renderer::Settings;
use renderflow_renderer::denoise::Denoiser;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

/// What made the pictures of a folder.
const RECORD: &str = "infer.json";
/// What a folder with another record holds.
pub(super) const OTHERS: &str = "pictures of other weights or options";
/// Where a network that renders clips was stopped in a sequence.
const STATE: &str = "stopped.safetensors";

/// Renders every frame of sequence folders with a network: from deferred shading, from keyframes, from a few samples a pixel that are
/// traced for it, or all of them. The sequences' scenes must be beside the frames, as datasets have them. The paper's network (--weights) reads
/// G-buffers and keyframes alone, and works in clips of five frames that overlap by one, unless --stills. Run again with the same weights and
/// options, it goes on where it was stopped.
#[derive(Args)]
#[command(after_help = "Examples:\n  renderflow infer --data data/test/seq-000000 --keyframes --out neural\n  \
renderflow infer --data data/test --rays 4 --neighbours around --out neural-rays\n  \
renderflow infer --data data/test --weights wan/flow.safetensors --vae wan/vae.safetensors --out wan-out")]
pub struct Infer {
    /// A sequence folder, or a folder of them
    #[arg(long)]
    data: PathBuf,
    #[command(flatten)]
    weights: WeightsArgs,
    /// Use the beauty of the sequence's keyframes
    #[arg(long)]
    keyframes: bool,
    /// Samples a pixel to trace of each frame, in place of deferred shading
    #[arg(long, value_name = "SAMPLES", value_parser = clap::value_parser!(u32).range(1..=65536))]
    rays: Option<u32>,
    /// Take in samples of the two frames before, or before and after
    #[arg(long, value_enum, requires = "rays")]
    neighbours: Option<NeighboursArg>,
    /// What is made of the samples of --rays and read beside them: OIDN's picture of least error or of least time; by default the
    /// former where this build has OIDN
    #[arg(long, value_enum, requires = "rays")]
    denoised: Option<DenoisedArg>,
    /// Surfaces that a path of --rays may scatter at
    #[arg(long, default_value_t = Settings::default().max_bounces, value_parser = within(Settings::MAX_BOUNCES))]
    max_bounces: u32,
    /// Render each frame by itself with the paper's network too: sharper, but not held together over time
    #[arg(long)]
    stills: bool,
    /// Euler steps of the paper's network; 1 is what it is trained for
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1000))]
    steps: u32,
    /// Folder to write to: an EXR with the picture as beauty and a PNG for every frame
    #[arg(long)]
    out: PathBuf,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum NeighboursArg {
    Before,
    Around,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum DenoisedArg {
    Oidn,
    Fast,
    None,
}

/// What decides the pictures; written into the folder, so that others are not mixed in.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Record {
    network: String,
    /// BLAKE3 of the weights files; empty for the weights inside the program.
    weights: Vec<String>,
    header: String,
    keyframes: bool,
    steps: u32,
    #[serde(default)]
    stills: bool,
    tile: Option<usize>,
    /// Name of the method in an evaluation; empty for networks that read no samples.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    method: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    max_bounces: Option<u32>,
}

impl Infer {
    pub fn run(self, allowed: &[PathBuf], cancel: &AtomicBool) -> Result<()> {
        let dataset = Dataset::open(&self.data)?;
        let weights = match (self.weights.fusion()?, &self.weights.weights) {
            (None, Some(weights)) => weights,
            (fusion, _) => return self.with_scene(&dataset, &fusion.context("no weights")?, allowed, cancel),
        };
        ensure!(self.rays.is_none(), "--rays: these weights are of a network that reads no samples");
        let renderer = self.weights.wan(weights)?;
        let claim = self.claim(&*renderer)?;
        for folder in &dataset.sequences {
            ready(folder).with_context(|| folder.path.display().to_string())?;
        }
        let progress = Progress::new("infer", dataset.sequences.iter().map(|s| s.len() as u64).sum());
        for folder in &dataset.sequences {
            progress.message(folder.name());
            let work = self.work(folder, &claim, &progress, cancel);
            if renderer.about().in_clips(self.options()) { work.clips(&*renderer) } else { work.frames(&*renderer) }
                .with_context(|| folder.path.display().to_string())?;
        }
        progress.finish();
        Ok(())
    }

    fn work<'a>(&self, folder: &'a SequenceFolder, claim: &'a Claim, progress: &'a Progress, cancel: &'a AtomicBool) -> Work<'a> {
        Work { folder, out: self.out.join(folder.name()), claim, options: self.options(), progress, cancel }
    }

    /// Renders with the network that reads samples and terms of deferred shading, both made from the scene.
    fn with_scene(&self, dataset: &Dataset, fusion: &Fusion, allowed: &[PathBuf], cancel: &AtomicBool) -> Result<()> {
        let others = [("--stills", self.stills), ("--steps", self.steps != 1), ("--tile", self.weights.tile.is_some())];
        if let Some((option, _)) = others.into_iter().find(|(_, given)| *given) {
            bail!("{option}: is for the paper's network (--weights)");
        }
        let keys = if self.keyframes { "+keys" } else { "" };
        let neighbours = match self.neighbours {
            None => "",
            Some(NeighboursArg::Before) => "+before",
            Some(NeighboursArg::Around) => "+around",
        };
        let denoised = match self.denoised {
            Some(DenoisedArg::None) => "",
            Some(DenoisedArg::Fast) => "+fast",
            None if Denoiser::new().is_err() => "",
            Some(DenoisedArg::Oidn) | None => "+oidn",
        };
        let id = match self.rays {
            Some(rays) => format!("pt{rays}{denoised}+neural{neighbours}{keys}"),
            None => format!("neural{keys}"),
        };
        let methods = [Method::parse(&id)?];
        let record = Record {
            network: "fusion".into(),
            weights: self.weights.digests()?,
            header: serde_json::to_string(fusion.header())?,
            keyframes: self.keyframes,
            steps: 1,
            stills: false,
            tile: None,
            method: id,
            max_bounces: self.rays.map(|_| self.max_bounces),
        };
        let claim = Claim::new(&self.out, RECORD, &record, OTHERS)?;
        for folder in &dataset.sequences {
            let ready = || -> Result<()> {
                ready(folder)?;
                let there = folder.path.join("scene.json").is_file();
                ensure!(
                    there,
                    "has no scene.json, and the network shades the scene: the paper's (--weights) reads G-buffers alone"
                );
                ensure!(!self.keyframes || !folder.sequence.keyframes.is_empty(), "--keyframes: the sequence has none");
                Ok(())
            };
            ready().with_context(|| folder.path.display().to_string())?;
        }
        let options = renderer::Options {
            methods: &methods,
            fusion: Some(fusion),
            wan: None,
            guide_samples: 16,
            max_bounces: self.max_bounces,
            allowed,
            timed: false,
        };
        let progress = Progress::new("infer", dataset.sequences.iter().map(|s| s.len() as u64).sum());
        for folder in &dataset.sequences {
            progress.message(folder.name());
            self.work(folder, &claim, &progress, cancel).methods(&options).with_context(|| folder.path.display().to_string())?;
        }
        progress.finish();
        Ok(())
    }

    fn options(&self) -> Options {
        Options { keyframes: self.keyframes, steps: self.steps as usize, stills: self.stills }
    }

    /// What the pictures are made with, to be written before the first; or says that the folder holds others.
    fn claim(&self, renderer: &dyn Renderer) -> Result<Claim> {
        let about = renderer.about();
        ensure!(!self.keyframes || about.keyframes, "--keyframes: these weights cannot make use of any");
        let record = Record {
            network: about.name.into(),
            weights: self.weights.digests()?,
            header: about.header,
            keyframes: self.keyframes,
            steps: self.steps,
            stills: self.stills,
            tile: self.weights.tile,
            method: String::new(),
            max_bounces: None,
        };
        Claim::new(&self.out, RECORD, &record, OTHERS)
    }
}

/// Checks that the frames are there, and that pictures called after them stay in the folder they are written to.
pub(super) fn ready(folder: &SequenceFolder) -> Result<()> {
    for file in &folder.sequence.files {
        reach::plain_name(file).map_err(|reason| anyhow!("transforms.json: {reason}"))?;
        ensure!(folder.path.join(file).is_file(), "{file}: is not there");
    }
    Ok(())
}

/// One sequence to be rendered.
struct Work<'a> {
    folder: &'a SequenceFolder,
    out: PathBuf,
    /// What is written before the first picture.
    claim: &'a Claim,
    options: Options,
    progress: &'a Progress,
    cancel: &'a AtomicBool,
}

impl Work<'_> {
    /// Where a frame goes.
    fn path(&self, index: usize) -> PathBuf {
        self.out.join(&self.folder.sequence.files[index]).with_extension("exr")
    }

    /// Frames that do not depend on each other: those that are there are kept.
    fn frames(&self, renderer: &dyn Renderer) -> Result<()> {
        let view = SequenceView::new(self.folder);
        let mut session = renderer.begin(&view, self.options)?;
        for index in 0..self.folder.len() {
            if self.path(index).is_file() {
                self.progress.resume(1);
            } else {
                self.push(&mut *session, index)?;
            }
        }
        Ok(())
    }

    /// Frames made from the scene: those that are there are kept.
    fn methods(&self, options: &renderer::Options) -> Result<()> {
        let missing: Vec<usize> = (0..self.folder.len()).filter(|&index| !self.path(index).is_file()).collect();
        self.progress.resume((self.folder.len() - missing.len()) as u64);
        if missing.is_empty() {
            return Ok(());
        }
        let view = SequenceView::new(self.folder);
        let mut renderer = MethodRenderer::new(&view, options)?;
        for index in missing {
            if self.cancel.load(Ordering::Relaxed) {
                return Err(Interrupted.into());
            }
            let made = renderer.render(index, self.cancel)?;
            self.write(made.into_iter().map(|made| Rendered { index, linear: made.linear }).collect())?;
        }
        Ok(())
    }

    /// Frames in clips: what was there when the last clip was written is kept.
    fn clips(&self, renderer: &dyn Renderer) -> Result<()> {
        let state = self.out.join(STATE);
        let done = (0..self.folder.len()).take_while(|&index| self.path(index).is_file()).count();
        if done == self.folder.len() && !state.is_file() {
            self.progress.resume(done as u64);
            return Ok(());
        }
        let view = SequenceView::new(self.folder);
        let mut session = renderer.begin(&view, self.options)?;
        let start = match self.stopped(&state, done)? {
            Some((index, state)) => {
                let frame = self.folder.frame(index)?;
                let number = self.folder.numbers[index];
                session.resume(View { number, index, frame: &frame }, state)?;
                index + 1
            }
            None => 0,
        };
        self.progress.resume(start as u64);
        for index in start..self.folder.len() {
            self.push(&mut *session, index)?;
            if let Some(reached) = session.state() {
                self.claim.write()?;
                file::write_atomic(&state, &reached.encode()?)?;
            }
        }
        self.write(session.finish()?)?;
        // It is this program's: it was written above, or was read when work began.
        match std::fs::remove_file(&state) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                Err(error).with_context(|| format!("{}: cannot remove", state.display()))
            }
            _ => Ok(()),
        }
    }

    /// The index of the last frame of the last clip that was written, and what the next one begins with; `None` where work begins anew.
    fn stopped(&self, path: &Path, done: usize) -> Result<Option<(usize, State)>> {
        let bytes = match file::read(path) {
            Ok(bytes) => bytes,
            Err(error) if error.is_missing() => return Ok(None),
            Err(error) => return Err(error.into()),
        };
        let state = State::decode(path, &bytes)?;
        let index = self.folder.numbers.iter().position(|number| *number == state.number);
        // Where frames have been taken away since, all are made again.
        Ok(index.filter(|index| *index < done).map(|index| (index, state)))
    }

    fn push(&self, session: &mut dyn Session, index: usize) -> Result<()> {
        if self.cancel.load(Ordering::Relaxed) {
            return Err(Interrupted.into());
        }
        let frame = self.folder.frame(index)?;
        let number = self.folder.numbers[index];
        let rendered = session.push(View { number, index, frame: &frame })?;
        self.write(rendered)
    }

    fn write(&self, rendered: Vec<Rendered>) -> Result<()> {
        let exposure = self.folder.sequence.exposure;
        for Rendered { index, linear } in rendered {
            let path = self.path(index);
            let mut frame = self.folder.frame(index)?;
            self.claim.write()?;
            file::write_atomic(&path.with_extension("png"), &picture::png(&linear.map(|p| color::display(*p, exposure)))?)?;
            frame.beauty = Some(linear);
            frame.raw = None;
            frame.variance = None;
            frame.info.denoiser = None;
            frame.info.spp = 0;
            exr::write(&path, &frame)?;
            self.progress.add(1);
        }
        Ok(())
    }
}
