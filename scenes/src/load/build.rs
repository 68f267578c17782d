//! From a [`Scene`] to a [`LoadedScene`].

mod hollow;
mod lights;
mod models;

use super::gltf::rig::Rig;
use super::patterns::Patterns;
use super::{images, mesh};
use crate::description::{EnvironmentSource, Geometry, Material as Described, NameOrNumber, Object, Scene, TextureWrap};
use crate::error::{Error, Problem, Result};
use crate::loaded::{AlphaMask, Encoding, PunctualLight, Wrap};
use crate::texture::{Budget, uv_transform};
use crate::{Instance, LoadReport, LoadedScene, Material, Mesh, Principled, Texture, TextureSlot, tangents};
use glam::{DAffine3, DVec3, Mat2};
use models::Placed;
use rayon::prelude::*;
use renderflow_frame::reach::Reach;
use renderflow_frame::{Environment, file};
use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};
use std::path::PathBuf;
use std::rc::Rc;

/// Turns of texture coordinates that differ by no more, in any number of their matrices, are the same one.
const SAME_TURN: f32 = 1e-5;

/// Validates `scene` and loads what it refers to; `reach` says where relative paths start, the folder of the scene file, and
/// which files the scene, and the models in it, may name.
///
/// Images that nothing looks at are not read, so they need not be there: those of materials on no object, normal maps on meshes
/// without texture coordinates, and those that a factor of zero hides.
///
/// # Errors
/// [`Error::Invalid`] as [`Scene::validate`]; for a file that cannot be read, the place in the scene, the file and the place in
/// it;
/// [`Error::Name`] for a name that leads out of reach.
pub fn load(scene: &Scene, reach: &Reach) -> Result<LoadedScene> {
    build(scene, reach, false)
}

/// As [`load`], the images that nothing looks at included: for measurements.
///
/// # Errors
/// As [`load`].
#[doc(hidden)]
pub fn load_everything(scene: &Scene, reach: &Reach) -> Result<LoadedScene> {
    build(scene, reach, true)
}

fn build(scene: &Scene, reach: &Reach, everything: bool) -> Result<LoadedScene> {
    scene.validate()?;
    let reach = &reach.noting();
    let mut report = LoadReport::default();
    let environment = environment(scene, reach, &mut report)?;
    let mut build = Build { report, ..Build::new(scene, reach) };
    build.described_materials();
    for (index, object) in scene.objects.iter().enumerate() {
        build.object(index, object).map_err(|e| e.at(format!("/objects/{index} ({})", object.name)))?;
    }
    build.described_lights()?;
    build.note_unused();
    build.prepare_tangents();
    build.read_images(everything)?;
    build.note_inside_out();
    build.note_hollow();
    build.mirror();
    build.drop_idle_masks();
    build.weigh_colors();
    build.meshes.iter_mut().for_each(Mesh::settle);
    Ok(LoadedScene {
        name: scene.name.clone(),
        seed: scene.seed,
        hash: scene.hash(),
        files: content(reach.noted())?,
        meshes: build.meshes,
        instances: build.instances,
        materials: build.materials,
        textures: build.textures,
        origin: build.origin,
        environment,
        lights: build.lights,
        cameras: (0..scene.frames).map(|frame| scene.camera(frame)).collect(),
        report: build.report,
    })
}

/// BLAKE3 of what the files `paths` hold, in the order of their names without folders, hexadecimal; empty without files.
fn content(paths: BTreeSet<PathBuf>) -> Result<String> {
    if paths.is_empty() {
        return Ok(String::new());
    }
    let of = |path: &PathBuf| {
        let mut hasher = blake3::Hasher::new();
        hasher.update_reader(file::open(path)?).map_err(renderflow_frame::Error::io(path, "read"))?;
        Ok((path.file_name().map(ToOwned::to_owned), *hasher.finalize().as_bytes()))
    };
    let mut hashes: Vec<_> = paths.par_iter().map(of).collect::<Result<_>>()?;
    hashes.sort_unstable();
    let mut all = blake3::Hasher::new();
    hashes.iter().for_each(|(_, hash)| _ = all.update(hash));
    Ok(all.finalize().to_hex().to_string())
}

