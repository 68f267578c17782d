//! Scenes that another renderer has rendered from the same description, and how far our picture of them is from its means.

use glam::DVec3;
use renderflow_frame::reach::Reach;
use renderflow_renderer::material::Mode;
use renderflow_renderer::{RenderScene, Settings, render};
use renderflow_scenes::{description::Scene, load};
use serde::Deserialize;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::fmt::Write;
use std::path::Path;
use std::sync::atomic::AtomicBool;

/// A scene as the scripts in `tests/references` read it.
#[derive(Deserialize)]
pub struct Description {
    pub eye: [f64; 3],
    pub target: [f64; 3],
    pub vertical_fov: f64,
    /// By name; in the words of a scene file, or in a script's own.
    pub materials: BTreeMap<String, Value>,
    #[serde(default)]
    pub spheres: Vec<Sphere>,
    pub quads: Vec<Quad>,
    pub model: Option<Model>,
    #[allow(dead_code)] // Not every test says it in the scene.
    pub mode: Option<Mode>,
}

#[derive(Deserialize)]
pub struct Sphere {
    pub center: [f64; 3],
    pub radius: f64,
    pub material: String,
}

#[derive(Deserialize)]
pub struct Quad {
    /// Counter-clockwise from its front; texture coordinates (0,0), (1,0), (1,1), (0,1).
    pub corners: [[f64; 3]; 4],
    pub material: String,
}

#[derive(Deserialize)]
pub struct Model {
    pub file: String,
    pub material: String,
}

/// What a script stored.
#[derive(Deserialize)]
pub struct Reference {
    pub size: usize,
    pub scenes: BTreeMap<String, Blocks>,
}

#[derive(Deserialize)]
pub struct Blocks {
    /// Standard error of a block's mean, as a share of it.
    pub noise: f64,
    /// Mean radiance, row by row.
    pub blocks: Vec<Vec<[f64; 3]>>,
}

/// The scripts' sphere: radial normals, one seam in the texture coordinates.
fn sphere(path: &Path, sphere: &Sphere) {
    let (segments, rings) = (192, 96);
    let mut text = String::new();
    for r in 0..=rings {
        let theta = PI * f64::from(r) / f64::from(rings);
        for s in 0..=segments {
            let phi = 2.0 * PI * f64::from(s) / f64::from(segments);
            let n = [theta.sin() * phi.sin(), theta.cos(), theta.sin() * phi.cos()];
            let [x, y, z] = [0, 1, 2].map(|k| sphere.center[k] + sphere.radius * n[k]);
            let (u, v) = (f64::from(s) / f64::from(segments), 1.0 - f64::from(r) / f64::from(rings));
            writeln!(text, "v {x:.9} {y:.9} {z:.9}\nvn {:.9} {:.9} {:.9}\nvt {u:.9} {v:.9}", n[0], n[1], n[2]).unwrap();
        }
    }
    let index = |r: i32, s: i32| r * (segments + 1) + s + 1;
    for r in 0..rings {
        for s in 0..segments {
            let (a, b, c, d) = (index(r, s), index(r + 1, s), index(r + 1, s + 1), index(r, s + 1));
            if r < rings - 1 {
                writeln!(text, "f {a}/{a}/{a} {b}/{b}/{b} {c}/{c}/{c}").unwrap();
            }
            if r > 0 {
                writeln!(text, "f {a}/{a}/{a} {c}/{c}/{c} {d}/{d}/{d}").unwrap();
            }
        }
    }
    std::fs::write(path, text).unwrap();
}

fn quad(path: &Path, quad: &Quad) {
    let mut text = String::new();
    for ([x, y, z], [u, v]) in quad.corners.iter().zip([[0, 0], [1, 0], [1, 1], [0, 1]]) {
        writeln!(text, "v {x} {y} {z}\nvt {u} {v}").unwrap();
    }
    text += "f 1/1 2/2 3/3\nf 1/1 3/3 4/4\n";
    std::fs::write(path, text).unwrap();
}

/// The scripts' sky in a unit direction.
#[allow(dead_code)] // Not every test asks for it.
pub fn sky_radiance(d: DVec3) -> DVec3 {
    let glow = (8.0 * (d.dot(DVec3::new(0.6, 0.64, 0.48)) - 1.0)).exp();
    let up = 0.5 + 0.5 * d.y;
    DVec3::new(0.3 + 0.2 * up + 6.0 * glow, 0.3 + 0.4 * up + 5.0 * glow, 0.3 + 0.7 * up + 4.0 * glow)
}

fn sky(path: &Path) {
    let (width, height) = (1024, 512);
    let radiance = |x: usize, y: usize| {
        let (theta, phi) = (PI * (y as f64 + 0.5) / height as f64, 2.0 * PI * (x as f64 + 0.5) / width as f64);
        let l = sky_radiance(DVec3::new(phi.sin() * theta.sin(), theta.cos(), -phi.cos() * theta.sin()));
        (l.x as f32, l.y as f32, l.z as f32)
    };
    exr::prelude::write_rgb_file(path, width, height, radiance).unwrap();
}

