use crate::util::cancel::Cancel;
use crate::util::progress::Progress;
use anyhow::{Context, Result, bail};
use clap::Args;
use renderflow_frame::file;
use renderflow_renderer::verify::{Check, Effort, Outcome, Ticker, checks};
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::path::PathBuf;
use std::time::Instant;

/// Test the numerics of the path tracer
///
/// The checks are of samplers, filters, film, materials, lights, geometry, determinism, and scenes whose picture is known in
/// closed form. The command prints a table, writes JSON, and fails if any claim fails. If it was stopped, the same command
/// continues.
#[derive(Args)]
#[command(after_help = "Examples:\n  renderflow stress --quick\n  renderflow stress --only film --again -o film.json")]
pub struct Stress {
    /// Test fewer cases: less than a minute on four cores
    #[arg(long)]
    quick: bool,
    /// Only checks whose name contains this; may be given several times
    #[arg(long, value_name = "NAME")]
    only: Vec<String>,
    /// List the checks and stop
    #[arg(long)]
    list: bool,
    /// File for the results. Checks that are finished in it, for this version and effort, do not run again
    #[arg(long, short = 'o', default_value = "stress.json")]
    out: PathBuf,
    /// Run everything again
    #[arg(long)]
    again: bool,
    /// Print the results, or the list, as JSON
    #[arg(long)]
    json: bool,
}

/// What the JSON file holds.
#[derive(Debug, Serialize, Deserialize)]
struct Results {
    /// Version of the program.
    version: String,
    effort: Effort,
    /// Whether every claim of every check in this file held.
    passed: bool,
    checks: Vec<CheckResult>,
}

/// One finished check.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct CheckResult {
    name: String,
    seconds: f64,
    outcomes: Vec<Outcome>,
}

/// Progress units of a check.
const UNITS: u64 = 1000;

impl Stress {
    pub fn run(self, cancel: &Cancel) -> Result<()> {
        let chosen = self.chosen()?;
        if self.list && self.json {
            let listed: Vec<_> = chosen.iter().map(|check| json!({ "name": check.name, "about": check.about })).collect();
            println!("{}", serde_json::to_string_pretty(&listed)?);
            return Ok(());
        }
        if self.list {
            let width = chosen.iter().map(|c| c.name.len()).max().unwrap_or(0);
            chosen.iter().for_each(|c| println!("{:width$}  {}", c.name, c.about));
            return Ok(());
        }
        let effort = if self.quick { Effort::Quick } else { Effort::Full };
        let mut results = self.earlier(effort)?;
        let progress = Progress::new("stress", chosen.len() as u64 * UNITS);
        for (number, check) in chosen.iter().enumerate() {
            let base = number as u64 * UNITS;
            progress.message(check.name);
            if results.checks.iter().any(|done| done.name == check.name) {
                progress.resume(UNITS);
                continue;
            }
            let result = run_check(check, effort, cancel, &|done, total| {
                progress.set(base + (UNITS * done / total.max(1)).min(UNITS));
            });
            cancel.check()?;
            progress.set(base + UNITS);
            results.checks.push(result);
            results.passed = results.checks.iter().all(CheckResult::passed);
            // Written after every check, so that an interruption loses only the check that is running.
            file::write_json(&self.out, &results)?;
        }
        progress.finish();

        let ran: Vec<&CheckResult> = results.checks.iter().filter(|r| chosen.iter().any(|c| c.name == r.name)).collect();
        if self.json {
            println!("{}", serde_json::to_string_pretty(&ran)?);
        } else {
            print!("{}", table(&ran));
        }
        let failed: Vec<&str> = ran.iter().filter(|r| !r.passed()).map(|r| r.name.as_str()).collect();
        if !self.json {
            println!("{}", self.out.display());
        }
        if !failed.is_empty() {
            bail!("{} of {} checks failed: {}", failed.len(), ran.len(), failed.join(", "));
        }
        Ok(())
    }

