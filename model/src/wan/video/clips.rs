//! A session that renders a sequence clip by clip.

use super::WanRenderer;
use super::pixels::Size;
use crate::data::step_rng;
use crate::network::init::normal;
use crate::parameters::read;
use crate::renderer::{KeyframePlace, Options, Rendered, Sequence, Session, State, View, check, nearest};
use crate::wan::flow::{Conditions, KeyframeLatent};
use crate::wan::pictures::{BridgeStart, EnvironmentView, Kind, Pictures, check_bounds, radiance};
use crate::{Error, Result};
use burn::tensor::{Tensor, TensorData};
use glam::Vec2;
use renderflow_frame::image::Rgb;
use renderflow_frame::{Camera, DepthBounds};

/// The session of [`WanRenderer`]; see [`super`]. It holds the pictures of one clip, its keyframes, and the latents of a grey
/// clip.
pub struct ClipSession<'a> {
    renderer: &'a WanRenderer,
    sequence: &'a dyn Sequence,
    options: Options,
    bounds: DepthBounds,
    /// The size of all frames, and the environment at the padded size. The first frame determines both.
    shown: Option<(Size, EnvironmentView)>,
    /// Frames that wait for the next clip.
    waiting: Vec<FrameInputs>,
    /// The frame before them, and its picture.
    last: Option<(FrameInputs, Vec<f32>)>,
    keyframes: Vec<EncodedKeyframe>,
    /// Latents of a grey clip, with its number of frames.
    grey: Option<(usize, Tensor<5>)>,
    /// For each kind, the last clip whose frames were all equal. The next clip is often the same, for instance with a camera that
    /// stands still, and then it is not encoded again.
    unchanged: Vec<UnchangedClip>,
}

/// A clip whose frames are all equal.
struct UnchangedClip {
    kind: Kind,
    frames: usize,
    picture: Vec<f32>,
    latents: Tensor<5>,
}

/// A frame to render.
struct FrameInputs {
    number: usize,
    index: usize,
    camera: Camera,
    pictures: Pictures,
}

/// A keyframe.
struct EncodedKeyframe {
    place: KeyframePlace,
    latent: Tensor<5>,
    picture: Vec<f32>,
    beauty: Rgb,
}

impl<'a> ClipSession<'a> {
    /// Begins with a sequence.
    ///
    /// # Errors
    /// As for [`crate::renderer::Renderer::begin`].
    pub fn new(renderer: &'a WanRenderer, sequence: &'a dyn Sequence, options: Options) -> Result<Self> {
        check(options, sequence.light()?.exposure())?;
        if options.keyframes && renderer.config().keyframes.is_none() {
            return Err(Error::config("keyframes", "these weights have no keyframe adapter"));
        }
        let bounds = sequence.depth_bounds()?;
        check_bounds(bounds)?;
        let (waiting, keyframes, unchanged) = (Vec::new(), Vec::new(), Vec::new());
        Ok(Self { renderer, sequence, options, bounds, shown: None, waiting, last: None, keyframes, grey: None, unchanged })
    }

    /// Number of values in memory for frames, keyframes, grey and unchanged clips. It does not grow with the length of the
    /// sequence.
    pub fn held(&self) -> usize {
        let pictures = |frame: &FrameInputs| Kind::ALL.iter().map(|kind| frame.pictures.of(*kind).len()).sum::<usize>();
        let latent = |tensor: &Tensor<5>| tensor.dims().iter().product::<usize>();
        let key = |key: &EncodedKeyframe| latent(&key.latent) + key.picture.len() + 3 * key.beauty.pixels.len();
        self.waiting.iter().map(pictures).sum::<usize>()
            + self.last.as_ref().map_or(0, |(frame, picture)| pictures(frame) + picture.len())
            + self.keyframes.iter().map(key).sum::<usize>()
            + self.grey.as_ref().map_or(0, |(_, grey)| latent(grey))
            + self.unchanged.iter().map(|still| still.picture.len() + latent(&still.latents)).sum::<usize>()
    }

    fn inputs(&mut self, view: View) -> Result<FrameInputs> {
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
        pictures = pictures.starting(self.renderer.config().bridge_start, frame, light, view.shaded)?;
        pictures.target = None;
        Ok(FrameInputs { number: view.number, index: view.index, camera: frame.info.camera, pictures })
    }

    /// The latents of the keyframes for the clip of frames `first..=last`. Other keyframes are dropped.
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

