//! What several runs, and a long sequence, show: whether pictures are the same again, and whether errors add up.

use super::lab::{Ask, Lab};
use super::scale::{Data, Keys, Run};
use super::sheet::{Row, Table};
use crate::evaluate::method::Method;
use crate::evaluate::renderer::{self, Drawing, MethodRenderer};
use crate::evaluate::results::Results;
use crate::metrics::psnr::psnr;
use crate::report::plot::{self, Line, Plot, Point, Scale};
use crate::util::progress::Progress;
use crate::util::text::plural;
use anyhow::{Context, Result};
use renderflow_frame::{color, file};
use serde::{Deserialize, Serialize};

/// The runs of one method.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Runs {
    /// PSNR of each run, mean over its frames.
    psnr: Vec<f64>,
    /// Whether all runs gave the same bits.
    equal: bool,
}

/// The paper's figure on determinism: the same sequence several times, with another seed for the noise each time.
pub fn determinism(lab: &Lab) -> Result<Table> {
    let [runs, frames] = lab.scale.runs;
    let text = format!(
        "{} of {}, each with another seed. The paper reports no variance for RenderFlow, and a large one for the \
         baselines from noise, over 10 runs of 100 frames.",
        plural(runs, "run"),
        plural(frames, "frame")
    );
    let mut table = Table::new("Determinism", &text, &["psnr_full", "spread"]);
    table.heads = vec!["PSNR full".into(), "standard deviation over runs, dB".into()];
    let [stills, clips] = lab.scale.noisy_steps;
    let mut lines = Vec::new();
    let rows = [
        ("our network", None, "neural", 1),
        ("RenderFlow", Some(Run::Base), "wan", 1),
        ("single frames from noise (as RGB-X)", Some(Run::Noise { clips: false }), "wan-stills", stills),
        ("clips from noise (as DiffusionRenderer)", Some(Run::Noise { clips: true }), "wan", clips),
    ];
    for (number, (label, run, method, steps)) in rows.into_iter().enumerate() {
        let recipe = (method, lab.networks(run)?, steps, lab.scale.runs, lab.scale.plan(Data::Way)?);
        let made = lab.kept("determinism", &recipe, || repeat(lab, run, method, steps))?;
        let mean = made.psnr.iter().sum::<f64>() / made.psnr.len().max(1) as f64;
        let variance = made.psnr.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (made.psnr.len().max(2) - 1) as f64;
        let mut row = Row::named(label);
        row.set("psnr_full", mean);
        row.set("spread", variance.sqrt());
        row.note = if made.equal { "the same bits in every run" } else { "another picture in every run" }.into();
        table.add(row, if number == 1 { "no variance" } else { "" });
        let points =
            made.psnr.iter().enumerate().map(|(run, value)| Point { at: (run as f64 + 1.0, *value), ..Point::default() });
        lines.push(Line { color: number, joined: true, legend: label.into(), points: points.collect(), ..Line::default() });
    }
    picture(lab, &mut table, "determinism.svg", "PSNR of each run", ("run", Scale::Count), lines)?;
    Ok(table)
}

/// Renders the first frames of the long sequence several times.
fn repeat(lab: &Lab, run: Option<Run>, method: &str, steps: u32) -> Result<Runs> {
    let [runs, frames] = lab.scale.runs;
    let tests = lab.sequences(Data::Way, None)?;
    let sequence = &tests.first().context("no sequence")?.sequence;
    let methods = [Method::parse(method)?];
    let wan = run.map(|run| lab.renderer(run)).transpose()?;
    let progress = Progress::new(&format!("repeating {method}"), u64::from(runs * frames));
    let (mut values, mut digests) = (Vec::new(), Vec::new());
    for seed in 1..=u64::from(runs) {
        let options = renderer::Options {
            fusion: Some(lab.fusion),
            wan: wan.as_deref(),
            drawing: Drawing { steps, seed },
            timed: false,
            ..renderer::Options::new(&methods)
        };
        let mut renderer = MethodRenderer::new(sequence, &options)?;
        let (mut sum, mut digest) = (0.0, blake3::Hasher::new());
        for index in 0..frames as usize {
            lab.cancel.check()?;
            let made = renderer.render(index, lab.cancel)?;
            let made = &made.first().context("no picture")?.linear;
            made.pixels.iter().flatten().for_each(|value| _ = digest.update(&value.to_le_bytes()));
            let truth = sequence.frame(index)?.beauty.context("no beauty")?;
            let [made, truth] = [made, &truth].map(|picture| picture.map(|p| color::display(*p, sequence.exposure())));
            sum += psnr(&made, &truth);
            progress.add(1);
        }
        values.push(sum / f64::from(frames));
        digests.push(digest.finalize());
    }
    progress.finish();
    Ok(Runs { psnr: values, equal: digests.windows(2).all(|pair| pair[0] == pair[1]) })
}

