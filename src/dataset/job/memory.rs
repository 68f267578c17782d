//! Estimates how much memory a frame takes while it is rendered, denoised and stored, before any of it is taken.

use crate::dataset::job::TruthSettings;
use crate::util::machine;
use anyhow::Result;
use renderflow_frame::channel::{LAYERS, Storage};
use renderflow_frame::frame_file::Profile;
use renderflow_renderer::Budget;

/// The denoiser keeps buffers and network for the next picture up to this many pixels.
const KEPT: u64 = 2048 * 2048;
/// Bytes that the program takes before it renders anything.
const PROGRAM: u64 = 40 << 20;

/// The most bytes that a frame of `width x height` pixels takes while it is made and stored, beyond the scene.
pub fn of_frame(settings: &TruthSettings, size: [usize; 2], light_paths: bool, storage: Profile) -> u64 {
    let pixels = (size[0] as u64).saturating_mul(size[1] as u64);
    let all = |bytes: u64| pixels.saturating_mul(bytes);
    let memory = settings.render.memory(size, light_paths, settings.render.spp == 0);
    let frame = memory.frame.saturating_add(if settings.distance { all(4) } else { 0 });
    let denoises = settings.denoiser_name().is_some();
    let [network, stays] = settings.denoising(pixels);
    let denoising = if denoises { frame.saturating_add(network) } else { 0 };
    let retained = if denoises && pixels <= KEPT { stays } else { 0 };
    let encoding = frame.saturating_add(retained).saturating_add(all(encoded(settings, storage)));
    // A watched picture is made in parts, which are merged.
    let parts = if settings.watch.is_some() { 2 } else { 1 };
    memory.tracing.saturating_mul(parts).max(denoising).max(encoding).saturating_add(PROGRAM)
}

/// Bytes for each pixel that encoding takes: the channels as they are stored, and the file.
fn encoded(settings: &TruthSettings, storage: Profile) -> u64 {
    let asked = |name: &str| match (name, name.strip_prefix("light.")) {
        ("irradiance", _) => settings.render.irradiance,
        ("indirect" | "hidden", _) => settings.render.channels.paths,
        ("distance", _) => settings.distance,
        ("samples", _) => settings.render.budget != Budget::Uniform || settings.sample_map.is_some(),
        (_, Some(group)) => group.parse().is_ok_and(|group: u32| group < settings.render.light_groups),
        _ => true,
    };
    let layers = LAYERS.iter().filter(|layer| asked(layer.name));
    let bytes = |storage: Storage| if storage == Storage::Half { 2 } else { 4 };
    let stored: u64 = layers.map(|layer| layer.components.len() as u64 * bytes(layer.storage)).sum();
    match storage {
        Profile::Full => 2 * stored,
        Profile::Compact => stored,
    }
}

/// Refuses frames that take more memory than is available.
///
/// # Errors
/// The message has both numbers, and ways to need less.
pub fn ensure(settings: &TruthSettings, size: [usize; 2], light_paths: bool, storage: Profile) -> Result<()> {
    let ways = [
        (true, "a smaller resolution"),
        (settings.render.light_groups > 0, "fewer light groups"),
        (settings.denoiser_name().is_some(), "no denoiser (denoise none)"),
        (light_paths, "no light paths (no-light-paths)"),
    ];
    let ways: Vec<&str> = ways.iter().filter(|(helps, _)| *helps).map(|&(_, way)| way).collect();
    let ways = match ways.split_last() {
        Some((last, rest)) if !rest.is_empty() => format!("{} or {last} takes less", rest.join(", ")),
        _ => format!("{} takes less", ways.concat()),
    };
    let what = format!("a frame of {} x {} pixels", size[0], size[1]);
    machine::ensure_memory(&what, of_frame(settings, size, light_paths, storage), &ways)
}
