//! A sequence rendered clip by clip.

use super::WanRenderer;
use super::pixels::Size;
use crate::parameters::to_vec;
use crate::renderer::{KeyframePlace, Options, Rendered, Sequence, Session, State, View, check, nearest};
use crate::wan::flow::{Conditions, KeyframeLatent};
use crate::wan::pictures::{DepthBounds, EnvironmentView, Kind, Pictures, radiance};
use crate::wan::probe::Probe;
use crate::{Error, Result};
use burn::tensor::Tensor;
use glam::Vec2;
use renderflow_frame::Camera;
use renderflow_frame::image::Rgb;

/// The session of [`WanRenderer`]; see [`super`]. What it holds: the frames of one clip as pictures, its keyframes, the latents of grey.
pub struct Clips<'a> {
    renderer: &'a WanRenderer,
    sequence: &'a dyn Sequence,
    options: Options,
    bounds: DepthBounds,
    /// The size of all frames, and the environment at the padded one; known with the first frame.
    shown: Option<(Size, EnvironmentView)>,
    /// Frames of the next clip.
    waiting: Vec<Page>,
    /// The frame before them and its picture.
    last: Option<(Page, Vec<f32>)>,
    keyframes: Vec<Key>,
    /// Latents of a clip of grey, of the number of frames they were last needed for.
    grey: Option<(usize, Tensor<5>)>,
    /// Of each kind, the last clip in which nothing changed: where the camera stands still, or the light is the same from
    /// everywhere, the next one need not be encoded (81 frames of a scene in which nothing moves in 4.1 s instead of 5.9 s with
    /// `wan-small` at 64 x 64 pixels, the same bytes).
    still: Vec<Still>,
}

/// A clip whose frames are all the same.
struct Still {
    kind: Kind,
    frames: usize,
    picture: Vec<f32>,
    latents: Tensor<5>,
}

/// A frame to be rendered.
struct Page {
    number: usize,
    index: usize,
    camera: Camera,
    pictures: Pictures,
}

/// A keyframe.
struct Key {
    place: KeyframePlace,
    latent: Tensor<5>,
    picture: Vec<f32>,
    beauty: Rgb,
}

impl<'a> Clips<'a> {
    /// Begins with a sequence.
    ///
    /// # Errors
    /// As of [`crate::renderer::Renderer::begin`].
    pub fn new(renderer: &'a WanRenderer, sequence: &'a dyn Sequence, options: Options) -> Result<Self> {
        check(options, sequence.light()?.exposure())?;
        if options.keyframes && renderer.config().keyframes.is_none() {
            return Err(Error::config("keyframes", "these weights have no keyframe adapter"));
        }
        let bounds = sequence.depth_bounds()?;
        bounds.validate()?;
        let (waiting, keyframes, still) = (Vec::new(), Vec::new(), Vec::new());
        Ok(Self { renderer, sequence, options, bounds, shown: None, waiting, last: None, keyframes, grey: None, still })
    }

    /// Numbers held of frames, keyframes, grey and clips without change: bounded by the size of a clip, whatever the length of the sequence.
    pub fn held(&self) -> usize {
        let pictures = |page: &Page| Kind::ALL.iter().map(|kind| page.pictures.of(*kind).len()).sum::<usize>();
        let latent = |tensor: &Tensor<5>| tensor.dims().iter().product::<usize>();
        let key = |key: &Key| latent(&key.latent) + key.picture.len() + 3 * key.beauty.pixels.len();
        self.waiting.iter().map(pictures).sum::<usize>()
            + self.last.as_ref().map_or(0, |(page, picture)| pictures(page) + picture.len())
            + self.keyframes.iter().map(key).sum::<usize>()
            + self.grey.as_ref().map_or(0, |(_, grey)| latent(grey))
            + self.still.iter().map(|still| still.picture.len() + latent(&still.latents)).sum::<usize>()
    }

    fn page(&mut self, view: View) -> Result<Page> {
        let (frame, sequence) = (view.frame, self.sequence);
        let size = Size::new(frame.width, frame.height, self.renderer.config().pixel_multiple());
        if frame.width == 0 || frame.height == 0 {
            return Err(broken("has no pixels".into()));
        }
        let light = sequence.light()?;
        let (known, environment) = self
            .shown
            .get_or_insert_with(|| (size, EnvironmentView::new(&light.environment, size.padded_width, size.padded_height)));
        if *known != size {
            let reason = format!("{}x{} pixels after frames of {}x{}", size.width, size.height, known.width, known.height);
            return Err(broken(reason));
        }
        let mut pictures = Pictures::new(frame, light, environment, self.bounds)?;
        pictures.target = None;
        Ok(Page { number: view.number, index: view.index, camera: frame.info.camera, pictures })
    }

