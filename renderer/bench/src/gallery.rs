//! `renderflow-bench gallery`: models as the program shows them, on one labelled sheet.

use anyhow::{Context, Result, bail};
use clap::Args;
use renderflow::dataset::contact;
use renderflow::dataset::denoise::Denoise;
use renderflow::dataset::job::TruthSettings;
use renderflow::util::cancel::Cancel;
use renderflow::util::picture;
use renderflow::util::progress::Progress;
use renderflow::util::sheet::{self, Tile};
use renderflow_frame::file;
use renderflow_frame::image::Rgb;
use renderflow_frame::reach::Reach;
use renderflow_renderer::{RenderScene, Settings};
use renderflow_scenes::load::{self, Format, ModelView};
use std::path::{Path, PathBuf};

/// Models as `renderflow render` shows them, on one labelled sheet. A model that cannot be read is left out with a message.
#[derive(Args)]
#[command(after_help = "Example: renderflow-bench gallery models/*.glb assets/gltf --out models.png")]
pub struct Options {
    /// Models, and folders that are searched for models
    #[arg(required = true, value_name = "FILE|FOLDER")]
    models: Vec<PathBuf>,
    /// Pixels along both sides of a picture
    #[arg(long, default_value_t = 256, value_parser = clap::value_parser!(u32).range(16..=2048))]
    size: u32,
    /// Samples a pixel
    #[arg(long, default_value_t = Settings::default().spp, value_parser = clap::value_parser!(u32).range(1..))]
    spp: u32,
    /// Pictures in a row
    #[arg(long, default_value_t = 6, value_parser = clap::value_parser!(u32).range(1..=64))]
    columns: u32,
    /// The sheet
    #[arg(long, default_value = "models.png")]
    out: PathBuf,
}

impl Options {
    /// Renders and writes.
    pub fn run(self, allowed: &[PathBuf], cancel: &Cancel) -> Result<()> {
        let mut models = Vec::new();
        for path in &self.models {
            let before = models.len();
            find(path, &mut models)?;
            models[before..].sort();
        }
        let progress = Progress::new("gallery", models.len() as u64);
        let settings = TruthSettings::quiet(Settings { spp: self.spp, ..Settings::default() }, Denoise::Auto)?;
        let mut tiles = Vec::new();
        for path in &models {
            progress.message(path.display().to_string());
            cancel.check()?;
            match self.picture(path, &settings, allowed, cancel) {
                Ok(made) => {
                    let name = path.file_stem().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
                    tiles.push(Tile::new(name, made));
                }
                Err(error) if error.is::<renderflow::util::cancel::Interrupted>() => return Err(error),
                Err(error) => progress.hide(|| println!("left out: {}", renderflow::util::console::message(&error))),
            }
            progress.add(1);
        }
        progress.finish();
        if tiles.is_empty() {
            bail!("there is no model to show");
        }
        file::write_atomic(&self.out, &picture::png(&sheet::sheet(&tiles, self.columns as usize))?)?;
        println!("{}: {} of {} models", self.out.display(), tiles.len(), models.len());
        Ok(())
    }

    fn picture(&self, path: &Path, settings: &TruthSettings, allowed: &[PathBuf], cancel: &Cancel) -> Result<Rgb> {
        let reach = Reach::of(path).allow(allowed);
        let view = ModelView { resolution: [self.size; 2], frames: 1, ..ModelView::default() };
        let scene = load::describe_model(path, None, &view, &reach)?;
        let compiled = RenderScene::compile(&load::load(&scene, &reach)?)?;
        let (frame, _) = settings.frame(&compiled, &|_, _| (), cancel)?;
        contact::display(&frame).context("no picture")
    }
}

/// Adds the model at `path`, or the models in that folder and in those below it.
fn find(path: &Path, models: &mut Vec<PathBuf>) -> Result<()> {
    if !path.is_dir() {
        if Format::of(path).is_none() {
            bail!("{}: neither a folder nor a model (glTF or OBJ)", path.display());
        }
        models.push(path.to_owned());
        return Ok(());
    }
    for entry in std::fs::read_dir(path).with_context(|| path.display().to_string())? {
        let path = entry?.path();
        if path.is_dir() || Format::of(&path).is_some() {
            find(&path, models)?;
        }
    }
    Ok(())
}
