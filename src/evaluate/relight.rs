//! `renderflow evaluate relight`: a picture is inverted, the light turns, and what the buffers show under it is compared with
//! path tracing.

use super::find;
use super::inverter::{Inverter, WanOptions, image, unit};
use super::{run, shell};
use crate::dataset::Sequence;
use crate::dataset::denoise::Denoise;
use crate::dataset::job::{SequenceJob, TruthSettings};
use crate::dataset::layout::SCENE;
use crate::metrics::bootstrap::{Interval, bootstrap};
use crate::metrics::intrinsics::Buffers;
use crate::metrics::{METRICS, Networks, Truth, values};
use crate::util::cancel::Cancel;
use crate::util::device::{DeviceArgs, recorded};
use crate::util::output::Claim;
use crate::util::picture;
use crate::util::progress::Progress;
use crate::util::ranges::within;
use crate::util::sheet::{Tile, sheet};
use crate::util::text::plural;
use crate::util::weights::digests;
use anyhow::{Context, Result, ensure};
use clap::Args;
use renderflow_frame::color::{display, srgb_to_linear};
use renderflow_frame::frame_file::Profile;
use renderflow_frame::image::Rgb;
use renderflow_frame::reach::Reach;
use renderflow_frame::{DepthBounds, Frame, Image, Light, file, ibl};
use renderflow_model::inverse::InverseNet;
use renderflow_model::wan::flow::Intrinsic;
use renderflow_model::wan::pictures::{EnvironmentView, Pictures};
use renderflow_renderer::Settings;
use renderflow_renderer::denoise::{self, Denoiser};
use renderflow_scenes::description::Scene;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The file that says what the pictures in a folder show.
const RECORD: &str = "relight.json";
/// The metrics of the table.
const SHOWN: [&str; 4] = ["psnr", "ssim_object", "lpips_alex", "flip_object"];
/// Rows of the table.
const ROWS: [&str; 8] = [
    "network",
    "network, ratio",
    "network, traced",
    "network, ratio traced",
    "true buffers",
    "true buffers, traced",
    "no network",
    "the old picture",
];
/// Display-linear light that is added to both sides of a ratio, so that a surface which is black under one light does not glow
/// under the other.
const LEAST: f32 = 0.02;
/// Most that a ratio brightens.
const MOST: f32 = 16.0;

/// Invert pictures, turn their light, and compare with path tracing under the turned light
///
/// The first frame of each sequence is inverted. Then the environment turns about the vertical, and the buffers are shaded under
/// it with the split sum. The truth is path-traced with the turned environment. Another row multiplies the picture by the ratio
/// of the buffers' shading under the new and the old light, which must be known for it. The rows `traced` path-trace the surfaces
/// that the picture shows, so that they cast shadows on each other. Beside them stand the true buffers, which show what shading
/// costs, the picture itself as albedo of surfaces that face the camera, and the picture as it was. The command writes
/// relight.json and pictures, and prints a table.
#[derive(Args)]
#[command(after_help = "Example:\n  renderflow evaluate relight --data data -o results-relight")]
pub struct Options {
    /// Weights of the inverse network, or of the paper's network with an inverse adapter; the file says which. Without it, the
    /// weights inside the program are used
    #[arg(long)]
    weights: Option<PathBuf>,
    /// Weights of the autoencoder of the paper's network; vae.safetensors beside --weights without it
    #[arg(long, requires = "weights")]
    vae: Option<PathBuf>,
    #[command(flatten)]
    device: DeviceArgs,
    /// Test sets, a dataset, a split of it, or one sequence. Each sequence needs its scene.json
    #[arg(long)]
    data: PathBuf,
    /// Degrees that the environment turns
    #[arg(long, default_value_t = 120.0, allow_hyphen_values = true)]
    turn: f32,
    /// Samples for each pixel of the truth and of the traced surfaces
    #[arg(long, default_value_t = 64, value_parser = within(Settings::SPP))]
    spp: u32,
    /// Folder for the truth, the pictures and the results
    #[arg(long, short = 'o', default_value = "results-relight")]
    out: PathBuf,
    /// Print the table as JSON
    #[arg(long)]
    json: bool,
}

/// What decides the truth.
#[derive(PartialEq, Serialize, Deserialize)]
struct About {
    about: String,
    turn: f32,
    spp: u32,
}

