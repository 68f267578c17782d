//! What the measured pictures add up to.

use super::contender::OURS;
use super::reference::Difference;
use renderflow::metrics::median;
use renderflow::metrics::relmse::RelMse;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt::Write;

/// One picture: who rendered it, how long that took, how wrong it is.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Row {
    /// Name of the scene.
    pub scene: String,
    /// Id of the renderer.
    pub renderer: String,
    /// Which of the repeats, from 0.
    pub repeat: u32,
    /// Samples a pixel.
    pub spp: u32,
    /// Wall seconds.
    pub wall: f64,
    /// Processor seconds, all threads.
    pub cpu: f64,
    /// Against the renderer's own reference.
    pub error: RelMse,
}

/// A renderer as results know it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Named {
    /// Id.
    pub id: String,
    /// As in tables.
    pub label: String,
    /// Version.
    pub version: String,
    /// Whose reference it is measured against.
    pub family: String,
}

/// A renderer at one number of samples: medians of the seconds of all repeats, means of their errors.
#[derive(Clone, Debug, Serialize)]
pub struct Point {
    pub spp: u32,
    pub wall: f64,
    pub cpu: f64,
    pub error: RelMse,
    /// Relative error times samples a pixel: constant for an estimator that converges as fast as independent samples.
    pub variance: f64,
    /// Million camera samples a wall second.
    pub msamples: f64,
}

/// Seconds to an error.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TimeTo {
    /// Wall, or processor over threads.
    pub seconds: f64,
    /// Whether that lies beyond what was measured, and is taken to be inversely proportional to the error there.
    pub extrapolated: bool,
}

/// A renderer on a scene.
#[derive(Clone, Debug, Serialize)]
pub struct Curve {
    pub scene: String,
    pub renderer: String,
    pub points: Vec<Point>,
    /// Wall seconds to the target.
    pub wall_to_target: Option<TimeTo>,
    /// Processor seconds to the target over the number of threads: what an idle machine would take at best.
    pub cpu_to_target: Option<TimeTo>,
    /// Our times to the target over this renderer's, by the id of ours: wall, processor.
    pub ours_over_this: BTreeMap<String, [f64; 2]>,
}

/// Everything known of one scene, in the order of `renderers`.
pub fn curves(scene: &str, pixels: usize, rows: &[Row], renderers: &[Named], target: f64, threads: usize) -> Vec<Curve> {
    let mut curves: Vec<Curve> = renderers
        .iter()
        .map(|renderer| {
            let points = points(scene, &renderer.id, pixels, rows);
            let to = |seconds: &dyn Fn(&Point) -> f64| {
                let curve: Vec<(f64, f64)> = points.iter().map(|p| (seconds(p), p.error.mean)).collect();
                time_to(&curve, target)
            };
            let (wall_to_target, cpu_to_target) = (to(&|p| p.wall), to(&|p| p.cpu / threads.max(1) as f64));
            let (scene, renderer) = (scene.to_owned(), renderer.id.clone());
            Curve { scene, renderer, points, wall_to_target, cpu_to_target, ours_over_this: BTreeMap::new() }
        })
        .filter(|curve| !curve.points.is_empty())
        .collect();
    let is_ours = |curve: &Curve| renderers.iter().any(|r| r.id == curve.renderer && r.family == OURS);
    let ours: Vec<Curve> = curves.iter().filter(|c| is_ours(c)).cloned().collect();
    for curve in curves.iter_mut().filter(|c| !is_ours(c)) {
        let ratio = |ours: Option<TimeTo>, theirs: Option<TimeTo>| Some(ours?.seconds / theirs?.seconds);
        for own in &ours {
            let (wall, cpu) = (ratio(own.wall_to_target, curve.wall_to_target), ratio(own.cpu_to_target, curve.cpu_to_target));
            curve.ours_over_this.extend(wall.zip(cpu).map(|(wall, cpu)| (own.renderer.clone(), [wall, cpu])));
        }
    }
    curves
}

