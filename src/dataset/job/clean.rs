//! Denoises path-traced pictures, by OIDN or by the network inside the program.

use crate::dataset::around::{Carried, Traced, add_up, offer};
use crate::dataset::denoise::Denoise;
use crate::dataset::job::TruthSettings;
use crate::dataset::shading::{BUFFERS, OWN_BUFFER};
use crate::util::cancel::{Cancel, Interrupted};
use crate::util::device;
use crate::util::stop;
use anyhow::{Context, Result};
use renderflow_frame::ibl;
use renderflow_frame::image::Rgb;
use renderflow_frame::{Camera, Frame};
use renderflow_model::device::NetworkDevice;
use renderflow_model::fusion::fill::{Samples, background};
use renderflow_model::fusion::record::Selection;
use renderflow_model::fusion::{Fusion, Record};
use renderflow_renderer::denoise::{DenoiseError, Denoiser, Options};
use renderflow_renderer::{Budget, RenderScene, Settings, render_gbuffer_until};
use std::sync::{Arc, Mutex, PoisonError};

/// Bytes of a pixel of three channels.
const RGB: u64 = size_of::<[f32; 3]>() as u64;
/// Pixels of the largest tile that OIDN denoises at a time, and the bytes that its network takes for one of them.
const OIDN_TILE: u64 = 2160 * 2160;
const OIDN_NETWORK: u64 = 480;
/// Bytes for each pixel of the record that the network reads and of its picture, and bytes for each pixel that the network is
/// working on.
const NEURAL_RECORD: u64 = 820;
const NEURAL_NETWORK: u64 = 930;

/// The network inside the program was trained with pictures of at most this many samples for each pixel.
const NEURAL_MOST: u32 = 16;

/// A denoiser at work.
pub(super) enum Cleaner {
    Oidn(Mutex<Denoiser>),
    Neural {
        network: Arc<Fusion>,
        /// Also denoises the samples; the network reads the result.
        oidn: Option<Mutex<Denoiser>>,
        /// Name in the headers of frames. It includes a hash of the weights, because other weights make other pictures.
        name: String,
    },
}

impl Cleaner {
    /// Opens the denoiser that `mode` asks for; `settings` are the settings of the pictures, `device` is that of the network.
    ///
    /// # Errors
    /// When the mode asks for a denoiser that is not found.
    pub(super) fn open(mode: Denoise, settings: &Settings, device: &NetworkDevice) -> Result<Option<Self>> {
        let clean_guides = settings.clean_guides();
        let oidn = || Denoiser::with_options(Options { clean_guides, ..Options::default() });
        Ok(match mode {
            Denoise::None => None,
            Denoise::Oidn => Some(Self::Oidn(Mutex::new(oidn()?))),
            Denoise::Neural => {
                if settings.spp > NEURAL_MOST {
                    let spp = settings.spp;
                    eprintln!(
                        "note: the network learned from up to {NEURAL_MOST} samples per pixel; with {spp} OIDN has less error"
                    );
                }
                // The G-buffer that the network reads has guides that are clean.
                Some(Self::neural(Arc::new(Fusion::shipped()?.to(device)?), Denoiser::new().ok()))
            }
            Denoise::Auto => match oidn() {
                Ok(denoiser) => Some(Self::Oidn(Mutex::new(denoiser))),
                Err(error) => {
                    eprintln!("warning: pictures stay noisy: {error}");
                    None
                }
            },
        })
    }

    /// The network, which also reads what `oidn` makes of the samples.
    pub(super) fn neural(network: Arc<Fusion>, oidn: Option<Denoiser>) -> Self {
        let mut hasher = blake3::Hasher::new();
        for parameter in network.parameters() {
            parameter.values.iter().for_each(|v| {
                hasher.update(&v.to_le_bytes());
            });
        }
        let digest = hasher.finalize().to_hex();
        let after = if oidn.is_some() { "oidn + " } else { "" };
        let on = device::recorded(network.device()).map_or(String::new(), |device| format!(" on {device}"));
        Self::Neural { network, oidn: oidn.map(Mutex::new), name: format!("{after}neural {}{on}", &digest[..16]) }
    }

