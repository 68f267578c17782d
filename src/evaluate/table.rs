//! Means over frames and sequences, and the table that is printed.

use crate::evaluate::{Evaluation, Method, Score};
use serde::Serialize;

/// Mean of one method. PSNR, SSIM and LPIPS are means over frames; keyframes themselves never count.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// The method.
    pub method: Method,
    /// Frames counted.
    pub frames: usize,
    /// dB, pixels with coverage.
    pub psnr: f64,
    /// dB, full frame.
    pub psnr_full: f64,
    /// Full frame.
    pub ssim: Option<f64>,
    /// LPIPS (AlexNet).
    pub lpips: Option<f64>,
    /// Median wall seconds a frame.
    pub seconds: f64,
}

/// Rows in the order methods first appear. All methods are averaged over the same frames: those that are no keyframes
/// (or all frames, where every frame is a keyframe).
pub fn rows(evaluations: &[Evaluation]) -> Vec<Row> {
    let all: Vec<&Score> = evaluations.iter().flat_map(|e| &e.scores).collect();
    let only_keys = all.iter().all(|s| s.key);
    let mut methods: Vec<Method> = Vec::new();
    for score in &all {
        if !methods.contains(&score.method) {
            methods.push(score.method);
        }
    }
    methods
        .into_iter()
        .filter_map(|method| {
            let scores: Vec<&Score> = all.iter().copied().filter(|s| s.method == method && (only_keys || !s.key)).collect();
            if scores.is_empty() {
                return None;
            }
            Some(Row {
                method,
                frames: scores.len(),
                psnr: mean(scores.iter().filter_map(|s| s.psnr))?,
                psnr_full: mean(scores.iter().map(|s| s.psnr_full))?,
                ssim: mean(scores.iter().filter_map(|s| s.ssim)),
                lpips: mean(scores.iter().filter_map(|s| s.lpips)),
                seconds: median(scores.iter().map(|s| s.seconds).collect()),
            })
        })
        .collect()
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0usize), |(s, n), v| (s + v, n + 1));
    (count > 0).then(|| sum / count as f64)
}

/// Median; NaN for nothing.
pub fn median(mut values: Vec<f64>) -> f64 {
    values.retain(|v| v.is_finite());
    values.sort_by(f64::total_cmp);
    if values.is_empty() { f64::NAN } else { 0.5 * (values[(values.len() - 1) / 2] + values[values.len() / 2]) }
}

/// A missing value as `n/a`.
pub fn optional(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "n/a".into(), |v| format!("{v:.digits$}"))
}

/// The table as Markdown; `truth` is the samples a pixel and the median seconds of the reference itself.
pub fn print(rows: &[Row], truth: Option<(u32, f64)>) -> String {
    let mut text = format!(
        "| {:<30} | {:>9} | {:>9} | {:>6} | {:>6} | {:>9} |\n|{}|\n",
        "method",
        "PSNR dB",
        "full dB",
        "SSIM",
        "LPIPS",
        "s/frame",
        [32, 11, 11, 8, 8, 11].map(|n| "-".repeat(n)).join("|")
    );
    for row in rows {
        text += &format!(
            "| {:<30} | {:>9.2} | {:>9.2} | {:>6} | {:>6} | {:>9.3} |\n",
            row.method.label(),
            row.psnr,
            row.psnr_full,
            optional(row.ssim, 4),
            optional(row.lpips, 4),
            row.seconds
        );
    }
    if let Some((spp, seconds)) = truth {
        let name = format!("truth: path traced, {spp} spp");
        text += &format!("| {name:<30} | {:>9} | {:>9} | {:>6} | {:>6} | {seconds:>9.3} |\n", "-", "-", "-", "-");
    }
    text
}
