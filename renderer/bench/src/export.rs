//! Scenes in a form that scripts of other renderers read with nothing but a JSON parser: `scene.json`, a PLY an object, the
//! environment as OpenEXR, textures as PNG.
//!
//! Positions and directions are in world space, +Y up, metres, with every transform applied. The direction of environment
//! coordinates (u to the right, v down) is that of [`renderflow_frame::Environment`]; its gain is in the texels, its rotation in
//! the file. Texture coordinates (0, 0) are at the first texel of the first row, with the material's transform applied.

mod maps;

use crate::kernels::rays;
use anyhow::{Context, Result, bail, ensure};
use exr::prelude::write_rgb_file;
use glam::{Mat3A, Vec3A};
use renderflow_frame::{Camera, file};
use renderflow_renderer::Clear;
use renderflow_renderer::accel::{Accel, Scratch};
use renderflow_renderer::material::{ggx, refraction_index};
use renderflow_renderer::ray::Ray;
use renderflow_scenes::loaded::{AlphaMask, Wrap};
use renderflow_scenes::{Instance, LoadedScene, Material, Mesh, Principled, Texture, TextureSlot};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What `scene.json` holds; every file is named relative to it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Exported {
    /// Name for messages.
    pub name: String,
    /// Surfaces a path may scatter at.
    pub max_bounces: u32,
    /// The camera.
    pub camera: View,
    /// OpenEXR, equirectangular.
    pub environment: String,
    /// Degrees the environment turns about +Y.
    pub environment_rotation: f32,
    /// Placed meshes.
    pub objects: Vec<ExportedObject>,
}

/// A pinhole camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct View {
    /// Position.
    pub eye: [f32; 3],
    /// A point ahead.
    pub target: [f32; 3],
    /// Up direction.
    pub up: [f32; 3],
    /// Degrees.
    pub vertical_fov: f32,
    /// Pixels.
    pub width: usize,
    /// Pixels.
    pub height: usize,
}

/// A mesh with its material.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExportedObject {
    /// Name, unique in the scene.
    pub name: String,
    /// Binary little-endian PLY of floats x y z, nx ny nz where `smooth`, u v where there are textures, and int triangles.
    pub mesh: String,
    /// Whether the mesh has shading normals.
    pub smooth: bool,
    /// Triangles.
    pub triangles: usize,
    /// Whether its back is there, too. Seen from behind, a surface that has none lets rays pass.
    pub double_sided: bool,
    /// Whether paths meet its back: renderers that shade the front alone must then be told.
    pub seen_from_behind: bool,
    /// Its material.
    pub material: ExportedMaterial,
}

/// Disney principled parameters. A texture stands in place of its parameter, factors applied.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExportedMaterial {
    /// Linear Rec.709.
    pub base_color: [f32; 3],
    /// The base colour is that of the vertices (`r`, `g`, `b` of the mesh, linear) instead.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub vertex_colors: bool,
    /// The other parameters by the names of scene files, those not at 0 and the common ones.
    pub parameters: BTreeMap<String, f32>,
    /// Radiance; one at which there is a texture `emissive`, which holds the radiance itself.
    pub emissive: [f32; 3],
    /// Whether it is Lambertian in our renderer, which the forms of other renderers are not for any parameters.
    pub lambertian: bool,
    /// Its clear part, if it has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clear: Option<ExportedClear>,
    /// Share of the surface that covers what lies behind it, if that is not everything; a texture `opacity` holds the share
    /// itself.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub opacity: Option<f32>,
    /// By parameter: `base_color` (PNG, sRGB), `roughness`, `metallic` (PNG, grey, linear), `normal` (PNG, tangent space),
    /// `opacity` (PNG, grey: 255 where the surface is, 0 in its holes; to be read without interpolation if there is no field
    /// `opacity`), `transmission` (PNG, grey, the share of the clear part), `emissive` (OpenEXR).
    pub textures: BTreeMap<String, ExportedTexture>,
}

