//! The log of a shard: one JSON object on each line. Every run appends to it, so that a thousand machines can be watched by their
//! files.

use super::job::Cost;
use super::plan::Plan;
use super::record::Failure;
use crate::util::cancel::Cancel;
use crate::util::{files, machine};
use anyhow::Result;
use renderflow_frame::file;
use serde::{Deserialize, Serialize};
use std::fs::{File, TryLockError};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::{SystemTime, UNIX_EPOCH};

/// One line of a shard's log.
#[derive(Serialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Event<'a> {
    /// Work begins.
    Start {
        /// Part of the plan.
        shard: String,
        /// Process id.
        process: u32,
        /// Threads.
        threads: usize,
        /// Frames of this part.
        frames: usize,
        /// The plan: if `plan.json` is lost, `dataset repair` finds it here.
        plan: &'a Plan,
    },
    /// A frame was made.
    Frame {
        /// Its sequence.
        sequence: &'a str,
        /// Its number.
        frame: usize,
        /// Samples a pixel.
        spp: u32,
        /// Seconds and bytes.
        #[serde(flatten)]
        cost: Cost,
    },
    /// A frame, or a whole sequence, could not be made.
    Failure {
        /// Its sequence.
        sequence: &'a str,
        /// What failed.
        #[serde(flatten)]
        failure: &'a Failure,
    },
    /// A sequence is complete.
    Sequence {
        /// Its name.
        sequence: &'a str,
        /// Seconds of composing and loading it.
        load: f64,
        /// Seconds of reading everything back.
        check: f64,
    },
    /// A signal came.
    Interrupted {},
    /// Nothing is left to do.
    End {
        /// Frames made by this run.
        made: usize,
        /// Frames that were there before.
        kept: usize,
        /// Frames that failed.
        failed: usize,
    },
}

/// An open log. A line that cannot be written is lost; the work continues.
pub struct Log {
    file: Option<Mutex<File>>,
}

#[derive(Serialize)]
struct Line<'a> {
    /// Seconds since 1970.
    time: f64,
    /// Memory of the process, MiB.
    rss: f64,
    #[serde(flatten)]
    event: Event<'a>,
}

impl Log {
    /// Opens `path` to append to it; warns where that is not possible.
    pub fn open(path: &Path) -> Self {
        let folder = path.parent().unwrap_or(Path::new("."));
        let file = std::fs::create_dir_all(folder).and_then(|()| append(path));
        let file = file.map_err(|error| eprintln!("warning: {}: no log is kept: {error}", path.display())).ok();
        if file.as_ref().is_some_and(is_taken) {
            let twice = "another process renders the same part into this folder; each may spoil what the other writes";
            eprintln!("warning: {}: {twice}", path.display());
        }
        Self { file: file.map(Mutex::new) }
    }

    /// Appends a line.
    pub fn write(&self, event: Event<'_>) {
        let Some(file) = &self.file else { return };
        let time = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |t| t.as_secs_f64());
        let rss = (machine::resident() as f64 / (1 << 20) as f64 * 10.0).round() / 10.0;
        let Ok(mut line) = serde_json::to_vec(&Line { time: (time * 1000.0).round() / 1000.0, rss, event }) else { return };
        line.push(b'\n');
        let mut log = file.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        // One call for each line, so that lines of two runs do not mix.
        let _ = log.write_all(&line);
    }
}

/// Marks the log as that of this process, for as long as it is open. Returns whether another process has it. A network file
/// system may keep the lock of a machine that died, so a log that is taken is no reason to stop.
fn is_taken(log: &File) -> bool {
    // Where locks are not advisory, nobody could read the log meanwhile.
    cfg!(unix) && matches!(log.try_lock(), Err(TryLockError::WouldBlock))
}

/// Opens a log at its end, and ends a line that a killed run began.
fn append(path: &Path) -> std::io::Result<File> {
    // The call would wait for the reader of a pipe.
    if std::fs::metadata(path).is_ok_and(|about| !about.is_file()) {
        return Err(std::io::Error::other("is no regular file"));
    }
    let mut log = File::options().create(true).read(true).append(true).open(path)?;
    let mut last = [b'\n'];
    if log.seek(SeekFrom::End(-1)).is_ok() {
        log.read_exact(&mut last)?;
    }
    if last != *b"\n" {
        log.write_all(b"\n")?;
    }
    Ok(log)
}

