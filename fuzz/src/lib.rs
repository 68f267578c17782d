//! What the fuzz targets share.

use renderflow_renderer::RenderScene;
use renderflow_scenes::LoadedScene;
use std::cell::RefCell;
use std::path::{Path, PathBuf};

pub mod scenes;

thread_local! {
    static LAST_PANIC: RefCell<String> = const { RefCell::new(String::new()) };
}

/// Makes panics silent until they leave the target: readers that catch a library's panics by design would else end the run,
/// because libfuzzer-sys aborts inside the panic hook. What leaves the target still ends it.
pub fn catch_in_readers() {
    std::panic::set_hook(Box::new(|info| LAST_PANIC.with(|last| *last.borrow_mut() = info.to_string())));
}

/// Runs a target; a panic that leaves it is printed and ends the process, for the fuzzer to see.
pub fn watch(target: impl FnOnce()) {
    if std::panic::catch_unwind(std::panic::AssertUnwindSafe(target)).is_err() {
        LAST_PANIC.with(|last| eprintln!("{}", last.borrow()));
        std::process::abort();
    }
}

/// Folder for inputs of loaders that take paths: `RENDERFLOW_FUZZ_DIR` (best in memory), else one of this process.
pub fn folder() -> PathBuf {
    let folder = match std::env::var_os("RENDERFLOW_FUZZ_DIR") {
        Some(folder) => PathBuf::from(folder),
        None => std::env::temp_dir().join(format!("renderflow-fuzz-{}", std::process::id())),
    };
    std::fs::create_dir_all(&folder).expect("the folder for inputs can be made");
    folder
}

/// Writes an input.
pub fn put(path: &Path, bytes: &[u8]) {
    std::fs::write(path, bytes).expect("an input can be written");
}

/// An error must say which file it is about.
pub fn names_file(error: impl std::fmt::Display, name: &str) {
    let message = error.to_string();
    assert!(message.contains(name), "the message does not name {name}: {message}");
}

/// What a renderer relies on in a loaded scene, and that it compiles.
pub fn check_scene(scene: &LoadedScene) {
    for mesh in &scene.meshes {
        let count = mesh.positions.len();
        assert!(mesh.triangles.iter().flatten().all(|&v| (v as usize) < count), "an index leaves the vertices");
        assert!(mesh.positions.iter().all(|p| p.is_finite()), "a position is not finite");
        assert!(mesh.normals.is_empty() || mesh.normals.len() == count, "normals are missing");
        assert!(mesh.normals.iter().all(|n| (n.length() - 1.0).abs() < 1e-3), "a normal is not unit");
        assert!(mesh.uvs.is_empty() || mesh.uvs.len() == count, "coordinates are missing");
        assert!(mesh.uvs.iter().all(|uv| uv.is_finite()), "a coordinate is not finite");
        assert!(mesh.tangents.is_empty() || mesh.tangents.len() == count, "tangents are missing");
        let unit = |t: &glam::Vec4| (t.truncate().length() - 1.0).abs() < 1e-3 && t.w.abs() == 1.0;
        assert!(mesh.tangents.iter().all(unit), "a tangent is not unit");
    }
    for instance in &scene.instances {
        assert!(instance.mesh < scene.meshes.len() && instance.material < scene.materials.len());
        assert!(!instance.transforms.is_empty() && instance.transforms.iter().all(|t| t.is_finite()), "a transform is not finite");
    }
    for material in &scene.materials {
        let values = material.base_color.iter().chain([&material.metallic, &material.roughness, &material.specular]);
        assert!(values.clone().all(|v| (0.0..=1.0).contains(v)), "a material is out of range");
        assert!(material.emissive.iter().all(|v| v.is_finite() && *v >= 0.0), "emission is out of range");
        let slots = [&material.base_color_texture, &material.metallic_roughness_texture].into_iter().flatten();
        for slot in slots.chain(material.normal_texture.as_ref().map(|(slot, _)| slot)) {
            assert!(slot.texture < scene.textures.len(), "a texture does not exist");
            assert!(slot.uv_transform.is_finite(), "a coordinate transform is not finite");
        }
        assert!(material.normal_texture.as_ref().is_none_or(|(_, scale)| scale.is_finite()), "a normal scale is not finite");
    }
    for texture in &scene.textures {
        let image = &texture.image;
        assert!(image.width > 0 && image.height > 0 && image.pixels.len() == image.width * image.height);
        assert!(image.pixels.iter().flatten().all(|v| v.is_finite()), "a texel is not finite");
    }
    let texels = scene.environment.map.pixels.iter().flatten();
    assert!(texels.clone().all(|v| v.is_finite() && *v >= 0.0), "the environment is out of range");
    for camera in &scene.cameras {
        let intrinsics = [camera.fl_x, camera.fl_y, camera.cx, camera.cy];
        assert!(camera.camera_to_world.is_finite() && intrinsics.iter().all(|v| v.is_finite()), "a camera is not finite");
    }
    // An error is an answer; a panic is not.
    if let Ok(compiled) = RenderScene::compile(scene) {
        assert!(compiled.triangle_count() <= scene.instances.iter().map(|i| scene.meshes[i.mesh].triangles.len()).sum());
    }
}
