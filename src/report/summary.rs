//! A summary of the results in a few sentences.

use super::html::escape;
use super::style::EQUAL;
use super::table::{self, Filter, Means, Row};
use crate::metrics::Metric;

/// A paragraph about a set; empty where no method has a PSNR.
pub fn paragraph(means: &Means, set: &str) -> String {
    let filter = Filter { set: Some(set), without_ablations: true, ..Filter::default() };
    let rows = means.rows(filter);
    let Some(psnr) = table::metric("psnr") else { return String::new() };
    let traced = |row: &&Row| row.method.group.is_traced();
    let keys = |row: &&Row| row.method.reads_keyframes;
    let mut sentences = Vec::new();
    let plain = best(rows.iter().filter(|row| !traced(row) && !keys(row)));
    if let Some(row) = plain {
        sentences.push(format!("Without keyframes and without path tracing {} is best: {}.", bold(row), result(psnr, row)));
    }
    if let Some((row, budget)) = plain.and_then(|row| Some((row, row.seconds?))) {
        let same = best(rows.iter().filter(traced).filter(|row| row.seconds.is_some_and(|s| s <= EQUAL * budget)));
        sentences.push(match same {
            Some(other) => {
                format!("At equal time path tracing stands at {} ({}), {}.", value(psnr, other), bold(other), gap(other, row))
            }
            None => "No path-traced row is as fast.".into(),
        });
    }
    if let Some(row) = best(rows.iter().filter(|row| !traced(row) && keys(row))) {
        sentences.push(format!("With keyframes {} is best: {}.", bold(row), result(psnr, row)));
    }
    if let Some(row) = best(rows.iter().filter(traced)) {
        sentences.push(format!("The best path-traced row is {}: {}.", bold(row), result(psnr, row)));
    }
    if sentences.is_empty() {
        return String::new();
    }
    format!("<p><strong>{}:</strong> {}</p>\n", escape(set), sentences.join(" "))
}

fn best<'a, 'r: 'a>(rows: impl Iterator<Item = &'a Row<'r>>) -> Option<&'a Row<'r>> {
    rows.filter(|row| row.mean("psnr").is_some())
        .max_by(|a, b| a.mean("psnr").unwrap_or(0.0).total_cmp(&b.mean("psnr").unwrap_or(0.0)))
}

fn bold(row: &Row) -> String {
    format!("<em>{}</em>", escape(&row.method.label))
}

fn value(metric: &Metric, row: &Row) -> String {
    row.mean(metric.id).map_or_else(String::new, |mean| format!("{} dB", table::number(metric, mean)))
}

fn result(metric: &Metric, row: &Row) -> String {
    let ends = row.cells.get(metric.id).and_then(|cell| cell.range);
    let ends = ends.map_or_else(String::new, |[a, b]| format!(" ({} to {})", table::number(metric, a), table::number(metric, b)));
    let seconds = row.seconds.map_or_else(String::new, |s| format!(" at {} s a frame", table::seconds(s)));
    let paid = row.seconds_with_truth.filter(|_| row.method.reads_keyframes);
    let paid = paid.map_or_else(String::new, |s| format!(", {} s with the truth of its keyframes", table::seconds(s)));
    format!("{}{ends}{seconds}{paid}", value(metric, row))
}

fn gap(row: &Row, than: &Row) -> String {
    let gap = row.mean("psnr").unwrap_or(0.0) - than.mean("psnr").unwrap_or(0.0);
    let seconds = row.seconds.map_or_else(String::new, |s| format!(" at {} s", table::seconds(s)));
    format!("{:.2} dB {}{seconds}", gap.abs(), if gap < 0.0 { "below" } else { "above" })
}
