//! Shows the progress of long work on standard error: a bar on a terminal, a line every few seconds elsewhere.

use indicatif::{HumanDuration, ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::IsTerminal;
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// Seconds between lines where standard error is not a terminal.
const LINE_EVERY: Duration = Duration::from_secs(10);

/// One long job: `total` units of work, a title, and the current step.
pub struct Progress {
    bar: ProgressBar,
    title: String,
    started: Instant,
    /// When the last plain line was printed; `None` on a terminal, where the bar draws itself.
    last_line: Option<Mutex<Instant>>,
    /// Units that an earlier run did; they do not count for the rate.
    resumed: std::sync::atomic::AtomicU64,
}

impl Progress {
    /// Starts showing a job of `total` units.
    pub fn new(title: &str, total: u64) -> Self {
        let terminal = std::io::stderr().is_terminal();
        let bar = ProgressBar::with_draw_target(
            Some(total),
            if terminal { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() },
        );
        let style = ProgressStyle::with_template("{prefix:>12} [{bar:32}] {percent:>3}% {elapsed} elapsed, {eta} left  {msg}")
            .unwrap_or_else(|_| ProgressStyle::default_bar());
        bar.set_style(style.progress_chars("=> "));
        bar.set_prefix(title.to_owned());
        let last_line = (!terminal).then(|| Mutex::new(Instant::now()));
        Self { bar, title: title.to_owned(), started: Instant::now(), last_line, resumed: 0.into() }
    }

    /// Says that `units` were done by an earlier run.
    pub fn resume(&self, units: u64) {
        self.resumed.fetch_add(units, std::sync::atomic::Ordering::Relaxed);
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
        eprintln!("{:>12} done in {:.1} s", self.title, self.started.elapsed().as_secs_f64());
    }

    fn line(&self) {
        let Some(last) = &self.last_line else { return };
        let Ok(mut last) = last.try_lock() else { return };
        if last.elapsed() < LINE_EVERY {
            return;
        }
        *last = Instant::now();
        let (done, total) = (self.bar.position(), self.bar.length().unwrap_or(0));
        let fresh = done.saturating_sub(self.resumed.load(std::sync::atomic::Ordering::Relaxed));
        let left = self.started.elapsed().as_secs_f64() / fresh.max(1) as f64 * total.saturating_sub(done) as f64;
        eprintln!(
            "{:>12} {:>3}%, {} left  {}",
            self.title,
            100 * done / total.max(1),
            HumanDuration(Duration::from_secs_f64(left)),
            self.bar.message()
        );
    }
}
