//! Inference: a frame's G-buffer, its environment and optional keyframes in, scene-linear radiance out.

use crate::bridge;
use crate::config::NetworkConfig;
use crate::features::{Features, STORED, write_input};
use crate::keyframe::{self, Carried, KEYS, KeyInputs, StoredKeys};
use crate::network::{Network, PIXEL_MULTIPLE, heads};
use crate::parameters::to_vec;
use crate::tokens::{EnvironmentSummary, TOKEN_FEATURES, TOKENS};
use crate::weights::{self, WeightsHeader};
use crate::{Error, Result};
use burn::tensor::{Device, Tensor, TensorData};
use rayon::prelude::*;
use renderflow_frame::ibl::IblTables;
use renderflow_frame::image::{Image, Rgb};
use renderflow_frame::tracks::Movement;
use renderflow_frame::{Camera, Environment, Frame};
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

#[cfg(shipped_weights)]
static SHIPPED: Option<&[u8]> = Some(include_bytes!("../weights/compact.safetensors"));
#[cfg(not(shipped_weights))]
static SHIPPED: Option<&[u8]> = None;

/// A network ready to render. Results depend on the inputs only: never on threads, runs or earlier calls.
#[derive(Debug)]
pub struct NeuralRenderer {
    network: Network,
    header: WeightsHeader,
    device: Device,
    /// Summary of the environment seen last; frames of a sequence share it.
    summary: Mutex<Option<(Environment, Arc<EnvironmentSummary>)>>,
}

/// A keyframe whose truth has been turned into what is carried to other frames; made once, used for many frames.
#[derive(Clone, Debug)]
pub struct PreparedKeyframe {
    frame: Frame,
    truth: Rgb,
    start: Rgb,
}

/// A keyframe as seen from the frame to be rendered.
#[derive(Clone, Copy, Debug)]
pub struct Keyframe<'a> {
    /// The keyframe.
    pub prepared: &'a PreparedKeyframe,
    /// Frames from the current frame to the keyframe; negative before it, 0 = this frame is the keyframe.
    pub distance: f32,
    /// How objects moved from the current frame to the keyframe.
    pub movement: Movement<'a>,
}

impl PreparedKeyframe {
    /// `frame` holds the path-traced `beauty`; the other arguments are those of [`NeuralRenderer::render`].
    ///
    /// # Errors
    /// When the frame has no beauty.
    pub fn new(frame: &Frame, camera: &Camera, environment: &Environment, tables: &IblTables, exposure: f32) -> Result<Self> {
        check_exposure(exposure)?;
        if frame.beauty.is_none() {
            return Err(Error::Data { place: "keyframe".into(), reason: "has no beauty".into() });
        }
        let summary = EnvironmentSummary::new(environment);
        let features = Features::new(frame, camera, environment, &summary, tables, exposure);
        let (truth, start) = (keyframe::truth_picture(&features), keyframe::start_picture(&features));
        Ok(Self { truth, start, frame: with_camera(frame, camera) })
    }
}

/// A copy whose header names the camera, which is what warping reads.
fn with_camera(frame: &Frame, camera: &Camera) -> Frame {
    let mut frame = frame.clone();
    frame.info.camera = Some(*camera);
    frame
}

impl NeuralRenderer {
    /// The weights inside this build.
    ///
    /// # Errors
    /// [`Error::NoShippedWeights`] when it carries none.
    pub fn shipped() -> Result<Self> {
        let bytes = SHIPPED.ok_or(Error::NoShippedWeights)?;
        let device = Device::flex();
        let (network, header) = weights::decode(Path::new("shipped weights"), bytes, &device)?;
        Ok(Self::new(network, header, device))
    }

    /// Weights from a file.
    ///
    /// # Errors
    /// When the file cannot be read or is no weights file; the message names file and tensor.
    pub fn load(path: &Path) -> Result<Self> {
        let device = Device::flex();
        let (network, header) = weights::load(path, &device)?;
        Ok(Self::new(network, header, device))
    }

