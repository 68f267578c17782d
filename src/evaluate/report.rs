//! The report: one HTML file with the table, the curve over frames, pictures side by side with error maps, and the settings.

use crate::evaluate::table::{Row, optional};
use crate::evaluate::{Evaluation, Method};
use crate::report::picture::{self, ERROR_GAIN};
pub use crate::report::picture::{error_map, png};
use anyhow::Result;
use renderflow_frame::image::Rgb;
use std::fmt::Write;

const PALETTE: [&str; 8] = ["#4e79a7", "#f28e2b", "#76b7b2", "#e15759", "#59a14f", "#b07aa1", "#9c755f", "#edc948"];

/// Pictures of one frame, display values.
pub struct FramePictures {
    /// Frame index.
    pub frame: usize,
    /// Path-traced truth.
    pub truth: Rgb,
    /// A picture a method.
    pub methods: Vec<(Method, Rgb)>,
}

/// Everything the page shows.
pub struct Report<'a> {
    /// Heading.
    pub title: &'a str,
    /// The printed table, as rows.
    pub rows: &'a [Row],
    /// Last row: what the truth cost.
    pub truth: (u32, f64),
    /// Per-frame scores of one sequence, for the curve.
    pub evaluation: &'a Evaluation,
    /// Pictures to show.
    pub pictures: &'a [FramePictures],
    /// Name and value of every setting.
    pub settings: &'a [(String, String)],
}

/// Renders the page.
pub fn html(report: &Report) -> Result<String> {
    let mut page = String::new();
    let title = escape(report.title);
    write!(
        page,
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width,initial-scale=1\">\
         <title>{title}</title><style>{STYLE}</style><h1>{title}</h1>"
    )?;
    table(&mut page, report)?;
    curve(&mut page, report.evaluation)?;
    for pictures in report.pictures {
        frame(&mut page, pictures)?;
    }
    page += "<h2>Settings</h2><table class=\"settings\">";
    for (name, value) in report.settings {
        write!(page, "<tr><th>{}</th><td>{}</td></tr>", escape(name), escape(value))?;
    }
    page += "</table></html>";
    Ok(page)
}

fn table(page: &mut String, report: &Report) -> Result<()> {
    *page +=
        "<table><tr><th>method</th><th>PSNR (dB)</th><th>full frame (dB)</th><th>SSIM</th><th>LPIPS</th><th>s / frame</th></tr>";
    for row in report.rows {
        write!(
            page,
            "<tr><td>{}</td><td>{:.2}</td><td>{:.2}</td><td>{}</td><td>{}</td><td>{:.3}</td></tr>",
            escape(&row.method.label()),
            row.psnr,
            row.psnr_full,
            optional(row.ssim, 4),
            optional(row.lpips, 4),
            row.seconds
        )?;
    }
    let (spp, seconds) = report.truth;
    write!(
        page,
        "<tr><td>truth: path traced, {spp} spp</td><td>-</td><td>-</td><td>-</td><td>-</td><td>{seconds:.3}</td></tr></table>\
         <p>Mean over frames that are not keyframes. PSNR counts pixels an object covers; SSIM and LPIPS the full frame. \
         Metrics are computed on sRGB of the clamped, exposed radiance. Keyframe rows read the truth of the keyframes.</p>"
    )?;
    Ok(())
}

