//! Computes means over frames and sequences with their intervals, and prints tables.

use crate::evaluate::results::{BUDGET_PIXELS, Group, MethodInfo, Results, Scored, SequenceSummary};
use crate::metrics::bootstrap::{self, Interval};
use crate::metrics::{METRICS, Metric, median};
use crate::util::text::plural;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

/// Metrics of the main table, in the order of its columns.
pub const COLUMNS: [&str; 7] = ["psnr", "ssim", "lpips_alex", "flip", "psnr_full", "rel_mse", "temporal"];

/// Head of the column of [`Row::seconds_with_truth`].
pub const WITH_TRUTH: &str = "s/frame with truth";

/// A metric by its id; `None` if [`METRICS`] does not list it.
pub fn metric(id: &str) -> Option<&'static Metric> {
    METRICS.iter().find(|metric| metric.id == id)
}

/// The row of a method in a table.
#[derive(Clone, Debug)]
pub struct Row<'a> {
    /// The method.
    pub method: &'a MethodInfo,
    /// Means by id of the metric; metrics without a value are missing.
    pub cells: BTreeMap<&'static str, Interval>,
    /// Mean over sequences of the median wall seconds of the counted frames.
    pub seconds: Option<f64>,
    /// The same, plus the seconds a frame for the truth of keyframes, where a method reads it; `None` where these are unknown.
    pub seconds_with_truth: Option<f64>,
    /// Mean over sequences of the seconds that the row was given, for rows with a budget.
    pub budget: Option<f64>,
    /// Mean samples for each pixel of the counted frames, for path tracing.
    pub spp: Option<f64>,
    /// Number of sequences that the method was scored on.
    pub sequences: usize,
}

impl Row<'_> {
    /// Name in tables, with the number of samples where it follows from the time.
    pub fn label(&self) -> String {
        let label = &self.method.label;
        match self.spp.filter(|_| matches!(self.method.group, Group::EqualTime | Group::Budget)) {
            Some(spp) => format!("{label} ({spp:.0} spp)"),
            None => label.clone(),
        }
    }

    /// [`label`](Self::label), with the number of sequences where the row stands for fewer than all `of` sequences of its table.
    pub fn label_among(&self, of: usize) -> String {
        match self.sequences {
            fewer if fewer < of => format!("{} ({fewer} of {})", self.label(), plural(of, "sequence")),
            _ => self.label(),
        }
    }

    /// Mean of a metric.
    pub fn mean(&self, metric: &str) -> Option<f64> {
        self.cells.get(metric).map(|cell| cell.mean)
    }
}

/// The part of the results that a table is about.
#[derive(Clone, Copy, Debug, Default)]
pub struct Filter<'a> {
    /// One set only.
    pub set: Option<&'a str>,
    /// One class of scenes only.
    pub class: Option<&'a str>,
    /// One sequence only.
    pub name: Option<&'a str>,
    /// Leaves out rows of [`Group::Ablation`].
    pub without_ablations: bool,
    /// Leaves out rows of [`Group::Budget`].
    pub without_budgets: bool,
}

impl Filter<'_> {
    /// Whether the filter takes the sequence.
    pub fn takes(&self, sequence: &SequenceSummary) -> bool {
        let takes = |asked: Option<&str>, is: &str| asked.is_none_or(|asked| asked == is);
        takes(self.set, &sequence.set) && takes(self.class, &sequence.class) && takes(self.name, &sequence.name)
    }
}

/// Means over frames for each sequence, from which rows are made.
///
/// All methods are averaged over the same frames: those that are not keyframes, or all frames where every frame is a keyframe.
pub struct Means<'a> {
    results: &'a Results,
    /// For each sequence, by method and metric.
    values: Vec<BTreeMap<(&'a str, &'static str), f64>>,
    /// For each sequence, by method: seconds of the counted frames.
    seconds: Vec<BTreeMap<&'a str, Vec<f64>>>,
    /// For each sequence, by method: mean samples for each pixel of the counted frames.
    spp: Vec<BTreeMap<&'a str, f64>>,
    /// For each sequence: methods with a score on a counted frame.
    scored: Vec<BTreeSet<&'a str>>,
}

