use super::scene::any_resolution;
use crate::dataset::plan::Plan;
use crate::util::output;
use crate::util::ranges::{Resolution, within};
use crate::util::stop;
use anyhow::Result;
use clap::Args;
use renderflow_scenes::procedural::{Composition, Split, compose_one};
use std::path::PathBuf;

/// Writes a procedurally composed scene: objects on a ground, a room or open country, with light and a camera.
#[derive(Args)]
#[command(after_help = "Example: renderflow compose --seed 7 -o scene.json && renderflow render scene.json -o out")]
pub struct Compose {
    /// Seed of the scene
    #[arg(long, default_value_t = 1, help_heading = "Scene")]
    seed: u64,
    /// Split whose families of meshes and environments the scene is made of; training never sees those of val and test
    #[arg(long, value_enum, default_value = "train", help_heading = "Scene")]
    split: Split,
    /// Size of the pictures in pixels: 640x480, or 512 for a square
    #[arg(long, value_name = "WxH", default_value = "256", value_parser = any_resolution(), help_heading = "Scene")]
    resolution: Resolution,
    /// Number of frames
    #[arg(long, default_value_t = 17, value_parser = within(Plan::FRAMES), help_heading = "Scene")]
    frames: u32,
    /// Degrees that an orbiting camera turns from one frame to the next
    #[arg(long, default_value_t = 3.6, help_heading = "Scene")]
    degrees_per_frame: f32,
    /// File to write; without it, the scene goes to standard output
    #[arg(long, short = 'o', help_heading = "Output")]
    out: Option<PathBuf>,
    /// Replace the file if another one is there
    #[arg(long, requires = "out", help_heading = "Output")]
    overwrite: bool,
}

impl Compose {
    pub fn run(self) -> Result<()> {
        let composition = Composition { degrees_per_frame: self.degrees_per_frame, ..Composition::default() };
        let Resolution(resolution) = self.resolution;
        let scene = compose_one(self.seed, self.split, resolution, self.frames, &composition)?;
        match self.out {
            Some(path) => {
                let text = renderflow_frame::file::json(&path, &scene)?;
                stop::hold(|| output::write(&[(path, text)], self.overwrite))
            }
            None => {
                println!("{}", serde_json::to_string_pretty(&scene)?);
                Ok(())
            }
        }
    }
}
