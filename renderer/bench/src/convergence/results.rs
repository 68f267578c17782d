//! What a measurement found, as the JSON file holds it, and what follows from it.

use super::Method;
use crate::Machine;
use renderflow::metrics::displayed::Displayed;
use renderflow::metrics::median;
use renderflow::metrics::relmse::RelMse;
use renderflow::util::clock::Spent;
use renderflow_renderer::Stats;
use serde::{Deserialize, Serialize};

/// What rows must share to stand in one table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Conditions {
    /// Pixels along both sides.
    pub resolution: u32,
    /// Scattering events of a path.
    pub max_bounces: u32,
    /// Samples a pixel of the references.
    pub reference_spp: u32,
}

/// The JSON file.
#[derive(Debug, Serialize, Deserialize)]
pub struct Results {
    /// What it was measured with.
    pub machine: Machine,
    /// What is the same for every row.
    pub conditions: Conditions,
    /// One a scene, in the order they were measured in.
    pub scenes: Vec<SceneResult>,
}

/// Rows of one scene.
#[derive(Debug, Serialize, Deserialize)]
pub struct SceneResult {
    /// Name of the scene.
    pub name: String,
    /// Hash of its description and files.
    pub hash: String,
    /// Triangles, instances counted each.
    pub triangles: usize,
    /// Making trees and tables.
    pub compile: Spent,
    /// Seconds of rendering the reference.
    pub reference_seconds: f64,
    /// What the noise of the reference would add to relMSE; it is taken off.
    pub reference_noise: f64,
    /// Methods and samples a pixel.
    pub rows: Vec<Row>,
}

/// One method at one number of samples, all repeats.
#[derive(Debug, Serialize, Deserialize)]
pub struct Row {
    /// How samples were spent.
    pub method: Method,
    /// Samples a pixel that were asked for.
    pub spp: u32,
    /// One a repeat.
    pub runs: Vec<Run>,
}

/// One picture.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Run {
    /// Seed of its random numbers.
    pub seed: u64,
    /// Time of rendering beauty, variance and G-buffer.
    pub time: Spent,
    /// Samples a pixel on average.
    pub spp: f64,
    /// What was traced.
    pub stats: Stats,
    /// Error of the radiance.
    pub relmse: RelMse,
    /// Error of what a screen shows.
    pub displayed: Displayed,
}

impl Row {
    fn over(&self, value: impl Fn(&Run) -> f64) -> Vec<f64> {
        self.runs.iter().map(value).collect()
    }

    pub(super) fn mean(&self, value: impl Fn(&Run) -> f64) -> f64 {
        self.over(value).iter().sum::<f64>() / self.runs.len().max(1) as f64
    }

    /// Median seconds of the repeats.
    pub fn seconds(&self) -> f64 {
        median(&self.over(|run| run.time.seconds))
    }

    /// Error of one sample a pixel, were it to fall as that of independent samples does.
    pub fn per_sample(&self) -> f64 {
        self.relmse().mean * self.mean(|r| r.spp)
    }

    /// Median processor seconds of the repeats.
    pub fn processor(&self) -> Option<f64> {
        let known: Vec<f64> = self.runs.iter().filter_map(|run| run.time.processor).collect();
        (!known.is_empty()).then(|| median(&known))
    }

    /// Mean errors of the repeats.
    pub fn relmse(&self) -> RelMse {
        RelMse {
            mean: self.mean(|r| r.relmse.mean),
            trimmed: self.mean(|r| r.relmse.trimmed),
            clipped: self.mean(|r| r.relmse.clipped),
            median: self.mean(|r| r.relmse.median),
        }
    }

    /// Millions of `count` a second.
    pub(super) fn rate(&self, count: impl Fn(&Stats) -> u64) -> f64 {
        1e-6 * self.mean(|r| count(&r.stats) as f64) / self.seconds()
    }
}

impl SceneResult {
    pub(super) fn row(&mut self, method: Method, spp: u32) -> &mut Row {
        let at = self.rows.iter().position(|r| (r.method, r.spp) == (method, spp)).unwrap_or_else(|| {
            self.rows.push(Row { method, spp, runs: Vec::new() });
            self.rows.len() - 1
        });
        &mut self.rows[at]
    }

    pub(super) fn has(&self, method: Method, spp: u32, seed: u64) -> bool {
        self.rows.iter().any(|r| (r.method, r.spp) == (method, spp) && r.runs.iter().any(|run| run.seed == seed))
    }

    pub(super) fn of(&self, method: Method) -> impl Iterator<Item = &Row> {
        self.rows.iter().filter(move |row| row.method == method)
    }
}

/// When a falling error reached a goal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reached {
    /// After these seconds, between two rows.
    At(f64),
    /// Before the first row, which took these seconds.
    Before(f64),
    /// Not by the last row, which took these seconds.
    After(f64),
}

impl std::fmt::Display for Reached {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::At(seconds) => write!(f, "{}", three(*seconds)),
            Self::Before(seconds) => write!(f, "< {}", three(*seconds)),
            Self::After(seconds) => write!(f, "> {}", three(*seconds)),
        }
    }
}

/// Seconds to reach `goal`, linear in the logarithms between the two (seconds, error) around it; `None` without points.
pub fn reached(points: &[(f64, f64)], goal: f64) -> Option<Reached> {
    let after = points.iter().position(|&(_, error)| error <= goal);
    Some(match after {
        Some(0) => Reached::Before(points[0].0),
        Some(i) => {
            let ((t0, e0), (t1, e1)) = (points[i - 1], points[i]);
            // An error at or below 0 (less than the reference's noise) has no logarithm: reached by then.
            let share = if e1 > 0.0 { (e0 / goal).ln() / (e0 / e1).ln() } else { 1.0 };
            Reached::At((t0.ln() + share * (t1 / t0).ln()).exp())
        }
        None => Reached::After(points.last()?.0),
    })
}

/// Three significant digits.
pub(super) fn three(value: f64) -> String {
    let digits = if value > 0.0 { (2 - value.log10().floor() as i32).clamp(0, 6) } else { 2 };
    format!("{value:.*}", digits as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_goal_is_found_between_points() {
        // Error = 0.08 / t.
        let points: Vec<(f64, f64)> = [1.0, 2.0, 4.0, 16.0].map(|t| (t, 0.08 / t)).to_vec();
        let Some(Reached::At(seconds)) = reached(&points, 0.01) else { panic!("{:?}", reached(&points, 0.01)) };
        assert!((seconds - 8.0).abs() < 1e-9, "{seconds}");
        assert_eq!(reached(&points, 0.1), Some(Reached::Before(1.0)));
        assert_eq!(reached(&points, 1e-3), Some(Reached::After(16.0)));
        assert_eq!(reached(&[(1.0, 0.1), (2.0, -1e-5)], 0.01), Some(Reached::At(2.0)));
        assert_eq!(reached(&[], 0.01), None);
        assert_eq!(["0.00123", "12.3", "1234"].map(|s| three(s.parse().unwrap())), ["0.00123", "12.3", "1234"]);
    }
}
