//! Compiles a loaded scene: its geometry, material and light tables, and the features the scene needs.

mod check;
mod material;

use crate::accel::{Hit, Scratch};
use crate::camera::Shutter;
use crate::error::{Error, Result};
use crate::features::FeatureSet;
use crate::geometry::{Builds, Geometry, Sharing, Wanted};
use crate::light::{DistantLight, EmissiveTriangle, EnvironmentLight, Lamp, LightSampler, Lights, Repairs, Sampling, Selection};
use crate::material::{Prepared, Principled};
use crate::ray::Ray;
use crate::texture::{Lookup, Sampled};
use check::check;
use glam::Vec3A;
use material::least_alphas;
use renderflow_frame::{Camera, Environment, Light};
use renderflow_scenes::loaded::PunctualLight;
use renderflow_scenes::{Instance, LoadedScene, Material, TextureSlot};
use std::sync::{Arc, OnceLock};

pub use material::Clear;
pub(crate) use material::CompiledMaterial;

/// Most sets of texture coordinates beyond the first: one for every kind of texture of a material.
const MAX_UV_SETS: usize = 8;

/// A scene at one frame, ready to be rendered.
pub struct RenderScene {
    pub(crate) geometry: Geometry,
    pub(crate) materials: Vec<CompiledMaterial>,
    /// Those that change along the sequence, by number, as loaded.
    changing: Vec<(usize, Material)>,
    pub(crate) textures: Vec<Sampled>,
    pub(crate) lights: LightSampler,
    /// Of each instance, the number of its first triangle among the emissive ones.
    first_emitter: Vec<Option<u32>>,
    /// Instance and triangle of every emissive triangle.
    emitters: Vec<(u32, u32)>,
    /// Lights without an area.
    punctual: Vec<PunctualLight>,
    /// How light samples choose among the lights.
    selection: Selection,
    light: Arc<Light>,
    pub(crate) seed: u64,
    pub(crate) hash: String,
    pub(crate) files: String,
    /// One a pose: those of a frame, one after the other.
    cameras: Vec<Camera>,
    shutter: Option<Shutter>,
    /// Offsets of the moments that follow each frame, in frames; empty without a shutter.
    moments: Vec<f64>,
    frame: usize,
    /// Entry of lists with one a frame, or one a frame and moment, that holds now.
    pose: usize,
    features: FeatureSet,
    bsdfs: OnceLock<Vec<Option<Prepared>>>,
}

impl RenderScene {
    /// Compiles `scene` at frame 0.
    ///
    /// # Errors
    /// When the scene has no camera, refers to a mesh, material, texture or vertex it does not hold, or has more than 2^28
    /// triangles.
    pub fn compile(scene: &LoadedScene) -> Result<Self> {
        Self::compile_with(scene, Sharing::Automatic)
    }

    /// As [`Self::compile`], with another choice of what is flattened: for measurements, the picture is the same up to rounding.
    ///
    /// # Errors
    /// As [`Self::compile`].
    pub fn compile_with(scene: &LoadedScene, sharing: Sharing) -> Result<Self> {
        Self::of(scene, sharing, None)
    }

    /// As [`Self::compile`], for [`crate::render_with_shutter`]: [`Self::set_moment`] moves to where things are while
    /// `shutter` is open.
    ///
    /// # Errors
    /// As [`Self::compile`], and when the shutter is out of range.
    pub fn compile_with_shutter(scene: &LoadedScene, shutter: Shutter) -> Result<Self> {
        shutter.check()?;
        Self::of(&scene.with_moments(&shutter.offsets()), Sharing::Automatic, Some(shutter))
    }

    /// `scene` has the moments of `shutter` behind each frame.
    fn of(scene: &LoadedScene, sharing: Sharing, shutter: Option<Shutter>) -> Result<Self> {
        let moments = shutter.map(|shutter| shutter.offsets()).unwrap_or_default();
        check(scene, sharing)?;
        let textures: Vec<Sampled> = scene.textures.iter().map(Sampled::new).collect();
        let frames = scene.cameras.len() / (1 + moments.len());
        let materials = scene.materials.iter().zip(least_alphas(scene));
        let materials: Vec<_> =
            materials.map(|(m, least_alpha)| CompiledMaterial::new(&m.at(0.0, frames), &textures, least_alpha)).collect();
        let changing = scene.materials.iter().cloned().enumerate().filter(|(_, m)| m.change.is_some()).collect();
        let light = EnvironmentLight::new(&scene.environment)?;
        let features = features(&materials, &scene.instances, &light, &scene.lights);
        let wanted = Wanted {
            uv_sets: if features.textures { 1 + further_sets(&scene.materials, &scene.instances) } else { 0 },
            tangents: materials.iter().map(|m| m.normal_texture.is_some() || m.surface.anisotropic > 0.0).collect(),
            colors: materials.iter().any(CompiledMaterial::has_colors),
        };
        let mut compiled = Self {
            geometry: Geometry::new(scene.meshes.clone(), scene.instances.clone(), wanted, sharing),
            materials,
            changing,
            textures,
            lights: LightSampler::new(light, Lights::default()),
            first_emitter: vec![None; scene.instances.len()],
            emitters: Vec::new(),
            punctual: scene.lights.clone(),
            selection: Selection::default(),
            light: Arc::new(Light::new(scene.environment.clone())),
            seed: scene.seed,
            hash: scene.hash.clone(),
            files: scene.files.clone(),
            cameras: scene.cameras.clone(),
            shutter,
            moments,
            frame: 0,
            pose: 0,
            features,
            bsdfs: OnceLock::new(),
        };
        compiled.place_emitters();
        Ok(compiled)
    }

