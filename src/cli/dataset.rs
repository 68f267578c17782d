use super::scene::any_resolution;
use crate::dataset::denoise::Denoise;
use crate::dataset::job::NO_TRUTH;
use crate::dataset::plan::{Allowed, Keyframes, NO_CLASSIC, Plan, Render, is_keyframe};
use crate::dataset::{Shard, log, merge, planning, preview, render, repair, stats, verify};
use crate::report;
use crate::util::cancel::Cancel;
use crate::util::ranges::{Resolution, within};
use crate::util::text::plural;
use crate::util::{files, output};
use anyhow::{Result, bail, ensure};
use clap::{Args, Subcommand};
use renderflow_frame::file;
use renderflow_frame::frame_file::Profile;
use renderflow_renderer::Settings;
use renderflow_renderer::denoise::Denoiser;
use renderflow_scenes::procedural::{Composition, Split};
use serde_json::{Value, json};
use std::path::PathBuf;

/// Said below the help of `dataset`.
pub(super) const HELP: &str = "\
Examples:
  renderflow dataset plan --seed 5 --sequences 10 --frames 8 --resolution 192 --spp 64 -o plan.toml
  renderflow dataset render --plan plan.toml -o data
  renderflow dataset verify data";

/// Datasets: a small plan, and folders of sequences made from it.
#[derive(Subcommand)]
pub enum DatasetCommand {
    /// Write a plan: counts, sizes, the seed, and what scenes look like
    Plan(PlanArgs),
    /// Show what a plan would make: contact sheets of its meshes, environments and scenes, and counts of its catalogue
    Preview(PreviewArgs),
    /// Render a plan, or a shard of it; finished frames stay
    Render(RenderArgs),
    /// Write the manifest of a dataset whose shards are complete
    Merge(MergeArgs),
    /// Verify a dataset: counts, hashes, values, depth against motion and normals, splits
    Verify(VerifyArgs),
    /// Make damaged or missing parts of a dataset again, with the same bytes
    Repair(RepairArgs),
    /// Write a page of histograms about a dataset
    Stats(StatsArgs),
    /// Write scripts that render a plan on a Slurm or Kubernetes cluster
    Slurm(super::slurm::SlurmArgs),
    Pack(super::pack::PackArgs),
    /// Write a dataset for nerfstudio, Cosmos DiffusionRenderer or COCO tools, or as PNG files
    Export(super::export::ExportArgs),
}