    /// Makes latents of the keyframes that guide the clip of frames `first..=last`; others are let go.
    fn keys(&mut self, first: usize, last: usize, size: Size) -> Result<Vec<KeyframeLatent>> {
        if !self.options.keyframes {
            return Ok(Vec::new());
        }
        let wanted = nearest(self.sequence.keyframes(), first, last);
        self.keyframes.retain(|key| wanted.contains(&key.place));
        let factor = self.renderer.config().vae.temporal_factor() as f64;
        let mut latents = Vec::with_capacity(wanted.len());
        for place in wanted {
            let at = match self.keyframes.iter().position(|key| key.place == place) {
                Some(at) => at,
                None => {
                    self.keyframes.push(self.key(place, size)?);
                    self.keyframes.len() - 1
                }
            };
            let time = (place.number as f64 - first as f64) / factor;
            latents.push(KeyframeLatent { latent: self.keyframes[at].latent.clone(), time });
        }
        Ok(latents)
    }

    fn key(&self, place: KeyframePlace, size: Size) -> Result<Key> {
        let frame = self.sequence.keyframe(place.index)?;
        let broken = |reason: &str| Error::Data { place: format!("keyframe {}", place.number), reason: reason.into() };
        if (frame.width, frame.height) != (size.width, size.height) {
            return Err(broken("differs in size from the frames"));
        }
        // Its environment is not looked at: any size will do.
        let light = self.sequence.light()?;
        let pictures = Pictures::new(&frame, light, &EnvironmentView::new(&light.environment, 1, 1), self.bounds)?;
        let (Some(picture), Some(beauty)) = (pictures.target, frame.beauty) else { return Err(broken("has no beauty")) };
        let latent = self.renderer.encode(size.clip(&[&picture], &self.renderer.device))?;
        Ok(Key { place, latent, picture, beauty })
    }

    /// Renders the frames that wait, after the one before them.
    fn clip(&mut self) -> Result<Vec<Rendered>> {
        let Some((size, _)) = self.shown else { return Ok(Vec::new()) };
        let first = self.last.as_ref().map(|(page, _)| page).or(self.waiting.first());
        let (Some(first), Some(last)) = (first, self.waiting.last()) else { return Ok(Vec::new()) };
        let keyframes = self.keys(first.number, last.number, size)?;
        let given = usize::from(self.last.is_some());
        let frames = given + self.waiting.len();
        let values = match self.wholly_known() {
            true => Vec::new(),
            false => self.render(size, keyframes)?,
        };
        let count = self.padded(frames);
        let mut rendered = Vec::with_capacity(self.waiting.len());
        let mut last = None;
        for (i, page) in std::mem::take(&mut self.waiting).into_iter().enumerate() {
            let key = self.keyframes.iter().find(|key| key.place.number == page.number);
            let (picture, linear) = match key {
                Some(key) => (key.picture.clone(), key.beauty.clone()),
                None => self.picture(&page, size.frame(&values, count, given + i))?,
            };
            rendered.push(Rendered { index: page.index, linear });
            last = Some((page, picture));
        }
        self.last = last;
        Ok(rendered)
    }

    /// Whether every frame that waits is a keyframe, whose picture is known.
    fn wholly_known(&self) -> bool {
        let known = |page: &Page| self.keyframes.iter().any(|key| key.place.number == page.number);
        self.waiting.iter().all(known)
    }

    /// Frames of the clip that `frames` are padded to.
    fn padded(&self, frames: usize) -> usize {
        1 + (frames - 1).next_multiple_of(self.renderer.config().vae.temporal_factor())
    }

    /// Latents of a kind of picture of the next clip's frames, the last one repeated up to `count`.
    fn encode(&mut self, kind: Kind, size: Size, count: usize) -> Result<Tensor<5>> {
        let pages = self.last.iter().map(|(page, _)| page).chain(&self.waiting);
        let mut frames: Vec<&[f32]> = pages.map(|page| page.pictures.of(kind)).collect();
        let Some(&last) = frames.last() else { return Err(broken("is missing".into())) };
        frames.resize(count, last);
        let changes = frames.iter().any(|frame| *frame != last);
        let known = |still: &&Still| still.kind == kind && still.frames == count && still.picture == last;
        if let Some(still) = self.still.iter().find(|still| !changes && known(still)) {
            return Ok(still.latents.clone());
        }
        let device = &self.renderer.device;
        let latents = self.renderer.encode(match kind {
            Kind::Environment => size.whole_clip(&frames, device),
            _ => size.clip(&frames, device),
        })?;
        let picture = (!changes).then(|| last.to_vec());
        self.still.retain(|still| still.kind != kind);
        self.still.extend(picture.map(|picture| Still { kind, frames: count, picture, latents: latents.clone() }));
        Ok(latents)
    }

