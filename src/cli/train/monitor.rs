//! The files that show how a run is doing: a page of curves, TensorBoard events, and pictures of some validation frames.

use super::Bars;
use crate::report::html;
use crate::report::plot::{self, Level, Line, Plot, Point, Scale};
use crate::util::picture;
use anyhow::{Context, Result};
use renderflow_frame::file;
use renderflow_frame::image::Rgb;
use renderflow_model::train::runner::{LogRecord, Progress, VALIDATIONS, Validation, weights_path};
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::{SystemTime, UNIX_EPOCH};

/// Most frames on one sheet.
pub(super) const FRAMES: usize = 4;

/// Draws sheets of pictures with the weights in a file, by name.
pub(super) type Sheets<'a> = &'a (dyn Fn(&Path) -> Result<Vec<(String, Rgb)>> + Sync);

/// Shows the progress of one run, and writes its files.
pub(super) struct Monitor<'a> {
    out: &'a Path,
    /// Created with the first scalar, so that a run that is refused leaves no file behind.
    events: Mutex<Option<Events>>,
    /// PSNR of OIDN, by kind of input.
    oidn: &'a BTreeMap<String, f32>,
    sheets: Sheets<'a>,
}

impl<'a> Monitor<'a> {
    pub(super) fn new(out: &'a Path, oidn: &'a BTreeMap<String, f32>, sheets: Sheets<'a>) -> Self {
        Self { out, events: Mutex::new(None), oidn, sheets }
    }

    /// Shows what a run reports, and writes it. A file that cannot be written does not stop the run.
    pub(super) fn tell(&self, bars: &Bars, progress: &Progress) {
        let shown = |done: Result<()>| done.unwrap_or_else(|error| bars.note(&format!("{error:#}")));
        match progress {
            Progress::Loading { done, total } => bars.loading(*done, *total),
            Progress::Note(note) => bars.note(note),
            Progress::Validated(validated) => {
                let others = validated.others.iter().map(|(name, value)| format!("; {name} {value:.4}")).collect::<String>();
                bars.note(&format!("validation at step {}: {} dB{others}", validated.step, listed(&validated.psnr)));
                shown(self.validated(validated));
            }
            Progress::Step(record) => {
                let rate = record.items_per_second;
                bars.step(record.share, format!("step {} loss {:.5}, {rate:.1} crops/s", record.step, record.loss));
                shown(self.line(record));
            }
        }
    }

    /// Writes the scalars of a log line.
    fn line(&self, record: &LogRecord) -> Result<()> {
        let numbers =
            [("train/loss", record.loss), ("train/gradient_norm", record.gradient_norm), ("train/rate", record.lr as f32)];
        let mut scalars: Vec<(String, f32)> = numbers.map(|(name, value)| (name.to_owned(), value)).into();
        scalars.push(("train/crops_per_second".to_owned(), record.items_per_second as f32));
        scalars.extend(record.psnr.iter().map(|(name, value)| (format!("train_psnr/{name}"), *value)));
        self.scalars(record.step, &scalars)
    }

    /// Writes the scalars of a validation, the curves so far, and the sheets.
    fn validated(&self, validated: &Validation) -> Result<()> {
        let psnr = validated.psnr.iter().map(|(name, value)| (format!("validation_psnr/{name}"), *value));
        let others = validated.others.iter().map(|(name, value)| (format!("validation/{name}"), *value));
        let scalars: Vec<(String, f32)> = psnr.chain(others).collect();
        self.scalars(validated.step, &scalars)?;
        file::write_atomic(&self.out.join("curves.html"), self.curves()?.as_bytes())?;
        for (name, sheet) in (self.sheets)(&weights_path(self.out))? {
            file::write_atomic(&self.out.join(format!("validation-{name}.png")), &picture::png(&sheet)?)?;
        }
        Ok(())
    }

    fn scalars(&self, step: u64, scalars: &[(String, f32)]) -> Result<()> {
        let mut events = self.events.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        if events.is_none() {
            *events = Some(Events::create(self.out)?);
        }
        events.as_mut().map_or(Ok(()), |events| events.write(step, scalars))
    }

    /// The page of curves, from the logs of the run.
    fn curves(&self) -> Result<String> {
        let lines: Vec<LogRecord> = records(&self.out.join("log.jsonl"))?;
        let validations: Vec<Validation> = records(&self.out.join(VALIDATIONS))?;
        let point = |step: u64, value: f32| Point { at: (step as f64, f64::from(value)), ..Point::default() };
        let loss: Vec<(String, Vec<Point>)> =
            vec![("loss".to_owned(), lines.iter().map(|line| point(line.step, line.loss)).collect())];
        let [mut by_tier, mut others]: [BTreeMap<String, Vec<Point>>; 2] = Default::default();
        for validation in &validations {
            for (name, psnr) in &validation.psnr {
                by_tier.entry(name.clone()).or_default().push(point(validation.step, *psnr));
            }
            for (name, value) in &validation.others {
                others.entry(name.clone()).or_default().push(point(validation.step, *value));
            }
        }
        // Each level has the colour of its curve.
        let level = |(color, name): (usize, &String)| {
            let y = f64::from(*self.oidn.get(name)?);
            Some(Level { name: format!("OIDN, {name}"), named: true, color, y })
        };
        let levels: Vec<Level> = by_tier.keys().enumerate().filter_map(level).collect();
        let others =
            others.into_iter().map(|(name, points)| figure(&name.clone(), &name.clone(), vec![(name, points)], Vec::new()));
        let body = format!(
            "<h1>Training of {}</h1>\n<h2>Validation</h2>\n{}{}<h2>Loss of the batches</h2>\n{}",
            html::escape(&self.out.display().to_string()),
            figure("validation", "PSNR, dB (up is better)", by_tier.into_iter().collect(), levels),
            others.collect::<String>(),
            figure("loss", "loss", loss, Vec::new())
        );
        Ok(html::page("RenderFlow: a training run", &body))
    }
}

