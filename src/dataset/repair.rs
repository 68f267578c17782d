//! `renderflow dataset repair`: makes again what is damaged or missing.

use super::damage::{self, Depth};
use super::mend::{known_plan, plan_of, set_aside};
use super::plan::{Allowed, Plan, SPLITS};
use super::render::{self, Summary};
use super::shard::Shard;
use crate::dataset::layout::{MANIFEST, PLAN};
use crate::util::cancel::Cancel;
use crate::util::files;
use crate::util::output::Hold;
use anyhow::{Context, Result, ensure};
use renderflow_frame::file;
use std::path::{Path, PathBuf};

/// What `repair` did.
#[derive(Clone, Debug, Default)]
pub struct Repaired {
    /// Frames made and kept, and sequences that were damaged.
    pub summary: Summary,
    /// The plan or the manifest, if it was written again.
    pub rewritten: Vec<&'static str>,
    /// Folders that hold a sequence but do not belong to the plan.
    pub strangers: Vec<PathBuf>,
}

/// Repairs the dataset in `out`: examines it as closely as `verify` does, and makes what is damaged or missing again. `plan` is
/// only needed where the dataset's own plan is damaged and no log holds it. Its models may name files in the folders `allowed`.
///
/// # Errors
/// As [`render::run`]; when the plan is damaged and cannot be found; when another process repairs or renders the dataset.
pub fn repair(out: &Path, plan: Option<&Plan>, allowed: Allowed, stop: &Cancel) -> Result<Repaired> {
    let hold = Hold::new(out)?;
    let mut repaired = Repaired::default();
    let found = match plan_of(out) {
        // Only a plan from elsewhere can help.
        Err(error) if plan.is_some() && out.join(PLAN).exists() => Err(crate::util::console::message(&error)),
        found => found?,
    };
    let own = match found {
        Ok(own) => {
            if let Some(plan) = plan {
                ensure!(own == *plan, "--plan: the dataset was made from another plan, which its {PLAN} holds");
            }
            own
        }
        Err(reason) => {
            let found = lost_plan(out, plan).with_context(|| reason.clone())?;
            eprintln!("note: {reason}; written again");
            if !out.join(PLAN).is_file() && out.join(PLAN).exists() {
                set_aside(out, &out.join(PLAN))?;
            }
            file::write_json(&out.join(PLAN), &found)?;
            repaired.rewritten.push(PLAN);
            found
        }
    };
    for folder in SPLITS.map(|split| out.join(split.name())).iter().chain(&[out.join("logs")]) {
        if folder.exists() && !folder.is_dir() {
            let aside = set_aside(out, folder)?;
            eprintln!("note: {}: is not a folder and was moved to {}", folder.display(), aside.display());
        }
    }
    let path = out.join(MANIFEST);
    if path.exists() && !path.is_file() {
        let aside = set_aside(out, &path)?;
        eprintln!("note: {}: is not a file and was moved to {}", path.display(), aside.display());
    }
    let before = files::hash(&path).ok();
    let own = Plan { allowed, ..own };
    repaired.summary = render::run_at(&own, out, Shard { index: 1, count: 1 }, (Depth::Pixels, &|_| true), Some(&hold), stop)?;
    if before != files::hash(&path).ok() {
        repaired.rewritten.push(MANIFEST);
    }
    repaired.strangers = damage::strangers(&own, out)?;
    Ok(repaired)
}

/// Finds the plan of a dataset that has lost it: the plan that is `given`, what is left of the file, or a plan in its logs.
fn lost_plan(out: &Path, given: Option<&Plan>) -> Result<Plan> {
    let known = known_plan(out);
    let fits = |plan: &Plan| known.as_ref().is_none_or(|known| *known == plan.hash());
    if let Some(plan) = given {
        ensure!(fits(plan), "--plan: the dataset was made from another plan");
        return Ok(plan.clone());
    }
    if let Some(plan) = Plan::read(&out.join(PLAN)).ok().filter(|plan| known.is_some() && fits(plan)) {
        return Ok(plan);
    }
    let logged = super::log::plans(out).into_iter().rev().find(|plan| plan.check().is_ok() && fits(plan));
    logged.with_context(|| format!("no log of the dataset holds its plan; name it: {} --plan PLAN", damage::remedy(out)))
}