    /// The values of the whole clip's pictures, `[3, frames, padded height, padded width]`.
    fn render(&mut self, size: Size, keyframes: Vec<KeyframeLatent>) -> Result<Vec<f32>> {
        let (renderer, device) = (self.renderer, &self.renderer.device);
        let count = self.padded(usize::from(self.last.is_some()) + self.waiting.len());
        let mut z = self.encode(Kind::Albedo, size, count)?;
        let grey = match &self.grey {
            Some((frames, grey)) if *frames == count => grey.clone(),
            _ => {
                let [h, w] = [size.padded_height, size.padded_width];
                let grey = renderer.encode(Tensor::zeros([1, 3, count, h, w], device))?;
                self.grey.insert((count, grey)).1.clone()
            }
        };
        let reference = self.last.as_ref().map(|(_, picture)| picture.as_slice());
        let inactive = match reference {
            Some(picture) => {
                let unknown = vec![0.0; picture.len()];
                let frames: Vec<&[f32]> = std::iter::once(picture).chain(std::iter::repeat(&unknown[..])).take(count).collect();
                renderer.encode(size.clip(&frames, device))?
            }
            // Nothing is given: the clip of what is given is grey.
            None => grey.clone(),
        };
        let known: Vec<bool> = (0..count).map(|i| i == 0 && reference.is_some()).collect();
        let mask = renderer.mask(&known, &z);
        let [normal, depth, material] = [Kind::Normal, Kind::Depth, Kind::Material].map(|kind| self.encode(kind, size, count));
        let conditions = Conditions {
            attributes: Tensor::cat(vec![inactive, grey, mask, normal?, depth?, material?], 1),
            environment: self.encode(Kind::Environment, size, count)?,
            keyframes,
        };
        let steps = self.options.steps;
        for step in 0..steps {
            let t = step as f64 / steps as f64;
            let velocity = renderer.flow.velocity(z.clone(), &[t], &conditions, &mut Probe::idle())?;
            z = z + velocity * (1.0 / steps as f64);
        }
        let values = to_vec(renderer.decode(z)?);
        all_finite(&values)?;
        Ok(values)
    }

    /// Picture and radiance of a frame from what the network made of it: pixels that no surface covers are the environment.
    fn picture(&self, page: &Page, mut picture: Vec<f32>) -> Result<(Vec<f32>, Rgb)> {
        let Pictures { width, height, mask, albedo, .. } = &page.pictures;
        let (width, pixels) = (*width, width * height);
        let light = self.sequence.light()?;
        let mut linear = radiance(&picture, width, *height, light.exposure())?;
        for i in (0..pixels).filter(|&i| mask[i] == 0.0) {
            // The albedo shows the environment there.
            for c in 0..3 {
                picture[c * pixels + i] = albedo[c * pixels + i];
            }
            let direction = page.camera.ray_direction(Vec2::new((i % width) as f32 + 0.5, (i / width) as f32 + 0.5));
            linear.pixels[i] = light.environment.radiance(direction);
        }
        Ok((picture, linear))
    }
}

impl Session for Clips<'_> {
    fn push(&mut self, view: View) -> Result<Vec<Rendered>> {
        let page = self.page(view)?;
        let before = self.waiting.last().or(self.last.as_ref().map(|(page, _)| page)).map(|page| page.number);
        let mut rendered = match before {
            Some(before) if before + 1 != page.number => self.finish()?,
            _ => Vec::new(),
        };
        self.waiting.push(page);
        if self.options.stills {
            rendered.extend(self.finish()?);
            return Ok(rendered);
        }
        let step = self.renderer.config().vae.temporal_factor();
        if usize::from(self.last.is_some()) + self.waiting.len() > step {
            rendered.extend(self.clip()?);
        }
        Ok(rendered)
    }

    fn finish(&mut self) -> Result<Vec<Rendered>> {
        let rendered = if self.waiting.is_empty() { Vec::new() } else { self.clip()? };
        self.last = None;
        Ok(rendered)
    }

    fn state(&self) -> Option<State> {
        let (page, picture) = self.last.as_ref().filter(|_| self.waiting.is_empty())?;
        let size = [page.pictures.width, page.pictures.height];
        Some(State { number: page.number, size, picture: picture.clone() })
    }

    fn resume(&mut self, view: View, state: State) -> Result<()> {
        let fits = view.number == state.number && state.size == [view.frame.width, view.frame.height];
        if !fits || state.picture.len() != 3 * state.size[0] * state.size[1] {
            let reason = format!("frame {} of {:?} pixels is not where the work was stopped", view.number, state.size);
            return Err(broken(reason));
        }
        all_finite(&state.picture)?;
        self.waiting.clear();
        self.last = Some((self.page(view)?, state.picture));
        Ok(())
    }
}

/// No picture goes out with NaN or infinity in it.
pub(super) fn all_finite(values: &[f32]) -> Result<()> {
    match values.iter().all(|v| v.is_finite()) {
        true => Ok(()),
        false => Err(Error::Data { place: "renderer".into(), reason: "made values that are not finite".into() }),
    }
}

fn broken(reason: String) -> Error {
    Error::Data { place: "frame".into(), reason }
}