fn figure(title: &str, y: &str, lines: Vec<(String, Vec<Point>)>, levels: Vec<Level>) -> String {
    let line = |(color, (name, points)): (usize, (String, Vec<Point>))| Line {
        color,
        joined: true,
        named: true,
        legend: name,
        points,
        ..Line::default()
    };
    plot::figure(&Plot {
        title,
        x: ("steps", Scale::Linear),
        y: (y, Scale::Linear),
        lines: lines.into_iter().enumerate().map(line).collect(),
        levels,
        marks: Vec::new(),
        size: (960.0, 460.0),
    })
}

/// Numbers by name, in one line.
pub(super) fn listed(numbers: &BTreeMap<String, f32>) -> String {
    numbers.iter().map(|(name, number)| format!("{name} {number:.2}")).collect::<Vec<_>>().join(", ")
}

/// The lines of a log. A missing log is empty, and an incomplete last line is left out.
fn records<T: DeserializeOwned>(path: &Path) -> Result<Vec<T>> {
    let text = match file::read(path) {
        Ok(bytes) => String::from_utf8_lossy(&bytes).into_owned(),
        Err(error) if error.is_missing() => return Ok(Vec::new()),
        Err(error) => return Err(error.into()),
    };
    let whole = text.split_inclusive('\n').filter(|line| line.ends_with('\n'));
    whole.map(|line| serde_json::from_str(line).with_context(|| path.display().to_string())).collect()
}

/// Scalars in the format that TensorBoard reads: TFRecord frames around `tensorflow.Event` messages.
struct Events {
    path: PathBuf,
    file: File,
}

impl Events {
    /// Creates a file of its own for each session of a run, as TensorBoard expects.
    fn create(folder: &Path) -> Result<Self> {
        let seconds = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
        let path = folder.join(format!("events.out.tfevents.{seconds:010}.renderflow.{}", std::process::id()));
        let file = OpenOptions::new().create_new(true).append(true).open(&path);
        let file = file.with_context(|| format!("{}: cannot create", path.display()))?;
        let mut events = Self { path, file };
        // Field 3: the version of the format.
        let version = event(0, |out| text(out, 3, b"brain.Event:2"));
        events.put(&version)?;
        Ok(events)
    }

    fn write(&mut self, step: u64, scalars: &[(String, f32)]) -> Result<()> {
        // Field 5: a summary, whose field 1 is a value: field 1 its name, field 2 the number.
        let mut summary = Vec::new();
        for (name, number) in scalars {
            let mut value = Vec::new();
            text(&mut value, 1, name.as_bytes());
            value.push(2 << 3 | 5);
            value.extend(number.to_le_bytes());
            text(&mut summary, 1, &value);
        }
        let message = event(step, |out| text(out, 5, &summary));
        self.put(&message)
    }

    fn put(&mut self, message: &[u8]) -> Result<()> {
        let length = (message.len() as u64).to_le_bytes();
        let mut frame = Vec::with_capacity(message.len() + 16);
        frame.extend(length);
        frame.extend(masked_checksum(&length).to_le_bytes());
        frame.extend(message);
        frame.extend(masked_checksum(message).to_le_bytes());
        self.file.write_all(&frame).with_context(|| format!("{}: cannot write", self.path.display()))
    }
}

/// An event at the current time: field 1 is the seconds since 1970, field 2 the step, then comes `content`.
fn event(step: u64, content: impl FnOnce(&mut Vec<u8>)) -> Vec<u8> {
    let seconds = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64());
    let mut out = vec![1 << 3 | 1];
    out.extend(seconds.to_le_bytes());
    out.push(2 << 3);
    varint(&mut out, step);
    content(&mut out);
    out
}

/// Writes a field of bytes.
fn text(out: &mut Vec<u8>, field: u8, bytes: &[u8]) {
    out.push(field << 3 | 2);
    varint(out, bytes.len() as u64);
    out.extend(bytes);
}

fn varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

/// CRC-32C as TFRecord stores it.
fn masked_checksum(bytes: &[u8]) -> u32 {
    crc32c::crc32c(bytes).rotate_right(15).wrapping_add(0xa282_ead8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checksums_are_those_of_tfrecord() {
        // These are the results of TensorBoard's own `masked_crc32c`.
        assert_eq!(masked_checksum(&[0; 32]), 0x0fd7_fffa);
        assert_eq!(masked_checksum(b"brain.Event:2"), 0x7c06_01ee);
        let mut out = Vec::new();
        varint(&mut out, 300);
        assert_eq!(out, [0xac, 0x02]);
    }

    #[test]
    fn logs_are_read_up_to_their_last_whole_line() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("validation.jsonl");
        assert!(records::<Validation>(&path).expect("no log is an empty one").is_empty());
        std::fs::write(&path, "{\"step\":5,\"psnr\":{\"rays 1\":30.0}}\n{\"step\":9,\"ps").expect("a file");
        let found: Vec<Validation> = records(&path).expect("a log");
        assert_eq!(found.iter().map(|validation| validation.step).collect::<Vec<_>>(), [5]);
    }
}
