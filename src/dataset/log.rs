//! The log of a shard: a JSON object a line, appended by every run, so that a thousand machines can be watched by their files.

use super::record::Event;
use crate::memory;
use serde::Serialize;
use std::fs::File;
use std::io::Write;
use std::path::Path;
use std::sync::Mutex;
use std::time::{SystemTime, UNIX_EPOCH};

/// An open log. What cannot be written to it is lost, the work goes on.
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
    /// Opens `path` to append to it; says so where that is not possible.
    pub fn open(path: &Path) -> Self {
        let folder = path.parent().unwrap_or(Path::new("."));
        let file = std::fs::create_dir_all(folder)
            .and_then(|()| File::options().create(true).append(true).open(path))
            .map_err(|error| eprintln!("warning: {}: no log is kept: {error}", path.display()));
        Self { file: file.ok().map(Mutex::new) }
    }

    /// Appends a line.
    pub fn write(&self, event: Event<'_>) {
        let Some(file) = &self.file else { return };
        let time = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |t| t.as_secs_f64());
        let rss = (memory::resident() as f64 / (1 << 20) as f64 * 10.0).round() / 10.0;
        let Ok(mut line) = serde_json::to_vec(&Line { time: (time * 1000.0).round() / 1000.0, rss, event }) else { return };
        line.push(b'\n');
        let mut file = file.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        // One call a line: lines of two runs do not mix.
        let _ = file.write_all(&line);
    }
}
