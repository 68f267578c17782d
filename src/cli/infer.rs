use super::WeightsArgs;
use crate::dataset::around::Neighbours;
use crate::dataset::shading::Shading;
use crate::dataset::{Dataset, Sequence};
use crate::evaluate::method::Method;
use crate::evaluate::method::tracing::Clean;
use crate::evaluate::renderer::{self, MethodRenderer};
use crate::util::cancel::Cancel;
use crate::util::device;
use crate::util::output::Claim;
use crate::util::picture;
use crate::util::progress::Progress;
use crate::util::ranges::within;
use anyhow::{Context, Result, anyhow, bail, ensure};
use clap::Args;
use renderflow_frame::{color, exr, file, reach};
use renderflow_model::fusion::{Fusion, FusionNet};
use renderflow_model::renderer::{Options, Rendered, Renderer, Session, State, View};
use renderflow_renderer::Settings;
use renderflow_renderer::denoise::Denoiser;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The file that says what made the pictures in a folder.
const RECORD: &str = "infer.json";
/// Said of a folder whose record differs.
pub(super) const OTHERS: &str = "pictures of other weights or options";
/// State of a network that was stopped between the clips of a sequence.
const STATE: &str = "stopped.safetensors";

/// Render the frames of sequence folders with a network
///
/// The network renders from deferred shading or from a few samples that are traced for it, and reads keyframes besides if it is
/// told to. The scene of each sequence must be beside its frames, as in datasets. The paper's network (--weights) only reads
/// G-buffers and keyframes, and deferred shading if it was trained to begin with it. It works in clips of five frames that
/// overlap by one, unless --stills is given. If the command was stopped, the same command continues.
#[derive(Args)]
#[command(after_help = "Examples:\n  renderflow infer --data data/test/seq-000009 --keyframes -o neural\n  \
renderflow infer --data data/test --rays 4 --neighbours around -o neural-rays\n  \
renderflow infer --data data/test --weights wan/flow.safetensors --vae wan/vae.safetensors -o wan-out")]
pub struct Infer {
    /// A sequence folder, or a folder of them
    #[arg(long, help_heading = "Input")]
    data: PathBuf,
    #[command(flatten)]
    weights: WeightsArgs,
    /// Use the beauty of the sequence's keyframes
    #[arg(long, help_heading = "Input")]
    keyframes: bool,
    /// Trace this many samples for each pixel, instead of deferred shading
    #[arg(long, value_name = "SAMPLES", value_parser = clap::value_parser!(u32).range(1..=65536), help_heading = "Sampling")]
    rays: Option<u32>,
    /// Spread the samples of --rays: more where the G-buffer shows detail, and as many on average
    #[arg(long, requires = "rays", help_heading = "Sampling")]
    adaptive: bool,
    /// Also use the samples of frames around the frame, as far as they agree
    #[arg(long, value_enum, requires = "rays", help_heading = "Sampling")]
    neighbours: Option<Neighbours>,
    /// The denoised picture that the network reads with the samples of --rays: OIDN's picture of least error (the default where
    /// OIDN is found), the one that takes least time, or none
    #[arg(long, value_enum, requires = "rays", help_heading = "Denoising")]
    denoised: Option<Clean>,
    /// How often a path of --rays may scatter
    #[arg(long, default_value_t = Settings::default().max_bounces, value_parser = within(Settings::MAX_BOUNCES), help_heading = "Sampling")]
    max_bounces: u32,
    /// Render each frame by itself with the paper's network too: sharper, but less stable over time
    #[arg(long, help_heading = "Network")]
    stills: bool,
    /// Euler steps of the paper's network; it is trained for 1
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1000), help_heading = "Network")]
    steps: u32,
    /// Seed of the noise that the paper's network begins with, for weights that were trained to begin with noise
    #[arg(long, default_value_t = 0, help_heading = "Network")]
    seed: u64,
    /// Folder to write to: an EXR with the picture as beauty and a PNG for every frame
    #[arg(long, short = 'o', help_heading = "Output")]
    out: PathBuf,
}

/// What decides the pictures. It is written into the folder, so that no other pictures are mixed in.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Record {
    network: String,
    /// BLAKE3 of the weights, which are in files or inside the program. Older programs recorded none of those inside them.
    weights: Vec<String>,
    header: String,
    keyframes: bool,
    steps: u32,
    #[serde(default, skip_serializing_if = "is_zero")]
    seed: u64,
    #[serde(default)]
    stills: bool,
    tile: Option<usize>,
    /// Name of the method in an evaluation; empty for networks that read no samples.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    method: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    max_bounces: Option<u32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    device: Option<String>,
    /// What was read, by the name of its pictures; empty in older folders.
    #[serde(default, skip_serializing_if = "Data::is_empty")]
    data: Data,
}

