//! Renders the sequences of a plan: idempotent, resumable, the same bytes for any shard and thread count.

use super::log::Log;
use super::plan::{Denoise, Plan, Quality};
use super::record::{Event, Failure, RECORD, Record, failures, write_failures};
use super::shard::Shard;
use super::{check, manifest};
use crate::machine;
use crate::progress::Progress;
use crate::truth::{DenoiseMode, Found, Interrupted, OpenSequence, SequenceJob, TruthSettings};
use anyhow::{Context, Result, bail};
use renderflow_frame::file;
use renderflow_renderer::Budget;
use renderflow_scenes::catalog::Catalog;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// Units of progress a frame.
const UNITS: u64 = 1000;

/// What a run did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Summary {
    /// Frames made.
    pub made: usize,
    /// Frames that were there.
    pub kept: usize,
    /// Frames, or whole sequences, that could not be made.
    pub failed: usize,
}

/// Settings of the truth for each quality of frame.
struct Qualities {
    full: TruthSettings,
    between: TruthSettings,
    gbuffer: TruthSettings,
}

impl Qualities {
    fn new(plan: &Plan) -> Result<Self> {
        let mode = match plan.render.denoise {
            Denoise::Oidn => DenoiseMode::Oidn,
            Denoise::None => DenoiseMode::None,
        };
        let settings = |spp: u32| -> Result<TruthSettings> {
            let budget = if plan.render.adaptive && spp > 0 { Budget::Average } else { Budget::Uniform };
            // Without paths there is nothing to denoise.
            let mode = if spp == 0 { DenoiseMode::None } else { mode };
            let mut settings = TruthSettings::spread(spp, budget, plan.render.max_bounces, mode)?;
            (settings.irradiance, settings.distance) = (plan.render.irradiance, plan.render.distance);
            settings.light_groups = plan.render.light_groups;
            Ok(settings)
        };
        let between = plan.keyframes.between_spp.unwrap_or(plan.render.spp);
        Ok(Self { full: settings(plan.render.spp)?, between: settings(between)?, gbuffer: settings(0)? })
    }

    fn of(&self, quality: Quality) -> &TruthSettings {
        match quality {
            Quality::Full => &self.full,
            Quality::Between => &self.between,
            Quality::GBuffer => &self.gbuffer,
        }
    }
}

/// The whole work of one shard.
struct Work<'a> {
    plan: &'a Plan,
    hash: String,
    out: &'a Path,
    catalog: Catalog,
    qualities: Qualities,
    progress: Progress,
    log: Log,
    started: Instant,
    summary: Summary,
    stop: &'a AtomicBool,
}

/// Folder of sequence `index` of a dataset.
pub fn sequence_folder(plan: &Plan, out: &Path, index: u32) -> PathBuf {
    out.join(plan.split(index).name()).join(Plan::sequence_name(index))
}

/// Renders `shard` of `plan` into `out`. Finished frames are kept. A frame that cannot be made is recorded beside the others and does
/// not stop them; `stop` ends the work after the frame at hand. Writes the manifest once all sequences of the plan are complete.
///
/// # Errors
/// [`Interrupted`] when stopped; when the folder belongs to another plan; when nothing can be stored any more; at the end, when frames
/// failed.
pub fn run(plan: &Plan, out: &Path, shard: Shard, stop: &AtomicBool) -> Result<Summary> {
    let qualities = Qualities::new(plan)?;
    claim(plan, out)?;
    let mine: Vec<u32> = (0..plan.total()).filter(|&s| shard.owns(s)).collect();
    let frames = mine.len() * plan.numbers().count();
    let log = Log::open(&out.join("logs").join(format!("shard-{:05}-of-{:05}.jsonl", shard.index, shard.count)));
    log.write(Event::Start {
        shard: format!("{}/{}", shard.index, shard.count),
        process: std::process::id(),
        threads: rayon::current_num_threads(),
        frames,
    });
    let mut work = Work {
        plan,
        hash: plan.hash(),
        out,
        catalog: plan.catalog(),
        qualities,
        progress: Progress::new("dataset", frames as u64 * UNITS),
        log,
        started: Instant::now(),
        summary: Summary::default(),
        stop,
    };
    for &index in &mine {
        work.sequence(index)?;
    }
    let Work { progress, log, summary, .. } = work;
    progress.finish();
    let Summary { made, kept, failed } = summary;
    log.write(Event::End { made, kept, failed });
    eprintln!(
        "{made} frames made, {kept} kept, {failed} failures, peak memory {:.0} MiB",
        machine::peak() as f64 / f64::from(1 << 20)
    );
    if failed > 0 {
        bail!("{failed} failures; see {} in the folders of their sequences", super::record::FAILURES);
    }
    if manifest::complete(plan, out) {
        manifest::merge(plan, out)?;
    }
    Ok(summary)
}

