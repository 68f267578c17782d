//! Renders a scene file or a model to `.png`, `.hdr` or `.exr`:
//!
//! `cargo run --release -p renderflow-renderer --example quick -- model.glb out.png --hdri sky.hdr --spp 64 --size 512x512 --ibl`

use renderflow_frame::reach::Reach;
use renderflow_frame::{color, exr, file, hdr};
use renderflow_renderer::{RenderScene, Settings, ibl, render_with_stats};
use renderflow_scenes::description::{EnvironmentSource, Scene};
use renderflow_scenes::load::{Format, ModelView, describe_model, load};
use std::error::Error;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

fn main() -> Result<(), Box<dyn Error>> {
    let mut positional: Vec<PathBuf> = Vec::new();
    let (mut hdri, mut resolution, mut split_sum, mut frame) = (None, None, false, 0usize);
    let mut settings = Settings { spp: 64, ..Settings::default() };
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().ok_or(format!("{argument} needs a value"));
        match argument.as_str() {
            "--hdri" => hdri = Some(PathBuf::from(value()?)),
            "--spp" => settings.spp = value()?.parse()?,
            "--branches" => settings.branches = value()?.parse()?,
            "--bounces" => settings.max_bounces = value()?.parse()?,
            "--frame" => frame = value()?.parse()?,
            "--ibl" => split_sum = true,
            "--size" => {
                let text = value()?;
                let (w, h) = text.split_once('x').ok_or("--size takes WIDTHxHEIGHT")?;
                resolution = Some([w.parse::<u32>()?, h.parse::<u32>()?]);
            }
            _ => positional.push(argument.into()),
        }
    }
    let [input, output] = positional.as_slice() else { return Err("usage: quick SCENE_OR_MODEL OUTPUT [--hdri MAP] ...".into()) };

    let begin = Instant::now();
    let reach = Reach::of(input).allow(["/"]);
    let mut scene = if Format::of(input).is_some() {
        let view = ModelView { environment: EnvironmentSource::Constant([1.0; 3]), ..ModelView::default() };
        describe_model(input, hdri.as_deref(), &view, &reach)?
    } else {
        let mut scene = Scene::read(input)?;
        if let Some(map) = &hdri {
            scene.environment.source = EnvironmentSource::File(std::path::absolute(map)?.to_string_lossy().into_owned());
        }
        scene
    };
    if let Some(resolution) = resolution {
        scene.resolution = resolution;
    }
    let loaded = load(&scene, &reach)?;
    let loaded_in = begin.elapsed();
    let begin = Instant::now();
    let mut compiled = RenderScene::compile(&loaded)?;
    compiled.set_frame(frame);
    println!("{} triangles: loaded in {loaded_in:.2?}, compiled in {:.2?}", compiled.triangle_count(), begin.elapsed());

    let begin = Instant::now();
    let picture = if split_sum {
        ibl::render(&compiled, &settings)?
    } else {
        let (picture, stats) = render_with_stats(&compiled, &settings, &|_, _| (), &AtomicBool::new(false))?;
        let seconds = begin.elapsed().as_secs_f64();
        println!("{:.2} Msamples/s, {stats:?}", stats.samples as f64 / seconds / 1e6);
        picture
    };
    println!("rendered in {:.2?}", begin.elapsed());

    let beauty = picture.beauty.as_ref().ok_or("nothing was rendered")?;
    match output.extension().and_then(|e| e.to_str()) {
        Some("exr") => {
            exr::write(output, &picture)?;
        }
        Some("hdr") => file::write_atomic(output, &hdr::encode(beauty))?,
        _ => {
            let bytes: Vec<u8> = beauty
                .pixels
                .iter()
                .flat_map(|&p| color::display(p, picture.info.exposure))
                .map(|v| (v * 255.0 + 0.5) as u8)
                .collect();
            image::save_buffer(output, &bytes, beauty.width as u32, beauty.height as u32, image::ColorType::Rgb8)?;
        }
    }
    Ok(())
}
