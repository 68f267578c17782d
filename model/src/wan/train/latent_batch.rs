//! Batches of latents. A batch depends on the seed, the step and the clips in memory.

use super::clip_pictures::Window;
use super::config::{BatchConfig, LatentConfig};
use super::latents::ClipLatents;
use crate::bridge::velocity;
use crate::network::init::normal;
use crate::train::{Share, draw_weighted};
use crate::wan::flow::{FlowConfig, Intrinsic, mask_cells};
use crate::wan::pictures::{BridgeStart, Kind};
use crate::{Error, Result};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::sync::Arc;

/// The task that a batch is drawn for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Task {
    /// Rendering.
    Render {
        /// Distance between keyframes in frames, or `None` to render without keyframes.
        gap: Option<usize>,
    },
    /// Inverse rendering of an intrinsic that is drawn at random.
    Invert,
}

/// The window of pictures that decoded predictions are compared with.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Truth {
    /// First row in latent pixels.
    pub top: usize,
    /// First column in latent pixels.
    pub left: usize,
    /// Rows and columns in latent pixels.
    pub size: [usize; 2],
    /// `[items, 3, frames, rows, columns]` of pixels.
    pub pictures: Vec<f32>,
    /// `[items, 1, frames, rows, columns]`.
    pub masks: Vec<f32>,
    /// Where the bridge begins, if the autoencoder codes the change of the start.
    pub start: Option<Start>,
}

/// The window of pictures that a bridge begins with.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Start {
    /// As [`Truth::pictures`].
    pub pictures: Vec<f32>,
    /// Their latents, `[items, channels, latent frames, rows, columns]`.
    pub latents: Vec<f32>,
}

/// One batch in the host's memory.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LatentBatch {
    /// Numbers of items, latent channels, latent frames, rows and columns.
    pub shape: [usize; 5],
    /// State of the bridge, of [`Self::shape`].
    pub z_t: Vec<f32>,
    /// The target `(z_1 - z_t) / (1 - t)`, of [`Self::shape`].
    pub velocity: Vec<f32>,
    /// Bridge time of each item.
    pub times: Vec<f32>,
    /// Conditions beside the state, `[items, channels, frames, rows, columns]`; empty for inverse rendering.
    pub attributes: Vec<f32>,
    /// Latents of the environment, of [`Self::shape`]; empty for inverse rendering.
    pub environment: Vec<f32>,
    /// Latents `[items, z, 1, rows, columns]` of each keyframe, and its time in latent frames.
    pub keyframes: Vec<(Vec<f32>, f64)>,
    /// The intrinsic that inverse rendering recovers.
    pub intrinsic: Option<Intrinsic>,
    /// Pictures to compare with, in steps that decode their prediction.
    pub truth: Option<Truth>,
}

/// Draws batches.
pub struct BatchSampler<'a> {
    /// The renderer.
    pub network: &'a FlowConfig,
    /// Options of the stage.
    pub latents: &'a LatentConfig,
    /// Kinds of batch.
    pub batches: &'a [BatchConfig],
    /// The task that batches are drawn for.
    pub task: Task,
    /// Which items of a batch are made.
    pub share: Share,
}

/// The first frame of an item.
#[derive(Clone, Copy)]
struct Item {
    clip: usize,
    frame: usize,
}

/// What is drawn for one item.
struct ItemDraw {
    /// Bridge time.
    time: f32,
    /// Whether the first frame is given.
    given: bool,
    /// Noise of the bridge.
    noise: Pcg64Mcg,
    /// In latent pixels.
    window: Window,
}