/// What decides the results. It is written into the folder, so that no other results take their place.
#[derive(Clone, PartialEq, Serialize, Deserialize)]
struct Record {
    about: String,
    turn: f32,
    spp: u32,
    /// BLAKE3 of the weights, which are in files or inside the program. Older programs recorded none.
    #[serde(default)]
    weights: Vec<String>,
    /// BLAKE3 of what was read of each sequence, by set, class and name. Older programs recorded none.
    #[serde(default)]
    data: BTreeMap<String, String>,
    /// Device of the network; `None` for the processor.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    device: Option<String>,
}

impl Record {
    /// Whether what is asked for is `there`, or that and more sequences.
    fn continues(&self, there: &Self) -> bool {
        let known = there.data.iter().all(|(place, digest)| self.data.get(place) == Some(digest));
        known && *there == Self { data: there.data.clone(), ..self.clone() }
    }
}

/// Errors of one kind of buffers.
#[derive(Serialize)]
struct Row {
    buffers: &'static str,
    /// Means by metric.
    values: BTreeMap<String, Interval>,
}

#[derive(Serialize)]
struct Results {
    #[serde(flatten)]
    record: Record,
    sequences: usize,
    rows: Vec<Row>,
}

impl Options {
    /// Renders, measures and prints.
    pub fn run(self, allowed: &[PathBuf], cancel: &Cancel) -> Result<()> {
        ensure!(self.turn.is_finite(), "--turn: {} is not a number of degrees", self.turn);
        let options = WanOptions { vae: self.vae.as_deref(), tile: None };
        let device = self.device.open()?;
        let network = Inverter::open(self.weights.as_deref(), options, &device)?;
        let tests = find::find(&self.data)?;
        for test in &tests {
            let file = test.sequence.folder.join(SCENE);
            ensure!(file.is_file(), "{}: is missing; the scene is rendered under another light", file.display());
            // The truth is rendered of frame 0, and must show what the picture shows.
            let (folder, first) = (test.sequence.folder.display(), test.sequence.numbers.first());
            ensure!(first == Some(&0), "{folder}: frame 0 is missing; it is the one that is inverted and rendered again");
        }
        let settings = TruthSettings::quiet(Settings { spp: self.spp, ..Settings::default() }, Denoise::Auto)?;
        let (about, turn, spp) = ("truth under another light".to_owned(), self.turn, self.spp);
        let record = Record {
            about: about.clone(),
            turn,
            spp,
            weights: digests::<InverseNet>(self.weights.as_deref(), self.vae.as_deref())?,
            data: run::digests(&tests, |_| vec![0], cancel)?,
            device: recorded(&device),
        };
        let truth = Claim::new(&self.out.join("truth"), RECORD, &About { about, turn, spp }, "pictures of another light")?;
        let mut same = false;
        let claim = Claim::agreed(&self.out, RECORD, &record, |there: &Record| {
            same = *there == record;
            ensure!(record.continues(there), "the folder holds results of other weights, data or devices; choose another folder");
            Ok(())
        })?;
        // Results of the same sequences stay until there are new ones.
        if !same {
            claim.write()?;
        }
        truth.write()?;
        let lpips = Networks::find()?;
        let mut tracer = Tracer { spp: self.spp, denoiser: Denoiser::with_options(denoise::Options::default()).ok(), cancel };

        let progress = Progress::new("relight", 1000 * tests.len() as u64);
        let mut found = Vec::new();
        for test in &tests {
            let name = Path::new(&test.set).join(&test.class).join(&test.sequence.name);
            progress.message(name.display().to_string());
            let measured = self.truth(&test.sequence, &name, allowed, &settings, &progress, cancel).and_then(|turned| {
                let Shown { pictures, truth, alpha } = Shown::new(&test.sequence, &turned, &network, &mut tracer)?;
                let all = ROWS.iter().zip(&pictures).chain(std::iter::once((&"truth", &truth)));
                let tiles: Vec<Tile> = all.map(|(name, picture)| Tile::new(*name, picture.clone())).collect();
                // Not `with_extension`: names with points would lose what follows the last one, and two could become one.
                let path = self.out.join(&test.set).join(&test.class).join(format!("{}.png", test.sequence.name));
                std::fs::create_dir_all(path.parent().unwrap_or(&self.out))?;
                file::write_atomic(&path, &picture::png(&sheet(&tiles, tiles.len()))?)?;
                let measured = Truth::new(&truth, Some(&alpha), None, &lpips)?;
                pictures.iter().map(|picture| values(&measured.measure(picture, None)?)).collect::<Result<Vec<_>>>()
            });
            found.push(measured.with_context(|| test.sequence.folder.display().to_string())?);
        }
        progress.finish();
        let results = Results { record, sequences: found.len(), rows: rows(&found) };
        let path = self.out.join(RECORD);
        file::write_json(&path, &results)?;
        if self.json {
            println!("{}", serde_json::to_string_pretty(&results)?);
        } else {
            print(&results);
            println!("{}", path.display());
        }
        Ok(())
    }

