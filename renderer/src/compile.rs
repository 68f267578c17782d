//! Compiles a loaded scene: its geometry, material and light tables, and the features the scene needs.

use crate::accel::{Candidate, Hit, MAX_TRIANGLES, Scratch};
use crate::error::{Error, Result};
use crate::features::FeatureSet;
use crate::geometry::{Builds, Geometry, Sharing, Wanted};
use crate::light::{EnvironmentLight, Repairs, Sampling};
use crate::material::Surface;
use crate::ray::Ray;
use crate::texture::Sampled;
use glam::Vec3A;
use renderflow_frame::ibl::IblTables;
use renderflow_frame::{Camera, Environment};
use renderflow_scenes::mipmap::{Level, Texels};
use renderflow_scenes::{LoadedScene, Material, TextureSlot};
use std::sync::OnceLock;

/// A scene at one frame, ready to be rendered.
pub struct RenderScene {
    pub(crate) geometry: Geometry,
    pub(crate) materials: Vec<CompiledMaterial>,
    pub(crate) textures: Vec<Sampled>,
    pub(crate) light: EnvironmentLight,
    pub(crate) environment: Environment,
    pub(crate) seed: u64,
    pub(crate) hash: String,
    cameras: Vec<Camera>,
    frame: usize,
    features: FeatureSet,
    tables: OnceLock<IblTables>,
    exposure: OnceLock<f32>,
}

/// A material with its constant part ready.
#[derive(Clone, Debug)]
pub(crate) struct CompiledMaterial {
    pub surface: Surface,
    pub base_color_texture: Option<TextureSlot>,
    pub metallic_roughness_texture: Option<TextureSlot>,
    pub normal_texture: Option<(TextureSlot, f32)>,
}

impl RenderScene {
    /// Compiles `scene` at frame 0.
    ///
    /// # Errors
    /// When the scene has no camera, refers to a mesh, material, texture or vertex it does not hold, or has more than 2^28 triangles.
    pub fn compile(scene: &LoadedScene) -> Result<Self> {
        Self::compile_with(scene, Sharing::Automatic)
    }

    /// As [`Self::compile`], with another choice of what is flattened: for measurements, the picture is the same up to rounding.
    ///
    /// # Errors
    /// As [`Self::compile`].
    pub fn compile_with(scene: &LoadedScene, sharing: Sharing) -> Result<Self> {
        check(scene, sharing)?;
        let materials: Vec<_> = scene.materials.iter().map(compile_material).collect();
        // Only what some instance uses counts: an unused textured material must not slow the others down.
        let used = |f: &dyn Fn(&CompiledMaterial) -> bool| scene.instances.iter().any(|i| f(&materials[i.material]));
        let light = EnvironmentLight::new(&scene.environment)?;
        let features = FeatureSet {
            textures: used(&|m| m.base_color_texture.is_some() || m.metallic_roughness_texture.is_some()),
            normal_maps: used(&|m| m.normal_texture.is_some()),
            flat_environment: light.constant().is_some(),
            black_environment: light.is_black(),
        };
        let wanted = Wanted {
            uvs: features.textures || features.normal_maps,
            tangents: materials.iter().map(|m| features.normal_maps && m.normal_texture.is_some()).collect(),
        };
        Ok(Self {
            geometry: Geometry::new(scene.meshes.clone(), scene.instances.clone(), wanted, sharing),
            materials,
            textures: scene.textures.iter().map(Sampled::new).collect(),
            light,
            environment: scene.environment.clone(),
            seed: scene.seed,
            hash: scene.hash.clone(),
            cameras: scene.cameras.clone(),
            frame: 0,
            features,
            tables: OnceLock::new(),
            exposure: OnceLock::new(),
        })
    }

    /// Moves to `frame` (0 is the first; beyond the last the last pose is held). The tree is built again only if something moved.
    pub fn set_frame(&mut self, frame: usize) {
        self.frame = frame;
        self.geometry.set_frame(frame);
    }

    /// The current frame.
    pub fn frame(&self) -> usize {
        self.frame
    }

