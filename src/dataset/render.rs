//! Renders the sequences of a plan: idempotent, resumable, the same bytes for any shard and thread count.

use super::check::{self, Header};
use super::damage::{self, Depth, Made, Part};
use super::log::Log;
use super::manifest::{self, Listed};
use super::mend;
use super::plan::{Denoise, Plan, Quality};
use super::record::{Checked, Event, FAILURES, Failure, RECORD, Record, write_failures};
use super::shard::Shard;
use crate::progress::Progress;
use crate::truth::{DenoiseMode, Found, Interrupted, OpenSequence, SequenceJob, TruthSettings};
use crate::{machine, memory};
use anyhow::{Context, Result, bail};
use renderflow_frame::file;
use renderflow_frame::frame_file::{self, Profile};
use renderflow_scenes::catalog::Catalog;
use renderflow_scenes::procedural::Composed;
use std::collections::HashSet;
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
    /// Sequences of which something was damaged.
    pub damaged: usize,
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
            let mut settings = TruthSettings::new(plan.render.settings(spp), mode)?;
            settings.distance = plan.render.distance;
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
    out: &'a Path,
    /// How closely what is there is looked at.
    depth: Depth,
    /// Which frames to make, by number.
    wanted: &'a dyn Fn(usize) -> bool,
    /// What the manifest says, where there is one.
    listed: Listed,
    /// Sequences that this run has found whole or made.
    proven: HashSet<u32>,
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

/// Renders `shard` of `plan` into `out`. What is finished and whole is kept: every file is hashed. What is damaged is made again, with
/// a note. A frame that cannot be made is recorded beside the others and does not stop them; `stop` ends the work after the frame at
/// hand. Writes the manifest once all sequences of the plan are complete.
///
/// # Errors
/// [`Interrupted`] when stopped; when the folder belongs to another plan; when nothing can be stored any more; at the end, when frames
/// failed.
pub fn run(plan: &Plan, out: &Path, shard: Shard, stop: &AtomicBool) -> Result<Summary> {
    run_some(plan, out, shard, &|_| true, stop)
}

/// [`run`] for those frames of every sequence alone whose number is `wanted`. A sequence whose other frames are not recorded yet gets no
/// record: it counts as unfinished, and a later run makes the rest.
///
/// # Errors
/// As [`run`].
pub fn run_some(plan: &Plan, out: &Path, shard: Shard, wanted: &dyn Fn(usize) -> bool, stop: &AtomicBool) -> Result<Summary> {
    run_at(plan, out, shard, (Depth::Hashes, wanted), stop)
}

/// [`run_some`], looking as closely as `depth` says at what is there: [`Depth::Hashes`] or [`Depth::Pixels`].
pub(super) fn run_at(
    plan: &Plan,
    out: &Path,
    shard: Shard,
    (depth, wanted): (Depth, &dyn Fn(usize) -> bool),
    stop: &AtomicBool,
) -> Result<Summary> {
    let qualities = Qualities::new(plan)?;
    for settings in [&qualities.full, &qualities.between] {
        memory::ensure(settings, plan.resolution.map(|v| v as usize), false, plan.storage)?;
    }
    mend::claim(plan, out)?;
    let mine: Vec<u32> = (0..plan.total()).filter(|&s| shard.owns(s)).collect();
    let frames = mine.len() * plan.numbers().filter(|&number| wanted(number)).count();
    let log = Log::open(&out.join("logs").join(format!("shard-{:05}-of-{:05}.jsonl", shard.index, shard.count)));
    log.write(Event::Start {
        shard: format!("{}/{}", shard.index, shard.count),
        process: std::process::id(),
        threads: rayon::current_num_threads(),
        frames,
        plan,
    });
    let mut work = Work {
        plan,
        out,
        depth,
        wanted,
        listed: Listed::read(plan, out),
        proven: HashSet::new(),
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
    let Work { progress, log, summary, proven, .. } = work;
    progress.finish();
    let Summary { made, kept, failed, .. } = summary;
    log.write(Event::End { made, kept, failed });
    eprintln!(
        "{made} frames made, {kept} kept, {failed} failures, peak memory {:.0} MiB",
        machine::peak() as f64 / f64::from(1 << 20)
    );
    if failed > 0 {
        bail!("{failed} failures; see {FAILURES} in the folders of their sequences");
    }
    if manifest::complete(plan, out) {
        // Those of other shards were read back when they were made, and are not hashed again by every shard.
        manifest::merge_after(plan, out, &proven, Depth::Sizes, stop)?;
    }
    Ok(summary)
}

/// Files that a process left behind when it was killed while writing.
pub fn remove_leftovers(folder: &Path) {
    file::remove_leftovers(folder);
}

/// Whether an error means that nothing more can be stored: a full or read-only disk, a quota, a device that fails.
fn storage_is_gone(error: &anyhow::Error) -> bool {
    use std::io::ErrorKind::{QuotaExceeded, ReadOnlyFilesystem, StorageFull};
    let io = error.chain().find_map(|cause| cause.downcast_ref::<std::io::Error>());
    io.is_some_and(|io| matches!(io.kind(), StorageFull | QuotaExceeded | ReadOnlyFilesystem) || io.raw_os_error() == Some(5))
}

/// The result of `work`; a panic in it is an error like others.
pub(super) fn guarded<T>(work: impl FnOnce() -> Result<T>) -> Result<T> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|payload| bail!("panic: {}", crate::cli::panic_message(payload.as_ref())))
}

