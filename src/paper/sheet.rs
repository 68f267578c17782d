//! Tables as text.

use crate::evaluate::results::{Results, Scored};
use crate::metrics::bootstrap::{Interval, bootstrap};
use crate::report::table::{Filter, Means, aligned, metric, number, seconds};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fmt::Write;

/// A row as text: its label, its cells, a note, and the paper's numbers.
pub type Line = (String, Vec<String>, String, String);

/// A table with its text.
#[derive(Clone, Debug)]
pub struct Table {
    /// Heading.
    pub title: String,
    /// What is measured, in a few sentences.
    pub text: String,
    /// Ids of the columns, where they are metrics.
    columns: Vec<&'static str>,
    /// Heads of the columns.
    pub heads: Vec<String>,
    /// Its rows.
    pub rows: Vec<Line>,
    /// The rows with their numbers, for other programs.
    values: Vec<Value>,
    /// Files of pictures in the output folder.
    pub pictures: Vec<String>,
}

/// Head of a column that is no metric.
fn head(id: &str) -> String {
    match id {
        "seconds" => "s / frame".into(),
        "with_truth" => "s / frame with truth".into(),
        "psnr_all" => "PSNR full, all frames".into(),
        id => metric(id).map_or_else(|| id.to_owned(), |metric| metric.label.to_owned()),
    }
}

impl Table {
    /// A table with columns of these metrics.
    pub fn new(title: &str, text: &str, columns: &[&'static str]) -> Self {
        Self {
            title: title.into(),
            text: text.into(),
            columns: columns.to_vec(),
            heads: columns.iter().map(|id| head(id)).collect(),
            rows: Vec::new(),
            values: Vec::new(),
            pictures: Vec::new(),
        }
    }

    /// Adds a row, beside the numbers that the paper has for it.
    pub fn add(&mut self, row: Row, paper: &str) {
        let cells = self.columns.iter().map(|id| row.cell(id)).collect();
        self.values.push(json!({ "label": row.label, "values": row.values, "note": row.note, "paper": paper }));
        self.rows.push((row.label, cells, row.note, paper.to_owned()));
    }

    /// The table as Markdown, with its heading.
    pub fn markdown(&self) -> String {
        let (noted, published) = (self.rows.iter().any(|row| !row.2.is_empty()), self.rows.iter().any(|row| !row.3.is_empty()));
        let mut head = vec![String::new()];
        head.extend(self.heads.iter().cloned());
        head.extend(noted.then(String::new));
        head.extend(published.then(|| "the paper, its own data".to_owned()));
        let line = |(label, cells, note, paper): &Line| {
            let mut line = vec![label.clone()];
            line.extend(cells.iter().cloned());
            line.extend(noted.then(|| note.clone()));
            line.extend(published.then(|| paper.clone()));
            line
        };
        let lines: Vec<Vec<String>> = std::iter::once(head).chain(self.rows.iter().map(line)).collect();
        let mut text = format!("## {}\n\n{}\n\n", self.title, self.text);
        text += &aligned(&lines);
        for picture in &self.pictures {
            // Writing to a string cannot fail.
            let _ = write!(text, "\n![{0}]({picture})\n", self.title);
        }
        text
    }

    /// The table for other programs.
    pub fn json(&self) -> Value {
        let plain = || self.rows.iter().map(|row| json!({ "label": row.0, "cells": row.1, "note": row.2 })).collect();
        let rows: Vec<Value> = if self.values.is_empty() { plain() } else { self.values.clone() };
        json!({ "title": self.title, "text": self.text, "heads": self.heads, "rows": rows })
    }
}

/// A row of a table.
#[derive(Clone, Debug, Default)]
pub struct Row {
    /// Its first cell.
    pub label: String,
    /// Means with their intervals, by id.
    values: BTreeMap<String, Interval>,
    /// What else there is to say.
    pub note: String,
}

impl Row {
    /// A row without numbers.
    pub fn named(label: &str) -> Self {
        Self { label: label.into(), ..Self::default() }
    }

    /// A number without an interval.
    pub fn set(&mut self, id: &str, mean: f64) {
        self.values.insert(id.to_owned(), Interval { mean, range: None, sequences: 0 });
    }

    /// The row of a method in results.
    pub fn of(results: &Results, id: &str, label: &str) -> Self {
        let mut made = Self::named(label);
        let means = Means::new(results);
        let rows = means.rows(Filter::default());
        let Some(row) = rows.iter().find(|row| row.method.id == id) else { return made };
        made.values = row.cells.iter().map(|(id, cell)| ((*id).to_owned(), *cell)).collect();
        for (id, value) in [("seconds", row.seconds), ("with_truth", row.seconds_with_truth)] {
            if let Some(value) = value {
                made.set(id, value);
            }
        }
        let whole: Vec<f64> = results.sequences.iter().map(|sequence| whole(sequence, id)).collect();
        made.values.extend(bootstrap(&whole).map(|all| ("psnr_all".to_owned(), all)));
        made
    }

