//! `renderflow-bench skip`: what every skip saves, and that it does not show.

mod load;
mod sequence;

use super::{Machine, scenes};
use anyhow::{Context, Result, bail};
use clap::Args;
use renderflow::metrics::median;
use renderflow::metrics::relmse::relmse;
use renderflow::util::cancel::Interrupted;
use renderflow::util::clock::{Spent, Stopwatch};
use renderflow_frame::image::Rgb;
use renderflow_frame::{Environment, file};
use renderflow_renderer::{Channels, RenderScene, Settings, Skips, render_gbuffer, render_with_stats};
use renderflow_scenes::LoadedScene;
use serde::Serialize;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};

/// Renders with each skip on and off in turn, and compares time and pictures. Writes skip.json and prints a table.
#[derive(Args)]
#[command(after_help = "Example: renderflow-bench skip --out bench")]
pub struct Options {
    /// Only rows with this in their name; may be given several times
    #[arg(long, value_name = "TEXT")]
    only: Vec<String>,
    /// Pixels along both sides
    #[arg(long, default_value_t = 256, value_parser = clap::value_parser!(u32).range(16..=4096))]
    resolution: u32,
    /// Samples a pixel
    #[arg(long, default_value_t = 32, value_parser = clap::value_parser!(u32).range(1..=1 << 20))]
    spp: u32,
    /// Pictures with and without; medians are shown
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    repeats: u32,
    /// Folder for the results
    #[arg(long, default_value = "bench")]
    out: PathBuf,
}

/// The JSON file.
#[derive(Serialize)]
struct Results {
    machine: Machine,
    resolution: u32,
    spp: u32,
    repeats: u32,
    rows: Vec<Row>,
}

/// One skip.
#[derive(Serialize)]
struct Row {
    name: String,
    scene: String,
    /// Medians with the skip, and without.
    with: Spent,
    without: Spent,
    /// Without over with.
    ratio: f64,
    /// The same of processor seconds.
    processor_ratio: Option<f64>,
    /// Whether the two pictures should be the same to the bit; otherwise they differ by rounding or, where `note` says so, by
    /// noise.
    exact: bool,
    /// Largest difference of a value of the two pictures.
    difference: f64,
    /// relMSE of the picture with the skip against that without.
    relmse: f64,
    /// What the ratio is of, where it is not the rendering of a picture.
    note: &'static str,
}

/// What one way of doing something makes, to be compared with what the other makes.
type Picture = Rgb;

/// Measures rows.
struct Bench<'a> {
    options: &'a Options,
    cancel: &'a AtomicBool,
    rows: Vec<Row>,
}

impl Options {
    /// Measures all rows.
    pub fn run(self, cancel: &AtomicBool) -> Result<()> {
        let mut bench = Bench { options: &self, cancel, rows: Vec::new() };
        println!("{}", heading());
        bench.pictures()?;
        sequence::measure(&mut bench)?;
        load::measure(&mut bench)?;
        let (resolution, spp, repeats) = (self.resolution, self.spp, self.repeats);
        let results = Results { machine: Machine::current(), resolution, spp, repeats, rows: bench.rows };
        let path = self.out.join("skip.json");
        file::write_json(&path, &results)?;
        println!("{}", path.display());
        let shows: Vec<_> = results.rows.iter().filter(|row| row.exact && row.difference != 0.0).map(|row| &*row.name).collect();
        if !shows.is_empty() {
            bail!("what should leave the picture as it is changes it: {}", shows.join(", "));
        }
        Ok(())
    }
}

