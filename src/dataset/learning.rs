//! Makes frames for training on the fly: composes them from a plan or reads them from a dataset, renders them with few samples
//! and with many, shades them, and carries keyframes to them.

pub mod kept;
mod relit;
mod truth;

pub use kept::Kept;

use crate::dataset::Dataset;
use crate::dataset::around::{Carried, Neighbours, REACH, Traced, offer, surface};
use crate::dataset::plan::Plan;
use crate::dataset::shading::{BUFFERS, OWN_BUFFER, TRACED};
use crate::util::cancel::Cancel;
use anyhow::{Context, Result, anyhow, ensure};
use half::f16;
use rand::RngExt;
use rand::seq::SliceRandom;
use relit::Lit;
use renderflow_frame::Frame;
use renderflow_frame::frame::LIGHT_GROUPS;
use renderflow_frame::ibl;
use renderflow_frame::reach::Reach;
use renderflow_frame::warp::{Keyframe, Neighbour};
use renderflow_model::data::step_rng;
use renderflow_model::fusion::Record;
use renderflow_model::fusion::batch::BEFORE;
use renderflow_model::fusion::fill::{Samples, background};
use renderflow_model::fusion::record::{ALL_BEFORE, Groups, PARTS, PICTURES, Selection};
use renderflow_model::fusion::training::Source;
use renderflow_renderer::deferred::{self, Deferred, Options, ShadowTiles};
use renderflow_renderer::denoise::{self, Denoiser, Quality};
use renderflow_renderer::{Budget, Channels, RenderScene, Settings, render, render_gbuffer};
use renderflow_scenes::catalog::Catalog;
use renderflow_scenes::description::Scene;
use renderflow_scenes::seed::Seed;
use renderflow_scenes::{LoadedScene, load};
use serde::{Deserialize, Serialize};
use std::num::NonZeroU64;
use std::ops::Range;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use truth::{Shown, Truth};

/// Frames between two keyframes.
const GAP: usize = 16;

/// How frames for training are made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Recipe {
    /// Samples for each pixel of the truth. Squared errors are of what was traced. The rest of the loss is of OIDN's picture of
    /// it, where OIDN is found.
    pub truth_spp: u32,
    /// How often a path may scatter.
    pub max_bounces: u32,
    /// Frames of each sequence between its two keyframes.
    pub frames: usize,
    /// Samples for each pixel of each part of a frame; each neighbour gets the number of the first part. `None` draws them: 1, 2,
    /// 4 and 8 or 16, in any order.
    pub samples: Option<[u32; PARTS]>,
    /// Share of the denoised pictures, 0..=1, that OIDN makes in least time. It makes the others with least error.
    pub fast: f64,
    /// Share of the sequences, 0..=1, that have neither samples, denoised pictures nor keyframes. They take less time than the
    /// others, and train the tier that reads deferred shading alone.
    pub bare: f64,
    /// Share of the bare sequences, 0..=1, that have keyframes after all.
    pub keyed: f64,
    /// Share of the sequences that are not bare, 0..=1, whose frames have samples of their own alone, without keyframes and
    /// without frames around. They take less than half the time of the others, so that a network sees more scenes.
    #[serde(skip_serializing_if = "is_zero")]
    pub single: f64,
    /// Share of the sequences with samples, 0..=1, whose samples are spread by the detail of the G-buffer
    /// ([`renderflow_renderer::Budget::Detail`]), one part of one sample excepted. The
    /// G-buffer of frames by themselves is that of the first part, if it has eight or more.
    #[serde(skip_serializing_if = "is_zero")]
    pub adaptive: f64,
    /// Samples for each pixel of the truth of a bare sequence.
    pub bare_spp: u32,
    /// The same of keyframes. Their noise is carried to the other frames. A network that learns from noisy keyframes trusts clean
    /// ones too little.
    pub key_spp: u32,
    /// Share of the sequences of a plan, 0..=1, that are rendered at half the width and height. They take a quarter of the time,
    /// so that a network sees more scenes. Crops that do not fit them are taken from the others.
    pub small: f64,
    /// Number of times that a bare sequence is shown under yet another light, 0..=64. Its frames take that much more memory.
    /// Each group of directions of its environment ([`renderflow_renderer::LightGroups`]) becomes up to two stops brighter or
    /// darker, and tinged. The truth of all is one render, so that another light takes about half the time of another scene.
    #[serde(skip_serializing_if = "is_zero")]
    pub relit: u32,
    /// Whether frames get deferred shading, for a network that reads it. Without it, a sequence takes less time.
    pub deferred: bool,
    /// Number of sequences at the beginning that are passed over, because an earlier run learned from them.
    pub skip: u64,
    /// Number of sequences that follow each other before the first one comes again; `None` never repeats one.
    pub count: Option<NonZeroU64>,
}

