//! Clips as latents in memory, made once by the frozen autoencoder, and batches of them.
//!
//! A stretch of frames is cut as long videos are rendered: clips of 1 + s frames (s what a latent frame spans, 4 with Wan's
//! autoencoder), each beginning with the last frame of the one before. The first latent frame of a clip is that of its first
//! picture by itself, so keyframes cost nothing more. Latents are normalised and kept in half precision: their values are about 1,
//! and its 11 bits are finer than what the autoencoder tells apart. They can be kept in a folder, for the stages that follow.

mod store;

pub use store::Store;

use crate::Result;
use crate::data::Clip;
use crate::parameters::to_vec;
use crate::train::pool::Stored;
use crate::wan::pictures::Kind;
use crate::wan::train::album::{Album, Window};
use crate::wan::vae::Vae;
use burn::tensor::{Device, Tensor, TensorData};
use half::f16;

/// One value for each pixel under a latent pixel, `[cells, latent frames, height, width]` with `cells` = s s: 1 where a frame is to be
/// rendered, 0 where `known` (one a frame) says it is given.
///
/// Frames become latent frames as in VACE's code, by the nearest: latent frame j of n shows frame `floor((j + 1/2) T / n)` of T. With
/// the paper's clips of five frames these are the second and the fourth, so that a given first frame is told by the inactive latents
/// alone.
pub fn mask_cells(known: &[bool], latent_frames: usize, cells: usize, plane: usize) -> Vec<f32> {
    let value = |j: usize| {
        let frame = (2 * j + 1) * known.len() / (2 * latent_frames.max(1));
        if known.get(frame).copied().unwrap_or(false) { 0.0 } else { 1.0 }
    };
    let channel: Vec<f32> = (0..latent_frames).flat_map(|j| std::iter::repeat_n(value(j), plane)).collect();
    channel.repeat(cells)
}

/// The latent frame that begins with a picture: that of the picture by itself.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Anchor {
    /// Page of the album.
    pub page: usize,
    /// Number of its frame in the sequence.
    pub number: usize,
    /// `[z, h, w]` of each [`Kind`].
    pub(super) kinds: [Vec<f16>; 6],
    /// What follows, where a clip begins here.
    pub(super) next: Option<Next>,
}

/// The second latent frame of a clip.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Next {
    pub kinds: [Vec<f16>; 6],
    /// Of the clip whose first frame is the truth and whose others are grey; empty where it is not needed.
    pub reference: Vec<f16>,
}

/// One clip at one size.
#[derive(Clone, Debug, Default)]
pub struct ClipLatents {
    /// Latent rows.
    pub height: usize,
    /// Latent columns.
    pub width: usize,
    /// Distance of the numbers of neighbouring frames; see [`Album::stride`].
    pub stride: usize,
    /// In order of their frames.
    pub anchors: Vec<Anchor>,
    /// Pictures that predictions are compared with.
    pub album: Album,
    /// Latents of grey, `[z, 1 or 2, h, w]`.
    pub(super) grey: Vec<f16>,
}

impl Stored for ClipLatents {
    fn bytes(&self) -> usize {
        let kinds = |kinds: &[Vec<f16>; 6]| kinds.iter().map(Vec::len).sum::<usize>();
        let next = |next: &Next| kinds(&next.kinds) + next.reference.len();
        let anchors = self.anchors.iter().map(|a| kinds(&a.kinds) + a.next.as_ref().map_or(0, next)).sum::<usize>();
        self.album.bytes() + 2 * (anchors + self.grey.len())
    }
}

/// All sizes of one clip, in the order of [`Encoder::sizes`].
impl Stored for Vec<ClipLatents> {
    fn bytes(&self) -> usize {
        self.iter().map(Stored::bytes).sum()
    }
}

