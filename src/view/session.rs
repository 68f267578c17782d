//! Decides what is rendered next: first something of each side, then more samples for as long as nobody changes anything.

use super::inbox::Inbox;
use super::method::{Method, Side};
use super::outbox::Outbox;
use super::stage::{Content, MOST_SAMPLES, Made, Stage};
use super::state::{Message, Picture, Request, State, stops};
use crate::metrics::psnr;
use crate::util::cancel::Cancel;
use crate::util::picture;
use anyhow::Result;
use renderflow_frame::color;
use renderflow_frame::image::Rgb;
use std::collections::HashMap;

/// While things move, pictures are made smaller if they would take longer than this many seconds.
const QUICK: f64 = 0.07;
/// Pictures are made this many times smaller at most.
const SMALLEST: u32 = 4;
/// Seconds of tracing between two looks at what the page wants.
const TURN: f64 = 0.15;
/// Path-traced pictures serve as a reference from this many samples per pixel on.
const REFERENCE: u32 = 256;

/// The renderer's side of the viewer.
pub struct Session<'a> {
    stage: Stage,
    inbox: &'a Inbox,
    outbox: &'a Outbox,
    /// The state that is shown; `None` while there is no page.
    state: Option<State>,
    sides: [Option<Made>; 2],
    /// Samples in the last picture that was sent of the methods that refine.
    sent: u32,
    /// Seconds per pixel of each method.
    costs: HashMap<Method, f64>,
    /// Factor of the exposure.
    gain: f32,
    scale: u32,
    /// The materials that the page was told about, so that a note comes once.
    noted: Vec<String>,
}

impl<'a> Session<'a> {
    /// A session that waits for a page.
    pub fn new(stage: Stage, inbox: &'a Inbox, outbox: &'a Outbox) -> Self {
        Self {
            stage,
            inbox,
            outbox,
            state: None,
            sides: [None, None],
            sent: 0,
            costs: HashMap::new(),
            gain: 1.0,
            scale: 1,
            noted: Vec::new(),
        }
    }

    /// Renders until the inbox is stopped.
    pub fn run(mut self) {
        loop {
            let taken = self.inbox.take(!self.has_work());
            if taken.stopped {
                return;
            }
            if taken.joined {
                self.state = None;
                self.gain = 1.0;
                // What was made for an earlier page meanwhile.
                self.outbox.clear();
                self.outbox.text(&Message::Hello(Box::new(self.stage.hello())));
            } else if taken.left {
                self.state = None;
            }
            if let Some(state) = taken.state {
                self.adopt(*state);
            }
            for request in taken.requests {
                let done = self.answer(request, &taken.work);
                self.said(done, &taken.work);
            }
            let done = self.advance(&taken.work);
            self.said(done, &taken.work);
        }
    }

    /// Tells the page what failed. Then nothing is done until it asks for something else. Work that was stopped has not failed.
    fn said(&mut self, done: Result<()>, work: &Cancel) {
        if let Err(error) = done
            && !work.is_set()
        {
            self.outbox.text(&Message::Note { text: crate::util::console::message(&error) });
            self.state = None;
        }
    }

    fn has_work(&self) -> bool {
        let Some(state) = &self.state else { return false };
        state.sides().iter().any(|side| self.sides[side.index()].is_none()) || self.traces(state)
    }

    /// Whether more samples are wanted: for a picture that refines, or as a reference for the others. Channels need neither.
    fn traces(&self, state: &State) -> bool {
        let picture = state.sides().iter().any(|side| state.method(*side).channel().is_none());
        picture && !state.moving && self.stage.samples() < MOST_SAMPLES
    }

    fn adopt(&mut self, state: State) {
        self.sides = [None, None];
        self.sent = 0;
        self.state = None;
        if let Err(error) = self.stage.apply(state.clone()) {
            self.outbox.text(&Message::Note { text: crate::util::console::message(&error) });
            return;
        }
        self.scale = self.scale_for(&state);
        self.stage.set_scale(self.scale);
        match self.stage.files() {
            Ok(([scene, camera], notes)) => {
                self.outbox.keep(scene, camera);
                for note in notes {
                    if !self.noted.contains(&note) {
                        self.outbox.text(&Message::Note { text: note.clone() });
                        self.noted.push(note);
                    }
                }
            }
            Err(error) => self.outbox.text(&Message::Note { text: crate::util::console::message(&error) }),
        }
        self.state = Some(state);
    }

    /// How many times smaller pictures should be.
    fn scale_for(&self, state: &State) -> u32 {
        if !state.moving {
            return 1;
        }
        let pixels = f64::from(state.resolution[0]) * f64::from(state.resolution[1]);
        let mut methods: Vec<Method> = state.sides().iter().map(|side| state.method(*side)).collect();
        methods.dedup();
        let seconds: f64 = methods.iter().map(|method| self.costs.get(method).copied().unwrap_or(3e-7) * pixels).sum();
        [1, 2].into_iter().find(|scale| seconds / f64::from(scale * scale) <= QUICK).unwrap_or(SMALLEST)
    }