fn environment(scene: &Scene, reach: &Reach, report: &mut LoadReport) -> Result<Environment> {
    let light = &scene.environment;
    let place = |e: Error| e.at("/environment/source");
    let mut environment = Environment::constant([0.0; 3]);
    match &light.source {
        EnvironmentSource::Constant(radiance) => environment = Environment::constant(*radiance),
        EnvironmentSource::File(file) => {
            let path = reach.resolve(file).map_err(|reason| place(Error::Name { reason }))?;
            let loaded = renderflow_frame::hdr::read(&path).map_err(|e| place(e.into()))?;
            reach.note(&path);
            if loaded.repaired > 0 {
                let what = "texels that were NaN, infinite or negative became 0";
                report.notes.push(format!("{}: {} {what}", path.display(), loaded.repaired));
            }
            report.repaired_texels = loaded.repaired;
            environment.map = loaded.map;
        }
        EnvironmentSource::Builtin(name) => {
            environment.map = crate::sky::builtin(name).ok_or_else(|| {
                let known = crate::sky::names().join(", ");
                let pointer = "/environment/source/builtin".into();
                let problem = Problem { pointer, reason: format!("no environment is named {name:?}; there are {known}") };
                Error::Invalid { file: None, problems: vec![problem] }
            })?;
        }
        EnvironmentSource::Sky(sky) => {
            // The size of the named maps: a map and its parameters written out give the same light.
            let [width, height] = crate::sky::LIBRARY_SIZE;
            environment.map = crate::sky::render(sky, width, height);
        }
    }
    environment.rotation = light.rotation.rem_euclid(360.0).to_radians();
    environment.intensity = light.intensity;
    Ok(environment)
}

struct Build<'a> {
    scene: &'a Scene,
    reach: &'a Reach,
    /// What textures may take.
    budget: Budget,
    /// Where transforms are counted from.
    origin: DVec3,
    meshes: Vec<Mesh>,
    /// Where each mesh's own zero was before it was moved there, in its own space.
    centers: Vec<DVec3>,
    instances: Vec<Instance>,
    materials: Vec<Material>,
    textures: Vec<Texture>,
    lights: Vec<PunctualLight>,
    report: LoadReport,
    shapes: HashMap<String, usize>,
    models: HashMap<PathBuf, Placed>,
    /// Node trees of files with the animation that objects play.
    rigs: HashMap<(PathBuf, Option<NameOrNumber>), Rc<Rig>>,
    images: HashMap<(PathBuf, Encoding, Wrap), usize>,
    wanted: Vec<images::Wanted>,
    patterns: Patterns,
    material_names: Names,
    instance_names: Names,
    light_names: Names,
    default_material: Option<usize>,
    /// Materials of files for objects of another size, by the file's material and the bits of the size.
    scaled: HashMap<(usize, u32), usize>,
}

impl<'a> Build<'a> {
    fn new(scene: &'a Scene, reach: &'a Reach) -> Self {
        Self {
            scene,
            reach,
            budget: Budget::of_machine(),
            origin: scene.camera.origin(),
            meshes: vec![],
            centers: vec![],
            instances: vec![],
            materials: vec![],
            textures: vec![],
            lights: vec![],
            report: LoadReport::default(),
            shapes: HashMap::new(),
            models: HashMap::new(),
            rigs: HashMap::new(),
            images: HashMap::new(),
            wanted: vec![],
            patterns: Patterns::default(),
            material_names: Names::new(scene.materials.iter().map(|m| &m.name)),
            // A part of a model must not take the name of a later object.
            instance_names: Names::new(scene.objects.iter().map(|o| &o.name)),
            light_names: Names::new(scene.lights.iter().map(|light| &light.name)),
            default_material: None,
            scaled: HashMap::new(),
        }
    }

    /// Materials of the description come first, in its order, so that their ids are known without loading.
    fn described_materials(&mut self) {
        for (i, described) in self.scene.materials.iter().enumerate() {
            let mut material = self.described(described, &format!("/materials/{i}"));
            if let Some(pattern) = &described.pattern {
                self.patterns.add(pattern, described, &mut material, &mut self.textures);
            }
            self.materials.push(material);
        }
    }

