//! Training data in memory: clips become half-precision network inputs once, batches are random crops of them.

use crate::bridge::{self, Bridge};
use crate::config::{Curve, Input, NetworkConfig};
use crate::features::{Features, Physical, STORED, TARGET, write_input};
use crate::keyframe::{self, StoredKeys};
use crate::network::init::normal;
use crate::tokens::{EnvironmentSummary, mirrored};
use crate::{Error, Result};
use half::f16;
use half::slice::HalfFloatSliceExt;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use renderflow_frame::color::linear_to_srgb;
use renderflow_frame::ibl::IblTables;
use renderflow_frame::tracks::Tracks;
use renderflow_frame::{Camera, Environment, Frame};

/// One sequence as it was rendered: consecutive frames under one environment.
#[derive(Clone, Debug)]
pub struct Clip {
    /// Where it came from, for messages.
    pub name: String,
    /// Frames with `beauty`.
    pub frames: Vec<Frame>,
    /// Camera of each frame.
    pub cameras: Vec<Camera>,
    /// Light of the sequence.
    pub environment: Environment,
    /// Factor from radiance to display-linear.
    pub exposure: f32,
    /// Number of each frame in its sequence, ascending; distances to keyframes are counted in them.
    pub numbers: Vec<usize>,
    /// Transforms of the objects that move.
    pub tracks: Tracks,
    /// Indices of keyframes, ascending; used by the keyframe stage.
    pub keyframes: Vec<usize>,
}

impl Clip {
    /// Checks what every kind of training needs.
    ///
    /// # Errors
    /// [`Error::Data`] when lengths disagree, the exposure is no positive number, or a frame has no beauty.
    pub fn check(&self) -> Result<()> {
        let (frames, cameras, numbers) = (self.frames.len(), self.cameras.len(), self.numbers.len());
        if frames == 0 || cameras != frames || numbers != frames {
            return Err(self.broken(format!("{frames} frames with {cameras} cameras and {numbers} numbers")));
        }
        if !(self.exposure.is_finite() && self.exposure > 0.0) {
            return Err(self.broken(format!("exposure {} is not a positive number", self.exposure)));
        }
        match self.frames.iter().position(|frame| frame.beauty.is_none()) {
            Some(i) => Err(self.broken(format!("frame {i} has no beauty to learn from"))),
            None => Ok(()),
        }
    }

    pub(crate) fn broken(&self, reason: String) -> Error {
        Error::Data { place: self.name.clone(), reason }
    }
}

/// Where training clips come from.
pub trait ClipSource: Sync {
    /// Number of clips.
    fn len(&self) -> usize;
    /// Loads clip `i`; called from several threads.
    ///
    /// # Errors
    /// When its files cannot be read.
    fn load(&self, i: usize) -> Result<Clip>;
    /// What tells these clips from others: the same text for the same clips, wherever they lie. A run is gone on with only on the
    /// clips it began with. `None` where nothing tells them apart.
    ///
    /// # Errors
    /// When files cannot be read.
    fn identity(&self) -> Result<Option<String>> {
        Ok(None)
    }
    /// Whether there is nothing to train on.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

impl ClipSource for Vec<Clip> {
    fn len(&self) -> usize {
        self.as_slice().len()
    }

    fn load(&self, i: usize) -> Result<Clip> {
        Ok(self[i].clone())
    }
}

/// One frame of the cache.
#[derive(Clone, Debug)]
pub struct StoredFrame {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `[height][width][STORED]`.
    pub pixels: Vec<f16>,
    /// Environment tokens.
    pub tokens: Vec<f32>,
    /// Warped keyframes, for the keyframe stage.
    pub keys: Option<StoredKeys>,
}

impl StoredFrame {
    /// Memory it takes.
    pub fn bytes(&self) -> usize {
        2 * self.pixels.len() + 4 * self.tokens.len() + self.keys.as_ref().map_or(0, StoredKeys::bytes)
    }
}

/// Turns a clip into cache frames. With `keys`, warped keyframes are added and the keyframes themselves left out.
///
/// # Errors
/// [`Error::Data`] when lengths disagree, a frame has no beauty, or nothing is covered in the whole clip.
pub fn prepare(clip: &Clip, keys: bool) -> Result<Vec<StoredFrame>> {
    clip.check()?;
    let tables = IblTables::new(&clip.environment);
    let summary = EnvironmentSummary::new(&clip.environment);
    let features: Vec<Features> = clip
        .frames
        .par_iter()
        .zip(&clip.cameras)
        .map(|(frame, camera)| Features::new(frame, camera, &clip.environment, &summary, &tables, clip.exposure))
        .collect();
    if features.iter().all(|f| f.physical.iter().all(|p| p.alpha == 0.0)) {
        return Err(clip.broken("no pixel of any frame is covered".into()));
    }
    (0..features.len())
        .into_par_iter()
        .filter(|i| !keys || !clip.keyframes.contains(i))
        .map(|i| {
            let f = &features[i];
            let keys = if keys { Some(keyframe::store(clip, &features, i)?) } else { None };
            Ok(StoredFrame { width: f.width, height: f.height, pixels: f.to_half(), tokens: f.tokens.clone(), keys })
        })
        .collect()
}

/// Which window of which frame, and where on the bridge.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Item {
    frame: usize,
    x: usize,
    y: usize,
    flip: bool,
    time: f32,
    noise_seed: u64,
}