fn points(scene: &str, renderer: &str, pixels: usize, rows: &[Row]) -> Vec<Point> {
    let mine = || rows.iter().filter(|r| r.scene == scene && r.renderer == renderer);
    let mut spps: Vec<u32> = mine().map(|r| r.spp).collect();
    spps.sort_unstable();
    spps.dedup();
    spps.into_iter()
        .map(|spp| {
            let all = |f: &dyn Fn(&Row) -> f64| mine().filter(|r| r.spp == spp).map(f).collect::<Vec<f64>>();
            let middle = |f: &dyn Fn(&Row) -> f64| median(&all(f));
            // A median would hide the repeats with fireflies, which are what the mean error consists of.
            let mean = |f: &dyn Fn(&Row) -> f64| all(f).iter().sum::<f64>() / all(f).len() as f64;
            let error = RelMse {
                mean: mean(&|r| r.error.mean),
                trimmed: mean(&|r| r.error.trimmed),
                clipped: mean(&|r| r.error.clipped),
                median: mean(&|r| r.error.median),
            };
            let (wall, cpu) = (middle(&|r| r.wall), middle(&|r| r.cpu));
            let msamples = 1e-6 * pixels as f64 * f64::from(spp) / wall.max(1e-9);
            Point { spp, wall, cpu, error, variance: error.mean * f64::from(spp), msamples }
        })
        .collect()
}

/// Seconds at which a measured curve of (seconds, error), in the order of samples, first falls to `target`: linear between its
/// points in the logarithms of both, inversely proportional beyond them. `None` without a point of positive error.
pub fn time_to(curve: &[(f64, f64)], target: f64) -> Option<TimeTo> {
    let known: Vec<(f64, f64)> = curve.iter().copied().filter(|(s, e)| *s > 0.0 && *e > 0.0).collect();
    for pair in known.windows(2) {
        let [(s0, e0), (s1, e1)] = [pair[0], pair[1]];
        if e0 >= target && target >= e1 && e0 > e1 {
            let t = (e0 / target).ln() / (e0 / e1).ln();
            return Some(TimeTo { seconds: (s0.ln() + t * (s1.ln() - s0.ln())).exp(), extrapolated: false });
        }
    }
    let beyond = |&(seconds, error): &(f64, f64)| TimeTo { seconds: seconds * error / target, extrapolated: error != target };
    let first = known.first()?;
    Some(if first.1 <= target { beyond(first) } else { beyond(known.last()?) })
}

/// Which seconds and which error of a point are meant.
type Measure = (fn(&Point) -> f64, fn(&RelMse) -> f64);

/// Our seconds over those of another renderer at equal errors: the geometric mean over its points. `None` where one of the curves
/// has no error above its reference's noise.
fn at_equal_error(ours: &Curve, theirs: &Curve, (seconds, error): Measure) -> Option<f64> {
    let own: Vec<(f64, f64)> = ours.points.iter().map(|p| (seconds(p), error(&p.error))).collect();
    let points = theirs.points.iter().filter(|p| error(&p.error) > 0.0);
    let ratios = points.map(|p| Some(time_to(&own, error(&p.error))?.seconds / seconds(p))).collect::<Option<Vec<_>>>()?;
    (!ratios.is_empty()).then(|| geometric_mean(&ratios))
}

fn geometric_mean(values: &[f64]) -> f64 {
    (values.iter().map(|v| v.ln()).sum::<f64>() / values.len() as f64).exp()
}