impl Default for Recipe {
    fn default() -> Self {
        Self {
            truth_spp: 64,
            max_bounces: 6,
            frames: 3,
            samples: None,
            fast: 0.4,
            bare: 0.0,
            keyed: 0.0,
            single: 0.0,
            adaptive: 0.0,
            bare_spp: 16,
            key_spp: 64,
            small: 0.0,
            relit: 0,
            deferred: true,
            skip: 0,
            count: None,
        }
    }
}

/// Recipes from before an option keep their names as long as it is not used.
fn is_zero<T: Default + PartialEq>(option: &T) -> bool {
    *option == T::default()
}

impl Recipe {
    /// Most that [`Self::relit`] may be.
    pub const MOST_LIGHTS: u32 = 64;

    /// Index, in the plan or the dataset, of the sequence that is used as sequence `i`.
    fn index(&self, i: u64) -> u64 {
        self.count.map_or(i, |count| i % count).saturating_add(self.skip)
    }

    /// What makes the sequences of a recipe what they are, whichever of them are used.
    fn content(&self) -> Self {
        Self { skip: 0, count: None, ..self.clone() }
    }
}

/// A source that knows which sequences of the plan or the dataset it uses.
pub trait Indexed: Source {
    /// A text that is equal if the sequences of equal [`Self::index`] are.
    fn content(&self) -> String;
    /// Index of sequence `i` in the plan or the dataset.
    fn index(&self, i: u64) -> u64;
}

/// The sequences of a plan, one after the other. After the last one it continues with other seeds.
pub struct Planned<'a> {
    plan: &'a Plan,
    catalog: Catalog,
    /// Index of the first sequence of the split, and the number of sequences.
    range: [u32; 2],
    maker: Maker<'a>,
}

/// The sequences of a dataset, in a new order each time round. Their truth is read; everything else is made from their scenes.
pub struct Recorded<'a> {
    dataset: &'a Dataset,
    /// BLAKE3 of the content of the dataset.
    digest: String,
    allowed: &'a [PathBuf],
    maker: Maker<'a>,
}

/// Makes the frames.
struct Maker<'a> {
    recipe: Recipe,
    /// OIDN with least error, and in least time; `None` where OIDN is not found.
    denoisers: Option<[Mutex<Denoiser>; 2]>,
    cancel: &'a Cancel,
}

/// The frames of one sequence that are used, by number.
struct SelectedFrames {
    keys: [usize; 2],
    between: Vec<usize>,
}

/// What the frames of a sequence have.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Kind {
    /// Samples and denoised pictures.
    samples: bool,
    /// Keyframes; with samples, also those of the frames around.
    keys: bool,
}

impl<'a> Planned<'a> {
    /// Uses `count` sequences of `plan`, starting with sequence `first`.
    pub fn new(plan: &'a Plan, [first, count]: [u32; 2], recipe: Recipe, cancel: &'a Cancel) -> Self {
        Self { plan, catalog: plan.catalog(), range: [first, count.max(1)], maker: Maker::new(recipe, cancel) }
    }