    fn chosen(&self) -> Result<Vec<Check>> {
        let all = checks();
        for name in &self.only {
            if !all.iter().any(|c| c.name.contains(name.as_str())) {
                bail!("--only {name}: no such check; --list shows them");
            }
        }
        let selected = |c: &Check| self.only.is_empty() || self.only.iter().any(|name| c.name.contains(name.as_str()));
        Ok(all.into_iter().filter(selected).collect())
    }

    /// Results to continue from. A file of another version or effort is replaced; a file that is something else stays.
    fn earlier(&self, effort: Effort) -> Result<Results> {
        let version = env!("CARGO_PKG_VERSION").to_owned();
        let fresh = Results { version, effort, passed: true, checks: Vec::new() };
        if !self.out.exists() {
            return Ok(fresh);
        }
        let found: Results =
            file::read_json(&self.out).context("not the results of an earlier run; choose another file with --out")?;
        let mut kept = if found.version == fresh.version && found.effort == effort { found } else { fresh };
        if self.again {
            kept.checks.retain(|r| !self.only.is_empty() && !self.only.iter().any(|name| r.name.contains(name.as_str())));
        }
        Ok(kept)
    }
}

impl CheckResult {
    fn passed(&self) -> bool {
        !self.outcomes.is_empty() && self.outcomes.iter().all(|o| o.passed)
    }
}

/// Runs one check. A panic inside is a failed claim, so that the other checks still run.
fn run_check(check: &Check, effort: Effort, cancel: &Cancel, report: &(dyn Fn(u64, u64) + Sync)) -> CheckResult {
    let started = Instant::now();
    let ticker = Ticker::new(report, cancel);
    let outcomes =
        std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| (check.run)(effort, &ticker))).unwrap_or_else(|payload| {
            let reason = crate::util::panic::message(payload.as_ref());
            vec![Outcome { passed: false, ..Outcome::at_most("does not panic", 0, 1.0, 0.0, reason) }]
        });
    CheckResult { name: check.name.to_owned(), seconds: started.elapsed().as_secs_f64(), outcomes }
}

/// One line for each claim; below a failed claim, where its worst case was.
fn table(results: &[&CheckResult]) -> String {
    let claims = || results.iter().flat_map(|r| r.outcomes.iter().map(move |o| (r, o)));
    let label = |r: &CheckResult, o: &Outcome| format!("{}: {}", r.name, o.name);
    let width = claims().map(|(r, o)| label(r, o).chars().count()).max().unwrap_or(0).max(5);
    let mut text =
        format!("{:width$}  {:>11}  {:>10}  {:>10}  {:>6}  {:>7}\n", "check", "cases", "worst", "limit", "passed", "seconds");
    for result in results {
        for (i, outcome) in result.outcomes.iter().enumerate() {
            let seconds = if i == 0 { format!("{:.1}", result.seconds) } else { String::new() };
            text += &format!(
                "{:width$}  {:>11}  {:>10.3e}  {:>10.3e}  {:>6}  {seconds:>7}\n",
                label(result, outcome),
                outcome.cases,
                outcome.worst,
                outcome.limit,
                if outcome.passed { "yes" } else { "NO" },
            );
            if !outcome.passed {
                outcome.detail.lines().for_each(|line| text += &format!("    {line}\n"));
            }
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_show_the_place_of_failures_only() {
        let outcomes = vec![
            Outcome::at_most("small enough", 10, 0.5, 1.0, "never shown"),
            Outcome::at_most("too large", 7, 2.0, 1.0, "pixel 3"),
        ];
        let text = table(&[&CheckResult { name: "part.claim".into(), seconds: 1.25, outcomes }]);
        assert_eq!(text.lines().count(), 4, "{text}");
        assert!(text.contains("pixel 3") && !text.contains("never shown") && text.contains("NO"), "{text}");
    }

    #[test]
    fn a_panic_is_a_failed_claim() {
        let check = Check { name: "a", about: "b", run: |_, _| panic!("on purpose: {}", 7) };
        let result = run_check(&check, Effort::Quick, &Cancel::default(), &|_, _| ());
        assert!(!result.passed() && result.outcomes[0].detail.contains("on purpose: 7"), "{result:?}");
    }
}