/// What lets light through: a smooth or rough dielectric, coloured by the base colour each time that light crosses it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExportedClear {
    /// `body` (with air outside), `sheet` (rough, without an inside) or `pane` (a smooth sheet, which bends nothing).
    pub form: String,
    /// Share of the light that meets it, 0..=1; the rest meets the opaque material.
    pub share: f32,
    /// Index of refraction.
    pub ior: f32,
    /// GGX width, at least 0.001, which stands for smooth.
    pub alpha: f32,
    /// What the inside absorbs per metre.
    pub absorption: [f32; 3],
}

/// An image and what lies outside it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExportedTexture {
    /// Relative to `scene.json`.
    pub file: String,
    /// `repeat`, `mirror` or `clamp`.
    pub wrap: String,
}

/// Writes `scene` at frame 0 into `folder` for paths of `max_bounces` scattering events. Returns the path of `scene.json`.
///
/// # Errors
/// When the scene has something that the format does not (transforms that differ between the textures of a material, textures
/// that wrap differently along their axes, an off-centre image), or a file cannot be written.
pub fn write(scene: &LoadedScene, max_bounces: u32, folder: &Path) -> Result<PathBuf> {
    let mut writer = Writer { scene, folder, textures: BTreeMap::new() };
    // Rays of that test stop at the first surface; what lets light through shows the backs of others.
    let through = scene.materials.iter().any(|m| m.opacity.is_some() || clear_form(m) != Clear::No);
    let backs = if through { vec![true; scene.instances.len()] } else { seen_from_behind(scene) };
    let mut objects = Vec::new();
    for (index, (instance, behind)) in scene.instances.iter().zip(backs).enumerate() {
        if !is_nowhere(&scene.materials[instance.material]) {
            objects.push(writer.object(index, instance, behind).with_context(|| instance.name.clone())?);
        }
    }
    let environment = "sky.exr".to_owned();
    let map = &scene.environment.map;
    ensure!(!map.pixels.is_empty(), "the environment has no texels");
    let texel = |x: usize, y: usize| <(f32, f32, f32)>::from(map.at(x, y).map(|v| v * scene.environment.intensity));
    std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    let path = folder.join(&environment);
    // Some readers take no map of a single row or column.
    let (width, height) = (map.width.max(4), map.height.max(2));
    let texel = |x: usize, y: usize| texel(x * map.width / width, y * map.height / height);
    write_rgb_file(&path, width, height, texel).with_context(|| path.display().to_string())?;
    let exported = Exported {
        name: scene.name.clone(),
        max_bounces,
        camera: view(&scene.cameras[0])?,
        environment,
        environment_rotation: scene.environment.rotation.to_degrees(),
        objects,
    };
    let path = folder.join("scene.json");
    file::write_json(&path, &exported)?;
    Ok(path)
}

/// Makes `material` Lambertian; base colour, emission, normal map and holes stay.
pub fn make_lambertian(material: &mut Material) {
    (material.surface.metallic, material.surface.roughness, material.surface.specular) = (0.0, 0.0, 0.0);
    (material.surface.sheen, material.surface.clearcoat, material.surface.subsurface) = (0.0, 0.0, 0.0);
    material.metallic_roughness_texture = None;
}

/// Whether the conserving BRDF of `material` is a constant.
pub fn is_lambertian(material: &Material) -> bool {
    let Principled { metallic, roughness, specular, sheen, clearcoat, subsurface, .. } = material.surface;
    material.metallic_roughness_texture.is_none()
        && [metallic, roughness, specular, sheen, clearcoat, subsurface].iter().all(|v| *v == 0.0)
}

fn clear_form(material: &Material) -> Clear {
    Clear::of(&material.surface, material.thin_walled, material.metallic_roughness_texture.is_some())
}

