//! The frames of a clip as pictures in memory, in half precision.

use crate::Result;
use crate::data::Clip;
use crate::train::pool::Stored;
use crate::wan::pictures::{BridgeStart, EnvironmentView, Kind, Pictures};
use half::f16;
use half::slice::HalfFloatSliceExt;
use rayon::prelude::*;
use renderflow_frame::image::{Image, Rgb};
use renderflow_frame::{DepthBounds, Frame, FrameInfo};

/// All frames of a clip as pictures of one size.
#[derive(Clone, Debug, Default)]
pub struct ClipPictures {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Frames in order.
    pub frames: Vec<FramePictures>,
}

/// The pictures of one frame.
#[derive(Clone, Debug, Default)]
pub struct FramePictures {
    /// Number of the frame in its sequence.
    pub number: usize,
    /// `[3, height, width]` for each [`Kind`].
    kinds: [Vec<f16>; 6],
    /// `[1, height, width]`: 1 where the pixel sees a surface.
    mask: Vec<f16>,
}

/// A window of a picture, in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    /// First row.
    pub top: usize,
    /// First column.
    pub left: usize,
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
}

impl Stored for ClipPictures {
    fn bytes(&self) -> usize {
        let values = |frame: &FramePictures| frame.kinds.iter().map(Vec::len).sum::<usize>() + frame.mask.len();
        2 * self.frames.iter().map(values).sum::<usize>()
    }
}

impl ClipPictures {
    /// The pictures of `clip`, at least `least` pixels a side. With `size`, frames whose shorter side is at least twice `size`
    /// are reduced until it is between `size` and twice `size`. Sides are cut to multiples of `multiple`, at the right and at the
    /// bottom.
    ///
    /// A reduced G-buffer takes the sample in the middle of each new pixel, and the truth takes the mean radiance, as if the
    /// frame had been rendered at that size.
    ///
    /// # Errors
    /// [`crate::Error::Data`] when the clip cannot be used, when its frames are too small, or when they differ in size.
    pub fn new(clip: &Clip, size: Option<usize>, least: usize, multiple: usize) -> Result<Self> {
        Self::starting(BridgeStart::Albedo, clip, size, least, multiple)
    }

    /// As [`Self::new`], for a bridge that begins with `start`.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn starting(start: BridgeStart, clip: &Clip, size: Option<usize>, least: usize, multiple: usize) -> Result<Self> {
        clip.check()?;
        let (width, height) = (clip.frames[0].width, clip.frames[0].height);
        if let Some(frame) = clip.frames.iter().find(|f| (f.width, f.height) != (width, height)) {
            return Err(clip.broken(format!("frames of {width}x{height} and of {}x{}", frame.width, frame.height)));
        }
        let factor = size.map_or(1, |size| (width.min(height) / size.max(1)).max(1));
        let (w, h) = (width / factor, height / factor);
        let (cut_w, cut_h) = (w - w % multiple, h - h % multiple);
        if cut_w.min(cut_h) < least.max(1) {
            return Err(clip.broken(format!("frames of {width}x{height} are smaller than the {least} pixels of a batch")));
        }
        let bounds = DepthBounds::of(&clip.frames);
        let view = EnvironmentView::new(&clip.light.environment, cut_w, cut_h);
        let frames = (0..clip.frames.len())
            .into_par_iter()
            .map(|i| {
                let reduced;
                let (mut frame, mut shaded) = (&clip.frames[i], clip.shaded.get(i));
                if factor > 1 {
                    reduced = (reduce(frame, factor), shaded.map(|shaded| reduce_radiance(shaded, factor)));
                    (frame, shaded) = (&reduced.0, reduced.1.as_ref());
                }
                let pictures = Pictures::new(frame, &clip.light, &view, bounds)?.starting(start, frame, &clip.light, shaded)?;
                let cut = |planes: &[f32], width: usize, height: usize| {
                    let window = Window { top: 0, left: 0, height: cut_h, width: cut_w };
                    let mut out = Vec::with_capacity(planes.len());
                    for plane in planes.chunks_exact(width * height) {
                        rows(plane, width, window, |row| out.extend(row.iter().map(|v| f16::from_f32(*v))));
                    }
                    out
                };
                let kinds = Kind::ALL.map(|kind| match kind {
                    Kind::Environment => cut(pictures.of(kind), cut_w, cut_h),
                    _ => cut(pictures.of(kind), w, h),
                });
                Ok(FramePictures { number: clip.numbers[i], kinds, mask: cut(&pictures.mask, w, h) })
            })
            .collect::<Result<_>>()?;
        Ok(Self { width: cut_w, height: cut_h, frames })
    }

    /// A window of `count` frames that begin with frame `first`, `[3, count, height, width]`.
    pub fn clip(&self, first: usize, count: usize, kind: Kind, window: Window) -> Vec<f32> {
        let mut clip = Vec::with_capacity(3 * count * window.height * window.width);
        let plane = self.width * self.height;
        for channel in 0..3 {
            for frame in &self.frames[first..first + count] {
                self.read_planes(&frame.kinds[kind as usize][channel * plane..][..plane], window, &mut clip);
            }
        }
        clip
    }

    /// The masks of `count` frames that begin with frame `first`, `[1, count, height, width]`.
    pub fn masks(&self, first: usize, count: usize, window: Window) -> Vec<f32> {
        let mut masks = Vec::with_capacity(count * window.height * window.width);
        self.frames[first..first + count].iter().for_each(|frame| self.read_planes(&frame.mask, window, &mut masks));
        masks
    }

    /// The window that covers the whole picture.
    pub fn whole(&self) -> Window {
        Window { top: 0, left: 0, height: self.height, width: self.width }
    }

    fn read_planes(&self, planes: &[f16], window: Window, out: &mut Vec<f32>) {
        for plane in planes.chunks_exact(self.width * self.height) {
            read_window(plane, self.width, window, out);
        }
    }

    /// Keeps the pictures of these kinds, and drops the others.
    pub fn keeping(mut self, kinds: &[Kind]) -> Self {
        for frame in &mut self.frames {
            let others = Kind::ALL.into_iter().filter(|kind| !kinds.contains(kind));
            others.for_each(|kind| frame.kinds[kind as usize] = Vec::new());
        }
        self
    }

    /// Smallest distance between the numbers of two neighbouring frames: 1, or more where a dataset stores every n-th frame.
    pub fn stride(&self) -> usize {
        let distances = self.frames.windows(2).map(|pair| pair[1].number.saturating_sub(pair[0].number));
        distances.min().unwrap_or(1).max(1)
    }

    /// The frames that `step` more frames follow without a gap, each one [`Self::stride`] after the one before it.
    pub fn starts(&self, step: usize) -> Vec<usize> {
        let (frames, distance) = (&self.frames, step * self.stride());
        (0..frames.len()).filter(|&i| i + step < frames.len() && frames[i + step].number == frames[i].number + distance).collect()
    }
}

