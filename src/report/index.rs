//! The first page of a report.

use super::html::{self, escape};
use super::style::{self, NONE};
use super::table::{self, Filter};
use super::{View, ablation, charts, summary};
use crate::evaluate::results::{Group, MethodInfo, Scored, TRUTH, picture_file};
use crate::metrics::{METRICS, Metric};
use crate::util::picture;
use crate::util::text::plural;
use anyhow::Result;
use std::fmt::Write;

/// Longer side of thumbnails, in pixels.
const THUMBNAIL: u32 = 160;

/// Longer side of the pictures at the top, in pixels.
const LEAD: u32 = 320;

/// The whole page.
pub(super) fn html(view: &View) -> Result<String> {
    let about = &view.results.about;
    let sets = table::sets(view.results);
    let mut body = format!("<header><h1>{}</h1>\n", escape(&about.title));
    for set in &sets {
        body += &summary::paragraph(&view.means, set);
    }
    body += &lead(view)?;
    body += "<nav aria-label=\"Sections\">";
    for (number, set) in sets.iter().enumerate() {
        write!(body, "<a href=\"#set{number}\">{}</a> ", escape(set))?;
    }
    body += "<a href=\"#methods\">Methods</a> <a href=\"#metrics\">Metrics</a> <a href=\"#settings\">Settings</a></nav></header>\n<main>\n";
    for (number, set) in sets.iter().enumerate() {
        write!(body, "<section id=\"set{number}\">\n<h2>{}</h2>\n", escape(set))?;
        body += &set_section(view, set)?;
        body += "</section>\n";
    }
    body += &methods(view);
    body += &metrics();
    write!(body, "<section id=\"settings\">\n<h2>Settings and machine</h2>\n{}</section>\n", settings(view))?;
    body += "</main>\n";
    Ok(html::page(&about.title, &body))
}

/// Pictures before all numbers: of the first sequence the truth, the best method with keyframes, the best without, and the best
/// path tracing; empty where no pictures were kept. They lead to the page of the sequence.
fn lead(view: &View) -> Result<String> {
    let shown = |scored: &&Scored| !scored.about.shown.is_empty();
    let Some((number, scored)) = view.results.sequences.iter().enumerate().find(|(_, scored)| shown(scored)) else {
        return Ok(String::new());
    };
    let about = &scored.about;
    let plain = about.shown.iter().find(|frame| !about.keyframes.contains(frame));
    let Some(frame) = plain.or(about.shown.first()) else { return Ok(String::new()) };
    let score = |id: &str| view.means.value(number, id, "psnr");
    let best = |wanted: &dyn Fn(&MethodInfo) -> bool| {
        let methods = view.results.about.methods.iter().filter(|method| method.group != Group::Ablation && wanted(method));
        let scored = methods.filter_map(|method| Some((method, score(&method.id)?)));
        scored.max_by(|a, b| a.1.total_cmp(&b.1)).map(|(method, _)| method)
    };
    let chosen = [
        best(&|method| method.reads_keyframes && !method.group.is_traced()),
        best(&|method| !method.reads_keyframes && !method.group.is_traced()),
        best(&|method| method.group.is_traced()),
    ];
    let pictures = chosen.into_iter().flatten().map(|method| (method.id.as_str(), method.label.as_str(), score(&method.id)));
    let mut out = String::new();
    for (id, label, psnr) in std::iter::once((TRUTH, "Truth", None)).chain(pictures) {
        let path = scored.pictures.join(picture_file(*frame, id));
        let Some(bytes) = picture::read(&path)? else { continue };
        let url = picture::data_url(&picture::thumbnail(&bytes, LEAD, &path)?);
        let psnr = psnr.map_or_else(String::new, |psnr| format!(", {psnr:.2} dB"));
        let label = escape(label);
        writeln!(
            out,
            "<li><figure><a href=\"{}\"><img alt=\"{label}\" src=\"{url}\" width=\"{}\" height=\"{}\"></a>\
             <figcaption>{label}{psnr}</figcaption></figure></li>",
            view.pages[number], about.width, about.height
        )?;
    }
    if out.is_empty() {
        return Ok(out);
    }
    let name = escape(&about.name);
    Ok(format!(
        "<ul class=\"lead\">\n{out}</ul>\n<p class=\"quiet\">Frame {frame} of {name}; numbers are means over the sequence. Its page compares all \
         pictures.</p>\n"
    ))
}