/// Our seconds over those of every other renderer at equal errors, scene by scene; empty where nobody else took part.
pub fn summary(curves: &[Curve], renderers: &[Named]) -> String {
    let (ours, others): (Vec<&Named>, Vec<&Named>) = renderers.iter().partition(|r| r.family == OURS);
    let mut scenes: Vec<&str> = curves.iter().map(|c| c.scene.as_str()).collect();
    scenes.dedup();
    let find = |scene: &str, id: &str| curves.iter().find(|c| c.scene == scene && c.renderer == id);
    let mut text = String::new();
    for (own, other) in ours.iter().flat_map(|own| others.iter().map(move |other| (own, other))) {
        let measures: [Measure; 4] =
            [(|p| p.wall, |e| e.mean), (|p| p.wall, |e| e.trimmed), (|p| p.cpu, |e| e.mean), (|p| p.cpu, |e| e.trimmed)];
        let ratios = |scene: &str| {
            let (own, other) = (find(scene, &own.id)?, find(scene, &other.id)?);
            Some(measures.map(|measure| at_equal_error(own, other, measure)))
        };
        let rows: Vec<(&str, [Option<f64>; 4])> = scenes.iter().filter_map(|scene| Some((*scene, ratios(scene)?))).collect();
        if rows.is_empty() {
            continue;
        }
        let _ = writeln!(text, "\nseconds of {} over those of {} at equal error", own.label, other.label);
        let _ = writeln!(text, "  {:27} {:>10} {:>10} {:>12} {:>12}", "scene", "relMSE", "99 %", "cpu, relMSE", "cpu, 99 %");
        let mut line = |name: &str, values: [Option<f64>; 4]| {
            let [a, b, c, d] = values.map(|v| v.map_or_else(|| "unknown".into(), |v| format!("{v:.2}")));
            let _ = writeln!(text, "  {name:27} {a:>10} {b:>10} {c:>12} {d:>12}");
        };
        rows.iter().for_each(|(scene, values)| line(scene, *values));
        let column = |at: usize| rows.iter().filter_map(|(_, values)| values[at]).collect::<Vec<f64>>();
        let over = |f: &dyn Fn(&[f64]) -> f64| [0, 1, 2, 3].map(|at| Some(column(at)).filter(|c| !c.is_empty()).map(|c| f(&c)));
        line("geometric mean", over(&geometric_mean));
        line("largest", over(&|values| values.iter().copied().fold(0.0, f64::max)));
    }
    text
}

