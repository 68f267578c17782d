//! The scenes that everything is measured on: made in code, 512 x 512 unless told otherwise, the same on every machine.

mod clear;

pub use clear::CLEAR;

use super::composed;
use super::models::{self, Maps, Model};
use anyhow::{Context, Result, bail};
use glam::DVec3;
use renderflow_frame::file;
use renderflow_frame::reach::Reach;
use renderflow_scenes::LoadedScene;
use renderflow_scenes::description::{
    CameraPath, EnvironmentLight, EnvironmentSource, Geometry, Material, Object, Pose, Scene, TextureTransform, Transform,
};
use renderflow_scenes::load::{self, Format, ModelView};
use renderflow_scenes::shapes::Shape;
use renderflow_scenes::sky::{Sky, Sun};
use std::f64::consts::TAU;
use std::path::{Path, PathBuf};

/// Pixels along both sides unless told otherwise.
pub const RESOLUTION: u32 = 512;

/// A scene of the set.
pub struct BenchScene {
    /// Name on the command line and in results.
    pub name: &'static str,
    /// What it is there for.
    pub about: &'static str,
    make: fn() -> Result<Described>,
}

/// A scene with the files it refers to.
pub struct Described {
    /// The scene; its files have paths relative to the folder it is written to.
    pub scene: Scene,
    /// Name and bytes of every file it refers to.
    pub files: Vec<(String, Vec<u8>)>,
}

/// Every scene of the set but the composed ones ([`composed`]).
pub const ALL: [BenchScene; 8] = [
    BenchScene {
        name: "soft_sun",
        about: "13 objects and a dense body on a plane, sun of 10 degrees",
        make: || outdoor("soft_sun", 10.0),
    },
    BenchScene { name: "hard_sun", about: "the same under a sun of 1.5 degrees", make: || outdoor("hard_sun", 1.5) },
    BenchScene { name: "studio", about: "the same in a rig of lamps", make: studio },
    BenchScene { name: "overcast", about: "the same under a bright even sky", make: overcast },
    BenchScene { name: "textured", about: "bodies with colour, roughness, metal and normal maps", make: textured },
    BenchScene { name: "million", about: "a million triangles of hills, and bodies on them", make: million },
    BenchScene { name: "interior", about: "a room lit through one window", make: interior },
    BenchScene { name: "forest", about: "trees of 330 thousand leaf triangles", make: forest },
];

/// The scene called `name`.
pub fn by_name(name: &str) -> Option<&'static BenchScene> {
    ALL.iter().chain(&CLEAR).find(|scene| scene.name == name)
}

/// The scene of the set called `name`, composed or not, `resolution` pixels along both sides; `None` where there is no such
/// scene.
///
/// # Errors
/// When the resolution is out of range.
pub fn describe(name: &str, resolution: u32) -> Result<Option<Described>> {
    match by_name(name) {
        Some(scene) => scene.describe(resolution).map(Some),
        None => Ok(composed::describe(name, resolution)?.map(|scene| Described { scene, files: Vec::new() })),
    }
}

/// A scene to measure, loaded.
pub struct Subject {
    /// Name of the scene of the set, or of the file.
    pub name: String,
    /// The scene at the resolution asked for; its hash covers the files that were made for it.
    pub loaded: LoadedScene,
}

/// Says whether `name` is a scene of the set or a file that may be one: what long work asks before it begins.
///
/// # Errors
/// When it is neither.
pub fn exists(name: &str) -> Result<()> {
    let path = Path::new(name);
    if composed::names().any(|known| known == name) {
        return Ok(());
    }
    let described = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("json"));
    if by_name(name).is_none() && !described && Format::of(path).is_none() {
        let known: Vec<&str> = ALL.iter().chain(&CLEAR).map(|scene| scene.name).chain([composed::ALL]).collect();
        bail!("{name}: neither a scene file (.json), a model, nor a scene of the set; there are {}", known.join(", "));
    }
    if by_name(name).is_none() && !path.is_file() {
        bail!("{name}: no such file");
    }
    Ok(())
}

/// Names of scenes, with each of the composed ones in place of the word for all of them.
pub fn expand(names: &[String]) -> Vec<String> {
    let each = |name: &String| if name == composed::ALL { composed::names().collect() } else { vec![name.clone()] };
    names.iter().flat_map(each).collect()
}

