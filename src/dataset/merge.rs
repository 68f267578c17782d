//! Collects the records of a dataset into its manifest.

use super::damage::{self, Depth, Findings};
use super::manifest::{self, Entry, Leak, Leaks, Listed, Manifest};
use super::plan::Plan;
use super::record::Record;
use crate::dataset::layout::{MANIFEST, PLAN, RECORD};
use crate::util::cancel::Cancel;
use crate::util::output::Share;
use crate::util::progress::Progress;
use crate::util::text::plural;
use anyhow::{Result, bail, ensure};
use rayon::prelude::*;
use renderflow_frame::file;
use std::collections::HashSet;
use std::path::Path;

/// A message names at most this many damaged sequences.
const SHOWN: usize = 20;

/// Whether every sequence has its record.
pub fn complete(plan: &Plan, out: &Path) -> bool {
    (0..plan.total()).all(|index| plan.folder(out, index).join(RECORD).is_file())
}

/// The records of the sequences `indices`, which were examined as `found` says.
///
/// # Errors
/// When some are not complete or damaged. The message names them and the command that repairs them.
pub(super) fn accept(plan: &Plan, out: &Path, indices: &[u32], found: Vec<Findings>) -> Result<Vec<Record>> {
    ensure_whole(plan, out, indices, &found)?;
    Ok(found.into_iter().filter_map(|found| found.record).collect())
}

/// Refuses sequences that are not complete or damaged. Their records are not looked at.
fn ensure_whole(plan: &Plan, out: &Path, indices: &[u32], found: &[Findings]) -> Result<()> {
    let missing: Vec<u32> = indices.iter().zip(found).filter(|(_, found)| found.unfinished).map(|(index, _)| *index).collect();
    if let Some(&first) = missing.first() {
        let failed: usize =
            missing.iter().map(|&index| super::record::failures(&plan.folder(out, index)).map_or(0, |f| f.len())).sum();
        bail!(
            "not complete: {} of {} ({} recorded), the first is {}; render them, then merge: {}",
            missing.len(),
            plural(indices.len(), "sequence"),
            plural(failed, "failure"),
            Plan::sequence_name(first),
            damage::remedy(out)
        );
    }
    let first = |(index, found): (&u32, &Findings)| Some(format!("{}: {}", plan.place(*index), found.damage.first()?));
    let damaged: Vec<String> = indices.iter().zip(found).filter_map(first).collect();
    if !damaged.is_empty() {
        let shown = damaged.iter().take(SHOWN).map(|line| format!("\n  {line}")).collect::<String>();
        let more = damaged.len().saturating_sub(SHOWN);
        let more = if more > 0 { format!("\n  and {more} more") } else { String::new() };
        bail!("{} damaged:{shown}{more}\nto repair: {}", plural(damaged.len(), "sequence"), damage::remedy(out));
    }
    Ok(())
}

/// Collects the records into the manifest, and hashes every file.
///
/// # Errors
/// When a sequence is not complete or damaged, when splits share something that they must not, or when another process repairs
/// the dataset.
pub fn merge(plan: &Plan, out: &Path, stop: &Cancel) -> Result<Manifest> {
    let _share = Share::new(out)?;
    if let Ok(own) = Plan::read(&out.join(PLAN)) {
        let file = out.join(PLAN);
        ensure!(own == *plan, "{}: the dataset was made from this plan, and --plan names another", file.display());
    }
    merge_after(plan, out, &HashSet::new(), Depth::Hashes, stop)
}

/// As [`merge`]. The sequences `proven` have just been examined or made; others are examined at `depth`.
pub(super) fn merge_after(plan: &Plan, out: &Path, proven: &HashSet<u32>, depth: Depth, stop: &Cancel) -> Result<Manifest> {
    let listed = Listed::read(plan, out);
    let progress = (depth >= Depth::Hashes).then(|| Progress::new("merge", u64::from(plan.total())));
    let look = |index: u32| {
        stop.check()?;
        let mut found = if proven.contains(&index) {
            damage::sequence(plan, out, index, None, Depth::Sizes)
        } else {
            damage::sequence(plan, out, index, listed.of(index), depth)
        };
        if let Some(progress) = &progress {
            progress.add(1);
        }
        // Records of many frames are long, so only what the manifest needs is kept of them.
        let known = found.record.take().zip(found.record_hash.take()).filter(|_| found.is_whole());
        let known = known.map(|(record, hash)| (Entry::of(plan, index, &record, hash), manifest::things(&record)));
        Ok((found, known))
    };
    let all: Vec<u32> = (0..plan.total()).collect();
    let found = all.par_iter().with_max_len(1).map(|&index| look(index)).collect::<Result<Vec<_>>>()?;
    let (found, known): (Vec<_>, Vec<_>) = found.into_iter().unzip();
    if let Some(progress) = &progress {
        progress.finish();
    }
    ensure_whole(plan, out, &all, &found)?;
    let (mut entries, mut leaks) = (Vec::new(), Leaks::new(plan));
    for (index, (entry, things)) in (0..).zip(known.into_iter().flatten()) {
        entries.push(entry);
        leaks.add(index, things);
    }
    let manifest = Manifest::with(plan, entries);
    let leaks: Vec<String> = leaks.finish().iter().map(Leak::to_string).collect();
    ensure!(leaks.is_empty(), "splits must not share anything, but they share: {}", leaks.join("; "));
    file::remove_leftovers(out);
    let path = out.join(MANIFEST);
    match file::write_json(&path, &manifest) {
        // Another shard that finished at the same time removed this one's draft, and wrote the same manifest.
        Err(error) if !file::holds(&path, &file::json(&path, &manifest)?).unwrap_or(false) => Err(error.into()),
        _ => Ok(manifest),
    }
}
