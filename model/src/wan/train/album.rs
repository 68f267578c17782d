//! Clips as pictures in memory, in half precision.

use crate::Result;
use crate::data::Clip;
use crate::train::pool::Stored;
use crate::wan::pictures::{DepthBounds, EnvironmentView, Kind, Pictures};
use half::f16;
use half::slice::HalfFloatSliceExt;
use rayon::prelude::*;
use renderflow_frame::image::{Image, Rgb};
use renderflow_frame::{Frame, FrameInfo};

/// All frames of a clip as pictures.
#[derive(Clone, Debug, Default)]
pub struct Album {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Frames in order.
    pub pages: Vec<Page>,
}

/// One frame.
#[derive(Clone, Debug, Default)]
pub struct Page {
    /// Its number in the sequence.
    pub number: usize,
    /// `[3, height, width]` of each [`Kind`].
    kinds: [Vec<f16>; 6],
    /// `[1, height, width]`: 1 where a surface is seen.
    mask: Vec<f16>,
}

/// A window of a picture, pixels.
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

impl Stored for Album {
    fn bytes(&self) -> usize {
        let page = |page: &Page| page.kinds.iter().map(Vec::len).sum::<usize>() + page.mask.len();
        2 * self.pages.iter().map(page).sum::<usize>()
    }
}

impl Album {
    /// The pictures of `clip`, no smaller than `least` pixels a side. With `size`, frames of twice that and more are reduced: their
    /// shorter side is then `size` to twice `size`. Sides are cut to multiples of `multiple`, at the right and below.
    ///
    /// A reduced G-buffer is a sample in the middle of each pixel, and the truth the mean of radiance, as if rendered so.
    ///
    /// # Errors
    /// [`crate::Error::Data`] when the clip cannot be used or its frames are too small or not all of one size.
    pub fn new(clip: &Clip, size: Option<usize>, least: usize, multiple: usize) -> Result<Self> {
        clip.check()?;
        let (width, height) = (clip.frames[0].width, clip.frames[0].height);
        if let Some(frame) = clip.frames.iter().find(|f| (f.width, f.height) != (width, height)) {
            return Err(clip.broken(format!("frames of {width}x{height} and of {}x{}", frame.width, frame.height)));
        }
        let factor = size.map_or(1, |size| (width.min(height) / size.max(1)).max(1));
        let (w, h) = (width / factor, height / factor);
        let (cut_w, cut_h) = (w - w % multiple, h - h % multiple);
        if cut_w.min(cut_h) < least.max(1) {
            return Err(clip.broken(format!("frames of {width}x{height} are smaller than the pictures of {least} to be drawn")));
        }
        let bounds = DepthBounds::of(&clip.frames);
        let view = EnvironmentView::new(&clip.light.environment, cut_w, cut_h);
        let pages = (0..clip.frames.len())
            .into_par_iter()
            .map(|i| {
                let reduced;
                let mut frame = &clip.frames[i];
                if factor > 1 {
                    reduced = reduce(frame, factor);
                    frame = &reduced;
                }
                let pictures = Pictures::new(frame, &clip.light, &view, bounds)?;
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
                Ok(Page { number: clip.numbers[i], kinds, mask: cut(&pictures.mask, w, h) })
            })
            .collect::<Result<_>>()?;
        Ok(Self { width: cut_w, height: cut_h, pages })
    }

    /// `frames` pages from `page` on, `[3, frames, height, width]`.
    pub fn clip(&self, page: usize, frames: usize, kind: Kind, window: Window) -> Vec<f32> {
        let mut clip = Vec::with_capacity(3 * frames * window.height * window.width);
        let plane = self.width * self.height;
        for channel in 0..3 {
            for page in &self.pages[page..page + frames] {
                self.read_planes(&page.kinds[kind as usize][channel * plane..][..plane], window, &mut clip);
            }
        }
        clip
    }

    /// The masks of `frames` pages from `page` on, `[1, frames, height, width]`.
    pub fn masks(&self, page: usize, frames: usize, window: Window) -> Vec<f32> {
        let mut masks = Vec::with_capacity(frames * window.height * window.width);
        self.pages[page..page + frames].iter().for_each(|page| self.read_planes(&page.mask, window, &mut masks));
        masks
    }

    /// The whole of a picture.
    pub fn whole(&self) -> Window {
        Window { top: 0, left: 0, height: self.height, width: self.width }
    }

    fn read_planes(&self, planes: &[f16], window: Window, out: &mut Vec<f32>) {
        for plane in planes.chunks_exact(self.width * self.height) {
            read_window(plane, self.width, window, out);
        }
    }

    /// The same with the pictures of these kinds only.
    pub fn keeping(mut self, kinds: &[Kind]) -> Self {
        for page in &mut self.pages {
            let others = Kind::ALL.into_iter().filter(|kind| !kinds.contains(kind));
            others.for_each(|kind| page.kinds[kind as usize] = Vec::new());
        }
        self
    }

    /// Smallest distance of the numbers of two pages: 1, or more where a dataset stores every n-th frame.
    pub fn stride(&self) -> usize {
        let distances = self.pages.windows(2).map(|pair| pair[1].number.saturating_sub(pair[0].number));
        distances.min().unwrap_or(1).max(1)
    }

    /// First pages of the stretches of `1 + step` pages that are one [`Self::stride`] apart.
    pub fn stretches(&self, step: usize) -> Vec<usize> {
        let (pages, distance) = (&self.pages, step * self.stride());
        (0..pages.len()).filter(|&i| i + step < pages.len() && pages[i + step].number == pages[i].number + distance).collect()
    }
}

/// Adds a window of a plane of `width` columns to `out`.
pub(in crate::wan) fn read_window(plane: &[f16], width: usize, window: Window, out: &mut Vec<f32>) {
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

/// A frame of a `factor`-th of the size; remainders at the right and below are left out.
fn reduce(frame: &Frame, factor: usize) -> Frame {
    let (width, height) = (frame.width / factor, frame.height / factor);
    let middle = |x: usize| x * factor + factor / 2;
    let sample = |image: &Rgb| Rgb::from_fn(width, height, |x, y| *image.at(middle(x), middle(y)));
    let mean = |x: usize, y: usize, value: &dyn Fn(usize, usize) -> f32| {
        let cells = (0..factor * factor).map(|i| value(x * factor + i % factor, y * factor + i / factor));
        cells.sum::<f32>() / (factor * factor) as f32
    };
    Frame {
        width,
        height,
        beauty: frame
            .beauty
            .as_ref()
            .map(|image| Rgb::from_fn(width, height, |x, y| [0, 1, 2].map(|c| mean(x, y, &|x, y| image.at(x, y)[c])))),
        alpha: Image::from_fn(width, height, |x, y| mean(x, y, &|x, y| *frame.alpha.at(x, y))),
        albedo: sample(&frame.albedo),
        normal: sample(&frame.normal),
        depth: Image::from_fn(width, height, |x, y| *frame.depth.at(middle(x), middle(y))),
        material: sample(&frame.material),
        info: FrameInfo { camera: frame.info.camera.resized(width, height), ..FrameInfo::default() },
        ..Frame::default()
    }
}
