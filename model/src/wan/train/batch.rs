//! Batches of latents: a function of the seed, the step and the clips in memory.

use super::album::Window;
use super::config::{BatchConfig, LatentConfig};
use crate::bridge::velocity;
use crate::network::init::normal;
use crate::train::draw_weighted;
use crate::wan::flow::{FlowConfig, Intrinsic};
use crate::wan::latents::{ClipLatents, mask_cells};
use crate::wan::pictures::Kind;
use crate::{Error, Result};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::sync::Arc;

/// What a batch is to teach.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lesson {
    /// Rendering, with keyframes a gap of frames apart where there is one.
    Render {
        /// Frames from a keyframe to the next.
        gap: Option<usize>,
    },
    /// The way back, to a random intrinsic.
    Invert,
}

/// A window of the pictures that decoded predictions are compared with.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Truth {
    /// In latent pixels.
    pub top: usize,
    /// In latent pixels.
    pub left: usize,
    /// Rows and columns in latent pixels.
    pub size: [usize; 2],
    /// `[items, 3, frames, rows, columns]` of pixels.
    pub pictures: Vec<f32>,
    /// `[items, 1, frames, rows, columns]`.
    pub masks: Vec<f32>,
}

/// One batch on the host.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LatentBatch {
    /// Items, latent channels, latent frames, rows, columns.
    pub shape: [usize; 5],
    /// State of the bridge, of that shape.
    pub z_t: Vec<f32>,
    /// `(z_1 - z_t) / (1 - t)`, what a network should answer, of that shape.
    pub velocity: Vec<f32>,
    /// Of each item.
    pub times: Vec<f32>,
    /// What the renderer is given beside the state, `[items, channels, frames, rows, columns]`; empty on the way back.
    pub attributes: Vec<f32>,
    /// Of that shape; empty on the way back.
    pub environment: Vec<f32>,
    /// Latents `[items, z, 1, rows, columns]` and time in latent frames.
    pub keyframes: Vec<(Vec<f32>, f64)>,
    /// What is recovered on the way back.
    pub intrinsic: Option<Intrinsic>,
    /// Pictures, where this step decodes its prediction.
    pub truth: Option<Truth>,
}

/// Draws batches.
pub struct Drawing<'a> {
    /// The renderer.
    pub network: &'a FlowConfig,
    /// Settings of the stage.
    pub latents: &'a LatentConfig,
    /// Kinds of batch.
    pub batches: &'a [BatchConfig],
    /// What is taught.
    pub lesson: Lesson,
}

/// Where an item comes from.
#[derive(Clone, Copy)]
struct Item {
    clip: usize,
    anchor: usize,
}

