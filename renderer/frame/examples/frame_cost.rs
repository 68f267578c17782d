//! Bytes and loading time of frame files, whole and compact: `cargo run --release -p renderflow-frame --example frame_cost -- FILE.exr...`
//!
//! For each file: the OpenEXR as it is, the compact form, and an OpenEXR with just the channels of the compact form. Files are in memory, one thread;
//! times are medians over rounds that take the three in turn (A B C A B C ...).

use renderflow_frame::{Frame, compact, exr, frame_file};
use std::path::Path;
use std::time::Instant;

/// Rounds of each file.
const ROUNDS: usize = 21;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut sums = [(0usize, 0.0f64); 3];
    let files: Vec<_> = std::env::args_os().skip(1).collect();
    if files.is_empty() {
        return Err("usage: frame_cost FILE.exr...".into());
    }
    println!(
        "{:>10} {:>10} {:>10}  {:>8} {:>8} {:>8}  {:>8}  file",
        "exr B", "same B", "rff B", "exr ms", "same ms", "rff ms", "write ms"
    );
    for file in &files {
        let path = Path::new(file);
        let whole = std::fs::read(path)?;
        let frame = frame_file::decode(path, &whole)?;
        let started = Instant::now();
        let (small, _) = compact::encode(path, &frame)?;
        let writing = 1e3 * started.elapsed().as_secs_f64();
        let (same, _) = exr::encode(path, &training(frame))?;
        let files = [&whole, &same, &small];
        let mut times = [const { Vec::new() }; 3];
        for _ in 0..ROUNDS {
            for (bytes, times) in files.iter().zip(&mut times) {
                let started = Instant::now();
                std::hint::black_box(frame_file::decode(path, bytes)?);
                times.push(1e3 * started.elapsed().as_secs_f64());
            }
        }
        let medians = times.map(|mut times| {
            times.sort_by(f64::total_cmp);
            times[ROUNDS / 2]
        });
        for ((sum, bytes), time) in sums.iter_mut().zip(files).zip(medians) {
            *sum = (sum.0 + bytes.len(), sum.1 + time);
        }
        let [a, b, c] = files.map(Vec::len);
        println!(
            "{a:>10} {b:>10} {c:>10}  {:>8.2} {:>8.2} {:>8.2}  {writing:>8.1}  {}",
            medians[0],
            medians[1],
            medians[2],
            path.display()
        );
    }
    let [whole, same, small] = sums;
    let percent = |of: (usize, f64)| 100.0 * small.0 as f64 / of.0 as f64;
    println!("compact: {:.1} % of the bytes of the whole files, {:.1} % on equal channels", percent(whole), percent(same));
    println!("loading: {:.1} x faster than the whole files, {:.1} x on equal channels", whole.1 / small.1, same.1 / small.1);
    Ok(())
}

/// The layers that the compact form keeps.
fn training(frame: Frame) -> Frame {
    Frame { raw: None, variance: None, samples: None, light: Default::default(), guide_albedo: None, guide_normal: None, ..frame }
}
