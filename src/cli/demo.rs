use super::{SceneArgs, TraceArgs};
use crate::dataset::SequenceFolder;
use crate::dataset::plan::Storage;
use crate::evaluate::report::{self, FramePictures, Report};
use crate::evaluate::{Method, Options, sequence, table};
use crate::progress::Progress;
use crate::truth::{self, SequenceJob, TruthSettings};
use anyhow::Result;
use clap::Args;
use renderflow_frame::file;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

/// The whole pipeline on one sequence: compose (or load) a scene, render truth and keyframes along an orbit, render it by split-sum
/// IBL and by the network without and with keyframes, print the comparison and write report.html. Run again, it goes on where it stopped.
#[derive(Args)]
#[command(after_help = "Examples:\n  renderflow demo\n  renderflow demo --scene model.glb --hdri sky.hdr --out demo-model")]
pub struct Demo {
    #[command(flatten)]
    scene: SceneArgs,
    #[command(flatten)]
    trace: TraceArgs,
    /// Seed of the composed scene (its light is never one of training)
    #[arg(long, default_value_t = 2026)]
    seed: u64,
    /// Pixels along both sides
    #[arg(long, default_value_t = 256, value_parser = clap::value_parser!(u32).range(16..=4096))]
    resolution: u32,
    /// Frames, 3.6 degrees of orbit each
    #[arg(long, default_value_t = 17, value_parser = clap::value_parser!(u32).range(1..=1000))]
    frames: u32,
    /// Distance of keyframes
    #[arg(long, default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..))]
    keyframe_gap: u32,
    /// Weights; those inside the program without it
    #[arg(long)]
    weights: Option<PathBuf>,
    /// Sample counts of path-traced rows
    #[arg(long, value_delimiter = ',', default_value = "1,4")]
    path_traced: Vec<u32>,
    /// Folder to write to
    #[arg(long, default_value = "demo-out")]
    out: PathBuf,
}

impl Demo {
    pub fn run(self, cancel: &AtomicBool) -> Result<()> {
        // What could fail fast fails before the first ray.
        let renderer = super::network(self.weights.as_deref())?;
        let lpips = super::lpips()?;
        let (scene, base) = self.scene.describe(self.seed, Some(self.resolution), Some(self.frames))?;
        let settings = TruthSettings::new(self.trace.spp, self.trace.max_bounces, self.trace.denoise)?;

        let progress = Progress::new("path tracing", u64::from(scene.frames) * 1000);
        let folder = self.out.join("sequence");
        let name = scene.name.clone();
        let job = SequenceJob {
            scene,
            base,
            out: folder.clone(),
            keyframe_gap: self.keyframe_gap,
            frame_step: 1,
            storage: Storage::Full,
        };
        let loaded = job.run(&settings, &progress, cancel)?;
        progress.finish();
        super::print_report(&loaded.report);

        let folder = SequenceFolder::open(&folder)?;
        let shown = shown_frames(folder.len());
        let mut pictures: Vec<FramePictures> = Vec::new();
        let progress = Progress::new("comparing", folder.len() as u64);
        let options = Options {
            lpips: lpips.as_ref(),
            path_traced: &self.path_traced,
            max_bounces: self.trace.max_bounces,
            denoise: self.trace.denoise,
            ..Options::new(&renderer)
        };
        let mut sink = |method: Option<Method>, frame: usize, picture: &renderflow_frame::image::Rgb| {
            if !shown.contains(&frame) {
                return;
            }
            match (method, pictures.last_mut()) {
                (Some(method), Some(last)) => last.methods.push((method, picture.clone())),
                _ => pictures.push(FramePictures { frame, truth: picture.clone(), methods: Vec::new() }),
            }
        };
        let evaluation = sequence::evaluate(&folder, &options, &mut sink, &progress, cancel)?;
        progress.finish();

        let rows = table::rows(std::slice::from_ref(&evaluation));
        let truth = (self.trace.spp, table::median(truth::seconds(&folder.path)));
        println!("{}", table::print(&rows, Some(truth)));
        let settings = self.settings(&name, &loaded, &settings, &evaluation, serde_json::to_string(renderer.header())?);
        let page = report::html(&Report {
            title: &format!("RenderFlow: {name}"),
            rows: &rows,
            truth,
            evaluation: &evaluation,
            pictures: &pictures,
            settings: &settings,
        })?;
        let report_path = self.out.join("report.html");
        file::write_atomic(&report_path, page.as_bytes())?;
        file::write_json(&self.out.join("scores.json"), &evaluation)?;
        for frame in &pictures {
            let path = self.out.join(format!("comparison.{:04}.png", frame.frame));
            file::write_atomic(&path, &report::png(&report::montage(frame))?)?;
        }
        println!("peak memory {}\nreport: {}", peak_memory(), report_path.display());
        Ok(())
    }

    fn settings(
        &self,
        name: &str,
        loaded: &renderflow_scenes::LoadedScene,
        truth: &TruthSettings,
        evaluation: &crate::evaluate::Evaluation,
        network: String,
    ) -> Vec<(String, String)> {
        let triangles: usize = loaded.instances.iter().map(|i| loaded.meshes[i.mesh].triangles.len()).sum();
        let setting = |name: &str, value: String| (name.to_owned(), value);
        vec![
            setting("program", format!("renderflow {}", env!("CARGO_PKG_VERSION"))),
            setting("scene", format!("{name}, BLAKE3 {}", loaded.hash)),
            setting(
                "size",
                format!("{0} x {0}, {1} frames, keyframe gap {2}", self.resolution, loaded.cameras.len(), self.keyframe_gap),
            ),
            setting("geometry", format!("{} instances, {triangles} triangles", loaded.instances.len())),
            setting(
                "truth",
                format!(
                    "{} spp, {} bounces, denoiser {}",
                    truth.spp,
                    truth.max_bounces,
                    truth.denoiser_name().as_deref().unwrap_or("none")
                ),
            ),
            setting("exposure", format!("{:.6}", renderflow_frame::ibl::exposure(&loaded.environment))),
            setting("environment prefiltering", format!("{:.3} s a sequence, not in the table", evaluation.prefilter_seconds)),
            setting("threads", rayon::current_num_threads().to_string()),
            setting("network", network),
        ]
    }
}

/// Three frames between the first and the last, none of them a keyframe at the default gap.
fn shown_frames(frames: usize) -> Vec<usize> {
    let mut shown: Vec<usize> = [1, 2, 3].iter().map(|quarter| (frames - 1) * quarter / 4).collect();
    shown.dedup();
    shown
}

/// Largest resident set of this process so far, from the operating system.
fn peak_memory() -> String {
    match crate::memory::peak() {
        0 => "unknown on this system".into(),
        bytes => format!("{:.0} MiB", bytes as f64 / f64::from(1 << 20)),
    }
}