    /// Random weights: renders the start picture. For tests and benchmarks of time.
    ///
    /// # Errors
    /// When the configuration is invalid.
    pub fn untrained(config: &NetworkConfig, seed: u64) -> Result<Self> {
        let device = Device::flex();
        let network = Network::new(config, seed, &device)?;
        let header = WeightsHeader { network: config.clone(), steps: 0, keyframe_steps: 0, seed };
        Ok(Self::new(network, header, device))
    }

    /// From a network in memory, on `device`.
    pub fn new(network: Network, header: WeightsHeader, device: Device) -> Self {
        Self { network, header, device, summary: Mutex::new(None) }
    }

    /// What the weights say about themselves.
    pub fn header(&self) -> &WeightsHeader {
        &self.header
    }

    /// Whether the weights hold a keyframe stage.
    pub fn accepts_keyframes(&self) -> bool {
        self.network.keyframes.is_some()
    }

    /// Scene-linear radiance of a frame in one step from t = 0. `exposure` maps radiance to display-linear
    /// ([`renderflow_frame::ibl::exposure`]). Of `keyframes`, the nearest at or before and the nearest after the frame are used; one at
    /// distance 0 is returned as it is. Pixels without coverage are the environment.
    ///
    /// # Errors
    /// When sizes disagree, the exposure is no positive number, or keyframes are given to weights without a keyframe stage.
    pub fn render(
        &self,
        frame: &Frame,
        camera: &Camera,
        environment: &Environment,
        tables: &IblTables,
        exposure: f32,
        keyframes: &[Keyframe],
    ) -> Result<Rgb> {
        self.render_steps(frame, camera, environment, tables, exposure, keyframes, 1)
    }

    /// [`Self::render`] in `steps` Euler steps of the base bridge (t = k / steps, no noise); the keyframe stage takes one.
    ///
    /// # Errors
    /// As [`Self::render`], and for 0 steps.
    #[allow(clippy::too_many_arguments)]
    pub fn render_steps(
        &self,
        frame: &Frame,
        camera: &Camera,
        environment: &Environment,
        tables: &IblTables,
        exposure: f32,
        keyframes: &[Keyframe],
        steps: usize,
    ) -> Result<Rgb> {
        check_exposure(exposure)?;
        if steps == 0 {
            return Err(Error::config("steps", "must be at least 1"));
        }
        if frame.width == 0 || frame.height == 0 || (camera.width, camera.height) != (frame.width, frame.height) {
            let reason = format!("{}x{} pixels with a camera of {}x{}", frame.width, frame.height, camera.width, camera.height);
            return Err(Error::Data { place: "frame".into(), reason });
        }
        if let Some(key) = keyframes.iter().find(|key| key.distance == 0.0)
            && let Some(beauty) = &key.prepared.frame.beauty
        {
            return Ok(beauty.clone());
        }
        let summary = self.summary(environment);
        let features = Features::new(frame, camera, environment, &summary, tables, exposure);
        let mut exposed = self.base(&features, steps);
        if !keyframes.is_empty() {
            exposed = self.with_keyframes(&with_camera(frame, camera), &features, exposed, keyframes)?;
        }
        // Uncovered pixels are written from the environment itself, so that no rounding touches them.
        Ok(Image::from_fn(frame.width, frame.height, |x, y| {
            let i = y * frame.width + x;
            let p = &features.physical[i];
            if p.alpha == 0.0 { environment_pixel(p.background, exposure) } else { exposed[i].map(|v| v / exposure) }
        }))
    }

    fn summary(&self, environment: &Environment) -> Arc<EnvironmentSummary> {
        // A poisoned lock only means that another thread panicked while holding a cache entry.
        let lock = || self.summary.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((known, summary)) = &*lock()
            && known == environment
        {
            return summary.clone();
        }
        // Made without the lock: this runs on rayon, where a waiting thread may pick up another frame and come back here.
        let summary = Arc::new(EnvironmentSummary::new(environment));
        *lock() = Some((environment.clone(), summary.clone()));
        summary
    }