    /// Whether the truth is denoised: whether OIDN was found.
    pub fn denoises(&self) -> bool {
        self.maker.denoisers.is_some()
    }

    /// The frames of sequence `i`: its two keyframes without samples, then the frames between them with everything.
    ///
    /// # Errors
    /// When the sequence cannot be composed or rendered.
    pub fn records(&self, i: u64) -> Result<Vec<Record<f32>>> {
        let i = self.maker.recipe.index(i);
        let [first, count] = self.range;
        let (round, index) = (i / u64::from(count), first + (i % u64::from(count)) as u32);
        let seed = Seed::root(self.plan.seed).child("learning", i);
        let plan = Plan { seed: self.plan.seed.wrapping_add(round), ..self.plan.clone() };
        let mut composed = if round == 0 { plan.compose(&self.catalog, index)? } else { plan.compose(&plan.catalog(), index)? };
        if seed.child("small", 0).rng().random_bool(self.maker.recipe.small) {
            composed.scene.resolution = composed.scene.resolution.map(|side| (side / 2).max(1));
        }
        let loaded = load::load(&composed.scene, &plan.reach())?;
        let frames = loaded.cameras.len();
        let gap = GAP.min(frames.saturating_sub(1));
        let before = pick(seed, "before", frames - gap);
        let between = (before + 1..before + gap).collect();
        let selected = SelectedFrames { keys: [before, before + gap], between: self.maker.some(seed, between) };
        let truth = |number: usize, scene: &RenderScene| self.maker.truth(scene, seed, selected.keys.contains(&number));
        self.maker.records(&loaded, &selected, seed, &truth)
    }
}

impl<'a> Recorded<'a> {
    /// Uses the sequences of `dataset`, whose scenes may name files in the folders `allowed`.
    ///
    /// # Errors
    /// When the recipe asks for other lights, or when a file of the dataset cannot be read or differs from its record.
    pub fn new(dataset: &'a Dataset, allowed: &'a [PathBuf], recipe: Recipe, cancel: &'a Cancel) -> Result<Self> {
        ensure!(recipe.relit == 0, "recipe.relit: a dataset holds its truth under one light: train on a plan instead");
        (0..dataset.sequences.len()).try_for_each(|index| dataset.check_scene(index))?;
        Ok(Self { dataset, digest: dataset.digest()?, allowed, maker: Maker::new(recipe, cancel) })
    }

    /// The frames of sequence `i`, as [`Planned::records`].
    ///
    /// # Errors
    /// When the sequence cannot be read or rendered, or when a frame has no beauty, another size or another scene.
    pub fn records(&self, i: u64) -> Result<Vec<Record<f32>>> {
        let i = self.maker.recipe.index(i);
        let count = self.dataset.sequences.len() as u64;
        let mut order: Vec<usize> = (0..count as usize).collect();
        order.shuffle(&mut step_rng(0x6c65_6172, i / count));
        let which = order[(i % count) as usize];
        let sequence = &self.dataset.sequences[which];
        let make = || -> Result<Vec<Record<f32>>> {
            ensure!(!sequence.is_empty(), "has no frames");
            let file = sequence.folder.join("scene.json");
            let scene = Scene::read(&file)?;
            let loaded = load::load(&scene, &Reach::of(&file).allow(self.allowed))?;
            let seed = Seed::root(loaded.seed).child("learning", i);
            let last = sequence.len().saturating_sub(1);
            // Two keyframes that follow each other; the ends of the sequence where there are none.
            let pairs: Vec<[usize; 2]> = sequence.transforms.keyframes.windows(2).map(|pair| [pair[0], pair[1]]).collect();
            let [before, after] = pairs.get(pick(seed, "before", pairs.len())).copied().unwrap_or([0, last]);
            let numbers = |indices: Range<usize>| indices.map(|index| sequence.numbers[index]).collect::<Vec<usize>>();
            let between = self.maker.some(seed, numbers(before + 1..after.max(before + 1)));
            let selected = SelectedFrames { keys: [sequence.numbers[before], sequence.numbers[after]], between };
            let truth = |number: usize, _: &RenderScene| {
                let index = sequence.numbers.iter().position(|stored| *stored == number).context("a frame of the dataset")?;
                let frame = self.dataset.frame(which, index)?;
                let name = &sequence.transforms.files[index];
                frame.info.check_scene(&loaded.hash, &loaded.files).map_err(|reason| anyhow!("{name}: {reason}"))?;
                let picture = frame.beauty.with_context(|| format!("{name}: has no beauty"))?;
                // Compact frames hold no raw picture. Squared errors are then of the denoised one.
                Ok(Truth { shown: Shown { picture, raw: frame.raw }, traced: None })
            };
            self.maker.records(&loaded, &selected, seed, &truth)
        };
        make().with_context(|| sequence.folder.display().to_string())
    }
}