/// The clear part of `m`.
fn clear(m: &Material) -> Result<Option<ExportedClear>> {
    let form = match clear_form(m) {
        Clear::No => return Ok(None),
        Clear::Body => "body",
        Clear::Sheet => "sheet",
        Clear::Pane => "pane",
    };
    if m.metallic_roughness_texture.is_some() {
        bail!("material {}: a clear surface with textures of metallic and roughness cannot be exported", m.name);
    }
    if m.normal_texture.is_some() && form == "pane" {
        bail!("material {}: a pane with a normal map cannot be exported", m.name);
    }
    Ok(Some(ExportedClear {
        form: form.to_owned(),
        share: m.surface.transmission * (1.0 - m.surface.metallic),
        ior: refraction_index(m.surface.specular),
        alpha: if form == "pane" { ggx::MIN_ALPHA } else { ggx::alpha(m.surface.roughness) },
        absorption: if form == "body" { m.absorption } else { [0.0; 3] },
    }))
}

/// Whether the alpha mask of `material` leaves nothing of it.
fn is_nowhere(material: &Material) -> bool {
    material.base_color_texture.is_none() && material.alpha_mask.is_some_and(|mask| mask.factor < mask.cutoff)
}

fn view(camera: &Camera) -> Result<View> {
    let (width, height) = (camera.width as f32, camera.height as f32);
    let centred = (camera.cx - 0.5 * width).abs() < 1e-3 && (camera.cy - 0.5 * height).abs() < 1e-3;
    ensure!(
        centred && (camera.fl_x / camera.fl_y - 1.0).abs() < 1e-5,
        "the camera's image is not centred or its pixels are not square"
    );
    let axes: Mat3A = camera.camera_to_world.matrix3;
    Ok(View {
        eye: camera.position().to_array(),
        target: (camera.position() - axes.z_axis).to_array(),
        up: axes.y_axis.to_array(),
        vertical_fov: (2.0 * (0.5 * height / camera.fl_y).atan()).to_degrees(),
        width: camera.width,
        height: camera.height,
    })
}

/// Of every instance, whether camera rays or one bounce of them meet its back.
fn seen_from_behind(scene: &LoadedScene) -> Vec<bool> {
    let (mut triangles, mut owners) = (Vec::new(), Vec::new());
    for (index, instance) in scene.instances.iter().enumerate() {
        let before = triangles.len();
        triangles.extend(placed(scene, instance));
        owners.resize(triangles.len() - before + owners.len(), index);
    }
    let accel = Accel::build(&triangles);
    let mut scratch = Scratch::default();
    let mut behind = vec![false; scene.instances.len()];
    let camera = scene.cameras[0].resized(256, 256);
    for [origin, direction] in rays::make(&camera, &triangles, &accel).into_iter().flat_map(|set| set.rays) {
        if let Some(hit) = accel.closest(&Ray::new(origin, direction), &mut scratch) {
            let [a, b, c] = triangles[hit.primitive as usize];
            behind[owners[hit.primitive as usize]] |= (b - a).cross(c - a).dot(direction) > 0.0;
        }
    }
    behind
}

/// Triangles of an instance at frame 0, world space; those with corners that are not finite are points.
fn placed<'a>(scene: &'a LoadedScene, instance: &'a Instance) -> impl Iterator<Item = [Vec3A; 3]> + 'a {
    let (mesh, transform) = (&scene.meshes[instance.mesh], instance.transform(0));
    let place = move |v: u32| transform.transform_point3a(mesh.positions[v as usize].into());
    mesh.triangles.iter().map(move |t| t.map(place)).map(|t| if t.iter().all(|v| v.is_finite()) { t } else { [Vec3A::ZERO; 3] })
}

struct Writer<'a> {
    scene: &'a LoadedScene,
    folder: &'a Path,
    /// Texture by what went into it.
    textures: BTreeMap<String, ExportedTexture>,
}