    /// The text of a cell: the mean, and its interval for PSNR.
    pub fn cell(&self, id: &str) -> String {
        let Some(value) = self.values.get(id) else { return "-".into() };
        if ["seconds", "with_truth"].contains(&id) {
            return seconds(value.mean);
        }
        let Some(metric) = metric(if id == "psnr_all" { "psnr_full" } else { id }) else {
            return if id == "spread" { format!("{:.3}", value.mean) } else { format!("{:.2}", value.mean) };
        };
        let mean = number(metric, value.mean);
        match value.range.filter(|_| id.starts_with("psnr")) {
            Some([low, high]) => format!("{mean} ({low:.1} to {high:.1})"),
            None => mean,
        }
    }
}

/// The PSNR of the mean squared error of all frames of a sequence, keyframes too: where they are the truth itself, only their
/// squared error has a mean that says something. Those that were evaluated stand for their share of the sequence, which is not
/// their share of the frames that were evaluated.
fn whole(sequence: &Scored, method: &str) -> f64 {
    let scores = sequence.scores.iter().filter(|score| score.method == method);
    let errors = scores.filter_map(|score| Some((score.key, 10f64.powf(-0.1 * score.values.get("psnr_full")?))));
    let (keys, between): (Vec<_>, Vec<_>) = errors.partition(|(key, _)| *key);
    // Results of earlier versions know the distance of the keyframes alone.
    let about = &sequence.about;
    let evaluated = keys.len() as f64 / (keys.len() + between.len()) as f64;
    let share = about.keyframe_share.or(about.keyframe_gap.map(f64::recip)).unwrap_or(evaluated);
    let (mut sum, mut weights) = (0.0, 0.0);
    for (errors, share) in [(keys, share), (between, 1.0 - share)].into_iter().filter(|(errors, _)| !errors.is_empty()) {
        sum += share * errors.iter().map(|(_, error)| error).sum::<f64>() / errors.len() as f64;
        weights += share;
    }
    -10.0 * (sum / weights).log10()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::results::{About, Group, MethodInfo, Score, SequenceSummary, Truth, VERSION};

    /// Two of every ten frames of a sequence whose only evaluated keyframe is the first.
    fn tenth(about: SequenceSummary) -> Scored {
        let frames = (0..50).filter(|frame| frame % 10 < 2);
        let score = |frame: usize| Score {
            method: "warp".into(),
            frame,
            key: frame == 0,
            seconds: None,
            spp: None,
            values: [("psnr_full".to_owned(), if frame == 0 { 100.0 } else { 20.0 })].into(),
        };
        Scored { about, pictures: std::path::PathBuf::new(), scores: frames.map(score).collect() }
    }

    #[test]
    fn keyframes_count_by_their_share_of_the_sequence() {
        // Two keyframes among 50 frames: the error is that of 48 frames.
        let gain = -10.0 * 0.96f64.log10();
        let known = SequenceSummary { keyframe_gap: Some(25.0), keyframe_share: Some(0.04), ..SequenceSummary::default() };
        let earlier = SequenceSummary { keyframe_share: None, ..known.clone() };
        for about in [known.clone(), earlier] {
            let all = whole(&tenth(about), "warp");
            assert!((all - 20.0 - gain).abs() < 1e-4, "{all}");
        }
        // Where nothing is known of the others, the frames that were evaluated stand for all.
        let all = whole(&tenth(SequenceSummary::default()), "warp");
        assert!((all - 20.0 + 10.0 * 0.9f64.log10()).abs() < 1e-4, "{all}");
        // Where no keyframe was evaluated, or nothing else was, the others stand for all.
        for (key, expected) in [(false, 20.0), (true, 100.0)] {
            let mut some = tenth(known.clone());
            some.scores.retain(|score| score.key == key);
            assert!((whole(&some, "warp") - expected).abs() < 1e-9);
        }
        assert!(whole(&tenth(known), "another method").is_nan());
    }

    /// Where nobody wrote down the seconds of the truth, a method that reads keyframes is not as cheap as without them.
    #[test]
    fn a_price_that_is_not_known_is_not_shown() {
        let cells = |seconds: Option<f64>, reads_keyframes: bool| {
            let truth = Truth { seconds, ..Truth::default() };
            let mut sequence = tenth(SequenceSummary { keyframe_gap: Some(10.0), truth, ..SequenceSummary::default() });
            sequence.scores.iter_mut().for_each(|score| score.seconds = Some(0.5));
            let method = MethodInfo { reads_keyframes, ..MethodInfo::new("warp".into(), "warp".into(), Group::Baseline) };
            let about = About {
                version: VERSION,
                program: String::new(),
                title: String::new(),
                machine: String::new(),
                lpips: None,
                curve: String::new(),
                methods: vec![method],
                settings: Vec::new(),
                sequences: None,
            };
            let row = Row::of(&Results { about, sequences: vec![sequence] }, "warp", "warp");
            ["seconds", "with_truth"].map(|id| row.cell(id))
        };
        assert_eq!(cells(Some(5.0), true), ["0.500", "1.00"]);
        assert_eq!(cells(None, true), ["0.500", "-"]);
        assert_eq!(cells(None, false), ["0.500", "0.500"]);
    }

    #[test]
    fn tables_show_what_there_is() {
        let mut table = Table::new("Steps", "Euler steps.", &["psnr_full", "seconds"]);
        let mut row = Row::named("1 step");
        row.set("psnr_full", 24.1234);
        table.add(row, "best");
        table.add(Row { note: "slow".into(), ..Row::named("2 steps") }, "");
        table.pictures.push("steps.png".into());
        let text = table.markdown();
        for words in [
            "## Steps",
            "Euler steps.",
            "the paper, its own data",
            "| 1 step  |",
            "24.12 |",
            "best",
            "slow",
            "![Steps](steps.png)",
        ] {
            assert!(text.contains(words), "{words} is not in\n{text}");
        }
        let all = table.json();
        assert_eq!(all["rows"][0]["values"]["psnr_full"]["mean"], 24.1234);
        assert_eq!(all["rows"][1]["note"], "slow");
    }
}
