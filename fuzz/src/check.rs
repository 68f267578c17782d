//! What scenes must hold that a reader accepted.

use renderflow_renderer::RenderScene;
use renderflow_scenes::LoadedScene;
use renderflow_scenes::mipmap::Texels;

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
        assert!(mesh.colors.is_empty() || mesh.colors.len() == count, "colours are missing");
        let unit = |v: f32| (0.0..=1.0).contains(&v);
        assert!(mesh.colors.iter().all(|c| c.to_array().into_iter().all(unit)), "a colour is out of range");
        assert!(mesh.tangents.is_empty() || mesh.tangents.len() == count, "tangents are missing");
        let unit = |t: &glam::Vec4| (t.truncate().length() - 1.0).abs() < 1e-3 && t.w.abs() == 1.0;
        assert!(mesh.tangents.iter().all(unit), "a tangent is not unit");
    }
    for instance in &scene.instances {
        assert!(instance.mesh < scene.meshes.len() && instance.material < scene.materials.len());
        assert!(
            !instance.transforms.is_empty() && instance.transforms.iter().all(|t| t.is_finite()),
            "a transform is not finite"
        );
    }
    for material in &scene.materials {
        let m = material;
        assert!(m.surface.out_of_range().is_none(), "a material is out of range: {m:?}");
        assert!(m.alpha_mask.is_none_or(|mask| mask.cutoff.is_finite() && (0.0..=1.0).contains(&mask.factor)), "{m:?}");
        assert!(material.emissive.iter().all(|v| v.is_finite() && *v >= 0.0), "emission is out of range");
        assert!(m.opacity.is_none_or(|share| (0.0..=1.0).contains(&share) && m.alpha_mask.is_none()), "{m:?}");
        assert!(m.absorption.iter().all(|v| v.is_finite() && *v >= 0.0), "absorption is out of range: {m:?}");
        for slot in m.texture_slots() {
            assert!(slot.texture < scene.textures.len(), "a texture does not exist");
            assert!(slot.uv_transform.is_finite(), "a coordinate transform is not finite");
        }
        assert!(material.normal_texture.as_ref().is_none_or(|(_, scale)| scale.is_finite()), "a normal scale is not finite");
    }
    for texture in &scene.textures {
        assert!(!texture.levels.is_empty(), "a texture has no texels");
        for level in &*texture.levels {
            let count = match &level.texels {
                Texels::Bytes(texels) => texels.len(),
                Texels::Words(texels) => texels.len(),
            };
            assert!(count > 0 && count == level.width * level.height, "a level's size is not its number of texels");
        }
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
