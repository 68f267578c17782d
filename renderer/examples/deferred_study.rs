//! How far each feature of the deferred baseline brings a picture towards the truth: PSNR (exposed, sRGB, pixels with coverage) of the split
//! sum and of deferred shading with features on and off, over the sequences of dataset folders, by layout.
//!
//! `cargo run --release -p renderflow-renderer --example deferred_study -- [--each] [--images FOLDER] SEQUENCE_FOLDER...`

use renderflow_frame::deferred::{self, Deferred, Lighting, Options, ShadowMode};
use renderflow_frame::image::Rgb;
use renderflow_frame::{Environment, Frame, color, ibl, transforms};
use renderflow_renderer::{RenderScene, shadow_maps};
use renderflow_scenes::description::Scene;
use renderflow_scenes::load::load;
use std::collections::BTreeMap;
use std::error::Error;
use std::path::{Path, PathBuf};
use std::time::Instant;

type Outcome<T> = Result<T, Box<dyn Error + Send + Sync>>;

const ALL: Options =
    Options { shadows: ShadowMode::Map, sky: true, occlusion: true, bent: true, reflections: true, indirect: true };

fn variants() -> Vec<(&'static str, Options)> {
    let only = std::env::var("ONLY").ok();
    every().into_iter().filter(|v| only.as_ref().is_none_or(|only| only.split(',').any(|o| o == v.0))).collect()
}

fn every() -> Vec<(&'static str, Options)> {
    vec![
        ("all", ALL),
        (
            "none",
            Options { shadows: ShadowMode::None, sky: false, occlusion: false, bent: false, reflections: false, indirect: false },
        ),
        ("-shadows", Options { shadows: ShadowMode::None, ..ALL }),
        ("ss-shadow", Options { shadows: ShadowMode::ScreenSpace, ..ALL }),
        ("-sky", Options { sky: false, ..ALL }),
        ("-occlusion", Options { occlusion: false, ..ALL }),
        ("-bent", Options { bent: false, ..ALL }),
        ("-reflect", Options { reflections: false, ..ALL }),
        ("-indirect", Options { indirect: false, ..ALL }),
    ]
}

fn main() -> Outcome<()> {
    let mut arguments = std::env::args().skip(1);
    let (mut folders, mut each, mut images) = (Vec::new(), false, None);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--each" => each = true,
            "--images" => images = arguments.next().map(PathBuf::from),
            _ => folders.push(PathBuf::from(argument)),
        }
    }
    let mut sums: BTreeMap<String, (usize, Vec<f64>)> = BTreeMap::new();
    let mut seconds = [0.0; 3];
    let names: Vec<_> = std::iter::once("ibl").chain(variants().iter().map(|v| v.0)).collect();
    println!(
        "{:34}{}",
        "",
        names
            .iter()
            .map(|n| format!("{:>11}", n.chars().rev().take(10).collect::<String>().chars().rev().collect::<String>()))
            .collect::<String>()
    );
    for folder in folders {
        let (layout, values) = match sequence(&folder, images.as_deref(), &mut seconds) {
            Ok(found) => found,
            Err(error) => {
                eprintln!("{}: {error}", folder.display());
                continue;
            }
        };
        let frames = values.len();
        if each {
            let mean: Vec<f64> = (0..names.len()).map(|k| values.iter().map(|v| v[k]).sum::<f64>() / frames as f64).collect();
            print_row(&format!("{layout} {}", folder.file_name().unwrap_or_default().to_string_lossy()), &mean);
        }
        for key in [layout, "all layouts".into()] {
            let (count, sum) = sums.entry(key).or_insert_with(|| (0, vec![0.0; names.len()]));
            *count += frames;
            values.iter().for_each(|v| sum.iter_mut().zip(v).for_each(|(sum, v)| *sum += v));
        }
    }
    for (layout, (count, sum)) in &sums {
        print_row(&format!("{layout} ({count} frames)"), &sum.iter().map(|s| s / *count as f64).collect::<Vec<_>>());
    }
    let frames = sums.get("all layouts").map_or(1, |s| s.0) as f64;
    println!(
        "milliseconds: lighting {:.0} in all, shadow maps {:.1} a frame, shading {:.1} a frame",
        seconds[0] * 1e3,
        seconds[1] / frames * 1e3,
        seconds[2] / frames * 1e3
    );
    Ok(())
}

fn print_row(name: &str, values: &[f64]) {
    println!("{name:34}{}", values.iter().map(|v| format!("{v:11.2}")).collect::<String>());
}