    /// Number of frames that have a camera of their own.
    pub fn frames(&self) -> usize {
        self.cameras.len()
    }

    /// Camera of the current frame.
    pub fn camera(&self) -> &Camera {
        self.camera_at(self.frame)
    }

    /// Camera of `frame`, the last one beyond the end.
    pub(crate) fn camera_at(&self, frame: usize) -> &Camera {
        &self.cameras[frame.min(self.cameras.len() - 1)]
    }

    /// Gives every frame's camera another resolution, the view kept.
    pub fn set_resolution(&mut self, width: usize, height: usize) {
        for camera in &mut self.cameras {
            *camera = camera.resized(width, height);
        }
    }

    /// Light of the scene.
    pub fn environment(&self) -> &Environment {
        &self.environment
    }

    /// Split-sum tables of the environment, made on first use and kept.
    pub fn ibl_tables(&self) -> &IblTables {
        // Made before the cell is locked: making them runs on rayon, where a waiting thread may pick up work that asks for them.
        match self.tables.get() {
            Some(tables) => tables,
            None => {
                let made = IblTables::new(&self.environment);
                self.tables.get_or_init(|| made)
            }
        }
    }

    /// Factor from scene radiance to display-linear, from the environment alone (see [`renderflow_frame::ibl::exposure`]).
    pub fn exposure(&self) -> f32 {
        match self.exposure.get() {
            Some(&exposure) => exposure,
            None => {
                let made = renderflow_frame::ibl::exposure(&self.environment);
                *self.exposure.get_or_init(|| made)
            }
        }
    }

    /// Chooses what light samples of the environment follow; [`Self::compile`] takes the default.
    ///
    /// # Errors
    /// Never after [`Self::compile`] accepted the environment.
    pub fn set_environment_sampling(&mut self, sampling: Sampling) -> Result<()> {
        self.light = EnvironmentLight::with_sampling(&self.environment, sampling)?;
        Ok(())
    }

    /// Components of the environment's texels that could not be used as they are.
    pub fn environment_repairs(&self) -> Repairs {
        self.light.repairs()
    }

    /// What the scene needs of the integrator.
    pub fn features(&self) -> FeatureSet {
        self.features
    }

    /// Triangles, all instances together.
    pub fn triangle_count(&self) -> usize {
        self.geometry.triangle_count()
    }

    /// Triangles left out because a corner is not finite, farther than 1e12 m from the origin, or equal to another.
    pub fn dropped_triangles(&self) -> usize {
        self.geometry.dropped_triangles()
    }

    /// How often each kind of tree was built since [`Self::compile`], that one included.
    pub fn builds(&self) -> Builds {
        self.geometry.builds()
    }

    /// Bytes of the trees and of the vertex attributes placed for them.
    pub fn geometry_memory(&self) -> usize {
        self.geometry.memory()
    }

    /// The nearest triangle along `ray` (relative to the scene's origin), for measurements.
    #[inline]
    pub fn closest(&self, ray: &Ray, scratch: &mut Scratch) -> Option<Hit> {
        self.geometry.closest(ray, scratch)
    }

    /// Whether any triangle stands in the way of `ray` (relative to the scene's origin), for measurements.
    #[inline]
    pub fn occluded(&self, ray: &Ray, scratch: &mut Scratch) -> bool {
        self.geometry.occluded(ray, scratch)
    }

    /// As [`Self::closest`], of the triangles that `accept` accepts.
    #[inline]
    pub fn closest_where(&self, ray: &Ray, scratch: &mut Scratch, accept: impl Fn(&Candidate) -> bool) -> Option<Hit> {
        self.geometry.closest_where(ray, scratch, accept)
    }

    /// As [`Self::occluded`], of the triangles that `accept` accepts.
    #[inline]
    pub fn occluded_where(&self, ray: &Ray, scratch: &mut Scratch, accept: impl Fn(&Candidate) -> bool) -> bool {
        self.geometry.occluded_where(ray, scratch, accept)
    }