    /// The first frame of a sequence, path-traced under the turned environment into the folder `name` of the truth. It is read
    /// where it is there already.
    fn truth(
        &self,
        sequence: &Sequence,
        name: &Path,
        allowed: &[PathBuf],
        settings: &TruthSettings,
        progress: &Progress,
        cancel: &Cancel,
    ) -> Result<Sequence> {
        let path = sequence.folder.join(SCENE);
        let mut scene: Scene = file::read_json(&path)?;
        scene.environment.rotation += self.turn;
        let job = SequenceJob {
            scene,
            base: Reach::of(&path).allow(allowed),
            out: self.out.join("truth").join(name),
            keyframe_gap: 0,
            // Only the first frame.
            frame_step: u32::MAX,
            storage: Profile::Full,
        };
        let mut open = job.open()?;
        let work = open.decide(settings, None)?;
        open.make(&work, settings, progress, cancel)?;
        Sequence::open(&job.out)
    }
}

/// Path-traces the surfaces of frames.
struct Tracer<'a> {
    spp: u32,
    denoiser: Option<Denoiser>,
    cancel: &'a Cancel,
}

impl Tracer<'_> {
    fn picture(&mut self, frame: &Frame, light: &Light) -> Result<Rgb> {
        shell::traced(frame, &light.environment, self.spp, self.denoiser.as_mut(), self.cancel)
    }
}

/// What is compared: display values.
struct Shown {
    /// The pictures of [`ROWS`].
    pictures: [Rgb; ROWS.len()],
    truth: Rgb,
    /// Coverage.
    alpha: Image<f32>,
}

impl Shown {
    fn new(old: &Sequence, turned: &Sequence, network: &Inverter, tracer: &mut Tracer) -> Result<Self> {
        let (frame, truth) = (old.frame(0)?, turned.frame(0)?);
        let shown = shown(&frame, old.light()?)?;
        let found = network.find(std::slice::from_ref(&shown), &Intrinsic::ALL, 1)?.swap_remove(0);
        let (width, height) = (shown.width, shown.height);
        let plain = Buffers {
            albedo: Some(shown.clone()),
            normal: Some(Rgb::filled(width, height, [0.0, 0.0, 1.0])),
            depth: None,
            material: Some(Rgb::filled(width, height, [0.5, 0.0, 0.5])),
        };
        let (light, exposure) = (turned.light()?, turned.exposure());
        let shade = |frame: &Frame| ibl::shade(frame, light).image;
        let displayed = |picture: &Rgb| picture.map(|rgb| display(*rgb, exposure));
        let recovered = with(&frame, &found);
        let new = shade(&recovered);
        let before = ibl::shade(&recovered, old.light()?).image;
        let [traced, traced_before] = [tracer.picture(&recovered, light)?, tracer.picture(&recovered, old.light()?)?];
        let linear = shown.map(|p| p.map(|v| srgb_to_linear(v) / old.exposure()));
        let turned_by = |shadings: [&Rgb; 2]| displayed(&ratio(&linear, shadings, [old.exposure(), exposure]));
        let pictures = [
            displayed(&new),
            turned_by([&before, &new]),
            displayed(&traced),
            turned_by([&traced_before, &traced]),
            displayed(&shade(&frame)),
            displayed(&tracer.picture(&frame, light)?),
            displayed(&shade(&with(&frame, &plain))),
            shown,
        ];
        let beauty = truth.beauty.as_ref().context("the truth has no beauty")?;
        Ok(Self { pictures, truth: displayed(beauty), alpha: truth.alpha })
    }
}

/// The picture times the ratio of two shadings of the same surfaces, under the old light and the new. All are radiance, with the
/// exposures of the two lights.
fn ratio(picture: &Rgb, [old, new]: [&Rgb; 2], exposures: [f32; 2]) -> Rgb {
    let [least_old, least_new] = exposures.map(|exposure| LEAST / exposure);
    Rgb::from_fn(picture.width, picture.height, |x, y| {
        let (picture, old, new) = (picture.at(x, y), old.at(x, y), new.at(x, y));
        std::array::from_fn(|c| picture[c] * ((new[c] + least_new) / (old[c] + least_old)).clamp(0.0, MOST))
    })
}