/// The deferred picture of the frame at which `scene` stands, if the recipe wants it. `tiles` are those of its earlier frames and
/// other lights.
fn deferred_picture(scene: &RenderScene, gbuffer: &Frame, lit: &Lit, tiles: &mut ShadowTiles) -> Option<Deferred> {
    let lighting = lit.lighting.as_ref()?;
    let shadows = tiles.maps(scene, lighting, gbuffer);
    Some(deferred::shade(gbuffer, lighting, &shadows, &Options::default()))
}

/// A record of the G-buffer, its deferred picture if there is one, and its truth.
fn shaded_record(gbuffer: &Frame, shaded: Option<&Deferred>, truth: &Shown, lit: &Lit) -> Record<f32> {
    let mut record = if let Some(shaded) = shaded {
        let mut record = Record::of(gbuffer, &shaded.surfaces, lit.exposure);
        record.add_deferred(&shaded.terms, lit.exposure);
        record
    } else {
        let mut surfaces = ibl::surfaces(gbuffer, &lit.light.environment);
        surfaces.join();
        Record::of(gbuffer, &surfaces, lit.exposure)
    };
    record.add_truth(&truth.picture, truth.raw.as_ref(), lit.exposure);
    record
}

/// Draws one of `count`, by name.
fn pick(seed: Seed, name: &str, count: usize) -> usize {
    (seed.child(name, 0).u64() % count.max(1) as u64) as usize
}

impl<'a> Maker<'a> {
    fn new(recipe: Recipe, cancel: &'a Cancel) -> Self {
        let open =
            |quality| Denoiser::with_options(denoise::Options { quality, ..denoise::Options::default() }).ok().map(Mutex::new);
        let denoisers = open(Quality::High).zip(open(Quality::Fast)).map(|(high, fast)| [high, fast]);
        Self { recipe, denoisers, cancel }
    }

    /// `digest` of the scenes and the recipe, with what else decides the numbers: the denoiser.
    fn content(&self, digest: &str) -> String {
        format!("{digest} {}", if self.denoisers.is_some() { "denoised" } else { "raw" })
    }

    /// Draws the number of frames that the recipe asks for from `between`.
    fn some(&self, seed: Seed, mut between: Vec<usize>) -> Vec<usize> {
        while between.len() > self.recipe.frames {
            between.remove(pick(seed, "between", between.len() * 7919) % between.len());
        }
        between
    }

    /// Whether the sequence of a seed has neither samples nor denoised pictures.
    fn bare(&self, seed: Seed) -> bool {
        seed.child("bare", 0).rng().random_bool(self.recipe.bare)
    }

    /// What the frames of the sequence of a seed have.
    fn kind(&self, seed: Seed) -> Kind {
        let draw = |name: &str, share: f64| seed.child(name, 0).rng().random_bool(share);
        if self.bare(seed) {
            return Kind { samples: false, keys: draw("keyed", self.recipe.keyed) };
        }
        Kind { samples: true, keys: !draw("single", self.recipe.single) }
    }

