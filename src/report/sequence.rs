//! The page of a sequence: its table, its frames, and pictures to compare.

use super::html::{self, escape};
use super::table::Filter;
use super::{View, charts, style};
use crate::evaluate::results::{Group, Scored, TRUTH, picture_file};
use crate::util::picture;
use crate::util::text::plural;
use anyhow::Result;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::Write;

/// A page may hold this many bytes of picture files; in base64 they become 40 MB, which a phone can still open.
const LARGEST: usize = 30_000_000;

/// The data that the page's script reads.
#[derive(Serialize)]
struct Data {
    width: usize,
    height: usize,
    /// Numbers of the frames with pictures.
    frames: Vec<usize>,
    /// Numbers of keyframes.
    keyframes: Vec<usize>,
    /// Ids and labels, the truth first.
    methods: Vec<(String, String)>,
    /// Base64 of PNG files, by frame and method.
    pictures: BTreeMap<usize, BTreeMap<String, String>>,
    /// PSNR as it is written below a picture, by frame and method.
    psnr: BTreeMap<usize, BTreeMap<String, String>>,
}

/// The whole page of sequence number `number`.
pub(super) fn html(view: &View, number: usize) -> Result<String> {
    let scored = &view.results.sequences[number];
    let about = &scored.about;
    let (data, left_out) = collect(view, scored)?;
    let title = format!("{} - {}", about.name, view.results.about.title);
    let mut body = format!(
        "<header>\n{}<h1>{}</h1>\n<p>Test set: {}. Kind of scene: {}. {} of {} x {} pixels, {} among them.</p></header>\n<main>\n",
        links(view, number),
        escape(&about.name),
        escape(&about.set),
        escape(&about.class),
        plural(about.frames.len(), "frame"),
        about.width,
        about.height,
        plural(about.keyframes.len(), "keyframe")
    );
    body += &comparison(view, &data, scored, left_out)?;
    let filter = Filter { set: Some(&about.set), class: Some(&about.class), name: Some(&about.name), ..Filter::default() };
    body +=
        "<section><h2>Scores</h2>\n<p>Means over the frames that are no keyframes (over all, where every frame is one).</p>\n";
    body += &style::main_table(&view.palette, &format!("{}: scores", about.name), &view.means.rows(filter), 1);
    body += "</section>\n";
    let plots = charts::frames(view, number);
    if !plots.is_empty() {
        body += "<section id=\"curves\"><h2>Over the frames</h2>\n<p>Triangles at the foot mark keyframes, the upright line the frame \
                 shown above; a click goes to the nearest frame that has pictures. Where a keyframe's picture is the truth itself it has no point.</p>\n";
        body += &html::chooser("Metric", &plots);
        body += "</section>\n";
    }
    write!(body, "<section><h2>Facts</h2>\n{}</section>\n</main>\n", facts(scored))?;
    writeln!(body, "<script type=\"application/json\" id=\"data\">{}</script>", html::json(&data)?)?;
    // The frame of the page adds about 20 kB, which does not change the first digit after the point.
    let size = format!("{:.1}", (body.len() as f64 + 20e3) / 1e6);
    body = body.replacen(PAGE_SIZE, &size, 1);
    Ok(html::page(&title, &body))
}

/// Stands for the page's size until that is known. It is a control character, which no escaped text holds.
const PAGE_SIZE: &str = "\u{1}";

/// Links to the index and to the neighbours.
fn links(view: &View, number: usize) -> String {
    let mut out = String::from("<nav aria-label=\"Pages\"><a href=\"index.html\">All sequences</a>");
    let neighbours = [(number.checked_sub(1), "Previous"), (Some(number + 1), "Next")];
    for (other, name) in neighbours {
        if let Some(page) = other.and_then(|other| view.pages.get(other)) {
            out += &format!(" <a href=\"{page}\">{name}</a>");
        }
    }
    out + "</nav>\n"
}

