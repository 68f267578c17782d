use super::SplitArg;
use crate::output;
use anyhow::Result;
use clap::Args;
use renderflow_scenes::procedural::{ComposeOptions, compose};
use std::path::PathBuf;

/// Writes a procedurally composed scene: ground, 4 to 16 objects, light and an orbit.
#[derive(Args)]
#[command(after_help = "Example: renderflow compose --seed 7 --out scene.json && renderflow render --scene scene.json --out out")]
pub struct Compose {
    /// Seed of the scene
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Pool the environment is drawn from; test uses the maps of hdri/, which training never sees
    #[arg(long, value_enum, default_value = "train")]
    split: SplitArg,
    /// Width and height in pixels
    #[arg(long, num_args = 2, default_values_t = [256, 256], value_names = ["WIDTH", "HEIGHT"])]
    resolution: Vec<u32>,
    /// Frames
    #[arg(long, default_value_t = 17)]
    frames: u32,
    /// Camera turn from a frame to the next
    #[arg(long, default_value_t = 3.6)]
    degrees_per_frame: f32,
    /// File to write; standard output without it
    #[arg(long)]
    out: Option<PathBuf>,
    /// Replace the file where another one is there
    #[arg(long, requires = "out")]
    overwrite: bool,
}

impl Compose {
    pub fn run(self) -> Result<()> {
        let scene = compose(&ComposeOptions {
            seed: self.seed,
            split: self.split.into(),
            resolution: [self.resolution[0], self.resolution[1]],
            frames: self.frames,
            degrees_per_frame: self.degrees_per_frame,
            ..ComposeOptions::default()
        });
        scene.validate()?;
        match self.out {
            Some(path) => {
                let text = renderflow_frame::file::json(&path, &scene)?;
                output::write(&[(path, text)], self.overwrite)
            }
            None => {
                println!("{}", serde_json::to_string_pretty(&scene)?);
                Ok(())
            }
        }
    }
}
