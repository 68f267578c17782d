//! Compiles a loaded scene: world-space triangles and their tree, material and light tables, and the features the scene needs.

use crate::accel::{Accel, MAX_COORDINATE, MAX_TRIANGLES};
use crate::error::{Error, Result};
use crate::features::FeatureSet;
use crate::light::EnvironmentLight;
use crate::material::Surface;
use crate::texture::Sampled;
use glam::{Affine3A, Vec3A};
use renderflow_frame::ibl::IblTables;
use renderflow_frame::{Camera, Environment};
use renderflow_scenes::mipmap::{Level, Texels};
use renderflow_scenes::{Instance, LoadedScene, Material, Mesh, TextureSlot};
use std::sync::OnceLock;

/// A scene at one frame, ready to be rendered.
pub struct RenderScene {
    pub(crate) accel: Accel,
    /// One a triangle of `accel`, in the order given to its builder.
    pub(crate) triangles: Vec<PlacedTriangle>,
    /// World-space unit shading normals, zero where a mesh has none; empty when no mesh has any.
    pub(crate) normals: Vec<[f32; 3]>,
    /// Empty when no material looks anything up.
    pub(crate) uvs: Vec<[f32; 2]>,
    /// World-space tangents with handedness; empty when no material has a normal map.
    pub(crate) tangents: Vec<[f32; 4]>,
    pub(crate) placed: Vec<PlacedInstance>,
    pub(crate) materials: Vec<CompiledMaterial>,
    pub(crate) textures: Vec<Sampled>,
    pub(crate) light: EnvironmentLight,
    pub(crate) environment: Environment,
    pub(crate) instances: Vec<Instance>,
    pub(crate) meshes: Vec<Mesh>,
    pub(crate) seed: u64,
    pub(crate) hash: String,
    cameras: Vec<Camera>,
    frame: usize,
    features: FeatureSet,
    dropped_triangles: usize,
    builds: usize,
    tables: OnceLock<IblTables>,
    exposure: OnceLock<f32>,
}

/// Where a triangle's attributes are.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PlacedTriangle {
    /// Indices into the world-space vertex arrays.
    pub vertices: [u32; 3],
    pub instance: u32,
    /// Index into the triangles of the instance's mesh.
    pub in_mesh: u32,
}

/// What shading needs of an instance.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PlacedInstance {
    pub material: usize,
    pub smooth: bool,
    pub tangents: bool,
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
        check(scene)?;
        let materials: Vec<_> = scene.materials.iter().map(compile_material).collect();
        // Only what some instance uses counts: an unused textured material must not slow the others down.
        let used = |f: &dyn Fn(&CompiledMaterial) -> bool| scene.instances.iter().any(|i| f(&materials[i.material]));
        let light = EnvironmentLight::new(&scene.environment);
        let features = FeatureSet {
            textures: used(&|m| m.base_color_texture.is_some() || m.metallic_roughness_texture.is_some()),
            normal_maps: used(&|m| m.normal_texture.is_some()),
            flat_environment: light.constant().is_some(),
            black_environment: light.is_black(),
        };
        let mut compiled = Self {
            accel: Accel::build(&[]),
            triangles: Vec::new(),
            normals: Vec::new(),
            uvs: Vec::new(),
            tangents: Vec::new(),
            placed: Vec::new(),
            materials,
            textures: scene.textures.iter().map(Sampled::new).collect(),
            light,
            environment: scene.environment.clone(),
            instances: scene.instances.clone(),
            meshes: scene.meshes.clone(),
            seed: scene.seed,
            hash: scene.hash.clone(),
            cameras: scene.cameras.clone(),
            frame: 0,
            features,
            dropped_triangles: 0,
            builds: 0,
            tables: OnceLock::new(),
            exposure: OnceLock::new(),
        };
        compiled.build_geometry();
        Ok(compiled)
    }

    /// Moves to `frame` (0 is the first; beyond the last the last pose is held). The tree is built again only if something moved.
    pub fn set_frame(&mut self, frame: usize) {
        let moved = self.instances.iter().any(|i| i.transform(frame) != i.transform(self.frame));
        self.frame = frame;
        if moved {
            self.build_geometry();
        }
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

    /// What the scene needs of the integrator.
    pub fn features(&self) -> FeatureSet {
        self.features
    }

    /// Triangles in the tree, all instances together.
    pub fn triangle_count(&self) -> usize {
        self.triangles.len()
    }

    /// Triangles left out because a placed corner is not finite, farther than 1e12 m from the origin, or equal to another.
    pub fn dropped_triangles(&self) -> usize {
        self.dropped_triangles
    }

    /// How often the tree was built since [`Self::compile`], that one included.
    pub fn builds(&self) -> usize {
        self.builds
    }

    /// The tree, for measurements.
    pub fn accel(&self) -> &Accel {
        &self.accel
    }

    /// World-space point at `frame` of what is now at barycentric `weights` of triangle `primitive`.
    pub(crate) fn point_at(&self, primitive: u32, weights: [f32; 3], frame: usize) -> glam::DVec3 {
        let triangle = &self.triangles[primitive as usize];
        let instance = &self.instances[triangle.instance as usize];
        let mesh = &self.meshes[instance.mesh];
        let transform = instance.transform(frame);
        let corners = mesh.triangles[triangle.in_mesh as usize].map(|v| place(&transform, mesh.positions[v as usize]).as_dvec3());
        corners.iter().zip(weights).map(|(&c, w)| c * f64::from(w)).sum()
    }

    /// World-space corners of every triangle in the tree.
    pub(crate) fn corners(&self) -> impl Iterator<Item = [Vec3A; 3]> + '_ {
        self.accel.triangles()
    }

    /// Flattens all instances at the current frame and builds their tree.
    fn build_geometry(&mut self) {
        let textured = self.features.textures || self.features.normal_maps;
        let any_normals = self.meshes.iter().any(|m| !m.normals.is_empty());
        self.triangles.clear();
        self.normals.clear();
        self.uvs.clear();
        self.tangents.clear();
        self.placed.clear();
        self.dropped_triangles = 0;
        let mut corners: Vec<[Vec3A; 3]> = Vec::new();
        let mut positions: Vec<Vec3A> = Vec::new();
        let mut first = 0u32;
        for (index, instance) in self.instances.iter().enumerate() {
            let mesh = &self.meshes[instance.mesh];
            let transform = instance.transform(self.frame);
            let count = mesh.positions.len();
            positions.clear();
            positions.extend(mesh.positions.iter().map(|&p| place(&transform, p)));

            let mapped = self.features.normal_maps && self.materials[instance.material].normal_texture.is_some();
            let placed = PlacedInstance {
                material: instance.material,
                smooth: !mesh.normals.is_empty(),
                tangents: mapped && !mesh.tangents.is_empty() && !mesh.uvs.is_empty(),
            };
            if any_normals {
                append(&mut self.normals, place_normals(&transform, &mesh.normals), count, [0.0; 3]);
            }
            if textured {
                append(&mut self.uvs, mesh.uvs.iter().map(|uv| uv.to_array()), count, [0.0; 2]);
            }
            if self.features.normal_maps {
                let handedness = transform.matrix3.determinant().signum();
                let tangents = mesh.tangents.iter().map(|t| {
                    let d = (transform.matrix3 * Vec3A::new(t.x, t.y, t.z)).normalize_or_zero();
                    [d.x, d.y, d.z, t.w * handedness]
                });
                append(&mut self.tangents, tangents, count, [0.0; 4]);
            }

            for (in_mesh, triangle) in mesh.triangles.iter().enumerate() {
                let p = triangle.map(|v| positions[v as usize]);
                // Two equal corners leave nothing to hit; a transform that flattens everything to a point makes thousands of them.
                let flat = p[0] == p[1] || p[1] == p[2] || p[2] == p[0];
                if flat || !p.iter().all(|v| v.is_finite() && v.abs().max_element() <= MAX_COORDINATE) {
                    self.dropped_triangles += 1;
                    continue;
                }
                corners.push(p);
                let vertices = triangle.map(|v| first + v);
                self.triangles.push(PlacedTriangle { vertices, instance: index as u32, in_mesh: in_mesh as u32 });
            }
            self.placed.push(placed);
            first += count as u32;
        }
        self.accel = Accel::build(&corners);
        self.builds += 1;
    }
}

