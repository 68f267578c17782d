//! What renders: this program, and others in processes of their own.

use super::child::Child;
use anyhow::{Context, Result, ensure};
use renderflow::util::cancel::Interrupted;
use renderflow::util::clock::{Spent, Stopwatch};
use renderflow_frame::image::{Image, Rgb};
use renderflow_renderer::{Budget, Channels, RenderScene, Settings, render};
use renderflow_scenes::LoadedScene;
use serde_json::json;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

/// A renderer that may take part.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Kind {
    /// On the command line and in results.
    pub id: &'static str,
    /// In tables.
    pub label: &'static str,
    /// Renderers of one family converge to the same picture and share its reference.
    pub family: &'static str,
    /// Arguments of the family's script.
    pub arguments: &'static [&'static str],
}

/// Every renderer, in the order they take turns in.
pub const KINDS: [Kind; 6] = [
    Kind { id: OURS, label: "renderflow, uniform", family: OURS, arguments: &[] },
    Kind { id: ADAPTIVE, label: "renderflow, adaptive", family: OURS, arguments: &[] },
    Kind {
        id: "mitsuba-multijitter",
        label: "Mitsuba LLVM, multijitter",
        family: "mitsuba",
        arguments: &["llvm_ad_rgb", "multijitter"],
    },
    Kind {
        id: "mitsuba-independent",
        label: "Mitsuba LLVM, independent",
        family: "mitsuba",
        arguments: &["llvm_ad_rgb", "independent"],
    },
    Kind { id: "mitsuba-scalar", label: "Mitsuba scalar", family: "mitsuba", arguments: &["scalar_rgb", "multijitter"] },
    Kind { id: "cycles", label: "Cycles", family: "cycles", arguments: &[] },
];

/// Id of ours with as many samples in every pixel, and its family.
pub const OURS: &str = "renderflow";
/// Id of ours with more samples where the picture is noisier, and as many on average.
const ADAPTIVE: &str = "renderflow-adaptive";

/// A renderer that does take part.
pub struct Contender {
    /// Which.
    pub kind: Kind,
    /// Its version.
    pub version: String,
    engine: Engine,
}

enum Engine {
    Ours(Box<Ours>),
    Other { child: Child, file: PathBuf },
}

/// The scene as loaded, and as compiled for the last seed.
#[derive(Default)]
struct Ours {
    loaded: Option<LoadedScene>,
    compiled: Option<(u64, RenderScene)>,
}

/// What every picture of a scene shares.
#[derive(Clone, Copy, Debug)]
pub struct Shot {
    /// Width and height, pixels.
    pub size: [usize; 2],
    /// Surfaces a path may scatter at; others have it from the exported scene.
    pub max_bounces: u32,
}

impl Contender {
    /// This program.
    pub fn ours(kind: Kind) -> Self {
        Self { kind, version: env!("CARGO_PKG_VERSION").into(), engine: Engine::Ours(Box::default()) }
    }

    /// A script; pictures come through a file in `folder`.
    pub fn other(kind: Kind, child: Child, folder: &Path) -> Self {
        let file = folder.join(format!("{}.f32", kind.id));
        Self { kind, version: child.version.clone(), engine: Engine::Other { child, file } }
    }

    /// Loads a scene, which others read from `exported`. Returns what there is to say about it.
    ///
    /// # Errors
    /// When it cannot be loaded, or `cancel` was set.
    pub fn load(&mut self, scene: &LoadedScene, exported: &Path, cancel: &AtomicBool) -> Result<Vec<String>> {
        match &mut self.engine {
            Engine::Ours(ours) => {
                **ours = Ours { loaded: Some(scene.clone()), compiled: None };
                Ok(Vec::new())
            }
            Engine::Other { child, .. } => child.load(exported, cancel),
        }
    }

    /// Does once what renders of `spps` samples a pixel need the first time.
    ///
    /// # Errors
    /// As [`Self::render`].
    pub fn warm(&mut self, spps: &[u32], shot: &Shot, cancel: &AtomicBool) -> Result<()> {
        match &mut self.engine {
            Engine::Ours(_) => self.render(1, 1, shot, cancel).map(|_| ()),
            Engine::Other { child, .. } => child.ask(&json!({"warm": {"spps": spps}}), cancel).map(|_| ()),
        }
    }

    /// Renders the scene that is loaded. Loading and compiling it is not in the time.
    ///
    /// # Errors
    /// When it fails, or `cancel` was set.
    pub fn render(&mut self, spp: u32, seed: u64, shot: &Shot, cancel: &AtomicBool) -> Result<(Rgb, Spent)> {
        match &mut self.engine {
            Engine::Ours(ours) => {
                if ours.compiled.as_ref().is_none_or(|(of, _)| *of != seed) {
                    let loaded = ours.loaded.as_mut().context("no scene is loaded")?;
                    loaded.seed = seed;
                    ours.compiled = Some((seed, RenderScene::compile(loaded)?));
                }
                let (_, scene) = ours.compiled.as_ref().context("no scene is compiled")?;
                let budget = if self.kind.id == ADAPTIVE { Budget::Average } else { Budget::Uniform };
                // What the others render, too: the beauty.
                let channels = Channels::BEAUTY;
                let settings = Settings { spp, max_bounces: shot.max_bounces, budget, channels, ..Settings::default() };
                let clock = Stopwatch::start();
                let frame = render(scene, &settings, &|_, _| (), cancel);
                let spent = clock.spent();
                if cancel.load(Ordering::Relaxed) {
                    return Err(Interrupted.into());
                }
                Ok((frame?.raw.context("a frame without beauty")?, spent))
            }
            Engine::Other { child, file } => {
                let answer = child.ask(&json!({"render": {"spp": spp, "seed": seed, "file": file}}), cancel)?;
                let seconds = |name: &str| answer[name].as_f64().filter(|s| s.is_finite() && *s >= 0.0);
                let seconds = |name| seconds(name).with_context(|| format!("said {answer}, without {name}"));
                let spent = Spent { seconds: seconds("wall")?, processor: Some(seconds("cpu")?) };
                let bytes = renderflow_frame::file::read(file)?;
                Ok((picture(&bytes, shot.size)?, spent))
            }
        }
    }
}

/// A picture from its little-endian floats, row by row from the top.
///
/// # Errors
/// When there are more or fewer, or some are not finite.
pub fn picture(bytes: &[u8], [width, height]: [usize; 2]) -> Result<Rgb> {
    let wanted = 12 * width * height;
    ensure!(bytes.len() == wanted, "a picture of {} bytes; {width} x {height} pixels take {wanted}", bytes.len());
    let (texels, _) = bytes.as_chunks::<4>();
    let values: Vec<f32> = texels.iter().map(|b| f32::from_le_bytes(*b)).collect();
    ensure!(values.iter().all(|v| v.is_finite()), "a picture with values that are not finite");
    Ok(Image { width, height, pixels: values.as_chunks::<3>().0.to_vec() })
}

/// Inverse of [`picture`].
pub fn bytes(picture: &Rgb) -> Vec<u8> {
    picture.pixels.iter().flatten().flat_map(|v| v.to_le_bytes()).collect()
}
