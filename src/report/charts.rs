//! The plots of the report.

use super::View;
use super::plot::{Level, Line, Plot, Point, Scale, figure};
use super::style::short_label;
use super::table::{self, Filter, Row};
use crate::evaluate::results::{Group, Scored};
use crate::metrics::Metric;
use std::collections::BTreeMap;

/// Metrics with plots of their own.
const PLOTTED: [&str; 4] = ["psnr", "lpips_alex", "flip", "rel_mse"];
/// Metrics that are plotted over all seconds, one below the other.
const OVER_WHOLE_TIME: [&str; 2] = ["psnr", "temporal"];
/// Pixels of the plots.
const SIZE: (f64, f64) = (960.0, 520.0);

/// Error against seconds a frame, for all methods except those with a budget: the name and the plot of each metric.
pub fn time(view: &View, set: &str) -> Vec<(String, String)> {
    let rows = view.means.rows(Filter { set: Some(set), without_budgets: true, ..Filter::default() });
    each(&rows, |metric| time_plot(view, &rows, metric, &Axis::SECONDS))
}

/// Error and flicker against all seconds a frame, which include the truth of keyframes: a name and two plots for all classes of
/// scenes, then for each class. Where path tracing had budgets, only its rows with budgets are in these plots.
pub fn whole_time(view: &View, set: &str) -> Vec<(String, String)> {
    let classes = table::classes(view.results, set);
    let each = if classes.len() > 1 { classes.as_slice() } else { &[] };
    let parts = std::iter::once(("all classes", None)).chain(each.iter().map(|class| (*class, Some(*class))));
    let part = |(name, class): (&str, Option<&str>)| {
        let mut rows = view.means.rows(Filter { set: Some(set), class, without_ablations: true, ..Filter::default() });
        if rows.iter().any(|row| row.method.group == Group::Budget) {
            rows.retain(|row| row.method.group == Group::Budget || !row.method.group.is_traced());
        }
        let metrics = OVER_WHOLE_TIME.iter().filter_map(|id| table::metric(id));
        let plots: String = metrics.filter_map(|metric| time_plot(view, &rows, metric, &Axis::ALL_SECONDS)).collect();
        (!plots.is_empty()).then(|| (name.to_owned(), plots))
    };
    parts.filter_map(part).collect()
}

/// The seconds that a plot is drawn over.
struct Axis {
    name: &'static str,
    seconds: fn(&Row) -> Option<f64>,
    height: f64,
}

impl Axis {
    const SECONDS: Self = Self { name: "seconds a frame", seconds: |row| row.seconds, height: SIZE.1 };
    const ALL_SECONDS: Self =
        Self { name: "seconds a frame with truth", seconds: |row| row.seconds_with_truth, height: 0.75 * SIZE.1 };
}

/// A plot for each metric that any row has.
fn each(rows: &[Row], draw: impl Fn(&Metric) -> Option<String>) -> Vec<(String, String)> {
    let metrics = PLOTTED.iter().filter_map(|id| table::metric(id));
    let present = metrics.filter(|metric| rows.iter().any(|row| row.cells.contains_key(metric.id)));
    present.filter_map(|metric| Some((metric.label.to_owned(), draw(metric)?))).collect()
}

/// For errors, ratios matter; for decibels and similarities, differences.
fn scale(metric: &Metric) -> Scale {
    if metric.rising { Scale::Linear } else { Scale::Log }
}

/// What an axis of values is called.
fn named(metric: &Metric) -> String {
    let unit = if metric.id.starts_with("psnr") { ", dB" } else { "" };
    format!("{}{unit} ({} is better)", metric.label, if metric.rising { "up" } else { "down" })
}