impl BatchSampler<'_> {
    /// Distinct sizes of pictures, ascending: [`super::latents::Encoder::sizes`].
    pub fn sizes(&self) -> Vec<usize> {
        let mut sizes: Vec<usize> = self.batches.iter().map(|b| b.size).collect();
        sizes.sort_unstable();
        sizes.dedup();
        sizes
    }

    /// Whether the prediction of a step is decoded.
    pub fn decodes(&self, step: u64) -> bool {
        self.latents.pixels.weight > 0.0 && step.is_multiple_of(self.latents.pixels.period)
    }

    /// Draws the batch of a step, and makes the share of this process. `rng` holds the random numbers of that step.
    ///
    /// # Errors
    /// When no clip in memory has the frames or keyframes that the batch needs.
    pub fn draw(&self, clips: &[Arc<Vec<ClipLatents>>], step: u64, rng: &mut Pcg64Mcg) -> Result<LatentBatch> {
        let kind = self.batches[draw_weighted(self.batches.iter().map(|b| b.weight), rng)];
        let size = self.sizes().binary_search(&kind.size).unwrap_or_default();
        let at = |item: Item| &clips[item.clip][size];
        let mut items = Vec::new();
        for (clip, sized) in clips.iter().enumerate() {
            let frames = 0..sized[size].frames.len();
            let fits = frames.filter(|&frame| kind.frames == 1 || sized[size].begins_clip(frame));
            items.extend(fits.map(|frame| Item { clip, frame }));
        }
        let (offsets, stride) = match self.task {
            Task::Render { gap: Some(gap) } => self.keyframes(&mut items, &at, gap, rng)?,
            _ => (Vec::new(), 1),
        };
        if items.is_empty() {
            let reason = format!("no {} frames in a row in the clips in memory", kind.frames);
            return Err(Error::Data { place: "training data".into(), reason });
        }
        let intrinsic = match self.task {
            Task::Invert => Some(Intrinsic::ALL[rng.random_range(0..Intrinsic::ALL.len())]),
            Task::Render { .. } => None,
        };

        let vae = &self.network.vae;
        let (factor, patch) = (vae.spatial_factor(), self.network.dit.patch_size[1]);
        let (side, frames) = (kind.size / factor, vae.latent_frames(kind.frames).unwrap_or(1));
        let made = self.share.of(kind.items);
        let mut batch = LatentBatch {
            shape: [made.len(), vae.z_dim, frames, side, side],
            keyframes: offsets
                .iter()
                .map(|&offset| (Vec::new(), offset as f64 / (stride * vae.temporal_factor()) as f64))
                .collect(),
            intrinsic,
            ..LatentBatch::default()
        };
        if self.decodes(step) {
            let window = self.latents.pixels.window.min(side);
            let [top, left] = [(); 2].map(|()| rng.random_range(0..=side - window));
            let start = self.network.bridge_start.is_coded_as_change().then(Start::default);
            batch.truth = Some(Truth { top, left, size: [window; 2], start, ..Truth::default() });
        }
        for i in 0..kind.items {
            let item = items[rng.random_range(0..items.len())];
            let clip = at(item);
            // Windows begin at corners of tokens, so that their tokens are tokens of the whole picture.
            let [top, left] = [clip.height, clip.width].map(|all| patch * rng.random_range(0..=(all - side) / patch));
            let window = Window { top, left, height: side, width: side };
            let time = self.latents.bridge.times.draw(rng);
            let given = rng.random::<f32>() < self.latents.reference_probability && kind.frames > 1;
            let noise = Pcg64Mcg::seed_from_u64(rng.random());
            if !made.contains(&i) {
                continue;
            }
            self.add(&mut batch, clip, item.frame, ItemDraw { time, given, noise, window });
            for (keyframe, offset) in batch.keyframes.iter_mut().zip(&offsets) {
                if let Some(frame) = clip.offset(item.frame, *offset) {
                    clip.read(frame, 1, Kind::Target, window, &mut keyframe.0);
                }
            }
            if let Some(truth) = &mut batch.truth {
                let pixels = Window {
                    top: (top + truth.top) * factor,
                    left: (left + truth.left) * factor,
                    height: truth.size[0] * factor,
                    width: truth.size[1] * factor,
                };
                let index = clip.frames[item.frame].index;
                let compared = intrinsic.map_or(Kind::Target, kind_of);
                truth.pictures.extend(clip.pictures.clip(index, kind.frames, compared, pixels));
                truth.masks.extend(clip.pictures.masks(index, kind.frames, pixels));
                if let Some(start) = &mut truth.start {
                    start.pictures.extend(clip.pictures.clip(index, kind.frames, Kind::Albedo, pixels));
                    let latents =
                        Window { top: top + truth.top, left: left + truth.left, height: truth.size[0], width: truth.size[1] };
                    clip.read(item.frame, frames, Kind::Albedo, latents, &mut start.latents);
                }
            }
        }
        Ok(batch)
    }

    /// Draws the distances of a batch's keyframes from the first frame of each clip: one keyframe at or before that frame, and
    /// one `gap` frames later. Keeps the items that have both, or one if no item has both. All items of a batch have the same
    /// stride, which is returned too.
    fn keyframes<'b>(
        &self,
        items: &mut Vec<Item>,
        at: &dyn Fn(Item) -> &'b ClipLatents,
        gap: usize,
        rng: &mut Pcg64Mcg,
    ) -> Result<(Vec<i64>, usize)> {
        let missing = || Error::Data { place: "training data".into(), reason: format!("no keyframe within {gap} frames") };
        if items.is_empty() {
            return Err(missing());
        }
        let stride = at(items[rng.random_range(0..items.len())]).stride;
        items.retain(|item| at(*item).stride == stride);
        // What a bridge from deferred shading begins with was carried from every `gap`-th frame, and no others are keyframes.
        let carried = self.network.bridge_start == BridgeStart::Deferred;
        let is_key = |clip: &ClipLatents, frame: usize| {
            !carried || (clip.frames[frame].number - clip.frames[0].number).is_multiple_of(gap)
        };
        let has = |item: &Item, offset: i64| {
            let clip = at(*item);
            clip.offset(item.frame, offset).is_some_and(|frame| is_key(clip, frame))
        };
        let mut choices: Vec<Vec<i64>> = Vec::new();
        for offset in (0..gap as i64).step_by(stride).map(|offset| -offset) {
            let both = vec![offset, offset + gap as i64];
            let complete = items.iter().any(|item| both.iter().all(|o| has(item, *o)));
            let alone = both.iter().find(|o| items.iter().any(|item| has(item, **o)));
            choices.extend(if complete { Some(both) } else { alone.map(|o| vec![*o]) });
        }
        if choices.is_empty() {
            return Err(missing());
        }
        let offsets = choices.swap_remove(rng.random_range(0..choices.len()));
        items.retain(|item| offsets.iter().all(|o| has(item, *o)));
        Ok((offsets, stride))
    }

    /// Adds one item: the clip that begins with `frame`.
    fn add(&self, batch: &mut LatentBatch, clip: &ClipLatents, frame: usize, draw: ItemDraw) {
        let ItemDraw { time, given, mut noise, window } = draw;
        let frames = batch.shape[2];
        let latents = |kind: Kind| {
            let mut out = Vec::new();
            clip.read(frame, frames, kind, window, &mut out);
            out
        };
        let (mut start, end) = match batch.intrinsic {
            Some(intrinsic) => (latents(Kind::Target), latents(kind_of(intrinsic))),
            None => (latents(Kind::Albedo), latents(Kind::Target)),
        };
        let noisy = self.network.bridge_start == BridgeStart::Noise;
        let albedo = if noisy { start.clone() } else { Vec::new() };
        if noisy {
            start.iter_mut().for_each(|value| *value = normal(&mut noise));
        }
        for (z0, z1) in start.into_iter().zip(end) {
            let z_t = self.latents.bridge.interpolate(z0, z1, time, normal(&mut noise));
            batch.z_t.push(z_t);
            batch.velocity.push(velocity(z1, z_t, time));
        }
        batch.times.push(time);
        if batch.intrinsic.is_some() {
            return;
        }
        clip.read_reference(frame, frames, given, window, &mut batch.attributes);
        let mut known = vec![false; 1 + (frames - 1) * self.network.vae.temporal_factor()];
        known[0] = given;
        batch.attributes.extend(mask_cells(&known, frames, self.network.mask_channels(), window.height * window.width));
        for kind in [Kind::Normal, Kind::Depth, Kind::Material] {
            clip.read(frame, frames, kind, window, &mut batch.attributes);
        }
        batch.attributes.extend(albedo);
        clip.read(frame, frames, Kind::Environment, window, &mut batch.environment);
    }
}

/// The kind of picture that shows an intrinsic.
pub fn kind_of(intrinsic: Intrinsic) -> Kind {
    match intrinsic {
        Intrinsic::Albedo => Kind::Albedo,
        Intrinsic::Normal => Kind::Normal,
        Intrinsic::Depth => Kind::Depth,
        Intrinsic::Material => Kind::Material,
    }
}
