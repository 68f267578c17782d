use anyhow::{Result, bail};
use clap::Args;
use renderflow_frame::{exr, hdr};
use renderflow_model::infer::NeuralRenderer;
use renderflow_scenes::{description::Scene, load};
use std::path::{Path, PathBuf};

/// Says of each file whether it can be read: scenes, models, environment maps, frames, weights.
#[derive(Args)]
#[command(after_help = "Example: renderflow check scene.json model.glb sky.hdr frame.0000.exr weights.safetensors")]
pub struct Check {
    /// Files
    #[arg(required = true)]
    files: Vec<PathBuf>,
}

impl Check {
    pub fn run(self) -> Result<()> {
        let mut refused = 0;
        for path in &self.files {
            match accept(path) {
                Ok(found) => println!("accepted {}: {found}", path.display()),
                Err(error) => {
                    refused += 1;
                    println!("refused  {}: {error:#}", path.display());
                }
            }
        }
        if refused > 0 {
            bail!("{refused} of {} files refused", self.files.len());
        }
        Ok(())
    }
}

fn accept(path: &Path) -> Result<String> {
    let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    Ok(match extension.as_str() {
        "json" => scene_counts(&Scene::read(path)?, &super::parent(path))?,
        "gltf" | "glb" | "obj" => scene_counts(&load::describe_model(path, None, &load::ModelView::default())?, Path::new("."))?,
        "hdr" => map_counts(path)?,
        "exr" => match exr::read(path) {
            Ok(frame) => format!("frame, {} x {}, {} spp", frame.width, frame.height, frame.info.spp),
            Err(frame_error) => {
                map_counts(path).map_err(|map_error| anyhow::anyhow!("{frame_error}; nor a map: {map_error:#}"))?
            }
        },
        "safetensors" => weights(path)?,
        _ => bail!("{}: unknown kind of file; known: json gltf glb obj hdr exr safetensors", path.display()),
    })
}

fn weights(path: &Path) -> Result<String> {
    let renderer = NeuralRenderer::load(path)?;
    let header = renderer.header();
    let keyframes = if renderer.accepts_keyframes() { "with" } else { "without" };
    Ok(format!("weights after {} steps, {keyframes} keyframe stage", header.steps))
}

fn scene_counts(scene: &Scene, base: &Path) -> Result<String> {
    let loaded = load::load(scene, base)?;
    let triangles: usize = loaded.instances.iter().map(|i| loaded.meshes[i.mesh].triangles.len()).sum();
    Ok(format!(
        "{} instances, {triangles} triangles, {} materials, {} textures, {} frames, {} triangles dropped",
        loaded.instances.len(),
        loaded.materials.len(),
        loaded.textures.len(),
        loaded.cameras.len(),
        loaded.report.triangles.dropped()
    ))
}

fn map_counts(path: &Path) -> Result<String> {
    let map = hdr::read(path)?;
    Ok(format!("map, {} x {}, {} texels repaired", map.map.width, map.map.height, map.repaired))
}
