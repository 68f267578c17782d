//! Named families of environments: valid, finite, distinct, closed around the eye, and as bright as the paper says where that is known.

use renderflow_frame::color::luminance;
use renderflow_frame::image::Rgb;
use renderflow_scenes::seed::Seed;
use renderflow_scenes::sky::{self, ENVIRONMENTS, Sky};
use std::f64::consts::{PI, TAU};
use std::path::PathBuf;
use std::time::Instant;

fn draw(name: &str, k: u64) -> Sky {
    sky::random_of(name, &mut Seed::root(2026).child(name, k).rng()).expect("a known family")
}

fn solid_angle(map: &Rgb, y: usize) -> f64 {
    let (top, bottom) = (PI * y as f64 / map.height as f64, PI * (y + 1) as f64 / map.height as f64);
    TAU / map.width as f64 * (top.cos() - bottom.cos())
}

/// Luminance integrated over the sphere.
fn flux(map: &Rgb) -> f64 {
    let row = |y: usize| (0..map.width).map(|x| f64::from(luminance(*map.at(x, y)))).sum::<f64>() * solid_angle(map, y);
    (0..map.height).map(row).sum()
}

/// Mean of the squared luminance over the square of its mean.
fn concentration(map: &Rgb) -> f64 {
    let row = |y: usize| (0..map.width).map(|x| f64::from(luminance(*map.at(x, y))).powi(2)).sum::<f64>() * solid_angle(map, y);
    (0..map.height).map(row).sum::<f64>() * 4.0 * PI / flux(map).powi(2)
}

/// Writes contact sheets of tone-mapped maps into the folder RENDERFLOW_SHEETS, and prints a table.
#[test]
#[ignore = "writes pictures to look at"]
fn contact_sheets() {
    let folder = PathBuf::from(std::env::var("RENDERFLOW_SHEETS").expect("RENDERFLOW_SHEETS names a folder"));
    std::fs::create_dir_all(&folder).expect("folder");
    let (columns, width, height) = (6usize, 320usize, 160usize);
    for (page, names) in ENVIRONMENTS.chunks(7).enumerate() {
        let mut sheet = image::RgbImage::new((columns * (width + 4)) as u32, (names.len() * (height + 4)) as u32);
        for (row, name) in names.iter().enumerate() {
            for column in 0..columns {
                let map = sky::render(&draw(name, column as u64), width, height);
                let mut sorted: Vec<f32> = map.pixels.iter().map(|&p| luminance(p)).collect();
                sorted.sort_by(f32::total_cmp);
                let white = sorted[sorted.len() * 9 / 10].max(1e-6);
                for (i, pixel) in map.pixels.iter().enumerate() {
                    let tone = |v: f32| {
                        let x = 0.6 * v / white;
                        let y = x * (1.0 + x / 9.0) / (1.0 + x);
                        (y.min(1.0).powf(1.0 / 2.2) * 255.0).round() as u8
                    };
                    let at = ((column * (width + 4) + i % width) as u32, (row * (height + 4) + i / width) as u32);
                    sheet.put_pixel(at.0, at.1, image::Rgb(pixel.map(tone)));
                }
            }
        }
        sheet.save(folder.join(format!("sheet-{page:02}.png"))).expect("PNG");
    }
    for name in ENVIRONMENTS {
        let maps: Vec<Rgb> = (0..16).map(|k| sky::render(&draw(name, k), 128, 64)).collect();
        let means: Vec<f64> = maps.iter().map(|map| flux(map) / (4.0 * PI)).collect();
        let strong: Vec<f64> = maps.iter().map(concentration).collect();
        let range = |v: &[f64]| (v.iter().copied().fold(f64::MAX, f64::min), v.iter().copied().fold(0.0, f64::max));
        println!("{name:18} mean luminance {:.3?} concentration {:.1?}", range(&means), range(&strong));
    }
}

/// Prints the time a map of every family takes on one core.
#[test]
#[ignore = "a measurement"]
fn time_of_a_map() {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("pool");
    let mut all = 0.0;
    for name in ENVIRONMENTS {
        let skies: Vec<Sky> = (0..4).map(|k| draw(name, k)).collect();
        let start = Instant::now();
        pool.install(|| skies.iter().for_each(|sky| assert!(!sky::render(sky, 256, 128).pixels.is_empty())));
        let mean = start.elapsed().as_secs_f64() * 250.0;
        println!("{name:18} {mean:.1} ms");
        all += mean;
    }
    println!("mean over families {:.1} ms", all / ENVIRONMENTS.len() as f64);
}
