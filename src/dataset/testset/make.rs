//! Makes a test set: renders what is missing, estimates the error of its truth, and verifies all of it.

use super::audit::{Audit, decibel};
use super::{Sources, TestSet, audit, check_scenes};
use crate::dataset::layout::{AUDIT, MANIFEST};
use crate::dataset::plan::Plan;
use crate::dataset::plan::is_keyframe;
use crate::dataset::{Shard, merge, render, verify};
use crate::metrics::psnr::CAP;
use crate::util::cancel::Cancel;
use crate::util::files;
use crate::util::output;
use crate::util::text::plural;
use anyhow::{Context, Result, bail, ensure};
use renderflow_frame::file;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// File name of [`SetFile`].
pub const SET: &str = "set.json";

/// What a finished set holds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SetFile {
    /// Name of the set.
    pub set: String,
    /// For every class: its folder, BLAKE3 of its plan, and BLAKE3 of its manifest, which holds the hashes of all files.
    pub classes: Vec<(String, String, String)>,
    /// BLAKE3 of the entries above: two sets with the same hash are equal, byte for byte. Other processors and other versions of
    /// the denoiser round differently; then scenes are equal, and pictures are almost equal.
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
    /// The part of every class that this process makes.
    pub shard: Shard,
    /// Only the first two of every n frames, and the keyframes, are made: an evaluation of every n-th frame reads these. 1 = all.
    pub every: u32,
    /// Samples for each pixel of the longer render that estimates the error of the truth; 0 = none.
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

/// Makes `set` in `out/<set>`, or continues it. A shard makes its part of every class. Returns the finished set; `None` where
/// frames or parts of other shards are missing.
///
/// # Errors
/// As [`render::run`]; when this program would not make the scenes of the published set.
pub fn make(set: TestSet, sources: &Sources, out: &Path, extent: Extent, cancel: &Cancel) -> Result<Option<SetFile>> {
    let plans = set.plans(sources)?;
    check_folders(&out.join(set.name()), &plans)?;
    check_scenes(set, &plans)?;
    make_plans(set.name(), &plans, out, extent, cancel)
}

/// Checks, before anything is rendered, that the folders of the classes belong to their plans.
fn check_folders(folder: &Path, plans: &[(&str, Plan)]) -> Result<()> {
    for (name, plan) in plans {
        let path = folder.join(name).join("plan.json");
        if output::exists(&path) {
            let stored: Plan = file::read_json(&path)?;
            ensure!(stored == *plan, "{}: the folder holds a dataset of another plan; choose another folder", path.display());
        }
    }
    Ok(())
}

/// As [`make`], for any plans, by the name of their class.
///
/// # Errors
/// As [`render::run`].
pub fn make_plans(set: &str, plans: &[(&str, Plan)], out: &Path, extent: Extent, cancel: &Cancel) -> Result<Option<SetFile>> {
    let folder = out.join(set);
    check_folders(&folder, plans)?;
    for (i, (name, plan)) in plans.iter().enumerate() {
        eprintln!("{set} {name}, {} of {}", i + 1, plans.len());
        let class = folder.join(name);
        let selected = |number: usize| extent.holds(plan, number);
        render::run_some(plan, &class, extent.shard, &selected, cancel).with_context(|| (*name).to_owned())?;
        if extent.audited > 0 {
            audit::run(plan, &class, extent.shard, extent.audited, cancel).with_context(|| (*name).to_owned())?;
        }
    }
    if !plans.iter().all(|(name, plan)| merge::complete(plan, &folder.join(name))) {
        return Ok(None);
    }
    let file = describe(set, &folder, plans)?;
    file::write_json(&folder.join(SET), &file)?;
    Ok(Some(file))
}

fn describe(set: &str, folder: &Path, plans: &[(&str, Plan)]) -> Result<SetFile> {
    let class = |(name, plan): &(&str, Plan)| -> Result<_> {
        Ok(((*name).to_owned(), plan.hash(), files::hash(&folder.join(name).join(MANIFEST))?))
    };
    SetFile::new(set, plans.iter().map(class).collect::<Result<_>>()?)
}

/// Verifies the finished set in `folder`: every file's hash, every frame's channels, the plans, the set's own hash. Prints the
/// result.
///
/// # Errors
/// When anything is missing or differs.
pub fn check(folder: &Path, cancel: &Cancel) -> Result<SetFile> {
    let set: SetFile = file::read_json(&folder.join(SET)).context("not a finished test set")?;
    if let Ok(known) = <TestSet as clap::ValueEnum>::from_str(&set.set, false) {
        let there: Vec<&str> = set.classes.iter().map(|(name, ..)| name.as_str()).collect();
        let all: Vec<&str> = known.classes().iter().map(|class| class.name).collect();
        let folder = folder.display();
        ensure!(
            there == all,
            "{folder}: {SET} has the classes {there:?}, the set {} has {all:?}; testset make makes what is missing",
            set.set
        );
    }
    let mut found = Vec::new();
    for (name, plan_hash, _) in &set.classes {
        let class = folder.join(name);
        let plan = Plan::read(&class.join("plan.json"))?;
        ensure!(plan.hash() == *plan_hash, "{}: is of another plan than {SET} says", class.display());
        let verified = verify::verify(&class, cancel)?;
        let (sequences, frames) = (plural(verified.sequences, "sequence"), plural(verified.frames, "frame"));
        println!("{name}: {sequences}, {frames}, {} bytes", verified.bytes);
        if let Some(fault) = verified.faults.first() {
            bail!("{}: {}, the first: {fault}", class.display(), plural(verified.faults.len(), "fault"));
        }
        found.push((name.clone(), plan.hash(), files::hash(&class.join(MANIFEST))?));
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

/// The audits of the set `set` in the folder `out`: one line for each class, with means of squares over its sequences.
///
/// # Errors
/// When an audit cannot be read.
pub fn audits(set: TestSet, out: &Path) -> Result<Vec<String>> {
    let mut lines = Vec::new();
    for class in set.classes() {
        let folder = out.join(set.name()).join(class.name);
        let plan = Plan::read(&folder.join("plan.json"))?;
        let paths = (0..plan.total()).map(|index| plan.folder(&folder, index).join(AUDIT));
        let audits = paths.filter(|path| path.is_file()).map(|path| Ok(file::read_json(&path)?)).collect::<Result<Vec<_>>>()?;
        lines.extend((!audits.is_empty()).then(|| line(class.name, &audits)));
    }
    Ok(lines)
}

fn line(class: &str, audits: &[Audit]) -> String {
    let count = audits.len();
    let mean = |value: &dyn Fn(&Audit) -> f64| audits.iter().map(value).sum::<f64>() / count as f64;
    let decibels = |value: fn(&Audit) -> f64| match decibel(mean(&|audit| 10f64.powf(-value(audit) / 10.0))) {
        CAP.. => "too small to measure".to_owned(),
        decibels => format!("{decibels:.1} dB"),
    };
    format!(
        "{class}: the truth's own error is {} (before the denoiser {}), judged by {:.0} samples per pixel ({}) of one frame of each of \
         {count} sequences",
        decibels(|audit| audit.error),
        decibels(|audit| audit.raw),
        mean(&|audit| f64::from(audit.spp)),
        decibels(|audit| audit.longer),
    )
}