/// Inference along a sequence of more than a hundred frames: whether pictures become worse.
pub fn progressive(lab: &Lab) -> Result<Table> {
    let mut table = Table::new(
        "A long sequence",
        "Each clip of RenderFlow begins with the picture that it made last. PSNR over the full frame at the beginning, in the middle and \
         at the end, and the slope of a straight line through all frames.",
        &["first", "middle", "last", "slope"],
    );
    let third = |part: &str| format!("PSNR, {part} third");
    table.heads = vec![third("first"), third("middle"), third("last"), "dB in 100 frames".into()];
    let ask = |methods| Ask { data: Data::Way, every: 1, ..lab.ask(methods) };
    let own = lab.measure(&ask(&["deferred", "neural", "neural+keys"]))?;
    let wan = lab.measure(&Ask { run: Some(Run::Base), ..ask(&["wan", "wan-stills"]) })?;
    let keys = lab.measure(&Ask { run: Some(Run::Keys(Keys::Whole)), ..ask(&["wan+keys"]) })?;
    let rows = [
        (&wan, "wan", "RenderFlow"),
        (&wan, "wan-stills", "RenderFlow, frame by frame"),
        (&keys, "wan+keys", "RenderFlow with keyframes"),
        (&own, "deferred", "Deferred"),
        (&own, "neural", "our network"),
        (&own, "neural+keys", "our network with keyframes"),
    ];
    let mut lines = Vec::new();
    for (number, (results, id, label)) in rows.into_iter().enumerate() {
        let frames = frames(results, id);
        let thirds: Vec<&[(f64, f64)]> = frames.chunks(frames.len().div_ceil(3).max(1)).collect();
        let mut row = Row::named(label);
        for (name, third) in ["first", "middle", "last"].into_iter().zip(thirds) {
            row.set(name, third.iter().map(|(_, value)| value).sum::<f64>() / third.len() as f64);
        }
        row.set("slope", 100.0 * slope(&frames));
        table.add(row, "");
        let points = frames.iter().map(|&at| Point { at, ..Point::default() }).collect();
        lines.push(Line { color: number, joined: true, legend: label.into(), points, ..Line::default() });
    }
    picture(lab, &mut table, "progressive.svg", "PSNR along a sequence", ("frame", Scale::Linear), lines)?;
    Ok(table)
}

/// PSNR of the frames of a method, by number, without keyframes where the method reads them.
fn frames(results: &Results, id: &str) -> Vec<(f64, f64)> {
    let reads = results.about.methods.iter().any(|method| method.id == id && method.reads_keyframes);
    let scores = results.sequences.iter().flat_map(|sequence| &sequence.scores);
    let of = scores.filter(|score| score.method == id && !(reads && score.key));
    of.filter_map(|score| Some((score.frame as f64, *score.values.get("psnr_full")?))).collect()
}

/// Slope of the line of least squares through points.
fn slope(points: &[(f64, f64)]) -> f64 {
    let count = points.len().max(1) as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| points.iter().map(of).sum::<f64>() / count;
    let (x, y) = (mean(|p| p.0), mean(|p| p.1));
    let squares: f64 = points.iter().map(|p| (p.0 - x).powi(2)).sum();
    if squares == 0.0 { 0.0 } else { points.iter().map(|p| (p.0 - x) * (p.1 - y)).sum::<f64>() / squares }
}

/// Writes a plot of PSNR, and puts it under the table.
fn picture(lab: &Lab, table: &mut Table, name: &str, title: &str, x: (&str, Scale), lines: Vec<Line>) -> Result<()> {
    let y = ("PSNR full, dB", Scale::Linear);
    let plot = Plot { title, x, y, lines, levels: Vec::new(), marks: Vec::new(), size: (760.0, 420.0) };
    file::write_atomic(&lab.out.join(name), plot::file(&plot).as_bytes())?;
    table.pictures.push(name.to_owned());
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slopes_are_those_of_lines() {
        let line: Vec<(f64, f64)> = (0..20).map(|i| (f64::from(i), 30.0 - 0.02 * f64::from(i))).collect();
        assert!((slope(&line) + 0.02).abs() < 1e-12);
        assert_eq!([slope(&[]), slope(&[(3.0, 4.0)])], [0.0; 2]);
    }
}