    /// Updates the materials that change along the sequence, and everything that depends on them, to the current pose.
    fn place_materials(&mut self) {
        let mut changed = false;
        let (frames, each) = (self.frames(), 1 + self.moments.len());
        let offset = (self.pose % each).checked_sub(1).map_or(0.0, |moment| self.moments[moment]);
        let time = self.frame as f64 + offset;
        for (number, material) in &self.changing {
            let made = CompiledMaterial::new(&material.at(time, frames), &self.textures, self.materials[*number].least_alpha);
            let old = &mut self.materials[*number];
            if made.surface != old.surface {
                changed = true;
                *old = made;
                if let Some(bsdfs) = self.bsdfs.get_mut() {
                    bsdfs[*number] = old.prepared(self.geometry.directs(*number));
                }
            }
        }
        if changed {
            self.features = features(&self.materials, &self.geometry.instances, self.lights.environment(), &self.punctual);
        }
    }

    /// Finds the emissive triangles and the lights without an area at the current pose.
    fn place_emitters(&mut self) {
        if !self.features.lights() {
            return;
        }
        let mut triangles = Vec::new();
        self.emitters.clear();
        for (index, instance) in self.geometry.instances.iter().enumerate() {
            let material = &self.materials[instance.material];
            if material.emissive == Vec3A::ZERO {
                continue;
            }
            self.first_emitter[index] = Some(self.emitters.len() as u32);
            let (mesh, transform) = (self.geometry.mesh(instance.mesh), instance.transform(self.pose));
            let posed = mesh.posed(self.pose);
            for (number, triangle) in mesh.triangles.iter().enumerate() {
                let corners = triangle.map(|v| transform.transform_point3a(posed.positions[v as usize].into()));
                let mut radiance = material.emissive;
                if let Some(slot) = &material.emissive_texture {
                    let uvs = triangle.map(|v| mesh.uv_set(slot.set).get(v as usize).copied().unwrap_or_default());
                    let area = (uvs[1] - uvs[0]).perp_dot(uvs[2] - uvs[0]).abs();
                    // The mean over the triangle, from a mip level.
                    let lookup = Lookup { uv: (uvs[0] + uvs[1] + uvs[2]) / 3.0, footprint_log2: 0.5 * area.log2() };
                    radiance *= Vec3A::from_vec4(self.textures[slot.texture].value(slot, lookup));
                }
                let id = self.emitters.len() as u32;
                triangles.push(EmissiveTriangle { corners, radiance, two_sided: material.double_sided, id });
                self.emitters.push((index as u32, number as u32));
            }
        }
        // A flat environment is found by scattering, so the sampler sends the fewest possible samples there.
        let share = if self.features.flat_environment { 0.0 } else { 0.5 };
        let (lamps, distant) = self.lights_without_area();
        let lights = Lights { triangles, lamps, distant, selection: self.selection };
        self.lights = LightSampler::with_share(self.lights.environment().clone(), lights, share);
    }

    /// Points and spots, and light from single directions, at the current frame.
    pub(crate) fn lights_without_area(&self) -> (Vec<Lamp>, Vec<DistantLight>) {
        (
            self.punctual.iter().filter_map(|light| Lamp::new(light, self.pose)).collect(),
            self.punctual.iter().filter_map(|light| DistantLight::new(light, self.pose)).collect(),
        )
    }

    /// Chooses how light samples choose among the lights; [`Self::compile`] takes the default. For measurements: the picture
    /// converges to the same one.
    #[doc(hidden)]
    pub fn set_light_selection(&mut self, selection: Selection) {
        self.selection = selection;
        self.place_emitters();
    }