    fn answer(&mut self, request: Request, cancel: &Cancel) -> Result<()> {
        match request {
            Request::Exposure { stops: asked } => {
                self.gain = stops(asked).exp2();
                for side in Side::BOTH {
                    self.send(side)?;
                }
            }
            Request::Pick { x, y } => {
                let material = self.stage.material_at([x, y], cancel)?;
                self.outbox.text(&Message::Pick { material });
            }
            Request::Home => {
                // The scene goes back; what is compared, and how large, stays.
                let mut home = self.stage.home();
                if let Some(State { left, right, split, rays, resolution, .. }) = self.state {
                    home = State { left, right, split, rays, resolution, ..home };
                }
                self.outbox.text(&Message::State { state: Box::new(home) });
            }
            Request::State(_) | Request::Shown => {}
        }
        Ok(())
    }

    /// Does the next piece of work.
    fn advance(&mut self, cancel: &Cancel) -> Result<()> {
        let Some(state) = self.state.clone() else { return Ok(()) };
        if let Some(side) = state.sides().iter().find(|side| self.sides[side.index()].is_none()) {
            return self.first(&state, *side, cancel);
        }
        if !self.traces(&state) {
            return Ok(());
        }
        let before = self.stage.samples();
        // As many samples as a turn has time for, at most as many as there are, so that each double is seen.
        let affordable = self.stage.seconds_a_sample().map_or(1.0, |seconds| TURN / seconds.max(1e-6)) as u32;
        self.stage.trace(affordable.clamp(1, before.max(1)), cancel)?;
        let samples = self.stage.samples();
        let refining = state.sides().iter().copied().filter(|side| state.method(*side).refines());
        if samples >= 2 * self.sent || samples >= MOST_SAMPLES {
            self.sent = samples;
            for side in refining {
                let made = self.stage.picture(state.method(side), cancel)?;
                self.sides[side.index()] = Some(made);
                self.send(side)?;
            }
            self.compare(&state);
        }
        Ok(())
    }

    /// Makes the first picture of a side.
    fn first(&mut self, state: &State, side: Side, cancel: &Cancel) -> Result<()> {
        let method = state.method(side);
        let other = Side::BOTH[1 - side.index()];
        let twin = self.sides[other.index()].as_ref().filter(|_| state.method(other) == method);
        let made = match twin {
            Some(made) => made.clone(),
            None => self.stage.picture(method, cancel)?,
        };
        let [width, height] = self.stage.size();
        // While things move, a picture that refines has one sample.
        let seconds = if method.refines() { made.seconds / f64::from(made.samples.max(1)) } else { made.seconds };
        self.costs.insert(method, seconds / (width * height) as f64);
        self.sides[side.index()] = Some(made);
        self.sent = self.sent.max(self.stage.samples());
        self.send(side)
    }

    /// Sends the picture of a side, if it is shown.
    fn send(&self, side: Side) -> Result<()> {
        let Some(state) = self.state.as_ref().filter(|state| state.sides().contains(&side)) else { return Ok(()) };
        let Some(made) = &self.sides[side.index()] else { return Ok(()) };
        let method = state.method(side);
        let [width, height] = self.stage.size();
        let png = picture::quick_png(&self.displayed(made))?;
        let header = Picture {
            r#type: "picture",
            side,
            method,
            state: state.id,
            size: [width, height],
            scale: self.scale,
            samples: made.samples,
            seconds: made.seconds,
            psnr: self.psnr(side),
            reference: self.reference(),
            done: !method.refines() || state.moving || made.samples >= MOST_SAMPLES,
        };
        self.outbox.picture(header, png);
        Ok(())
    }

    fn displayed(&self, made: &Made) -> Rgb {
        match &made.content {
            Content::Radiance(radiance) => {
                let exposure = self.stage.exposure() * self.gain;
                radiance.map(|p| color::display(*p, exposure))
            }
            Content::Display(picture) => picture.clone(),
        }
    }

    /// Samples of the reference, if there is one.
    fn reference(&self) -> Option<u32> {
        Some(self.stage.samples()).filter(|samples| *samples >= REFERENCE && self.scale == 1)
    }

    /// PSNR in dB of the picture of a side against the path-traced one, at the scene's own exposure. Methods that are made of the
    /// same samples have none.
    fn psnr(&self, side: Side) -> Option<f64> {
        self.reference()?;
        let state = self.state.as_ref()?;
        let made = self.sides[side.index()].as_ref()?;
        let (Content::Radiance(radiance), false) = (&made.content, state.method(side).refines()) else { return None };
        let exposure = self.stage.exposure();
        let display = |rgb: &Rgb| rgb.map(|p| color::display(*p, exposure));
        Some(psnr::capped(psnr::psnr(&display(radiance), &display(&self.stage.traced()?))))
    }

    /// Tells the page how far the pictures are from the path-traced one.
    fn compare(&self, state: &State) {
        if let Some(reference) = self.reference() {
            let [left, right] = Side::BOTH.map(|side| state.sides().contains(&side).then(|| self.psnr(side)).flatten());
            self.outbox.text(&Message::Psnr { state: state.id, left, right, reference });
        }
    }
}