    /// Exposed radiance predicted by the base network.
    fn base(&self, features: &Features, steps: usize) -> Vec<[f32; 3]> {
        let config = self.network.config();
        let base: Vec<_> = features.physical.iter().map(|p| p.base(config.start)).collect();
        let mut exposed: Vec<[f32; 3]> = base.iter().map(|b| b.start).collect();
        if features.physical.iter().all(|p| p.alpha == 0.0) {
            return exposed;
        }
        let padding = Padding::new(features);
        let tokens = Tensor::<3>::from_data(TensorData::new(features.tokens.clone(), [1, TOKENS, TOKEN_FEATURES]), &self.device);
        let mut z: Vec<[f32; 3]> = exposed.iter().map(|x| x.map(|v| config.curve.encode(v))).collect();
        for step in 0..steps {
            let t = step as f32 / steps as f32;
            let x = padding.input(config, features, &z, &self.device);
            let t_tensor = Tensor::<3>::from_data(TensorData::new(vec![t], [1, 1, 1]), &self.device);
            let outputs = to_vec(self.network.heads(x, tokens.clone(), t_tensor));
            let channels = config.start.head_channels();
            exposed.par_iter_mut().enumerate().for_each(|(i, exposed)| {
                let at = padding.index(i) * channels;
                *exposed = heads::apply_pixel(config.start, config.curve, &outputs[at..at + channels], &base[i]);
            });
            for (z, exposed) in z.iter_mut().zip(&exposed) {
                for c in 0..3 {
                    z[c] += bridge::velocity(config.curve.encode(exposed[c]), z[c], t) / steps as f32;
                }
            }
        }
        exposed
    }

    fn with_keyframes(
        &self,
        frame: &Frame,
        features: &Features,
        exposed: Vec<[f32; 3]>,
        keyframes: &[Keyframe],
    ) -> Result<Vec<[f32; 3]>> {
        let Some(network) = &self.network.keyframes else {
            return Err(Error::config("keyframes", "these weights have no keyframe stage"));
        };
        for key in keyframes {
            if (key.prepared.frame.width, key.prepared.frame.height) != (frame.width, frame.height) || !key.distance.is_finite() {
                return Err(Error::Data {
                    place: "keyframe".into(),
                    reason: "differs in size from the frame, or has no finite distance".into(),
                });
            }
        }
        let carried = carry(frame, features, keyframes);
        if carried.iter().flatten().all(|key| key.valid.pixels.iter().all(|v| *v == 0.0)) {
            return Ok(exposed);
        }
        let curve = self.network.config().curve;
        let padding = Padding::new(features);
        let stored = StoredKeys::new(features.width, features.height, &carried);
        let picture = |channels: usize, write: &dyn Fn(usize, &mut Vec<f32>)| {
            let mut values = Vec::with_capacity(padding.width * padding.height * channels);
            for i in 0..padding.width * padding.height {
                write(padding.source(i), &mut values);
            }
            Tensor::<4>::from_data(TensorData::new(values, [1, padding.height, padding.width, channels]), &self.device)
        };
        let inputs = KeyInputs {
            keys: picture(keyframe::CHANNELS, &|i, out| stored.read(i, out)),
            guides: picture(keyframe::GUIDES, &|i, out| keyframe::push_guides(&features.pixels[i * STORED..][..STORED], out)),
            base: picture(3, &|i, out| out.extend(exposed[i].map(|v| curve.encode(v)))),
        };
        let z0 = keyframe::start(&inputs);
        let time = Tensor::<4>::zeros([1, 1, 1, 1], &self.device);
        let z = to_vec(network.forward(&inputs, z0, time));
        Ok((0..exposed.len())
            .map(|i| {
                let at = padding.index(i) * 3;
                [z[at], z[at + 1], z[at + 2]].map(|v| curve.decode(v))
            })
            .collect())
    }
}

/// The nearest keyframes before and after, carried to the frame.
fn carry(frame: &Frame, features: &Features, keyframes: &[Keyframe]) -> [Option<Carried>; KEYS] {
    let nearest = |side: &dyn Fn(f32) -> bool| {
        let candidates = keyframes.iter().filter(|key| side(key.distance));
        candidates.min_by(|a, b| a.distance.abs().total_cmp(&b.distance.abs()))
    };
    [nearest(&|d| d <= 0.0), nearest(&|d| d > 0.0)].map(|key| {
        key.map(|Keyframe { prepared, distance, movement }| {
            keyframe::carry(frame, features, &prepared.frame, &prepared.truth, &prepared.start, *distance, *movement)
        })
    })
}