/// Names of inputs, with BLAKE3 of each.
pub(super) type Data = BTreeMap<String, String>;

/// Says which input of a folder was another one when its pictures were made.
///
/// # Errors
/// When there is one.
pub(super) fn same_data(then: &Data, now: &Data) -> Result<()> {
    match now.iter().find(|(name, digest)| then.get(*name).is_some_and(|old| old != *digest)) {
        Some((name, _)) => bail!("the folder holds pictures of another {name}; choose another folder"),
        None => Ok(()),
    }
}

/// For serde.
fn is_zero(seed: &u64) -> bool {
    *seed == 0
}

impl Infer {
    pub fn run(self, allowed: &[PathBuf], cancel: &Cancel) -> Result<()> {
        let dataset = Dataset::open(&self.data)?;
        let device = self.weights.device.open()?;
        let weights = match (self.weights.fusion(&device)?, &self.weights.weights) {
            (None, Some(weights)) => weights,
            (fusion, _) => return self.with_scene(&dataset, &fusion.context("no weights")?, allowed, cancel),
        };
        ensure!(self.rays.is_none(), "--rays: these weights are of a network that reads no samples");
        let renderer = self.weights.wan(weights, &device)?;
        let claim = self.claim(&*renderer, &dataset)?;
        for sequence in &dataset.sequences {
            ready(sequence).with_context(|| sequence.folder.display().to_string())?;
        }
        let progress = Progress::new("infer", dataset.sequences.iter().map(|s| s.len() as u64).sum());
        for sequence in &dataset.sequences {
            progress.message(sequence.name.clone());
            let work = self.work(sequence, &claim, &progress, cancel);
            let keys = if self.keyframes { &sequence.transforms.keyframes[..] } else { &[] };
            let shading = || Shading::new(sequence, allowed, keys);
            let mut shading =
                renderer.about().shaded.then(shading).transpose().with_context(|| sequence.folder.display().to_string())?;
            if renderer.about().in_clips(self.options()) {
                work.clips(&*renderer, &mut shading)
            } else {
                work.frames(&*renderer, &mut shading)
            }
            .with_context(|| sequence.folder.display().to_string())?;
        }
        progress.finish();
        Ok(())
    }

    fn work<'a>(&self, sequence: &'a Sequence, claim: &'a Claim, progress: &'a Progress, cancel: &'a Cancel) -> Work<'a> {
        Work { sequence, out: self.out.join(&sequence.name), claim, options: self.options(), progress, cancel }
    }

    /// Renders with the network that reads samples, and with samples or terms of deferred shading that are made from the scene.
    fn with_scene(&self, dataset: &Dataset, fusion: &Fusion, allowed: &[PathBuf], cancel: &Cancel) -> Result<()> {
        let others = [
            ("--stills", self.stills),
            ("--steps", self.steps != 1),
            ("--seed", self.seed != 0),
            ("--tile", self.weights.tile.is_some()),
        ];
        if let Some((option, _)) = others.into_iter().find(|(_, given)| *given) {
            bail!("{option}: is for the paper's network (--weights)");
        }
        let keys = if self.keyframes { "+keys" } else { "" };
        let neighbours = self.neighbours.unwrap_or(Neighbours::Alone).suffix();
        let usual = || if Denoiser::new().is_ok() { Clean::High } else { Clean::Raw };
        let denoised = self.denoised.unwrap_or_else(usual).suffix();
        let adaptive = if self.adaptive { "+adaptive" } else { "" };
        let id = match self.rays {
            Some(rays) => format!("pt{rays}{adaptive}{denoised}+neural{neighbours}{keys}"),
            None => format!("neural{keys}"),
        };
        let methods = [Method::parse(&id)?];
        let record = Record {
            network: "fusion".into(),
            weights: self.weights.digests::<FusionNet>()?,
            header: serde_json::to_string(fusion.header())?,
            keyframes: self.keyframes,
            steps: 1,
            seed: 0,
            stills: false,
            tile: None,
            method: id,
            max_bounces: self.rays.map(|_| self.max_bounces),
            device: device::recorded(&self.weights.device.get()?),
            data: with_earlier(&self.out.join(RECORD), data(dataset)?),
        };
        let claim = claim(&self.out, &record)?;
        for sequence in &dataset.sequences {
            let ready = || -> Result<()> {
                ready(sequence)?;
                let has_scene = sequence.folder.join("scene.json").is_file();
                ensure!(
                    has_scene,
                    "has no scene.json, and the network shades the scene: the paper's (--weights) reads G-buffers alone"
                );
                ensure!(!self.keyframes || !sequence.transforms.keyframes.is_empty(), "--keyframes: the sequence has none");
                Ok(())
            };
            ready().with_context(|| sequence.folder.display().to_string())?;
        }
        let options = renderer::Options {
            fusion: Some(fusion),
            max_bounces: self.max_bounces,
            allowed,
            timed: false,
            ..renderer::Options::new(&methods)
        };
        let progress = Progress::new("infer", dataset.sequences.iter().map(|s| s.len() as u64).sum());
        for sequence in &dataset.sequences {
            progress.message(sequence.name.clone());
            self.work(sequence, &claim, &progress, cancel)
                .methods(&options)
                .with_context(|| sequence.folder.display().to_string())?;
        }
        progress.finish();
        Ok(())
    }

