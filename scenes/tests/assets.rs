//! Every file of the shared assets, damaged and hostile ones included: loaded, or refused by an error that names it, within
//! bounded memory and time. One test, so that the memory counted is one file's.

mod common;

use common::anywhere;
use common::{asset, assets_below, empty_scene, grey, model_scene};
use peak_alloc::PeakAlloc;
use renderflow_frame::{exr, hdr};
use renderflow_scenes::description::Scene;
use renderflow_scenes::{LoadedScene, load};
use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, Instant};

#[global_allocator]
static MEMORY: PeakAlloc = PeakAlloc;

/// Most bytes that loading one file may hold at a time; a single allocation cannot exceed it either.
const MOST_BYTES: usize = 1 << 30;
/// Longest that loading one file may take: a hang. The slowest takes a tenth of it.
const LONGEST: Duration = Duration::from_secs(5);

/// Processor time of this process so far, all threads: unlike a clock it does not depend on what else the machine does.
fn busy() -> Option<Duration> {
    // proc(5): fields 14 and 15 are user and system time in hundredths of a second; the name before them may hold blanks.
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    let mut fields = stat.rsplit(')').next()?.split_whitespace().skip(11);
    let mut next = || fields.next()?.parse::<u64>().ok();
    Some(Duration::from_millis(10 * (next()? + next()?)))
}

/// What a renderer relies on.
fn check(scene: &LoadedScene) {
    for mesh in &scene.meshes {
        let count = mesh.positions.len();
        assert!(mesh.triangles.iter().flatten().all(|&v| (v as usize) < count));
        assert!(mesh.positions.iter().all(|p| p.is_finite()) && mesh.uvs.iter().all(|uv| uv.is_finite()));
        assert!(mesh.normals.iter().all(|n| (n.length() - 1.0).abs() < 1e-3));
        assert!(mesh.tangents.iter().all(|t| (t.truncate().length() - 1.0).abs() < 1e-3 && t.w.abs() == 1.0));
        assert!([mesh.normals.len(), mesh.uvs.len(), mesh.tangents.len()].iter().all(|&n| n == 0 || n == count));
    }
    for instance in &scene.instances {
        assert!(instance.mesh < scene.meshes.len() && instance.material < scene.materials.len());
        assert!(instance.transforms.iter().all(|t| t.is_finite()));
    }
    for material in &scene.materials {
        assert_eq!(material.surface.out_of_range(), None);
        assert!(material.emissive.iter().all(|v| v.is_finite() && *v >= 0.0));
    }
}

fn model(scene: &Scene) -> Result<(), String> {
    load::load(scene, &anywhere()).map(|loaded| check(&loaded)).map_err(|e| e.to_string())
}

/// The file as colour, data and normal map.
fn image(path: &Path) -> Result<(), String> {
    let file = path.to_str().map(str::to_owned);
    let mut material = grey("m");
    material.base_color_texture.clone_from(&file);
    material.metallic_roughness_texture.clone_from(&file);
    material.normal_texture = file;
    model(&Scene { materials: vec![material], ..empty_scene() })
}

/// Every reader of pictures; accepted where one takes the file, else what the reader of environments says.
fn picture(path: &Path) -> Result<(), String> {
    let frame = exr::read(path).map(|frame| assert_eq!(frame.depth.pixels.len(), frame.width * frame.height));
    let rgb = exr::read_rgb(path).map(|rgb| assert_eq!(rgb.pixels.len(), rgb.width * rgb.height));
    let map = hdr::read(path).map(|map| assert!(map.map.pixels.iter().flatten().all(|v| v.is_finite() && *v >= 0.0)));
    frame.or(rgb).or(map).map_err(|e| e.to_string())
}

#[test]
fn every_asset_is_loaded_or_refused_by_name() {
    let mut counts: BTreeMap<String, [usize; 2]> = BTreeMap::new();
    let (mut slowest, mut largest) = ((Duration::ZERO, String::new()), (0, String::new()));
    for kind in ["gltf", "obj", "exr", "hdri"] {
        let Some(root) = asset(kind) else { return };
        for path in assets_below(kind, &[]) {
            let name = path.file_name().and_then(|n| n.to_str()).unwrap_or_default().to_owned();
            let ending = path.extension().and_then(|e| e.to_str()).unwrap_or(kind).to_ascii_lowercase();
            let held = MEMORY.current_usage();
            MEMORY.reset_peak_usage();
            let (start, start_busy) = (Instant::now(), busy());
            let result = match (kind, ending.as_str()) {
                ("gltf" | "obj", "png" | "jpg") => image(&path),
                // Buffers and material libraries are refused as models by their ending.
                ("gltf" | "obj", _) => model(&model_scene(&path, None)),
                _ => picture(&path),
            };
            let time = busy().zip(start_busy).map_or_else(|| start.elapsed(), |(end, start)| end - start);
            let bytes = MEMORY.peak_usage().saturating_sub(held);
            let place = path.strip_prefix(&root).unwrap_or(&path).display().to_string();
            assert!(time < LONGEST, "{kind}/{place} took {time:?}");
            assert!(bytes < MOST_BYTES, "{kind}/{place} took {bytes} bytes");
            if let Err(message) = &result {
                // A texture that cannot be used is named itself, with the material that wants it.
                let named = message.contains(&name) || message.contains("cannot use texture");
                assert!(named, "{kind}/{place} is not named in {message:?}");
                let reason = message.rsplit(": ").next().unwrap_or_default();
                assert!(reason.len() > 5 && reason != name, "no reason in {message:?}");
            }
            let ending = if ending.len() > 4 { "damaged exr".to_owned() } else { ending };
            counts.entry(format!("{kind} .{ending}")).or_default()[usize::from(result.is_err())] += 1;
            slowest = slowest.max((time, place.clone()));
            largest = largest.max((bytes, place));
        }
    }
    for (kind, [accepted, refused]) in &counts {
        println!("{kind:20} {accepted:4} loaded {refused:4} refused");
    }
    println!("slowest: {:?} {}; most memory: {} MB {}", slowest.0, slowest.1, largest.0 >> 20, largest.1);
    let loaded: usize = counts.values().map(|[accepted, _]| accepted).sum();
    let refused: usize = counts.values().map(|[_, refused]| refused).sum();
    println!("all: {loaded} loaded, {refused} refused");
    assert!(loaded > 100 && refused > 20, "{loaded} loaded, {refused} refused: are these the files?");
}
