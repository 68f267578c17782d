//! How far each feature of the deferred baseline brings a picture towards the truth: PSNR (exposed, sRGB, pixels with coverage) of the split
//! sum and of deferred shading with features on and off, over the sequences of dataset folders, by layout.
//!
//! `cargo run --release -p renderflow-renderer --example deferred_study -- [--each] [--images FOLDER] [--only VARIANT,...] [--frames N] [--lights N] SEQUENCE_FOLDER...`

use renderflow_frame::deferred::{self, Carry, Deferred, Keyframe, Lighting, Options, ShadowMode};
use renderflow_frame::image::Rgb;
use renderflow_frame::reach::Reach;
use renderflow_frame::{Environment, Frame, color, ibl, transforms};
use renderflow_renderer::{RenderScene, ShadowTiles};
use renderflow_scenes::description::Scene;
use renderflow_scenes::load::load;
use std::collections::BTreeMap;
use std::error::Error;
use std::path::{Path, PathBuf};
use std::time::Instant;

type Outcome<T> = Result<T, Box<dyn Error + Send + Sync>>;

const ALL: Options =
    Options { shadows: ShadowMode::Map, sky: true, occlusion: true, bent: true, reflections: true, indirect: true, parts: true };

fn variants() -> Vec<(&'static str, Options)> {
    vec![
        ("all", ALL),
        ("none", Options::NONE),
        ("no-shadows", Options { shadows: ShadowMode::None, ..ALL }),
        ("ss-shadow", Options { shadows: ShadowMode::ScreenSpace, ..ALL }),
        ("no-sky", Options { sky: false, ..ALL }),
        ("no-ao", Options { occlusion: false, ..ALL }),
        ("no-bent", Options { bent: false, ..ALL }),
        ("no-reflect", Options { reflections: false, ..ALL }),
        ("no-bounce", Options { indirect: false, ..ALL }),
    ]
}

#[derive(Default)]
struct Study {
    folders: Vec<PathBuf>,
    each: bool,
    images: Option<PathBuf>,
    only: Option<String>,
    frames: Option<usize>,
    lights: Option<usize>,
}

fn main() -> Outcome<()> {
    let mut study = Study::default();
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--each" => study.each = true,
            "--images" => study.images = arguments.next().map(PathBuf::from),
            "--only" => study.only = arguments.next(),
            "--frames" => study.frames = arguments.next().map(|v| v.parse()).transpose()?,
            "--lights" => study.lights = arguments.next().map(|v| v.parse()).transpose()?,
            option if option.starts_with("--") => return Err(format!("unknown option {option}").into()),
            _ => study.folders.push(PathBuf::from(argument)),
        }
    }
    let wanted = |name: &str| study.only.as_ref().is_none_or(|only| only.split(',').any(|o| o == name));
    let variants: Vec<_> = variants().into_iter().filter(|v| v.0 == "all" || wanted(v.0)).collect();
    let names = [&["ibl"], &variants.iter().map(|v| v.0).collect::<Vec<_>>()[..], &["ratio", "fetch"]].concat();
    println!("{:24}{}", "", names.iter().map(|n| format!("{n:>11}")).collect::<String>());
    let mut rows: BTreeMap<String, Vec<Vec<f64>>> = BTreeMap::new();
    let mut seconds = [0.0; 3];
    for folder in &study.folders {
        let (layout, values) = match sequence(&study, &variants, folder, &mut seconds) {
            Ok(found) => found,
            Err(error) => {
                eprintln!("{}: {error}", folder.display());
                continue;
            }
        };
        if study.each {
            print_row(&format!("{layout} {}", folder.file_name().unwrap_or_default().to_string_lossy()), &values);
        }
        rows.entry("all layouts".into()).or_default().extend(values.iter().cloned());
        rows.entry(layout).or_default().extend(values);
    }
    for (layout, values) in &rows {
        print_row(&format!("{layout} ({} frames)", values.len()), values);
    }
    let frames = rows.get("all layouts").map_or(1, Vec::len) as f64;
    let [lighting, maps, shading] = seconds.map(|s| s * 1e3);
    println!(
        "milliseconds: lighting {:.0} a sequence, shadow maps {:.1} a frame, shading {:.1} a frame",
        lighting / study.folders.len() as f64,
        maps / frames,
        shading / frames
    );
    Ok(())
}