    fn described(&mut self, described: &Described, place: &str) -> Material {
        let surface = Principled::from(described);
        let mut slot = |file: &Option<String>, encoding| file.as_ref().map(|file| self.image(described, place, file, encoding));
        Material {
            name: described.name.clone(),
            surface,
            base_color_texture: slot(&described.base_color_texture, Encoding::Srgb),
            metallic_roughness_texture: slot(&described.metallic_roughness_texture, Encoding::Linear),
            normal_texture: slot(&described.normal_texture, Encoding::Normal).map(|s| (s, 1.0)),
            emissive: described.emissive,
            emissive_texture: slot(&described.emissive_texture, Encoding::Srgb),
            anisotropy_rotation: 0.0,
            alpha_mask: described.alpha_cutoff.map(|cutoff| AlphaMask { cutoff, factor: 1.0 }),
            opacity: described.opacity,
            transmission_texture: None,
            thin_walled: described.thin_walled,
            absorption: absorption(described.attenuation_color, described.attenuation_distance),
            double_sided: described.double_sided,
            change: described.change.as_ref().map(|change| change.applied(surface)),
        }
    }

    /// The texture of an image, which is read later.
    fn image(&mut self, user: &Described, place: &str, file: &str, encoding: Encoding) -> TextureSlot {
        // A name that is refused fails where the image is read, if it is.
        let path = self.reach.resolve(file);
        let wrap = wrap(user);
        let key = (path.clone().unwrap_or_else(|_| file.into()), encoding, wrap);
        let texture = match self.images.get(&key) {
            Some(&known) => known,
            None => {
                let texture = self.textures.len();
                self.textures.push(images::placeholder(file, encoding, [wrap; 2]));
                let user = format!("material {:?}", user.name);
                self.wanted.push(images::Wanted { texture, path, place: place.into(), user });
                self.images.insert(key, texture);
                texture
            }
        };
        slot(user, texture)
    }

    /// Reads the images of described materials and makes their patterns, those that nothing looks at only if `everything` is
    /// asked for.
    fn read_images(&mut self, everything: bool) -> Result<()> {
        if everything {
            self.patterns.make(&mut self.materials, &mut self.textures, true);
            return images::read(&self.wanted, &self.materials, &mut self.textures, &self.budget, self.reach);
        }
        for name in images::drop_idle_slots(&mut self.materials, &self.instances, &self.meshes) {
            self.report.notes.push(format!("material {name:?} is on no object: its textures are not read"));
        }
        self.patterns.make(&mut self.materials, &mut self.textures, false);
        images::read(&self.wanted, &self.materials, &mut self.textures, &self.budget, self.reach)?;
        images::drop_idle_textures(&mut self.materials, &mut self.textures);
        Ok(())
    }

    fn object(&mut self, index: usize, object: &Object) -> Result<()> {
        let frames = if object.moves() { self.scene.frames } else { 1 };
        let placements: Vec<DAffine3> = (0..frames).map(|f| object.transform_at(f)).collect();
        let own = object.material.as_ref().and_then(|name| self.scene.materials.iter().position(|m| m.name == *name));
        let object_id = index as u32 + 1;
        match &object.geometry {
            Geometry::Shape(shape) => {
                let key = serde_json::to_string(shape).unwrap_or_default();
                let mesh = match self.shapes.get(&key) {
                    Some(&known) => known,
                    None => {
                        let made = crate::shapes::mesh(shape);
                        self.shapes.insert(key, self.meshes.len());
                        self.add_mesh(made)
                    }
                };
                let material = own.unwrap_or_else(|| self.default_material());
                let transforms = placements.iter().map(|&p| super::relative(p, self.origin)).collect();
                self.instances.push(Instance { name: object.name.clone(), mesh, material, object_id, transforms });
            }
            Geometry::File(file) => {
                let path = self.reach.resolve(file).map_err(|reason| Error::Name { reason })?;
                if !self.models.contains_key(&path) {
                    let placed = self.add_model(&path, file)?;
                    self.reach.note(&path);
                    self.models.insert(path.clone(), placed);
                }
                self.instantiate(&path, object, own, object_id, &placements)?;
            }
        }
        Ok(())
    }

    fn add_mesh(&mut self, mut made: Mesh) -> usize {
        self.report.triangles += mesh::clean(&mut made);
        // Joints and targets know the vertices where they stand.
        self.centers.push(if made.deforms() { DVec3::ZERO } else { mesh::recentre(&mut made) });
        self.meshes.push(made);
        self.meshes.len() - 1
    }