/// Loads a scene of the set by name, or else a scene file (`.json`) or a model (glTF, OBJ or PLY, on a ground plane under a
/// built-in sky), at `resolution` (pixels along both sides; its own without). A file may name files of its folder, and of those
/// that are `allowed`.
///
/// # Errors
/// When it is neither, or the file or something it refers to cannot be read.
pub fn open(name: &str, resolution: Option<u32>, allowed: &[PathBuf]) -> Result<Subject> {
    if let Some(described) = describe(name, resolution.unwrap_or(RESOLUTION))? {
        return Ok(Subject { name: name.to_owned(), loaded: described.load()? });
    }
    exists(name)?;
    let path = Path::new(name);
    let reach = Reach::of(path).allow(allowed);
    let mut scene = match Format::of(path) {
        Some(_) => load::describe_model(path, None, &ModelView { frames: 1, ..ModelView::default() }, &reach)?,
        None => Scene::read(path)?,
    };
    if let Some(resolution) = resolution {
        scene.resolution = [resolution; 2];
    }
    let stem = path.file_stem().map_or_else(|| name.to_owned(), |s| s.to_string_lossy().into_owned());
    Ok(Subject { name: stem, loaded: load::load(&scene, &reach)? })
}

impl BenchScene {
    /// The scene and its files, at `resolution` pixels along both sides.
    ///
    /// # Errors
    /// When a texture cannot be encoded.
    pub fn describe(&self, resolution: u32) -> Result<Described> {
        let mut described = (self.make)()?;
        described.scene.resolution = [resolution; 2];
        Ok(described)
    }
}

impl Described {
    /// Writes `scene.json` and what it refers to into `folder`; returns the path of the former.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn write(&self, folder: &Path) -> Result<PathBuf> {
        for (name, bytes) in &self.files {
            file::write_atomic(&folder.join(name), bytes)?;
        }
        let path = folder.join("scene.json");
        file::write_json(&path, &self.scene)?;
        Ok(path)
    }

    /// Loads it by way of a folder that is gone afterwards, through the same readers as any scene.
    ///
    /// # Errors
    /// When that folder cannot be written.
    pub fn load(&self) -> Result<LoadedScene> {
        if self.files.is_empty() {
            return Ok(load::load(&self.scene, &Reach::folder(""))?);
        }
        let folder = tempfile::tempdir().context("a folder for the files of a scene")?;
        self.write(folder.path())?;
        let mut loaded = load::load(&self.scene, &Reach::folder(folder.path()))?;
        let mut hash = blake3::Hasher::new();
        hash.update(loaded.hash.as_bytes());
        for (name, bytes) in &self.files {
            hash.update(name.as_bytes()).update(bytes);
        }
        loaded.hash = hash.finalize().to_hex().to_string();
        Ok(loaded)
    }

    fn new(name: &str, camera: CameraPath, sky: Sky) -> Self {
        let environment = EnvironmentLight { source: EnvironmentSource::Sky(sky), rotation: 0.0, intensity: 1.0 };
        let scene = Scene {
            version: 1,
            name: name.into(),
            seed: 1,
            resolution: [RESOLUTION; 2],
            frames: 1,
            camera,
            environment,
            materials: Vec::new(),
            objects: Vec::new(),
            lights: Vec::new(),
        };
        Self { scene, files: Vec::new() }
    }

    /// Adds an object with a material of its own, both called `material.name`.
    fn add(&mut self, geometry: Geometry, material: Material, transform: Transform) {
        let name = material.name.clone();
        self.scene.objects.push(Object {
            name: name.clone(),
            geometry,
            material: Some(name),
            transform,
            motion: None,
            animation: None,
        });
        self.scene.materials.push(material);
    }

    fn shape(&mut self, shape: Shape, material: Material, transform: Transform) {
        self.add(Geometry::Shape(shape), material, transform);
    }

    /// Adds a mesh as a glTF file.
    fn model(&mut self, model: &Model, material: Material, transform: Transform) -> Result<()> {
        let [name, buffer] = ["gltf", "bin"].map(|e| format!("{}.{e}", material.name));
        let [document, data] = model.gltf(&buffer)?;
        self.files.extend([(name.clone(), document), (buffer, data)]);
        self.add(Geometry::File(name), material, transform);
        Ok(())
    }

    /// Adds textures called `name`, and makes `material` use them.
    fn maps(&mut self, name: &str, maps: &Maps, repeat: f32, material: Material) -> Material {
        let [color, surface, normal] = ["color", "surface", "normal"].map(|kind| format!("{name}_{kind}.png"));
        if !self.files.iter().any(|(file, _)| *file == color) {
            let made = [(&color, &maps.color), (&surface, &maps.surface), (&normal, &maps.normal)];
            self.files.extend(made.map(|(file, bytes)| (file.clone(), bytes.clone())));
        }
        Material {
            base_color_texture: Some(color),
            metallic_roughness_texture: Some(surface),
            normal_texture: Some(normal),
            texture_transform: TextureTransform { scale: [repeat; 2], ..TextureTransform::default() },
            ..material
        }
    }
}

