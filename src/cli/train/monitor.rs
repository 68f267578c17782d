//! The files that show how a run is doing: a page of curves, TensorBoard events, and pictures of some validation frames.

use super::reference::References;
use crate::report::html;
use crate::report::plot::{self, Level, Line, Plot, Point, Scale};
use crate::util::picture;
use anyhow::{Context, Result};
use half::f16;
use renderflow_frame::file;
use renderflow_frame::image::Rgb;
use renderflow_model::fusion::loss::display;
use renderflow_model::fusion::record::at;
use renderflow_model::fusion::training::variants;
use renderflow_model::fusion::{Fusion, Record};
use renderflow_model::train::runner::{LogRecord, Validation, weights_path};
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::{SystemTime, UNIX_EPOCH};

/// The kinds of input that the sheets of pictures show.
const SHEETS: [&str; 4] = ["deferred+keys", "rays 1", "denoised 4", "denoised+around+keys 4"];
/// Most frames on one sheet.
const FRAMES: usize = 4;

/// Writes the files of one run.
pub(super) struct Monitor<'a> {
    out: &'a Path,
    /// Created with the first scalar, so that a run that is refused leaves no file behind.
    events: Mutex<Option<Events>>,
    validation: &'a [Record<f16>],
    references: &'a References,
}

impl<'a> Monitor<'a> {
    pub(super) fn new(out: &'a Path, validation: &'a [Record<f16>], references: &'a References) -> Self {
        Self { out, events: Mutex::new(None), validation, references }
    }

    /// Writes the scalars of a log line.
    pub(super) fn line(&self, record: &LogRecord) -> Result<()> {
        let numbers =
            [("train/loss", record.loss), ("train/gradient_norm", record.gradient_norm), ("train/rate", record.lr as f32)];
        let mut scalars: Vec<(String, f32)> = numbers.map(|(name, value)| (name.to_owned(), value)).into();
        scalars.push(("train/crops_per_second".to_owned(), record.items_per_second as f32));
        scalars.extend(record.psnr.iter().map(|(name, value)| (format!("train_psnr/{name}"), *value)));
        self.scalars(record.step, &scalars)
    }

    /// Writes the scalars of a validation, the curves so far, and the sheets.
    pub(super) fn validated(&self, validated: &Validation) -> Result<()> {
        let scalars: Vec<(String, f32)> =
            validated.psnr.iter().map(|(name, value)| (format!("validation_psnr/{name}"), *value)).collect();
        self.scalars(validated.step, &scalars)?;
        file::write_atomic(&self.out.join("curves.html"), self.curves()?.as_bytes())?;
        let network = Fusion::load(&weights_path(self.out))?;
        let untrained = Fusion::untrained(&network.header().fusion, 0)?;
        for name in SHEETS {
            if let Some(sheet) = sheet(&network, &untrained, self.validation, name)? {
                let path = self.out.join(format!("validation-{}.png", name.replace([' ', '+'], "-")));
                file::write_atomic(&path, &picture::png(&sheet)?)?;
            }
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
        let validations: Vec<Validation> = records(&self.out.join("validation.jsonl"))?;
        let point = |step: u64, value: f32| Point { at: (step as f64, f64::from(value)), ..Point::default() };
        let loss: Vec<(String, Vec<Point>)> =
            vec![("loss".to_owned(), lines.iter().map(|line| point(line.step, line.loss)).collect())];
        let mut by_tier: BTreeMap<String, Vec<Point>> = BTreeMap::new();
        for validation in &validations {
            for (name, psnr) in &validation.psnr {
                by_tier.entry(name.clone()).or_default().push(point(validation.step, *psnr));
            }
        }
        // Each level has the colour of its curve.
        let level = |(color, name): (usize, &String)| {
            let y = f64::from(*self.references.oidn.get(name)?);
            Some(Level { name: format!("OIDN, {name}"), named: true, color, y })
        };
        let levels: Vec<Level> = by_tier.keys().enumerate().filter_map(level).collect();
        let body = format!(
            "<h1>Training of {}</h1>\n<h2>Validation</h2>\n{}<h2>Loss of the batches</h2>\n{}",
            html::escape(&self.out.display().to_string()),
            figure("validation", "PSNR, dB (up is better)", by_tier.into_iter().collect(), levels),
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

/// A sheet with one row for each frame that has the inputs `name`: the best input, the picture of the network, the truth, and the
/// errors of the first two.
fn sheet(network: &Fusion, untrained: &Fusion, frames: &[Record<f16>], name: &str) -> Result<Option<Rgb>> {
    let mut rows = Vec::new();
    for record in frames {
        let Some((_, selection)) = variants(record).into_iter().find(|(variant, _)| variant == name) else { continue };
        let picture = |pixels: Vec<[f32; 3]>| Rgb {
            width: record.width,
            height: record.height,
            pixels: pixels.into_iter().map(|rgb| rgb.map(display)).collect(),
        };
        let [input, drawn] = [untrained, network].map(|network| network.draw(record, &selection).map(picture));
        let truth = record.pixels.chunks_exact(at::COUNT).map(|stored| [0, 1, 2].map(|c| stored[at::TRUTH + c].to_f32()));
        let (input, drawn, truth) = (input?, drawn?, picture(truth.collect()));
        let errors = [&input, &drawn].map(|made| picture::error_map(made, &truth));
        let [before, after] = errors;
        rows.push([input, drawn, truth, before, after]);
        if rows.len() == FRAMES {
            break;
        }
    }
    let Some([first, ..]) = rows.first() else { return Ok(None) };
    let (width, height) = (first.width, first.height);
    Ok(Some(Rgb::from_fn(5 * width, rows.len() * height, |x, y| *rows[y / height][x / width].at(x % width, y % height))))
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