/// The picture of a frame, as a network sees it.
fn shown(frame: &Frame, light: &Light) -> Result<Rgb> {
    // The environment is not looked at: the smallest view of it is enough.
    let view = EnvironmentView::new(&light.environment, 2, 1);
    let pictures = Pictures::new(frame, light, &view, DepthBounds::of([frame]))?;
    let picture = pictures.target.as_deref().context("has no beauty")?;
    Ok(image(pictures.width, pictures.height, picture).map(|p| p.map(unit)))
}

/// The frame with recovered buffers in the place of its own. Coverage stays, and so does what is seen through clear surfaces.
fn with(frame: &Frame, buffers: &Buffers) -> Frame {
    let or = |found: &Option<Rgb>, own: &Rgb| found.clone().unwrap_or_else(|| own.clone());
    let mut recovered = Frame {
        albedo: buffers.albedo.as_ref().map_or_else(|| frame.albedo.clone(), |albedo| albedo.map(|p| p.map(srgb_to_linear))),
        normal: or(&buffers.normal, &frame.normal),
        material: or(&buffers.material, &frame.material),
        // Its scale is open, and does not matter to the light of an environment.
        depth: buffers.depth.as_ref().map_or_else(|| frame.depth.clone(), |depth| depth.map(|v| v.exp())),
        guide_albedo: None,
        guide_normal: None,
        ..frame.clone()
    };
    if buffers.depth.is_some() {
        recovered.depth = shell::fitted(&recovered);
    }
    recovered
}

fn rows(found: &[Vec<BTreeMap<String, f64>>]) -> Vec<Row> {
    let row = |(i, buffers): (usize, &'static str)| {
        let value = |id: &str| {
            let all: Vec<f64> = found.iter().filter_map(|rows| rows[i].get(id).copied()).collect();
            Some((id.to_owned(), bootstrap(&all)?))
        };
        Row { buffers, values: SHOWN.iter().filter_map(|id| value(id)).collect() }
    };
    ROWS.into_iter().enumerate().map(row).collect()
}

fn print(results: &Results) {
    println!("{}, light turned by {} degrees", plural(results.sequences, "sequence"), results.record.turn);
    for metric in METRICS.iter().filter(|metric| SHOWN.contains(&metric.id)) {
        println!("  {}: {}", metric.label, metric.meaning);
        for row in &results.rows {
            if let Some(value) = row.values.get(metric.id) {
                println!("    {:22} {}", row.buffers, value.shown(metric.digits));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use renderflow_frame::Environment;

    /// A wall under white light shows its albedo; recovered buffers replace the frame's own.
    #[test]
    fn recovered_buffers_are_shaded() {
        let wall = |albedo: f32| Frame {
            width: 8,
            height: 8,
            alpha: Image::filled(8, 8, 1.0),
            albedo: Rgb::filled(8, 8, [albedo; 3]),
            normal: Rgb::filled(8, 8, [0.0, 0.0, 1.0]),
            depth: Image::filled(8, 8, 2.0),
            material: Rgb::filled(8, 8, [1.0, 0.0, 0.0]),
            guide_albedo: Some(Rgb::filled(8, 8, [albedo; 3])),
            ..Frame::default()
        };
        let light = Light::new(Environment::constant([1.0; 3]));
        let mean = |frame: &Frame| ibl::shade(frame, &light).image.pixels[27][0];
        let found =
            Buffers { albedo: Some(Rgb::filled(8, 8, [renderflow_frame::color::linear_to_srgb(0.6); 3])), ..Buffers::default() };
        assert!((mean(&with(&wall(0.2), &found)) - mean(&wall(0.6))).abs() < 1e-4);
        assert!((mean(&wall(0.2)) - mean(&wall(0.6))).abs() > 0.2);
    }

    /// Where the buffers are wrong by a factor, the ratio is not.
    #[test]
    fn a_ratio_keeps_what_the_picture_shows() {
        let grey = |v: f32| Rgb::filled(1, 1, [v; 3]);
        let relit = ratio(&grey(0.8), [&grey(10.0), &grey(5.0)], [1.0; 2]);
        assert!((relit.pixels[0][0] - 0.4).abs() < 1e-3, "{relit:?}");
        assert!(ratio(&grey(1.0), [&grey(0.0), &grey(9.0)], [1.0; 2]).pixels[0][0] <= MOST);
        assert_eq!(ratio(&grey(0.0), [&grey(0.0), &grey(9.0)], [1.0; 2]).pixels[0], [0.0; 3]);
    }
}