fn look(eye: [f64; 3], target: [f64; 3], vertical_fov: f32) -> CameraPath {
    CameraPath::Poses { poses: vec![Pose { eye, target, up: [0.0, 1.0, 0.0] }], vertical_fov }
}

fn at(x: f64, y: f64, z: f64) -> Transform {
    Transform { translation: [x, y, z], ..Transform::default() }
}

fn turned(x: f64, y: f64, z: f64, rotation: [f32; 3]) -> Transform {
    Transform { rotation, ..at(x, y, z) }
}

/// A dielectric.
fn plastic(name: &str, base_color: [f32; 3], roughness: f32, specular: f32) -> Material {
    Material { name: name.into(), base_color, roughness, specular, ..Material::default() }
}

fn metal(name: &str, base_color: [f32; 3], roughness: f32) -> Material {
    Material { metallic: 1.0, ..plastic(name, base_color, roughness, 0.5) }
}

/// A clear sky; `radius` of the sun's disc in degrees. The sun brings somewhat less than half of the light.
fn day(radius: f32, gain: f32) -> Sky {
    let sun = Sun { elevation: 38.0, azimuth: 135.5, radius, gain };
    Sky::Daylight { sun, turbidity: 3.0, ground: [0.12, 0.1, 0.08], luminance: 0.6 }
}

/// Thirteen objects of mixed materials on a plane.
fn still_life(name: &str, sky: Sky) -> Result<Described> {
    let mut d = Described::new(name, look([5.2, 3.2, 7.6], [0.0, 0.85, 0.4], 38.0), sky);
    let sphere = |radius| Shape::Sphere { radius };
    let cube = |size| Shape::Box { size, bevel: 0.0 };
    let torus = |radius, tube| Shape::Torus { radius, tube };
    d.shape(Shape::Plane { size: 24.0 }, plastic("ground", [0.45, 0.42, 0.38], 0.8, 0.5), at(0.0, 0.0, 0.0));
    d.shape(sphere(0.8), plastic("sphere_red", [0.75, 0.08, 0.06], 0.25, 0.5), at(-2.6, 0.8, 1.2));
    d.shape(sphere(0.7), metal("sphere_gold", [1.0, 0.72, 0.3], 0.15), at(0.2, 0.7, 2.4));
    d.shape(sphere(0.6), metal("sphere_chrome", [0.9, 0.9, 0.92], 0.05), at(2.3, 0.6, 2.2));
    d.shape(sphere(0.55), plastic("sphere_white", [0.85; 3], 1.0, 0.2), at(-1.0, 0.55, 3.0));
    d.shape(sphere(0.45), plastic("sphere_glossy_blue", [0.05, 0.12, 0.6], 0.08, 0.8), at(1.3, 0.45, 3.4));
    let upright = |x, y, z, degrees| turned(x, y, z, [0.0, degrees, 0.0]);
    d.shape(cube([1.4; 3]), plastic("cube_green", [0.1, 0.45, 0.12], 0.6, 0.5), upright(-3.2, 0.7, -1.4, 30.0));
    d.shape(cube([1.1, 1.8, 1.1]), metal("cube_copper", [0.95, 0.55, 0.4], 0.35), upright(3.4, 0.9, -0.6, 12.0));
    d.shape(cube([0.9; 3]), plastic("cube_dark", [0.03, 0.03, 0.035], 0.3, 0.5), upright(-1.6, 0.45, 4.1, 40.0));
    let leaning = turned(2.4, 0.95, 0.2, [60.0, 0.0, 35.0]);
    d.shape(torus(0.75, 0.24), plastic("torus_orange", [0.95, 0.4, 0.05], 0.4, 0.5), leaning);
    d.shape(torus(0.6, 0.228), metal("torus_steel", [0.55, 0.56, 0.58], 0.5), at(-0.6, 0.23, 1.15));
    let standing = turned(-3.4, 0.68, 3.0, [0.0, 15.0, 90.0]);
    d.shape(torus(0.5, 0.18), plastic("torus_purple", [0.45, 0.1, 0.55], 0.15, 0.9), standing);
    let dense = models::displaced_sphere(0.75, 361);
    d.model(&dense, plastic("dense_displaced", [0.2, 0.55, 0.65], 0.2, 0.5), at(-1.5, 0.76, -0.46))?;
    Ok(d)
}