    /// Makes the frames `selected` of a scene: its two keyframes without samples, then the frames between them with what the kind
    /// of the sequence has. Keyframes are left out where they serve nothing: no other frame reads them, and what reads no samples
    /// learns from bare sequences. `truth` gives the truth of a frame, at which the scene stands.
    fn records(
        &self,
        loaded: &LoadedScene,
        selected: &SelectedFrames,
        seed: Seed,
        truth: &dyn Fn(usize, &RenderScene) -> Result<Truth>,
    ) -> Result<Vec<Record<f32>>> {
        let SelectedFrames { keys, between } = selected;
        let settings = Settings { channels: BUFFERS, ..Settings::default() };
        let frames = loaded.cameras.len();
        let numbers: Vec<usize> = (0..frames).collect();
        let tracks = super::job::tracks(loaded, &numbers);

        let mut scene = RenderScene::compile(loaded)?;
        let kind = self.kind(seed);
        let lights = self.lights(&scene, seed);
        let Lit { exposure, .. } = lights[0];
        let light = Arc::clone(scene.light());

        // Depths towards a light serve every light of that direction, and every frame where nothing moves.
        let mut tiles = ShadowTiles::default();
        // One list for each light.
        let mut records: Vec<Vec<Record<f32>>> = lights.iter().map(|_| Vec::new()).collect();
        let mut carried: Vec<Vec<Keyframe>> = lights.iter().map(|_| Vec::new()).collect();
        // G-buffers and the first part of the samples share camera rays, as in rendering. Those of the truth are others.
        let (apart, truthful) = (loaded.seed.wrapping_add(1), loaded.seed);
        let needed = kind.keys || !kind.samples;
        // Where there is no frame between keyframes that are not needed, the first of them is used.
        let between: &[usize] = if between.is_empty() && !needed { &keys[..1] } else { between };
        for &number in keys.iter().filter(|_| needed) {
            scene.set_frame(number);
            scene.reseed(apart);
            let gbuffer = render_gbuffer(&scene, &settings)?;
            scene.reseed(truthful);
            let truth = truth(number, &scene)?.fitting(&gbuffer)?;
            for ((lit, records), carried) in lights.iter().zip(&mut records).zip(&mut carried) {
                let shaded = deferred_picture(&scene, &gbuffer, lit, &mut tiles);
                let truth = self.truth_under(lit, &truth)?;
                records.push(shaded_record(&gbuffer, shaded.as_ref(), &truth, lit));
                let start = kind.keys.then(|| ibl::shade(&gbuffer, &lit.light).image);
                carried.push(Keyframe { frame: gbuffer.clone(), truth: truth.picture, start });
            }
        }
        let adaptive = kind.samples && seed.child("adaptive", 0).rng().random_bool(self.recipe.adaptive);
        let trace = |scene: &mut RenderScene, samples: &[u32; PARTS], part: usize, surfaces: bool| {
            scene.reseed(apart.wrapping_add(part as u64));
            let mut settings = self.tracing(samples[part], surfaces, 0);
            (settings.channels.paths, settings.channels.variance) = (TRACED.paths, TRACED.variance);
            let budget = if adaptive && settings.spp > 1 { Budget::Detail } else { Budget::Uniform };
            render(scene, &Settings { budget, ..settings }, &|_, _| (), self.cancel)
        };
        for &number in between {
            scene.set_frame(number);
            let samples = &self.samples(seed, number);
            scene.reseed(apart);
            // Samples that are spread have a G-buffer of their own, if they are not too few for it.
            let own = adaptive && samples[0] >= OWN_BUFFER && !kind.keys;
            let gbuffer = if own { trace(&mut scene, samples, 0, true)? } else { render_gbuffer(&scene, &settings)? };
            scene.reseed(truthful);
            let truth = truth(number, &scene)?.fitting(&gbuffer)?;
            for ((lit, records), carried) in lights.iter().zip(&mut records).zip(&carried) {
                let shaded = deferred_picture(&scene, &gbuffer, lit, &mut tiles);
                let mut record = shaded_record(&gbuffer, shaded.as_ref(), &self.truth_under(lit, &truth)?, lit);
                if kind.keys || kind.samples {
                    let alone = ibl::shade(&gbuffer, &lit.light);
                    let seen = |k: usize| {
                        let distance = keys[k] as f32 - number as f32;
                        carried.get(k).map(|key| Neighbour { key, distance, movement: tracks.between(number, keys[k]) })
                    };
                    if kind.keys {
                        record.add_keys([0, 1].map(seen), &gbuffer, &alone.image, lit.exposure);
                    }
                    if kind.samples {
                        record.add_environment(&alone, lit.exposure);
                    }
                }
                records.push(record);
            }
            if !kind.samples {
                continue;
            }
            let record = records[0].last_mut().context("the record of the frame")?;
            for part in 1..PARTS {
                let traced = trace(&mut scene, samples, part, false)?;
                let behind = background(scene.camera(), &traced.alpha, &light.environment);
                let traced = Samples { spp: samples[part], ..Samples::of(&traced, &behind).context("samples")? };
                record.add_part(part, &traced, exposure);
            }
            // The mean over all pixels may differ a little from the number that was asked for.
            let traced = |frame: Frame| Ok::<_, anyhow::Error>(Traced { spp: samples[0], ..Traced::of(frame, exposure)? });
            let own = traced(if own { gbuffer.clone() } else { trace(&mut scene, samples, 0, false)? })?;
            let behind = background(scene.camera(), &own.alpha, &light.environment);
            record.add_part(0, &own.samples(&behind)?, exposure);
            // The frames around have as many samples as the first part.
            let near = |&other: &usize| -> Result<(usize, Frame, Traced)> {
                scene.set_frame(other);
                let frame = trace(&mut scene, samples, 0, true)?;
                Ok((other, surface(&frame), traced(frame)?))
            };
            let around = if kind.keys { Neighbours::Around.of(REACH, number, frames) } else { Vec::new() };
            let near = around.iter().map(near).collect::<Result<Vec<_>>>()?;
            let current = surface(&gbuffer);
            let others: Vec<(usize, Carried)> = near
                .iter()
                .map(|(other, surface, traced)| {
                    let movement = tracks.between(number, *other);
                    (*other, Carried::new((&current, &own), (surface, traced), movement, other.abs_diff(number)))
                })
                .collect();
            let others = others.iter().map(|(there, carried)| (*there, carried));
            offer(record, number, others, |there| loaded.cameras[there], (&light.environment, exposure))?;
            self.add_denoised(record, seed.child("denoised", number as u64), exposure)?;
        }
        Ok(records.into_iter().flatten().collect())
    }