/// Makes `out` the folder of this plan, or says that it is another's.
fn claim(plan: &Plan, out: &Path) -> Result<()> {
    let path = out.join("plan.json");
    if path.is_file() {
        let there: Plan = file::read_json(&path)?;
        if there != *plan {
            bail!("{}: the folder holds a dataset of another plan; choose another folder", path.display());
        }
        return Ok(());
    }
    Ok(file::write_json(&path, plan)?)
}

/// Files that a process left behind when it was killed while writing.
pub fn remove_leftovers(folder: &Path) {
    let Ok(entries) = std::fs::read_dir(folder) else { return };
    for entry in entries.flatten() {
        let name = entry.file_name();
        let name = name.to_string_lossy();
        if name.starts_with('.') && name.ends_with(".tmp") {
            let _ = std::fs::remove_file(entry.path());
        }
    }
}

/// Whether an error means that nothing more can be stored: a full or read-only disk, a quota, a device that fails.
fn storage_is_gone(error: &anyhow::Error) -> bool {
    use std::io::ErrorKind::{QuotaExceeded, ReadOnlyFilesystem, StorageFull};
    let io = error.chain().find_map(|cause| cause.downcast_ref::<std::io::Error>());
    io.is_some_and(|io| matches!(io.kind(), StorageFull | QuotaExceeded | ReadOnlyFilesystem) || io.raw_os_error() == Some(5))
}

/// The result of `work`; a panic in it is an error like others.
fn guarded<T>(work: impl FnOnce() -> Result<T>) -> Result<T> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|payload| bail!("panic: {}", crate::cli::panic_message(payload.as_ref())))
}

