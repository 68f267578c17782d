use super::scene::{SceneArgs, Wanted};
use super::{AllWeightsArgs, OpenArgs, TraceArgs};
use crate::dataset::denoise::Denoise;
use crate::dataset::job::{NO_TRUTH, TruthSettings};
use crate::dataset::sweep::{self, Sweep};
use crate::evaluate::find::TestSequence;
use crate::evaluate::method::Method;
use crate::evaluate::renderer;
use crate::evaluate::results::Results;
use crate::evaluate::run;
use crate::report::steps::Steps;
use crate::util::cancel::Cancel;
use crate::util::output;
use crate::util::picture;
use crate::util::progress::Progress;
use crate::util::ranges::{Resolution, resolution};
use anyhow::{Result, ensure};
use clap::Args;
use renderflow_frame::file;
use renderflow_frame::reach::Reach;
use std::path::{Path, PathBuf};

/// Samples for each pixel of the truth by default.
const SAMPLES: u32 = 128;
/// The name of the set in the results.
const SET: &str = "edit";

/// Change materials, lights or the environment in steps, by networks and by path tracing: a sheet, a GIF and a table
///
/// Values of a scene go from one end to another in steps: materials, lights, the environment, anything that a scene file holds.
/// Every step is path-traced, and rendered by the methods as well. The command writes a labelled sheet and a GIF of each edit,
/// and prints the error at each step. Without --sweep, it makes the three edits that the paper shows: a red cone becomes smooth,
/// a yellow cylinder becomes metal, a blue cube becomes green. If it was stopped, the same command continues.
#[derive(Args)]
#[command(after_help = "Examples:
  renderflow edit -o edits
  renderflow edit room.json --sweep materials/2/roughness=.9...1 --steps 6 -o polished
  renderflow edit --seed 5 --sweep environment/rotation=0..180 --methods neural,pt4+oidn+neural -o turned
  renderflow edit room.json --sweep lights/0/color=[1,.6,.3]..[.4,.6,1] --sweep lights/0/kind/point/intensity=2..8 -o lit

Writes NAME.png (a row for the truth and for each method, a column for each step), NAME.gif, results/ for `renderflow report`, and
the path-traced frames in steps/.")]
pub struct Edit {
    #[command(flatten)]
    scene: SceneArgs,
    #[command(flatten)]
    trace: TraceArgs,
    /// Change a value of the scene from the first step to the last, as in materials/0/roughness=1..0 or
    /// materials/0/base_color=[0,0,1]..[0,1,0]. Several change together
    #[arg(long, value_name = "PATH=FROM..TO", help_heading = "Input")]
    sweep: Vec<Sweep>,
    /// Number of steps
    #[arg(long, default_value_t = 6, value_parser = clap::value_parser!(u32).range(1..=1000), help_heading = "Input")]
    steps: u32,
    /// Seed. With a file, it replaces the scene's seed for random sampling. Otherwise it composes the scene (1 by default)
    #[arg(long, help_heading = "Input")]
    seed: Option<u64>,
    /// Size of the pictures in pixels: 640x480, or 512 for a square
    #[arg(long, value_name = "WxH", default_value = "256", help_heading = "Output", value_parser = resolution(16..=4096))]
    resolution: Resolution,
    /// Methods to compare with path tracing, as in `evaluate`; wan-stills is there if its --weights are named
    #[arg(long, default_value = "deferred,neural,wan-stills", help_heading = "Methods")]
    methods: String,
    #[command(flatten)]
    weights: AllWeightsArgs,
    /// Folder to write to
    #[arg(long, short, help_heading = "Output")]
    out: PathBuf,
    #[command(flatten)]
    open: OpenArgs,
    /// Print the tables as JSON
    #[arg(long, help_heading = "Output")]
    json: bool,
}

