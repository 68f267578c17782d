//! The table of parts of baselines that were switched on or off, beside the baseline itself.

use super::View;
use super::html;
use super::style::{NONE, better, name, seconds};
use super::table::{self, Filter, Row};
use crate::evaluate::results::Group;
use crate::metrics::Metric;
use crate::metrics::bootstrap::Interval;

/// Metrics that the table compares.
const COMPARED: [&str; 5] = ["psnr", "ssim", "lpips_alex", "flip", "temporal"];

/// The table of a set; empty where no part was switched.
pub fn section(view: &View, set: &str) -> String {
    let filter = Filter { set: Some(set), ..Filter::default() };
    let of = view.means.sequences(filter).len();
    let columns: Vec<&Metric> = COMPARED.iter().filter_map(|id| table::metric(id)).collect();
    let rows = view.means.rows(filter);
    let parent = |row: &Row| table::parent(&view.results.about.methods, row.method).map(|parent| parent.id.as_str());
    let ablations: Vec<&Row> = rows.iter().filter(|row| row.method.group == Group::Ablation).collect();
    let line = |row: &Row, parent: Option<&str>| {
        let mut line = vec![(None, name(&view.palette, row, of))];
        for column in &columns {
            let change = parent.and_then(|parent| view.means.difference(filter, &row.method.id, parent, column.id));
            line.push(cell(column, row.cells.get(column.id), change));
        }
        line.push(seconds(row.seconds));
        line
    };
    let mut lines = Vec::new();
    for whole in rows.iter().filter(|row| row.method.group != Group::Ablation) {
        let mut parts = ablations.iter().filter(|row| parent(row) == Some(&whole.method.id)).peekable();
        if parts.peek().is_some() {
            lines.push(line(whole, None));
            lines.extend(parts.map(|row| line(row, parent(row))));
        }
    }
    // Changes of a method that was not scored here.
    let scored = |id: &str| rows.iter().any(|row| row.method.id == id);
    lines.extend(ablations.iter().filter(|row| !parent(row).is_some_and(scored)).map(|row| line(row, None)));
    if ablations.is_empty() {
        return String::new();
    }
    let mut heads = vec![("method".to_owned(), "A baseline, then the same with a part switched".to_owned())];
    let change = "below it the change from the baseline, on the same sequences; sorts by the change";
    let meaning = |column: &Metric| format!("{}; {change}; {}", column.meaning, better(column));
    heads.extend(columns.iter().map(|column| (column.label.to_owned(), meaning(column))));
    heads.push(("s/frame".into(), "Median wall seconds of a sequence's frames, mean over sequences; less is better".into()));
    format!(
        "<h3>What parts are worth</h3>\n<p>Below a mean its change from the baseline the row was taken from, over the same sequences, with \
         its 95 % interval; grey where the interval holds 0.</p>\n{}",
        html::table(&format!("{set}: parts switched on and off"), &heads, &lines)
    )
}

/// A mean and its change, with sign and interval.
fn cell(metric: &Metric, mean: Option<&Interval>, change: Option<Interval>) -> (Option<f64>, String) {
    let Some(mean) = mean else { return (None, NONE.into()) };
    let mean = table::number(metric, mean.mean);
    let Some(change) = change else { return (None, mean) };
    let text = |value: f64| format!("{value:+.*}", metric.digits).replace('-', "\u{2212}");
    let ends = change.range.map_or_else(String::new, |[a, b]| format!(" ({} to {})", text(a), text(b)));
    let class = if change.is_clear() { " class=\"clear\"" } else { "" };
    (Some(change.mean), format!("{mean}<small{class}>{}{ends}</small>", text(change.mean)))
}