fn outdoor(name: &str, radius: f32) -> Result<Described> {
    still_life(name, day(radius, 0.35))
}

/// Name of the one object of [`body_on_plane`].
pub(super) const BODY: &str = "body";
/// Radius of a body that fills the picture of [`body_on_plane`], metres.
pub(super) const BODY_RADIUS: f64 = 1.0;

/// A sphere on a plane under the soft sun, seen from near: a place for bodies of any number of triangles.
pub(super) fn body_on_plane(resolution: u32) -> Described {
    let mut d = Described::new("body_on_plane", look([0.0, 1.9, 3.4], [0.0, 0.95, 0.0], 38.0), day(10.0, 0.35));
    d.scene.resolution = [resolution; 2];
    d.shape(Shape::Plane { size: 24.0 }, plastic("ground", [0.45, 0.42, 0.38], 0.8, 0.5), at(0.0, 0.0, 0.0));
    let sphere = Shape::Sphere { radius: BODY_RADIUS as f32 };
    d.shape(sphere, plastic(BODY, [0.2, 0.55, 0.65], 0.3, 0.5), at(0.0, 1.0, 0.0));
    d
}

fn builtin(name: &str) -> Result<Sky> {
    let library = renderflow_scenes::sky::library();
    let found = library.iter().find(|(known, _)| *known == name);
    Ok(found.with_context(|| format!("the sky {name} is not in the library"))?.1.clone())
}

fn studio() -> Result<Described> {
    still_life("studio", builtin("studio_three_point")?)
}

fn overcast() -> Result<Described> {
    let zenith = [0.95, 1.0, 1.05];
    let sky = Sky::Overcast { zenith, ground: [0.3, 0.3, 0.29], glow: 1.0, glow_elevation: 50.0, glow_azimuth: 140.0 };
    still_life("overcast", sky)
}

fn textured() -> Result<Described> {
    let mut d = Described::new("textured", look([3.6, 2.6, 5.2], [0.0, 0.8, 0.0], 36.0), day(2.0, 0.5));
    let (bricks, worn) = (models::bricks(512)?, models::worn_metal(512)?);
    let plain = |name: &str| Material { roughness: 1.0, ..plastic(name, [1.0; 3], 1.0, 0.5) };
    let shiny = |name: &str| Material { metallic: 1.0, ..plain(name) };
    let ground = d.maps("bricks", &bricks, 0.5, plain("ground"));
    d.shape(Shape::Plane { size: 20.0 }, ground, at(0.0, 0.0, 0.0));
    let ball = d.maps("worn", &worn, 1.0, shiny("ball"));
    d.shape(Shape::Sphere { radius: 0.8 }, ball, at(-1.3, 0.8, 0.6));
    let pillar = d.maps("bricks", &bricks, 0.8, plain("pillar"));
    d.shape(Shape::Box { size: [0.9, 2.2, 0.9], bevel: 0.04 }, pillar, turned(1.5, 1.1, -0.9, [0.0, 25.0, 0.0]));
    let ring = d.maps("worn", &worn, 2.0, shiny("ring"));
    d.shape(Shape::Torus { radius: 0.6, tube: 0.25 }, ring, turned(0.6, 0.25, 1.3, [0.0, 40.0, 0.0]));
    let radii = vec![0.35, 0.5, 0.62, 0.5, 0.28, 0.34];
    let vase = d.maps("worn", &worn, 1.0, Material { metallic: 0.0, ..plain("vase") });
    d.shape(Shape::Lathe { radii, height: 1.5, wall: 0.05 }, vase, at(-0.2, 0.75, -1.3));
    d.shape(Shape::Sphere { radius: 0.35 }, metal("mirror", [0.92; 3], 0.05), at(1.9, 0.35, 0.7));
    Ok(d)
}