/// One training batch on the host; pictures are `[batch][size][size][channels]` unless said otherwise.
#[derive(Clone, Debug, Default)]
pub struct Batch {
    /// Items.
    pub items: usize,
    /// Rows and columns.
    pub size: usize,
    /// Network input, pixel-unshuffled: `[batch][size/2][size/2][4 * pixel_channels]`.
    pub input: Vec<f32>,
    /// `[batch][TOKENS][TOKEN_FEATURES]`.
    pub tokens: Vec<f32>,
    /// Bridge time of each item.
    pub times: Vec<f32>,
    /// Eighteen channels: lit, specular, tint, rest, start as z, z_t.
    pub base: Vec<f32>,
    /// One channel.
    pub alpha: Vec<f32>,
    /// Six channels: z_1, then the true display value.
    pub target: Vec<f32>,
    /// One channel: 1 where the pixel counts.
    pub mask: Vec<f32>,
    /// Warped keyframes, [`keyframe::CHANNELS`] channels; empty in the base stage.
    pub keys: Vec<f32>,
    /// Guides of the keyframe network, [`keyframe::GUIDES`] channels; empty in the base stage.
    pub guides: Vec<f32>,
    /// Standard normal noise, three channels, for the bridge of the keyframe stage, whose start is known on the device only.
    pub noise: Vec<f32>,
}

/// Channels of [`Batch::base`].
pub const BASE_CHANNELS: usize = 18;