    /// A mesh of a file that was added as it rests: its triangles were counted then.
    fn add_deforming(&mut self, made: Mesh) -> usize {
        let counted = self.report.triangles;
        let mesh = self.add_mesh(made);
        self.report.triangles = counted;
        mesh
    }

    fn default_material(&mut self) -> usize {
        if let Some(known) = self.default_material {
            return known;
        }
        let name = self.material_names.unique("default");
        self.materials.push(Material { name, ..Material::default() });
        self.default_material = Some(self.materials.len() - 1);
        self.materials.len() - 1
    }

    /// Tangents for the meshes that a normal map or a stretched highlight is seen on, and only for them. Those that a file brings
    /// stay. Others belong to the coordinates that the normal map is looked up with: a mesh whose materials turn theirs
    /// differently becomes several.
    fn prepare_tangents(&mut self) {
        let mut told = HashSet::new();
        let mut asked: BTreeMap<usize, Vec<(Mat2, Vec<usize>)>> = BTreeMap::new();
        for (number, instance) in self.instances.iter().enumerate() {
            let (material, mesh) = (&self.materials[instance.material], &self.meshes[instance.mesh]);
            let bumpy = material.normal_texture.is_some();
            if !(bumpy || material.surface.anisotropic > 0.0) || !mesh.tangents.is_empty() {
                continue;
            }
            if mesh.uvs.is_empty() {
                if told.insert((instance.mesh, instance.material)) {
                    let what = if bumpy { "normal map" } else { "anisotropy" };
                    let note = format!(
                        "{}: the {what} of {:?} is not applied: the mesh has no texture coordinates",
                        instance.name, material.name
                    );
                    self.report.notes.push(note);
                }
                continue;
            }
            let turn = material.normal_texture.as_ref().map_or(Mat2::IDENTITY, |(slot, _)| tangents::turn(&slot.uv_transform));
            let turns = asked.entry(instance.mesh).or_default();
            match turns.iter_mut().find(|(known, _)| known.abs_diff_eq(turn, SAME_TURN)) {
                Some((_, instances)) => instances.push(number),
                None => turns.push((turn, vec![number])),
            }
        }
        for (mesh, turns) in asked {
            // The first keeps the mesh, which the others are copied from before it has tangents.
            for (turn, instances) in turns.iter().skip(1) {
                let mut copy = self.meshes[mesh].clone();
                tangents::generate(&mut copy, *turn);
                instances.iter().for_each(|&number| self.instances[number].mesh = self.meshes.len());
                self.meshes.push(copy);
            }
            tangents::generate(&mut self.meshes[mesh], turns[0].0);
        }
    }

    /// Says which bodies of model files face inwards and are not there from outside.
    fn note_inside_out(&mut self) {
        let of_files: HashSet<usize> =
            self.models.values().flat_map(|placed| placed.parts.iter().map(|part| placed.first_mesh + part.mesh)).collect();
        let mut judged = HashSet::new();
        let turned: Vec<&Instance> = self
            .instances
            .iter()
            .filter(|i| !self.materials[i.material].double_sided && of_files.contains(&i.mesh) && judged.insert(i.mesh))
            .filter(|i| mesh::is_inside_out(&self.meshes[i.mesh]))
            .collect();
        let Some(first) = turned.first() else { return };
        let others = match turned.len() - 1 {
            0 => String::new(),
            1 => " (and one more mesh)".into(),
            more => format!(" (and {more} more meshes)"),
        };
        self.report.notes.push(format!(
            "{}{others}: the faces of this closed, single-sided surface point inwards: from outside only its far side is seen",
            first.name
        ));
    }

    /// Takes masks away that cut nothing and opacities that cover everything, and counts those that stay.
    fn drop_idle_masks(&mut self) {
        let of_mesh = |mesh: &Mesh| mesh.colors.iter().map(|color| color.w).fold(1.0, f32::min);
        let of_meshes: Vec<f32> = self.meshes.iter().map(of_mesh).collect();
        let mut least_alphas = vec![1.0_f32; self.materials.len()];
        for Instance { mesh, material, .. } in &self.instances {
            least_alphas[*material] = least_alphas[*material].min(of_meshes[*mesh]);
        }
        for (material, least_alpha) in self.materials.iter_mut().zip(least_alphas) {
            let lowest = material.base_color_texture.as_ref().map_or(1.0, |slot| self.textures[slot.texture].lowest_alpha());
            // As the renderer multiplies them.
            let lowest = lowest * least_alpha;
            if let Some(AlphaMask { cutoff, factor }) = material.alpha_mask {
                if factor * lowest >= cutoff {
                    material.alpha_mask = None;
                } else {
                    self.report.alpha_masked += 1;
                }
            }
            if let Some(opacity) = material.opacity {
                if opacity * lowest >= 1.0 {
                    material.opacity = None;
                } else {
                    self.report.blended += 1;
                }
            }
        }
    }

