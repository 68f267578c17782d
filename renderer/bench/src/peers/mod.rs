//! `renderflow-bench peers`: the same scenes rendered by turns by this program, Mitsuba 3 and Cycles.
//!
//! Materials are not quite the same in the three (ours is the conserving mode, Mitsuba's the published one, Cycles has a model of
//! its own), so each is measured against a picture of many samples of its own; how far those differ is printed.

pub mod agree;
mod child;
mod contender;
mod reference;
mod report;

use crate::{export, kernels, scenes};
use anyhow::{Context, Result, bail};
use child::{Child, Started};
use clap::Args;
use contender::{Contender, KINDS, Kind, OURS, Shot};
use reference::{Difference, Reference};
use renderflow::util::cancel::Interrupted;
use renderflow::util::progress::Progress;
use renderflow::util::ranges::within;
use renderflow_frame::file;
use renderflow_renderer::Settings as RenderSettings;
use renderflow_scenes::LoadedScene;
use report::{Curve, Named, Row};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

/// The scripts, written beside the results when they are run.
const SCRIPTS: [(&str, &str); 2] =
    [("mitsuba", include_str!("../../scripts/mitsuba.py")), ("cycles", include_str!("../../scripts/cycles.py"))];
/// Name of the results.
const RESULTS: &str = "peers.json";
/// Changes whenever exported scenes or settings do, so that older references and rows are not taken for new ones.
const FORMAT: u32 = 3;

/// Time against error beside Mitsuba 3 and Cycles: the same scenes, rendered by turns, each measured against its own reference.
/// Renderers that are not installed are skipped. Finished pictures and references are kept: run again, it goes on.
#[derive(Args)]
#[command(
    after_help = "Examples:\n  renderflow-bench peers --quick --out peers\n  renderflow-bench peers --mitsuba-python venv-mitsuba/bin/python --cycles-python venv-bpy/bin/python --out peers\n  renderflow-bench peers --scene soft_sun --scene scene.json --only renderflow --only mitsuba-multijitter --out peers\n\ndocs/benchmarks.md says how to install them and what is measured."
)]
pub struct Options {
    /// Scene of the set (`composed` stands for sixteen), scene file or model; may be given several times; otherwise soft_sun,
    /// studio, overcast, textured and million
    #[arg(long, value_name = "NAME|FILE")]
    scene: Vec<String>,
    /// Renderers that take part; may be given several times; otherwise all that are installed
    #[arg(long, value_name = "RENDERER", value_parser = clap::builder::PossibleValuesParser::new(KINDS.map(|k| k.id)))]
    only: Vec<String>,
    /// Pixels along both sides [default: 512]
    #[arg(long, value_parser = clap::value_parser!(u32).range(8..=4096))]
    resolution: Option<u32>,
    /// Samples a pixel of the pictures, separated by commas [default: 4,16,64]
    #[arg(long, value_delimiter = ',', value_parser = clap::value_parser!(u32).range(1..=65536))]
    spp: Vec<u32>,
    /// Pictures of each kind, rendered by turns: median seconds and mean errors are reported [default: 3]
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..))]
    repeats: Option<u32>,
    /// Samples a pixel of references [default: 1024]
    #[arg(long, value_parser = clap::value_parser!(u32).range(8..))]
    reference_spp: Option<u32>,
    /// Scattering events of a path
    #[arg(long, default_value_t = RenderSettings::default().max_bounces, value_parser = within(RenderSettings::MAX_BOUNCES))]
    max_bounces: u32,
    /// Every surface Lambertian, of its base colour: the material models then are the same, and where references still differ
    /// they differ in how light is transported
    #[arg(long)]
    lambertian: bool,
    /// Relative squared error that times are compared at
    #[arg(long, default_value_t = 0.01)]
    target: f64,
    /// 256 x 256 pixels, 4 and 16 samples, once, references of 256, scene soft_sun, unless told otherwise
    #[arg(long)]
    quick: bool,
    #[command(flatten)]
    pythons: Pythons,
    /// Folder for results (peers.json), references, exported scenes and messages of the scripts
    #[arg(long, default_value = "bench-peers")]
    out: PathBuf,
}

