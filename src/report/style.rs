//! Colours, and the cells that both kinds of pages share.

use super::html::{self, escape};
use super::table::{self, COLUMNS, Row};
use crate::evaluate::results::{Group, MethodInfo};
use crate::metrics::Metric;
use crate::metrics::bootstrap::Interval;
use std::collections::BTreeMap;

/// A colour number for each method. Methods of one series share it, and ablations have the colour of their parent.
pub struct Palette(BTreeMap<String, usize>);

impl Palette {
    /// Gives out colours in the order of the methods.
    pub fn new(methods: &[MethodInfo]) -> Self {
        let mut colors = BTreeMap::new();
        let mut series: BTreeMap<&str, usize> = BTreeMap::new();
        let mut next = 0;
        for method in methods.iter().filter(|method| method.group != Group::Ablation) {
            let fresh = || {
                next += 1;
                next - 1
            };
            let color = match &method.series {
                Some(name) => *series.entry(name).or_insert_with(fresh),
                // It takes the time of another method, but belongs to its own series.
                None => of_series(method, &series).map_or_else(fresh, |(_, color)| color),
            };
            colors.insert(method.id.clone(), color);
        }
        for method in methods.iter().filter(|method| method.group == Group::Ablation) {
            let parent = table::parent(methods, method).and_then(|parent| colors.get(&parent.id).copied());
            colors.insert(method.id.clone(), parent.unwrap_or(0));
        }
        Self(colors)
    }

    /// Number of a method's colour.
    pub fn color(&self, method: &str) -> usize {
        self.0.get(method).copied().unwrap_or(0)
    }
}

/// The series whose name starts a method's label, for a row that takes the seconds of another method.
fn of_series<'a, T: Copy>(method: &MethodInfo, series: &BTreeMap<&'a str, T>) -> Option<(&'a str, T)> {
    let begun = series.iter().filter(|(name, _)| method.group == Group::EqualTime && method.label.starts_with(*name));
    begun.max_by_key(|(name, _)| name.len()).map(|(name, value)| (*name, *value))
}

/// A method's label without the name of its series, which the colour shows.
pub fn short_label(methods: &[MethodInfo], method: &MethodInfo) -> String {
    let series = methods.iter().filter_map(|method| Some((method.series.as_deref()?, ()))).collect();
    let rest = of_series(method, &series).and_then(|(name, ())| method.label.strip_prefix(name));
    rest.map(str::trim).filter(|rest| !rest.is_empty()).unwrap_or(&method.label).to_owned()
}

/// Seconds count as equal up to this ratio: rows of equal time differ by a few percent on a quiet machine.
pub const EQUAL: f64 = 1.15;

/// Stands where there is no value.
pub const NONE: &str = "<span class=\"none\">–</span>";

/// A method's name with its colour; `of` is the number of sequences that it could have been scored on.
pub fn name(palette: &Palette, row: &Row, of: usize) -> String {
    let color = palette.color(&row.method.id) % super::plot::COLORS;
    let partly = if row.sequences < of { format!(" <small>{} of {of} sequences</small>", row.sequences) } else { String::new() };
    format!("<span class=\"dot c{color}\"></span>{}{partly}", escape(&row.label()))
}

/// A mean, with its interval below.
pub fn cell(metric: &Metric, cell: Option<&Interval>) -> (Option<f64>, String) {
    let Some(cell) = cell else { return (None, NONE.into()) };
    let mean = table::number(metric, cell.mean);
    let ends = cell.range.map(|ends| ends.map(|end| table::number(metric, end)));
    let ends = ends.map_or_else(String::new, |[a, b]| format!("<small>{a} to {b}</small>"));
    (Some(cell.mean), format!("{mean}{ends}"))
}

/// Seconds, or a dash.
pub fn seconds(value: Option<f64>) -> (Option<f64>, String) {
    (value, value.map_or_else(|| NONE.into(), table::seconds))
}

/// Seconds, and by how much a row missed the seconds that it was given.
fn given_seconds(rows: &[Row], row: &Row) -> (Option<f64>, String) {
    let (value, text) = seconds(row.seconds);
    let ratio = table::given_seconds(rows, row).and_then(|given| Some(row.seconds? / given));
    match ratio.filter(|ratio| ratio.is_finite() && !(1.0 / EQUAL..=EQUAL).contains(ratio)) {
        Some(ratio) => (value, format!("{text}<small>{ratio:.2} x given</small>")),
        None => (value, text),
    }
}

/// The table of the headline metrics.
pub fn main_table(palette: &Palette, caption: &str, rows: &[Row], of: usize) -> String {
    let columns: Vec<&Metric> = COLUMNS.iter().filter_map(|id| table::metric(id)).collect();
    let mut heads = vec![("method".to_owned(), "How the pictures were made".to_owned())];
    heads.extend(columns.iter().map(|column| (column.label.to_owned(), direction(column))));
    heads.push(("s/frame".into(), "Median wall seconds of a sequence's frames, mean over sequences; less is better".into()));
    let with_truth =
        "The same with the seconds of the keyframes' truth, shared over their gap, where a method reads it; less is better";
    heads.push((table::WITH_TRUTH.into(), with_truth.into()));
    let line = |row: &Row| {
        let mut line = vec![(None, name(palette, row, of))];
        line.extend(columns.iter().map(|column| cell(column, row.cells.get(column.id))));
        line.extend([given_seconds(rows, row), seconds(row.seconds_with_truth)]);
        line
    };
    html::table(caption, &heads, &rows.iter().map(line).collect::<Vec<_>>())
}

/// The meaning of a metric, and which direction is better.
pub fn direction(metric: &Metric) -> String {
    format!("{}; {}", metric.meaning, better(metric))
}

/// Which direction is better.
pub fn better(metric: &Metric) -> &'static str {
    if metric.rising { html::MORE } else { "less is better" }
}