/// Appends a window of a plane of `width` columns to `out`.
pub(super) fn read_window(plane: &[f16], width: usize, window: Window, out: &mut Vec<f32>) {
    rows(plane, width, window, |row| {
        let at = out.len();
        out.resize(at + row.len(), 0.0);
        row.convert_to_f32_slice(&mut out[at..]);
    });
}

fn rows<T>(plane: &[T], width: usize, window: Window, mut row: impl FnMut(&[T])) {
    for y in window.top..window.top + window.height {
        row(&plane[y * width + window.left..][..window.width]);
    }
}

/// Mean of `value` over the pixels that become pixel `x`, `y`.
fn mean(factor: usize, x: usize, y: usize, value: impl Fn(usize, usize) -> f32) -> f32 {
    let cells = (0..factor * factor).map(|i| value(x * factor + i % factor, y * factor + i / factor));
    cells.sum::<f32>() / (factor * factor) as f32
}

/// Radiance whose sides are divided by `factor`. Remainders at the right and at the bottom are left out.
fn reduce_radiance(image: &Rgb, factor: usize) -> Rgb {
    let (width, height) = (image.width / factor, image.height / factor);
    Rgb::from_fn(width, height, |x, y| [0, 1, 2].map(|c| mean(factor, x, y, |x, y| image.at(x, y)[c])))
}

/// A frame whose sides are divided by `factor`. Remainders at the right and at the bottom are left out.
fn reduce(frame: &Frame, factor: usize) -> Frame {
    let (width, height) = (frame.width / factor, frame.height / factor);
    let middle = |x: usize| x * factor + factor / 2;
    let sample = |image: &Rgb| Rgb::from_fn(width, height, |x, y| *image.at(middle(x), middle(y)));
    Frame {
        width,
        height,
        beauty: frame.beauty.as_ref().map(|image| reduce_radiance(image, factor)),
        alpha: Image::from_fn(width, height, |x, y| mean(factor, x, y, |x, y| *frame.alpha.at(x, y))),
        albedo: sample(&frame.albedo),
        normal: sample(&frame.normal),
        depth: Image::from_fn(width, height, |x, y| *frame.depth.at(middle(x), middle(y))),
        material: sample(&frame.material),
        info: FrameInfo { camera: frame.info.camera.resized(width, height), ..FrameInfo::default() },
        ..Frame::default()
    }
}
