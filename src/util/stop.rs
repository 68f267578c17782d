//! Decides what the first and the second interrupt or termination signal do.
//!
//! Long work checks a flag between its steps, and stores what is done before it ends. Where a step takes long and stores nothing
//! meanwhile, the signal ends the process at once ([`at_once`]), except while something is stored ([`hold`]). The second signal
//! always ends the process.

use super::cancel::{Cancel, Interrupted};
use anyhow::{Context, Result};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Exit code of work that was interrupted and can be resumed.
pub const RESUMABLE: u8 = 75;
/// Exit code of a command that was interrupted and leaves nothing behind: 128 + 2, as in shells.
pub const NOTHING_TO_RESUME: u8 = 130;

/// What a signal may do now.
struct State {
    /// Exit code, if a signal may end the process.
    at_once: Option<u8>,
    /// Number of things that are being stored.
    held: usize,
    /// The flag that the first signal sets.
    flag: Option<Cancel>,
}

static STATE: Mutex<State> = Mutex::new(State { at_once: None, held: 0, flag: None });

fn state() -> MutexGuard<'static, State> {
    STATE.lock().unwrap_or_else(PoisonError::into_inner)
}

impl State {
    /// Ends the process if that is allowed. The lock is held until the end, so that nothing starts to be stored.
    fn end_if_free(&self) {
        if let (Some(code), 0) = (self.at_once, self.held) {
            if code == RESUMABLE {
                eprintln!("{}", Interrupted);
            }
            std::process::exit(code.into());
        }
    }
}

/// Listens for interrupts, terminations and hangups. The first one sets the flag. A hangup that was ignored when the process
/// began stays ignored on Linux, as `nohup` wants it.
pub fn listen() -> Result<Cancel> {
    let flag = Cancel::default();
    state().flag = Some(flag.clone());
    let first = flag.clone();
    on_signals(move || {
        if first.set() {
            std::process::exit(RESUMABLE.into());
        }
        state().end_if_free();
        eprintln!("stopping after the current step; press Ctrl-C again to stop at once");
    })
    .context("cannot listen for interrupts")?;
    Ok(flag)
}

/// Calls `act` on a thread of its own for every signal.
#[cfg(unix)]
fn on_signals(act: impl Fn() + Send + 'static) -> std::io::Result<()> {
    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
    let mut signals = signal_hook::iterator::Signals::new([SIGINT, SIGTERM])?;
    if !is_ignored(SIGHUP) {
        signals.add_signal(SIGHUP)?;
    }
    let wait = move || signals.forever().for_each(|_| act());
    std::thread::Builder::new().name("signals".into()).spawn(wait).map(drop)
}

/// Whether the process was started with this signal ignored. Only Linux tells.
#[cfg(unix)]
fn is_ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    mask.is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}

#[cfg(not(unix))]
fn on_signals(act: impl FnMut() + Send + 'static) -> Result<(), ctrlc::Error> {
    ctrlc::set_handler(act)
}

/// Does `work`, during which the first signal ends the process with exit code `code`. Nothing else may run at that time.
pub fn at_once<T>(code: u8, work: impl FnOnce() -> T) -> T {
    let before = state().at_once.replace(code);
    let _after = OnDrop(|| state().at_once = before);
    work()
}

/// Does `work`, during which a signal does not end the process. A signal takes effect afterwards.
pub fn hold<T>(work: impl FnOnce() -> T) -> T {
    state().held += 1;
    let _after = OnDrop(|| {
        let mut state = state();
        state.held -= 1;
        if state.flag.as_ref().is_some_and(Cancel::is_set) {
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