/// Where other renderers are.
#[derive(Args)]
struct Pythons {
    /// Python with the package mitsuba [default: RENDERFLOW_MITSUBA_PYTHON, or python3]
    #[arg(long, value_name = "PATH")]
    mitsuba_python: Option<String>,
    /// Python with the package bpy [default: RENDERFLOW_CYCLES_PYTHON, or python3]
    #[arg(long, value_name = "PATH")]
    cycles_python: Option<String>,
}

/// What rows must share to stand in one table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Settings {
    format: u32,
    /// Version of this program.
    version: String,
    /// Pixels along both sides.
    resolution: u32,
    spps: Vec<u32>,
    reference_spp: u32,
    max_bounces: u32,
    /// Of our renderer.
    bsdf: String,
    /// Whether all materials were replaced.
    #[serde(default)]
    lambertian: bool,
    threads: usize,
}

/// The part of the results that a later run goes on from.
#[derive(Serialize, Deserialize)]
struct Measured {
    settings: Settings,
    /// Hash of every scene by name.
    scenes: BTreeMap<String, String>,
    renderers: Vec<Named>,
    rows: Vec<Row>,
    differences: Vec<Difference>,
}

#[derive(Serialize)]
struct Results<'a> {
    #[serde(flatten)]
    measured: &'a Measured,
    target: f64,
    curves: Vec<Curve>,
}

struct Run<'a> {
    options: &'a Options,
    settings: Settings,
    repeats: u32,
    contenders: Vec<Contender>,
    measured: Measured,
    progress: Progress,
    cancel: &'a AtomicBool,
}

impl Pythons {
    /// Starts everything that is chosen; says what is missing. Messages of the scripts go to `out`.
    fn contenders(
        &self,
        chosen: impl Fn(&Kind) -> bool,
        threads: usize,
        out: &Path,
        cancel: &AtomicBool,
    ) -> Result<Vec<Contender>> {
        let mut contenders = Vec::new();
        for kind in KINDS.into_iter().filter(|kind| chosen(kind)) {
            if kind.family == OURS {
                contenders.push(Contender::ours(kind));
                continue;
            }
            let (given, variable) = match kind.family {
                "mitsuba" => (&self.mitsuba_python, "RENDERFLOW_MITSUBA_PYTHON"),
                _ => (&self.cycles_python, "RENDERFLOW_CYCLES_PYTHON"),
            };
            let python = given.clone().or_else(|| std::env::var(variable).ok()).unwrap_or_else(|| "python3".into());
            let text = SCRIPTS.iter().find(|(family, _)| *family == kind.family).map_or("", |(_, text)| text);
            let script = out.join("messages").join(format!("{}.py", kind.family));
            file::write_atomic(&script, text.as_bytes())?;
            let log = out.join("messages").join(format!("{}.txt", kind.id));
            let arguments: Vec<String> = kind.arguments.iter().map(|a| (*a).to_owned()).chain([threads.to_string()]).collect();
            match Child::start(&python, &script, &arguments, &log, cancel)? {
                Started::Ready(child) => {
                    println!("{}: {} {}", kind.id, kind.label, child.version);
                    contenders.push(Contender::other(kind, child, &std::path::absolute(out.join("messages"))?));
                }
                Started::Unavailable(reason) => {
                    println!("skipped {}: {reason} (docs/benchmarks.md says how to install it)", kind.id)
                }
            }
        }
        if contenders.is_empty() {
            bail!("nothing to measure");
        }
        Ok(contenders)
    }
}

