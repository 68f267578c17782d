//! What the page has asked for and the renderer has not yet seen.

use super::state::{Request, State};
use crate::util::cancel::Cancel;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// Most requests that wait; a page that sends more loses the oldest.
const MOST: usize = 64;

/// What waits.
#[derive(Default)]
pub struct Inbox {
    waiting: Mutex<Waiting>,
    changed: Condvar,
}

#[derive(Default)]
struct Waiting {
    state: Option<Box<State>>,
    requests: Vec<Request>,
    joined: bool,
    left: bool,
    stopped: bool,
    /// Stops what is being rendered.
    work: Cancel,
}

/// What has waited.
#[derive(Default)]
pub struct Taken {
    /// The newest state.
    pub state: Option<Box<State>>,
    /// The other requests, oldest first.
    pub requests: Vec<Request>,
    /// Whether a page has come.
    pub joined: bool,
    /// Whether the page has gone.
    pub left: bool,
    /// Whether the program ends.
    pub stopped: bool,
    /// Is set when a newer state comes.
    pub work: Cancel,
}

impl Inbox {
    fn waiting(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds a request. A state replaces the one before it, and stops what is rendered for that one.
    pub fn put(&self, request: Request) {
        let mut waiting = self.waiting();
        match request {
            Request::State(state) => {
                waiting.work.set();
                waiting.state = Some(state);
            }
            other => {
                if waiting.requests.len() >= MOST {
                    waiting.requests.remove(0);
                }
                waiting.requests.push(other);
            }
        }
        self.changed.notify_one();
    }

    /// Says that a page has come. What an earlier page asked for is forgotten.
    pub fn join(&self) {
        let mut waiting = self.waiting();
        waiting.work.set();
        *waiting = Waiting { joined: true, stopped: waiting.stopped, work: waiting.work.clone(), ..Waiting::default() };
        self.changed.notify_one();
    }

    /// Says that the page has gone.
    pub fn leave(&self) {
        let mut waiting = self.waiting();
        waiting.work.set();
        waiting.left = true;
        self.changed.notify_one();
    }

    /// Says that the program ends.
    pub fn stop(&self) {
        let mut waiting = self.waiting();
        waiting.work.set();
        waiting.stopped = true;
        self.changed.notify_one();
    }

    /// Takes everything. If nothing is there, it returns at once, or waits if `wait`.
    pub fn take(&self, wait: bool) -> Taken {
        let mut waiting = self.waiting();
        let empty = |w: &Waiting| w.state.is_none() && w.requests.is_empty() && !(w.joined || w.left || w.stopped);
        while wait && empty(&waiting) {
            waiting = self.changed.wait(waiting).unwrap_or_else(PoisonError::into_inner);
        }
        let waiting = &mut *waiting;
        if waiting.work.is_set() {
            waiting.work = Cancel::default();
        }
        Taken {
            state: waiting.state.take(),
            requests: std::mem::take(&mut waiting.requests),
            joined: std::mem::take(&mut waiting.joined),
            left: std::mem::take(&mut waiting.left),
            stopped: waiting.stopped,
            work: waiting.work.clone(),
        }
    }
}