    /// Name in the headers of frames.
    pub(super) fn name(&self) -> &str {
        match self {
            Self::Oidn(_) => "oidn",
            Self::Neural { name, .. } => name,
        }
    }

    /// Whether it reads what samples are made of.
    pub(super) fn reads_paths(&self) -> bool {
        matches!(self, Self::Neural { network, .. } if network.header().fusion.paths)
    }

    /// Bytes that denoising a picture of this many pixels takes, and how many of them are kept for the next picture.
    pub(super) fn bytes(&self, pixels: u64) -> [u64; 2] {
        let each = |bytes: u64| pixels.saturating_mul(bytes);
        match self {
            // OIDN's own pictures, and the copies that it is given.
            Self::Oidn(_) => [oidn_bytes(pixels).saturating_add(each(3 * RGB)), oidn_bytes(pixels)],
            Self::Neural { network, oidn, .. } => {
                let tile = pixels.min(network.tile_pixels() as u64);
                let network = each(NEURAL_RECORD).saturating_add(tile * NEURAL_NETWORK);
                match oidn {
                    Some(_) => [network.saturating_add(each(3 * RGB)).saturating_add(oidn_bytes(pixels)), oidn_bytes(pixels)],
                    None => [network, 0],
                }
            }
        }
    }

    /// Opens OIDN once more where it denoises the samples of `frames` frames at once: their guides may be clean where those of
    /// one are not.
    ///
    /// # Errors
    /// When it is not found.
    pub(super) fn reopen(&mut self, settings: &Settings, frames: usize) -> Result<()> {
        if let Self::Oidn(denoiser) = self {
            let all = Settings { spp: settings.spp.saturating_mul(frames as u32), ..*settings };
            *denoiser = Mutex::new(Denoiser::with_options(Options { clean_guides: all.clean_guides(), ..Options::default() })?);
        }
        Ok(())
    }

    /// Denoises `frame`, at which `scene` stands, with the samples of the frames `around`.
    ///
    /// # Errors
    /// When stopped ([`Interrupted`]), when the denoiser fails, or when the frame has no samples.
    pub(super) fn clean(
        &self,
        scene: &RenderScene,
        frame: &Frame,
        around: Option<Around>,
        settings: &Settings,
        cancel: &Cancel,
    ) -> Result<Rgb> {
        match self {
            Self::Oidn(denoiser) => {
                if let Some(Around { own, others, .. }) = around {
                    let (raw, guides) = add_up(own, others.iter().map(|(_, other)| other), &frame.object_id);
                    let [albedo, normal] = guides.as_ref().map_or([None; 2], |[albedo, normal]| [Some(albedo), Some(normal)]);
                    return denoise(denoiser, &raw, [albedo, normal], cancel);
                }
                let raw = frame.raw.as_ref().context("the path tracer made no picture")?;
                denoise(denoiser, raw, [frame.guide_albedo.as_ref(), frame.guide_normal.as_ref()], cancel)
            }
            Self::Neural { network, oidn, .. } => {
                // The network was trained with G-buffers of this many camera rays for each pixel, even where there are fewer
                // samples. Samples that are spread by detail have as good a one of their own.
                let usual = Settings { channels: BUFFERS, ..Settings::default() };
                let own = settings.budget == Budget::Detail && settings.spp >= OWN_BUFFER && settings.lens.is_none();
                let few = settings.camera_samples() < usual.guide_samples && !(own && around.is_none());
                let gbuffer = few.then(|| render_gbuffer_until(scene, &usual, cancel)).transpose();
                cancel.check()?;
                let gbuffer = gbuffer?;
                fuse(network, oidn.as_ref(), scene, [frame, gbuffer.as_ref().unwrap_or(frame)], around, cancel)
            }
        }
    }
}