/// What the frames of a dataset cost, according to its logs.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Costs {
    /// Frames made, over all runs.
    pub frames: usize,
    /// Wall seconds from the first to the last line of each run, added up over runs and shards.
    pub wall: f64,
    /// Mean seconds for each frame of compiling or moving, rendering, denoising and writing.
    pub stages: [f64; 4],
    /// Mean seconds for each sequence of composing and loading, and of reading back.
    pub sequences: [f64; 2],
    /// Failures.
    pub failures: usize,
    /// Memory after each frame, MiB: the median of each tenth of the frames in the order of the logs, and the largest.
    pub memory: Vec<f64>,
    /// Largest memory after a frame, MiB.
    pub peak: f64,
}

/// The plans that the logs in `out` hold, in the order of logs and lines.
pub fn plans(out: &Path) -> Vec<Plan> {
    #[derive(Deserialize)]
    struct Start {
        plan: Plan,
    }
    let starts = |line: &String| line.contains(r#""event":"start""#);
    let plan = |line: String| Some(serde_json::from_str::<Start>(&line).ok()?.plan);
    logs(out).iter().filter_map(|path| file::lines(path).ok()).flatten().filter(starts).filter_map(plan).collect()
}

/// The logs in `out`, by name.
fn logs(out: &Path) -> Vec<PathBuf> {
    files::list(&out.join("logs")).unwrap_or_default()
}

/// Reads every log in `out`. Lines that cannot be read are skipped: a run may have been killed while it wrote one.
///
/// # Errors
/// When stopped.
pub fn costs(out: &Path, cancel: &Cancel) -> Result<Costs> {
    let (mut costs, mut memory) = (Costs::default(), Vec::new());
    let (mut sequences, mut stages) = ([0.0; 3], [0.0; 4]);
    for path in logs(out) {
        let (mut started, mut last) = (0.0, 0.0);
        for line in file::lines(&path).into_iter().flatten() {
            cancel.check()?;
            let Ok(line) = serde_json::from_str::<serde_json::Value>(&line) else { continue };
            let number = |key: &str| line[key].as_f64().unwrap_or(0.0);
            if line["event"] == "start" {
                costs.wall += last - started;
                started = number("time");
            }
            last = number("time");
            match line["event"].as_str() {
                Some("frame") => {
                    costs.frames += 1;
                    memory.push(number("rss"));
                    for (sum, key) in stages.iter_mut().zip(["compile", "render", "denoise", "write"]) {
                        *sum += number(key);
                    }
                }
                Some("sequence") => {
                    for (sum, more) in sequences.iter_mut().zip([number("load"), number("check"), 1.0]) {
                        *sum += more;
                    }
                }
                Some("failure") => costs.failures += 1,
                _ => {}
            }
        }
        costs.wall += last - started;
    }
    costs.stages = stages.map(|sum: f64| sum / costs.frames.max(1) as f64);
    costs.sequences = [0, 1].map(|i| sequences[i] / f64::max(sequences[2], 1.0));
    costs.peak = memory.iter().copied().fold(0.0, f64::max);
    for part in memory.chunks(memory.len().div_ceil(10).max(1)) {
        let mut part = part.to_vec();
        part.sort_by(f64::total_cmp);
        costs.memory.push(part[part.len() / 2]);
    }
    Ok(costs)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(unix)]
    #[test]
    fn a_log_is_taken_while_it_is_open() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("shard.jsonl");
        let open = || append(&path).unwrap();
        let first = open();
        assert!(!is_taken(&first) && is_taken(&open()));
        drop(first);
        assert!(!is_taken(&open()));
    }

    #[test]
    fn a_log_larger_than_a_text_counts() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("logs/shard-00001-of-00001.jsonl");
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        let mut log = File::create(&path).unwrap();
        let frame = |time: u32| format!("{{\"time\":{time},\"rss\":100,\"event\":\"frame\",\"render\":2.0}}\n");
        log.write_all(format!("{{\"time\":1,\"event\":\"start\"}}\n{}", frame(3)).as_bytes()).unwrap();
        // Holes of the file, which take no room on the disk: each is a line that is no JSON.
        for time in 4..8 {
            log.seek(SeekFrom::Current(80 << 20)).unwrap();
            log.write_all(format!("\n{}", frame(time)).as_bytes()).unwrap();
        }
        assert!(log.metadata().unwrap().len() > file::LARGEST_TEXT);
        let costs = costs(folder.path(), &Cancel::default()).unwrap();
        assert_eq!((costs.frames, costs.wall, costs.stages[1], costs.peak), (5, 6.0, 2.0, 100.0));
        let stop = Cancel::default();
        stop.set();
        assert!(super::costs(folder.path(), &stop).is_err());
    }
}
