//! Shows the progress of long work on standard error: a bar on a terminal, a line every few seconds elsewhere.

use indicatif::{HumanDuration, ProgressBar, ProgressDrawTarget, ProgressState, ProgressStyle};
use std::fmt::Write;
use std::io::IsTerminal;
use std::sync::atomic::{AtomicU8, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Seconds between lines where standard error is not a terminal.
const LINE_EVERY: Duration = Duration::from_secs(10);

/// How progress is shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum Display {
    /// A bar on a terminal, lines elsewhere.
    #[default]
    Usual,
    /// Lines, which other lines on standard error do not disturb.
    Lines,
    /// Nothing.
    Nothing,
}

/// The [`Display`] of every job.
static DISPLAY: AtomicU8 = AtomicU8::new(Display::Usual as u8);

/// Chooses how the progress of all later jobs is shown.
pub fn display(how: Display) {
    DISPLAY.store(how as u8, Ordering::Relaxed);
}

/// Whether no progress is shown.
fn is_quiet() -> bool {
    DISPLAY.load(Ordering::Relaxed) == Display::Nothing as u8
}

/// One long job: `total` units of work, a title, and the current step.
pub struct Progress {
    bar: ProgressBar,
    title: String,
    started: Instant,
    /// When the last plain line was printed; `None` where the bar draws itself, or nothing is shown.
    last_line: Option<Mutex<Instant>>,
    /// Units that an earlier run did; they do not count for the rate.
    resumed: Arc<AtomicU64>,
}

impl Progress {
    /// Starts showing a job of `total` units.
    pub fn new(title: &str, total: u64) -> Self {
        let usual = DISPLAY.load(Ordering::Relaxed) == Display::Usual as u8;
        let draws = usual && std::io::stderr().is_terminal();
        let target = if draws { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() };
        let bar = ProgressBar::with_draw_target(Some(total), target);
        let resumed = Arc::new(AtomicU64::new(0));
        let before = Arc::clone(&resumed);
        let remaining = move |state: &ProgressState, out: &mut dyn Write| {
            let (done, total) = (state.pos(), state.len().unwrap_or(0));
            // The bar draws nothing else where this cannot be written.
            let _ = out.write_str(&shown(left(state.elapsed(), before.load(Ordering::Relaxed), done, total), ", "));
        };
        let style = ProgressStyle::with_template("{prefix:>12} [{bar:32}] {percent:>3}% {elapsed} elapsed{remaining}  {msg}")
            .unwrap_or_else(|_| ProgressStyle::default_bar());
        bar.set_style(style.with_key("remaining", remaining).progress_chars("=> "));
        bar.set_prefix(title.to_owned());
        let last_line = (!draws && !is_quiet()).then(|| Mutex::new(Instant::now()));
        Self { bar, title: title.to_owned(), started: Instant::now(), last_line, resumed }
    }

    /// Says that `units` were done by an earlier run.
    pub fn resume(&self, units: u64) {
        self.resumed.fetch_add(units, Ordering::Relaxed);
        self.bar.inc(units);
        self.bar.reset_eta();
    }

    /// Sets the number of units in all, where it was not known before.
    pub fn length(&self, total: u64) {
        self.bar.set_length(total);
    }

    /// Sets the units done so far.
    pub fn set(&self, done: u64) {
        self.bar.set_position(done);
        self.line();
    }

    /// Units done so far.
    pub fn position(&self) -> u64 {
        self.bar.position()
    }

    /// Adds finished units.
    pub fn add(&self, units: u64) {
        self.bar.inc(units);
        self.line();
    }

    /// Sets the name of the current step.
    pub fn message(&self, text: impl Into<String>) {
        self.bar.set_message(text.into());
    }

    /// Prints with `print` while the bar is out of the way.
    pub fn hide<T>(&self, print: impl FnOnce() -> T) -> T {
        self.bar.suspend(print)
    }

    /// Prints a line on standard output while the bar is out of the way.
    pub fn print(&self, line: &str) {
        self.bar.suspend(|| println!("{line}"));
    }

    /// Ends the display.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
        if !is_quiet() {
            eprintln!("{:>12} done in {:.1} s", self.title, self.started.elapsed().as_secs_f64());
        }
    }

    fn line(&self) {
        let Some(last) = &self.last_line else { return };
        let Ok(mut last) = last.try_lock() else { return };
        if last.elapsed() < LINE_EVERY {
            return;
        }
        *last = Instant::now();
        let (done, total) = (self.bar.position(), self.bar.length().unwrap_or(0));
        let left = left(self.started.elapsed(), self.resumed.load(Ordering::Relaxed), done, total);
        eprintln!("{:>12} {:>3}%{}  {}", self.title, 100 * done / total.max(1), shown(left, ", "), self.bar.message());
    }
}

/// Estimates the time left after `elapsed`, where `resumed` of the `done` units were done before. There is no estimate in the
/// first second, nor before 3 % of the work or half a minute has gone by: it would be far off.
fn left(elapsed: Duration, resumed: u64, done: u64, total: u64) -> Option<Duration> {
    let (fresh, missing) = (done.saturating_sub(resumed), total.saturating_sub(done));
    let enough = 100 * fresh >= 3 * (fresh + missing) || elapsed >= Duration::from_secs(30);
    if fresh == 0 || elapsed < Duration::from_secs(1) || !enough {
        return None;
    }
    Some(elapsed.mul_f64(missing as f64 / fresh as f64))
}

/// The time left, after `before`; empty where it is not known.
fn shown(left: Option<Duration>, before: &str) -> String {
    left.map_or_else(String::new, |left| format!("{before}{} left", HumanDuration(left)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_is_no_estimate_before_there_is_something_to_estimate_from() {
        let left = |milliseconds, resumed, done| left(Duration::from_millis(milliseconds), resumed, done, 1000);
        for (milliseconds, resumed, done) in
            [(0, 0, 0), (900, 0, 500), (5000, 0, 29), (5000, 500, 510), (40_000, 0, 0), (40_000, 70, 70)]
        {
            assert_eq!(left(milliseconds, resumed, done), None, "{milliseconds} ms, {done} of 1000, {resumed} before");
        }
        assert_eq!(left(3000, 0, 30), Some(Duration::from_secs(97)));
        assert_eq!(left(10_000, 500, 750), Some(Duration::from_secs(10)));
        assert_eq!(left(60_000, 0, 1), Some(Duration::from_secs(59_940)));
        assert_eq!(left(60_000, 0, 1000), Some(Duration::ZERO));
        assert_eq!([shown(None, ", "), shown(Some(Duration::from_secs(59)), ", ")], ["", ", 59 seconds left"]);
    }
}