fn set_section(view: &View, set: &str) -> Result<String> {
    let filter = Filter { set: Some(set), ..Filter::default() };
    let (sequences, frames) = table::extent(&view.means, filter);
    let rows = view.means.rows(Filter { without_ablations: true, without_budgets: true, ..filter });
    let mut out = format!(
        "<p>{}, {}: those that are no keyframes (all, where every frame of a sequence is one), the same for all \
         methods. Below a mean its 95 % bootstrap interval over sequences. Click a heading to sort.</p>\n",
        plural(sequences, "sequence"),
        plural(frames, "frame")
    );
    out += &style::main_table(&view.palette, &format!("{set}: all classes of scenes"), &rows, sequences);
    out += &plots(
        "Error against time",
        &charts::time(view, set),
        "Mean over sequences with its 95 % interval; seconds as in the table. Faint: parts switched on or off.",
    );
    out += &whole_time(view, filter, sequences);
    out += &plots("Convergence of path tracing", &charts::convergence(view, set), "Other methods as levels.");
    let classes = class_tables(view, set);
    if table::classes(view.results, set).len() > 1 {
        out += "<h3>By class of scene</h3>\n";
        out += &html::chooser("Metric", &classes);
    }
    out += &ablation::section(view, set);
    out += &truth(view, set);
    out += &grid(view, set)?;
    Ok(out)
}

/// Error and flicker over all seconds, and the table of rows with budgets.
fn whole_time(view: &View, filter: Filter, of: usize) -> String {
    let Some(set) = filter.set else { return String::new() };
    let choices = charts::whole_time(view, set);
    if choices.is_empty() {
        return String::new();
    }
    let note = "The seconds of the keyframes' truth, shared over their gap, are paid by the methods that read it. Joined: path tracing in \
                budgets of seconds, where it was given such, else by its samples.";
    let mut out = format!("<h3>Error and flicker against all seconds</h3>\n<p>{note}</p>\n{}", html::chooser("Class", &choices));
    let mut rows = view.means.rows(filter);
    rows.retain(|row| row.method.group == Group::Budget);
    if !rows.is_empty() {
        let table = style::main_table(&view.palette, &format!("{set}: path tracing in budgets of seconds"), &rows, of);
        out += &format!("<details><summary>Table of the budgets</summary>\n{table}</details>\n");
    }
    out
}

fn plots(heading: &str, choices: &[(String, String)], note: &str) -> String {
    if choices.is_empty() {
        return String::new();
    }
    format!("<h3>{heading}</h3>\n<p>{note}</p>\n{}", html::chooser("Metric", choices))
}

/// The methods for each class: a table for each metric.
fn class_tables(view: &View, set: &str) -> Vec<(String, String)> {
    let classes = table::classes(view.results, set);
    let columns: Vec<_> = classes
        .iter()
        .map(|class| {
            let filter = Filter { set: Some(set), class: Some(class), ..Filter::default() };
            (*class, table::extent(&view.means, filter).0, view.means.rows(filter))
        })
        .collect();
    let all = view.means.rows(Filter { set: Some(set), ..Filter::default() });
    let heads = |metric: &Metric| {
        let of_class = |class: &str, count: usize| {
            (class.to_owned(), format!("{}: {}", plural(count, "sequence"), style::direction(metric)))
        };
        let classes = columns.iter().map(|(class, count, _)| of_class(class, *count));
        std::iter::once(("method".to_owned(), "How the pictures were made".to_owned())).chain(classes).collect::<Vec<_>>()
    };
    let of = table::extent(&view.means, Filter { set: Some(set), ..Filter::default() }).0;
    let find = |rows: &[table::Row], id: &str, metric: &'static Metric| {
        style::cell(metric, rows.iter().find(|row| row.method.id == id).and_then(|row| row.cells.get(metric.id)))
    };
    let table = |metric: &'static Metric| {
        let line = |row: &table::Row| {
            let mut line = vec![(None, style::name(&view.palette, row, of))];
            line.extend(columns.iter().map(|(_, _, rows)| find(rows, &row.method.id, metric)));
            line
        };
        let with = all.iter().filter(|row| row.cells.contains_key(metric.id));
        let lines: Vec<_> = with.map(line).collect();
        let caption = format!("{set}: {} by class of scene", metric.label);
        (!lines.is_empty()).then(|| (metric.label.to_owned(), html::table(&caption, &heads(metric), &lines)))
    };
    METRICS.iter().filter_map(table).collect()
}

