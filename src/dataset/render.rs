//! Renders the sequences of a plan. The work can be resumed, and gives the same bytes for any shard and any number of threads.

use super::check::Part;
use super::check::{self, Header};
use super::damage::{self, Depth, Made};
use super::log::Event;
use super::log::Log;
use super::manifest::Listed;
use super::mend;
use super::merge;
use super::plan::{Plan, Quality};
use super::record::{Checked, Failure, Failures, Record, write_failures};
use super::shard::Shard;
use crate::dataset::job::memory;
use crate::dataset::job::{Existing, OpenSequence, SequenceJob, TruthSettings};
use crate::dataset::layout::{FAILURES, RECORD};
use crate::util::cancel::{Cancel, Interrupted};
use crate::util::machine;
use crate::util::output::{self, Hold, Share};
use crate::util::panic::guarded;
use crate::util::progress::Progress;
use crate::util::text::plural;
use anyhow::{Context, Result, bail};
use renderflow_frame::file;
use renderflow_frame::frame_file::{self, Profile};
use renderflow_model::device::NetworkDevice;
use renderflow_scenes::catalog::Catalog;
use renderflow_scenes::procedural::Composed;
use std::collections::HashSet;
use std::path::Path;
use std::time::Instant;

/// Units of progress for each frame.
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
    /// Sequences that were damaged.
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
        let settings = |spp: u32| -> Result<TruthSettings> {
            let mut settings = TruthSettings::new(plan.render.settings(spp), plan.render.denoise, &NetworkDevice::cpu())?;
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
    /// How closely existing files are examined.
    depth: Depth,
    /// Which frames to make, by number.
    wanted: &'a dyn Fn(usize) -> bool,
    /// The hashes in the manifest, if there is one.
    listed: Listed,
    /// Sequences that this run made, or found whole.
    proven: HashSet<u32>,
    catalog: Catalog,
    qualities: Qualities,
    progress: Progress,
    log: Log,
    started: Instant,
    summary: Summary,
    stop: &'a Cancel,
}

/// Renders `shard` of `plan` into `out`. Every file that is there is hashed: whole ones stay, damaged ones are made again, with a
/// note. A frame that cannot be made is recorded and does not stop the others. `stop` ends the work after the current frame.
/// Writes the manifest once all sequences of the plan are complete.
///
/// # Errors
/// When stopped ([`Interrupted`]), when the folder belongs to another plan or is being repaired, when nothing can be stored any
/// more, and at the end, when frames failed.
pub fn run(plan: &Plan, out: &Path, shard: Shard, stop: &Cancel) -> Result<Summary> {
    run_some(plan, out, shard, &|_| true, stop)
}

/// As [`run`], but only for the frames of every sequence whose number is `wanted`. A sequence gets no record until all its frames
/// are made: it counts as unfinished, and a later run makes the rest.
///
/// # Errors
/// As [`run`].
pub fn run_some(plan: &Plan, out: &Path, shard: Shard, wanted: &dyn Fn(usize) -> bool, stop: &Cancel) -> Result<Summary> {
    run_at(plan, out, shard, (Depth::Hashes, wanted), None, stop)
}

/// As [`run_some`], and examines existing files at `depth`: [`Depth::Hashes`] or [`Depth::Pixels`]. Without the caller's `hold`,
/// the folder is shared with those who render other shards.
pub(super) fn run_at(
    plan: &Plan,
    out: &Path,
    shard: Shard,
    (depth, wanted): (Depth, &dyn Fn(usize) -> bool),
    hold: Option<&Hold>,
    stop: &Cancel,
) -> Result<Summary> {
    let qualities = Qualities::new(plan)?;
    for settings in [&qualities.full, &qualities.between] {
        memory::ensure(settings, plan.resolution.map(|v| v as usize), false, plan.storage)?;
    }
    if !output::exists(out) {
        std::fs::create_dir_all(out).with_context(|| format!("{}: cannot create folder", out.display()))?;
    }
    let _share = if hold.is_none() { Some(Share::new(out)?) } else { None };
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
        "{} made, {kept} kept, {}, peak memory {:.0} MiB",
        plural(made, "frame"),
        plural(failed, "failure"),
        machine::peak() as f64 / f64::from(1 << 20)
    );
    if failed > 0 {
        bail!("{}; see {FAILURES} in the folders of the sequences", plural(failed, "failure"));
    }
    if merge::complete(plan, out) {
        // Sequences of other shards were read back when they were made; not every shard hashes them again.
        merge::merge_after(plan, out, &proven, Depth::Sizes, stop)?;
    }
    Ok(summary)
}