/// The pictures of the shown frames, or of every n-th of them where all would be too many; and the number of frames left out.
fn collect(view: &View, scored: &Scored) -> Result<(Data, usize)> {
    let about = &scored.about;
    let labels = view.results.about.methods.iter().map(|method| (method.id.clone(), method.label.clone()));
    let methods: Vec<(String, String)> = std::iter::once((TRUTH.to_owned(), "Truth".to_owned())).chain(labels).collect();
    let path = |frame: usize, id: &str| scored.pictures.join(picture_file(frame, id));
    let bytes = |frame: usize| -> usize {
        let sizes = methods.iter().filter_map(|(id, _)| std::fs::metadata(path(frame, id)).ok());
        sizes.map(|file| file.len() as usize).sum()
    };
    let sizes: Vec<(usize, usize)> =
        about.shown.iter().map(|frame| (*frame, bytes(*frame))).filter(|(_, size)| *size > 0).collect();
    let kept = kept_frames(&sizes);
    let left_out = sizes.len() - kept.len();
    let mut pictures: BTreeMap<usize, BTreeMap<String, String>> = BTreeMap::new();
    for frame in &kept {
        for (id, _) in &methods {
            if let Some(bytes) = picture::read(&path(*frame, id))? {
                pictures.entry(*frame).or_default().insert(id.clone(), picture::base64(&bytes));
            }
        }
    }
    let present = |id: &str| pictures.values().any(|of_frame| of_frame.contains_key(id));
    let methods = methods.into_iter().filter(|(id, _)| present(id)).collect();
    let mut psnr: BTreeMap<usize, BTreeMap<String, String>> = BTreeMap::new();
    for score in scored.scores.iter().filter(|score| kept.contains(&score.frame)) {
        if let Some(value) = score.values.get("psnr").filter(|value| value.is_finite()) {
            psnr.entry(score.frame).or_default().insert(score.method.clone(), format!("{value:.2} dB"));
        }
    }
    Ok((
        Data {
            width: about.width,
            height: about.height,
            frames: kept,
            keyframes: about.keyframes.clone(),
            methods,
            pictures,
            psnr,
        },
        left_out,
    ))
}

/// Every n-th frame, for the smallest n with which the bytes fit; at least one frame.
fn kept_frames(frames: &[(usize, usize)]) -> Vec<usize> {
    let every = |n: usize| frames.iter().step_by(n);
    let fits = |n: &usize| every(*n).map(|(_, bytes)| bytes).sum::<usize>() <= LARGEST;
    let n = (1..frames.len().max(1)).find(fits).unwrap_or(frames.len().max(1));
    every(n).map(|(frame, _)| *frame).collect()
}

