//! Numerical-stability checks, usable from tests and from `renderflow stress`.
//!
//! A [`Check`] runs many cases and returns one [`Outcome`] for every claim it tests: the worst value found, the limit it had to
//! keep, and where it was found. [`checks`] lists all of them. They need nothing but this library: no files, no network.
//!
//! A new check is a function `fn(Effort, &Ticker) -> Vec<Outcome>` and a line in the `CHECKS` of its file. It calls
//! [`Ticker::expect`] once, [`Ticker::add`] as it goes, and returns early with what it has when [`Ticker::cancelled`].

pub mod analytic;
pub mod bsdf;
pub mod chi_square;
pub mod clear;
pub mod determinism;
pub mod emitters;
pub mod film;
pub mod geometry;
pub mod leaks;
pub mod lights;
pub mod materials;
pub mod sampler;
pub mod scale;
pub mod scenes;

use serde::{Deserialize, Serialize};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// The result of testing one claim.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Outcome {
    /// What was claimed, within its check.
    pub name: String,
    /// How many cases were tried.
    pub cases: u64,
    /// The value of the worst case; always finite.
    pub worst: f64,
    /// The value it had to keep to.
    pub limit: f64,
    /// Whether it did.
    pub passed: bool,
    /// Where the worst case was.
    pub detail: String,
}

impl Outcome {
    /// A claim that `worst` is at most `limit`. Not a number fails, and is stored as the largest number.
    pub fn at_most(name: impl Into<String>, cases: u64, worst: f64, limit: f64, detail: impl Into<String>) -> Self {
        let stored = if worst.is_nan() { f64::MAX } else { worst.clamp(-f64::MAX, f64::MAX) };
        Self { name: name.into(), cases, worst: stored, limit, passed: worst <= limit, detail: detail.into() }
    }

    /// A claim that `worst` is at least `limit`. Not a number fails, and is stored as the smallest number.
    pub fn at_least(name: impl Into<String>, cases: u64, worst: f64, limit: f64, detail: impl Into<String>) -> Self {
        let stored = if worst.is_nan() { -f64::MAX } else { worst.clamp(-f64::MAX, f64::MAX) };
        Self { name: name.into(), cases, worst: stored, limit, passed: worst >= limit, detail: detail.into() }
    }
}

/// The largest of many values, with where it was. Not a number counts as larger than any number.
#[derive(Clone, Debug, Default)]
pub struct Worst {
    cases: u64,
    value: Option<f64>,
    place: String,
}

impl Worst {
    /// Takes one case into account; `place` is asked only when it is the worst so far.
    pub fn see(&mut self, value: f64, place: impl FnOnce() -> String) {
        self.cases += 1;
        let value = if value.is_nan() { f64::INFINITY } else { value };
        if self.value.is_none_or(|worst| value > worst) {
            self.value = Some(value);
            self.place = place();
        }
    }

    /// As if the cases of `other` had been seen here, after the own ones.
    pub fn merge(&mut self, other: Self) {
        self.cases += other.cases;
        if let Some(value) = other.value
            && self.value.is_none_or(|worst| value > worst)
        {
            self.value = Some(value);
            self.place = other.place;
        }
    }

    /// Largest value so far, 0 before the first.
    pub fn value(&self) -> f64 {
        self.value.unwrap_or(0.0)
    }

    /// The claim that no value was larger than `limit`; refuted when there was no case at all.
    pub fn at_most(self, name: impl Into<String>, limit: f64) -> Outcome {
        match self.value {
            Some(value) => Outcome::at_most(name, self.cases, value, limit, self.place),
            None => Outcome { passed: false, ..Outcome::at_most(name, 0, 0.0, limit, "no case was tried") },
        }
    }
}

/// How many cases to try.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Effort {
    /// All checks together in less than a minute on four cores.
    Quick,
    /// What a release must pass; all checks together in less than ten minutes on four cores.
    Full,
}

impl Effort {
    /// The one or the other.
    pub fn pick<T>(self, quick: T, full: T) -> T {
        match self {
            Self::Quick => quick,
            Self::Full => full,
        }
    }
}

/// How far a check is, and whether it should stop.
pub struct Ticker<'a> {
    report: &'a (dyn Fn(u64, u64) + Sync),
    cancel: &'a AtomicBool,
    done: AtomicU64,
    total: AtomicU64,
}

impl<'a> Ticker<'a> {
    /// `report` is called with units done and expected, from any thread; `cancel` asks the check to stop.
    pub fn new(report: &'a (dyn Fn(u64, u64) + Sync), cancel: &'a AtomicBool) -> Self {
        Self { report, cancel, done: 0.into(), total: 0.into() }
    }

    /// Adds to the units of work expected.
    pub fn expect(&self, units: u64) {
        let total = self.total.fetch_add(units, Ordering::Relaxed) + units;
        (self.report)(self.done.load(Ordering::Relaxed), total);
    }

    /// Says that `units` more are done.
    pub fn add(&self, units: u64) {
        let done = self.done.fetch_add(units, Ordering::Relaxed) + units;
        (self.report)(done, self.total.load(Ordering::Relaxed).max(done));
    }

    /// Whether the check should return with what it has; its outcomes will not be used.
    pub fn cancelled(&self) -> bool {
        self.cancel.load(Ordering::Relaxed)
    }

    /// The flag itself, for what takes one.
    pub fn cancel(&self) -> &AtomicBool {
        self.cancel
    }
}

/// One check of the suite.
#[derive(Clone, Copy, Debug)]
pub struct Check {
    /// Short and unique, `part.claim`.
    pub name: &'static str,
    /// What is compared with what, in a sentence.
    pub about: &'static str,
    /// Runs it.
    pub run: fn(Effort, &Ticker<'_>) -> Vec<Outcome>,
}

impl Check {
    /// Runs the check without showing its progress or stopping it, as tests do.
    pub fn outcomes(&self, effort: Effort) -> Vec<Outcome> {
        (self.run)(effort, &Ticker::new(&|_, _| (), &AtomicBool::new(false)))
    }
}

/// All checks, in the order to run them.
pub fn checks() -> Vec<Check> {
    [
        sampler::CHECKS,
        film::CHECKS,
        materials::CHECKS,
        clear::CHECKS,
        lights::CHECKS,
        emitters::CHECKS,
        leaks::CHECKS,
        determinism::CHECKS,
        scale::CHECKS,
        analytic::CHECKS,
    ]
    .concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_unique() {
        let mut names: Vec<_> = checks().iter().map(|c| c.name).collect();
        let count = names.len();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), count);
    }

    #[test]
    fn no_number_is_worse_than_any_number() {
        let mut worst = Worst::default();
        worst.see(3.0, || "three".into());
        worst.see(f64::NAN, || "none".into());
        worst.see(1e300, || "large".into());
        let outcome = worst.at_most("claim", 1e308);
        assert!(!outcome.passed && outcome.worst == f64::MAX && outcome.detail == "none" && outcome.cases == 3);
        assert!(!Outcome::at_least("claim", 1, f64::NAN, 0.0, "").passed);
        assert!(!Worst::default().at_most("nothing tried", 1.0).passed);
    }
}
