//! Clips as latents in memory, made once by the frozen autoencoder.
//!
//! Frames are cut into clips in the same way as when videos are rendered: a clip has 1 + s frames, where s is the number of
//! frames that a latent frame spans (4 with Wan's autoencoder), and begins with the last frame of the clip before it. The first
//! latent frame of a clip is the latent of its first picture alone, so keyframes need no latents of their own. Latents are
//! normalised and kept in half precision: their values are about 1, and its 11 bits are finer than the differences that the
//! autoencoder preserves. A folder can keep them for later stages.

mod store;

pub use store::Store;

use super::clip_pictures::{ClipPictures, Window, read_window};
use crate::Result;
use crate::data::Clip;
use crate::parameters::read;
use crate::train::pool::Stored;
use crate::wan::pictures::{BridgeStart, Kind};
use crate::wan::vae::Vae;
use burn::tensor::{Tensor, TensorData};
use half::f16;

/// The latents of one frame's pictures, each encoded alone.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FrameLatents {
    /// Index of the frame in [`ClipPictures::frames`].
    pub index: usize,
    /// Number of the frame in its sequence.
    pub number: usize,
    /// `[z, h, w]` for each [`Kind`].
    pub(super) kinds: [Vec<f16>; 6],
    /// The second latent frame, where a clip begins with this frame.
    pub(super) next: Option<SecondLatents>,
}

/// The second latent frame of a clip.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct SecondLatents {
    /// `[z, h, w]` for each [`Kind`].
    pub kinds: [Vec<f16>; 6],
    /// The latent of the clip whose first frame is the truth and whose other frames are grey; empty where it is not needed.
    pub reference: Vec<f16>,
}

/// The latents of one clip at one size.
#[derive(Clone, Debug, Default)]
pub struct ClipLatents {
    /// Latent rows.
    pub height: usize,
    /// Latent columns.
    pub width: usize,
    /// Distance between the numbers of neighbouring frames; see [`ClipPictures::stride`].
    pub stride: usize,
    /// Frames in order.
    pub frames: Vec<FrameLatents>,
    /// Pictures that predictions are compared with.
    pub pictures: ClipPictures,
    /// Latents of a grey clip, `[z, 1 or 2, h, w]`.
    pub(super) grey: Vec<f16>,
}

impl Stored for ClipLatents {
    fn bytes(&self) -> usize {
        let kinds = |kinds: &[Vec<f16>; 6]| kinds.iter().map(Vec::len).sum::<usize>();
        let next = |next: &SecondLatents| kinds(&next.kinds) + next.reference.len();
        let frames = self.frames.iter().map(|frame| kinds(&frame.kinds) + frame.next.as_ref().map_or(0, next)).sum::<usize>();
        self.pictures.bytes() + 2 * (frames + self.grey.len())
    }
}

/// One clip at every size, in the order of [`Encoder::sizes`].
impl Stored for Vec<ClipLatents> {
    fn bytes(&self) -> usize {
        self.iter().map(Stored::bytes).sum()
    }
}

/// Encodes clips with the frozen autoencoder.
pub struct Encoder<'a> {
    /// The autoencoder, on a device that does not record operations.
    pub vae: &'a Vae,
    /// Sizes of the pictures in batches; see [`ClipPictures::new`].
    pub sizes: Vec<usize>,
    /// What the bridge begins with.
    pub start: BridgeStart,
    /// Sides of pictures are multiples of this.
    pub multiple: usize,
    /// Whether every frame is encoded alone, not only the first frame of each clip.
    pub stills: bool,
    /// Whether clips of several frames are encoded.
    pub clips: bool,
    /// Whether clips of which only the first frame is given are encoded.
    pub references: bool,
    /// Kinds of pictures that are kept beside the latents. With any, masks are kept too.
    pub pictures: &'a [Kind],
    /// Where latents are looked up and kept.
    pub store: Option<Store>,
}