/// Makes latents.
pub struct Encoder<'a> {
    /// On a device that records nothing.
    pub vae: &'a Vae,
    /// Sides of the pictures to be drawn; see [`Album::new`].
    pub sizes: Vec<usize>,
    /// What sides of pictures are multiples of.
    pub multiple: usize,
    /// Whether every frame is needed by itself, not only the first of each clip.
    pub stills: bool,
    /// Whether clips of several frames are needed.
    pub clips: bool,
    /// Whether the latents of references are needed.
    pub references: bool,
    /// Kinds whose pictures are kept; with any, masks are kept too.
    pub pictures: &'a [Kind],
    /// Where latents are kept and looked for.
    pub store: Option<Store>,
}

impl Encoder<'_> {
    /// The latents of a clip at each size.
    ///
    /// # Errors
    /// When the clip cannot be used, the autoencoder does not fit, or a kept file is broken or cannot be written.
    pub fn encode(&self, clip: &Clip) -> Result<Vec<ClipLatents>> {
        self.sizes.iter().map(|&size| self.at_size(clip, size)).collect()
    }

    fn at_size(&self, clip: &Clip, size: usize) -> Result<ClipLatents> {
        let album = Album::new(clip, Some(size), size, self.multiple)?;
        let file = self.store.as_ref().map(|store| {
            let settings = [album.width, album.height, self.stills.into(), self.clips.into(), self.references.into()];
            store.file(clip, &settings)
        });
        let mut latents = match file.as_deref().map(store::read).transpose()?.flatten() {
            Some(latents) => latents,
            None => {
                let latents = self.of_album(&album)?;
                file.as_deref().map(|file| store::write(file, &latents)).transpose()?;
                latents
            }
        };
        if !self.pictures.is_empty() {
            latents.album = album.keeping(self.pictures);
        }
        Ok(latents)
    }

    fn of_album(&self, album: &Album) -> Result<ClipLatents> {
        let config = self.vae.config();
        let (step, factor) = (config.temporal_factor(), config.spatial_factor());
        let stretches = if self.clips { album.stretches(step) } else { Vec::new() };
        let mut anchors: Vec<Anchor> = Vec::new();
        // The page that the next clip begins with; the pages before it belong to the last.
        let mut begin = 0;
        for page in 0..album.pages.len() {
            let whole = page >= begin && stretches.binary_search(&page).is_ok();
            // The last frame of a clip begins another, or ends its stretch.
            if !(self.stills || whole || page >= begin) {
                continue;
            }
            if whole {
                begin = page + step;
            }
            anchors.push(self.anchor(album, page, if whole { 1 + step } else { 1 })?);
        }
        let frames = if self.clips { 1 + step } else { 1 };
        let nothing = Tensor::zeros([1, 3, frames, album.height, album.width], &Device::flex());
        Ok(ClipLatents {
            height: album.height / factor,
            width: album.width / factor,
            stride: album.stride(),
            anchors,
            album: Album::default(),
            grey: halves(to_vec(self.vae.encode_normalised(nothing)?)),
        })
    }

    fn anchor(&self, album: &Album, page: usize, frames: usize) -> Result<Anchor> {
        let next = (frames > 1).then(Next::default);
        let mut anchor = Anchor { page, number: album.pages[page].number, next, ..Anchor::default() };
        for kind in Kind::ALL {
            let (first, second) = self.frames(album, page, frames, kind, false)?;
            anchor.kinds[kind as usize] = first;
            if let Some(next) = &mut anchor.next {
                next.kinds[kind as usize] = second;
            }
        }
        if let (Some(next), true) = (&mut anchor.next, self.references) {
            next.reference = self.frames(album, page, frames, Kind::Target, true)?.1;
        }
        Ok(anchor)
    }

    /// First and second latent frame of a clip of a kind; where `reference`, all pictures but the first are grey.
    fn frames(&self, album: &Album, page: usize, frames: usize, kind: Kind, reference: bool) -> Result<(Vec<f16>, Vec<f16>)> {
        let (h, w) = (album.height, album.width);
        let mut pictures = album.clip(page, frames, kind, album.whole());
        if reference {
            pictures.chunks_exact_mut(frames * h * w).for_each(|channel| channel[h * w..].fill(0.0));
        }
        let pictures = Tensor::from_data(TensorData::new(pictures, [1, 3, frames, h, w]), &Device::flex());
        let latents = self.vae.encode_normalised(pictures)?;
        let frame = |i: usize| halves(to_vec(latents.clone().narrow(2, i, 1)));
        Ok((frame(0), if frames > 1 { frame(1) } else { Vec::new() }))
    }
}