    /// Moves to `frame`; 0 is the first, and beyond the last frame the last pose is held. Nothing is done where only the camera
    /// moved. Materials that changed are prepared again. Where something moved, trees are refitted, and rebuilt only now and
    /// then. The picture is a function of the frame and does not depend on the frames before it.
    pub fn set_frame(&mut self, frame: usize) {
        self.frame = frame;
        self.set_pose(self.pose_at(frame));
    }

    /// Moves to moment `moment` of the shutter at the current frame. The frame's number stays, and with it the random numbers.
    /// [`Self::set_frame`] leads back.
    ///
    /// # Panics
    /// When the scene has no such moment.
    pub fn set_moment(&mut self, moment: usize) {
        assert!(moment < self.moments.len(), "moment {moment} of {}", self.moments.len());
        self.set_pose(self.pose_at(self.frame) + 1 + moment);
    }

    /// The shutter of [`Self::compile_with_shutter`].
    pub fn shutter(&self) -> Option<Shutter> {
        self.shutter
    }

    fn set_pose(&mut self, pose: usize) {
        let moved = |i: &Instance| !self.geometry.rests(i, pose, self.pose);
        let shone = |i: &&Instance| self.materials[i.material].emissive != Vec3A::ZERO;
        let emitters_moved = self.features.emitters && self.geometry.instances.iter().filter(shone).any(moved)
            || self.punctual.iter().any(|light| light.transform(pose) != light.transform(self.pose));
        self.pose = pose;
        self.geometry.set_frame(pose);
        self.place_materials();
        if emitters_moved {
            self.place_emitters();
        }
    }

    /// Replaces the scene's seed: all later pictures use other random numbers.
    pub fn reseed(&mut self, seed: u64) {
        self.seed = seed;
    }

    /// The same scene with random numbers from `seed` in place of its own.
    pub fn with_seed(mut self, seed: u64) -> Self {
        self.reseed(seed);
        self
    }

    /// As [`Self::set_frame`], with nothing kept of the tree over flattened triangles: for measurements.
    #[doc(hidden)]
    pub fn set_frame_anew(&mut self, frame: usize) {
        self.set_frame(frame);
        self.geometry.flatten();
    }

    /// The current frame.
    pub fn frame(&self) -> usize {
        self.frame
    }

    /// Number of frames that have a camera of their own.
    pub fn frames(&self) -> usize {
        self.cameras.len() / (1 + self.moments.len())
    }

    /// Camera of the current frame, at its moment.
    pub fn camera(&self) -> &Camera {
        &self.cameras[self.pose.min(self.cameras.len() - 1)]
    }

    /// Camera of `frame`, the last one beyond the end.
    pub(crate) fn camera_at(&self, frame: usize) -> &Camera {
        &self.cameras[self.pose_at(frame).min(self.cameras.len() - 1)]
    }

    /// Entry of `frame` in lists with one a frame, or one a frame and moment.
    pub(crate) fn pose_at(&self, frame: usize) -> usize {
        // Beyond the last frame that one is held, not its last moment.
        if self.moments.is_empty() { frame } else { frame.min(self.frames() - 1) * (1 + self.moments.len()) }
    }

    /// Entry that holds now.
    pub(crate) fn pose(&self) -> usize {
        self.pose
    }

    /// Looks at every frame with `camera`, whose origin is the one of the scene's own cameras ([`Self::camera`]).
    pub fn look_with(&mut self, camera: Camera) {
        self.cameras.fill(camera);
    }

    /// Gives material `number` other parameters, each limited to 0..=1, and keeps its textures. It no longer changes along the
    /// sequence. Anisotropy has no effect where the mesh has no tangents, or where the material had neither anisotropy nor a
    /// normal map when the scene was compiled.
    ///
    /// # Errors
    /// When there is no such material.
    pub fn set_surface(&mut self, number: usize, surface: &Principled) -> Result<()> {
        let count = self.materials.len();
        let Some(material) = self.materials.get_mut(number) else {
            return Err(Error::inconsistent("materials", format!("{number} does not exist, there are {count}")));
        };
        self.changing.retain(|(changing, _)| *changing != number);
        material.surface = surface.clamped();
        material.clear = Clear::of(&material.surface, material.thin_walled, material.metallic_roughness_texture.is_some());
        if let Some(bsdfs) = self.bsdfs.get_mut() {
            bsdfs[number] = material.prepared(self.geometry.directs(number));
        }
        self.features = features(&self.materials, &self.geometry.instances, self.lights.environment(), &self.punctual);
        Ok(())
    }

    /// Turns the environment to `rotation` (radians) about +Y. The exposure stays.
    pub fn turn_environment(&mut self, rotation: f32) {
        if rotation == self.light.environment.rotation {
            return;
        }
        self.light = Arc::new(self.light.turned(rotation));
        self.lights = LightSampler::new(self.lights.environment().turned(rotation), Lights::default());
        self.place_emitters();
    }

