//! Scenes and models: loaded and compiled as for rendering.

use super::Counts;
use anyhow::Result;
use glam::DVec3;
use renderflow_frame::reach::Reach;
use renderflow_renderer::RenderScene;
use renderflow_scenes::description::{EnvironmentSource, Scene, Transform};
use renderflow_scenes::load::{self, ModelView};
use renderflow_scenes::{LoadedScene, Texture};
use serde_json::json;
use std::path::Path;

/// A scene description with everything it refers to.
pub(super) fn scene(path: &Path, reach: &Reach) -> Result<Counts> {
    let loaded = load::load(&Scene::read(path)?, reach)?;
    let mut counts = counts(&loaded)?;
    counts.add("frames", loaded.cameras.len());
    let map = &loaded.environment.map;
    counts.add("environment", json!([map.width, map.height]));
    counts.add("repaired_texels", loaded.report.repaired_texels);
    Ok(counts)
}

/// A model file alone, where and as large as it stands in the file.
pub(super) fn model(path: &Path, reach: &Reach) -> Result<Counts> {
    let environment = EnvironmentSource::Constant([1.0; 3]);
    let view = ModelView { ground: false, frames: 1, environment, ..ModelView::default() };
    let mut scene = load::describe_model(path, None, &view, reach)?;
    for object in &mut scene.objects {
        object.transform = Transform::default();
    }
    let mut counts = counts(&load::load(&scene, reach)?)?;
    let contents = load::contents(path, reach)?;
    counts.add("cameras", contents.cameras.len());
    counts.add("animations", contents.animations.len());
    Ok(counts)
}

fn counts(loaded: &LoadedScene) -> Result<Counts> {
    // What loads may still be refused by the renderer.
    let compiled = RenderScene::compile(loaded)?;
    let meshes = || loaded.instances.iter().map(|i| &loaded.meshes[i.mesh]);
    let emitters = loaded.instances.iter().filter(|i| loaded.materials[i.material].emissive != [0.0; 3]);
    let mut found = Counts::default();
    found.add("instances", loaded.instances.len());
    found.add("meshes", loaded.meshes.len());
    found.add("vertices", loaded.meshes.iter().map(|m| m.positions.len()).sum::<usize>());
    found.add("triangles", meshes().map(|m| m.triangles.len()).sum::<usize>());
    let dropped = loaded.report.triangles;
    found.add("dropped_out_of_range", dropped.out_of_range);
    found.add("dropped_not_finite", dropped.not_finite);
    found.add("dropped_without_area", dropped.no_area);
    found.add("dropped_duplicate", dropped.duplicate);
    found.add("dropped_by_compiling", compiled.dropped_triangles());
    found.add("needles", dropped.needles);
    found.add("materials", loaded.materials.len());
    found.add("alpha_masked", loaded.report.alpha_masked);
    found.add("blended", loaded.report.blended);
    found.add("textures", loaded.textures.len());
    found.add("texture_bytes", loaded.textures.iter().map(Texture::bytes).sum::<usize>());
    found.add("emissive_triangles", emitters.map(|i| loaded.meshes[i.mesh].triangles.len()).sum::<usize>());
    if !loaded.lights.is_empty() {
        found.add("lights", loaded.lights.len());
    }
    if let Some((low, high)) = extents(loaded) {
        found.add("low", json!(low.to_array()));
        found.add("high", json!(high.to_array()));
    }
    found.notes.clone_from(&loaded.report.notes);
    Ok(found)
}

/// Corners of the box around all triangles at frame 0, metres in the world; `None` without any triangle.
fn extents(loaded: &LoadedScene) -> Option<(DVec3, DVec3)> {
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for instance in &loaded.instances {
        let (mesh, transform) = (&loaded.meshes[instance.mesh], instance.transform(0));
        for &vertex in mesh.triangles.iter().flatten() {
            let p = transform.transform_point3a(mesh.positions[vertex as usize].into()).as_dvec3() + loaded.origin;
            (low, high) = (low.min(p), high.max(p));
        }
    }
    (low.x <= high.x).then_some((low, high))
}
