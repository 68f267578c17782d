//! Proves a dataset on disk: counts, hashes, values, the agreement of channels, and that splits share nothing.

use super::agreement::Agreement;
use super::manifest::{self, MANIFEST, Manifest};
use super::plan::Plan;
use super::record::Record;
use super::render::{all_failures, sequence_folder};
use super::statistics::Statistics;
use super::{check, record};
use crate::progress::Progress;
use crate::truth::Interrupted;
use anyhow::{Context, Result, bail};
use renderflow_frame::file;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

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
    /// Everything that is wrong, a sentence each.
    pub faults: Vec<String>,
}

/// Reads the whole dataset in `out`.
///
/// # Errors
/// When it has no plan, or `stop` was set. What is wrong with it stands in the result.
pub fn verify(out: &Path, stop: &AtomicBool) -> Result<Verified> {
    let plan = Plan::read(&out.join("plan.json")).context("not a dataset folder")?;
    let mut found = Verified::default();
    let progress = Progress::new("verify", u64::from(plan.total()));
    let mut records = Vec::new();
    for index in 0..plan.total() {
        if stop.load(Ordering::Relaxed) {
            return Err(Interrupted.into());
        }
        let folder = sequence_folder(&plan, out, index);
        match sequence(&plan, &folder, &mut found) {
            Ok(record) => records.push(record),
            Err(error) => found.faults.push(format!("{}: {error:#}", folder.display())),
        }
        progress.add(1);
    }
    progress.finish();
    found.faults.extend(all_failures(&plan, out)?.into_iter().map(|(sequence, failure)| {
        let frame = failure.frame.map_or_else(String::new, |number| format!(" frame {number}"));
        format!("{sequence}{frame}: failed when it was made: {}", failure.error)
    }));
    if !plan.classic {
        found.faults.extend(manifest::leaks(&records));
    }
    if records.len() == plan.total() as usize {
        match file::read_json::<Manifest>(&out.join(MANIFEST)) {
            Ok(there) if there == Manifest::new(&plan, out, &records)? => {}
            Ok(_) => found.faults.push(format!("{MANIFEST}: is not that of these sequences; merge again")),
            Err(error) => found.faults.push(format!("{error}")),
        }
    }
    Ok(found)
}

/// One sequence: its record, held against its files.
fn sequence(plan: &Plan, folder: &Path, found: &mut Verified) -> Result<Record> {
    let Some(record) = Record::read(folder)? else { bail!("no {}: not complete", record::RECORD) };
    if record.plan != plan.hash() {
        bail!("{}: is of another plan", record::RECORD);
    }
    let checked = check::sequence(plan, folder)?;
    record.compare(&checked)?;
    found.sequences += 1;
    found.frames += checked.frames.len();
    found.bytes += checked.frames.iter().map(|frame| frame.bytes).sum::<u64>();
    found.agreement.add(&checked.agreement);
    found.statistics.add(&checked.statistics);
    Ok(record)
}