impl Drawing<'_> {
    /// Distinct sizes of pictures, in the order of [`crate::wan::latents::Encoder::sizes`].
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

    /// The batch of a step; `rng` is that of the step.
    ///
    /// # Errors
    /// When no clip in memory has the frames or keyframes that are asked for.
    pub fn draw(&self, clips: &[Arc<Vec<ClipLatents>>], step: u64, rng: &mut Pcg64Mcg) -> Result<LatentBatch> {
        let kind = self.batches[draw_weighted(self.batches.iter().map(|b| b.weight), rng)];
        let size = self.sizes().binary_search(&kind.size).unwrap_or_default();
        let at = |item: Item| &clips[item.clip][size];
        let mut items = Vec::new();
        for (clip, sized) in clips.iter().enumerate() {
            let anchors = 0..sized[size].anchors.len();
            let fits = anchors.filter(|&anchor| kind.frames == 1 || sized[size].begins_clip(anchor));
            items.extend(fits.map(|anchor| Item { clip, anchor }));
        }
        let (offsets, stride) = match self.lesson {
            Lesson::Render { gap: Some(gap) } => self.keyframes(&mut items, &at, gap, rng)?,
            _ => (Vec::new(), 1),
        };
        if items.is_empty() {
            let reason = format!("no {} frames in a row in the clips in memory", kind.frames);
            return Err(Error::Data { place: "training data".into(), reason });
        }
        let intrinsic = match self.lesson {
            Lesson::Invert => Some(Intrinsic::ALL[rng.random_range(0..Intrinsic::ALL.len())]),
            Lesson::Render { .. } => None,
        };

        let vae = &self.network.vae;
        let (factor, patch) = (vae.spatial_factor(), self.network.dit.patch_size[1]);
        let (side, frames) = (kind.size / factor, vae.latent_frames(kind.frames).unwrap_or(1));
        let mut batch = LatentBatch {
            shape: [kind.items, vae.z_dim, frames, side, side],
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
            batch.truth = Some(Truth { top, left, size: [window; 2], ..Truth::default() });
        }
        for _ in 0..kind.items {
            let item = items[rng.random_range(0..items.len())];
            let clip = at(item);
            // Corners of tokens, so that tokens are those of the whole picture.
            let [top, left] = [clip.height, clip.width].map(|all| patch * rng.random_range(0..=(all - side) / patch));
            let window = Window { top, left, height: side, width: side };
            let time = self.latents.bridge.times.draw(rng);
            let given = rng.random::<f32>() < self.latents.reference_probability;
            let noise = Pcg64Mcg::seed_from_u64(rng.random());
            self.add(&mut batch, clip, item.anchor, window, (time, given && kind.frames > 1, noise));
            for (keyframe, offset) in batch.keyframes.iter_mut().zip(&offsets) {
                if let Some(anchor) = clip.offset(item.anchor, *offset) {
                    clip.read(anchor, 1, Kind::Target, window, &mut keyframe.0);
                }
            }
            if let Some(truth) = &mut batch.truth {
                let pixels = Window {
                    top: (top + truth.top) * factor,
                    left: (left + truth.left) * factor,
                    height: truth.size[0] * factor,
                    width: truth.size[1] * factor,
                };
                let page = clip.anchors[item.anchor].page;
                let compared = intrinsic.map_or(Kind::Target, kind_of);
                truth.pictures.extend(clip.album.clip(page, kind.frames, compared, pixels));
                truth.masks.extend(clip.album.masks(page, kind.frames, pixels));
            }
        }
        Ok(batch)
    }

    /// Chooses where the keyframes of a batch are, in frames from the first of each clip: the nearest at or before it and the next, a
    /// gap later. Keeps the items that have both, or the one there is, and the stride of one of them: a batch has one distance.
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
        let has = |item: &Item, offset: i64| at(*item).offset(item.anchor, offset).is_some();
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

    fn add(
        &self,
        batch: &mut LatentBatch,
        clip: &ClipLatents,
        anchor: usize,
        window: Window,
        (time, given, mut rng): (f32, bool, Pcg64Mcg),
    ) {
        let frames = batch.shape[2];
        let latents = |kind: Kind| {
            let mut out = Vec::new();
            clip.read(anchor, frames, kind, window, &mut out);
            out
        };
        let (start, end) = match batch.intrinsic {
            Some(intrinsic) => (latents(Kind::Target), latents(kind_of(intrinsic))),
            None => (latents(Kind::Albedo), latents(Kind::Target)),
        };
        for (z0, z1) in start.into_iter().zip(end) {
            let z_t = self.latents.bridge.interpolate(z0, z1, time, normal(&mut rng));
            batch.z_t.push(z_t);
            batch.velocity.push(velocity(z1, z_t, time));
        }
        batch.times.push(time);
        if batch.intrinsic.is_some() {
            return;
        }
        clip.read_reference(anchor, frames, given, window, &mut batch.attributes);
        let mut known = vec![false; 1 + (frames - 1) * self.network.vae.temporal_factor()];
        known[0] = given;
        batch.attributes.extend(mask_cells(&known, frames, self.network.mask_channels(), window.height * window.width));
        for kind in [Kind::Normal, Kind::Depth, Kind::Material] {
            clip.read(anchor, frames, kind, window, &mut batch.attributes);
        }
        clip.read(anchor, frames, Kind::Environment, window, &mut batch.environment);
    }
}

/// The picture of an intrinsic.
pub fn kind_of(intrinsic: Intrinsic) -> Kind {
    match intrinsic {
        Intrinsic::Albedo => Kind::Albedo,
        Intrinsic::Normal => Kind::Normal,
        Intrinsic::Depth => Kind::Depth,
        Intrinsic::Material => Kind::Material,
    }
}
