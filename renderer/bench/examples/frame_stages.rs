//! Where the seconds of a neural frame go, on one thread: the G-buffer, the samples, the split sum, the record, the inputs of the
//! network, its convolutions and its head.
//!
//! `cargo run --release -p renderflow-bench --example frame_stages -- SCENE.json [--size 128] [--spp 4] [--guides 16]
//! [--repeats 9] [--bf16]`
//!
//! Times are the least wall seconds of all repeats. The last line is a hash of the picture.

use renderflow_frame::reach::Reach;
use renderflow_frame::{Light, ibl};
use renderflow_model::fusion::batch::{Augmentation, Batch, Window};
use renderflow_model::fusion::fill::{Samples, background};
use renderflow_model::fusion::graph::MULTIPLE;
use renderflow_model::fusion::record::Selection;
use renderflow_model::fusion::{Fusion, Record};
use renderflow_model::ops::Products;
use renderflow_renderer::{Channels, RenderScene, Settings, render, render_gbuffer};
use renderflow_scenes::description::Scene;
use renderflow_scenes::load::load;
use std::error::Error;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

type Result<T> = std::result::Result<T, Box<dyn Error + Send + Sync>>;

fn main() -> Result<()> {
    let (mut path, mut size, mut spp, mut repeats) = (None, 128u32, 4u32, 9usize);
    let (mut guides, mut products) = (16u32, Products::F32);
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().ok_or(format!("{argument} needs a value"));
        match argument.as_str() {
            "--size" => size = value()?.parse()?,
            "--spp" => spp = value()?.parse()?,
            "--repeats" => repeats = value()?.parse()?,
            "--guides" => guides = value()?.parse()?,
            "--bf16" => products = Products::Bf16,
            _ => path = Some(PathBuf::from(argument)),
        }
    }
    let path = path.ok_or("usage: frame_stages SCENE.json [--size N] [--spp N] [--guides N] [--repeats N] [--bf16]")?;
    let mut description = Scene::read(&path)?;
    description.resolution = [size; 2];
    let loaded = load(&description, &Reach::of(&path).allow(["/"]))?;
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    pool.install(|| {
        let light = Light::new(loaded.environment.clone());
        measure(&RenderScene::compile(&loaded)?, &light, [spp, guides], repeats, products)
    })
}

fn measure(scene: &RenderScene, light: &Light, [spp, guides]: [u32; 2], repeats: usize, products: Products) -> Result<()> {
    let (never, exposure) = (AtomicBool::new(false), light.exposure());
    let network = Fusion::shipped()?.with_products(products);
    let buffers = Settings {
        guide_samples: guides,
        channels: Channels { motion: false, variance: false, ..Channels::ALL },
        ..Settings::default()
    };
    let read = network.header().fusion.paths;
    let channels = Channels { guides: true, variance: read, paths: read, ..Channels::BEAUTY };
    let traced = Settings { spp, channels, ..Settings::default() };
    let buffer = time("G-buffer", repeats, || render_gbuffer(scene, &buffers))?;
    let samples = time("samples", repeats, || render(scene, &traced, &|_, _| (), &never))?;
    let shading = time("split sum", repeats, || Ok::<_, Box<dyn Error + Send + Sync>>(ibl::shade(&buffer, light)))?;
    let record = time("record", repeats, || -> Result<Record<f32>> {
        let mut record = Record::of(&buffer, &shading.surfaces, exposure);
        record.add_environment(&shading, exposure);
        let behind = background(scene.camera(), &samples.alpha, &light.environment);
        record.add_part(0, &Samples::of(&samples, &behind).ok_or("samples without guides")?, exposure);
        Ok(record)
    })?;
    let selection = Selection::all(&record);
    let [width, height] = [record.width, record.height].map(|side| side.next_multiple_of(MULTIPLE));
    let window = Window { x: 0, y: 0, width, height };
    let batch = time("inputs", repeats, || -> Result<Batch> { Ok(Batch::of(&record, window, &selection, &Augmentation::NONE)) })?;
    let mut batches: Vec<Batch> = (0..repeats).map(|_| batch.clone()).collect();
    let drawn = time("network", repeats, || -> Result<_> { Ok(network.draw_batch(batches.pop().ok_or("no batch")?)?) })?;
    time("of that, the head", repeats, || -> Result<_> { Ok(batch.picture(0, &drawn.fine, &drawn.coarse).draw()) })?;
    let pixels = time("record to picture", repeats, || network.render(&record))?;
    let bytes: Vec<u8> = pixels.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
    println!("picture {}", &blake3::hash(&bytes).to_hex()[..16]);
    Ok(())
}

/// Prints the least milliseconds of `repeats` runs, and returns what the last one made.
fn time<T, E>(what: &str, repeats: usize, mut f: impl FnMut() -> std::result::Result<T, E>) -> std::result::Result<T, E> {
    let (mut least, mut made) = (f64::INFINITY, None);
    for _ in 0..repeats.max(1) {
        let start = Instant::now();
        let result = std::hint::black_box(f()?);
        least = least.min(start.elapsed().as_secs_f64());
        made = Some(result);
    }
    println!("{what:>20}: {:7.2} ms", 1e3 * least);
    Ok(made.expect("at least one run"))
}