impl Edit {
    pub fn run(self, allowed: &[PathBuf], cancel: &Cancel) -> Result<()> {
        ensure!(self.trace.denoise != Denoise::Neural, "--denoise neural: {NO_TRUTH}");
        let mut methods = Method::list(&self.methods)?;
        let networks = self.weights.open(&methods)?;
        if networks.wan.is_none() {
            methods.retain(|method| !method.is_wan());
        }
        ensure!(!methods.is_empty(), "--methods {}: needs the weights of the paper's network (--weights FILE)", self.methods);
        if let Some(method) = methods.iter().find(|method| method.needs_keyframes()) {
            ensure!(false, "--methods: {} needs keyframes, and each step of an edit is a picture by itself", method.id());
        }
        let lpips = super::evaluate::lpips()?;
        let (edits, base) = self.edits(allowed)?;
        let settings = TruthSettings::new(self.trace.settings(SAMPLES), self.trace.denoise, &networks.device)?;
        let named: Vec<PathBuf> = base.folders().map(Path::to_owned).collect();
        let options = run::Options {
            rendering: renderer::Options { max_bounces: self.trace.max_bounces, allowed: &named, ..networks.rendering(&methods) },
            lpips: &lpips,
            every: 1,
            raw_truth: false,
            pictures: 1,
            title: "RenderFlow: edits in steps".into(),
            settings: self.settings(&edits, &settings, networks.settings()),
        };
        let folder = self.out.join("results");
        run::check(&options, &folder)?;
        let frames = self.out.join("steps");
        // Where the frames of an edit are, its pictures come from an earlier run.
        for edit in edits.iter().filter(|edit| !output::exists(&frames.join(&edit.name))) {
            self.pictures(edit).iter().try_for_each(|path| output::absent(path))?;
        }
        let swept = sweep::render(&edits, self.steps, &base, &frames, &settings, cancel)?;
        swept.load.iter().for_each(super::print_report);
        let test = |(class, sequence)| TestSequence { set: SET.into(), class, sequence };
        let tests: Vec<TestSequence> = swept.steps.into_iter().map(test).collect();
        let progress = Progress::new("comparing", tests.len() as u64);
        run::run(&tests, &options, &folder, &progress, cancel)?;
        progress.finish();

        let results = Results::read(&folder)?;
        let mut tables = Vec::new();
        for edit in &edits {
            let labels = (0..self.steps).map(|step| edit.label(step, self.steps)).collect();
            let steps = Steps::new(&results, &edit.name, labels);
            let [sheet, animation] = self.pictures(edit);
            file::write_atomic(&sheet, &picture::png(&steps.sheet()?)?)?;
            if self.steps > 1 {
                file::write_atomic(&animation, &steps.animation()?)?;
            }
            if self.json {
                tables.push(steps.json());
            } else {
                println!("{}{}\n", steps.table(), sheet.display());
            }
        }
        if self.json {
            println!("{}", serde_json::to_string_pretty(&tables)?);
        }
        if let Some(edit) = edits.first() {
            self.open.open(&self.out.join(format!("{}.png", edit.name)));
        }
        Ok(())
    }

    /// The sheet and the animation of an edit.
    fn pictures(&self, edit: &sweep::Edit) -> [PathBuf; 2] {
        ["png", "gif"].map(|ending| self.out.join(format!("{}.{ending}", edit.name)))
    }

    /// The edits that are asked for, and the files that their scenes may name.
    fn edits(&self, allowed: &[PathBuf]) -> Result<(Vec<sweep::Edit>, Reach)> {
        if self.sweep.is_empty() {
            ensure!(
                self.scene.is_empty() && self.seed.is_none(),
                "name what changes with --sweep, as in --sweep materials/0/roughness=1..0"
            );
            return Ok((sweep::published(self.resolution.0), Reach::folder(".").allow(allowed)));
        }
        let wanted = Wanted { seed: self.seed, composed: 1, resolution: Some(self.resolution), frames: Some(1) };
        let (scene, base) = self.scene.describe(allowed, &wanted)?;
        Ok((vec![sweep::Edit::new(scene, self.sweep.clone())], base))
    }

    fn settings(&self, edits: &[sweep::Edit], truth: &TruthSettings, networks: Vec<(String, String)>) -> Vec<(String, String)> {
        let setting = |name: &str, value: String| (name.to_owned(), value);
        let of = |edit: &sweep::Edit| {
            let ends = [0, self.steps - 1].map(|step| edit.label(step, self.steps)).join(" to ");
            setting(&edit.name, format!("{ends} in {} steps; scene BLAKE3 {}", self.steps, edit.scene.hash()))
        };
        let mut settings: Vec<_> = edits.iter().map(of).collect();
        let denoiser = truth.denoiser_name();
        let Resolution([width, height]) = self.resolution;
        settings.push(setting("size", format!("{width} x {height}")));
        settings.push(setting("truth", format!("{} spp, denoiser {}", truth.render.spp, denoiser.as_deref().unwrap_or("none"))));
        settings.extend(networks);
        settings
    }
}