    /// Keeps the colour that textures have in holes out of what is seen beside them; light that lies as the colour does has the
    /// same holes. A texture that something else looks at too, for which alpha means nothing, stays, and the material with holes
    /// gets one of its own.
    fn weigh_colors(&mut self) {
        let has_holes = |material: &Material| material.alpha_mask.is_some() || material.opacity.is_some();
        let mut others = self.materials.clone();
        for material in others.iter_mut().filter(|material| has_holes(material)) {
            let color = material.base_color_texture.take();
            material.emissive_texture.take_if(|light| color.as_ref() == Some(light));
        }
        let shared = images::looked_at(&others, self.textures.len());
        let mut known = HashMap::new();
        for material in self.materials.iter_mut().filter(|material| has_holes(material)) {
            let Some(slot) = &mut material.base_color_texture else { continue };
            let light = material.emissive_texture.as_mut().filter(|light| **light == *slot);
            slot.texture = *known.entry(slot.texture).or_insert_with_key(|&texture| {
                let Some(weighed) = self.textures[texture].weighed_by_alpha() else { return texture };
                if !shared[texture] {
                    self.textures[texture] = weighed;
                    return texture;
                }
                self.textures.push(weighed);
                self.textures.len() - 1
            });
            if let Some(light) = light {
                light.texture = slot.texture;
            }
        }
    }

    /// Instances with a mirroring transform get a mesh with reversed winding.
    fn mirror(&mut self) {
        let mut copies = HashMap::new();
        for instance in &mut self.instances {
            // In double precision: the determinant of a scale of 1e-13 has none in single.
            if instance.transforms[0].matrix3.as_dmat3().determinant() < 0.0 {
                instance.mesh = *copies.entry(instance.mesh).or_insert_with(|| {
                    self.meshes.push(mesh::mirrored(&self.meshes[instance.mesh]));
                    self.meshes.len() - 1
                });
            }
        }
    }
}

/// What a body absorbs per metre that turns white light into `color` over `distance` metres (Beer and Lambert's law).
pub(in crate::load) fn absorption(color: [f32; 3], distance: f32) -> [f32; 3] {
    color.map(|share| if share < 1.0 { -share.max(1e-6).ln() / distance } else { 0.0 })
}

/// How the textures of a material go on.
pub(super) fn wrap(material: &Described) -> Wrap {
    match material.texture_wrap {
        TextureWrap::Repeat => Wrap::Repeat,
        TextureWrap::Mirror => Wrap::Mirror,
        TextureWrap::Clamp => Wrap::Clamp,
    }
}

/// Texture `texture` as it lies on a material.
pub(super) fn slot(material: &Described, texture: usize) -> TextureSlot {
    let lie = &material.texture_transform;
    TextureSlot { texture, uv_transform: uv_transform(lie.offset, lie.rotation.to_radians(), lie.scale), set: 0 }
}

/// Names given so far, each with how often it was asked for.
struct Names(HashMap<String, usize>);

impl Names {
    fn new<'a>(taken: impl Iterator<Item = &'a String>) -> Self {
        Self(taken.map(|name| (name.clone(), 1)).collect())
    }

    /// `name`, or `name#2`, `name#3`, ... when it is taken; the result is taken afterwards.
    fn unique(&mut self, name: &str) -> String {
        let Some(count) = self.0.get(name).copied() else {
            self.0.insert(name.into(), 1);
            return name.into();
        };
        let (n, free) = (count + 1..)
            .map(|n| (n, format!("{name}#{n}")))
            .find(|(_, s)| !self.0.contains_key(s))
            .expect("some number is free");
        self.0.insert(name.into(), n);
        self.0.insert(free.clone(), 1);
        free
    }
}
