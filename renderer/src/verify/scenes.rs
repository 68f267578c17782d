//! Small scenes for the checks and tests, made in memory.

use crate::compile::RenderScene;
use glam::{Affine3A, Vec3A};
use renderflow_frame::{Camera, Environment, Image};
use renderflow_scenes::shapes::{self, Shape};
use renderflow_scenes::{Instance, LoadReport, LoadedScene, Material, Mesh, Principled, Texture};

/// A mesh with a material at a place.
#[derive(Clone, Debug)]
pub struct Part {
    /// Its triangles.
    pub mesh: Mesh,
    /// What they are made of.
    pub material: Material,
    /// From the mesh to the world.
    pub transform: Affine3A,
}

impl Part {
    /// A shape with a normal a vertex where it is smooth.
    pub fn new(shape: Shape, material: Material, transform: Affine3A) -> Self {
        Self { mesh: shapes::mesh(&shape), material, transform }
    }

    /// The same with a normal a triangle in place of a normal a vertex.
    pub fn flat(mut self) -> Self {
        self.mesh.normals.clear();
        self
    }
}

/// A Lambertian material: diffuse reflection grows retro-reflective with roughness, and has no coat without specular.
pub fn diffuse(base_color: [f32; 3]) -> Material {
    Material::from(Principled {
        base_color: Vec3A::from_array(base_color),
        roughness: 0.0,
        specular: 0.0,
        ..Principled::default()
    })
}

/// A metal.
pub fn metal(base_color: [f32; 3], roughness: f32) -> Material {
    Material::from(Principled { base_color: Vec3A::from_array(base_color), roughness, metallic: 1.0, ..Principled::default() })
}

/// A camera with +Y up; `degrees` is the vertical field of view.
pub fn camera(eye: [f32; 3], target: [f32; 3], degrees: f32, width: usize, height: usize) -> Camera {
    let up = if (eye[0], eye[2]) == (target[0], target[2]) { Vec3A::Z } else { Vec3A::Y };
    Camera::look_at(eye.into(), target.into(), up, degrees.to_radians(), width, height)
}

/// Environment whose map is `f` of a direction, sampled at texel centres.
pub fn environment(width: usize, height: usize, f: impl Fn(Vec3A) -> [f32; 3]) -> Environment {
    let blank = Environment { map: Image::filled(width, height, [0.0; 3]), rotation: 0.0, intensity: 1.0 };
    let map = Image::from_fn(width, height, |x, y| f(blank.texel_direction(x, y)));
    blank.with_map(map)
}

/// A sky with a gradient and a small bright sun.
pub fn sunny() -> Environment {
    let sun = Vec3A::new(0.5, 0.7, 0.4).normalize();
    environment(128, 64, |d| {
        let (sky, sun) = (0.6 + 0.4 * d.y, if d.dot(sun) > 0.997 { 300.0 } else { 0.0 });
        [0.6 * sky + sun, 0.8 * sky + sun, sky + 0.8 * sun]
    })
}

/// A scene of `parts`, with the textures that materials refer to, seen by `camera` under `environment`.
pub fn scene(parts: Vec<Part>, textures: Vec<Texture>, environment: Environment, camera: Camera) -> LoadedScene {
    let mut scene = LoadedScene {
        name: "check".into(),
        seed: 1,
        hash: String::new(),
        files: String::new(),
        meshes: Vec::new(),
        instances: Vec::new(),
        materials: Vec::new(),
        textures,
        origin: glam::DVec3::ZERO,
        environment,
        lights: Vec::new(),
        cameras: vec![camera],
        report: LoadReport::default(),
    };
    for (i, part) in parts.into_iter().enumerate() {
        scene.meshes.push(part.mesh);
        scene.materials.push(part.material);
        scene.instances.push(instance(i, i, part.transform));
    }
    scene
}

/// A mesh with a material at a place; its object has the number of its mesh, counted from 1.
pub fn instance(mesh: usize, material: usize, transform: Affine3A) -> Instance {
    let name = format!("object {mesh} {material} {transform:?}");
    Instance { name, mesh, material, object_id: mesh as u32 + 1, transforms: vec![transform] }
}

/// A scene of `parts`, ready for rendering.
///
/// # Errors
/// What compiling says, in words.
pub fn compile(parts: Vec<Part>, environment: Environment, camera: Camera) -> Result<RenderScene, String> {
    compile_textured(parts, Vec::new(), environment, camera)
}

/// As [`compile`], with the textures that materials refer to.
///
/// # Errors
/// As [`compile`].
pub fn compile_textured(
    parts: Vec<Part>,
    textures: Vec<Texture>,
    environment: Environment,
    camera: Camera,
) -> Result<RenderScene, String> {
    RenderScene::compile(&scene(parts, textures, environment, camera)).map_err(|e| e.to_string())
}