    /// The lights under which a sequence of `seed` is shown, its own first.
    fn lights(&self, scene: &RenderScene, seed: Seed) -> Vec<Lit> {
        let groups = self.tracing(1, false, self.groups(seed)).groups(scene);
        let others = groups.iter().flat_map(|groups| {
            (0..self.recipe.relit).map(move |k| Lit::changed(scene, groups, seed.child("relit", k.into()), self.recipe.deferred))
        });
        std::iter::once(Lit::own(scene, self.recipe.deferred)).chain(others).collect()
    }

    /// Groups into which the light of the truth is split in a sequence of `seed`.
    fn groups(&self, seed: Seed) -> u32 {
        if self.recipe.relit > 0 && self.bare(seed) { LIGHT_GROUPS as u32 } else { 0 }
    }

    /// The settings of a picture without the channels of [`TRACED`].
    fn tracing(&self, spp: u32, surfaces: bool, light_groups: u32) -> Settings {
        let channels = Channels { guides: true, gbuffer: surfaces, ..Channels::BEAUTY };
        Settings { spp, max_bounces: self.recipe.max_bounces, channels, light_groups, ..Settings::default() }
    }

    /// The samples for each pixel of each part of frame `number`.
    fn samples(&self, seed: Seed, number: usize) -> [u32; PARTS] {
        self.recipe.samples.unwrap_or_else(|| {
            let mut rng = seed.child("samples", number as u64).rng();
            let mut samples = [1, 2, 4, if rng.random_bool(0.3) { 16 } else { 8 }];
            samples.shuffle(&mut rng);
            samples
        })
    }

