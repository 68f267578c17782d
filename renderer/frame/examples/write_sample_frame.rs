//! Writes a small frame with every channel, for other programs to read:
//! `cargo run -p renderflow-frame --example write_sample_frame -- frame.exr`

#[path = "../tests/common/mod.rs"]
mod common;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::args_os().nth(1).ok_or("usage: write_sample_frame FILE.exr")?;
    renderflow_frame::exr::write(path.as_ref(), &common::frame(24, 18))?;
    Ok(())
}