fn time_plot(view: &View, rows: &[Row], metric: &Metric, axis: &Axis) -> Option<String> {
    let mut lines: BTreeMap<(usize, &str), Line> = BTreeMap::new();
    for (number, row) in rows.iter().enumerate() {
        let (Some(cell), Some(seconds)) = (row.cells.get(metric.id), (axis.seconds)(row)) else { continue };
        let faint = row.method.group == Group::Ablation;
        let series = row.method.series.as_deref().filter(|_| !faint);
        // A method without a series is a line of one point.
        let key = series.map_or((number, row.method.id.as_str()), |series| (usize::MAX, series));
        let line = lines.entry(key).or_insert_with(|| Line {
            id: row.method.id.clone(),
            color: view.palette.color(&row.method.id),
            joined: series.is_some(),
            legend: if faint { String::new() } else { series.unwrap_or(&row.method.label).to_owned() },
            ..Line::default()
        });
        let value = table::number(metric, cell.mean);
        line.points.push(Point {
            at: (seconds, cell.mean),
            bar: cell.range,
            label: if faint { String::new() } else { short(view, row, series) },
            title: format!("{}: {value} at {} s a frame", row.method.label, table::seconds(seconds)),
            faint,
        });
    }
    for (key, line) in lines.iter_mut().filter(|(_, line)| line.joined) {
        // Points are joined in the order of the methods, which shows where a row was faster than a cheaper one. The last point
        // carries the name of the series.
        if let Some(last) = line.points.last_mut() {
            last.label = if last.label.is_empty() { key.1.to_owned() } else { format!("{}, {}", key.1, last.label) };
        }
    }
    (!lines.is_empty()).then(|| {
        figure(&Plot {
            title: &format!("{} against {}", metric.label, axis.name),
            x: (axis.name, Scale::Log),
            y: (&named(metric), scale(metric)),
            lines: lines.into_values().collect(),
            levels: Vec::new(),
            marks: Vec::new(),
            size: (SIZE.0, axis.height),
        })
    })
}

/// The text that tells a point from others of its series.
fn short(view: &View, row: &Row, series: Option<&str>) -> String {
    match (series, row.method.spp) {
        (Some(_), Some(spp)) => format!("{spp} spp"),
        // The axis shows its seconds.
        (Some(_), None) if row.method.group == Group::Budget => String::new(),
        _ => short_label(&view.results.about.methods, row.method),
    }
}

/// Error against samples for each pixel, for every series of path tracing, with other methods as levels: the name and the plot of
/// each metric.
pub fn convergence(view: &View, set: &str) -> Vec<(String, String)> {
    let rows = view.means.rows(Filter { set: Some(set), without_ablations: true, without_budgets: true, ..Filter::default() });
    each(&rows, |metric| convergence_plot(view, &rows, metric))
}

fn convergence_plot(view: &View, rows: &[Row], metric: &Metric) -> Option<String> {
    let mut lines: BTreeMap<&str, Line> = BTreeMap::new();
    let mut levels = Vec::new();
    for row in rows {
        let Some(cell) = row.cells.get(metric.id) else { continue };
        let color = view.palette.color(&row.method.id);
        let value = table::number(metric, cell.mean);
        match (&row.method.series, row.method.spp, row.method.group) {
            (Some(series), Some(spp), _) => {
                let fresh =
                    || Line { color, joined: true, named: true, legend: series.clone(), id: series.clone(), ..Line::default() };
                let title = format!("{}: {value}", row.method.label);
                let at = (f64::from(spp), cell.mean);
                lines.entry(series).or_insert_with(fresh).points.push(Point { at, bar: cell.range, title, ..Point::default() });
            }
            (_, _, Group::PathTraced | Group::EqualTime) => {}
            _ => levels.push(Level { name: row.method.label.clone(), named: true, color, y: cell.mean }),
        }
    }
    lines.values_mut().for_each(|line| line.points.sort_by(|a, b| a.at.0.total_cmp(&b.at.0)));
    (!lines.is_empty()).then(|| {
        figure(&Plot {
            title: &format!("{} against samples per pixel", metric.label),
            x: ("samples per pixel", Scale::Doubling),
            y: (&named(metric), scale(metric)),
            lines: lines.into_values().collect(),
            levels,
            marks: Vec::new(),
            size: SIZE,
        })
    })
}

