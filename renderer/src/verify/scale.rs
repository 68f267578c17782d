//! The picture of a scene does not depend on the unit it is measured in, nor on where it stands.

use super::{Check, Effort, Outcome, Ticker, Worst};
use crate::compile::RenderScene;
use crate::integrator::{self, Settings};
use renderflow_frame::Frame;
use renderflow_frame::reach::Reach;
use renderflow_scenes::{Scene, load};
use std::path::Path;

/// Checks of this file.
pub const CHECKS: &[Check] = &[
    Check {
        name: "scale.size",
        about: "the same scene description from 1e-6 to 1e6 times its size gives the same picture, sample for sample",
        run: size,
    },
    Check {
        name: "scale.place",
        about: "the same scene description moved by up to 1e6 m gives the same picture, sample for sample of paths from the camera",
        run: place,
    },
];

/// A description of a still life of `scale` times its size, its middle at `offset`. Its coordinates keep below 1, so that those of
/// the largest one keep within the million that scene files allow.
fn description(scale: f64, offset: [f64; 3], edge: u32) -> String {
    let at = |p: [f64; 3]| [0, 1, 2].map(|i| p[i] * scale + offset[i]);
    let transform = |p: [f64; 3], turn: [f64; 3]| {
        let (p, s) = (at(p), scale);
        format!(
            r#"{{"translation": [{:e}, {:e}, {:e}], "rotation": [{}, {}, {}], "scale": [{s:e}, {s:e}, {s:e}]}}"#,
            p[0], p[1], p[2], turn[0], turn[1], turn[2]
        )
    };
    let object = |name: &str, shape: &str, material: &str, transform: String| {
        format!(r#"{{"name": "{name}", "geometry": {{"shape": {shape}}}, "material": "{material}", "transform": {transform}}}"#)
    };
    let objects = [
        object("floor", r#"{"family": "plane", "size": 1.6}"#, "grey", transform([0.0; 3], [0.0; 3])),
        object("ball", r#"{"family": "sphere", "radius": 0.12}"#, "metal", transform([-0.14, 0.12, 0.02], [0.0; 3])),
        object(
            "crate",
            r#"{"family": "box", "size": [0.16, 0.22, 0.14]}"#,
            "red",
            transform([0.16, 0.11, -0.04], [0.0, 33.0, 0.0]),
        ),
        object(
            "ring",
            r#"{"family": "torus", "radius": 0.08, "tube": 0.024}"#,
            "grey",
            transform([0.02, 0.09, 0.18], [70.0, 0.0, 10.0]),
        ),
    ];
    let (eye, target) = (at([0.08, 0.34, 0.84]), at([0.0, 0.1, 0.0]));
    format!(
        r#"{{"version": 1, "name": "still life", "seed": 5, "resolution": [{edge}, {edge}],
        "camera": {{"type": "poses", "vertical_fov": 35, "poses": [{{"eye": [{:e}, {:e}, {:e}], "target": [{:e}, {:e}, {:e}]}}]}},
        "environment": {{"source": {{"builtin": "golden_hour"}}}},
        "materials": [{{"name": "grey", "base_color": [0.6, 0.6, 0.6], "roughness": 0.8}},
            {{"name": "metal", "base_color": [0.9, 0.8, 0.6], "metallic": 1, "roughness": 0.3}},
            {{"name": "red", "base_color": [0.7, 0.2, 0.1], "roughness": 0.4}}],
        "objects": [{}]}}"#,
        eye[0],
        eye[1],
        eye[2],
        target[0],
        target[1],
        target[2],
        objects.join(",\n")
    )
}

/// Renders the still life.
fn picture(size: f64, offset: [f64; 3], light_paths: bool, effort: Effort, ticker: &Ticker<'_>) -> Result<Frame, String> {
    let path = Path::new("still-life.json");
    let scene = Scene::from_json(path, &description(size, offset, effort.pick(48, 96))).map_err(|e| e.to_string())?;
    let loaded = load::load(&scene, &Reach::folder(".")).map_err(|e| e.to_string())?;
    let dropped = loaded.report.triangles.dropped();
    let compiled = RenderScene::compile(&loaded).map_err(|e| e.to_string())?;
    if dropped + compiled.dropped_triangles() > 0 {
        return Err(format!("{dropped} triangles dropped by loading, {} by compiling", compiled.dropped_triangles()));
    }
    let settings = Settings { spp: effort.pick(32, 256), light_paths, ..Settings::default() };
    integrator::render(&compiled, &settings, &|_, _| (), ticker.cancel()).map_err(|e| e.to_string())
}

/// Root mean square difference of two pictures over the mean of the first.
fn difference(a: &Frame, b: &Frame) -> f64 {
    let pixels = |f: &Frame| f.beauty.as_ref().map(|i| i.pixels.clone()).unwrap_or_default();
    let (a, b) = (pixels(a), pixels(b));
    if a.len() != b.len() || a.is_empty() {
        return f64::INFINITY;
    }
    let (a, b) = (a.as_flattened(), b.as_flattened());
    let squares: f64 = a.iter().zip(b).map(|(x, y)| (f64::from(*x) - f64::from(*y)).powi(2)).sum();
    let sum: f64 = a.iter().map(|x| f64::from(*x)).sum();
    (squares * a.len() as f64).sqrt() / sum
}

/// Share of pixels that show another object at their centre.
fn flipped(a: &Frame, b: &Frame) -> f64 {
    let (a, b) = (&a.object_id.pixels, &b.object_id.pixels);
    a.iter().zip(b).filter(|(x, y)| x != y).count() as f64 / a.len().max(1) as f64
}

fn against_unit(others: &[(String, f64, [f64; 3])], light_paths: bool, effort: Effort, ticker: &Ticker<'_>) -> Vec<Outcome> {
    let [rms, ids] = LIMITS;
    ticker.expect(1 + others.len() as u64);
    let unit = picture(1.0, [0.0; 3], light_paths, effort, ticker);
    ticker.add(1);
    let (mut beauty, mut objects) = (Worst::default(), Worst::default());
    for (name, size, offset) in others {
        let other = picture(*size, *offset, light_paths, effort, ticker);
        if ticker.cancelled() {
            break;
        }
        match (&unit, &other) {
            (Ok(unit), Ok(other)) => {
                beauty.see(difference(unit, other), || name.clone());
                objects.see(flipped(unit, other), || name.clone());
            }
            (Err(reason), _) | (_, Err(reason)) => beauty.see(f64::INFINITY, || format!("{name}: {reason}")),
        }
        ticker.add(1);
    }
    vec![
        beauty.at_most("root mean square difference over mean", rms),
        objects.at_most("share of pixels that show another object", ids),
    ]
}

fn size(effort: Effort, ticker: &Ticker<'_>) -> Vec<Outcome> {
    let exponents: &[i32] = effort.pick(&[-6, -3, 3, 6], &[-6, -5, -4, -3, -2, -1, 1, 2, 3, 4, 5, 6]);
    let others: Vec<_> = exponents.iter().map(|&e| (format!("1e{e} times the size"), 10f64.powi(e), [0.0; 3])).collect();
    against_unit(&others, true, effort, ticker)
}

fn place(effort: Effort, ticker: &Ticker<'_>) -> Vec<Outcome> {
    // Scene files allow a million; the scene needs some of it for itself.
    let far = 999_000.0;
    let mut others = vec![
        ("moved by 999 km along x".to_owned(), 1.0, [far, 0.0, 0.0]),
        ("moved by 999 km along every axis".to_owned(), 1.0, [-far, far, far]),
    ];
    if effort == Effort::Full {
        others.push(("moved by 999 km along y".to_owned(), 1.0, [0.0, -far, 0.0]));
        others.push(("moved by 12345.678 m".to_owned(), 1.0, [12345.678, 0.1, -12345.678]));
        others.push(("900 times the size, moved by 999 km".to_owned(), 900.0, [far, far, -far]));
    }
    against_unit(&others, false, effort, ticker)
}

/// Limits of the two claims. Sample for sample the paths are the same but for the rounding of their corners; a path whose ray passes
/// an edge on the other side is another sample of the same pixel. Far away a light path may land on the other side of a pixel's border and
/// bring its light to the neighbour (0.0012 at 900 times the size, 999 km away; 0.00016 without light paths): that claim is one of paths
/// from the camera.
const LIMITS: [f64; 2] = [0.001, 0.001];
