//! `renderflow view`: a page on this computer that shows a scene by several methods while the camera, the light and the materials
//! are changed.
//!
//! The page and the program speak over a WebSocket. [`state`] has the messages, [`server`] the connection, [`stage`] the scene
//! and its pictures, and [`session`] decides what is rendered next.

mod camera;
mod changes;
mod inbox;
mod method;
mod outbox;
mod server;
mod session;
mod stage;
mod state;

use crate::dataset::job::with_absolute_paths;
use crate::util::cancel::Cancel;
use anyhow::Result;
use renderflow_frame::reach::Reach;
use renderflow_model::fusion::Fusion;
use renderflow_scenes::description::Scene;
use renderflow_scenes::load;

/// Serves `scene`, which may name files that `reach` allows, until `cancel` is set, on `port` of this computer; 0 takes a free
/// one. `opened` is called with the address of the page as soon as it can be opened.
///
/// # Errors
/// When the scene cannot be loaded, the port cannot be used, or `opened` fails.
pub fn serve(
    scene: Scene,
    reach: &Reach,
    network: Fusion,
    port: u16,
    opened: &dyn Fn(&str) -> Result<()>,
    cancel: &Cancel,
) -> Result<()> {
    let loaded = load::load(&scene, reach)?;
    // What the page saves may lie in any folder.
    let scene = with_absolute_paths(&scene, reach.base())?;
    let stage = stage::Stage::new(scene, loaded, network)?;
    server::serve(stage, port, opened, cancel)
}