/// Layout, and the PSNR of each method of each frame.
fn sequence(folder: &Path, images: Option<&Path>, seconds: &mut [f64; 3]) -> Outcome<(String, Vec<Vec<f64>>)> {
    let about: serde_json::Value = renderflow_frame::file::read_json(&folder.join("sequence.json"))?;
    let layout = about["layout"].as_str().unwrap_or("?").to_owned();
    let sequence = transforms::read(&folder.join("transforms.json"))?;
    let scene = Scene::read(&folder.join("scene.json"))?;
    let mut scene = RenderScene::compile(&load(&scene, folder)?)?;
    let environment = Environment {
        map: renderflow_frame::hdr::read(&folder.join(&sequence.environment))?.map,
        rotation: sequence.environment_rotation,
        intensity: sequence.environment_intensity,
    };
    let start = Instant::now();
    let most = std::env::var("LIGHTS").ok().and_then(|v| v.parse().ok()).unwrap_or(deferred::LIGHTS);
    let lighting = Lighting::new(&environment, most);
    seconds[0] += start.elapsed().as_secs_f64();
    let tables = ibl::IblTables::new(&environment);
    if std::env::var("SHOW").is_ok() {
        for light in &lighting.lights {
            println!("   light share {:.3} radius {:.3} direction {:.2}", light.share, light.angular_radius, light.direction);
        }
    }
    let mut values = Vec::new();
    let few = std::env::var("FRAMES").ok().and_then(|v| v.parse().ok()).unwrap_or(usize::MAX);
    for (file, camera) in sequence.files.iter().zip(&sequence.cameras).take(few) {
        let frame = renderflow_frame::frame_file::read(&folder.join(file))?;
        let number = file.split('.').nth(1).and_then(|n| n.parse().ok()).unwrap_or(0);
        scene.set_frame(number);
        let start = Instant::now();
        let maps = shadow_maps(&scene, &lighting, &deferred::receivers(&frame, camera));
        seconds[1] += start.elapsed().as_secs_f64();
        let split_sum = ibl::shade(&frame, camera, &environment, &tables).image;
        let mut row = vec![psnr(&frame, &split_sum, sequence.exposure)];
        for (name, options) in variants() {
            let start = Instant::now();
            let made: Deferred = deferred::shade(&frame, camera, &lighting, &maps, &options);
            if name == "all" {
                seconds[2] += start.elapsed().as_secs_f64();
                if let (Some(images), Some(truth)) = (images, &frame.beauty) {
                    let black = Rgb::filled(frame.width, frame.height, [0.0; 3]);
                    let sum = |list: &[Rgb]| {
                        Rgb::from_fn(frame.width, frame.height, |x, y| {
                            [0, 1, 2].map(|c| list.iter().map(|p| p.at(x, y)[c]).sum())
                        })
                    };
                    let occlusion = made.occlusion.as_ref().map(|o| o.map(|o| [o / sequence.exposure; 3]));
                    let row = [
                        truth.clone(),
                        made.image.clone(),
                        split_sum.clone(),
                        sum(&made.direct),
                        made.ambient_diffuse.clone(),
                        made.ambient_specular.clone(),
                        made.reflections.clone().unwrap_or(black.clone()),
                        made.indirect.clone().unwrap_or(black.clone()),
                        occlusion.unwrap_or(black),
                    ];
                    let name = format!("{}_{number:04}.png", folder.file_name().unwrap_or_default().to_string_lossy());
                    save(&images.join(format!("{layout}_{name}")), &row, sequence.exposure)?;
                }
            }
            if name == "all"
                && let Ok(at) = std::env::var("PIXEL")
            {
                let at: Vec<usize> = at.split(',').filter_map(|v| v.parse().ok()).collect();
                let i = at[1] * frame.width + at[0];
                println!(
                    "   {number}: truth {:?} made {:?} depth {} normal {:?} material {:?} occlusion {:?} bent {:?} prefiltered {:?} specular {:?} ambient {:?}",
                    frame.beauty.as_ref().map(|b| b.pixels[i]),
                    made.image.pixels[i],
                    made.shading.depth.pixels[i],
                    made.shading.normal.pixels[i],
                    made.shading.material.pixels[i],
                    made.occlusion.as_ref().map(|o| o.pixels[i]),
                    made.bent_normal.as_ref().map(|o| o.pixels[i]),
                    made.shading.prefiltered.pixels[i],
                    made.ambient_specular.pixels[i],
                    made.ambient_diffuse.pixels[i]
                );
            }
            row.push(psnr(&frame, &made.image, sequence.exposure));
        }
        values.push(row);
    }
    Ok((layout, values))
}

fn psnr(frame: &Frame, picture: &Rgb, exposure: f32) -> f64 {
    let Some(truth) = &frame.beauty else { return f64::NAN };
    let (mut sum, mut count) = (0.0, 0.0);
    for i in 0..truth.pixels.len() {
        if frame.alpha.pixels[i] > 0.0 {
            let (a, b) = (color::display(truth.pixels[i], exposure), color::display(picture.pixels[i], exposure));
            sum += (0..3).map(|c| f64::from(a[c] - b[c]).powi(2)).sum::<f64>();
            count += 3.0;
        }
    }
    -10.0 * (sum / f64::max(count, 1.0)).max(1e-12).log10()
}

/// Pictures side by side, three in a row, as PNG.
fn save(path: &Path, pictures: &[Rgb], exposure: f32) -> Outcome<()> {
    let (width, height) = (pictures[0].width as u32, pictures[0].height as u32);
    let mut out = image::RgbImage::new(3 * width, height * (pictures.len() as u32).div_ceil(3));
    for (k, picture) in pictures.iter().enumerate() {
        let (left, top) = (k as u32 % 3 * width, k as u32 / 3 * height);
        for (i, pixel) in picture.pixels.iter().enumerate() {
            let value = color::display(*pixel, exposure).map(|v| (v * 255.0 + 0.5) as u8);
            out.put_pixel(left + i as u32 % width, top + i as u32 / width, image::Rgb(value));
        }
    }
    std::fs::create_dir_all(path.parent().unwrap_or(Path::new("")))?;
    Ok(out.save(path)?)
}
