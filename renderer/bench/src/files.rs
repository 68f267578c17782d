//! `renderflow-bench files`: bytes and seconds of frames as OpenEXR and in the compact form.

use crate::Machine;
use anyhow::Result;
use clap::Args;
use renderflow::metrics::median;
use renderflow::util::cancel::Interrupted;
use renderflow::util::progress::Progress;
use renderflow_frame::{Frame, compact, exr, file, frame_file};
use serde::Serialize;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// Bytes and loading time of frames: the OpenEXR as it is, the compact form, and an OpenEXR with just the channels of the compact
/// form. The files are in memory, and one thread decodes them; times are medians over rounds that take the three in turn. Writes
/// files.json.
#[derive(Args)]
#[command(after_help = "Example: renderflow-bench files out/frame.0000.exr out/frame.0001.exr --out bench")]
pub struct Options {
    /// Frames of this program, OpenEXR
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// Rounds of each file
    #[arg(long, default_value_t = 21, value_parser = clap::value_parser!(u32).range(1..=1000))]
    rounds: u32,
    /// Folder for the results
    #[arg(long, default_value = "bench")]
    out: PathBuf,
}

/// Bytes and seconds of one frame: as it is, with the channels of the compact form, and compact.
#[derive(Serialize)]
struct Row {
    file: PathBuf,
    bytes: [usize; 3],
    /// Median seconds of decoding.
    decode: [f64; 3],
    /// Seconds of encoding the compact form.
    encode: f64,
}

#[derive(Serialize)]
struct Results {
    machine: Machine,
    rows: Vec<Row>,
}

impl Options {
    /// Measures and prints.
    ///
    /// # Errors
    /// When a file is no frame, the results cannot be written, or it was interrupted.
    pub fn run(self, cancel: &AtomicBool) -> Result<()> {
        let progress = Progress::new("files", self.files.len() as u64);
        let mut rows = Vec::new();
        for path in &self.files {
            if cancel.load(Ordering::Relaxed) {
                return Err(Interrupted.into());
            }
            rows.push(self.row(path)?);
            progress.add(1);
        }
        progress.finish();
        println!(
            "{:>10} {:>10} {:>10}  {:>8} {:>8} {:>8}  {:>8}  file",
            "exr B", "same B", "rff B", "exr ms", "same ms", "rff ms", "write ms"
        );
        for Row { file, bytes: [a, b, c], decode, encode } in &rows {
            let [x, y, z] = decode.map(|seconds| 1e3 * seconds);
            println!("{a:>10} {b:>10} {c:>10}  {x:>8.2} {y:>8.2} {z:>8.2}  {:>8.1}  {}", 1e3 * encode, file.display());
        }
        let bytes = |i: usize| rows.iter().map(|row| row.bytes[i]).sum::<usize>() as f64;
        let seconds = |i: usize| rows.iter().map(|row| row.decode[i]).sum::<f64>();
        let percent = |of: usize| 100.0 * bytes(2) / bytes(of);
        println!("compact: {:.1} % of the bytes of the whole files, {:.1} % on equal channels", percent(0), percent(1));
        let [whole, same] = [0, 1].map(|i| seconds(i) / seconds(2));
        println!("loading: {whole:.1} x faster than the whole files, {same:.1} x on equal channels");
        let path = self.out.join("files.json");
        std::fs::create_dir_all(&self.out)?;
        file::write_json(&path, &Results { machine: Machine::current(), rows })?;
        println!("{}", path.display());
        Ok(())
    }

    fn row(&self, path: &std::path::Path) -> Result<Row> {
        let whole = file::read(path)?;
        let frame = frame_file::decode(path, &whole)?;
        let started = Instant::now();
        let (small, _) = compact::encode(path, &frame)?;
        let encode = started.elapsed().as_secs_f64();
        let (same, _) = exr::encode(path, &training(frame))?;
        let forms = [&whole, &same, &small];
        let mut times = [const { Vec::new() }; 3];
        for _ in 0..self.rounds {
            for (bytes, times) in forms.iter().zip(&mut times) {
                let started = Instant::now();
                std::hint::black_box(frame_file::decode(path, bytes)?);
                times.push(started.elapsed().as_secs_f64());
            }
        }
        Ok(Row { file: path.to_owned(), bytes: forms.map(Vec::len), decode: times.map(|t| median(&t)), encode })
    }
}

/// The layers that the compact form keeps.
fn training(frame: Frame) -> Frame {
    Frame { raw: None, variance: None, samples: None, light: Default::default(), guide_albedo: None, guide_normal: None, ..frame }
}