/// Means over the frames that have a value.
fn print_row(name: &str, rows: &[Vec<f64>]) {
    let mean = |k: usize| {
        let values: Vec<f64> = rows.iter().map(|row| row[k]).filter(|v| v.is_finite()).collect();
        if values.is_empty() { "-".into() } else { format!("{:.2}", values.iter().sum::<f64>() / values.len() as f64) }
    };
    println!("{name:24}{}", (0..rows[0].len()).map(|k| format!("{:>11}", mean(k))).collect::<String>());
}

/// Layout, and the PSNR of each method of each frame.
fn sequence(
    study: &Study,
    variants: &[(&str, Options)],
    folder: &Path,
    seconds: &mut [f64; 3],
) -> Outcome<(String, Vec<Vec<f64>>)> {
    let about: serde_json::Value = renderflow_frame::file::read_json(&folder.join("sequence.json"))?;
    let layout = about["layout"].as_str().unwrap_or("?").to_owned();
    let sequence = transforms::read(&folder.join("transforms.json"))?;
    let scene = Scene::read(&folder.join("scene.json"))?;
    let mut scene = RenderScene::compile(&load(&scene, &Reach::folder(folder).allow(["/"]))?)?;
    let environment = Environment {
        map: renderflow_frame::hdr::read(&folder.join(&sequence.environment))?.map,
        rotation: sequence.environment_rotation,
        intensity: sequence.environment_intensity,
    };
    let start = Instant::now();
    let lighting = Lighting::new(&environment, study.lights.unwrap_or(deferred::LIGHTS));
    seconds[0] += start.elapsed().as_secs_f64();
    let tables = ibl::IblTables::new(&environment);
    let mut values = Vec::new();
    let mut tiles = ShadowTiles::default();
    let (mut frames, mut pictures) = (Vec::new(), Vec::new());
    for file in sequence.files.iter().take(study.frames.unwrap_or(usize::MAX)) {
        let frame = renderflow_frame::frame_file::read(&folder.join(file))?;
        let number = file.split('.').nth(1).and_then(|n| n.parse().ok()).unwrap_or(0);
        scene.set_frame(number);
        let start = Instant::now();
        let maps = tiles.maps(&scene, &lighting, &deferred::receivers(&frame));
        seconds[1] += start.elapsed().as_secs_f64();
        let split_sum = ibl::shade(&frame, &environment, &tables).image;
        let mut row = vec![psnr(&frame, &split_sum, sequence.exposure)];
        for (name, options) in variants {
            let start = Instant::now();
            let made: Deferred = deferred::shade(&frame, &lighting, &maps, options);
            if *name == "all" {
                seconds[2] += start.elapsed().as_secs_f64();
                if let (Some(images), Some(truth)) = (&study.images, &frame.beauty) {
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
            row.push(psnr(&frame, &made.image, sequence.exposure));
            if *name == "all" {
                pictures.push(made.image);
            }
        }
        values.push(row);
        frames.push((number, frame));
    }
    carried(&sequence, &frames, &pictures, &mut values);
    Ok((layout, values))
}

/// Appends what the first and the last frame as keyframes make of those between, by ratio and as they are; 0 for the keyframes.
fn carried(sequence: &transforms::Sequence, frames: &[(usize, Frame)], pictures: &[Rgb], values: &mut [Vec<f64>]) {
    for (i, row) in values.iter_mut().enumerate() {
        let (number, frame) = &frames[i];
        let key = |k: usize| {
            let (at, key) = &frames[k];
            Some(Keyframe {
                frame: key,
                truth: key.beauty.as_ref()?,
                start: pictures.get(k)?,
                distance: *at as f32 - *number as f32,
                movement: sequence.tracks.between(i, k),
            })
        };
        let keys: Vec<Keyframe> = [0, frames.len() - 1].into_iter().filter_map(key).collect();
        let between = i > 0 && i + 1 < frames.len() && pictures.len() == frames.len();
        for carry in [Carry::Ratio, Carry::Fetch] {
            let made = between.then(|| deferred::warp_fill(frame, &pictures[i], &keys, sequence.exposure, carry));
            row.push(made.map_or(f64::NAN, |made| psnr(frame, &made, sequence.exposure)));
        }
    }
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