    fn options(&self) -> Options {
        Options { keyframes: self.keyframes, steps: self.steps as usize, seed: self.seed, stills: self.stills }
    }

    /// The claim on the folder: it is written before the first picture. Fails if the folder holds other pictures.
    fn claim(&self, renderer: &dyn Renderer, dataset: &Dataset) -> Result<Claim> {
        let about = renderer.about();
        ensure!(!self.keyframes || about.keyframes, "--keyframes: this network does not read keyframes");
        let record = Record {
            network: about.name.into(),
            weights: self.weights.digests::<FusionNet>()?,
            header: about.header,
            keyframes: self.keyframes,
            steps: self.steps,
            seed: self.seed,
            stills: self.stills,
            tile: self.weights.tile,
            method: String::new(),
            max_bounces: None,
            device: device::recorded(&self.weights.device.get()?),
            data: with_earlier(&self.out.join(RECORD), data(dataset)?),
        };
        claim(&self.out, &record)
    }
}

/// `now` together with what the record `path` of earlier pictures names besides.
pub(super) fn with_earlier(path: &Path, mut now: Data) -> Data {
    #[derive(Deserialize)]
    struct Earlier {
        #[serde(default)]
        data: Data,
    }
    if let Ok(Earlier { data }) = file::read_json(path) {
        for (name, digest) in data {
            now.entry(name).or_insert(digest);
        }
    }
    now
}

/// What is read of each sequence.
pub(super) fn data(dataset: &Dataset) -> Result<Data> {
    let digest = |sequence: &Sequence| {
        let all: Vec<usize> = (0..sequence.len()).collect();
        let digest = sequence.digest(&all).with_context(|| sequence.folder.display().to_string())?;
        Ok((sequence.name.clone(), digest))
    };
    dataset.sequences.iter().map(digest).collect()
}

/// The claim on the folder `out` for pictures of `record`.
fn claim(out: &Path, record: &Record) -> Result<Claim> {
    Claim::agreed(out, RECORD, record, |there: &Record| {
        let options = |record: &Record| Record { data: Data::new(), ..record.clone() };
        ensure!(options(there) == options(record), "the folder holds {OTHERS}; choose another folder");
        same_data(&there.data, &record.data)
    })
}

/// Checks that the frames are there, and that pictures with their names stay in the folder that they are written to.
pub(super) fn ready(sequence: &Sequence) -> Result<()> {
    for file in &sequence.transforms.files {
        reach::plain_name(file).map_err(|reason| anyhow!("transforms.json: {reason}"))?;
        ensure!(sequence.folder.join(file).is_file(), "{file}: is not there");
    }
    Ok(())
}

/// One sequence to render.
struct Work<'a> {
    sequence: &'a Sequence,
    out: PathBuf,
    /// Written before the first picture.
    claim: &'a Claim,
    options: Options,
    progress: &'a Progress,
    cancel: &'a Cancel,
}

