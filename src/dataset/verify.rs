//! Verifies a dataset on disk: counts, hashes, values, the agreement of channels, and that splits share nothing.

use super::agreement::Agreement;
use super::check::Part;
use super::damage::{self, Depth, Made};
use super::manifest::{self, Entry, Leaks, Listed, Manifest};
use super::mend;
use super::plan::Plan;
use super::record::failures;
use super::statistics::Statistics;
use crate::dataset::layout::MANIFEST;
use crate::util::cancel::Cancel;
use crate::util::panic::guarded;
use crate::util::progress::Progress;
use anyhow::Result;
use renderflow_frame::file;
use renderflow_frame::words::shell;
use std::fmt;
use std::path::Path;

/// Something that is wrong with a dataset.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fault {
    /// A sentence that starts with the place.
    pub what: String,
    /// The command that repairs it.
    pub remedy: String,
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.what)
    }
}

/// The result of verifying a dataset.
#[derive(Clone, Debug, Default)]
pub struct Verified {
    /// Sequences.
    pub sequences: usize,
    /// Frames.
    pub frames: usize,
    /// Bytes of all frames.
    pub bytes: u64,
    /// How well the channels agree with one another.
    pub agreement: Agreement,
    /// What the pixels are like.
    pub statistics: Statistics,
    /// Everything that is wrong.
    pub faults: Vec<Fault>,
    /// Oddities that do no harm, one sentence each.
    pub notes: Vec<String>,
}

impl Verified {
    fn fault(&mut self, what: String, remedy: String) {
        self.faults.push(Fault { what, remedy });
    }
}

/// Reads the whole dataset in `out`.
///
/// # Errors
/// When it has no plan, or when `stop` was set. Everything that is wrong with the dataset is in the result.
pub fn verify(out: &Path, stop: &Cancel) -> Result<Verified> {
    let mut found = Verified::default();
    let plan = match mend::plan_of(out)? {
        Ok(plan) => plan,
        Err(reason) => {
            // Nothing can be compared with a plan that is not the dataset's own.
            found.fault(format!("{reason}; the rest was not examined"), damage::remedy(out));
            return Ok(found);
        }
    };
    let catalog = plan.catalog();
    let listed = Listed::read(&plan, out);
    let progress = Progress::new("verify", u64::from(plan.total()));
    // Records of many frames are long, so only what is needed at the end is kept of them.
    let mut leaks = Leaks::new(&plan);
    // One for each sequence: its entry, if the manifest can be compared with its record.
    let mut entries: Vec<Option<Entry>> = Vec::new();
    for index in 0..plan.total() {
        stop.check()?;
        let folder = plan.folder(out, index);
        let name = folder.display();
        let examined = guarded(|| Ok(damage::sequence(&plan, out, index, listed.of(index), Depth::Pixels)))?;
        for damage in &examined.damage {
            found.fault(format!("{name}: {damage}"), damage::remedy(out));
        }
        if examined.is_whole() {
            match damage::against_plan(&plan, &catalog, index, listed.of(index).is_some(), &examined) {
                Made::Same => {}
                Made::Other(reason) => found.fault(format!("{name}: {reason}"), damage::remedy(out)),
                Made::OtherVersion => found.notes.push(format!(
                    "{name}: this version of the program makes another scene from the plan, so it cannot continue or repair the dataset"
                )),
                Made::Unknown(reason) => found.notes.push(format!("{name}: cannot be compared with the plan: {reason}")),
            }
            found.sequences += 1;
            found.frames += examined.checked.frames.len();
            found.bytes += examined.checked.frames.iter().map(|frame| frame.bytes).sum::<u64>();
            found.agreement.add(&examined.checked.agreement);
            found.statistics.add(&examined.checked.statistics);
        }
        match failures(&folder) {
            Ok(failures) => {
                for failure in failures {
                    let frame = failure.frame.map_or_else(String::new, |number| format!(" frame {number}"));
                    found.fault(format!("{name}{frame}: failed when it was made: {}", failure.error), damage::remedy(out));
                }
            }
            Err(error) => found.fault(crate::util::console::message(&error), damage::remedy(out)),
        }
        found.notes.extend(
            damage::strays(&plan, out, index)?.iter().map(|path| format!("{}: is not part of the dataset", path.display())),
        );
        let believed = !examined.damage.iter().any(|damage| damage.part == Part::Record);
        if let Some(record) = &examined.record {
            leaks.add(index, manifest::things(record));
        }
        let known = examined.record.zip(examined.record_hash).filter(|_| believed);
        entries.push(known.map(|(record, hash)| Entry::of(&plan, index, &record, hash)));
        progress.add(1);
    }
    progress.finish();
    for folder in damage::strangers(&plan, out)? {
        let what = "is not a sequence of the plan, but would count as one of its split; move it out of the dataset";
        let shown = shell(&folder.to_string_lossy());
        found.fault(format!("{}: {what}", folder.display()), format!("mv {shown} ELSEWHERE"));
    }
    for (places, leaks) in leaks.finish().chunk_by(|a, b| a.places == b.places).map(|same| (&same[0].places, same)) {
        let more = if leaks.len() > 1 { format!(" and {} more", leaks.len() - 1) } else { String::new() };
        let [one, other] = places;
        let what = format!("{one} and {other} share what splits must not: {}{more}", leaks[0].what);
        found.fault(what, damage::remedy(out));
    }
    manifest_of(&mut found, &plan, out, entries);
    Ok(found)
}

/// Compares the manifest with the entries that are `known`. There is one, or `None`, for each sequence of the plan.
fn manifest_of(found: &mut Verified, plan: &Plan, out: &Path, known: Vec<Option<Entry>>) {
    let path = out.join(MANIFEST);
    let judge = || -> Result<Option<String>> {
        let manifest: Manifest = file::read_long_json(&path, Manifest::largest(plan))?;
        if manifest.plan != plan.hash() {
            return Ok(Some("/plan: is of another plan".into()));
        }
        let expected = match manifest.corrected(plan, known) {
            Ok(corrected) => file::json(&path, &corrected)?,
            Err(error) => return Ok(Some(crate::util::console::message(&error))),
        };
        Ok((!file::holds(&path, &expected)?).then(|| "is not that of these sequences".into()))
    };
    match judge() {
        Ok(None) => {}
        Ok(Some(reason)) => found.fault(format!("{}: {reason}", path.display()), damage::remedy(out)),
        // A dataset that is still being rendered has no manifest, and is not complete either.
        Err(error) => found.fault(crate::util::console::message(&error), damage::remedy(out)),
    }
}
