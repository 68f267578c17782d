//! Tables and plots of a measurement.

use super::results::{Row, SceneResult, reached, three};
use super::{GOAL, Method};
use crate::Machine;
use renderflow::metrics::median;
use renderflow::metrics::relmse::RelMse;
use renderflow::report::plot::{self, COLORS, Level, Line, Plot, Point, Scale};
use renderflow_renderer::Stats;

/// Rays of all kinds.
fn rays(stats: &Stats) -> u64 {
    stats.camera_rays + stats.bounce_rays + stats.shadow_rays
}

/// One line a scene, method and number of samples.
pub(super) fn table(scenes: &[&SceneResult]) -> String {
    let width = scenes.iter().map(|s| s.name.len()).max().unwrap_or(0).max(5);
    let mut text = format!(
        "{:width$}  {:8}  {:>5}  {:>8}  {:>8}  {:>7}  {:>7}  {:>9}  {:>9}  {:>9}  {:>9}  {:>8}  {:>8}  {:>6}  {:>6}\n",
        "scene",
        "method",
        "spp",
        "seconds",
        "cpu s",
        "Msamp/s",
        "Mrays/s",
        "relMSE",
        "99 % trim",
        "99.9 clip",
        "median",
        "x spp",
        "x cpu s",
        "PSNR",
        "SSIM"
    );
    for scene in scenes {
        for row in &scene.rows {
            let error = row.relmse();
            let ssim = row.runs.iter().map(|r| r.displayed.ssim).sum::<Option<f64>>().map(|sum| sum / row.runs.len() as f64);
            text += &format!(
                "{:width$}  {:8}  {:>5}  {:>8}  {:>8}  {:>7.2}  {:>7.2}  {:>9.2e}  {:>9.2e}  {:>9.2e}  {:>9.2e}  {:>8.3}  {:>8}  {:>6.2}  {:>6}\n",
                scene.name,
                row.method.name(),
                row.spp,
                three(row.seconds()),
                row.processor().map_or_else(|| "-".into(), three),
                row.rate(|s| s.samples),
                row.rate(rays),
                error.mean,
                error.trimmed,
                error.clipped,
                error.median,
                row.per_sample(),
                row.processor().map_or_else(|| "-".into(), |s| three(error.mean * s)),
                row.mean(|r| r.displayed.psnr),
                ssim.map_or_else(|| "-".into(), |s| format!("{s:.4}")),
            );
        }
    }
    text
}

/// Seconds to the goal of every scene and method, and what they follow from.
pub(super) fn summary(scenes: &[&SceneResult]) -> String {
    let width = scenes.iter().map(|s| s.name.len()).max().unwrap_or(0).max(5);
    let mut text = format!(
        "{:width$}  {:8}  {:>10}  {:>9}  {:>13}  {:>14}  {:>12}  {:>7}  {:>15}\n",
        "scene", "method", "triangles", "compile s", "s to relMSE", "99 % trimmed", "relMSE x spp", "Msamp/s", "reference noise"
    );
    text += &format!("{:width$}  {:8}  {:>10}  {:>9}  {:>13}  {:>14}\n", "", "", "", "", GOAL, GOAL);
    for scene in scenes {
        let mut methods: Vec<Method> = Vec::new();
        for row in &scene.rows {
            if !methods.contains(&row.method) {
                methods.push(row.method);
            }
        }
        for method in methods {
            let to_goal = |form: fn(&RelMse) -> f64| {
                let points: Vec<(f64, f64)> = scene.of(method).map(|row| (row.seconds(), form(&row.relmse()))).collect();
                reached(&points, GOAL).map_or_else(String::new, |r| r.to_string())
            };
            // Of the upper half of the rows, where start-up does not count.
            let rows: Vec<&Row> = scene.of(method).collect();
            let upper = &rows[rows.len() / 2..];
            let middle = |value: &dyn Fn(&Row) -> f64| median(&upper.iter().map(|row| value(row)).collect::<Vec<_>>());
            text += &format!(
                "{:width$}  {:8}  {:>10}  {:>9}  {:>13}  {:>14}  {:>12.3}  {:>7.2}  {:>15.1e}\n",
                scene.name,
                method.name(),
                scene.triangles,
                three(scene.compile.seconds),
                to_goal(|e| e.mean),
                to_goal(|e| e.trimmed),
                middle(&Row::per_sample),
                middle(&|row| row.rate(|s| s.samples)),
                scene.reference_noise,
            );
        }
    }
    text
}

/// Error over time, one curve a scene and method.
pub(super) fn picture(scenes: &[&SceneResult], machine: &Machine, form: fn(&RelMse) -> f64, title: &str) -> String {
    let mut lines: Vec<Line> = Vec::new();
    for (number, scene) in scenes.iter().enumerate() {
        for row in &scene.rows {
            let legend = format!("{}, {}", scene.name, row.method.name());
            let point = Point { at: (row.seconds(), form(&row.relmse())), ..Point::default() };
            match lines.iter_mut().find(|line| line.legend == legend) {
                Some(line) => line.points.push(point),
                None => {
                    // The lines of adaptive samples are dashed.
                    let color = number % COLORS + if row.method == Method::Adaptive { COLORS } else { 0 };
                    lines.push(Line { color, joined: true, legend, named: true, points: vec![point], ..Line::default() });
                }
            }
        }
    }
    plot::file(&Plot {
        title: "Error against time, samples doubling from point to point",
        x: (&format!("seconds on {} threads of {}", machine.threads, machine.processor), Scale::Log),
        y: (title, Scale::Log),
        lines,
        levels: vec![Level { name: format!("{GOAL}"), named: true, color: 6, y: GOAL }],
        marks: Vec::new(),
        size: (980.0, 560.0),
    })
}