    /// Gives every frame's camera another resolution, the view kept.
    pub fn set_resolution(&mut self, width: usize, height: usize) {
        for camera in &mut self.cameras {
            *camera = camera.resized(width, height);
        }
    }

    /// The environment of the scene.
    pub fn environment(&self) -> &Environment {
        &self.light.environment
    }

    /// The environment with its split-sum tables and its exposure, which are computed on first use and kept.
    pub fn light(&self) -> &Arc<Light> {
        &self.light
    }

    /// The BSDF of each material, `None` where it changes from place to place. Made on first use, on this thread alone.
    pub(crate) fn bsdfs(&self) -> &[Option<Prepared>] {
        let prepared = |(number, material): (usize, &CompiledMaterial)| material.prepared(self.geometry.directs(number));
        self.bsdfs.get_or_init(|| self.materials.iter().enumerate().map(prepared).collect())
    }

    /// Factor from scene radiance to display-linear, from the environment alone ([`Light::exposure`]).
    pub fn exposure(&self) -> f32 {
        self.light.exposure()
    }

    /// Chooses what light samples of the environment follow; [`Self::compile`] takes the default.
    ///
    /// # Errors
    /// Never after [`Self::compile`] accepted the environment.
    pub fn set_environment_sampling(&mut self, sampling: Sampling) -> Result<()> {
        let environment = EnvironmentLight::with_sampling(self.environment(), sampling)?;
        self.lights = LightSampler::new(environment, Lights::default());
        self.place_emitters();
        Ok(())
    }

    /// Components of the environment's texels that could not be used as they are.
    pub fn environment_repairs(&self) -> Repairs {
        self.lights.environment().repairs()
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

    /// [`Self::closest`] of each ray, the same hits bit for bit; several times as fast for camera rays of neighbouring pixels,
    /// sixteen at a time. `hits` is as long as `rays`.
    pub fn closest_packet(&self, rays: &[Ray], hits: &mut [Option<Hit>], scratch: &mut Scratch) {
        self.geometry.closest_packet(rays, hits, scratch);
    }

    /// Whether any triangle stands in the way of `ray` (relative to the scene's origin), for measurements.
    #[inline]
    pub fn occluded(&self, ray: &Ray, scratch: &mut Scratch) -> bool {
        self.geometry.occluded(ray, scratch)
    }

    /// Instance and triangle of emitter `id`.
    #[inline]
    pub(crate) fn emitter(&self, id: u32) -> (u32, u32) {
        self.emitters[id as usize]
    }

    /// Number, among the emissive triangles, of triangle `triangle` of an instance; `None` where it does not emit.
    #[inline]
    pub(crate) fn emitter_id(&self, instance: u32, triangle: u32) -> Option<u32> {
        self.first_emitter[instance as usize].map(|first| first + triangle)
    }

    /// Value of a texture.
    #[inline]
    pub(crate) fn slot_value(&self, slot: &TextureSlot, lookup: Lookup) -> glam::Vec4 {
        self.textures[slot.texture].value(slot, lookup)
    }
}

/// The features that the instances need with these materials. A material that no instance uses must not slow the others down.
fn features(
    materials: &[CompiledMaterial],
    instances: &[Instance],
    light: &EnvironmentLight,
    punctual: &[PunctualLight],
) -> FeatureSet {
    let used = |f: &dyn Fn(&CompiledMaterial) -> bool| instances.iter().any(|i| f(&materials[i.material]));
    FeatureSet {
        textures: used(&|m| {
            let slots = [&m.base_color_texture, &m.metallic_roughness_texture, &m.emissive_texture, &m.transmission_texture];
            m.has_colors() || m.normal_texture.is_some() || slots.iter().any(|slot| slot.is_some())
        }),
        normal_maps: used(&|m| m.normal_texture.is_some()),
        flat_environment: light.constant().is_some(),
        black_environment: light.is_black(),
        layers: used(&|m| !m.surface.is_plain()),
        emitters: used(&|m| m.emissive != Vec3A::ZERO),
        punctual: !punctual.is_empty(),
        cutouts: used(&|m| !m.is_solid()),
        blended: used(&|m| m.opacity.is_some()),
        clear: used(&|m| m.clear != Clear::No),
        panes: used(&|m| m.clear == Clear::Pane),
    }
}

/// The highest set of texture coordinates that a material of an instance looks something up with.
fn further_sets(materials: &[Material], instances: &[Instance]) -> usize {
    let slots = instances.iter().flat_map(|instance| materials[instance.material].texture_slots());
    slots.map(|slot| slot.set).max().unwrap_or(0)
}