    /// Adds OIDN's picture of each part alone, and of the first part with the samples of the frames around it and of those before
    /// it.
    fn add_denoised(&self, record: &mut Record<f32>, seed: Seed, exposure: f32) -> Result<()> {
        let Some(denoisers) = &self.denoisers else { return Ok(()) };
        let all = Selection::all(record);
        for place in 0..PICTURES {
            if place >= PARTS && !all.groups.neighbours {
                break;
            }
            let part = if place < PARTS { place } else { 0 };
            let mut selection =
                Selection { groups: Groups { neighbours: place >= PARTS, ..all.groups }, parts: [0.0; PARTS], ..all };
            selection.parts[part] = record.parts[part] as f32;
            if place == ALL_BEFORE {
                selection.neighbours[BEFORE..].fill(0.0);
            }
            let [color, albedo, normal] = record.noisy(&selection, exposure);
            let fast = seed.child("fast", place as u64).rng().random_bool(self.recipe.fast);
            let mut denoiser = denoisers[usize::from(fast)].lock().unwrap_or_else(PoisonError::into_inner);
            record.add_denoised(place, &denoiser.denoise(&color, Some(&albedo), Some(&normal))?, exposure);
        }
        Ok(())
    }
}

impl Planned<'_> {
    fn digest(&self, recipe: &Recipe) -> String {
        let plan = serde_json::to_string(&(self.plan, recipe, self.range)).unwrap_or_default();
        blake3::hash(plan.as_bytes()).to_hex().to_string()
    }
}

impl Source for Planned<'_> {
    fn make(&self, i: u64) -> renderflow_model::Result<Vec<Record<f16>>> {
        halved(i, self.records(i))
    }

    fn identity(&self) -> String {
        self.maker.content(&self.digest(&self.maker.recipe))
    }
}

impl Indexed for Planned<'_> {
    fn content(&self) -> String {
        self.maker.content(&self.digest(&self.maker.recipe.content()))
    }

    fn index(&self, i: u64) -> u64 {
        self.maker.recipe.index(i)
    }
}

impl Recorded<'_> {
    fn digest(&self, recipe: &Recipe) -> String {
        let recipe = serde_json::to_string(recipe).unwrap_or_default();
        blake3::hash(format!("{} {recipe}", self.digest).as_bytes()).to_hex().to_string()
    }
}

impl Source for Recorded<'_> {
    fn make(&self, i: u64) -> renderflow_model::Result<Vec<Record<f16>>> {
        halved(i, self.records(i))
    }

    fn identity(&self) -> String {
        self.maker.content(&self.digest(&self.maker.recipe))
    }
}

impl Indexed for Recorded<'_> {
    fn content(&self) -> String {
        self.maker.content(&self.digest(&self.maker.recipe.content()))
    }

    fn index(&self, i: u64) -> u64 {
        self.maker.recipe.index(i)
    }
}

fn halved(i: u64, made: Result<Vec<Record<f32>>>) -> renderflow_model::Result<Vec<Record<f16>>> {
    let reason =
        |error: anyhow::Error| renderflow_model::Error::Data { place: format!("sequence {i}"), reason: format!("{error:#}") };
    made.map(|records| records.iter().map(Record::to_half).collect()).map_err(reason)
}
