//! What an edit in steps comes to: a table of errors, a labelled sheet and an animation for each class of the results, whose
//! sequences are its steps of one frame each.

use super::table::{aligned, metric, number};
use crate::evaluate::results::{MethodInfo, Results, Scored, TRUTH, picture_file};
use crate::metrics::Metric;
use crate::util::picture;
use crate::util::sheet::{self, Tile};
use anyhow::Result;
use renderflow_frame::image::Rgb;
use serde_json::{Value, json};
use std::fmt::Write;

/// Metrics of the table.
const COLUMNS: [&str; 3] = ["psnr", "lpips_alex", "flip"];
/// Most steps on a sheet.
const WIDEST: usize = 12;
/// Milliseconds that the animation shows each step.
const SHOWN: u32 = 250;

/// One edit.
pub struct Steps<'a> {
    results: &'a Results,
    /// The class of its sequences.
    name: &'a str,
    /// One sequence for each step.
    steps: Vec<&'a Scored>,
    /// What is edited, and its value at each step.
    labels: Vec<String>,
}

impl<'a> Steps<'a> {
    /// The edit `name` in `results`. There is one label for each step.
    pub fn new(results: &'a Results, name: &'a str, labels: Vec<String>) -> Self {
        let steps = results.sequences.iter().filter(|scored| scored.about.class == name).collect();
        Self { results, name, steps, labels }
    }