impl<'a> Means<'a> {
    /// Averages over frames.
    pub fn new(results: &'a Results) -> Self {
        let mut means = Self { results, values: Vec::new(), seconds: Vec::new(), spp: Vec::new(), scored: Vec::new() };
        for sequence in &results.sequences {
            let mut sums: BTreeMap<(&str, &'static str), (f64, usize)> = BTreeMap::new();
            let mut seconds: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
            let mut samples: BTreeMap<&str, (f64, usize)> = BTreeMap::new();
            let mut scored = BTreeSet::new();
            let only_keys = sequence.scores.iter().all(|score| score.key);
            for score in sequence.scores.iter().filter(|score| only_keys || !score.key) {
                scored.insert(score.method.as_str());
                seconds.entry(&score.method).or_default().extend(score.seconds.filter(|s| s.is_finite()));
                if let Some(spp) = score.spp {
                    let sum = samples.entry(&score.method).or_default();
                    *sum = (sum.0 + f64::from(spp), sum.1 + 1);
                }
                for (id, value) in score.values.iter().filter(|(_, value)| value.is_finite()) {
                    let Some(metric) = metric(id) else { continue };
                    let sum = sums.entry((&score.method, metric.id)).or_default();
                    *sum = (sum.0 + value, sum.1 + 1);
                }
            }
            means.values.push(sums.into_iter().map(|(key, (sum, count))| (key, sum / count as f64)).collect());
            means.seconds.push(seconds);
            means.spp.push(samples.into_iter().map(|(method, (sum, count))| (method, sum / count as f64)).collect());
            means.scored.push(scored);
        }
        means
    }

    /// Mean over the frames of sequence number `sequence` in the results.
    pub fn value(&self, sequence: usize, method: &str, metric: &str) -> Option<f64> {
        let metric = self::metric(metric)?;
        self.values.get(sequence)?.get(&(method, metric.id)).copied()
    }

    /// The numbers of the sequences that a mean in a row is over.
    pub fn over(&self, filter: Filter, method: &str, metric: &str) -> Vec<usize> {
        let numbers = self.sequences(filter).into_iter().map(|(number, _)| number);
        numbers.filter(|&number| self.value(number, method, metric).is_some()).collect()
    }

    /// The sequences that the filter takes, with their numbers.
    pub fn sequences(&self, filter: Filter) -> Vec<(usize, &'a Scored)> {
        self.results.sequences.iter().enumerate().filter(|(_, sequence)| filter.takes(&sequence.about)).collect()
    }

    /// A row for each method with a score, in the order of the results' methods.
    pub fn rows(&self, filter: Filter) -> Vec<Row<'a>> {
        let sequences = self.sequences(filter);
        let methods = self.results.about.methods.iter();
        let left_out = |group| match group {
            Group::Ablation => filter.without_ablations,
            Group::Budget => filter.without_budgets,
            _ => false,
        };
        let asked = methods.filter(|method| !left_out(method.group));
        asked.filter_map(|method| self.row(method, &sequences)).collect()
    }

