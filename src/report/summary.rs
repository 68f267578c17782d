//! A summary of the results in a few sentences.

use super::html::escape;
use super::style::EQUAL;
use super::table::{self, Filter, Means, Row};
use crate::evaluate::results::Group;
use crate::metrics::Metric;

/// A paragraph about a set; empty where no method has a PSNR.
pub fn paragraph(means: &Means, set: &str) -> String {
    let filter = Filter { set: Some(set), without_ablations: true, ..Filter::default() };
    let rows = means.rows(filter);
    let Some(psnr) = table::metric("psnr") else { return String::new() };
    let traced = |row: &&Row| row.method.group.is_traced();
    let keys = |row: &&Row| row.method.reads_keyframes;
    // Nobody says whether pictures from elsewhere read keyframes.
    let foreign = |row: &&Row| row.method.group == Group::Other;
    let mut sentences = Vec::new();
    let plain: Vec<&Row> = rows.iter().filter(|row| !traced(row) && !keys(row) && !foreign(row)).collect();
    sentences.extend(winner(psnr, "Without keyframes and without path tracing", &plain));
    if let Some((row, budget)) = best(&plain).and_then(|row| Some((row, row.seconds?))) {
        let same: Vec<&Row> = rows.iter().filter(traced).filter(|row| row.seconds.is_some_and(|s| s <= EQUAL * budget)).collect();
        sentences.push(match best(&same) {
            Some(other) => format!("Path tracing in the same time ({}) is {}.", bold(other), gap(psnr, other, row)),
            None => "No path-traced row is as fast.".into(),
        });
    }
    sentences.extend(winner(psnr, "With keyframes", &rows.iter().filter(|row| !traced(row) && keys(row)).collect::<Vec<_>>()));
    sentences.extend(winner(psnr, "Of the path-traced rows", &rows.iter().filter(traced).collect::<Vec<_>>()));
    sentences.extend(winner(psnr, "Of the pictures from elsewhere", &rows.iter().filter(foreign).collect::<Vec<_>>()));
    if sentences.is_empty() {
        return String::new();
    }
    format!("<p><strong>{}:</strong> {}</p>\n", escape(set), sentences.join(" "))
}

/// What stands out of `rows`: the best of several, or the score of the only one.
fn winner(psnr: &Metric, among: &str, rows: &[&Row]) -> Option<String> {
    let row = best(rows)?;
    let scored = rows.iter().filter(|row| row.mean("psnr").is_some()).count();
    Some(match scored {
        1 => format!("{} scores {}.", bold(row), result(psnr, row)),
        _ => format!("{among}, {} is best: {}.", bold(row), result(psnr, row)),
    })
}

/// The row with the highest PSNR.
fn best<'a, 'r>(rows: &[&'a Row<'r>]) -> Option<&'a Row<'r>> {
    let psnr = |row: &Row| row.mean("psnr");
    let scored = rows.iter().copied().filter(|row| psnr(row).is_some());
    scored.max_by(|a, b| psnr(a).unwrap_or(0.0).total_cmp(&psnr(b).unwrap_or(0.0)))
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

/// By how much `row` is better or worse than another row.
fn gap(metric: &Metric, row: &Row, than: &Row) -> String {
    let gap = row.mean("psnr").unwrap_or(0.0) - than.mean("psnr").unwrap_or(0.0);
    let seconds = row.seconds.map_or_else(String::new, |s| format!(" at {} s a frame", table::seconds(s)));
    format!("{:.2} dB {}: {}{seconds}", gap.abs(), if gap < 0.0 { "worse" } else { "better" }, value(metric, row))
}