impl Bench<'_> {
    fn wanted(&self, name: &str) -> bool {
        self.options.only.is_empty() || self.options.only.iter().any(|text| name.contains(text.as_str()))
    }

    fn settings(&self) -> Settings {
        Settings { spp: self.options.spp, ..Settings::default() }
    }

    fn scene(&self, name: &str) -> Result<LoadedScene> {
        Ok(scenes::open(name, Some(self.options.resolution), &[])?.loaded)
    }

    /// Measures a row: both ways in turn, after one of each for nothing.
    fn row(
        &mut self,
        name: &str,
        scene: &str,
        (exact, note): (bool, &'static str),
        mut with: impl FnMut() -> Result<Picture>,
        mut without: impl FnMut() -> Result<Picture>,
    ) -> Result<()> {
        if !self.wanted(name) {
            return Ok(());
        }
        let (picture, other) = (with()?, without()?);
        let mut spent: [Vec<Spent>; 2] = Default::default();
        for repeat in 0..self.options.repeats as usize {
            // The other way round every time, so that neither always comes after the other.
            for way in [repeat % 2, 1 - repeat % 2] {
                let clock = Stopwatch::start();
                if way == 0 { with() } else { without() }?;
                spent[way].push(clock.spent());
                if self.cancel.load(Ordering::Relaxed) {
                    return Err(Interrupted.into());
                }
            }
        }
        let [with, without] = spent.map(|list| Spent {
            seconds: median(&list.iter().map(|s| s.seconds).collect::<Vec<_>>()),
            processor: list.iter().map(|s| s.processor).collect::<Option<Vec<_>>>().map(|list| median(&list)),
        });
        let differences = picture.pixels.iter().flatten().zip(other.pixels.iter().flatten()).map(|(a, b)| f64::from(a - b).abs());
        let row = Row {
            name: name.into(),
            scene: scene.into(),
            with,
            without,
            ratio: without.seconds / with.seconds,
            processor_ratio: without.processor.zip(with.processor).map(|(a, b)| a / b),
            exact,
            difference: differences.fold(0.0, f64::max),
            relmse: relmse(&picture, &other, None)?.mean,
            note,
        };
        println!("{}", line(&row));
        self.rows.push(row);
        Ok(())
    }

    /// A row of one switch on one scene.
    fn switch(
        &mut self,
        name: &str,
        scene: &str,
        loaded: &LoadedScene,
        (exact, note): (bool, &'static str),
        off: fn(&mut Settings),
    ) -> Result<()> {
        if !self.wanted(name) {
            return Ok(());
        }
        let compiled = RenderScene::compile(loaded)?;
        let on = self.settings();
        let mut without = on;
        off(&mut without);
        let cancel = self.cancel;
        let (with, without) = (|| picture(&compiled, &on, cancel), || picture(&compiled, &without, cancel));
        self.row(name, scene, (exact, note), with, without)
    }

    fn pictures(&mut self) -> Result<()> {
        let exact = (true, "");
        let soft_sun = self.scene("soft_sun")?;
        self.switch("compiled feature set", "soft_sun", &soft_sun, (false, "by rounding"), |s| s.skips.feature_sets = false)?;
        self.switch("pixels that see the sky only", "forest", &self.scene("forest")?, exact, |s| {
            s.skips.environment_pixels = false
        })?;
        let ball = lonely(&soft_sun);
        self.switch("pixels that see the sky only", "one ball", &ball, exact, |s| s.skips.environment_pixels = false)?;
        let guides = (true, "against a second pass of camera rays");
        self.switch("guides of the beauty's samples", "soft_sun", &soft_sun, guides, |s| s.skips.shared_guides = false)?;
        let shadows = |s: &mut Settings| s.skips.zero_contributions = false;
        self.switch("no shadow ray for nothing", "soft_sun", &soft_sun, exact, shadows)?;
        self.switch("no shadow ray for nothing", "interior", &self.scene("interior")?, exact, shadows)?;
        self.switch("no light sample of a black surface", "black", &black(&soft_sun), exact, |s| s.skips.black_surfaces = false)?;
        let any = |s: &mut Settings| s.skips.last_any_hit = false;
        self.switch("last ray asks for any hit", "soft_sun", &soft_sun, exact, any)?;
        let short = |s: &mut Settings| (s.max_bounces, s.skips.last_any_hit) = (1, false);
        if self.wanted("last ray asks for any hit") {
            let compiled = RenderScene::compile(&soft_sun)?;
            let on = Settings { max_bounces: 1, ..self.settings() };
            let mut off = on;
            short(&mut off);
            let cancel = self.cancel;
            let (with, without) = (|| picture(&compiled, &on, cancel), || picture(&compiled, &off, cancel));
            self.row("last ray asks for any hit", "soft_sun", (true, "direct light only"), with, without)?;
        }
        let dark = LoadedScene { environment: Environment::constant([0.0; 3]), ..soft_sun.clone() };
        self.switch("no paths without light", "no light", &dark, exact, |s| s.skips.dark_scenes = false)?;
        let flat = LoadedScene { environment: Environment::constant([0.7; 3]), ..soft_sun.clone() };
        let noise = (false, "both are noisy, this one less");
        self.switch("flat sky is not sampled", "flat sky", &flat, noise, |s| s.skips.flat_environment = false)?;
        for name in ["soft_sun", "forest", "textured"] {
            self.plain_pixels(name)?;
        }
        let few = "one sample a pixel, against all channels";
        self.channels("beauty alone", &soft_sun, few, Channels::BEAUTY)?;
        self.channels("beauty and guides", &soft_sun, few, Channels { guides: true, ..Channels::BEAUTY })?;
        self.channels("all but motion", &soft_sun, few, Channels { motion: false, ..Channels::ALL })?;
        self.irradiance(&soft_sun)
    }

    /// A row of the guides of a G-buffer; the picture compared is their albedo.
    fn plain_pixels(&mut self, scene: &str) -> Result<()> {
        let name = "plain pixels without guide rays";
        if !self.wanted(name) {
            return Ok(());
        }
        let compiled = RenderScene::compile(&self.scene(scene)?)?;
        let gbuffer = |plain_pixels| {
            let skips = Skips { plain_pixels, ..Skips::ALL };
            let frame = render_gbuffer(&compiled, &Settings { skips, ..Settings::default() })?;
            frame.guide_albedo.context("the G-buffer has no guides")
        };
        self.row(name, scene, (false, "G-buffer of 16 rays; albedo"), || gbuffer(true), || gbuffer(false))
    }

    /// A row of a frame of few samples with some channels against all.
    fn channels(&mut self, name: &str, loaded: &LoadedScene, note: &'static str, channels: Channels) -> Result<()> {
        let compiled = RenderScene::compile(loaded)?;
        let all = Settings { spp: 1, ..self.settings() };
        let some = Settings { channels, ..all };
        let cancel = self.cancel;
        self.row(name, "soft_sun", (true, note), || picture(&compiled, &some, cancel), || picture(&compiled, &all, cancel))
    }

    /// A row of the irradiance table alone against all tables of the split sum.
    fn irradiance(&mut self, loaded: &LoadedScene) -> Result<()> {
        let environment = &loaded.environment;
        self.row(
            "irradiance without other tables",
            "soft_sun",
            (true, "the tables, not a picture"),
            || Ok(renderflow_frame::ibl::irradiance_map(environment).map),
            || Ok(renderflow_frame::ibl::IblTables::new(environment).irradiance_map.map),
        )
    }
}

/// The raw picture of the current frame.
fn picture(scene: &RenderScene, settings: &Settings, cancel: &AtomicBool) -> Result<Picture> {
    let rendered = render_with_stats(scene, settings, &|_, _| (), cancel);
    if cancel.load(Ordering::Relaxed) {
        return Err(Interrupted.into());
    }
    rendered?.0.raw.context("nothing was rendered")
}

/// One ball of the scene, and nothing else: most pixels see the sky.
fn lonely(loaded: &LoadedScene) -> LoadedScene {
    let mut scene = loaded.clone();
    scene.instances.retain(|instance| instance.name == "sphere_gold");
    scene
}

/// The scene with everything but the ground black.
fn black(loaded: &LoadedScene) -> LoadedScene {
    let mut scene = loaded.clone();
    for material in scene.materials.iter_mut().filter(|material| material.name != "ground") {
        (material.surface.base_color, material.surface.specular, material.surface.metallic) = (glam::Vec3A::ZERO, 0.0, 0.0);
    }
    scene
}

fn heading() -> String {
    format!(
        "{:36}  {:10}  {:>9}  {:>9}  {:>7}  {:>7}  {:>8}  {:>8}  note",
        "skip", "scene", "with", "without", "ratio", "cpu", "largest", "relMSE"
    )
}

fn line(row: &Row) -> String {
    let time = |seconds: f64| if seconds < 0.1 { format!("{:.2} ms", 1e3 * seconds) } else { format!("{seconds:.3} s") };
    let error = |v: f64| if v == 0.0 { "0".to_owned() } else { format!("{v:.1e}") };
    let cpu = row.processor_ratio.map_or_else(|| "-".into(), |r| format!("{r:.3}"));
    let difference = [error(row.difference), error(row.relmse)];
    format!(
        "{:36}  {:10}  {:>9}  {:>9}  {:>7.3}  {cpu:>7}  {:>8}  {:>8}  {}",
        row.name,
        row.scene,
        time(row.with.seconds),
        time(row.without.seconds),
        row.ratio,
        difference[0],
        difference[1],
        row.note
    )
}

/// For pictures that no two ways make: compares as equal.
fn no_picture() -> Picture {
    Rgb::filled(1, 1, [0.0; 3])
}