fn halves(values: Vec<f32>) -> Vec<f16> {
    values.into_iter().map(f16::from_f32).collect()
}

impl ClipLatents {
    /// Whether a clip of several frames begins at an anchor.
    pub fn begins_clip(&self, anchor: usize) -> bool {
        self.anchors.get(anchor).is_some_and(|a| a.next.is_some())
    }

    /// The anchor `frames` frames after another (before it, where negative) of the same stretch of frames.
    pub fn offset(&self, anchor: usize, frames: i64) -> Option<usize> {
        let number = |i: usize| self.anchors[i].number as i64;
        let wanted = number(anchor) + frames;
        self.anchors.iter().position(|a| a.number as i64 == wanted)
    }

    /// Adds latents of a kind, `[z, frames, window]` with 1 or 2 latent frames from an anchor on.
    pub fn read(&self, anchor: usize, frames: usize, kind: Kind, window: Window, out: &mut Vec<f32>) {
        let anchor = &self.anchors[anchor];
        let second = anchor.next.as_ref().map(|next| next.kinds[kind as usize].as_slice());
        self.interleave(&anchor.kinds[kind as usize], second.filter(|_| frames > 1), window, out);
    }

    /// Adds the inactive and the reactive latents of a clip whose first frame is given, or of which nothing is, `[2 z, frames, window]`.
    pub fn read_reference(&self, anchor: usize, frames: usize, given: bool, window: Window, out: &mut Vec<f32>) {
        let plane = self.height * self.width;
        // Latent frames of grey that are held.
        let held = (self.grey.len() / self.anchors[anchor].kinds[0].len().max(1)).max(1);
        let grey = |frame: usize| -> Vec<f16> {
            self.grey.chunks_exact(held * plane).flat_map(|channel| channel[frame * plane..][..plane].to_vec()).collect()
        };
        let (first, second) = (grey(0), if frames > 1 { grey(1) } else { Vec::new() });
        let second = (frames > 1).then_some(second.as_slice());
        match &self.anchors[anchor].next {
            Some(next) if given && frames > 1 => {
                self.interleave(&self.anchors[anchor].kinds[Kind::Target as usize], Some(&next.reference), window, out);
            }
            _ => self.interleave(&first, second, window, out),
        }
        self.interleave(&first, second, window, out);
    }

    /// Channel by channel, the first and then the second latent frame.
    fn interleave(&self, first: &[f16], second: Option<&[f16]>, window: Window, out: &mut Vec<f32>) {
        let plane = self.height * self.width;
        for (c, channel) in first.chunks_exact(plane).enumerate() {
            super::train::album::read_window(channel, self.width, window, out);
            if let Some(second) = second {
                super::train::album::read_window(&second[c * plane..][..plane], self.width, window, out);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masks_show_the_nearest_frame() {
        let cells = |known: &[bool], n: usize| mask_cells(known, n, 1, 1);
        assert_eq!(cells(&[false; 5], 2), [1.0, 1.0]);
        // The second and the fourth of five.
        assert_eq!(cells(&[true, false, false, false, false], 2), [1.0, 1.0]);
        assert_eq!(cells(&[true, true, false, false, false], 2), [0.0, 1.0]);
        assert_eq!(cells(&[false, false, false, true, false], 2), [1.0, 0.0]);
        // 1, 4, 7 of nine; the only one of one.
        assert_eq!(cells(&[false, true, false, false, true, false, false, false, false], 3), [0.0, 0.0, 1.0]);
        assert_eq!(cells(&[true], 1), [0.0]);
        assert_eq!(mask_cells(&[true, true, false, false, false], 2, 3, 2), [0.0, 0.0, 1.0, 1.0].repeat(3));
    }
}