    /// The metrics of its table that some step has a value of.
    fn columns(&self) -> Vec<&'static Metric> {
        let there = |id: &str| self.steps.iter().flat_map(|step| &step.scores).any(|score| score.values.contains_key(id));
        COLUMNS.iter().filter(|id| there(id)).filter_map(|id| metric(id)).collect()
    }

    /// The value of a metric at a step.
    fn value(step: &Scored, method: &MethodInfo, metric: &Metric) -> Option<f64> {
        step.scores.iter().find(|score| score.method == method.id)?.values.get(metric.id).copied()
    }

    /// The error of each method at each step, and its mean, as Markdown.
    pub fn table(&self) -> String {
        let (methods, columns) = (&self.results.about.methods, self.columns());
        let pairs = || methods.iter().flat_map(|method| columns.iter().map(move |metric| (method, *metric)));
        let cell = |metric: &Metric, value: Option<f64>| value.map_or_else(|| "-".into(), |value| number(metric, value));
        let mut lines = vec![vec![self.name.to_owned()]];
        lines[0].extend(pairs().map(|(method, metric)| format!("{}, {}", method.label, metric.label)));
        for (step, label) in self.steps.iter().zip(&self.labels) {
            let mut line = vec![label.clone()];
            line.extend(pairs().map(|(method, metric)| cell(metric, Self::value(step, method, metric))));
            lines.push(line);
        }
        let mut mean = vec!["mean".to_owned()];
        mean.extend(pairs().map(|(method, metric)| cell(metric, self.mean(method, metric))));
        lines.push(mean);
        aligned(&lines)
    }

    /// The PSNR of each method at each step, and its mean.
    pub fn psnr(&self) -> Vec<(String, Vec<String>)> {
        let Some(psnr) = metric("psnr") else { return Vec::new() };
        let methods = || self.results.about.methods.iter();
        let cell = |value: Option<f64>| value.map_or_else(|| "-".into(), |value| number(psnr, value));
        let step = |(step, label): (&&Scored, &String)| {
            (label.clone(), methods().map(|method| cell(Self::value(step, method, psnr))).collect())
        };
        let mean = ("mean".to_owned(), methods().map(|method| cell(self.mean(method, psnr))).collect());
        self.steps.iter().zip(&self.labels).map(step).chain([mean]).collect()
    }

    /// The mean of a metric over all steps that have a value.
    pub fn mean(&self, method: &MethodInfo, metric: &Metric) -> Option<f64> {
        let values: Vec<f64> = self.steps.iter().filter_map(|step| Self::value(step, method, metric)).collect();
        (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
    }

    /// The same as [`Self::table`] for other programs, with all metrics.
    pub fn json(&self) -> Value {
        let step = |(step, label): (&&Scored, &String)| {
            let scores: Vec<Value> = step
                .scores
                .iter()
                .map(|score| json!({ "method": score.method, "seconds": score.seconds, "metrics": score.values }))
                .collect();
            json!({ "step": label, "scores": scores })
        };
        json!({ "edit": self.name, "steps": self.steps.iter().zip(&self.labels).map(step).collect::<Vec<_>>() })
    }

    /// The truth and the picture of each method at a step, each with its name and PSNR.
    fn tiles(&self, step: &Scored) -> Result<Vec<Tile>> {
        let frame = step.about.frames.first().copied().unwrap_or(0);
        let read = |id: &str| picture::display_values(&step.pictures.join(picture_file(frame, id)));
        let mut tiles = vec![Tile::new("path traced", read(TRUTH)?)];
        for method in &self.results.about.methods {
            let mut name = method.label.clone();
            if let Some((psnr, value)) = metric("psnr").and_then(|psnr| Some((psnr, Self::value(step, method, psnr)?))) {
                // Writing to a string cannot fail.
                let _ = write!(name, ", {} dB", number(psnr, value));
            }
            tiles.push(Tile::new(name, read(&method.id)?));
        }
        Ok(tiles)
    }

    /// Indices of the steps on a sheet: all of them, or the ends and others evenly between them.
    fn shown(&self) -> Vec<usize> {
        let count = self.steps.len().min(WIDEST);
        (0..count).map(|k| k * (self.steps.len() - 1) / (count.max(2) - 1)).collect()
    }

    /// Steps side by side, a row for the truth and for each method. Of more than [`WIDEST`] steps, some are left out.
    ///
    /// # Errors
    /// When a picture of the results cannot be read.
    pub fn sheet(&self) -> Result<Rgb> {
        let shown = self.shown();
        let columns = shown.iter().map(|&step| self.tiles(self.steps[step])).collect::<Result<Vec<_>>>()?;
        let rows = columns.first().map_or(0, Vec::len);
        let mut tiles = Vec::new();
        for row in 0..rows {
            for (column, &step) in columns.iter().zip(&shown) {
                let mut tile = column[row].clone();
                if row == 0 {
                    tile.name = format!("{}, {}", tile.name, self.labels[step]);
                }
                tiles.push(tile);
            }
        }
        Ok(sheet::sheet(&tiles, columns.len()))
    }

    /// All methods side by side, one step after the other, there and back.
    ///
    /// # Errors
    /// As [`Self::sheet`], and when the pictures are too large for a GIF.
    pub fn animation(&self) -> Result<Vec<u8>> {
        let count = self.steps.len();
        let order = (0..count).chain((1..count.saturating_sub(1)).rev());
        let picture = |index: usize| {
            let mut tiles = self.tiles(self.steps[index])?;
            tiles[0].name = format!("{}, {}", tiles[0].name, self.labels[index]);
            Ok(sheet::sheet(&tiles, tiles.len()))
        };
        picture::gif(order.map(picture), SHOWN)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::results::{About, SequenceSummary};
    use std::path::PathBuf;

    #[test]
    fn a_sheet_shows_the_ends_and_no_more_than_fits() {
        let about = About {
            version: 2,
            program: String::new(),
            title: String::new(),
            machine: String::new(),
            lpips: None,
            curve: String::new(),
            methods: Vec::new(),
            settings: Vec::new(),
            sequences: None,
        };
        let step = |name: usize| Scored {
            about: SequenceSummary { class: "cone".into(), name: name.to_string(), ..SequenceSummary::default() },
            pictures: PathBuf::new(),
            scores: Vec::new(),
        };
        for (count, last) in [(0, None), (1, Some(0)), (2, Some(1)), (12, Some(11)), (13, Some(12)), (1000, Some(999))] {
            let results = Results { about: about.clone(), sequences: (0..count).map(step).collect() };
            let shown = Steps::new(&results, "cone", vec![String::new(); count]).shown();
            assert_eq!((shown.len(), shown.last().copied()), (count.min(WIDEST), last), "{count}");
            assert!(shown.windows(2).all(|pair| pair[0] < pair[1]) && shown.first().is_none_or(|first| *first == 0));
        }
    }
}