/// Random numbers of one step: the same for every run and every resumption.
pub fn step_rng(seed: u64, step: u64) -> Pcg64Mcg {
    // SplitMix64's finaliser keeps neighbouring steps unrelated.
    let mut x = seed.wrapping_add(step.wrapping_mul(0x9e37_79b9_7f4a_7c15)).wrapping_add(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    Pcg64Mcg::seed_from_u64(x ^ (x >> 31))
}

impl Batch {
    /// Draws `items` random crops of `size` pixels (a multiple of [`crate::network::PIXEL_MULTIPLE`]); half of them mirrored left to right.
    /// Times and noise are those of `bridge`. Frames smaller than `size` are never given here.
    pub fn draw(
        config: &NetworkConfig,
        frames: &[&StoredFrame],
        size: usize,
        items: usize,
        bridge: Bridge,
        rng: &mut Pcg64Mcg,
    ) -> Self {
        let chosen: Vec<Item> = (0..items).map(|_| draw_item(frames, size, bridge, rng)).collect();
        Self::assemble(config, frames, size, bridge, &chosen)
    }

    fn assemble(config: &NetworkConfig, frames: &[&StoredFrame], size: usize, bridge: Bridge, chosen: &[Item]) -> Self {
        let pixels = size * size;
        let channels = config.pixel_channels();
        let parts: Vec<Self> = chosen
            .par_iter()
            .map(|item| {
                let frame = frames[item.frame];
                let mut part = Self {
                    input: vec![0.0; pixels * channels],
                    tokens: if item.flip { mirrored(&frame.tokens) } else { frame.tokens.clone() },
                    times: vec![item.time],
                    base: Vec::with_capacity(pixels * BASE_CHANNELS),
                    alpha: Vec::with_capacity(pixels),
                    target: Vec::with_capacity(pixels * 6),
                    mask: Vec::with_capacity(pixels),
                    ..Self::default()
                };
                let mut rng = Pcg64Mcg::seed_from_u64(item.noise_seed);
                for y in 0..size {
                    for x in 0..size {
                        part.push_pixel(config, frame, item, (x, y), size, bridge, &mut rng);
                    }
                }
                part
            })
            .collect();
        let join = |field: fn(&Self) -> &Vec<f32>| parts.iter().flat_map(|part| field(part).iter().copied()).collect();
        Self {
            items: chosen.len(),
            size,
            input: join(|p| &p.input),
            tokens: join(|p| &p.tokens),
            times: join(|p| &p.times),
            base: join(|p| &p.base),
            alpha: join(|p| &p.alpha),
            target: join(|p| &p.target),
            mask: join(|p| &p.mask),
            keys: join(|p| &p.keys),
            guides: join(|p| &p.guides),
            noise: join(|p| &p.noise),
        }
    }

    #[allow(clippy::too_many_arguments)]
    fn push_pixel(
        &mut self,
        config: &NetworkConfig,
        frame: &StoredFrame,
        item: &Item,
        (x, y): (usize, usize),
        size: usize,
        bridge: Bridge,
        rng: &mut Pcg64Mcg,
    ) {
        let column = item.x + if item.flip { size - 1 - x } else { x };
        let index = (item.y + y) * frame.width + column;
        let mut stored = [0.0f32; STORED];
        frame.pixels[index * STORED..][..STORED].convert_to_f32_slice(&mut stored);
        if item.flip {
            stored[Input::Normal.offset()] *= -1.0;
        }
        let base = Physical::from_stored(&stored).base(config.start);
        // In the keyframe stage the base network runs at its start; the time belongs to the second bridge.
        let base_time = if frame.keys.is_some() { 0.0 } else { item.time };
        let mut state = [[0.0; 3]; 4]; // z_0, z_t, z_1, display
        for c in 0..3 {
            let exposed = bridge::log_curve_inverse(stored[TARGET + c]);
            let z0 = config.curve.encode(base.start[c]);
            let z1 = match config.curve {
                Curve::Log => 2.0 * stored[TARGET + c] - 1.0,
                Curve::Srgb => config.curve.encode(exposed),
            };
            let noise = if base_time > 0.0 { normal(rng) } else { 0.0 };
            state[0][c] = z0;
            state[1][c] = bridge.interpolate(z0, z1, base_time, noise);
            state[2][c] = z1;
            state[3][c] = linear_to_srgb(exposed.clamp(0.0, 1.0));
        }
        let channels = config.pixel_channels();
        // Pixel-unshuffle: the four pixels of a 2 x 2 block become neighbours along the channels.
        let at = (((y / 2) * (size / 2) + x / 2) * 4 + (y % 2) * 2 + x % 2) * channels;
        write_input(config, state[1], &stored, &mut self.input[at..at + channels]);
        for part in [base.lit, base.specular, base.tint, base.rest, state[0], state[1]] {
            self.base.extend_from_slice(&part);
        }
        self.alpha.push(base.alpha);
        self.mask.push(if base.alpha > 0.0 { 1.0 } else { 0.0 });
        self.target.extend_from_slice(&state[2]);
        self.target.extend_from_slice(&state[3]);
        if let Some(keys) = &frame.keys {
            keys.read(index, &mut self.keys);
            keyframe::push_guides(&stored, &mut self.guides);
            self.noise.extend([(); 3].map(|()| normal(rng)));
        }
    }
}

fn draw_item(frames: &[&StoredFrame], size: usize, bridge: Bridge, rng: &mut Pcg64Mcg) -> Item {
    let coverage = Input::Coverage.offset();
    let mut item = Item { frame: 0, x: 0, y: 0, flip: false, time: 0.0, noise_seed: 0 };
    // A crop of sky teaches nothing: look for one that is covered at one point in eight at least, up to four times.
    for _ in 0..4 {
        item.frame = rng.random_range(0..frames.len());
        let frame = frames[item.frame];
        // Even corners, so that the 2 x 2 blocks of the codec are those of the whole picture.
        item.x = 2 * rng.random_range(0..=(frame.width - size) / 2);
        item.y = 2 * rng.random_range(0..=(frame.height - size) / 2);
        let step = size / 8;
        let covered = (0..64)
            .filter(|i| {
                let (x, y) = (item.x + (i % 8) * step + step / 2, item.y + (i / 8) * step + step / 2);
                frame.pixels[(y * frame.width + x) * STORED + coverage] > f16::ZERO
            })
            .count();
        if covered >= 8 {
            break;
        }
    }
    item.flip = rng.random_bool(0.5);
    item.time = bridge.times.draw(rng);
    item.noise_seed = rng.random();
    item
}
