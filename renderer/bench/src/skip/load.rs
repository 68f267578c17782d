//! Rows of what loading leaves out.

use super::{Bench, no_picture};
use crate::scenes;
use anyhow::{Context, Result};
use renderflow_frame::reach::Reach;
use renderflow_renderer::RenderScene;
use renderflow_scenes::description::TextureWrap;
use renderflow_scenes::load;

/// Measures them.
pub(super) fn measure(bench: &mut Bench<'_>) -> Result<()> {
    let name = "images that something looks at";
    if !bench.wanted(name) {
        return Ok(());
    }
    let mut described =
        scenes::by_name("textured").context("the set has a textured scene")?.describe(bench.options.resolution)?;
    let folder = tempfile::tempdir()?;
    described.write(folder.path())?;
    // As a library of materials has them: as many again, used by nothing. Wrapped otherwise, since equal textures are read once.
    let copies: Vec<_> = described
        .scene
        .materials
        .iter()
        .map(|material| {
            let mut copy = material.clone();
            copy.name += " copy";
            copy.texture_wrap = TextureWrap::Clamp;
            copy
        })
        .collect();
    described.scene.materials.extend(copies);
    let (scene, folder) = (&described.scene, &Reach::folder(folder.path()));
    let settings = bench.settings();
    let cancel = bench.cancel;
    bench.row(
        name,
        "textured",
        (true, "loading, not a picture"),
        || load::load(scene, folder).map(|_| no_picture()).map_err(Into::into),
        || load::load_everything(scene, folder).map(|_| no_picture()).map_err(Into::into),
    )?;
    let [with, without] = [load::load(scene, folder)?, load::load_everything(scene, folder)?];
    let [with, without] = [RenderScene::compile(&with)?, RenderScene::compile(&without)?];
    let picture = |scene: &RenderScene| super::picture(scene, &settings, cancel);
    bench.row(name, "textured", (true, "the picture"), || picture(&with), || picture(&without))
}