/// PSNR over the frames of the sequence, one line a method.
fn curve(page: &mut String, evaluation: &Evaluation) -> Result<()> {
    let (width, height, left, bottom) = (720.0, 260.0, 46.0, 28.0);
    let finite: Vec<(Method, usize, f64)> = evaluation
        .scores
        .iter()
        .filter(|s| !s.key)
        .filter_map(|s| Some((s.method, s.frame, s.psnr?)))
        .filter(|s| s.2.is_finite())
        .collect();
    let Some(last) = finite.iter().map(|s| s.1).max() else { return Ok(()) };
    let low = finite.iter().map(|s| s.2).fold(f64::INFINITY, f64::min).floor() - 1.0;
    let high = finite.iter().map(|s| s.2).fold(0.0, f64::max).ceil() + 1.0;
    let x = |frame: usize| left + (width - left - 10.0) * frame as f64 / last.max(1) as f64;
    let y = |psnr: f64| (height - bottom - 12.0) * (high - psnr) / (high - low) + 12.0;
    write!(
        page,
        "<h2>PSNR over the sequence</h2><svg viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"PSNR a frame\">"
    )?;
    for step in 0..=4 {
        let value = low + (high - low) * f64::from(step) / 4.0;
        write!(
            page,
            "<line x1=\"{left}\" x2=\"{}\" y1=\"{1:.1}\" y2=\"{1:.1}\" stroke=\"#8884\"/><text x=\"2\" y=\"{2:.1}\">{value:.1}</text>",
            width - 10.0,
            y(value),
            y(value) + 4.0
        )?;
    }
    write!(page, "<text x=\"{}\" y=\"{}\">frame 0 to {last}</text>", left, height - 6.0)?;
    let mut methods: Vec<Method> = Vec::new();
    for (method, ..) in &finite {
        if !methods.contains(method) {
            methods.push(*method);
        }
    }
    for (i, method) in methods.iter().enumerate() {
        let points: Vec<String> =
            finite.iter().filter(|s| s.0 == *method).map(|s| format!("{:.1},{:.1}", x(s.1), y(s.2))).collect();
        let color = PALETTE[i % PALETTE.len()];
        write!(page, "<polyline fill=\"none\" stroke=\"{color}\" stroke-width=\"2\" points=\"{}\"/>", points.join(" "))?;
    }
    *page += "</svg><p class=\"legend\">";
    for (i, method) in methods.iter().enumerate() {
        write!(page, "<span style=\"color:{}\">&#9632;</span> {} &nbsp; ", PALETTE[i % PALETTE.len()], escape(&method.label()))?;
    }
    *page += "</p>";
    Ok(())
}

fn frame(page: &mut String, pictures: &FramePictures) -> Result<()> {
    write!(
        page,
        "<h2>Frame {}</h2><p>Below each picture: |difference to truth|, times {ERROR_GAIN}.</p><div class=\"row\">",
        pictures.frame
    )?;
    let figure = |page: &mut String, label: &str, image: &Rgb, error: Option<Rgb>| -> Result<()> {
        write!(page, "<figure><img alt=\"{0}\" src=\"{1}\">", escape(label), data_url(image)?)?;
        if let Some(error) = error {
            write!(page, "<img alt=\"error of {}\" src=\"{}\">", escape(label), data_url(&error)?)?;
        }
        write!(page, "<figcaption>{}</figcaption></figure>", escape(label))?;
        Ok(())
    };
    figure(page, "truth", &pictures.truth, None)?;
    for (method, picture) in &pictures.methods {
        figure(page, &method.label(), picture, Some(error_map(picture, &pictures.truth)))?;
    }
    *page += "</div>";
    Ok(())
}

/// The pictures of a frame side by side, truth first; below each its error map.
pub fn montage(pictures: &FramePictures) -> Rgb {
    crate::report::picture::montage(&pictures.truth, pictures.methods.iter().map(|(_, picture)| picture))
}

fn data_url(image: &Rgb) -> Result<String> {
    Ok(picture::data_url(&png(image)?))
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

const STYLE: &str = "body{font:15px/1.5 system-ui,sans-serif;margin:2em auto;max-width:1200px;padding:0 1em;background:#fff;color:#111}\
table{border-collapse:collapse}td,th{border:1px solid #8886;padding:.3em .7em;text-align:right}td:first-child,th:first-child{text-align:left}\
.settings td,.settings th{text-align:left}.row{display:flex;flex-wrap:wrap;gap:12px}figure{margin:0;width:256px}\
img{width:100%;display:block;margin-bottom:4px;image-rendering:pixelated}figcaption{font-size:13px}svg{max-width:760px;width:100%}\
svg text{font-size:11px;fill:currentColor}@media(prefers-color-scheme:dark){body{background:#161616;color:#ddd}}";
