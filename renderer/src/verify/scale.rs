//! The picture of a scene does not depend on the unit it is measured in, nor on where it stands.

use super::scenes::{self, Part};
use super::{Check, Effort, Outcome, Ticker, Worst};
use crate::compile::RenderScene;
use crate::geometry::Sharing;
use crate::integrator;
use crate::settings::Settings;
use glam::{Affine3A, Vec3, Vec3A};
use renderflow_frame::reach::Reach;
use renderflow_frame::{Camera, Frame};
use renderflow_scenes::shapes::Shape;
use renderflow_scenes::{Scene, load};
use std::path::Path;

/// Checks of this file.
pub const CHECKS: &[Check] = &[
    Check {
        name: "scale.size",
        about: "the same scene description from 1e-6 to 1e6 times its size gives the same picture, sample for sample, flattened and instanced",
        run: size,
    },
    Check {
        name: "scale.place",
        about: "the same scene description moved by up to 1e6 m gives the same picture, sample for sample of paths from the camera",
        run: place,
    },
    Check { name: "scale.contact", about: "a plate 1 mm above a ground of up to 1 km still hides the sky from it", run: contact },
];

/// A description of a still life of `scale` times its size, its middle at `offset`. Its coordinates keep below 1, so that those
/// of the largest one keep within the million that scene files allow.
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

/// How pictures are made.
#[derive(Clone, Copy)]
struct Way {
    light_paths: bool,
    sharing: Sharing,
}

/// Renders the still life.
fn picture(size: f64, offset: [f64; 3], way: Way, effort: Effort, ticker: &Ticker<'_>) -> Result<Frame, String> {
    let path = Path::new("still-life.json");
    let scene = Scene::from_json(path, &description(size, offset, effort.pick(48, 96))).map_err(|e| e.to_string())?;
    let loaded = load::load(&scene, &Reach::folder(".")).map_err(|e| e.to_string())?;
    let dropped = loaded.report.triangles.dropped();
    let compiled = RenderScene::compile_with(&loaded, way.sharing).map_err(|e| e.to_string())?;
    if dropped + compiled.dropped_triangles() > 0 {
        return Err(format!("{dropped} triangles dropped by loading, {} by compiling", compiled.dropped_triangles()));
    }
    let settings = Settings { spp: effort.pick(32, 256), light_paths: way.light_paths, ..Settings::default() };
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

fn against_unit(others: &[(String, f64, [f64; 3])], way: Way, effort: Effort, ticker: &Ticker<'_>) -> Vec<Outcome> {
    let [rms, ids] = LIMITS;
    ticker.expect(1 + others.len() as u64);
    let unit = picture(1.0, [0.0; 3], way, effort, ticker);
    ticker.add(1);
    let (mut beauty, mut objects) = (Worst::default(), Worst::default());
    for (name, size, offset) in others {
        let other = picture(*size, *offset, way, effort, ticker);
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
    let ways = [("", Sharing::Never), ("instanced: ", Sharing::Always)];
    let outcomes = ways.map(|(name, sharing)| {
        let found = against_unit(&others, Way { light_paths: true, sharing }, effort, ticker);
        found.into_iter().map(move |o| Outcome { name: format!("{name}{}", o.name), ..o })
    });
    outcomes.into_iter().flatten().collect()
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
    against_unit(&others, Way { light_paths: false, sharing: Sharing::Automatic }, effort, ticker)
}

/// Rays that leave the ground start half a millionth of its size above it: on a ground of 2 km they would start above the plate.
fn contact(_: Effort, ticker: &Ticker<'_>) -> Vec<Outcome> {
    let sizes = [1.0f32, 100.0, 1e3];
    ticker.expect(sizes.len() as u64);
    let mut worst = Worst::default();
    for size in sizes {
        let brightest = under_plate(size, ticker).unwrap_or(f64::NAN);
        worst.see(brightest, || format!("ground of {size} m"));
        ticker.add(1);
    }
    // Twenty centimetres inside, the sky is seen through a slit of 1 mm at 5 cm: less than a hundredth of it.
    vec![worst.at_most("radiance under the plate, of a sky of 1 with a sun", 0.05)]
}

/// The brightest pixel of a ground of edge `size` under a black plate, seen from between the two.
fn under_plate(size: f32, ticker: &Ticker<'_>) -> Result<f64, String> {
    let plate = Affine3A::from_translation(Vec3::new(0.0, 1e-3, 0.0));
    let parts = vec![
        Part::new(Shape::Plane { size }, scenes::diffuse([0.5; 3]), Affine3A::IDENTITY),
        Part::new(Shape::Plane { size: 0.5 }, scenes::diffuse([0.0; 3]), plate),
    ];
    let camera = Camera::look_at(Vec3A::new(0.0, 5e-4, 0.2), Vec3A::new(0.0, 0.0, 0.195), Vec3A::Y, 0.3, 9, 9);
    let compiled = scenes::compile(parts, scenes::sunny(), camera)?;
    let settings = Settings { spp: 64, ..Settings::default() };
    let frame = integrator::render(&compiled, &settings, &|_, _| (), ticker.cancel()).map_err(|e| e.to_string())?;
    let raw = frame.raw.as_ref().ok_or("no beauty")?;
    let ground = raw.pixels.iter().zip(&frame.object_id.pixels).filter(|(_, id)| **id == 1);
    let brightest = ground.map(|(p, _)| f64::from(p[1])).fold(f64::NAN, f64::max);
    if brightest.is_nan() { Err("the ground is not seen".into()) } else { Ok(brightest) }
}

/// Limits of the two claims. Sample for sample the paths are the same but for the rounding of their corners; a path whose ray
/// passes an edge on the other side is another sample of the same pixel. Far away a light path may land on the other side of a
/// pixel's border and bring its light to the neighbour (0.0012 at 900 times the size, 999 km away; 0.00016 without light paths):
/// that claim is one of paths from the camera.
const LIMITS: [f64; 2] = [0.001, 0.001];