impl Writer<'_> {
    fn object(&mut self, index: usize, instance: &Instance, seen_from_behind: bool) -> Result<ExportedObject> {
        let mesh = &self.scene.meshes[instance.mesh];
        let material = &self.scene.materials[instance.material];
        let (mut exported, uvs) = self.material(material)?;
        exported.vertex_colors = !mesh.colors.is_empty();
        let covers = material.opacity.is_some() || material.alpha_mask.is_some();
        if exported.vertex_colors && (material.base_color_texture.is_some() || covers) {
            bail!("material {}: colours of vertices cannot be exported with a texture or an opacity", material.name);
        }
        let base = material.surface.base_color;
        let name = format!("meshes/{index:03}.ply");
        file::write_atomic(&self.folder.join(&name), &ply(mesh, instance, uvs, base))?;
        Ok(ExportedObject {
            name: instance.name.clone(),
            mesh: name,
            smooth: !mesh.normals.is_empty(),
            triangles: mesh.triangles.len(),
            double_sided: material.double_sided || clear_form(material) == Clear::Body,
            seen_from_behind,
            material: exported,
        })
    }

    /// The material, and a slot whose transform is to be applied to the texture coordinates.
    fn material<'m>(&mut self, m: &'m Material) -> Result<(ExportedMaterial, Option<&'m TextureSlot>)> {
        let normal = m.normal_texture.as_ref();
        let slots: Vec<&TextureSlot> = m.texture_slots().collect();
        let slot = slots.first().copied();
        if slots.iter().any(|other| slot.is_some_and(|slot| slot.uv_transform != other.uv_transform)) {
            bail!("material {}: textures with different transforms cannot be exported", m.name);
        }
        let clear = clear(m)?;
        let mut textures = BTreeMap::new();
        let base_color = m.surface.base_color.to_array();
        if let Some(slot) = &m.base_color_texture {
            let color = |texture: &_| maps::png(texture, [0, 1, 2], base_color);
            textures.insert("base_color".into(), self.texture(slot, &format!("{base_color:?}"), "png", color)?);
            if let Some(AlphaMask { cutoff, factor }) = m.alpha_mask {
                let holes = |texture: &_| maps::opacity(texture, cutoff, factor);
                textures.insert("opacity".into(), self.texture(slot, &format!("mask {cutoff} {factor}"), "png", holes)?);
            }
        }
        if let (Some(slot), Some(factor)) = (&m.base_color_texture, m.opacity) {
            let covers = |texture: &_| maps::png(texture, [3], [factor]);
            textures.insert("opacity".into(), self.texture(slot, &format!("covers {factor}"), "png", covers)?);
        }
        if let (Some(slot), Some(clear)) = (&m.transmission_texture, &clear) {
            let share = |texture: &_| maps::png(texture, [0], [clear.share]);
            textures.insert("transmission".into(), self.texture(slot, &format!("share {}", clear.share), "png", share)?);
        }
        if let Some(slot) = &m.metallic_roughness_texture {
            for (name, channel, factor) in [("roughness", 1, m.surface.roughness), ("metallic", 2, m.surface.metallic)] {
                let grey = |texture: &_| maps::png(texture, [channel], [factor]);
                textures.insert(name.into(), self.texture(slot, &format!("{channel} {factor}"), "png", grey)?);
            }
        }
        if let Some((slot, scale)) = normal {
            let lean = |texture: &_| maps::normals(texture, *scale);
            textures.insert("normal".into(), self.texture(slot, &format!("normal {scale}"), "png", lean)?);
        }
        let mut emissive = m.emissive;
        if let Some(slot) = m.emissive_texture.as_ref().filter(|_| m.emissive != [0.0; 3]) {
            let light = |texture: &_| maps::radiance(texture, m.emissive);
            textures.insert("emissive".into(), self.texture(slot, &format!("light {:?}", m.emissive), "exr", light)?);
            emissive = [1.0; 3];
        }
        let always = [("metallic", m.surface.metallic), ("roughness", m.surface.roughness), ("specular", m.surface.specular)];
        let seldom = [
            ("specular_tint", m.surface.specular_tint),
            ("anisotropic", m.surface.anisotropic),
            ("sheen", m.surface.sheen),
            ("sheen_tint", if m.surface.sheen > 0.0 { m.surface.sheen_tint } else { 0.0 }),
            ("clearcoat", m.surface.clearcoat),
            ("clearcoat_gloss", if m.surface.clearcoat > 0.0 { m.surface.clearcoat_gloss } else { 0.0 }),
            ("subsurface", m.surface.subsurface),
        ];
        let parameters = always.into_iter().chain(seldom.into_iter().filter(|(_, value)| *value != 0.0));
        let parameters = parameters.map(|(name, value)| (name.to_owned(), value)).collect();
        let lambertian = is_lambertian(m);
        let (vertex_colors, opacity) = (false, m.opacity);
        let exported = ExportedMaterial { base_color, vertex_colors, parameters, emissive, lambertian, clear, opacity, textures };
        Ok((exported, slot))
    }

    /// Writes what `encode` makes of the texture of `slot`, once for each `key`, with the ending `ending`.
    fn texture(
        &mut self,
        slot: &TextureSlot,
        key: &str,
        ending: &str,
        encode: impl FnOnce(&Texture) -> Result<Vec<u8>>,
    ) -> Result<ExportedTexture> {
        let key = format!("{} {key}", slot.texture);
        if let Some(known) = self.textures.get(&key) {
            return Ok(known.clone());
        }
        let texture = &self.scene.textures[slot.texture];
        ensure!(texture.wrap[0] == texture.wrap[1], "{}: wraps differently along its axes", texture.name);
        let wrap = match texture.wrap[0] {
            Wrap::Repeat => "repeat",
            Wrap::Mirror => "mirror",
            Wrap::Clamp => "clamp",
        };
        let file = format!("textures/{:03}.{ending}", self.textures.len());
        file::write_atomic(&self.folder.join(&file), &encode(texture)?)?;
        let exported = ExportedTexture { file, wrap: wrap.to_owned() };
        self.textures.insert(key, exported.clone());
        Ok(exported)
    }
}