/// The scripts' two small textures.
fn textures(folder: &Path) {
    let image = |f: fn(u32, u32) -> [u32; 3]| image::RgbImage::from_fn(64, 64, |x, y| image::Rgb(f(x, y).map(|v| v as u8)));
    let pattern = image(|x, y| [4 * x, 252 - 4 * y, 60 + 140 * ((x / 8 + y / 8) % 2)]);
    pattern.save(folder.join("pattern.png")).unwrap();
    image(|x, y| [0, 80 + 2 * x, 4 * y]).save(folder.join("layers.png")).unwrap();
}

/// Our means of 8 x 8 blocks. `assets` holds the model and its textures. The picture goes into the folder that the environment
/// variable RENDERFLOW_TEST_PICTURES names, if it is set, as `name`.exr.
pub fn blocks(
    name: &str,
    description: &Description,
    assets: Option<&Path>,
    size: usize,
    settings: &Settings,
) -> Vec<Vec<[f64; 3]>> {
    let folder = tempfile::tempdir().unwrap();
    sky(&folder.path().join("sky.exr"));
    textures(folder.path());
    let mut objects = Vec::new();
    for (i, s) in description.spheres.iter().enumerate() {
        sphere(&folder.path().join(format!("sphere{i}.obj")), s);
        objects
            .push(json!({"name": format!("sphere {i}"), "geometry": {"file": format!("sphere{i}.obj")}, "material": s.material}));
    }
    for (i, q) in description.quads.iter().enumerate() {
        quad(&folder.path().join(format!("quad{i}.obj")), q);
        objects.push(json!({"name": format!("quad {i}"), "geometry": {"file": format!("quad{i}.obj")}, "material": q.material}));
    }
    let place = |file: &str| match assets {
        Some(assets) if !folder.path().join(file).exists() => assets.join(file).to_str().unwrap().to_owned(),
        _ => file.to_owned(),
    };
    if let Some(m) = &description.model {
        objects.push(json!({"name": "model", "geometry": {"file": place(&m.file)}, "material": m.material}));
    }
    let materials: Vec<Value> = description
        .materials
        .iter()
        .map(|(name, material)| {
            let mut material = material.clone();
            material["name"] = json!(name);
            for key in ["base_color_texture", "metallic_roughness_texture"] {
                if let Some(file) = material.get(key).and_then(Value::as_str).map(place) {
                    material[key] = json!(file);
                    // With a texture the factors are 1, in the scripts too.
                    for factor in if key == "base_color_texture" { &["base_color"][..] } else { &["roughness", "metallic"] } {
                        material[*factor] = if *factor == "base_color" { json!([1.0, 1.0, 1.0]) } else { json!(1.0) };
                    }
                }
            }
            material
        })
        .collect();
    let scene: Scene = serde_json::from_value(json!({
        "version": 1, "name": "compared", "resolution": [size, size],
        "camera": {"type": "poses", "poses": [{"eye": description.eye, "target": description.target}], "vertical_fov": description.vertical_fov},
        "environment": {"source": {"file": "sky.exr"}},
        "materials": materials, "objects": objects
    }))
    .unwrap();
    let loaded = load::load(&scene, &Reach::folder(folder.path()).allow(assets)).unwrap();
    let compiled = RenderScene::compile(&loaded).unwrap();
    let frame = render(&compiled, settings, &|_, _| (), &AtomicBool::new(false)).unwrap();
    let beauty = frame.beauty.or(frame.raw).unwrap();
    if let Some(folder) = std::env::var_os("RENDERFLOW_TEST_PICTURES") {
        let pixel = |x: usize, y: usize| {
            let [r, g, b] = beauty.pixels[y * size + x];
            (r, g, b)
        };
        exr::prelude::write_rgb_file(Path::new(&folder).join(format!("{name}.exr")), size, size, pixel).unwrap();
    }
    let side = size / 8;
    let mean = |x: usize, y: usize| {
        let part = beauty.crop(x * side, y * side, side, side);
        [0, 1, 2].map(|c| part.pixels.iter().map(|p| f64::from(p[c])).sum::<f64>() / part.pixels.len() as f64)
    };
    (0..8).map(|y| (0..8).map(|x| mean(x, y)).collect()).collect()
}

/// Prints the signed difference of every block in tenths of a percent, and returns the mean and the largest relative difference
/// over blocks and channels.
pub fn compare(name: &str, ours: &[Vec<[f64; 3]>], reference: &Blocks) -> (f64, f64) {
    let (mut sum, mut worst) = (0.0, 0.0f64);
    println!("{name}: difference of blocks, tenths of a percent (mean of channels)");
    for (ours, theirs) in ours.iter().zip(&reference.blocks) {
        let mut line = String::new();
        for (a, b) in ours.iter().zip(theirs) {
            let relative = [0, 1, 2].map(|c| a[c] / b[c] - 1.0);
            write!(line, "{:6.1}", 1e3 * relative.iter().sum::<f64>() / 3.0).unwrap();
            sum += relative.iter().map(|r| r.abs()).sum::<f64>();
            worst = relative.iter().fold(worst, |w, r| w.max(r.abs()));
        }
        println!("{line}");
    }
    let mean = sum / (3.0 * 64.0);
    println!(
        "{name}: mean {:.3} %, worst {:.2} %, noise of the reference {:.3} %",
        100.0 * mean,
        100.0 * worst,
        100.0 * reference.noise
    );
    (mean, worst)
}