impl Options {
    /// Measures and prints.
    pub fn run(self, allowed: &[PathBuf], cancel: &AtomicBool) -> Result<()> {
        let names = match (self.scene.is_empty(), self.quick) {
            (false, _) => scenes::expand(&self.scene),
            (true, true) => vec!["soft_sun".to_owned()],
            (true, false) => ["soft_sun", "studio", "overcast", "textured", "million"].map(str::to_owned).into(),
        };
        let pick = |given: Option<u32>, quick, full| given.unwrap_or(if self.quick { quick } else { full });
        let mut spps = match (self.spp.is_empty(), self.quick) {
            (false, _) => self.spp.clone(),
            (true, true) => vec![4, 16],
            (true, false) => vec![4, 16, 64],
        };
        spps.sort_unstable();
        spps.dedup();
        if !(self.target > 0.0 && self.target.is_finite()) {
            bail!("--target {}: an error is a positive number", self.target);
        }
        let settings = Settings {
            format: FORMAT,
            version: env!("CARGO_PKG_VERSION").into(),
            resolution: pick(self.resolution, 256, 512),
            spps,
            reference_spp: pick(self.reference_spp, 256, 1024),
            max_bounces: self.max_bounces,
            bsdf: renderflow_renderer::Mode::Conserving.name().into(),
            lambertian: self.lambertian,
            threads: rayon::current_num_threads(),
        };
        let repeats = pick(self.repeats, 1, 3);
        for folder in ["references", "scenes", "messages"] {
            let path = self.out.join(folder);
            std::fs::create_dir_all(&path).with_context(|| path.display().to_string())?;
        }
        if let Some(load) = kernels::load().filter(|load| *load > 0.5) {
            println!("note: the machine is not idle (load {load:.1}): wall times say little");
        }
        names.iter().try_for_each(|name| scenes::exists(name))?;
        let chosen = |kind: &Kind| self.only.is_empty() || self.only.iter().any(|id| id == kind.id);
        let contenders = self.pythons.contenders(chosen, settings.threads, &self.out, cancel)?;
        let measured = self.earlier(&settings);
        // Weighed by samples: references once, every picture of `repeats` twice as a guess of what warming up takes.
        let pictures: u32 = settings.spps.iter().sum();
        let references = contenders.iter().map(|c| c.kind.family).collect::<BTreeSet<_>>().len() as u64;
        let of_scene = references * u64::from(settings.reference_spp.next_multiple_of(8))
            + contenders.len() as u64 * u64::from(repeats + 1) * u64::from(pictures);
        let progress = Progress::new("peers", names.len() as u64 * of_scene);
        let mut run = Run { options: &self, settings, repeats, contenders, measured, progress, cancel };
        let bsdf = if run.settings.lambertian { "Lambertian" } else { &run.settings.bsdf };
        println!("ours: {bsdf} BRDF; the beauty alone, as the others");
        for (index, name) in names.iter().enumerate() {
            run.progress.set(index as u64 * of_scene);
            run.scene(scenes::open(name, Some(run.settings.resolution), allowed)?)?;
        }
        run.progress.finish();
        let curves: Vec<Curve> = run.measured.scenes.keys().flat_map(|scene| run.curves(scene)).collect();
        print!("{}", report::summary(&curves, &run.measured.renderers));
        println!("\nresults: {}", self.out.join(RESULTS).display());
        Ok(())
    }

    /// Results of an earlier run at these settings, or none.
    fn earlier(&self, settings: &Settings) -> Measured {
        let path = self.out.join(RESULTS);
        let none = || Measured {
            settings: settings.clone(),
            scenes: BTreeMap::new(),
            renderers: Vec::new(),
            rows: Vec::new(),
            differences: Vec::new(),
        };
        match file::read_json::<Measured>(&path) {
            Ok(earlier) if earlier.settings == *settings => earlier,
            Ok(_) => {
                println!("note: {} is of other settings and will be replaced", path.display());
                none()
            }
            Err(_) => none(),
        }
    }
}

