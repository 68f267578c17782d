//! The page about a dataset: bars of its families and histograms of its pixels.

use super::html::escape;
use crate::dataset::log::Costs;
use crate::dataset::stats::{Bars, Numbers};
use crate::util::output::GENERATOR;
use crate::util::picture;
use crate::util::text::plural;
use anyhow::Result;
use std::fmt::Write;

/// The page about the dataset `name`, with the PNG files `pictures` and their names; it needs no other files.
pub fn page(name: &str, numbers: &Numbers, costs: &Costs, pictures: &[(String, Vec<u8>)]) -> Result<String> {
    let title = escape(&format!("Dataset {name}"));
    let mut page = String::new();
    let [complete, planned] = numbers.sequences;
    write!(
        page,
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\">{GENERATOR}<meta name=\"viewport\" content=\"width=device-width,initial-scale=1\">\
         <title>{title}</title><style>{STYLE}</style><h1>{title}</h1><p>{complete} of {}, {}, {:.1} MiB \
         ({:.0} bytes per frame); {}, {}, {}; {} shared by splits.</p>",
        plural(planned, "sequence"),
        plural(numbers.frames, "frame"),
        numbers.bytes as f64 / f64::from(1 << 20),
        numbers.bytes as f64 / numbers.frames.max(1) as f64,
        plural(numbers.scenes, "distinct scene"),
        plural(numbers.meshes, "distinct mesh"),
        plural(numbers.environments, "distinct environment"),
        plural(numbers.leaks.len(), "thing")
    )?;
    for leak in &numbers.leaks {
        write!(page, "<p class=\"leak\">{}</p>", escape(leak))?;
    }
    if costs.frames > 0 {
        let [compile, render, denoise, write] = costs.stages;
        write!(
            page,
            "<p>{} made in {:.1} s, {:.3} per second; one frame takes compile {compile:.3}, render {render:.3}, denoise {denoise:.3}, \
             write {write:.3} s; memory at most {:.0} MiB; {}.</p>",
            plural(costs.frames, "frame"),
            costs.wall,
            costs.frames as f64 / costs.wall.max(1e-9),
            costs.peak,
            plural(costs.failures, "failure")
        )?;
    }
    if !pictures.is_empty() {
        page += "<h2>First frames of some sequences</h2><div class=\"all pictures\">";
        for (place, png) in pictures {
            let (place, url) = (escape(place), picture::data_url(png));
            write!(page, "<figure><img alt=\"first frame of {place}\" src=\"{url}\"><figcaption>{place}</figcaption></figure>")?;
        }
        page += "</div>";
    }
    page += "<h2>Pixels</h2><div class=\"all\">";
    for bars in &numbers.histograms {
        upright(&mut page, bars)?;
    }
    page += "</div><h2>Sequences and objects</h2><div class=\"all\">";
    for bars in std::iter::once(&numbers.splits).chain(&numbers.counts) {
        lying(&mut page, bars)?;
    }
    page += "</div></html>";
    Ok(page)
}

const STYLE: &str = "body{font:15px/1.45 system-ui,sans-serif;margin:1.5rem auto;max-width:78rem;padding:0 1rem;color:#222}\
.all{display:flex;flex-wrap:wrap;gap:1.2rem}figure{margin:0;flex:1 1 22rem;max-width:38rem}figcaption{font-weight:600}\
svg{width:100%;height:auto}rect{fill:#4e79a7}text{font:10px system-ui,sans-serif;fill:#333}.leak{color:#b00020}\
.pictures figure{flex:none}.pictures img{display:block;max-width:100%}.pictures figcaption{font-weight:400}";

/// Draws many bars side by side, and labels a few of them.
fn upright(page: &mut String, bars: &Bars) -> Result<()> {
    let (width, height) = (400.0, 130.0);
    let most = bars.bars.iter().map(|bar| bar.1).max().unwrap_or(0).max(1) as f64;
    let step = width / bars.bars.len().max(1) as f64;
    write!(
        page,
        "<figure><figcaption>{}</figcaption><svg viewBox=\"0 0 {width} {}\" role=\"img\">",
        escape(&bars.title),
        height + 16.0
    )?;
    for (i, (label, count)) in bars.bars.iter().enumerate() {
        let tall = height * *count as f64 / most;
        let (x, y) = (i as f64 * step, height - tall);
        write!(
            page,
            "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{:.1}\" height=\"{tall:.1}\"><title>from {}: {count}</title></rect>",
            step - 1.0,
            escape(label)
        )?;
        if i.is_multiple_of(bars.bars.len().div_ceil(8)) {
            write!(page, "<text x=\"{x:.1}\" y=\"{}\">{}</text>", height + 12.0, escape(label))?;
        }
    }
    page.push_str("</svg></figure>");
    Ok(())
}

/// Draws one bar in each line, with its label.
fn lying(page: &mut String, bars: &Bars) -> Result<()> {
    let most = bars.bars.iter().map(|bar| bar.1).max().unwrap_or(0).max(1) as f64;
    write!(
        page,
        "<figure><figcaption>{}</figcaption><svg viewBox=\"0 0 400 {}\" role=\"img\">",
        escape(&bars.title),
        15 * bars.bars.len()
    )?;
    for (i, (label, count)) in bars.bars.iter().enumerate() {
        let y = 15 * i;
        write!(
            page,
            "<text x=\"0\" y=\"{}\">{}</text><rect x=\"150\" y=\"{}\" width=\"{:.1}\" height=\"12\"/><text x=\"{:.1}\" y=\"{}\">{count}</text>",
            y + 11,
            escape(label),
            y + 1,
            200.0 * *count as f64 / most,
            154.0 + 200.0 * *count as f64 / most,
            y + 11
        )?;
    }
    page.push_str("</svg></figure>");
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::stats::Bars;

    #[test]
    fn the_page_has_a_title_and_pictures() {
        let none = || Bars { title: String::new(), bars: Vec::new() };
        let numbers = Numbers {
            sequences: [1, 2],
            frames: 3,
            bytes: 4,
            meshes: 5,
            scenes: 1,
            environments: 1,
            leaks: Vec::new(),
            splits: none(),
            counts: Vec::new(),
            histograms: Vec::new(),
        };
        let page = page("a<b", &numbers, &Costs::default(), &[("train/seq-000000".into(), b"png".to_vec())]).unwrap();
        assert!(page.contains("<title>Dataset a&lt;b</title>") && page.contains("<h1>Dataset a&lt;b</h1>"));
        assert!(page.contains("data:image/png;base64,cG5n") && page.contains("<figcaption>train/seq-000000</figcaption>"));
    }
}