/// The error of the truth itself, as far as it is known.
fn truth(view: &View, set: &str) -> String {
    let sequences = view.means.sequences(Filter { set: Some(set), ..Filter::default() });
    let decibels = |value: Option<f64>| match value.filter(|value| value.is_finite()) {
        Some(value) => (Some(value), format!("{value:.2}")),
        None => (None, NONE.to_owned()),
    };
    let line = |scored: &Scored| {
        let truth = &scored.about.truth;
        vec![
            (None, escape(&scored.about.name)),
            (None, escape(&scored.about.class)),
            (Some(f64::from(truth.spp)), truth.spp.to_string()),
            style::seconds(truth.seconds),
            decibels(truth.noise),
            decibels(truth.error),
        ]
    };
    let head = |text: &str, meaning: &str| (text.to_owned(), meaning.to_owned());
    let heads = [
        head("sequence", "Name of the sequence"),
        head("class", "Class of scene"),
        head("spp", "Samples a pixel"),
        head("s/frame", "Median seconds a frame"),
        head(
            "noise, dB",
            "PSNR (object) that the noise left in the raw picture would score against a perfect one, from its variance",
        ),
        head(
            "error, dB",
            "PSNR (object) that the truth as it is would score against a perfect one, where a longer render was made to tell",
        ),
    ];
    let lines: Vec<_> = sequences.iter().map(|(_, scored)| line(scored)).collect();
    // One or two dots make no plot.
    let plot = if sequences.len() > 2 { charts::truth(view, set).unwrap_or_default() } else { String::new() };
    format!(
        "<h3>The truth's own error</h3>\n<p>PSNR that the truth would score against a perfect one: a method near it is limited by the \
         truth.</p>\n{plot}<details><summary>Table of the truth</summary>\n{}</details>\n",
        html::table(&format!("{set}: the truth"), &heads, &lines)
    )
}

/// A card for each sequence.
fn grid(view: &View, set: &str) -> Result<String> {
    let mut out = String::from("<h3>Sequences</h3>\n<ul class=\"grid\">\n");
    let main = |group| matches!(group, Group::Baseline | Group::Neural | Group::PathTraced | Group::Other);
    for (number, scored) in view.means.sequences(Filter { set: Some(set), ..Filter::default() }) {
        let about = &scored.about;
        write!(out, "<li><a href=\"{}\">", view.pages[number])?;
        if let Some(frame) = about.shown.get(about.shown.len() / 2) {
            let path = scored.pictures.join(picture_file(*frame, TRUTH));
            if let Some(bytes) = picture::read(&path)? {
                let url = picture::data_url(&picture::thumbnail(&bytes, THUMBNAIL, &path)?);
                write!(out, "<img alt=\"\" src=\"{url}\" width=\"{}\" height=\"{}\">", about.width, about.height)?;
            }
        }
        write!(out, "<strong>{}</strong></a> <span class=\"class\">{}</span>\n<dl>", escape(&about.name), escape(&about.class))?;
        for method in view.results.about.methods.iter().filter(|method| main(method.group)) {
            if let Some(psnr) = view.means.value(number, &method.id, "psnr") {
                write!(out, "<div><dt>{}</dt><dd>{psnr:.2}</dd></div>", escape(&method.label))?;
            }
        }
        out += "</dl></li>\n";
    }
    Ok(out + "</ul>\n")
}

fn methods(view: &View) -> String {
    let rows: Vec<(String, String)> = view
        .results
        .about
        .methods
        .iter()
        .map(|method| {
            let note = if method.note.is_empty() { group(method.group) } else { &method.note };
            (method.label.clone(), note.to_owned())
        })
        .collect();
    format!("<section id=\"methods\">\n<h2>Methods</h2>\n{}</section>\n", html::facts(&rows))
}

fn group(group: Group) -> &'static str {
    match group {
        Group::Baseline => "Baseline: shades what the camera sees; no network, and no rays beyond the camera's.",
        Group::Ablation => "A baseline with a part switched off or on.",
        Group::Neural => "A network draws the picture from the G-buffer and the environment; no rays beyond the camera's.",
        Group::PathTraced => "Path tracing with this many samples per pixel (spp); with OIDN, a denoiser cleans the picture.",
        Group::EqualTime => "Path tracing with as many samples as fit into the seconds of another method.",
        Group::Budget => "Path tracing with as many samples as fit into these seconds.",
        Group::Other => "Pictures from elsewhere.",
    }
}

fn metrics() -> String {
    let rows: Vec<(String, String)> =
        METRICS.iter().map(|metric| (metric.label.to_owned(), format!("{}.", style::direction(metric)))).collect();
    format!("<section id=\"metrics\">\n<h2>Metrics</h2>\n{}</section>\n", html::facts(&rows))
}

fn settings(view: &View) -> String {
    let about = &view.results.about;
    let fixed = [("program", &about.program), ("machine", &about.machine), ("display curve", &about.curve)];
    let mut rows: Vec<(String, String)> = fixed.map(|(name, value)| (name.to_owned(), value.clone())).into();
    rows.extend(about.lpips.iter().map(|networks| ("LPIPS".to_owned(), networks.clone())));
    rows.extend(about.settings.iter().filter(|(_, value)| !is_object(value)).cloned());
    let long: Vec<_> = about.settings.iter().filter(|(_, value)| is_object(value)).cloned().collect();
    let mut out = html::facts(&rows);
    if !long.is_empty() {
        out += &format!("<details><summary>Headers of the networks</summary>\n{}</details>\n", html::facts(&long));
    }
    out
}

/// Whether a setting is a JSON object, which few want to read.
fn is_object(value: &str) -> bool {
    value.starts_with('{') && value.ends_with('}')
}