    fn row(&self, method: &'a MethodInfo, sequences: &[(usize, &Scored)]) -> Option<Row<'a>> {
        let numbers = || sequences.iter().map(|(number, _)| *number);
        let count = numbers().filter(|&number| self.scored[number].contains(method.id.as_str())).count();
        let cell = |metric: &Metric| {
            let values: Vec<f64> = numbers().filter_map(|number| self.value(number, &method.id, metric.id)).collect();
            bootstrap::bootstrap(&values)
        };
        let frames = numbers().filter_map(|number| self.seconds[number].get(method.id.as_str()));
        let spp: Vec<f64> = numbers().filter_map(|number| self.spp[number].get(method.id.as_str()).copied()).collect();
        let usual = |seconds: &Vec<f64>| Some(median(seconds)).filter(|s| s.is_finite());
        let medians: Vec<f64> = frames.filter_map(usual).collect();
        let with_truth = |(number, sequence): &(usize, &Scored)| -> Option<Option<f64>> {
            let seconds = self.seconds[*number].get(method.id.as_str()).and_then(usual)?;
            let share = if method.reads_keyframes { sequence.about.truth_share() } else { Some(0.0) };
            Some(share.map(|share| seconds + share))
        };
        let all: Option<Vec<f64>> = sequences.iter().filter_map(with_truth).collect();
        let pixels = |sequence: &SequenceSummary| (sequence.width * sequence.height) as f64 / BUDGET_PIXELS;
        let budget = method.budget.map(|budget| {
            let scored = sequences.iter().filter(|(number, _)| self.scored[*number].contains(method.id.as_str()));
            scored.map(|(_, sequence)| budget * pixels(&sequence.about)).sum::<f64>() / count.max(1) as f64
        });
        (count > 0).then(|| Row {
            method,
            cells: METRICS.iter().filter_map(|metric| Some((metric.id, cell(metric)?))).collect(),
            // The median of all frames would follow a single scene among a few slow and a few fast ones.
            seconds: bootstrap::bootstrap(&medians).map(|seconds| seconds.mean),
            seconds_with_truth: all.and_then(|all| bootstrap::bootstrap(&all)).map(|seconds| seconds.mean),
            budget,
            spp: (!spp.is_empty()).then(|| spp.iter().sum::<f64>() / spp.len() as f64),
            sequences: count,
        })
    }

    /// Mean over sequences of the difference between `method` and `other` on the same sequence.
    pub fn difference(&self, filter: Filter, method: &str, other: &str, metric: &str) -> Option<Interval> {
        let sequences = self.sequences(filter);
        let values = |method| sequences.iter().map(|(number, _)| self.value(*number, method, metric)).collect::<Vec<_>>();
        bootstrap::bootstrap_difference(&values(method), &values(other))
    }
}

/// The method that an ablation changes.
pub fn parent<'a>(methods: &'a [MethodInfo], ablation: &MethodInfo) -> Option<&'a MethodInfo> {
    methods.iter().find(|method| ablation.part_of.as_ref() == Some(&method.id))
}

/// The row whose seconds a method of equal time was given.
pub fn given<'r, 'a>(rows: &'r [Row<'a>], method: &MethodInfo) -> Option<&'r Row<'a>> {
    rows.iter().find(|row| method.time_of.as_ref() == Some(&row.method.id))
}

/// Seconds that a row was given, by a budget or by another method.
pub fn given_seconds(rows: &[Row], row: &Row) -> Option<f64> {
    row.budget.or_else(|| given(rows, row.method)?.seconds)
}

/// A value with the digits of its metric.
pub fn number(metric: &Metric, value: f64) -> String {
    let digits = metric.digits;
    // A rare huge value must not make a column wider.
    if value.abs() >= 1e5 { format!("{value:.2e}") } else { format!("{value:.digits$}") }
}

/// Seconds with three digits that count, but no more than four behind the point.
pub fn seconds(value: f64) -> String {
    let digits = if value >= 100.0 {
        0
    } else if value >= 10.0 {
        1
    } else if value >= 1.0 {
        2
    } else if value >= 0.1 {
        3
    } else {
        4
    };
    format!("{value:.digits$}")
}

/// The sets of the results; the one with most sequences comes first.
pub fn sets(results: &Results) -> Vec<&str> {
    let mut sets = unique(results.sequences.iter().map(|sequence| sequence.about.set.as_str()));
    let count = |set: &str| results.sequences.iter().filter(|sequence| sequence.about.set == set).count();
    sets.sort_by_key(|set| std::cmp::Reverse(count(set)));
    sets
}

/// The classes of a set, in order of first appearance.
pub fn classes<'a>(results: &'a Results, set: &str) -> Vec<&'a str> {
    unique(results.sequences.iter().filter(|s| s.about.set == set).map(|sequence| sequence.about.class.as_str()))
}

fn unique<'a>(names: impl Iterator<Item = &'a str>) -> Vec<&'a str> {
    let mut seen = Vec::new();
    for name in names {
        if !seen.contains(&name) {
            seen.push(name);
        }
    }
    seen
}

