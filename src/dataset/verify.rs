//! Proves a dataset on disk: counts, hashes, values, the agreement of channels, and that splits share nothing.

use super::agreement::Agreement;
use super::damage::{self, Depth, Made, Part};
use super::manifest::{self, Listed, MANIFEST, Manifest};
use super::mend;
use super::plan::Plan;
use super::record::{Record, failures};
use super::render::{guarded, sequence_folder};
use super::statistics::Statistics;
use crate::progress::Progress;
use crate::truth::Interrupted;
use anyhow::Result;
use renderflow_frame::file;
use renderflow_frame::words::shell;
use std::fmt;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

/// Something that is wrong with a dataset.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fault {
    /// A sentence that begins with the place.
    pub what: String,
    /// The command that mends it.
    pub remedy: String,
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.what)
    }
}

/// What was found in a dataset.
#[derive(Clone, Debug, Default)]
pub struct Verified {
    /// Sequences.
    pub sequences: usize,
    /// Frames.
    pub frames: usize,
    /// Bytes of all frames.
    pub bytes: u64,
    /// What the channels say about one another.
    pub agreement: Agreement,
    /// What the pixels are like.
    pub statistics: Statistics,
    /// Everything that is wrong.
    pub faults: Vec<Fault>,
    /// What is odd and does no harm, a sentence each.
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
/// When it has no plan, or `stop` was set. What is wrong with it stands in the result.
pub fn verify(out: &Path, stop: &AtomicBool) -> Result<Verified> {
    let mut found = Verified::default();
    let plan = match mend::plan_of(out)? {
        Ok(plan) => plan,
        Err(reason) => {
            // Nothing can be held against a plan that is another one.
            found.fault(format!("{reason}; the rest is not looked at"), damage::remedy(out));
            return Ok(found);
        }
    };
    let catalog = plan.catalog();
    let listed = Listed::read(&plan, out);
    let progress = Progress::new("verify", u64::from(plan.total()));
    // With the place of the folder each is in, whatever it says itself.
    let mut records: Vec<(u32, Record)> = Vec::new();
    // One a sequence: those that the manifest can be held against.
    let mut listable: Vec<Option<Record>> = Vec::new();
    for index in 0..plan.total() {
        if stop.load(Ordering::Relaxed) {
            return Err(Interrupted.into());
        }
        let folder = sequence_folder(&plan, out, index);
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
                    "{name}: this version of the program makes another scene of the plan: it could not go on with the dataset or mend it"
                )),
                Made::Unknown(reason) => found.notes.push(format!("{name}: cannot be held against the plan: {reason}")),
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
            Err(error) => found.fault(crate::console::message(&error), damage::remedy(out)),
        }
        found.notes.extend(
            damage::strays(&plan, out, index)?.iter().map(|path| format!("{}: is no part of the dataset", path.display())),
        );
        let believed = !examined.damage.iter().any(|damage| damage.part == Part::Record);
        listable.push(examined.record.clone().filter(|_| believed));
        records.extend(examined.record.map(|record| (index, record)));
        progress.add(1);
    }
    progress.finish();
    for folder in damage::strangers(&plan, out)? {
        let what = "is no sequence of the plan, but would be taken for one of its split; move it out of the dataset";
        let shown = shell(&folder.to_string_lossy());
        found.fault(format!("{}: {what}", folder.display()), format!("mv {shown} ELSEWHERE"));
    }
    for (places, leaks) in manifest::leaks(&plan, records.iter().map(|(index, record)| (*index, record)))
        .chunk_by(|a, b| a.places == b.places)
        .map(|same| (&same[0].places, same))
    {
        let more = if leaks.len() > 1 { format!(" and {} more", leaks.len() - 1) } else { String::new() };
        let [one, other] = places;
        let what = format!("{one} and {other} share what splits must not: {}{more}", leaks[0].what);
        found.fault(what, damage::remedy(out));
    }
    manifest_of(&mut found, &plan, out, &listable);
    Ok(found)
}

/// Holds the manifest against the records that can be believed, one a sequence of the plan.
fn manifest_of(found: &mut Verified, plan: &Plan, out: &Path, records: &[Option<Record>]) {
    let path = out.join(MANIFEST);
    let judge = || -> Result<Option<String>> {
        let there = file::read_at_most(&path, file::LARGEST_TEXT)?;
        let manifest: Manifest = file::parse_json(&path, &there)?;
        if manifest.plan != plan.hash() {
            return Ok(Some("/plan: is of another plan".into()));
        }
        let made = match manifest.corrected(plan, out, records) {
            Ok(corrected) => file::json(&path, &corrected)?,
            Err(error) => return Ok(Some(crate::console::message(&error))),
        };
        Ok((there != made).then(|| "is not that of these sequences".into()))
    };
    match judge() {
        Ok(None) => {}
        Ok(Some(reason)) => found.fault(format!("{}: {reason}", path.display()), damage::remedy(out)),
        // A dataset that is being rendered has none yet, and is not complete either.
        Err(error) => found.fault(crate::console::message(&error), damage::remedy(out)),
    }
}