    /// Indices of the instance that was hit, of the triangle in its mesh, and of its material.
    pub fn locate(&self, hit: &Hit) -> (u32, u32, usize) {
        let (instance, triangle) = self.geometry.locate(hit);
        (instance, triangle, self.geometry.material(hit))
    }
}

fn compile_material(material: &Material) -> CompiledMaterial {
    let range = |v: f32| v.clamp(0.0, 1.0);
    CompiledMaterial {
        surface: Surface {
            base_color: Vec3A::from_array(material.base_color).clamp(Vec3A::ZERO, Vec3A::ONE),
            metallic: range(material.metallic),
            roughness: range(material.roughness),
            specular: range(material.specular),
            ..Surface::default()
        },
        base_color_texture: material.base_color_texture.clone(),
        metallic_roughness_texture: material.metallic_roughness_texture.clone(),
        normal_texture: material.normal_texture.clone(),
    }
}

/// References that would lead out of the scene's arrays, and values outside their range.
fn check(scene: &LoadedScene, sharing: Sharing) -> Result<()> {
    if scene.cameras.is_empty() {
        return Err(Error::inconsistent("cameras", "there is none"));
    }
    let missing = |place: String, index: usize, count: usize| {
        Err(Error::inconsistent(place, format!("{index} does not exist, there are {count}")))
    };
    for (i, instance) in scene.instances.iter().enumerate() {
        if instance.mesh >= scene.meshes.len() {
            return missing(format!("instances/{i}/mesh"), instance.mesh, scene.meshes.len());
        }
        if instance.material >= scene.materials.len() {
            return missing(format!("instances/{i}/material"), instance.material, scene.materials.len());
        }
        if instance.transforms.is_empty() {
            return Err(Error::inconsistent(format!("instances/{i}/transforms"), "there is none"));
        }
    }
    let (triangles, vertices) = Geometry::flattened_size(&scene.meshes, &scene.instances, sharing);
    if triangles > MAX_TRIANGLES {
        return Err(Error::TooLarge { what: "triangles", count: triangles, limit: MAX_TRIANGLES });
    }
    if vertices > u32::MAX as usize {
        return Err(Error::TooLarge { what: "vertices", count: vertices, limit: u32::MAX as usize });
    }
    for (i, mesh) in scene.meshes.iter().enumerate() {
        let count = mesh.positions.len();
        if let Some(t) = mesh.triangles.iter().position(|t| t.iter().any(|&v| v as usize >= count)) {
            return Err(Error::inconsistent(
                format!("meshes/{i}/triangles/{t}"),
                format!("a vertex is beyond the {count} there are"),
            ));
        }
        for (what, length) in [("normals", mesh.normals.len()), ("uvs", mesh.uvs.len()), ("tangents", mesh.tangents.len())] {
            if length != 0 && length != count {
                let reason = format!("{length} for {count} vertices");
                return Err(Error::inconsistent(format!("meshes/{i}/{what}"), reason));
            }
        }
    }
    for (i, material) in scene.materials.iter().enumerate() {
        let slots = [&material.base_color_texture, &material.metallic_roughness_texture].into_iter().flatten();
        for slot in slots.chain(material.normal_texture.as_ref().map(|(slot, _)| slot)) {
            if slot.texture >= scene.textures.len() {
                return missing(format!("materials/{i}"), slot.texture, scene.textures.len());
            }
        }
        let values = material.base_color.iter().chain([&material.metallic, &material.roughness, &material.specular]);
        for &value in values {
            if !(0.0..=1.0).contains(&value) {
                return Err(Error::inconsistent(format!("materials/{i}"), format!("{value} is outside 0..=1")));
            }
        }
    }
    for (i, texture) in scene.textures.iter().enumerate() {
        let complete = |level: &Level| match &level.texels {
            Texels::Bytes(texels) => texels.len() == level.width * level.height,
            Texels::Words(texels) => texels.len() == level.width * level.height,
        };
        if !texture.levels.iter().all(complete) {
            return Err(Error::inconsistent(format!("textures/{i}"), "size and texel count differ"));
        }
    }
    Ok(())
}