/// The main table of each set as Markdown for a terminal: PSNR with its interval, and a dash where there is no value.
pub fn markdown(results: &Results, filter: Filter) -> String {
    let means = Means::new(results);
    let mut text = String::new();
    for set in sets(results).into_iter().filter(|set| filter.set.is_none_or(|asked| asked == *set)) {
        let filter = Filter { set: Some(set), ..filter };
        let rows = means.rows(filter);
        if rows.is_empty() {
            continue;
        }
        let (sequences, frames) = extent(&means, filter);
        let gap = if text.is_empty() { "" } else { "\n" };
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{gap}{set}: {}, {}\n", plural(sequences, "sequence"), plural(frames, "frame"));
        text += &grid(&rows, sequences);
    }
    text
}

/// The main table of each set for other programs: the rows of [`markdown`], with every metric that has a value.
pub fn json(results: &Results) -> Value {
    let means = Means::new(results);
    let row = |row: &Row| {
        json!({
            "id": row.method.id,
            "label": row.label(),
            "seconds": row.seconds,
            "seconds_with_truth": row.seconds_with_truth,
            "spp": row.spp,
            "sequences": row.sequences,
            "metrics": row.cells,
        })
    };
    let set = |set: &&str| {
        let filter = Filter { set: Some(set), ..Filter::default() };
        let (sequences, frames) = extent(&means, filter);
        let rows: Vec<Value> = means.rows(filter).iter().map(row).collect();
        json!({ "set": set, "sequences": sequences, "frames": frames, "rows": rows })
    };
    sets(results).iter().map(set).collect()
}

/// Number of sequences, and of frames that they are averaged over.
pub fn extent(means: &Means, filter: Filter) -> (usize, usize) {
    let sequences = means.sequences(filter);
    let frames = sequences.iter().map(|(_, sequence)| counted(&sequence.about).len()).sum();
    (sequences.len(), frames)
}

/// The frames that count for means.
pub fn counted(sequence: &SequenceSummary) -> Vec<usize> {
    let rest: Vec<usize> = sequence.frames.iter().copied().filter(|frame| !sequence.keyframes.contains(frame)).collect();
    if rest.is_empty() { sequence.frames.clone() } else { rest }
}

/// Rows of a table of `of` sequences as Markdown, with aligned columns.
fn grid(rows: &[Row], of: usize) -> String {
    let columns: Vec<&Metric> = COLUMNS.iter().filter_map(|id| metric(id)).collect();
    let mut lines = vec![vec!["method".to_owned()]];
    for column in &columns {
        lines[0].push(column.label.to_owned());
        lines[0].extend((column.id == "psnr").then(|| "95 %".to_owned()));
    }
    lines[0].extend(["s/frame".to_owned(), WITH_TRUTH.to_owned()]);
    for row in rows {
        // A bar would end the cell.
        let mut line = vec![row.label_among(of).replace('|', "/").replace(char::is_control, " ")];
        for column in &columns {
            let cell = row.cells.get(column.id);
            line.push(cell.map_or_else(|| "-".into(), |cell| number(column, cell.mean)));
            if column.id == "psnr" {
                let ends = cell.and_then(|cell| cell.range);
                line.push(ends.map_or_else(|| "-".into(), |[a, b]| format!("{} to {}", number(column, a), number(column, b))));
            }
        }
        line.extend([row.seconds, row.seconds_with_truth].map(|value| value.map_or_else(|| "-".into(), seconds)));
        lines.push(line);
    }
    aligned(&lines)
}

/// Lines of cells as Markdown. The first line is the head; numbers stand at the right, the first column at the left.
pub fn aligned(lines: &[Vec<String>]) -> String {
    let Some(head) = lines.first() else { return String::new() };
    let width = |column: usize| lines.iter().map(|line| line[column].chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..head.len()).map(width).collect();
    let rule: Vec<String> =
        widths.iter().enumerate().map(|(i, w)| if i == 0 { "-".repeat(w + 2) } else { "-".repeat(w + 1) + ":" }).collect();
    let mut text = String::new();
    for (number, line) in lines.iter().enumerate() {
        for (i, (value, width)) in line.iter().zip(&widths).enumerate() {
            text += &if i == 0 { format!("| {value:<width$} ") } else { format!("| {value:>width$} ") };
        }
        text += "|\n";
        if number == 0 {
            text += &format!("|{}|\n", rule.join("|"));
        }
    }
    text
}