    fn key(&self, place: KeyframePlace, size: Size) -> Result<EncodedKeyframe> {
        let frame = self.sequence.keyframe(place.index)?;
        let broken = |reason: &str| Error::Data { place: format!("keyframe {}", place.number), reason: reason.into() };
        if (frame.width, frame.height) != (size.width, size.height) {
            return Err(broken("differs in size from the frames"));
        }
        // The environment of a keyframe is not used, so its size does not matter.
        let light = self.sequence.light()?;
        let pictures = Pictures::new(&frame, light, &EnvironmentView::new(&light.environment, 1, 1), self.bounds)?;
        let (Some(picture), Some(beauty)) = (pictures.target, frame.beauty) else { return Err(broken("has no beauty")) };
        let latent = self.renderer.encode(size.clip(&[&picture], &self.renderer.device))?;
        Ok(EncodedKeyframe { place, latent, picture, beauty })
    }

    /// Renders the frames that wait.
    fn clip(&mut self) -> Result<Vec<Rendered>> {
        let Some((size, _)) = self.shown else { return Ok(Vec::new()) };
        let first = self.last.as_ref().map(|(frame, _)| frame).or(self.waiting.first());
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
        for (i, frame) in std::mem::take(&mut self.waiting).into_iter().enumerate() {
            let key = self.keyframes.iter().find(|key| key.place.number == frame.number);
            let (picture, linear) = match key {
                Some(key) => (key.picture.clone(), key.beauty.clone()),
                None => self.picture(&frame, size.frame(&values, count, given + i))?,
            };
            rendered.push(Rendered { index: frame.index, linear });
            last = Some((frame, picture));
        }
        self.last = last;
        Ok(rendered)
    }

    /// Whether every frame that waits is a keyframe, so that its picture is known.
    fn wholly_known(&self) -> bool {
        let known = |frame: &FrameInputs| self.keyframes.iter().any(|key| key.place.number == frame.number);
        self.waiting.iter().all(known)
    }

    /// Number of frames of a clip to which `frames` frames are padded.
    fn padded(&self, frames: usize) -> usize {
        1 + (frames - 1).next_multiple_of(self.renderer.config().vae.temporal_factor())
    }

    /// The pictures of the next clip. The last one is repeated up to `count` pictures, at least 1.
    fn padded_pictures(&self, kind: Kind, count: usize) -> Result<Vec<&[f32]>> {
        let inputs = self.last.iter().map(|(frame, _)| frame).chain(&self.waiting);
        let mut frames: Vec<&[f32]> = inputs.map(|frame| frame.pictures.of(kind)).collect();
        let Some(&last) = frames.last() else { return Err(broken("is missing".into())) };
        frames.resize(count, last);
        Ok(frames)
    }

    /// Latents of the next clip for a kind of picture. The last frame is repeated up to `count` frames.
    fn encode(&mut self, kind: Kind, size: Size, count: usize) -> Result<Tensor<5>> {
        let frames = self.padded_pictures(kind, count)?;
        let last = frames[count - 1];
        let changes = frames.iter().any(|frame| *frame != last);
        let known = |still: &&UnchangedClip| still.kind == kind && still.frames == count && still.picture == last;
        if let Some(still) = self.unchanged.iter().find(|still| !changes && known(still)) {
            return Ok(still.latents.clone());
        }
        let device = &self.renderer.device;
        let latents = self.renderer.encode(match kind {
            Kind::Environment => size.whole_clip(&frames, device),
            _ => size.clip(&frames, device),
        })?;
        let picture = (!changes).then(|| last.to_vec());
        self.unchanged.retain(|still| still.kind != kind);
        self.unchanged.extend(picture.map(|picture| UnchangedClip { kind, frames: count, picture, latents: latents.clone() }));
        Ok(latents)
    }

