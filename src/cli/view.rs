//! `view`: shows a scene on a page that follows the mouse.

use super::OpenArgs;
use super::scene::{SceneArgs, Wanted, any_resolution};
use crate::dataset::plan::Plan;
use crate::util::cancel::Cancel;
use crate::util::console;
use crate::util::device::DeviceArgs;
use crate::util::ranges::{Resolution, within};
use crate::view;
use anyhow::{Result, ensure};
use clap::Args;
use std::path::{Path, PathBuf};

const HELP: &str = "\
Examples:
  renderflow view model.glb --open                 a model; the browser opens by itself
  renderflow view --seed 7 --resolution 512        a composed scene
  ssh -L 8000:localhost:8000 server renderflow view scene.json --port 8000   a scene on another machine

The page shows two methods beside each other, each with its seconds and, once the path tracer has 256 samples, its PSNR against
them. Drag to orbit, with shift to pan; the wheel zooms; a double click opens the material under the pointer.";

/// Look at a scene in the browser: orbit, change materials and light, compare methods
///
/// The page is served on this computer alone, at an address with a secret token. Ctrl-C ends the program.
#[derive(Args)]
#[command(after_help = HELP)]
pub struct View {
    #[command(flatten)]
    scene: SceneArgs,
    /// Seed of a composed scene
    #[arg(long, help_heading = "Input")]
    seed: Option<u64>,
    /// Number of frames; a model has one by default
    #[arg(long, value_parser = within(Plan::FRAMES), help_heading = "Input")]
    frames: Option<u32>,
    /// Columns and rows as WIDTHxHEIGHT, or one number for both
    #[arg(long, value_parser = any_resolution(), help_heading = "Input")]
    resolution: Option<Resolution>,
    /// Weights of the network; those inside the program without it
    #[arg(long, value_name = "FILE", help_heading = "Network")]
    weights: Option<PathBuf>,
    #[command(flatten)]
    device: DeviceArgs,
    /// Port of the page; 0 takes a free one
    #[arg(long, default_value_t = 0, help_heading = "Output")]
    port: u16,
    #[command(flatten)]
    open: OpenArgs,
}

/// Seed of the scene that is composed where nothing is named.
const COMPOSED: u64 = 1;

impl View {
    pub fn run(self, allowed: &[PathBuf], cancel: &Cancel) -> Result<()> {
        let wanted = Wanted { seed: self.seed, composed: COMPOSED, resolution: self.resolution, frames: self.frames };
        let (scene, reach) = self.scene.describe(allowed, &wanted)?;
        let network = super::fusion(self.weights.as_deref(), &self.device.open()?)?;
        let opened = |address: &str| {
            println!("{address}");
            ensure!(!console::is_closed(), "nobody reads the address of the page: standard output is closed");
            eprintln!("note: Ctrl-C ends the program");
            self.open.open(Path::new(address));
            Ok(())
        };
        view::serve(scene, &reach, network, self.port, &opened, cancel)
    }
}