fn comparison(view: &View, data: &Data, scored: &Scored, left_out: usize) -> Result<String> {
    let mut out = String::from(
        "<section id=\"compare\"><h2>Pictures</h2>\n<noscript><p>A script shows the pictures; it is part of this page.</p></noscript>\n",
    );
    if data.frames.is_empty() {
        return Ok(out + "<p>No pictures were kept.</p></section>\n");
    }
    let options = |wanted: usize| {
        let option = |(number, (id, label)): (usize, &(String, String))| {
            let selected = if number == wanted.min(data.methods.len() - 1) { " selected" } else { "" };
            format!("<option value=\"{}\"{selected}>{}</option>", escape(id), escape(label))
        };
        data.methods.iter().enumerate().map(option).collect::<String>()
    };
    let about = &scored.about;
    let last = data.frames.len() - 1;
    // A frame that is not a keyframe shows more.
    let first = data.frames.iter().position(|frame| !about.keyframes.contains(frame)).unwrap_or(0);
    let neural = |id: &str| view.results.about.methods.iter().any(|method| method.id == id && method.group == Group::Neural);
    let right = data.methods.iter().position(|(id, _)| neural(id)).unwrap_or(1);
    write!(
        out,
        "<div class=\"controls\">\n<label>Left <select id=\"left\">{}</select></label>\n<label>Right <select id=\"right\">{}</select></label>\n\
         <label>Zoom <select id=\"zoom\"><option value=\"0\">fit</option><option value=\"1\">1x</option><option value=\"2\">2x</option>\
         <option value=\"4\">4x</option></select></label>\n\
         <label class=\"check\"><input type=\"checkbox\" id=\"error\"> Error map</label>\n\
         <label>times <select id=\"gain\"><option>1</option><option selected>4</option><option>16</option></select></label>\n</div>\n",
        options(0),
        options(right)
    )?;
    write!(
        out,
        "<div class=\"viewport\" role=\"region\" tabindex=\"0\" aria-label=\"Pictures compared\"><div id=\"stage\" data-width=\"{0}\" data-height=\"{1}\">\n\
         <img id=\"right-picture\" alt=\"right picture\" draggable=\"false\"><canvas id=\"right-error\" hidden></canvas>\n\
         <div id=\"left-half\"><img id=\"left-picture\" alt=\"left picture\" draggable=\"false\"><canvas id=\"left-error\" hidden></canvas></div>\n\
         <div id=\"grip\" aria-hidden=\"true\"></div><span id=\"left-name\" class=\"side\"></span><span id=\"right-name\" class=\"side\"></span></div></div>\n\
         <div class=\"controls wide\"><label>Divide <input type=\"range\" id=\"divide\" min=\"0\" max=\"100\" step=\"1\" value=\"50\" \
         aria-label=\"Divide between left and right picture\"></label>\n\
         <label>Frame <input type=\"range\" id=\"frame\" min=\"0\" max=\"{last}\" step=\"1\" value=\"{first}\" aria-label=\"Frame\"></label> \
         <output id=\"frame-number\" for=\"frame\"></output> <button type=\"button\" id=\"play\" aria-pressed=\"false\">Play</button></div>\n\
         <p id=\"readout\" class=\"quiet\">Point at the picture or touch it to read values (sRGB, 0 to 255).</p>\n",
        about.width, about.height
    )?;
    out += "<p class=\"quiet\">Choose what stands right by its small picture; with Shift, what stands left.</p>\n<ul class=\"strip\">\n";
    for (id, label) in &data.methods {
        writeln!(
            out,
            "<li><button type=\"button\" data-method=\"{}\"><img alt=\"\"><span>{}</span> <small></small></button></li>",
            escape(id),
            escape(label)
        )?;
    }
    let thinned = match left_out {
        0 => String::new(),
        n => format!(
            " Pictures of {} are left out to keep the page small; they lie in the results folder.",
            plural(n, "more frame")
        ),
    };
    write!(
        out,
        "</ul>\n<p class=\"quiet\">Error maps show the mean absolute difference to the truth over red, green and blue, times the number chosen, \
         from black over red and yellow to white. Pictures are PNG as evaluated, rounded to 8 bits. This page has {PAGE_SIZE} MB.{thinned}</p>\n</section>\n"
    )?;
    Ok(out)
}

fn facts(scored: &Scored) -> String {
    let about = &scored.about;
    let mut rows = about.facts.clone();
    rows.push(("exposure".into(), format!("{}", about.exposure)));
    rows.push(("truth".into(), format!("{} per pixel", plural(about.truth.spp, "sample"))));
    let known = |value: Option<f64>| value.filter(|value| value.is_finite());
    rows.extend(known(about.truth.seconds).map(|s| ("truth, seconds a frame".into(), super::table::seconds(s))));
    let share =
        known(about.truth_share()).map(|s| ("truth of the keyframes, seconds per frame".into(), super::table::seconds(s)));
    rows.extend(share);
    rows.extend(known(about.truth.noise).map(|n| ("noise of the raw truth".into(), format!("{n:.2} dB"))));
    rows.extend(known(about.truth.error).map(|e| ("error of the truth".into(), format!("{e:.2} dB"))));
    for (what, seconds) in &about.once {
        rows.push((format!("once a sequence: {what}"), format!("{} s", super::table::seconds(*seconds))));
    }
    html::facts(&rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_thinned_evenly() {
        assert_eq!(kept_frames(&[(3, 10), (5, 10), (9, 10)]), [3, 5, 9]);
        let big = LARGEST / 2;
        assert_eq!(kept_frames(&[(0, big), (1, big), (2, big), (3, big)]), [0, 2]);
        assert_eq!(kept_frames(&[(0, LARGEST + 1), (1, 1)]), [0]);
        assert_eq!(kept_frames(&[]), [0; 0]);
    }
}
