//! Makes a test set: renders what is missing, estimates the error of its truth, and proves all of it.

use super::audit::{AUDIT, Audit, decibel};
use super::{Sources, TestSet, audit, check_scenes};
use crate::dataset::damage;
use crate::dataset::manifest::MANIFEST;
use crate::dataset::plan::Plan;
use crate::dataset::{Shard, manifest, render, verify};
use crate::metrics::psnr::CAP;
use crate::output;
use crate::truth::is_keyframe;
use anyhow::{Context, Result, bail, ensure};
use renderflow_frame::file;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::sync::atomic::AtomicBool;

/// File name of [`SetFile`].
pub const SET: &str = "set.json";

/// What a finished set consists of.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SetFile {
    /// Name of the set.
    pub set: String,
    /// Folder, BLAKE3 of the plan and BLAKE3 of the manifest (which holds those of all files) of every class.
    pub classes: Vec<(String, String, String)>,
    /// BLAKE3 of all that: equal where two sets are equal to the byte. Other processors and other versions of the denoiser round
    /// differently; their scenes are the same and their pictures nearly.
    pub blake3: String,
}

impl SetFile {
    fn new(set: &str, classes: Vec<(String, String, String)>) -> Result<Self> {
        let blake3 = blake3::hash(&serde_json::to_vec(&classes)?).to_hex().to_string();
        Ok(Self { set: set.into(), classes, blake3 })
    }
}

/// How much of a set is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Extent {
    /// The part of every class that is this process's.
    pub shard: Shard,
    /// Of every so many frames only the first two, beside the keyframes: what an evaluation of two in so many reads; 1 = all.
    pub every: u32,
    /// Samples a pixel of the longer render that tells how far the truth is from the truth; 0 = none.
    pub audited: u32,
}

impl Extent {
    /// Whether frame `number` of a sequence of `plan` is made.
    fn holds(&self, plan: &Plan, number: usize) -> bool {
        let at = number / plan.frame_step as usize;
        let audited = self.audited > 0 && audit::frame(plan) == Some(number);
        at % (self.every.max(1) as usize) < 2 || is_keyframe(plan.keyframe_gap(), number) || audited
    }
}

/// Makes `set` in `out/<set>`, or goes on with it; a shard makes its part of every class. Returns the finished set; `None` where
/// frames or the parts of other shards are missing.
///
/// # Errors
/// As [`render::run`]; when this program would not make the scenes of the published set.
pub fn make(set: TestSet, sources: &Sources, out: &Path, extent: Extent, cancel: &AtomicBool) -> Result<Option<SetFile>> {
    let plans = set.plans(sources)?;
    check_folders(&out.join(set.name()), &plans)?;
    check_scenes(set, &plans)?;
    make_plans(set.name(), &plans, out, extent, cancel)
}

/// Checks that what is in the folders of the classes, if anything, is of their plans: before any of them is rendered.
fn check_folders(folder: &Path, plans: &[(&str, Plan)]) -> Result<()> {
    for (name, plan) in plans {
        let path = folder.join(name).join("plan.json");
        if output::exists(&path) {
            let there: Plan = file::read_json(&path)?;
            ensure!(there == *plan, "{}: the folder holds a dataset of another plan; choose another folder", path.display());
        }
    }
    Ok(())
}

/// [`make`] for any plans, by the name of their class.
///
/// # Errors
/// As [`render::run`].
pub fn make_plans(set: &str, plans: &[(&str, Plan)], out: &Path, extent: Extent, cancel: &AtomicBool) -> Result<Option<SetFile>> {
    let folder = out.join(set);
    check_folders(&folder, plans)?;
    for (i, (name, plan)) in plans.iter().enumerate() {
        eprintln!("{set} {name}, {} of {}", i + 1, plans.len());
        let class = folder.join(name);
        let wanted = |number: usize| extent.holds(plan, number);
        render::run_some(plan, &class, extent.shard, &wanted, cancel).with_context(|| (*name).to_owned())?;
        if extent.audited > 0 {
            audit::run(plan, &class, extent.shard, extent.audited, cancel).with_context(|| (*name).to_owned())?;
        }
    }
    if !plans.iter().all(|(name, plan)| manifest::complete(plan, &folder.join(name))) {
        return Ok(None);
    }
    let file = describe(set, &folder, plans)?;
    file::write_json(&folder.join(SET), &file)?;
    Ok(Some(file))
}