impl Run<'_> {
    fn scene(&mut self, subject: scenes::Subject) -> Result<()> {
        let scenes::Subject { name, mut loaded } = subject;
        if self.settings.lambertian {
            loaded.materials.iter_mut().for_each(export::make_lambertian);
        }
        if self.measured.scenes.insert(name.clone(), loaded.hash.clone()).is_some_and(|hash| hash != loaded.hash) {
            self.measured.rows.retain(|row| row.scene != name);
        }
        self.progress.message(format!("{name}: loading"));
        let folder = std::path::absolute(self.options.out.join("scenes").join(&name))?;
        let exported = export::write(&loaded, self.settings.max_bounces, &folder)?;
        self.each("load", |c, run| {
            let notes = c.load(&loaded, &exported, run.cancel)?;
            notes.iter().for_each(|note| run.progress.hide(|| println!("note: {name}, {}: {note}", c.kind.id)));
            Ok(())
        })?;
        let references = self.references(&name, &loaded)?;
        self.remember();
        self.rounds(&name, &references)?;
        self.measured.differences.retain(|d| d.scene != name);
        let families: Vec<&str> = KINDS.iter().map(|k| k.family).filter(|f| references.contains_key(f)).collect();
        let mut families = families;
        families.dedup();
        for (index, of) in families.iter().enumerate() {
            for other in &families[index + 1..] {
                let difference = references[of].difference(&references[other], &name, [of, other])?;
                self.measured.differences.push(difference);
            }
        }
        self.save()?;
        let triangles: usize = loaded.instances.iter().map(|i| loaded.meshes[i.mesh].triangles.len()).sum();
        let size = self.settings.resolution;
        let title = format!("{name}: {size} x {size} pixels, {triangles} triangles, {} threads", self.settings.threads);
        let differences: Vec<Difference> = self.measured.differences.iter().filter(|d| d.scene == name).cloned().collect();
        let text = report::table(&title, &self.curves(&name), &self.measured.renderers, &differences, self.options.target);
        self.progress.hide(|| print!("{text}"));
        Ok(())
    }

    fn shot(&self) -> Shot {
        Shot { size: [self.settings.resolution as usize; 2], max_bounces: self.settings.max_bounces }
    }

    fn curves(&self, scene: &str) -> Vec<Curve> {
        let Settings { resolution, threads, .. } = self.settings;
        let pixels = (resolution as usize).pow(2);
        report::curves(scene, pixels, &self.measured.rows, &self.measured.renderers, self.options.target, threads)
    }

    /// Does something with every renderer; one that fails is left out from there on, with a message.
    fn each(&mut self, what: &str, mut f: impl FnMut(&mut Contender, &Self) -> Result<()>) -> Result<()> {
        let mut failed = Vec::new();
        let mut contenders = std::mem::take(&mut self.contenders);
        for contender in &mut contenders {
            match f(contender, self) {
                Err(error) if error.is::<Interrupted>() || contender.kind.family == OURS => {
                    return Err(error).with_context(|| format!("{}: {what}", contender.kind.id));
                }
                Err(error) => {
                    let id = contender.kind.id;
                    self.progress.hide(|| {
                        println!(
                            "left out {id}: {what}: {} (see {}/messages)",
                            renderflow::util::console::message(&error),
                            self.options.out.display()
                        )
                    });
                    failed.push(id);
                }
                Ok(()) => {}
            }
        }
        contenders.retain(|c| !failed.contains(&c.kind.id));
        self.contenders = contenders;
        Ok(())
    }

    /// One reference a family.
    fn references(&mut self, name: &str, scene: &LoadedScene) -> Result<BTreeMap<&'static str, Reference>> {
        let mut references = BTreeMap::new();
        let Settings { resolution, reference_spp, max_bounces, .. } = self.settings;
        let shot = self.shot();
        self.each("reference", |contender, run| {
            let family = contender.kind.family;
            if references.contains_key(family) {
                return Ok(());
            }
            run.progress.message(format!("{name}: reference of {family}"));
            let materials = if scene.materials.iter().any(export::is_lambertian) { " lambertian" } else { "" };
            let key = format!("{FORMAT} {} {max_bounces} {}{materials}", scene.hash, contender.version);
            let key = blake3::hash(key.as_bytes()).to_hex();
            let file = format!("{name}-{family}-{resolution}-{reference_spp}-{}.f32", &key.as_str()[..12]);
            let path = run.options.out.join("references").join(file);
            let step = |samples: u32| run.progress.add(u64::from(samples));
            let reference = Reference::get(&path, contender, reference_spp, &shot, &step, run.cancel)?;
            references.insert(family, reference);
            Ok(())
        })?;
        Ok(references)
    }

    /// Lists who takes part among the renderers of the results.
    fn remember(&mut self) {
        for contender in &self.contenders {
            let Kind { id, label, family, .. } = contender.kind;
            let (id, label, family) = (id.to_owned(), label.to_owned(), family.to_owned());
            let named = Named { id, label, version: contender.version.clone(), family };
            match self.measured.renderers.iter_mut().find(|r| r.id == named.id) {
                Some(known) if *known == named => {}
                Some(known) => {
                    // Of another version: its rows would be compared with a reference of this one.
                    self.measured.rows.retain(|row| row.renderer != named.id);
                    *known = named;
                }
                None => self.measured.renderers.push(named),
            }
        }
    }

    /// Renders what is missing, every renderer in its turn.
    fn rounds(&mut self, name: &str, references: &BTreeMap<&'static str, Reference>) -> Result<()> {
        let (shot, spps) = (self.shot(), self.settings.spps.clone());
        let mut warm = false;
        for repeat in 0..self.repeats {
            for &spp in &spps {
                let done = |rows: &[Row], id: &str| {
                    rows.iter().any(|r| r.scene == name && r.renderer == id && r.repeat == repeat && r.spp == spp)
                };
                if self.contenders.iter().all(|c| done(&self.measured.rows, c.kind.id)) {
                    self.progress.resume(u64::from(spp) * self.contenders.len() as u64);
                    continue;
                }
                if !warm {
                    self.progress.message(format!("{name}: warming up"));
                    self.each("warming up", |c, run| c.warm(&spps, &shot, run.cancel))?;
                    self.progress.add(u64::from(spps.iter().sum::<u32>()) * self.contenders.len() as u64);
                    warm = true;
                }
                // Those that have a picture already render it again, so that what is compared was measured side by side.
                let here: Vec<&str> = self.contenders.iter().map(|c| c.kind.id).collect();
                self.measured
                    .rows
                    .retain(|r| !(r.scene == name && r.repeat == repeat && r.spp == spp && here.contains(&&*r.renderer)));
                let mut rows = Vec::new();
                self.each("rendering", |contender, run| {
                    run.progress.message(format!(
                        "{name}: {} at {spp} spp, {} of {}",
                        contender.kind.id,
                        repeat + 1,
                        run.repeats
                    ));
                    let (picture, time) = contender.render(spp, u64::from(repeat) + 1, &shot, run.cancel)?;
                    let reference = references.get(contender.kind.family).context("without a reference")?;
                    let error = reference.error(&picture)?;
                    run.progress.add(u64::from(spp));
                    let (scene, renderer) = (name.to_owned(), contender.kind.id.to_owned());
                    rows.push(Row { scene, renderer, repeat, spp, wall: time.seconds, cpu: time.cpu(), error });
                    Ok(())
                })?;
                self.measured.rows.extend(rows);
                self.save()?;
                if self.cancel.load(Ordering::Relaxed) {
                    return Err(Interrupted.into());
                }
            }
        }
        Ok(())
    }

    fn save(&self) -> Result<()> {
        let curves = self.measured.scenes.keys().flat_map(|scene| self.curves(scene)).collect();
        let results = Results { measured: &self.measured, target: self.options.target, curves };
        Ok(file::write_json(&self.options.out.join(RESULTS), &results)?)
    }
}