impl Work<'_> {
    fn sequence(&mut self, index: u32) -> Result<()> {
        self.stopped()?;
        let name = Plan::sequence_name(index);
        let folder = sequence_folder(self.plan, self.out, index);
        let frames = self.plan.numbers().filter(|&number| (self.wanted)(number)).count();
        if self.depth == Depth::Pixels {
            mend::clear_places(self.plan, self.out, &folder, |what| self.note(&what))?;
        }
        let mut found = damage::sequence(self.plan, self.out, index, self.listed.of(index), self.depth);
        if found.is_whole()
            && self.depth == Depth::Pixels
            && let Made::Other(reason) =
                damage::against_plan(self.plan, &self.catalog, index, self.listed.of(index).is_some(), &found)
        {
            found.damage.push(damage::Damage { part: Part::Record, reason });
        }
        if found.is_whole() {
            self.proven.insert(index);
            self.summary.kept += frames;
            self.progress.resume(UNITS * frames as u64);
            // What failed once has been made since.
            let _ = write_failures(&folder, &[]);
            return Ok(());
        }
        if !found.unfinished {
            self.summary.damaged += 1;
            for damage in &found.damage {
                self.note(&format!("{}: {damage}", folder.display()));
            }
        }
        remove_leftovers(&folder);
        let before = self.progress.position();
        let mut failed = Vec::new();
        match self.frames(index, &name, &found, &mut failed) {
            Ok(()) => {}
            Err(error) if error.is::<Interrupted>() || storage_is_gone(&error) || error.is::<Mixture>() => {
                // What failed before is worth keeping, if it can be kept.
                let _ = write_failures(&folder, &failed);
                return Err(error.context(name));
            }
            Err(error) => {
                let failure = Failure { frame: None, seed: None, error: crate::console::message(&error) };
                self.fail(&name, failure, &mut failed);
            }
        }
        self.progress.set(before + UNITS * frames as u64);
        write_failures(&folder, &failed).with_context(|| name.clone())
    }

    /// Makes the frames of a sequence that are not there as they should be; those that fail are added to `failed`. The record follows
    /// when none did.
    fn frames(&mut self, index: u32, name: &str, found: &damage::Found, failed: &mut Vec<Failure>) -> Result<()> {
        let started = Instant::now();
        let folder = &sequence_folder(self.plan, self.out, index);
        let composed = guarded(|| self.plan.compose(&self.catalog, index))?;
        if let Some(reason) = mend::other_version(self.plan, folder, &composed.scene) {
            return Err(Mixture(reason).into());
        }
        let nothing = damage::Found::default();
        let mut found = found;
        if mend::is_misplaced(folder, found.record.as_ref(), &composed.scene) {
            found = &nothing;
            let aside = mend::set_aside(self.out, folder)?;
            self.note(&format!("{}: another sequence, moved to {}", folder.display(), aside.display()));
        }
        let job = SequenceJob {
            scene: composed.scene.clone(),
            base: self.plan.reach(),
            out: folder.to_owned(),
            keyframe_gap: self.plan.keyframe_gap(),
            frame_step: self.plan.frame_step,
            storage: self.plan.storage,
        };
        let mut sequence = guarded(|| job.open())?;
        let load = started.elapsed().as_secs_f64();
        let seed = Some(sequence.loaded.seed);
        let doubtful: Vec<usize> = self.plan.numbers().filter(|&number| !found.vouches_for(number)).collect();
        let doubles = mend::doubles(&doubtful.iter().map(|&number| (number, sequence.path(number))).collect::<Vec<_>>());
        // Frames that are there, but for which no record vouches.
        let mut believed = Vec::new();
        for number in self.plan.numbers().filter(|&number| (self.wanted)(number)) {
            self.stopped()?;
            if found.vouches_for(number) {
                self.keep();
                continue;
            }
            match self.frame(&mut sequence, name, number, doubles.contains(&number)) {
                Ok(kept) => believed.extend(kept.then_some(number)),
                Err(error) if error.is::<Interrupted>() || storage_is_gone(&error) || error.is::<Mixture>() => return Err(error),
                Err(error) => {
                    let failure = Failure { frame: Some(number), seed, error: crate::console::message(&error) };
                    self.fail(name, failure, failed);
                }
            }
        }
        if !failed.is_empty() {
            return Ok(());
        }
        sequence.describe()?;
        // A record speaks for all frames: those that nobody looked at keep it from being written.
        if !self.plan.numbers().all(|number| (self.wanted)(number) || found.vouches_for(number)) {
            return Ok(());
        }
        let started = Instant::now();
        let checked = guarded(|| self.read_back(folder, &sequence))?;
        let (mut bytes, mut hash) = self.record(index, &composed, &sequence, checked)?;
        let is = |hash: &String, known: Option<&str>| known == Some(hash.as_str());
        if let Some(listed) = self.listed.of(index).map(str::to_owned)
            && !believed.is_empty()
            && !is(&hash, Some(&listed))
            && !is(&hash, found.record_hash.as_deref())
        {
            self.note(&format!("{}: its frames are not those that manifest.json lists", folder.display()));
            for number in believed {
                self.stopped()?;
                self.summary.kept -= 1;
                self.make(&mut sequence, name, number)?;
            }
            let checked = guarded(|| self.read_back(folder, &sequence))?;
            (bytes, hash) = self.record(index, &composed, &sequence, checked)?;
        }
        if self.listed.of(index).is_some_and(|listed| listed != hash) {
            self.note(&format!("{}: {RECORD} is not the one that manifest.json lists, which is written again", folder.display()));
        }
        file::write_atomic(&folder.join(RECORD), &bytes)?;
        self.proven.insert(index);
        self.log.write(Event::Sequence { sequence: name, load, check: started.elapsed().as_secs_f64() });
        Ok(())
    }

    /// Reads the files of a sequence that is complete.
    fn read_back(&self, folder: &Path, sequence: &OpenSequence<'_>) -> Result<Checked> {
        check::sequence(self.plan, folder, header(sequence))
    }

    /// The bytes of the record of a sequence, and their BLAKE3.
    fn record(
        &self,
        index: u32,
        composed: &Composed,
        sequence: &OpenSequence<'_>,
        checked: Checked,
    ) -> Result<(Vec<u8>, String)> {
        let record = Record::new(self.plan, index, composed, &sequence.loaded, checked)?;
        let bytes = file::json(Path::new(RECORD), &record)?;
        let hash = blake3::hash(&bytes).to_hex().to_string();
        Ok((bytes, hash))
    }

    /// Makes frame `number` unless it is there; whether it was. One of `doubles` is never believed.
    fn frame(&mut self, sequence: &mut OpenSequence<'_>, name: &str, number: usize, double: bool) -> Result<bool> {
        let settings = self.qualities.of(self.plan.quality(number));
        let path = sequence.path(number);
        if std::fs::metadata(&path).is_ok_and(|about| !about.is_file()) {
            bail!("{}: is no file, so no frame can be put there; to move it aside: {}", path.display(), damage::remedy(self.out));
        }
        match sequence.found(number, settings)? {
            Found::Same if double => self.note(&format!("{}: made again: another frame has the same bytes", path.display())),
            Found::Same => match self.hold(sequence, number) {
                Ok(()) => {
                    self.keep();
                    return Ok(true);
                }
                Err(error) => self.note(&format!("{}: made again: {}", path.display(), crate::console::message(&error))),
            },
            Found::Other(_) => {
                let aside = mend::set_aside(self.out, &path)?;
                let what = "made again: is of another scene or other settings, moved to";
                self.note(&format!("{}: {what} {}", path.display(), aside.display()));
            }
            Found::Broken(error) => self.note(&format!("made again: {}", crate::console::message(&error))),
            Found::Nothing => {}
        }
        self.make(sequence, name, number)?;
        Ok(false)
    }

    /// That a frame of this scene and these settings, for which no record vouches, is frame `number`, to the byte.
    fn hold(&self, sequence: &OpenSequence<'_>, number: usize) -> Result<()> {
        let path = sequence.path(number);
        let bytes = file::read(&path)?;
        let frame = frame_file::decode(&path, &bytes)?;
        header(sequence).hold(&frame.info, &sequence.loaded.cameras[number])?;
        // Blocks of OpenEXR that do not compress have no checksum. Compact files have one everywhere.
        if self.plan.storage == Profile::Full && self.plan.storage.encode(&path, &frame)?.0 != bytes {
            bail!("its bytes are not those that this program writes");
        }
        Ok(())
    }

    /// Renders frame `number`, whatever is at its place.
    fn make(&mut self, sequence: &mut OpenSequence<'_>, name: &str, number: usize) -> Result<()> {
        let settings = self.qualities.of(self.plan.quality(number));
        // The frame at hand is finished whatever comes: only the checks between frames heed signals.
        let heedless = AtomicBool::new(false);
        let cost = guarded(|| sequence.render(number, settings, &self.progress, &heedless))?;
        self.summary.made += 1;
        self.log.write(Event::Frame { sequence: name, frame: number, spp: settings.render.spp, cost });
        self.show(name);
        Ok(())
    }

    /// A frame is there as it should be.
    fn keep(&mut self) {
        self.summary.kept += 1;
        self.progress.resume(UNITS);
    }

    fn note(&self, text: &str) {
        self.progress.hide(|| eprintln!("note: {text}"));
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

/// What every frame of an open sequence says of itself.
fn header<'a>(sequence: &'a OpenSequence<'_>) -> Header<'a> {
    Header { scene: &sequence.loaded.hash, seed: sequence.loaded.seed }
}

/// A sequence that this version of the program would make otherwise is in the way.
#[derive(Debug)]
struct Mixture(String);

impl std::fmt::Display for Mixture {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Mixture {}