/// The picture of "warped keyframes, split sum in the holes" without any network: scene-linear radiance. The baseline that the
/// keyframe stage has to beat; arguments as in [`NeuralRenderer::render`].
///
/// # Errors
/// When the exposure is no positive number or sizes disagree.
pub fn warp_only(
    frame: &Frame,
    camera: &Camera,
    environment: &Environment,
    tables: &IblTables,
    exposure: f32,
    keyframes: &[Keyframe],
) -> Result<Rgb> {
    let config = NetworkConfig::default();
    check_exposure(exposure)?;
    if keyframes.iter().any(|key| (key.prepared.frame.width, key.prepared.frame.height) != (frame.width, frame.height)) {
        return Err(Error::Data { place: "keyframe".into(), reason: "differs in size from the frame".into() });
    }
    let summary = EnvironmentSummary::new(environment);
    let features = Features::new(frame, camera, environment, &summary, tables, exposure);
    let carried = carry(&with_camera(frame, camera), &features, keyframes);
    Ok(Image::from_fn(frame.width, frame.height, |x, y| {
        let i = y * frame.width + x;
        let p = &features.physical[i];
        let (mut sum, mut total) = ([0.0; 3], 0.0);
        for key in carried.iter().flatten() {
            let weight = key.valid.pixels[i] / (key.age + 1.0 / 16.0);
            total += weight;
            for (sum, radiance) in sum.iter_mut().zip(key.radiance.pixels[i]) {
                *sum += weight * config.curve.encode(radiance);
            }
        }
        if p.alpha == 0.0 {
            environment_pixel(p.background, exposure)
        } else if total > 0.0 {
            sum.map(|v| config.curve.decode(v / total) / exposure)
        } else {
            p.base(config.start).start.map(|v| v / exposure)
        }
    }))
}

fn environment_pixel(background: [f32; 3], exposure: f32) -> [f32; 3] {
    background.map(|v| v / exposure)
}

fn check_exposure(exposure: f32) -> Result<()> {
    if exposure.is_finite() && exposure > 0.0 {
        Ok(())
    } else {
        Err(Error::config("exposure", format!("{exposure} is not a positive number")))
    }
}

/// A frame's place inside the padded picture: the frame at the top left, its last row and column repeated.
struct Padding {
    frame_width: usize,
    frame_height: usize,
    width: usize,
    height: usize,
}

impl Padding {
    fn new(features: &Features) -> Self {
        let pad = |size: usize| size.next_multiple_of(PIXEL_MULTIPLE);
        Self {
            frame_width: features.width,
            frame_height: features.height,
            width: pad(features.width),
            height: pad(features.height),
        }
    }

    /// Padded index of a frame pixel.
    fn index(&self, i: usize) -> usize {
        (i / self.frame_width) * self.width + i % self.frame_width
    }

    /// Frame pixel shown at a padded index.
    fn source(&self, i: usize) -> usize {
        let (x, y) = (i % self.width, i / self.width);
        y.min(self.frame_height - 1) * self.frame_width + x.min(self.frame_width - 1)
    }

    /// Pixel-unshuffled network input `[1, h/2, w/2, 4 c]`.
    fn input(&self, config: &NetworkConfig, features: &Features, z: &[[f32; 3]], device: &Device) -> Tensor<4> {
        let channels = config.pixel_channels();
        let (half_width, half_height) = (self.width / 2, self.height / 2);
        let mut values = vec![0.0; self.width * self.height * channels];
        values.par_chunks_exact_mut(4 * channels).enumerate().for_each(|(block, values)| {
            let (x, y) = (block % half_width, block / half_width);
            for (sub, values) in values.chunks_exact_mut(channels).enumerate() {
                let i = self.source((2 * y + sub / 2) * self.width + 2 * x + sub % 2);
                write_input(config, z[i], &features.pixels[i * STORED..][..STORED], values);
            }
        });
        Tensor::from_data(TensorData::new(values, [1, half_height, half_width, 4 * channels]), device)
    }
}