impl Work<'_> {
    fn sequence(&mut self, index: u32) -> Result<()> {
        self.stopped()?;
        let name = Plan::sequence_name(index);
        let folder = sequence_folder(self.plan, self.out, index);
        let frames = self.plan.numbers().count();
        if let Ok(Some(record)) = Record::read(&folder)
            && record.plan == self.hash
            && record.is_present(&folder)
        {
            self.summary.kept += frames;
            self.progress.resume(UNITS * frames as u64);
            return Ok(());
        }
        remove_leftovers(&folder);
        let before = self.progress.position();
        let mut failed = Vec::new();
        match self.frames(index, &name, &folder, &mut failed) {
            Ok(()) => {}
            Err(error) if error.is::<Interrupted>() || storage_is_gone(&error) || error.is::<Mixture>() => {
                // What failed before is worth keeping, if it can be kept.
                let _ = write_failures(&folder, &failed);
                return Err(error.context(name));
            }
            Err(error) => {
                let failure = Failure { frame: None, seed: None, error: format!("{error:#}") };
                self.fail(&name, failure, &mut failed);
            }
        }
        self.progress.set(before + UNITS * frames as u64);
        write_failures(&folder, &failed).with_context(|| name.clone())
    }

    /// Makes the frames of a sequence; those that fail are added to `failed`. The record follows when none did.
    fn frames(&mut self, index: u32, name: &str, folder: &Path, failed: &mut Vec<Failure>) -> Result<()> {
        let started = Instant::now();
        let composed = guarded(|| self.plan.compose(&self.catalog, index))?;
        let job = SequenceJob {
            scene: composed.scene.clone(),
            base: ".".into(),
            out: folder.to_owned(),
            keyframe_gap: self.plan.keyframe_gap(),
            frame_step: self.plan.frame_step,
            storage: self.plan.storage,
        };
        let mut sequence = guarded(|| job.open())?;
        let load = started.elapsed().as_secs_f64();
        let seed = Some(sequence.loaded.seed);
        for number in self.plan.numbers() {
            self.stopped()?;
            match self.frame(&mut sequence, name, number) {
                Ok(()) => {}
                Err(error) if error.is::<Interrupted>() || storage_is_gone(&error) || error.is::<Mixture>() => return Err(error),
                Err(error) => {
                    let failure = Failure { frame: Some(number), seed, error: format!("{error:#}") };
                    self.fail(name, failure, failed);
                }
            }
        }
        if !failed.is_empty() {
            return Ok(());
        }
        let started = Instant::now();
        let checked = guarded(|| check::sequence(self.plan, folder))?;
        let record = Record::new(self.plan, index, &composed, &sequence.loaded, checked)?;
        file::write_json(&folder.join(RECORD), &record)?;
        self.log.write(Event::Sequence { sequence: name, load, check: started.elapsed().as_secs_f64() });
        Ok(())
    }

    fn frame(&mut self, sequence: &mut OpenSequence<'_>, name: &str, number: usize) -> Result<()> {
        let settings = self.qualities.of(self.plan.quality(number));
        match sequence.found(number, settings)? {
            Found::Same => {
                self.summary.kept += 1;
                self.progress.resume(UNITS);
                return Ok(());
            }
            Found::Other(what) => return Err(Mixture(what).into()),
            Found::Broken(error) => eprintln!("note: made again: {error:#}"),
            Found::Nothing => {}
        }
        // The frame at hand is finished whatever comes: only the checks between frames heed signals.
        let heedless = AtomicBool::new(false);
        let cost = guarded(|| sequence.render(number, settings, &self.progress, &heedless))?;
        self.summary.made += 1;
        self.log.write(Event::Frame { sequence: name, frame: number, spp: settings.spp, cost });
        self.show(name);
        Ok(())
    }

    fn show(&self, name: &str) {
        let Summary { made, failed, .. } = self.summary;
        let rate = made as f64 / self.started.elapsed().as_secs_f64();
        let memory = machine::resident() as f64 / f64::from(1 << 20);
        let failed = if failed > 0 { format!(", {failed} FAILED") } else { String::new() };
        self.progress.message(format!("{name}  {rate:.2} frames/s, {memory:.0} MiB{failed}"));
    }

    fn fail(&mut self, name: &str, failure: Failure, failed: &mut Vec<Failure>) {
        let frame = failure.frame.map_or_else(String::new, |number| format!(" frame {number}"));
        self.progress.hide(|| eprintln!("error: {name}{frame}: {}", failure.error));
        self.log.write(Event::Failure { sequence: name, failure: &failure });
        self.summary.failed += 1;
        failed.push(failure);
        self.show(name);
    }

    fn stopped(&self) -> Result<()> {
        if self.stop.load(Ordering::Relaxed) {
            self.log.write(Event::Interrupted {});
            return Err(Interrupted.into());
        }
        Ok(())
    }
}

/// A frame of another scene or of other settings is in the way.
#[derive(Debug)]
struct Mixture(String);

impl std::fmt::Display for Mixture {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Mixture {}

/// Failures of all sequences: (sequence, failure).
pub fn all_failures(plan: &Plan, out: &Path) -> Result<Vec<(String, Failure)>> {
    let mut all = Vec::new();
    for index in 0..plan.total() {
        let found = failures(&sequence_folder(plan, out, index))?;
        all.extend(found.into_iter().map(|failure| (Plan::sequence_name(index), failure)));
    }
    Ok(all)
}