impl TruthSettings {
    /// The same settings for frames that keep indirect and hidden light.
    pub fn with_paths(mut self) -> Self {
        (self.keeps_paths, self.render.channels.paths) = (true, true);
        self
    }

    /// Whether frames are stored with indirect and hidden light: because they should have it, or because the denoiser reads it
    /// once all are rendered.
    pub(super) fn stores_paths(&self) -> bool {
        self.keeps_paths || self.denoises_later() && self.denoiser.as_ref().is_some_and(Cleaner::reads_paths)
    }

    /// Takes what only the denoiser reads out of a frame.
    pub(super) fn drop_paths(&self, frame: &mut Frame) {
        if !self.keeps_paths {
            (frame.indirect, frame.hidden) = (None, None);
        }
    }
}

/// Samples of the frames around the one that is denoised.
#[derive(Clone, Copy)]
pub struct Around<'a> {
    /// Place of the frame in the sequence.
    pub index: usize,
    /// Its own samples.
    pub own: &'a Traced,
    /// Samples of other frames, each with its place, nearest first.
    pub others: &'a [(usize, Carried<'a>)],
    /// Cameras, by place.
    pub cameras: &'a [Camera],
}

/// The picture that the network makes of `samples`, a path-traced frame, with the G-buffer of `guides`, and with the samples of
/// the frames `around`. `scene` stands at the frame.
///
/// # Errors
/// When stopped ([`Interrupted`]), when a denoiser fails, or when the frame has no samples.
pub fn fuse(
    network: &Fusion,
    oidn: Option<&Mutex<Denoiser>>,
    scene: &RenderScene,
    [samples, guides]: [&Frame; 2],
    around: Option<Around>,
    cancel: &Cancel,
) -> Result<Rgb> {
    let (camera, light, exposure) = (scene.camera(), scene.light(), scene.exposure());
    let shading = ibl::shade(guides, light);
    let mut record = Record::of(guides, &shading.surfaces, exposure);
    record.add_environment(&shading, exposure);
    let behind = background(camera, &samples.alpha, &light.environment);
    record.add_part(0, &Samples::of(samples, &behind).context("samples without guides")?, exposure);
    if let Some(Around { index, others, cameras, .. }) = around {
        let near = others.iter().map(|(there, other)| (*there, other));
        offer(&mut record, index, near, |there| cameras[there], (&light.environment, exposure))?;
    }
    if let Some(oidn) = oidn {
        let [color, albedo, normal] = record.noisy(&Selection::all(&record), exposure);
        record.add_denoised(0, &denoise(oidn, &color, [Some(&albedo), Some(&normal)], cancel)?, exposure);
    }
    cancel.check()?;
    let pixels = network.render(&record)?.into_iter().map(|rgb| rgb.map(|v| v / exposure)).collect();
    Ok(Rgb { width: record.width, height: record.height, pixels })
}

/// Bytes that OIDN takes for a picture of this many pixels: its own copies (colour, two guides, the result) and its network.
fn oidn_bytes(pixels: u64) -> u64 {
    pixels.saturating_mul(4 * RGB).saturating_add(pixels.min(OIDN_TILE) * OIDN_NETWORK)
}

/// Denoises `color` with OIDN, guided by albedo and normals.
///
/// # Errors
/// When stopped ([`Interrupted`]), or when OIDN fails.
pub fn denoise(denoiser: &Mutex<Denoiser>, color: &Rgb, [albedo, normal]: [Option<&Rgb>; 2], cancel: &Cancel) -> Result<Rgb> {
    let mut denoiser = denoiser.lock().unwrap_or_else(PoisonError::into_inner);
    // OIDN must not be running when the process ends; it stops when `cancel` is set.
    match stop::hold(|| denoiser.denoise_until(color, albedo, normal, cancel)) {
        Err(DenoiseError::Cancelled) => Err(Interrupted.into()),
        denoised => Ok(denoised?),
    }
}
