use super::scene::{SceneArgs, Wanted};
use super::{AllWeightsArgs, OpenArgs, TraceArgs};
use crate::dataset::Sequence;
use crate::dataset::denoise::Denoise;
use crate::dataset::job::{NO_TRUTH, SequenceJob, TruthSettings};
use crate::evaluate::find::TestSequence;
use crate::evaluate::method::Method;
use crate::evaluate::renderer;
use crate::evaluate::results::{Results, Scored, TRUTH, picture_file};
use crate::evaluate::run;
use crate::report::{self, table};
use crate::util::cancel::Cancel;
use crate::util::output;
use crate::util::picture;
use crate::util::progress::Progress;
use crate::util::ranges::{Resolution, resolution};
use crate::util::sheet;
use crate::util::text::plural;
use anyhow::{Result, ensure};
use clap::Args;
use renderflow_frame::file;
use renderflow_frame::frame_file::Profile;
use renderflow_renderer::denoise::Denoiser;
use std::path::{Path, PathBuf};

/// Seed of the scene: a gilded ring, a goblet and firs in front of a sun that is about to set. Networks find its hard, low light,
/// long shadows and glossy metal hardest, and no network of the program was trained on its families.
const SCENE: u64 = 53;
/// Samples for each pixel of the truth by default: the whole demo then takes about a minute on four cores.
const SAMPLES: u32 = 128;

/// The whole pipeline on one sequence: truth, every method, a table, and report/index.html
///
/// The command composes (or loads) a scene, renders truth and keyframes along an orbit, renders the same frames by split-sum IBL,
/// by deferred shading and by the networks with and without keyframes, prints the comparison and writes a report. If it was
/// stopped, the same command continues.
#[derive(Args)]
#[command(after_help = "Examples:\n  renderflow demo\n  renderflow demo model.glb --hdri sky.hdr -o demo-model")]
pub struct Demo {
    #[command(flatten)]
    scene: SceneArgs,
    #[command(flatten)]
    trace: TraceArgs,
    /// Seed. With a file, it replaces the scene's seed for random sampling. Otherwise it composes the scene (53 by default),
    /// whose meshes and light training never uses
    #[arg(long, help_heading = "Input")]
    seed: Option<u64>,
    /// Size of the pictures in pixels: 640x480, or 512 for a square
    #[arg(long, value_name = "WxH", default_value = "256", help_heading = "Output", value_parser = resolution(16..=4096))]
    resolution: Resolution,
    /// Number of frames; an orbiting camera turns by 3.6 degrees from one to the next
    #[arg(long, default_value_t = 17, value_parser = clap::value_parser!(u32).range(1..=1000), help_heading = "Input")]
    frames: u32,
    /// Distance between keyframes, in frames
    #[arg(long, default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..), help_heading = "Input")]
    keyframe_gap: u32,
    #[command(flatten)]
    weights: AllWeightsArgs,
    /// Samples for each pixel of the path-traced rows
    #[arg(long, value_delimiter = ',', default_value = "1,4", help_heading = "Sampling")]
    path_traced: Vec<u32>,
    /// Folder to write to
    #[arg(long, short, default_value = "demo-out", help_heading = "Output")]
    out: PathBuf,
    #[command(flatten)]
    open: OpenArgs,
    /// Print the table as JSON
    #[arg(long, help_heading = "Output")]
    json: bool,
}