fn million() -> Result<Described> {
    let mut d = Described::new("million", look([7.0, 4.2, 10.5], [0.0, 0.6, 0.0], 40.0), day(4.0, 0.4));
    d.model(&models::terrain(24.0, 725), plastic("hills", [0.36, 0.4, 0.22], 0.85, 0.4), at(0.0, 0.0, 0.0))?;
    for i in 0..12u8 {
        let f = f64::from(i);
        let (angle, reach) = (TAU * f / 12.0 + 0.2, 1.6 + 0.28 * f);
        let radius = 0.32 + 0.05 * (f32::from(i) * 1.7).sin();
        let color = [0.25 + 0.06 * f32::from(i), 0.85 - 0.055 * f32::from(i), 0.3 + 0.4 * f32::from(i % 2)];
        let name = format!("body_{i:02}");
        let roughness = 0.1 + 0.07 * f32::from(i);
        let material = if i % 3 == 0 { metal(&name, color, roughness) } else { plastic(&name, color, roughness, 0.5) };
        let shape = match i % 4 {
            0 => Shape::Sphere { radius },
            1 => Shape::TorusKnot { p: 2, q: 3, radius, tube: 0.25 * radius },
            2 => Shape::Rock { radius, roughness: 0.3, frequency: 1.5, seed: i.into(), facets: false },
            _ => Shape::Gear { teeth: 14, radius, depth: 0.2, hole: 0.3, height: 0.3 },
        };
        d.shape(shape, material, turned(reach * angle.cos(), 0.55, reach * angle.sin(), [20.0 * f32::from(i), 10.0, 0.0]));
    }
    Ok(d)
}

/// A room of 6 x 2.8 x 5 m with a window in the wall at -x; the sun falls through it to the floor.
fn interior() -> Result<Described> {
    let sun = Sun { elevation: 32.0, azimuth: 285.0, radius: 0.5, gain: 1.0 };
    let sky = Sky::Daylight { sun, turbidity: 3.0, ground: [0.25, 0.24, 0.2], luminance: 6.0 };
    let mut d = Described::new("interior", look([2.6, 1.5, 2.1], [-1.2, 1.0, -0.9], 62.0), sky);
    let slab = |size| Shape::Box { size, bevel: 0.0 };
    let wall = |name: &str| plastic(name, [0.75, 0.73, 0.68], 0.9, 0.3);
    d.shape(slab([6.4, 0.2, 5.4]), plastic("floor", [0.42, 0.28, 0.17], 0.35, 0.5), at(0.0, -0.1, 0.0));
    d.shape(slab([6.4, 0.2, 5.4]), wall("ceiling"), at(0.0, 2.9, 0.0));
    d.shape(slab([6.4, 2.8, 0.2]), wall("back"), at(0.0, 1.4, -2.6));
    d.shape(slab([6.4, 2.8, 0.2]), wall("front"), at(0.0, 1.4, 2.6));
    d.shape(slab([0.2, 2.8, 5.0]), plastic("red_wall", [0.6, 0.2, 0.15], 0.8, 0.3), at(3.1, 1.4, 0.0));
    // Around an opening of 3 x 1.9 m, its sill 0.5 m above the floor.
    d.shape(slab([0.2, 0.5, 5.0]), wall("below_window"), at(-3.1, 0.25, 0.0));
    d.shape(slab([0.2, 0.4, 5.0]), wall("above_window"), at(-3.1, 2.6, 0.0));
    d.shape(slab([0.2, 1.9, 1.0]), wall("left_of_window"), at(-3.1, 1.45, 2.0));
    d.shape(slab([0.2, 1.9, 1.0]), wall("right_of_window"), at(-3.1, 1.45, -2.0));
    d.shape(slab([1.6, 0.08, 0.9]), plastic("table", [0.5, 0.33, 0.2], 0.25, 0.5), at(-0.6, 0.76, -0.8));
    for (i, (x, z)) in [(-1.3, -1.15), (0.1, -1.15), (-1.3, -0.45), (0.1, -0.45)].into_iter().enumerate() {
        d.shape(slab([0.06, 0.72, 0.06]), metal(&format!("leg_{i}"), [0.6; 3], 0.3), at(x, 0.36, z));
    }
    d.shape(Shape::Sphere { radius: 0.2 }, metal("ball", [0.95, 0.75, 0.4], 0.1), at(-0.3, 1.0, -0.7));
    let radii = vec![0.1, 0.17, 0.2, 0.12, 0.08, 0.11];
    d.shape(Shape::Lathe { radii, height: 0.5, wall: 0.02 }, plastic("vase", [0.15, 0.3, 0.6], 0.1, 0.8), at(-0.95, 1.05, -0.85));
    d.shape(Shape::Torus { radius: 0.4, tube: 0.16 }, plastic("cushion", [0.7, 0.6, 0.2], 0.9, 0.2), at(1.5, 0.16, -1.5));
    Ok(d)
}