impl Work<'_> {
    /// File of the picture of a frame.
    fn path(&self, index: usize) -> PathBuf {
        self.out.join(&self.sequence.transforms.files[index]).with_extension("exr")
    }

    /// Renders frames that do not depend on each other. Pictures that are there already stay.
    fn frames(&self, renderer: &dyn Renderer, shading: &mut Option<Shading<'_>>) -> Result<()> {
        let mut session = renderer.begin(self.sequence, self.options)?;
        for index in 0..self.sequence.len() {
            if self.path(index).is_file() {
                self.progress.resume(1);
            } else {
                self.push(&mut *session, shading, index)?;
            }
        }
        Ok(())
    }

    /// Renders frames from the scene. Pictures that are there already stay.
    fn methods(&self, options: &renderer::Options) -> Result<()> {
        let missing: Vec<usize> = (0..self.sequence.len()).filter(|&index| !self.path(index).is_file()).collect();
        self.progress.resume((self.sequence.len() - missing.len()) as u64);
        if missing.is_empty() {
            return Ok(());
        }
        let mut renderer = MethodRenderer::new(self.sequence, options)?;
        for index in missing {
            self.cancel.check()?;
            let pictures = renderer.render(index, self.cancel)?;
            self.write(pictures.into_iter().map(|picture| Rendered { index, linear: picture.linear }).collect())?;
        }
        Ok(())
    }

    /// Renders frames in clips. Everything up to the last clip that was written stays.
    fn clips(&self, renderer: &dyn Renderer, shading: &mut Option<Shading<'_>>) -> Result<()> {
        let state = self.out.join(STATE);
        let done = (0..self.sequence.len()).take_while(|&index| self.path(index).is_file()).count();
        if done == self.sequence.len() && !state.is_file() {
            self.progress.resume(done as u64);
            return Ok(());
        }
        let mut session = renderer.begin(self.sequence, self.options)?;
        let start = match self.stopped(&state, done)? {
            Some((index, state)) => {
                let frame = self.sequence.frame(index)?;
                let number = self.sequence.numbers[index];
                let shaded = shading.as_mut().map(|shading| shading.picture(index, &frame)).transpose()?;
                session.resume(View { number, index, frame: &frame, shaded: shaded.as_ref() }, state)?;
                index + 1
            }
            None => 0,
        };
        self.progress.resume(start as u64);
        for index in start..self.sequence.len() {
            self.push(&mut *session, shading, index)?;
            if let Some(reached) = session.state() {
                self.claim.write()?;
                file::write_atomic(&state, &reached.encode()?)?;
            }
        }
        self.write(session.finish()?)?;
        // The file is this program's own: it was written above, or was read when work began.
        match std::fs::remove_file(&state) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                Err(error).with_context(|| format!("{}: cannot remove", state.display()))
            }
            _ => Ok(()),
        }
    }

    /// The index of the last frame of the last clip that was written, and the state that the next clip starts from. `None` where
    /// work starts from the beginning.
    fn stopped(&self, path: &Path, done: usize) -> Result<Option<(usize, State)>> {
        let bytes = match file::read(path) {
            Ok(bytes) => bytes,
            Err(error) if error.is_missing() => return Ok(None),
            Err(error) => return Err(error.into()),
        };
        let state = State::decode(path, &bytes)?;
        let index = self.sequence.numbers.iter().position(|number| *number == state.number);
        // Where frames were removed since then, all are made again.
        Ok(index.filter(|index| *index < done).map(|index| (index, state)))
    }

    fn push(&self, session: &mut dyn Session, shading: &mut Option<Shading<'_>>, index: usize) -> Result<()> {
        self.cancel.check()?;
        let frame = self.sequence.frame(index)?;
        let number = self.sequence.numbers[index];
        let shaded = shading.as_mut().map(|shading| shading.picture(index, &frame)).transpose()?;
        let rendered = session.push(View { number, index, frame: &frame, shaded: shaded.as_ref() })?;
        self.write(rendered)
    }

    fn write(&self, rendered: Vec<Rendered>) -> Result<()> {
        let exposure = self.sequence.exposure();
        for Rendered { index, linear } in rendered {
            let path = self.path(index);
            let mut frame = self.sequence.frame(index)?;
            self.claim.write()?;
            file::write_atomic(&path.with_extension("png"), &picture::png(&linear.map(|p| color::display(*p, exposure)))?)?;
            frame.beauty = Some(linear);
            frame.raw = None;
            frame.variance = None;
            (frame.indirect, frame.hidden) = (None, None);
            frame.info.denoiser = None;
            frame.info.spp = 0;
            exr::write(&path, &frame)?;
            self.progress.add(1);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sequences of earlier runs stay known, and what is read now counts in place of what was.
    #[test]
    fn records_keep_what_other_runs_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(RECORD);
        let data =
            |pairs: &[(&str, &str)]| pairs.iter().map(|(name, hash)| (name.to_string(), hash.to_string())).collect::<Data>();
        assert_eq!(with_earlier(&path, data(&[("b", "2")])), data(&[("b", "2")]));
        std::fs::write(&path, r#"{"data": {"a": "1"}, "steps": 1}"#).unwrap();
        assert_eq!(with_earlier(&path, data(&[("b", "2")])), data(&[("a", "1"), ("b", "2")]));
        let other = with_earlier(&path, data(&[("a", "9")]));
        assert_eq!(other, data(&[("a", "9")]));
        assert!(same_data(&data(&[("a", "1")]), &other).unwrap_err().to_string().contains("another a"));
    }
}