fn describe(set: &str, folder: &Path, plans: &[(&str, Plan)]) -> Result<SetFile> {
    let class = |(name, plan): &(&str, Plan)| -> Result<_> {
        Ok(((*name).to_owned(), plan.hash(), damage::hash(&folder.join(name).join(MANIFEST))?))
    };
    SetFile::new(set, plans.iter().map(class).collect::<Result<_>>()?)
}

/// Proves the finished set in `folder`: every file's hash, every frame's channels, the plans, the set's own hash. Prints what it finds.
///
/// # Errors
/// When anything is missing or differs.
pub fn check(folder: &Path, cancel: &AtomicBool) -> Result<SetFile> {
    let set: SetFile = file::read_json(&folder.join(SET)).context("not a finished test set")?;
    let mut found = Vec::new();
    for (name, plan_hash, _) in &set.classes {
        let class = folder.join(name);
        let plan = Plan::read(&class.join("plan.json"))?;
        ensure!(plan.hash() == *plan_hash, "{}: is of another plan than {SET} says", class.display());
        let verified = verify::verify(&class, cancel)?;
        println!("{name}: {} sequences, {} frames, {} bytes", verified.sequences, verified.frames, verified.bytes);
        if let Some(fault) = verified.faults.first() {
            bail!("{}: {} faults, the first: {fault}", class.display(), verified.faults.len());
        }
        found.push((name.clone(), plan.hash(), damage::hash(&class.join(MANIFEST))?));
    }
    ensure!(found == set.classes, "{}: {SET} does not say what is there", folder.display());
    let whole = SetFile::new(&set.set, found)?;
    ensure!(
        whole == set,
        "{}: {SET} does not say what is there: its digest is {:.16}, that of these classes {:.16}; testset make writes it again, and renders nothing that is there",
        folder.display(),
        set.blake3,
        whole.blake3
    );
    Ok(set)
}

/// What the audits of the set `set` in the folder `out` say: a line a class, means of squares over its sequences.
///
/// # Errors
/// When an audit cannot be read.
pub fn audits(set: TestSet, out: &Path) -> Result<Vec<String>> {
    let mut lines = Vec::new();
    for class in set.classes() {
        let folder = out.join(set.name()).join(class.name);
        let plan = Plan::read(&folder.join("plan.json"))?;
        let paths = (0..plan.total()).map(|index| render::sequence_folder(&plan, &folder, index).join(AUDIT));
        let audits = paths.filter(|path| path.is_file()).map(|path| Ok(file::read_json(&path)?)).collect::<Result<Vec<_>>>()?;
        lines.extend((!audits.is_empty()).then(|| line(class.name, &audits)));
    }
    Ok(lines)
}

fn line(class: &str, audits: &[Audit]) -> String {
    let count = audits.len();
    let mean = |value: &dyn Fn(&Audit) -> f64| audits.iter().map(value).sum::<f64>() / count as f64;
    let decibels = |value: fn(&Audit) -> f64| match decibel(mean(&|audit| 10f64.powf(-value(audit) / 10.0))) {
        CAP.. => "beyond what can be told".to_owned(),
        decibels => format!("{decibels:.1} dB"),
    };
    format!(
        "{class}: the truth's own error is {} (before the denoiser {}), judged by {:.0} samples a pixel ({}) of one frame of each of \
         {count} sequences",
        decibels(|audit| audit.error),
        decibels(|audit| audit.raw),
        mean(&|audit| f64::from(audit.spp)),
        decibels(|audit| audit.longer),
    )
}
