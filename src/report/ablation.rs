//! Parts of baselines switched on and off, each beside what it was taken from.

use super::View;
use super::style::{NONE, cell, name, seconds};
use super::table::{self, Cell, Filter};
use super::{html, html::escape};
use crate::evaluate::results::{Group, Metric};

/// Metrics that the table compares.
const COMPARED: [&str; 4] = ["psnr", "ssim", "lpips_alex", "flip"];

/// The table of a set; empty where nothing was switched.
pub fn section(view: &View, set: &str) -> String {
    let filter = Filter { set: Some(set), ..Filter::default() };
    let of = view.means.sequences(filter).len();
    let columns: Vec<&Metric> = COMPARED.iter().filter_map(|id| table::metric(id)).collect();
    let rows = view.means.rows(filter);
    let methods = &view.results.about.methods;
    let mut lines = Vec::new();
    for row in rows.iter().filter(|row| row.method.group == Group::Ablation) {
        let parent = table::parent(methods, row.method);
        let mut line = vec![(None, name(&view.palette, row, of))];
        line.push((None, parent.map_or_else(|| NONE.into(), |parent| escape(&parent.label))));
        for column in &columns {
            line.push(cell(column, row.cells.get(column.id)));
            let change = parent.and_then(|parent| view.means.difference(filter, &row.method.id, &parent.id, column.id));
            line.push(signed(column, change));
        }
        line.push(seconds(row.seconds));
        lines.push(line);
    }
    if lines.is_empty() {
        return String::new();
    }
    let mut heads =
        vec![("method", "A baseline with a part switched".to_owned()), ("compared with", "The baseline itself".to_owned())];
    for column in &columns {
        heads.push((column.label, super::style::direction(column)));
        heads.push((
            "change",
            format!("{} of this row less that of the row it is compared with, on the same sequences", column.label),
        ));
    }
    heads.push(("s/frame", "Median wall seconds a frame; less is better".into()));
    let heads: Vec<(String, String)> = heads.into_iter().map(|(text, meaning)| (text.to_owned(), meaning)).collect();
    format!("<h3>What parts are worth</h3>\n{}", html::table(&format!("{set}: parts switched on and off"), &heads, &lines))
}

/// A change with its sign and interval.
fn signed(metric: &Metric, change: Option<Cell>) -> (Option<f64>, String) {
    let Some(change) = change else { return (None, NONE.into()) };
    let text = |value: f64| format!("{value:+.*}", metric.digits);
    let ends = change.interval.map_or_else(String::new, |[a, b]| format!("<small>{} to {}</small>", text(a), text(b)));
    (Some(change.mean), format!("{}{ends}", text(change.mean)))
}