impl Demo {
    pub fn run(self, allowed: &[PathBuf], cancel: &Cancel) -> Result<()> {
        ensure!(self.trace.denoise != Denoise::Neural, "--denoise neural: {NO_TRUTH}");
        // Fail early: whatever can be checked is checked before the first ray.
        let denoised = self.trace.denoise != Denoise::None && Denoiser::new().is_ok();
        let clean = if denoised { "+oidn" } else { "" };
        let traced = self.path_traced.iter().map(|spp| format!(",pt{spp}{clean}")).collect::<String>();
        let all = Method::list(&format!("ibl,deferred,warp,neural,neural+keys,wan,wan+keys{traced}"))?;
        let networks = self.weights.open(&all)?;
        let there = |method: &Method| networks.wan.is_some() || !method.is_wan();
        let methods: Vec<Method> = all.into_iter().filter(there).collect();
        let lpips = super::evaluate::lpips()?;
        let wanted = Wanted { seed: self.seed, composed: SCENE, resolution: Some(self.resolution), frames: Some(self.frames) };
        let (scene, base) = self.scene.describe(allowed, &wanted)?;
        let settings = TruthSettings::new(self.trace.settings(SAMPLES), self.trace.denoise, &networks.device)?;

        let progress = Progress::new("path tracing", u64::from(scene.frames) * 1000);
        let folder = self.out.join("sequence");
        let name = scene.name.clone();
        // The scene beside the frames names the same files in full.
        let named: Vec<PathBuf> = base.folders().map(Path::to_owned).collect();
        let job = SequenceJob {
            scene,
            base,
            out: folder.clone(),
            keyframe_gap: self.keyframe_gap,
            frame_step: 1,
            storage: Profile::Full,
        };
        let mut sequence = job.open()?;
        let work = sequence.decide(&settings, None)?;

        let options = run::Options {
            rendering: renderer::Options { max_bounces: self.trace.max_bounces, allowed: &named, ..networks.rendering(&methods) },
            lpips: &lpips,
            every: 1,
            raw_truth: false,
            pictures: 17,
            title: format!("RenderFlow: {name}"),
            settings: self.settings(&name, &sequence.loaded, &settings, networks.settings()),
        };
        let [results_folder, report_folder] = ["results", "report"].map(|name| self.out.join(name));
        run::check(&options, &results_folder)?;
        output::check_page(&report_folder.join("index.html"))?;
        let ours = output::exists(&folder) || output::is_empty(&self.out)?;
        ensure!(ours, "{}: not empty, and not of a demo; choose another folder", self.out.display());

        sequence.make(&work, &settings, &progress, cancel)?;
        progress.finish();
        super::print_report(&sequence.loaded.report);
        let test = TestSequence { set: "demo".into(), class: "scene".into(), sequence: Sequence::open(&folder)? };
        let progress = Progress::new("comparing", test.sequence.len() as u64);
        run::run(&[test], &options, &results_folder, &progress, cancel)?;
        progress.finish();

        let results = Results::read(&results_folder)?;
        if self.json {
            println!("{}", serde_json::to_string_pretty(&table::json(&results))?);
        } else {
            print!("{}", table::markdown(&results, table::Filter::default()));
        }
        for scored in &results.sequences {
            self.montages(scored, &results)?;
        }
        let progress = Progress::new("report", results.sequences.len() as u64 + 1);
        report::build(&results, &report_folder, &progress, cancel)?;
        progress.finish();
        let page = report_folder.join("index.html");
        if !self.json {
            println!("peak memory {}\nreport: {}", peak_memory(), page.display());
        }
        self.open.open(&page);
        Ok(())
    }

    /// Writes the pictures of the first, the middle and the last frame side by side with their names; below them their errors,
    /// and where these are largest.
    fn montages(&self, scored: &Scored, results: &Results) -> Result<()> {
        let shown = &scored.about.shown;
        let mut frames: Vec<usize> =
            [0, shown.len() / 2, shown.len().saturating_sub(1)].iter().filter_map(|&i| shown.get(i).copied()).collect();
        frames.dedup();
        for frame in frames {
            let read = |method: &str| picture::display_values(&scored.pictures.join(picture_file(frame, method)));
            let truth = read(TRUTH)?;
            let there = results.about.methods.iter().filter(|m| scored.pictures.join(picture_file(frame, &m.id)).is_file());
            let others = there.map(|method| Ok((method.label.clone(), read(&method.id)?))).collect::<Result<Vec<_>>>()?;
            let comparison = sheet::comparison(&truth, &others);
            file::write_atomic(&self.out.join(format!("comparison.{frame:04}.png")), &picture::png(&comparison)?)?;
        }
        Ok(())
    }

    fn settings(
        &self,
        name: &str,
        loaded: &renderflow_scenes::LoadedScene,
        truth: &TruthSettings,
        networks: Vec<(String, String)>,
    ) -> Vec<(String, String)> {
        let Resolution([width, height]) = self.resolution;
        let triangles: usize = loaded.instances.iter().map(|i| loaded.meshes[i.mesh].triangles.len()).sum();
        let setting = |name: &str, value: String| (name.to_owned(), value);
        let mut settings = vec![
            setting("scene", format!("{name}, BLAKE3 {}", loaded.hash)),
            setting(
                "size",
                format!("{width} x {height}, {}, keyframe gap {}", plural(loaded.cameras.len(), "frame"), self.keyframe_gap),
            ),
            setting("geometry", format!("{}, {}", plural(loaded.instances.len(), "instance"), plural(triangles, "triangle"))),
            setting(
                "truth",
                format!(
                    "{} spp, {}, denoiser {}",
                    truth.render.spp,
                    plural(truth.render.max_bounces, "bounce"),
                    truth.denoiser_name().as_deref().unwrap_or("none")
                ),
            ),
            setting("exposure", format!("{:.6}", renderflow_frame::ibl::exposure(&loaded.environment))),
        ];
        settings.extend(networks);
        settings
    }
}

/// Largest resident set of this process so far, from the operating system.
fn peak_memory() -> String {
    match crate::util::machine::peak() {
        0 => "unknown on this system".into(),
        bytes => format!("{:.0} MiB", bytes as f64 / f64::from(1 << 20)),
    }
}
