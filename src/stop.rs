//! Stopping: what the first interrupt or termination signal does, and what the second.
//!
//! Long work asks a flag between its steps and stores what is done before it ends. Where a step can take long and nothing is stored
//! meanwhile, the signal ends the process at once ([`at_once`]), but for moments in which something is ([`hold`]). The second signal
//! ends the process in any case.

use anyhow::{Context, Result};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Exit code of work that was interrupted and can be resumed.
pub const RESUMABLE: u8 = 75;
/// Exit code of a command that was interrupted and leaves nothing behind, as shells have it for interrupts (128 + 2).
pub const NOTHING_TO_RESUME: u8 = 130;

/// What may happen at a signal.
struct State {
    /// Exit code where a signal may end the process.
    at_once: Option<u8>,
    /// How many things are being stored.
    held: usize,
    /// The flag that the first signal sets.
    flag: Option<Arc<AtomicBool>>,
}

static STATE: Mutex<State> = Mutex::new(State { at_once: None, held: 0, flag: None });

fn state() -> MutexGuard<'static, State> {
    STATE.lock().unwrap_or_else(PoisonError::into_inner)
}

impl State {
    /// Ends the process if it may end. The lock is held until then, so that nothing begins to be stored.
    fn end_if_free(&self) {
        if let (Some(code), 0) = (self.at_once, self.held) {
            if code == RESUMABLE {
                eprintln!("{}", crate::truth::Interrupted);
            }
            std::process::exit(code.into());
        }
    }
}

/// Listens for signals; the first sets the flag.
pub fn listen() -> Result<Arc<AtomicBool>> {
    let flag = Arc::new(AtomicBool::new(false));
    state().flag = Some(Arc::clone(&flag));
    let first = Arc::clone(&flag);
    ctrlc::set_handler(move || {
        if first.swap(true, Ordering::SeqCst) {
            std::process::exit(RESUMABLE.into());
        }
        state().end_if_free();
        eprintln!("stopping after the current step; once more to stop at once");
    })
    .context("cannot listen for interrupts")?;
    Ok(flag)
}

/// Does `work`, in which the first signal ends the process with exit code `code`. It must be all there is to do at the time.
pub fn at_once<T>(code: u8, work: impl FnOnce() -> T) -> T {
    let before = state().at_once.replace(code);
    let _after = OnDrop(|| state().at_once = before);
    work()
}

/// Does `work`, in which a signal does not end the process: it is heeded afterwards.
pub fn hold<T>(work: impl FnOnce() -> T) -> T {
    state().held += 1;
    let _after = OnDrop(|| {
        let mut state = state();
        state.held -= 1;
        if state.flag.as_ref().is_some_and(|flag| flag.load(Ordering::SeqCst)) {
            state.end_if_free();
        }
    });
    work()
}

/// Does something however a scope is left.
struct OnDrop<F: FnMut()>(F);

impl<F: FnMut()> Drop for OnDrop<F> {
    fn drop(&mut self) {
        (self.0)();
    }
}