/// Object to world. One function, so that geometry and motion round alike and still points have exactly no motion.
fn place(transform: &Affine3A, p: glam::Vec3) -> Vec3A {
    transform.transform_point3a(p.into())
}

/// Normals are moved by the inverse transpose; where the transform flattens the mesh they become zero, and the flat normal is used.
fn place_normals<'a>(transform: &Affine3A, normals: &'a [glam::Vec3]) -> impl Iterator<Item = [f32; 3]> + 'a {
    // The cofactor matrix: the inverse transpose up to a factor, but without a division that could fail.
    let m = transform.matrix3;
    let sign = if m.determinant() < 0.0 { -1.0 } else { 1.0 };
    let cofactors = [m.y_axis.cross(m.z_axis), m.z_axis.cross(m.x_axis), m.x_axis.cross(m.y_axis)].map(|c| c * sign);
    normals.iter().map(move |n| (cofactors[0] * n.x + cofactors[1] * n.y + cofactors[2] * n.z).normalize_or_zero().to_array())
}

/// Appends `values`, then `filler` up to `count` entries.
fn append<T: Copy>(to: &mut Vec<T>, values: impl Iterator<Item = T>, count: usize, filler: T) {
    let end = to.len() + count;
    to.extend(values.take(count));
    to.resize(end, filler);
}

fn compile_material(material: &Material) -> CompiledMaterial {
    let range = |v: f32| v.clamp(0.0, 1.0);
    CompiledMaterial {
        surface: Surface {
            base_color: Vec3A::from_array(material.base_color).clamp(Vec3A::ZERO, Vec3A::ONE),
            metallic: range(material.metallic),
            roughness: range(material.roughness),
            specular: range(material.specular),
        },
        base_color_texture: material.base_color_texture.clone(),
        metallic_roughness_texture: material.metallic_roughness_texture.clone(),
        normal_texture: material.normal_texture.clone(),
    }
}

/// References that would lead out of the scene's arrays, and values outside their range.
fn check(scene: &LoadedScene) -> Result<()> {
    if scene.cameras.is_empty() {
        return Err(Error::inconsistent("cameras", "there is none"));
    }
    let missing = |place: String, index: usize, count: usize| {
        Err(Error::inconsistent(place, format!("{index} does not exist, there are {count}")))
    };
    let (mut triangles, mut vertices) = (0usize, 0usize);
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
        triangles += scene.meshes[instance.mesh].triangles.len();
        vertices += scene.meshes[instance.mesh].positions.len();
    }
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