/// The score of the truth against a perfect picture, beside the best method, with a column for each sequence. `None` where
/// nothing is known.
pub fn truth(view: &View, set: &str) -> Option<String> {
    let sequences = view.means.sequences(Filter { set: Some(set), ..Filter::default() });
    let kind = |name: &str, color, value: &dyn Fn(usize, &Scored) -> Option<f64>| {
        let point = |(column, (number, scored)): (usize, &(usize, &Scored))| {
            let y = value(*number, scored).filter(|y| y.is_finite())?;
            let title = format!("{}: {name} {y:.2} dB", scored.about.name);
            Some(Point { at: (column as f64 + 1.0, y), title, ..Point::default() })
        };
        let points: Vec<Point> = sequences.iter().enumerate().filter_map(point).collect();
        Line { named: !points.is_empty(), legend: name.to_owned(), color, points, ..Line::default() }
    };
    let lines = [
        kind("noise of the raw truth", 0, &|_, scored| scored.about.truth.noise),
        kind("error of the truth", 2, &|_, scored| scored.about.truth.error),
        kind("best method", 1, &|number, _| {
            let methods = view.results.about.methods.iter();
            methods.filter_map(|method| view.means.value(number, &method.id, "psnr")).max_by(f64::total_cmp)
        }),
    ];
    let known = lines[..2].iter().any(|line| !line.points.is_empty());
    known.then(|| {
        figure(&Plot {
            title: "PSNR that the truth would score against a perfect one",
            x: ("sequence, in the order of the list below", Scale::Count),
            y: ("PSNR, dB (up is better)", Scale::Linear),
            lines: lines.into(),
            levels: Vec::new(),
            marks: Vec::new(),
            size: (SIZE.0, 300.0),
        })
    })
}

/// Whether a value says that a picture is the truth itself, as at keyframes.
fn copy(metric: &Metric, value: f64) -> bool {
    if metric.rising { value >= 99.0 } else { value <= 0.0 }
}

/// Metrics over the frames of a sequence, with a line for each method: the name and the plot of each metric.
pub fn frames(view: &View, number: usize) -> Vec<(String, String)> {
    let scored = &view.results.sequences[number];
    let about = &scored.about;
    let (class, name) = (Some(about.class.as_str()), Some(about.name.as_str()));
    let filter = Filter { set: Some(&about.set), class, name, without_ablations: true, without_budgets: true };
    let rows = view.means.rows(filter);
    let draw = |metric: &Metric| {
        let line = |row: &Row| {
            let scores = scored.scores.iter().filter(|score| score.method == row.method.id);
            let value = |score: &crate::evaluate::results::Score| {
                let y = score.values.get(metric.id).copied().filter(|y| y.is_finite() && !(score.key && copy(metric, *y)))?;
                let title = format!("{}, frame {}: {}", row.method.label, score.frame, table::number(metric, y));
                Some(Point { at: (score.frame as f64, y), title, ..Point::default() })
            };
            let mut points: Vec<Point> = scores.filter_map(value).collect();
            points.sort_by(|a, b| a.at.0.total_cmp(&b.at.0));
            let (id, legend, color) = (row.method.id.clone(), row.method.label.clone(), view.palette.color(&row.method.id));
            (!points.is_empty()).then_some(Line { id, legend, named: true, color, joined: true, points })
        };
        let lines: Vec<Line> = rows.iter().filter_map(line).collect();
        let height = SIZE.1.min(300.0).max(80.0 + 14.0 * lines.len() as f64);
        (!lines.is_empty()).then(|| {
            figure(&Plot {
                title: &format!("{} over the frames", metric.label),
                x: ("frame", Scale::Count),
                y: (&named(metric), scale(metric)),
                lines,
                levels: Vec::new(),
                marks: about.keyframes.iter().map(|frame| *frame as f64).collect(),
                size: (SIZE.0, height),
            })
        })
    };
    each(&rows, draw)
}
