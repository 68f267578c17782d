//! The paper's network on one sequence: with and without keyframes, in clips or frame by frame.

use super::{Drawing, Options};
use crate::dataset::Sequence;
use crate::evaluate::method::Method;
use crate::util::clock::timed;
use anyhow::{Context, Result};
use renderflow_frame::Frame;
use renderflow_frame::image::Rgb;
use renderflow_model::renderer::{self, Renderer, Session, View};
use std::collections::BTreeMap;

/// What networks begin with that begin with deferred shading: pictures with the seconds that they took.
pub struct Shaded {
    /// Deferred shading.
    pub alone: (Rgb, f64),
    /// Keyframes carried over it, if a network reads keyframes.
    pub carried: Option<(Rgb, f64)>,
}

impl Shaded {
    /// What a network with or without keyframes begins with.
    fn of(&self, keyframes: bool) -> &(Rgb, f64) {
        self.carried.as_ref().filter(|_| keyframes).unwrap_or(&self.alone)
    }
}

/// One network with or without keyframes.
struct NetworkSession<'a> {
    method: &'a Method,
    renderer: &'a dyn Renderer,
    options: renderer::Options,
    /// Whether it renders several frames at once.
    clips: bool,
    session: Box<dyn Session + 'a>,
    /// Finished pictures by stored index, with their share of the clip's seconds.
    ready: BTreeMap<usize, (Rgb, f64)>,
    /// Seconds spent on the current clip.
    spent: f64,
}

/// All networks of an evaluation.
pub struct NetworkSessions<'a> {
    sequence: &'a Sequence,
    networks: Vec<NetworkSession<'a>>,
    /// Stored index of the next frame for networks that render clips.
    next: usize,
    /// Seconds of preparing keyframes, for networks that do so while they render.
    pub preparing: f64,
}

impl<'a> NetworkSessions<'a> {
    /// Starts a sequence. Methods that need keyframes are left out where the sequence has none or the network takes none.
    pub fn new(sequence: &'a Sequence, options: &'a Options<'a>) -> Result<Self> {
        let mut networks = Vec::new();
        for method in options.methods {
            let Method::Wan { keyframes, stills } = *method else { continue };
            let renderer = options.wan.context("the methods need weights of the paper's network (--weights)")?;
            if keyframes && (sequence.transforms.keyframes.is_empty() || !renderer.about().keyframes) {
                continue;
            }
            let Drawing { steps, seed } = options.drawing;
            let options = renderer::Options { keyframes, stills, steps: steps as usize, seed };
            let session = renderer.begin(sequence, options)?;
            let clips = renderer.about().in_clips(options);
            networks.push(NetworkSession { method, renderer, options, clips, session, ready: BTreeMap::new(), spent: 0.0 });
        }
        Ok(Self { sequence, networks, next: 0, preparing: 0.0 })
    }

    /// Whether a network asks for the range of depths when it starts; networks that can render clips do.
    pub fn read_depths(&self) -> bool {
        self.networks.iter().any(|network| network.renderer.about().clip > 1)
    }

    /// The frame whose G-buffer is needed before frame `index` can be finished; `None` where none is.
    pub fn wanted(&self, index: usize) -> Option<usize> {
        let waits = |network: &NetworkSession| network.clips && !network.ready.contains_key(&index);
        (self.next < self.sequence.len() && self.networks.iter().any(waits)).then_some(self.next)
    }

    /// Gives the frame to the networks that work in clips. `shaded` is needed if the networks begin with it.
    pub fn push(&mut self, index: usize, frame: &Frame, shaded: Option<&Shaded>) -> Result<()> {
        self.next = index + 1;
        let last = self.next == self.sequence.len();
        for network in self.networks.iter_mut().filter(|network| network.clips) {
            let shaded = shaded.map(|shaded| shaded.of(network.options.keyframes));
            let view = view(self.sequence, index, frame, shaded);
            network.spent += shaded.map_or(0.0, |(_, seconds)| *seconds);
            network.take(|session| {
                let mut rendered = session.push(view)?;
                if last {
                    rendered.extend(session.finish()?);
                }
                Ok(rendered)
            })?;
        }
        Ok(())
    }

    /// The network's picture of frame `index`, and its seconds without the G-buffer. `None` where it cannot be made. Earlier
    /// frames are forgotten. `shaded` is as for [`Self::push`].
    pub fn picture(
        &mut self,
        method: &Method,
        index: usize,
        frame: &Frame,
        shaded: Option<&Shaded>,
    ) -> Result<Option<(Rgb, f64)>> {
        let Some(network) = self.networks.iter_mut().find(|network| network.method == method) else { return Ok(None) };
        if !network.clips {
            let shaded = shaded.map(|shaded| shaded.of(network.options.keyframes));
            let view = view(self.sequence, index, frame, shaded);
            network.spent += shaded.map_or(0.0, |(_, seconds)| *seconds);
            let ((), preparing) = timed(|| Ok(network.session.prepare(view.number)?))?;
            self.preparing += preparing;
            network.take(|session| session.push(view))?;
        }
        network.ready = network.ready.split_off(&index);
        Ok(network.ready.remove(&index))
    }

    /// Renders a frame in a session of its own, so that the first frame that counts does not pay for caches.
    pub fn warm_up(&self, method: &Method, index: usize, frame: &Frame, shaded: Option<&Shaded>) -> Result<()> {
        let Some(network) = self.networks.iter().find(|network| network.method == method) else { return Ok(()) };
        let mut session = network.renderer.begin(self.sequence, network.options)?;
        let shaded = shaded.map(|shaded| shaded.of(network.options.keyframes));
        session.push(view(self.sequence, index, frame, shaded))?;
        session.finish()?;
        Ok(())
    }
}

impl NetworkSession<'_> {
    /// Lets the session work, and divides the seconds among the frames that it finishes.
    fn take(&mut self, work: impl FnOnce(&mut dyn Session) -> renderflow_model::Result<Vec<renderer::Rendered>>) -> Result<()> {
        let (rendered, seconds) = timed(|| Ok(work(&mut *self.session)?))?;
        self.spent += seconds;
        if rendered.is_empty() {
            return Ok(());
        }
        let share = std::mem::take(&mut self.spent) / rendered.len() as f64;
        self.ready.extend(rendered.into_iter().map(|rendered| (rendered.index, (rendered.linear, share))));
        Ok(())
    }
}

fn view<'f>(sequence: &Sequence, index: usize, frame: &'f Frame, shaded: Option<&'f (Rgb, f64)>) -> View<'f> {
    View { number: sequence.numbers[index], index, frame, shaded: shaded.map(|(picture, _)| picture) }
}