/// Writes a plan file.
#[derive(Args)]
#[command(after_help = "Example: renderflow dataset plan --seed 5 --sequences 1300 --resolution 512 -o plan.toml\n\
The file holds the settings (layouts, cameras, materials, motion, families of each split); edit it before rendering.")]
pub struct PlanArgs {
    /// Root of the seed tree
    #[arg(long, help_heading = "Sequences")]
    seed: u64,
    /// Put all sequences into this split; by default, val and test get a tenth each
    #[arg(long, value_enum, help_heading = "Sequences")]
    split: Option<Split>,
    /// Number of sequences; each has a scene of its own
    #[arg(long, value_parser = within(Plan::SEQUENCES), help_heading = "Sequences")]
    sequences: u32,
    /// Frames in each sequence
    #[arg(long, default_value_t = 100, value_parser = within(Plan::FRAMES), help_heading = "Sequences")]
    frames: u32,
    /// Render only every n-th frame
    #[arg(long, default_value_t = Plan::FRAME_STEP, value_parser = within(Plan::FRAMES), help_heading = "Sequences")]
    frame_step: u32,
    /// Degrees that an orbiting camera turns from one frame to the next
    #[arg(long, default_value_t = Composition::default().degrees_per_frame, help_heading = "Sequences")]
    degrees_per_frame: f32,
    /// Size of the frames in pixels: 640x480, or 512 for a square
    #[arg(long, value_name = "WxH", default_value = "256", value_parser = any_resolution(), help_heading = "Output")]
    resolution: Resolution,
    /// Samples for each pixel; 0 renders G-buffers only
    #[arg(long, default_value_t = Settings::default().spp, value_parser = within(Plan::SPP), help_heading = "Sampling")]
    spp: u32,
    /// Spend more samples where the picture is noisier, --spp for each pixel on average
    #[arg(long, help_heading = "Sampling")]
    adaptive: bool,
    /// How often a path may scatter
    #[arg(long, default_value_t = Settings::default().max_bounces, value_parser = within(Settings::MAX_BOUNCES), help_heading = "Sampling")]
    max_bounces: u32,
    /// How to denoise the picture. The plan stores whether OIDN is used, so that all machines make the same dataset
    #[arg(long, value_enum, default_value_t, help_heading = "Denoising")]
    denoise: Denoise,
    /// Frames 0, gap, 2 gap, ... are keyframes
    #[arg(long, default_value_t = Keyframes::GAP, value_parser = within(Plan::FRAMES), help_heading = "Sequences")]
    keyframe_gap: u32,
    /// Samples for each pixel of the frames between keyframes; 0 renders G-buffers only
    #[arg(long, value_parser = within(Plan::SPP), help_heading = "Sampling")]
    between_spp: Option<u32>,
    /// Store the Euclidean distance as well as the planar depth
    #[arg(long, help_heading = "Output")]
    distance: bool,
    /// Store frames in the compact form for training
    #[arg(long, help_heading = "Output")]
    compact: bool,
    /// Number of meshes in the catalogue
    #[arg(long, default_value_t = Plan::MESHES, value_parser = within(Plan::CATALOGUE), help_heading = "Scenes")]
    mesh_count: u32,
    /// Number of environment maps in the catalogue
    #[arg(long, default_value_t = Plan::ENVIRONMENTS, value_parser = within(Plan::CATALOGUE), help_heading = "Scenes")]
    environment_count: u32,
    /// Folder of glTF, OBJ and PLY models to mix in
    #[arg(long, value_name = "DIR", help_heading = "Scenes")]
    meshes: Option<PathBuf>,
    /// Folder of environment maps (.hdr, .exr) to mix in
    #[arg(long, value_name = "DIR", help_heading = "Scenes")]
    hdris: Option<PathBuf>,
    /// Refused: version 0.1 had another composer
    #[arg(long, hide = true)]
    classic: bool,
    /// File to write: TOML if its name ends in .toml, JSON otherwise
    #[arg(long, short = 'o', help_heading = "Output")]
    out: PathBuf,
    /// Replace the file if another one is there, such as an edited plan
    #[arg(long, help_heading = "Output")]
    overwrite: bool,
}

/// Shows what a plan would make.
#[derive(Args)]
#[command(after_help = "Example: renderflow dataset preview --plan plan.json -o preview")]
pub struct PreviewArgs {
    /// Plan file
    #[arg(long)]
    plan: PathBuf,
    /// Folder for meshes.png, environments.png and scenes.png
    #[arg(long, short = 'o')]
    out: PathBuf,
    /// Pixels along a side of each picture
    #[arg(long, default_value_t = 128, value_parser = clap::value_parser!(u32).range(16..=1024))]
    size: u32,
    /// Samples for each pixel
    #[arg(long, default_value_t = 32, value_parser = within(Settings::SPP))]
    spp: u32,
    /// Number in the catalogue of the first mesh and the first environment to show
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u32).range(..=1_000_000))]
    first: u32,
    /// Also make every mesh and every map of the catalogue, which takes minutes, and count distinct meshes and maps, watertight
    /// meshes and triangles
    #[arg(long)]
    count: bool,
    /// Count as with --count, and make no pictures
    #[arg(long)]
    count_only: bool,
    /// Print the counts as JSON
    #[arg(long)]
    json: bool,
}