fn forest() -> Result<Described> {
    let mut d = Described::new("forest", look([7.5, 3.0, 9.0], [0.0, 1.7, 0.0], 42.0), day(3.0, 0.6));
    d.shape(Shape::Plane { size: 40.0 }, plastic("ground", [0.22, 0.2, 0.12], 0.9, 0.3), at(0.0, 0.0, 0.0));
    let bark = Material { name: "bark".into(), base_color: [0.25, 0.17, 0.1], roughness: 0.9, ..Material::default() };
    let mut trunks = Vec::new();
    for i in 0..40u8 {
        // Along a sunflower's spiral: nowhere crowded.
        let f = f64::from(i);
        let (angle, reach) = (f * 2.399_963, 0.95 * (f + 0.5).sqrt());
        let height = 2.0 + 0.7 * (f * 1.3).sin();
        let foot = DVec3::new(reach * angle.cos(), 0.0, reach * angle.sin());
        trunks.push((foot, height, 0.62 + 0.12 * (f * 2.1).cos()));
        let shape = Shape::Cone { radius: 0.09, top_radius: 0.04, height: 1.0 };
        let stretched = Transform { scale: [1.0, height as f32, 1.0], ..at(foot.x, 0.5 * height, foot.z) };
        if i == 0 {
            d.shape(shape, bark.clone(), stretched);
        } else {
            let name = format!("trunk_{i:02}");
            let object = Object {
                name,
                geometry: Geometry::Shape(shape),
                material: Some("bark".into()),
                transform: stretched,
                motion: None,
                animation: None,
            };
            d.scene.objects.push(object);
        }
    }
    d.model(&models::foliage(&trunks, 4096, 0.05), plastic("leaves", [0.16, 0.38, 0.08], 0.5, 0.5), at(0.0, 0.0, 0.0))?;
    Ok(d)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_scene_loads_with_the_triangles_it_is_there_for() {
        let least = [("soft_sun", 280_000), ("million", 1_050_000), ("forest", 327_680), ("textured", 5_000)];
        let mut hashes = Vec::new();
        for scene in ALL.iter().chain(&CLEAR) {
            let described = scene.describe(64).unwrap();
            described.scene.validate().unwrap();
            let loaded = described.load().unwrap();
            assert_eq!((loaded.cameras[0].width, loaded.cameras[0].height), (64, 64));
            assert_eq!(loaded.report.triangles.dropped(), 0, "{}: {:?}", scene.name, loaded.report);
            let triangles: usize = loaded.instances.iter().map(|i| loaded.meshes[i.mesh].triangles.len()).sum();
            let (_, wanted) = least.iter().find(|(name, _)| *name == scene.name).unwrap_or(&("", 100));
            assert!(triangles >= *wanted, "{}: {triangles} triangles", scene.name);
            assert!(!hashes.contains(&loaded.hash));
            hashes.push(loaded.hash);
        }
        assert!(open("no_such_scene", None, &[]).is_err_and(|e| e.to_string().contains("soft_sun")));
        let all = expand(&["soft_sun".into(), "composed".into(), "mine.json".into()]);
        assert!(all.len() == 18 && all[1] == "composed_01" && all[16] == "composed_16", "{all:?}");
        assert!(all[..17].iter().all(|name| exists(name).is_ok()));
    }
}