    /// The pictures of the whole clip, `[3, frames, padded height, padded width]`.
    fn render(&mut self, size: Size, keyframes: Vec<KeyframeLatent>) -> Result<Vec<f32>> {
        let (renderer, device) = (self.renderer, &self.renderer.device);
        let count = self.padded(usize::from(self.last.is_some()) + self.waiting.len());
        let start = self.encode(Kind::Albedo, size, count)?;
        let (mut z, condition) = match renderer.config().bridge_start {
            BridgeStart::Noise => (self.noise(&start), Some(start.clone())),
            BridgeStart::Albedo | BridgeStart::Lit | BridgeStart::Deferred => (start.clone(), None),
        };
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
            // No frame is given, so the inactive latents are those of a grey clip.
            None => grey.clone(),
        };
        let known: Vec<bool> = (0..count).map(|i| i == 0 && reference.is_some()).collect();
        let mask = renderer.mask(&known, &z);
        let [normal, depth, material] = [Kind::Normal, Kind::Depth, Kind::Material].map(|kind| self.encode(kind, size, count));
        let mut attributes = vec![inactive, grey, mask, normal?, depth?, material?];
        attributes.extend(condition);
        let conditions = Conditions {
            attributes: Tensor::cat(attributes, 1),
            environment: self.encode(Kind::Environment, size, count)?,
            keyframes,
        };
        let steps = self.options.steps;
        for step in 0..steps {
            let t = step as f64 / steps as f64;
            let velocity = renderer.flow.velocity(z.clone(), &[t], &conditions)?;
            z = z + velocity * (1.0 / steps as f64);
        }
        let mut pictures = renderer.decode(z)?;
        if renderer.config().bridge_start.is_coded_as_change() {
            let begun = size.clip(&self.padded_pictures(Kind::Albedo, count)?, device);
            pictures = (pictures + begun - renderer.decode(start)?).clamp(-1.0, 1.0);
        }
        let values = read(pictures)?;
        all_finite(&values)?;
        Ok(values)
    }

    /// Noise of the shape of `latents`. It depends on the seed and on the first frame of the clip.
    fn noise(&self, latents: &Tensor<5>) -> Tensor<5> {
        let first = self.waiting.first().map_or(0, |frame| frame.number as u64);
        let mut rng = step_rng(self.options.seed, first);
        let shape = latents.dims();
        let values: Vec<f32> = (0..shape.iter().product::<usize>()).map(|_| normal(&mut rng)).collect();
        Tensor::from_data(TensorData::new(values, shape), &self.renderer.device)
    }

    /// Picture and radiance of a frame from the output of the network. Pixels that see no surface show the environment.
    fn picture(&self, frame: &FrameInputs, mut picture: Vec<f32>) -> Result<(Vec<f32>, Rgb)> {
        let Pictures { width, height, mask, albedo, .. } = &frame.pictures;
        let (width, pixels) = (*width, width * height);
        let light = self.sequence.light()?;
        let mut linear = radiance(&picture, width, *height, light.exposure())?;
        for i in (0..pixels).filter(|&i| mask[i] == 0.0) {
            // The albedo shows the environment in such pixels.
            for c in 0..3 {
                picture[c * pixels + i] = albedo[c * pixels + i];
            }
            let direction = frame.camera.ray_direction(Vec2::new((i % width) as f32 + 0.5, (i / width) as f32 + 0.5));
            linear.pixels[i] = light.environment.radiance(direction);
        }
        Ok((picture, linear))
    }
}

impl Session for ClipSession<'_> {
    fn push(&mut self, view: View) -> Result<Vec<Rendered>> {
        let frame = self.inputs(view)?;
        let before = self.waiting.last().or(self.last.as_ref().map(|(frame, _)| frame)).map(|frame| frame.number);
        let mut rendered = match before {
            Some(before) if before + 1 != frame.number => self.finish()?,
            _ => Vec::new(),
        };
        self.waiting.push(frame);
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
        let (frame, picture) = self.last.as_ref().filter(|_| self.waiting.is_empty())?;
        let size = [frame.pictures.width, frame.pictures.height];
        Some(State { number: frame.number, size, picture: picture.clone() })
    }

    fn resume(&mut self, view: View, state: State) -> Result<()> {
        let fits = view.number == state.number && state.size == [view.frame.width, view.frame.height];
        if !fits || state.picture.len() != 3 * state.size[0] * state.size[1] {
            let reason = format!("frame {} of {:?} pixels is not where the work was stopped", view.number, state.size);
            return Err(broken(reason));
        }
        all_finite(&state.picture)?;
        self.waiting.clear();
        self.last = Some((self.inputs(view)?, state.picture));
        Ok(())
    }
}

/// Checks that a picture has no NaN or infinity.
pub(super) fn all_finite(values: &[f32]) -> Result<()> {
    match values.iter().all(|v| v.is_finite()) {
        true => Ok(()),
        false => Err(Error::Data { place: "renderer".into(), reason: "the network returned values that are not finite".into() }),
    }
}

fn broken(reason: String) -> Error {
    Error::Data { place: "frame".into(), reason }
}
