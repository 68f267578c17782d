use super::SplitArg;
use crate::dataset::{Plan, Shard, render};
use crate::truth::TruthSettings;
use anyhow::Result;
use clap::{Args, Subcommand};
use renderflow_renderer::Budget;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

/// Datasets: a small plan, then folders of sequences made from it.
#[derive(Subcommand)]
pub enum DatasetCommand {
    /// Write a plan: counts, sizes and the seed
    Plan(PlanArgs),
    /// Render a plan, or a shard of it; finished frames are kept
    Render(RenderArgs),
    /// Write scripts that render a plan on a Slurm or Kubernetes cluster
    Slurm(super::slurm::SlurmArgs),
}

/// Writes a plan file.
#[derive(Args)]
#[command(after_help = "Example: renderflow dataset plan --seed 5 --sequences 400 --frame-step 4 --spp 16 --out plan.json")]
pub struct PlanArgs {
    /// Root of the seed tree
    #[arg(long)]
    seed: u64,
    /// Pool of environments
    #[arg(long, value_enum, default_value = "train")]
    split: SplitArg,
    /// Sequences, one scene each
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..))]
    sequences: u32,
    /// Frames a sequence
    #[arg(long, default_value_t = 17, value_parser = clap::value_parser!(u32).range(1..))]
    frames: u32,
    /// Render only every so-manyth frame
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    frame_step: u32,
    /// Camera turn from a frame to the next
    #[arg(long, default_value_t = 3.6)]
    degrees_per_frame: f32,
    /// Pixels along both sides
    #[arg(long, default_value_t = 256, value_parser = clap::value_parser!(u32).range(1..=16384))]
    resolution: u32,
    /// Samples a pixel
    #[arg(long, default_value_t = 256, value_parser = clap::value_parser!(u32).range(1..))]
    spp: u32,
    /// Spend the samples where the picture is noisier, --spp a pixel on average
    #[arg(long)]
    adaptive: bool,
    /// Scattering events of a path
    #[arg(long, default_value_t = 6, value_parser = clap::value_parser!(u32).range(1..=64))]
    max_bounces: u32,
    /// Frames 0, gap, 2 gap, ... are keyframes
    #[arg(long, default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..))]
    keyframe_gap: u32,
    /// File to write
    #[arg(long)]
    out: PathBuf,
}

/// Renders a plan.
#[derive(Args)]
#[command(after_help = "Example: renderflow dataset render --plan plan.json --out data --shard 1/4")]
pub struct RenderArgs {
    /// Plan file
    #[arg(long)]
    plan: PathBuf,
    /// Dataset folder
    #[arg(long)]
    out: PathBuf,
    /// Part i of n, counted from 1; unless given, the task of a Slurm array or the index of a Kubernetes job, else all
    #[arg(long)]
    shard: Option<Shard>,
    /// Denoise with OIDN: where available, or else fail, or not at all
    #[arg(long, value_enum, default_value_t)]
    denoise: crate::truth::DenoiseMode,
}

impl DatasetCommand {
    pub fn run(self, cancel: &AtomicBool) -> Result<()> {
        match self {
            Self::Plan(args) => {
                let plan = Plan {
                    version: 1,
                    seed: args.seed,
                    split: args.split.into(),
                    sequences: args.sequences,
                    frames: args.frames,
                    frame_step: args.frame_step,
                    degrees_per_frame: args.degrees_per_frame,
                    resolution: [args.resolution; 2],
                    spp: args.spp,
                    adaptive: args.adaptive,
                    max_bounces: args.max_bounces,
                    keyframe_gap: args.keyframe_gap,
                };
                plan.check()?;
                Ok(renderflow_frame::file::write_json(&args.out, &plan)?)
            }
            Self::Render(args) => {
                let plan = Plan::read(&args.plan)?;
                let budget = if plan.adaptive { Budget::Average } else { Budget::Uniform };
                let settings = TruthSettings::spread(plan.spp, budget, plan.max_bounces, args.denoise)?;
                let assigned = Shard::choose(args.shard)?;
                eprintln!("{assigned}");
                render::run(&plan, &args.out, assigned.shard, &settings, cancel)
            }
            Self::Slurm(args) => args.run(),
        }
    }
}