impl Encoder<'_> {
    /// The latents of a clip at each size.
    ///
    /// # Errors
    /// When the clip cannot be used, when the autoencoder does not fit it, or when a kept file is broken or cannot be written.
    pub fn encode(&self, clip: &Clip) -> Result<Vec<ClipLatents>> {
        self.sizes.iter().map(|&size| self.at_size(clip, size)).collect()
    }

    fn at_size(&self, clip: &Clip, size: usize) -> Result<ClipLatents> {
        let pictures = ClipPictures::starting(self.start, clip, Some(size), size, self.multiple)?;
        let file = self.store.as_ref().map(|store| {
            let mut settings = vec![pictures.width, pictures.height];
            settings.extend([self.stills, self.clips, self.references].map(usize::from));
            // Files with the albedo keep the names that they had before there was a choice.
            settings.extend(match self.start {
                BridgeStart::Albedo | BridgeStart::Noise => None,
                BridgeStart::Lit => Some(1),
                BridgeStart::Deferred => Some(2),
            });
            store.file(clip, &settings)
        });
        let mut latents = match file.as_deref().map(store::read).transpose()?.flatten() {
            Some(latents) => latents,
            None => {
                let latents = self.encode_pictures(&pictures)?;
                file.as_deref().map(|file| store::write(file, &latents)).transpose()?;
                latents
            }
        };
        if !self.pictures.is_empty() {
            latents.pictures = pictures.keeping(self.pictures);
        }
        Ok(latents)
    }

    fn encode_pictures(&self, pictures: &ClipPictures) -> Result<ClipLatents> {
        let config = self.vae.config();
        let (step, factor) = (config.temporal_factor(), config.spatial_factor());
        let starts = if self.clips { pictures.starts(step) } else { Vec::new() };
        let mut frames: Vec<FrameLatents> = Vec::new();
        // The frame that the next clip begins with. Earlier frames belong to the clip before it.
        let mut next = 0;
        for index in 0..pictures.frames.len() {
            let whole = index >= next && starts.binary_search(&index).is_ok();
            // The last frame of a clip begins another clip, or ends a run of frames without gaps.
            if !(self.stills || whole || index >= next) {
                continue;
            }
            if whole {
                next = index + step;
            }
            frames.push(self.frame(pictures, index, if whole { 1 + step } else { 1 })?);
        }
        let count = if self.clips { 1 + step } else { 1 };
        let grey = Tensor::zeros([1, 3, count, pictures.height, pictures.width], &self.vae.device());
        Ok(ClipLatents {
            height: pictures.height / factor,
            width: pictures.width / factor,
            stride: pictures.stride(),
            frames,
            pictures: ClipPictures::default(),
            grey: halves(read(self.vae.encode_normalised(grey)?)?),
        })
    }

    /// The latents of the clip of `count` frames that begins with frame `index`.
    fn frame(&self, pictures: &ClipPictures, index: usize, count: usize) -> Result<FrameLatents> {
        let next = (count > 1).then(SecondLatents::default);
        let mut frame = FrameLatents { index, number: pictures.frames[index].number, next, ..FrameLatents::default() };
        let clip = |kind: Kind| pictures.clip(index, count, kind, pictures.whole());
        let (plane, size) = (pictures.height * pictures.width, [pictures.height, pictures.width]);
        for kind in Kind::ALL {
            let [first, second] = self.latents(clip(kind), count, size)?;
            frame.kinds[kind as usize] = first;
            if let Some(next) = &mut frame.next {
                next.kinds[kind as usize] = second;
            }
        }
        if let (Some(next), true) = (&mut frame.next, self.references) {
            // All pictures but the first are grey.
            let mut reference = clip(Kind::Target);
            reference.chunks_exact_mut(count * plane).for_each(|channel| channel[plane..].fill(0.0));
            [_, next.reference] = self.latents(reference, count, size)?;
        }
        Ok(frame)
    }

    /// The first and the second latent frame of a clip `[3, count, height, width]`; the second is empty for a single picture.
    fn latents(&self, clip: Vec<f32>, count: usize, [height, width]: [usize; 2]) -> Result<[Vec<f16>; 2]> {
        let clip = Tensor::from_data(TensorData::new(clip, [1, 3, count, height, width]), &self.vae.device());
        let latents = self.vae.encode_normalised(clip)?;
        let frame = |i: usize| read(latents.clone().narrow(2, i, 1)).map(halves);
        Ok([frame(0)?, if count > 1 { frame(1)? } else { Vec::new() }])
    }
}

fn halves(values: Vec<f32>) -> Vec<f16> {
    values.into_iter().map(f16::from_f32).collect()
}

impl ClipLatents {
    /// Whether a clip of several frames begins with a frame.
    pub fn begins_clip(&self, frame: usize) -> bool {
        self.frames.get(frame).is_some_and(|frame| frame.next.is_some())
    }

    /// The index of the frame that comes `distance` frames after another one, or before it if the distance is negative.
    pub fn offset(&self, frame: usize, distance: i64) -> Option<usize> {
        let number = self.frames[frame].number as i64 + distance;
        self.frames.iter().position(|frame| frame.number as i64 == number)
    }

    /// Appends a window of the 1 or 2 latent frames that begin with a frame, `[z, count, window]`.
    pub fn read(&self, frame: usize, count: usize, kind: Kind, window: Window, out: &mut Vec<f32>) {
        let frame = &self.frames[frame];
        let second = frame.next.as_ref().map(|next| next.kinds[kind as usize].as_slice());
        self.interleave(&frame.kinds[kind as usize], second.filter(|_| count > 1), window, out);
    }

    /// Appends the inactive and the reactive latents of a clip, `[2 z, count, window]`. If `given`, the first frame of the clip
    /// is given; otherwise no frame is.
    pub fn read_reference(&self, frame: usize, count: usize, given: bool, window: Window, out: &mut Vec<f32>) {
        let (frame, plane) = (&self.frames[frame], self.height * self.width);
        // Number of latent frames of the grey clip.
        let held = (self.grey.len() / frame.kinds[0].len().max(1)).max(1);
        let grey = |i: usize| -> Vec<f16> {
            self.grey.chunks_exact(held * plane).flat_map(|channel| channel[i * plane..][..plane].to_vec()).collect()
        };
        let (first, second) = (grey(0), if count > 1 { grey(1) } else { Vec::new() });
        let second = (count > 1).then_some(second.as_slice());
        match &frame.next {
            Some(next) if given && count > 1 => {
                self.interleave(&frame.kinds[Kind::Target as usize], Some(&next.reference), window, out);
            }
            _ => self.interleave(&first, second, window, out),
        }
        self.interleave(&first, second, window, out);
    }

    /// Appends, for each channel, the first latent frame and then the second.
    fn interleave(&self, first: &[f16], second: Option<&[f16]>, window: Window, out: &mut Vec<f32>) {
        let plane = self.height * self.width;
        for (c, channel) in first.chunks_exact(plane).enumerate() {
            read_window(channel, self.width, window, out);
            if let Some(second) = second {
                read_window(&second[c * plane..][..plane], self.width, window, out);
            }
        }
    }
}