/// The placed mesh; texture coordinates transformed as `slot` says, if there is one, and colours times `base`.
fn ply(mesh: &Mesh, instance: &Instance, slot: Option<&TextureSlot>, base: Vec3A) -> Vec<u8> {
    let transform = instance.transform(0);
    let normal_matrix = transform.matrix3.inverse().transpose();
    let uvs = slot.filter(|slot| mesh.uv_set(slot.set).len() == mesh.positions.len());
    let mut header = format!("ply\nformat binary_little_endian 1.0\nelement vertex {}\n", mesh.positions.len());
    let mut names = vec!["x", "y", "z"];
    if !mesh.normals.is_empty() {
        names.extend(["nx", "ny", "nz"]);
    }
    if uvs.is_some() {
        names.extend(["u", "v"]);
    }
    if !mesh.colors.is_empty() {
        names.extend(["r", "g", "b"]);
    }
    names.iter().for_each(|name| header += &format!("property float {name}\n"));
    header += &format!("element face {}\nproperty list uchar int vertex_indices\nend_header\n", mesh.triangles.len());
    let mut bytes = header.into_bytes();
    for (index, p) in mesh.positions.iter().enumerate() {
        let mut put = |values: &[f32]| values.iter().for_each(|v| bytes.extend(v.to_le_bytes()));
        put(&transform.transform_point3a((*p).into()).to_array());
        if let Some(n) = mesh.normals.get(index) {
            put(&(normal_matrix * Vec3A::from(*n)).normalize_or_zero().to_array());
        }
        if let Some(slot) = uvs {
            put(&slot.uv_transform.transform_point2(mesh.uv_set(slot.set)[index]).to_array());
        }
        if let Some(color) = mesh.colors.get(index) {
            put(&(Vec3A::from_vec4(*color) * base).to_array());
        }
    }
    for triangle in &mesh.triangles {
        bytes.push(3);
        triangle.iter().for_each(|v| bytes.extend(v.to_le_bytes()));
    }
    bytes
}