/// Renders a plan.
#[derive(Args)]
#[command(after_help = "Example: renderflow dataset render --plan plan.json -o data --shard 1/4\n\
After a termination signal, the current frame is finished (exit code 75); the same command goes on. Finished frames are hashed and\n\
compared with their record; damaged ones are rendered again. Frames that fail are recorded (failures.json beside them, logs/*.jsonl)\n\
and do not stop the others; the same command tries them again.")]
pub struct RenderArgs {
    /// Plan file
    #[arg(long)]
    plan: PathBuf,
    /// Dataset folder
    #[arg(long, short = 'o')]
    out: PathBuf,
    /// Part i of n, counted from 1. Without it, the task of a Slurm array or the index of a Kubernetes job decides; without
    /// those, everything is rendered
    #[arg(long)]
    shard: Option<Shard>,
    /// Continue where an earlier run stopped. This always happens; the option is here for scripts that ask for it
    #[arg(long)]
    resume: bool,
}

/// Writes the manifest.
#[derive(Args)]
#[command(after_help = "Example: renderflow dataset merge --plan plan.json -o data\n\
Every file is hashed first; a dataset that is damaged or not complete is refused.")]
pub struct MergeArgs {
    /// Plan file
    #[arg(long)]
    plan: PathBuf,
    /// Dataset folder
    #[arg(long, short = 'o')]
    out: PathBuf,
}

/// Verifies a dataset.
#[derive(Args)]
#[command(after_help = "Example: renderflow dataset verify data\n\
Prints each fault with the command that repairs it, and notes about oddities that do no harm. Exit code 1 if there are faults.")]
pub struct VerifyArgs {
    /// Dataset folder
    dataset: PathBuf,
    /// Print the findings as JSON
    #[arg(long)]
    json: bool,
}

/// Repairs a dataset.
#[derive(Args)]
#[command(after_help = "Example: renderflow dataset repair data\n\
Reads everything as `verify` does, then renders what is damaged or missing. Files that are not part of the dataset are\n\
not removed. Those that are in the way are moved to the folder `aside` in the dataset.")]
pub struct RepairArgs {
    /// Dataset folder
    dataset: PathBuf,
    /// The plan of the dataset, if the dataset's own plan is damaged and no log holds it
    #[arg(long)]
    plan: Option<PathBuf>,
}

/// Writes a page of histograms.
#[derive(Args)]
#[command(after_help = "Example: renderflow dataset stats data -o stats.html")]
pub struct StatsArgs {
    /// Dataset folder
    dataset: PathBuf,
    /// Page to write; stats.html in the dataset folder by default
    #[arg(long, short = 'o')]
    out: Option<PathBuf>,
    /// Print the numbers as JSON
    #[arg(long)]
    json: bool,
}

impl DatasetCommand {
    pub fn run(self, allowed: &[PathBuf], cancel: &Cancel) -> Result<()> {
        match self {
            Self::Plan(args) => args.run(allowed, cancel),
            Self::Preview(args) => args.run(allowed, cancel),
            Self::Render(args) => {
                let plan = Plan { allowed: Allowed(allowed.to_vec()), ..Plan::read(&args.plan)? };
                for idle in plan.idle() {
                    eprintln!("note: {}: {idle}", args.plan.display());
                }
                let assigned = Shard::choose(args.shard)?;
                eprintln!("{assigned}");
                render::run(&plan, &args.out, assigned.shard, cancel)?;
                Ok(())
            }
            Self::Merge(args) => {
                let manifest = merge::merge(&Plan::read(&args.plan)?, &args.out, cancel)?;
                let frames = manifest.frames.train + manifest.frames.val + manifest.frames.test;
                println!("{}, {}", plural(manifest.entries.len(), "sequence"), plural(frames, "frame"));
                Ok(())
            }
            Self::Verify(args) => args.run(cancel),
            Self::Repair(args) => args.run(allowed, cancel),
            Self::Stats(args) => args.run(cancel),
            Self::Slurm(args) => args.run(allowed),
            Self::Pack(args) => args.run(cancel),
            Self::Export(args) => args.run(cancel),
        }
    }
}

impl PlanArgs {
    /// The first option that would change nothing, and why.
    fn idle(&self) -> Option<(&'static str, &'static str)> {
        const NO_PATHS: &str = "with --spp 0 no path is traced";
        const NO_PICTURES: &str = "with --spp 0 no frame has a picture";
        let bare = self.spp == 0;
        let mut rendered = (0..self.frames as usize).step_by(self.frame_step as usize);
        let options = [
            ("--distance", self.compact && self.distance, "compact frames hold no distance, because it follows from the depth"),
            ("--adaptive", bare && self.adaptive, NO_PATHS),
            ("--max-bounces", bare && self.max_bounces != Settings::default().max_bounces, NO_PATHS),
            ("--denoise oidn", bare && self.denoise == Denoise::Oidn, NO_PICTURES),
            ("--between-spp", bare && self.between_spp.is_some_and(|spp| spp > 0), NO_PICTURES),
            ("--keyframe-gap", bare && self.keyframe_gap != Keyframes::GAP, NO_PICTURES),
            (
                "--between-spp",
                self.between_spp.is_some() && rendered.all(|number| is_keyframe(self.keyframe_gap, number)),
                "every frame that is rendered is a keyframe",
            ),
        ];
        options.into_iter().find_map(|(option, idle, reason)| idle.then_some((option, reason)))
    }

    fn run(self, allowed: &[PathBuf], cancel: &Cancel) -> Result<()> {
        ensure!(!self.classic, "--classic: {NO_CLASSIC}");
        if let Some((option, reason)) = self.idle() {
            bail!("{option}: {reason}, so it would change nothing; leave it out");
        }
        let denoise = match self.denoise {
            Denoise::Auto if Denoiser::new().is_ok() => Denoise::Oidn,
            Denoise::Auto => Denoise::None,
            Denoise::Neural => bail!("--denoise neural: {NO_TRUTH}"),
            named => named,
        };
        let mut plan = Plan {
            version: 2,
            seed: self.seed,
            sequences: match self.split {
                Some(split) => planning::all_to(split, self.sequences),
                None => planning::share_out(self.sequences),
            },
            frames: self.frames,
            frame_step: self.frame_step,
            resolution: self.resolution.0,
            render: Render {
                spp: self.spp,
                adaptive: self.adaptive,
                max_bounces: self.max_bounces,
                denoise,
                irradiance: false,
                distance: self.distance,
                light_groups: 0,
            },
            keyframes: Keyframes { gap: self.keyframe_gap, between_spp: self.between_spp },
            storage: if self.compact { Profile::Compact } else { Profile::Full },
            meshes: self.mesh_count,
            environments: self.environment_count,
            classic: (),
            composition: Composition { degrees_per_frame: self.degrees_per_frame, ..Composition::default() },
            splits: Default::default(),
            allowed: Allowed(allowed.to_vec()),
        };
        plan.splits = planning::splits(&plan, self.meshes.as_deref(), self.hdris.as_deref(), cancel)?;
        plan.check()?;
        cancel.check()?;
        if plan.frames > 1 && plan.numbers().count() == 1 {
            let (step, frames) = (plan.frame_step, plan.frames);
            eprintln!("note: with --frame-step {step}, only the first of {frames} frames is rendered");
        }
        let text = if files::has_ending(&self.out, &["toml"]) {
            toml::to_string_pretty(&plan)?.into_bytes()
        } else {
            file::json(&self.out, &plan)?
        };
        output::write(&[(self.out, text)], self.overwrite)
    }
}

impl PreviewArgs {
    fn run(self, allowed: &[PathBuf], cancel: &Cancel) -> Result<()> {
        let plan = Plan { allowed: Allowed(allowed.to_vec()), ..Plan::read(&self.plan)? };
        preview::check_folder(&self.out)?;
        let all = self.count || self.count_only;
        let found = if all { preview::counted(&plan, cancel)? } else { preview::inventory(&plan) };
        let sheets = if self.count_only { Vec::new() } else { preview::sheets(&plan, self.size, self.spp, self.first, cancel)? };
        file::write_json(&self.out.join(preview::CATALOG), &found)?;
        for (name, bytes) in sheets {
            file::write_atomic(&self.out.join(name), &bytes)?;
        }
        if self.json {
            println!("{}", serde_json::to_string_pretty(&found)?);
            return Ok(());
        }
        let count = |number: Option<usize>, what: &str| number.map_or_else(String::new, |number| format!(", {number} {what}"));
        let mean = found.triangles.map(|all| (all as f64 / found.meshes.max(1) as f64).round() as usize);
        println!(
            "{} meshes of {} families{}{}{}",
            found.meshes,
            found.families.len(),
            count(found.distinct_meshes, "distinct"),
            count(found.watertight, "watertight"),
            count(mean, "triangles on average")
        );
        println!(
            "{} environments of {} families{}",
            found.environments,
            found.environment_families.len(),
            count(found.distinct_environments, "distinct")
        );
        Ok(())
    }
}

impl VerifyArgs {
    fn run(self, cancel: &Cancel) -> Result<()> {
        let found = verify::verify(&self.dataset, cancel)?;
        let agreement = &found.agreement;
        let percent = |part: u64, whole: u64| 100.0 * part as f64 / whole.max(1) as f64;
        if self.json {
            let faults =
                found.faults.iter().map(|fault| json!({ "fault": fault.to_string(), "remedy": fault.remedy.to_string() }));
            let findings = json!({
                "sequences": found.sequences,
                "frames": found.frames,
                "bytes": found.bytes,
                "motion_that_differs": [agreement.motion_off, agreement.motion],
                "points_found_percent": percent(agreement.seen, agreement.projected),
                "normals_against_depth_degrees": agreement.median_angle(),
                "normals_that_face_percent": percent(agreement.facing, agreement.covered),
                "notes": found.notes.iter().map(ToString::to_string).collect::<Vec<String>>(),
                "faults": faults.collect::<Vec<Value>>(),
            });
            println!("{}", serde_json::to_string_pretty(&findings)?);
            ensure!(found.faults.is_empty(), "{}: {}", self.dataset.display(), plural(found.faults.len(), "fault"));
            return Ok(());
        }
        let (sequences, frames) = (plural(found.sequences, "sequence"), plural(found.frames, "frame"));
        println!("{sequences}, {frames}, {} bytes", found.bytes);
        println!("motion vectors against depth and cameras: {} of {} differ", agreement.motion_off, agreement.motion);
        println!("points found at their depth a frame later: {:.1} %", percent(agreement.seen, agreement.projected));
        if let Some(angle) = agreement.median_angle() {
            println!("normals against the slope of the depth: {angle:.1} degrees (median)");
        }
        println!("normals that face the camera: {:.1} %", percent(agreement.facing, agreement.covered));
        for note in &found.notes {
            println!("NOTE {note}");
        }
        for fault in &found.faults {
            println!("FAULT {fault}\n  to repair it: {}", fault.remedy);
        }
        if !found.faults.is_empty() {
            bail!("{}: {}", self.dataset.display(), plural(found.faults.len(), "fault"));
        }
        println!("no faults");
        Ok(())
    }
}

impl RepairArgs {
    fn run(self, allowed: &[PathBuf], cancel: &Cancel) -> Result<()> {
        let plan = self.plan.as_deref().map(Plan::read).transpose()?;
        let repaired = repair::repair(&self.dataset, plan.as_ref(), Allowed(allowed.to_vec()), cancel)?;
        let render::Summary { made, kept, damaged, .. } = repaired.summary;
        println!("{} repaired; {} made, {kept} kept", plural(damaged, "sequence"), plural(made, "frame"));
        for file in &repaired.rewritten {
            println!("{file} written");
        }
        for stranger in &repaired.strangers {
            println!("FAULT {}: is not a sequence of the plan; move it out of the dataset", stranger.display());
        }
        match repaired.strangers.len() {
            0 => Ok(()),
            more => bail!("{}: {} outside of the plan left in place", self.dataset.display(), plural(more, "folder")),
        }
    }
}

impl StatsArgs {
    fn run(self, cancel: &Cancel) -> Result<()> {
        let numbers = stats::numbers(&self.dataset, cancel)?;
        let costs = log::costs(&self.dataset, cancel)?;
        if self.json {
            println!("{}", serde_json::to_string_pretty(&serde_json::json!({ "dataset": numbers, "costs": costs }))?);
        }
        let out = self.out.unwrap_or_else(|| self.dataset.join("stats.html"));
        output::check_page(&out)?;
        let full = output::resolved(&self.dataset)?;
        let name = full.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        let page = report::dataset::page(&name, &numbers, &costs, &stats::pictures(&self.dataset, cancel)?)?;
        file::write_atomic(&out, page.as_bytes())?;
        if !self.json {
            if costs.frames > 0 {
                let [compile, render, denoise, write] = costs.stages;
                println!(
                    "{} made in {:.1} s ({:.3} frames/s); one frame: compile {compile:.3}, render {render:.3}, denoise {denoise:.3}, write \
                     {write:.3} s; one sequence: load {:.3}, read back {:.3} s; memory by tenths {:.0?} MiB, most {:.0}; {}",
                    plural(costs.frames, "frame"),
                    costs.wall,
                    costs.frames as f64 / costs.wall.max(1e-9),
                    costs.sequences[0],
                    costs.sequences[1],
                    costs.memory,
                    costs.peak,
                    plural(costs.failures, "failure")
                );
            }
            let [complete, planned] = numbers.sequences;
            println!(
                "{complete} of {}, {}, {} bytes, {}, {}: {}",
                plural(planned, "sequence"),
                plural(numbers.frames, "frame"),
                numbers.bytes,
                plural(numbers.meshes, "mesh"),
                plural(numbers.environments, "environment"),
                out.display()
            );
        }
        Ok(())
    }
}