/// The tables of one scene.
pub fn table(title: &str, curves: &[Curve], renderers: &[Named], differences: &[Difference], target: f64) -> String {
    let mut text = format!("\n{title}\n");
    let label = |id: &str| renderers.iter().find(|r| r.id == id).map_or(id, |r| &r.label).to_owned();
    let _ = writeln!(
        text,
        "  {:27} {:>5} {:>9} {:>9} {:>10} {:>10} {:>10} {:>10} {:>10}",
        "renderer", "spp", "wall s", "cpu s", "relMSE", "99 %", "median px", "relMSE*spp", "Msamples/s"
    );
    for curve in curves {
        for p in &curve.points {
            let _ = writeln!(
                text,
                "  {:27} {:>5} {:>9.3} {:>9.3} {:>10.3e} {:>10.3e} {:>10.3e} {:>10.3} {:>10.2}",
                label(&curve.renderer),
                p.spp,
                p.wall,
                p.cpu,
                p.error.mean,
                p.error.trimmed,
                p.error.median,
                p.variance,
                p.msamples
            );
        }
    }
    let _ = writeln!(text, "  seconds to relMSE {target}: (processor / threads in brackets; ~ beyond what was measured)");
    for curve in curves {
        let time = |t: Option<TimeTo>| match t {
            Some(t) => format!("{}{:.3}", if t.extrapolated { "~" } else { "" }, t.seconds),
            None => "unknown".into(),
        };
        let ratio = |(id, [wall, cpu]): (&String, &[f64; 2])| format!("   {id} takes {wall:.2} ({cpu:.2}) of that");
        let ratio: String = curve.ours_over_this.iter().map(ratio).collect();
        let (wall, cpu) = (time(curve.wall_to_target), time(curve.cpu_to_target));
        let _ = writeln!(text, "  {:27} {wall:>9} ({cpu}){ratio}", label(&curve.renderer));
    }
    for d in differences {
        let _ = writeln!(
            text,
            "  references: mean of {} {:+.2} % against {}; relMSE {:.2e}, 99 % {:.2e}, median pixel {:.2e}",
            d.other,
            100.0 * (d.ratio - 1.0),
            d.of,
            d.error.mean,
            d.error.trimmed,
            d.error.median
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seconds_to_an_error() {
        // Error = 1 / seconds: a line of slope -1.
        let curve = [(1.0, 1.0), (4.0, 0.25), (16.0, 0.0625)];
        let near = |a: Option<TimeTo>, seconds: f64, extrapolated: bool| {
            let a = a.unwrap();
            assert!((a.seconds / seconds - 1.0).abs() < 1e-12 && a.extrapolated == extrapolated, "{a:?}");
        };
        near(time_to(&curve, 0.1), 10.0, false);
        near(time_to(&curve, 0.25), 4.0, false);
        near(time_to(&curve, 0.01), 100.0, true);
        near(time_to(&curve, 4.0), 0.25, true);
        // A start-up of one second: seconds = 1 + 1 / error, between the points by the measured slope.
        let t = time_to(&[(2.0, 1.0), (11.0, 0.1)], 0.3).unwrap();
        assert!(!t.extrapolated && t.seconds > 2.0 && t.seconds < 11.0);
        // A noisy reference may leave nothing.
        assert_eq!(time_to(&[(1.0, -0.1)], 0.01), None);
        near(time_to(&[(1.0, 0.02), (4.0, -0.01)], 0.01), 2.0, true);
    }

    #[test]
    fn ours_is_compared_with_every_other() {
        let error = |mean: f64| RelMse { mean, trimmed: mean, clipped: mean, median: mean };
        let row = |renderer: &str, repeat, spp: u32, wall: f64| Row {
            scene: "s".into(),
            renderer: renderer.into(),
            repeat,
            spp,
            wall,
            cpu: 2.0 * wall,
            error: error(1.0 / f64::from(spp)),
        };
        let rows = [
            row(OURS, 0, 10, 1.0),
            row(OURS, 1, 10, 9.0),
            row(OURS, 2, 10, 2.0),
            row(OURS, 0, 100, 20.0),
            row("cycles", 0, 10, 4.0),
            row("cycles", 0, 100, 40.0),
        ];
        let named = |id: &str| Named { id: id.into(), label: id.into(), version: "1".into(), family: id.into() };
        let curves = curves("s", 1_000_000, &rows, &[named(OURS), named("cycles"), named("absent")], 0.05, 2);
        assert_eq!(curves.len(), 2);
        let first = &curves[0].points[0];
        assert_eq!((first.wall, first.msamples), (2.0, 5.0));
        assert!((first.variance - 1.0).abs() < 1e-12);
        assert!(curves[0].ours_over_this.is_empty());
        assert!(curves[1].ours_over_this[OURS].iter().all(|r| (r - 0.5).abs() < 1e-12));
        assert!((curves[1].wall_to_target.unwrap().seconds - 8.0).abs() < 1e-9);
        let text = table("s", &curves, &[named(OURS), named("cycles")], &[], 0.05);
        assert!(text.contains("renderflow takes 0.50 (0.50) of that"), "{text}");
        let text = summary(&curves, &[named(OURS), named("cycles")]);
        let line =
            |name: &str| text.lines().find(|l| l.trim_start().starts_with(name)).unwrap().split_whitespace().collect::<Vec<_>>();
        assert_eq!(line("s "), ["s", "0.50", "0.50", "0.50", "0.50"], "{text}");
        assert_eq!(line("geometric")[2..], ["0.50"; 4], "{text}");
        assert!(summary(&curves[..1], &[named(OURS), named("cycles")]).is_empty());
    }
}