/// Whether an error means that nothing more can be stored: the disk is full or read-only, a quota is reached, or a device fails.
fn storage_is_gone(error: &anyhow::Error) -> bool {
    use std::io::ErrorKind::{QuotaExceeded, ReadOnlyFilesystem, StorageFull};
    let io = error.chain().find_map(|cause| cause.downcast_ref::<std::io::Error>());
    io.is_some_and(|io| matches!(io.kind(), StorageFull | QuotaExceeded | ReadOnlyFilesystem) || io.raw_os_error() == Some(5))
}

impl Work<'_> {
    fn sequence(&mut self, index: u32) -> Result<()> {
        self.stopped()?;
        let name = Plan::sequence_name(index);
        let folder = self.plan.folder(self.out, index);
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
            // The frames that failed once have been made since.
            let _ = write_failures(&folder, &[]);
            return Ok(());
        }
        if !found.unfinished {
            self.summary.damaged += 1;
            for damage in &found.damage {
                self.note(&format!("{}: {damage}", folder.display()));
            }
        }
        file::remove_leftovers(&folder);
        let before = self.progress.position();
        let mut failed = Failures::read(&folder);
        match self.frames(index, &name, &found, &mut failed) {
            Ok(()) => {}
            Err(error) if error.is::<Interrupted>() || storage_is_gone(&error) || error.is::<Mixture>() => {
                // The list of failures so far is worth keeping, if it can be stored.
                let _ = failed.write(&folder);
                return Err(error.context(name));
            }
            Err(error) => {
                let failure = Failure { frame: None, seed: None, error: crate::util::console::message(&error) };
                self.fail(&name, failure, &mut failed);
            }
        }
        self.progress.set(before + UNITS * frames as u64);
        failed.write(&folder).with_context(|| name.clone())
    }

    /// Makes the frames of a sequence that are missing or damaged. Frames that fail are added to `failed`; the record is written
    /// if there are none.
    fn frames(&mut self, index: u32, name: &str, found: &damage::Findings, failed: &mut Failures) -> Result<()> {
        let started = Instant::now();
        let folder = &self.plan.folder(self.out, index);
        let composed = guarded(|| self.plan.compose(&self.catalog, index))?;
        if let Some(reason) = mend::other_version(self.plan, folder, &composed.scene) {
            return Err(Mixture(reason).into());
        }
        let nothing = damage::Findings::default();
        let mut found = found;
        if mend::is_misplaced(folder, found.record.as_ref(), &composed.scene) {
            found = &nothing;
            *failed = Failures::default();
            let aside = mend::set_aside(self.out, folder)?;
            self.note(&format!("{}: is another sequence and was moved to {}", folder.display(), aside.display()));
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
        // Frames that are there, but that no record confirms.
        let mut believed = Vec::new();
        for number in self.plan.numbers().filter(|&number| (self.wanted)(number)) {
            self.stopped()?;
            if found.vouches_for(number) {
                failed.mended(number);
                self.keep();
                continue;
            }
            match self.frame(&mut sequence, name, number, doubles.contains(&number)) {
                Ok(kept) => {
                    failed.mended(number);
                    believed.extend(kept.then_some(number));
                }
                Err(error) if error.is::<Interrupted>() || storage_is_gone(&error) || error.is::<Mixture>() => return Err(error),
                Err(error) => {
                    let failure = Failure { frame: Some(number), seed, error: crate::util::console::message(&error) };
                    self.fail(name, failure, failed);
                }
            }
        }
        if !failed.is_clean() {
            return Ok(());
        }
        sequence.describe()?;
        // A record stands for all frames, so it is not written while some of them were not examined.
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
        *failed = Failures::default();
        self.proven.insert(index);
        self.log.write(Event::Sequence { sequence: name, load, check: started.elapsed().as_secs_f64() });
        Ok(())
    }

    /// Reads the files of a complete sequence back.
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

    /// Makes frame `number` unless it is there; returns whether it was. A frame among `doubles` is always made again.
    fn frame(&mut self, sequence: &mut OpenSequence<'_>, name: &str, number: usize, double: bool) -> Result<bool> {
        let settings = self.qualities.of(self.plan.quality(number));
        let path = sequence.path(number);
        if std::fs::metadata(&path).is_ok_and(|about| !about.is_file()) {
            bail!(
                "{}: is not a file, so no frame can be written there; to move it away: {}",
                path.display(),
                damage::remedy(self.out)
            );
        }
        match sequence.found(number, settings)? {
            Existing::Same if double => self.note(&format!("{}: made again: another frame has the same bytes", path.display())),
            Existing::Same => match self.hold(sequence, number) {
                Ok(()) => {
                    self.keep();
                    return Ok(true);
                }
                Err(error) => self.note(&format!("{}: made again: {}", path.display(), crate::util::console::message(&error))),
            },
            Existing::Other(_) => {
                let aside = mend::set_aside(self.out, &path)?;
                let what = "made again, because it is of another scene or other settings. The old one was moved to";
                self.note(&format!("{}: {what} {}", path.display(), aside.display()));
            }
            Existing::Broken(error) => self.note(&format!("made again: {}", crate::util::console::message(&error))),
            Existing::Nothing => {}
        }
        self.make(sequence, name, number)?;
        Ok(false)
    }

    /// Checks that a frame of this scene and these settings, which no record confirms, is frame `number`, byte for byte.
    fn hold(&self, sequence: &OpenSequence<'_>, number: usize) -> Result<()> {
        let path = sequence.path(number);
        let bytes = file::read(&path)?;
        let frame = frame_file::decode(&path, &bytes)?;
        header(sequence).hold(&frame.info, &sequence.loaded.cameras[number])?;
        // Blocks of OpenEXR that are stored without compression have no checksum. Compact files have checksums everywhere.
        if self.plan.storage == Profile::Full && self.plan.storage.encode(&path, &frame)?.0 != bytes {
            bail!("its bytes are not those that this program writes");
        }
        Ok(())
    }

    /// Renders frame `number`, whatever is in its place.
    fn make(&mut self, sequence: &mut OpenSequence<'_>, name: &str, number: usize) -> Result<()> {
        let settings = self.qualities.of(self.plan.quality(number));
        // The current frame is always finished: signals are checked between frames only.
        let heedless = Cancel::default();
        let cost = guarded(|| sequence.render(number, settings, &self.progress, &heedless))?;
        self.summary.made += 1;
        self.log.write(Event::Frame { sequence: name, frame: number, spp: settings.render.spp, cost });
        self.show(name);
        Ok(())
    }

    /// Counts a frame that was there already.
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

    fn fail(&mut self, name: &str, failure: Failure, failed: &mut Failures) {
        let frame = failure.frame.map_or_else(String::new, |number| format!(" frame {number}"));
        self.progress.hide(|| eprintln!("error: {name}{frame}: {}", failure.error));
        self.log.write(Event::Failure { sequence: name, failure: &failure });
        self.summary.failed += 1;
        failed.add(failure);
        self.show(name);
    }

    fn stopped(&self) -> Result<()> {
        if self.stop.is_set() {
            self.log.write(Event::Interrupted {});
            return Err(Interrupted.into());
        }
        Ok(())
    }
}

/// What the header of every frame of an open sequence must say.
fn header<'a>(sequence: &'a OpenSequence<'_>) -> Header<'a> {
    Header { scene: &sequence.loaded.hash, seed: sequence.loaded.seed, files: Some(&sequence.loaded.files) }
}

/// A sequence is in the way that this version of the program would make differently.
#[derive(Debug)]
struct Mixture(String);

impl std::fmt::Display for Mixture {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Mixture {}
