//! The bodies that light paths are aimed at.

use crate::camera::Filter;
use crate::compile::{Clear, CompiledMaterial, RenderScene};
use crate::light::{LightId, LightSample, Receiver, Source};
use crate::settings::{DirectLight, Settings};
use glam::{Affine3A, DMat3, Vec3A};
use rayon::prelude::*;
use renderflow_scenes::Mesh;
use std::f32::consts::{PI, TAU};
use std::ops::Range;

/// Light less concentrated than this ([`crate::light::EnvironmentLight::concentration`]) makes no caustics that camera paths do
/// not find (docs/measurements/renderer-notes.md, light-paths).
const CONCENTRATION: f32 = 4.0;
/// Roughest lobe whose caustics are worth a path.
const ROUGHNESS: f32 = 0.5;
/// Paths for each sample and pixel that a metal body covers. More lower the error by little (docs/measurements/renderer-notes.md,
/// light-paths).
const DENSITY: f32 = 0.25;
/// The same for bodies that reflect little, in terms of [`DENSITY`].
const DIELECTRIC: f32 = 0.1;
/// Most light paths for each camera path.
const MOST: f32 = 0.25;

/// A body that light paths are aimed at.
#[derive(Clone, Copy, Debug)]
pub(super) struct CausticCaster {
    pub instance: u32,
    /// A sphere around it.
    pub center: Vec3A,
    pub radius: f32,
    /// Paths for one sample a pixel.
    pub paths: u32,
    /// Number of the first path, and the sample that it belongs to. Both are 0 but for a shutter, where they count on from moment
    /// to moment.
    first: (u64, u32),
}

/// All of them, and how dense light paths are at each.
pub(crate) struct CausticCasters {
    pub(super) list: Vec<CausticCaster>,
    /// By instance: its place in the list.
    of_instance: Vec<Option<u32>>,
    /// Whether light of the environment is followed.
    environment: bool,
}

/// Where a light path begins.
#[derive(Clone, Copy, Debug)]
pub(in crate::integrator) enum PathStart {
    /// In the environment.
    Environment,
    /// With light from one direction.
    Distant,
    /// At a light that stands somewhere.
    Near {
        light: LightId,
        /// The point on it.
        point: Vec3A,
        /// Normal of a triangle, on either side; 0 for a lamp.
        n: Vec3A,
    },
}

impl PathStart {
    /// Where the light of a light sample for a point at `p` begins.
    #[inline(always)]
    pub fn of(sample: &LightSample, p: Vec3A) -> Self {
        let near = |light, n| Self::Near { light, point: p + sample.wi * sample.distance, n };
        match sample.source {
            Source::Environment { .. } => Self::Environment,
            Source::Punctual { lamp: None, .. } => Self::Distant,
            Source::Punctual { lamp: Some(number), .. } => near(LightId::Lamp(number), Vec3A::ZERO),
            Source::Emitter { id, n, .. } => near(LightId::Triangle(id), n),
        }
    }
}

impl CausticCaster {
    /// Numbers of the light paths of `samples`; random numbers go with them.
    pub fn numbers(&self, samples: &Range<u32>) -> Range<u64> {
        let number = |sample: u32| self.first.0 + u64::from(sample - self.first.1) * u64::from(self.paths);
        number(samples.start)..number(samples.end)
    }

    /// The sample that path `number` belongs to.
    pub fn sample(&self, number: u64) -> u32 {
        self.first.1 + ((number - self.first.0) / u64::from(self.paths)) as u32
    }

    /// As what light samples that begin its light paths are drawn.
    pub fn receiver(&self) -> Receiver {
        Receiver { p: self.center, n: Vec3A::ZERO }
    }

    /// Light paths for one sample a pixel, per square metre across a direction that all of them have.
    pub fn density(&self) -> f32 {
        self.paths as f32 / (PI * self.radius * self.radius)
    }

    /// A direction from `point` to the sphere and its density per steradian, uniform in the cone around the sphere, or in all
    /// directions from within. `u` are two random numbers.
    pub fn direction(&self, point: Vec3A, u: [f32; 2]) -> (Vec3A, f32) {
        let away = self.center - point;
        let (span, density) = self.cone(away.length_squared());
        let cos = 1.0 - u[0] * span;
        let sin = (u[0] * span * (1.0 + cos)).max(0.0).sqrt();
        let (sin_phi, cos_phi) = (TAU * u[1]).sin_cos();
        let axis = away.normalize_or(Vec3A::Y);
        let (t, s) = axis.any_orthonormal_pair();
        ((axis * cos + (t * cos_phi + s * sin_phi) * sin).normalize(), density)
    }

    /// One less the cosine of the angle of the cone, and the density of a direction in it, from a point whose distance to the
    /// centre has the square `square`.
    fn cone(&self, square: f32) -> (f32, f32) {
        let sin2 = self.radius * self.radius / square;
        if sin2 < 1.0 {
            // Without the difference of two numbers near 1.
            let span = sin2 / (1.0 + (1.0 - sin2).sqrt());
            return (span, 1.0 / (TAU * span));
        }
        (2.0, 0.25 / PI)
    }
}

impl CausticCasters {
    /// `None` where light paths would bring nothing.
    pub fn find(scene: &RenderScene, settings: &Settings) -> Option<Self> {
        let wanted = settings.light_paths
            && settings.direct == DirectLight::Mis
            && settings.filter == Filter::Box
            && settings.clamp_indirect.is_none()
            // Light paths look for their pixel as a pinhole shows it.
            && settings.lens.is_none()
            && scene.camera().distortion.is_none()
            && settings.max_bounces >= 2;
        let features = scene.features();
        let environment = !features.flat_environment && scene.environment_light().concentration() >= CONCENTRATION;
        if !wanted || !(environment || features.lights()) {
            return None;
        }
        let camera = scene.camera();
        let (eye, focal) = (camera.position(), (camera.fl_x * camera.fl_y).sqrt());
        let pixels = (camera.width * camera.height) as f32;
        let shiny: Vec<(u32, f32)> = (scene.geometry.instances.iter().zip(0..))
            .map(|(instance, number)| (number, shine(&scene.materials[instance.material])))
            .filter(|(_, shine)| *shine > 0.0)
            .collect();
        let mut meshes: Vec<usize> = shiny.iter().map(|&(number, _)| scene.geometry.instances[number as usize].mesh).collect();
        meshes.sort_unstable();
        meshes.dedup();
        let spheres: Vec<_> = meshes.par_iter().map(|&mesh| sphere_around(scene.geometry.mesh(mesh), scene.pose())).collect();
        let caster = |&(instance, shine): &(u32, f32)| {
            let placed = &scene.geometry.instances[instance as usize];
            let sphere = spheres[meshes.binary_search(&placed.mesh).ok()?];
            let (center, radius) = transformed(sphere, &placed.transform(scene.pose()))?;
            let distance = center.distance(eye);
            // Where the camera is within, nobody knows what it sees of it.
            let share = (radius / distance).powi(2) * PI * focal * focal;
            (distance > radius && share.is_finite()).then(|| CausticCaster {
                instance,
                center,
                radius,
                paths: coarse(DENSITY * shine * share.min(pixels)),
                first: (0, 0),
            })
        };
        let mut list: Vec<CausticCaster> = shiny.iter().filter_map(caster).filter(|caster| caster.paths > 0).collect();
        let total: f32 = list.iter().map(|caster| caster.paths as f32).sum();
        if total > MOST * pixels {
            list.iter_mut().for_each(|caster| caster.paths = coarse(caster.paths as f32 * (MOST * pixels / total)));
            list.retain(|caster| caster.paths > 0);
        }
        let mut of_instance = vec![None; scene.geometry.instances.len()];
        for (caster, place) in list.iter().zip(0..) {
            of_instance[caster.instance as usize] = Some(place);
        }
        (!list.is_empty()).then_some(Self { list, of_instance, environment })
    }

    /// Numbers the paths of each body from `samples` on after the paths that `traced` has counted for its instance, and adds
    /// those of `samples` to the count. Otherwise a moment with fewer paths than the one before would use random numbers twice.
    pub fn go_on(&mut self, traced: &mut Vec<u64>, samples: &Range<u32>) {
        traced.resize(self.of_instance.len(), 0);
        for caster in &mut self.list {
            let traced = &mut traced[caster.instance as usize];
            caster.first = (*traced, samples.start);
            *traced += u64::from(caster.paths) * samples.len() as u64;
        }
    }

    /// Whether light paths may begin at `start`.
    pub fn follow(&self, start: &PathStart) -> bool {
        self.environment || !matches!(start, PathStart::Environment)
    }

    /// Number of light paths for one sample a pixel, per square metre across their direction, at the point of an instance that is
    /// `at` to light samples, relative to the density of light samples there; 0 where none are aimed.
    #[inline(always)]
    pub fn aimed(&self, scene: &RenderScene, instance: u32, at: &Receiver, start: &PathStart) -> f32 {
        let Some(place) = self.of_instance[instance as usize] else { return 0.0 };
        let caster = &self.list[place as usize];
        match *start {
            PathStart::Environment if !self.environment => 0.0,
            PathStart::Environment | PathStart::Distant => caster.density(),
            PathStart::Near { light, point, n } => {
                let (to_center, to_point) = (caster.center - point, at.p - point);
                // A lamp that sends nothing to the middle of the body begins no light path there.
                if let LightId::Lamp(number) = light
                    && scene.lights.irradiance(number, caster.center) == Vec3A::ZERO
                {
                    return 0.0;
                }
                // What a triangle sends from its other side begins no light path.
                if n != Vec3A::ZERO && n.dot(to_center) * n.dot(to_point) <= 0.0 {
                    return 0.0;
                }
                let (_, density) = caster.cone(to_center.length_squared());
                let share = scene.lights.probability(&caster.receiver(), light) / scene.lights.probability(at, light);
                caster.paths as f32 * density * share / to_point.length_squared()
            }
        }
    }

    /// Light paths for one sample a pixel.
    pub fn paths(&self) -> u64 {
        self.list.iter().map(|caster| u64::from(caster.paths)).sum()
    }
}

/// A count near `count` with at most five digits in binary: roundings of where things are must not change it, or the random
/// numbers of all paths would be others.
fn coarse(count: f32) -> u32 {
    let count = count.clamp(0.0, 1e9);
    let step = (count.log2().floor() - 4.0).exp2().max(1.0);
    ((count / step).round() * step) as u32
}

/// How many light paths the caustics of a material are worth, 0..=1.
fn shine(material: &CompiledMaterial) -> f32 {
    let surface = &material.surface;
    match material.clear {
        // Light goes through sheets nearly straight, as shadow rays do through panes.
        Clear::Sheet | Clear::Pane => return 0.0,
        Clear::Body if surface.roughness <= ROUGHNESS => return surface.transmission.max(DIELECTRIC),
        Clear::Body | Clear::No => {}
    }
    // What a texture makes of its roughness is nobody's guess.
    let smooth = surface.roughness <= ROUGHNESS || material.metallic_roughness_texture.is_some();
    if smooth && surface.metallic > 0.0 {
        return surface.metallic.max(DIELECTRIC);
    }
    let reflects = smooth && surface.specular > 0.0 || surface.clearcoat > 0.0;
    if reflects { DIELECTRIC } else { 0.0 }
}

/// A sphere around a mesh, as it is.
fn sphere_around(mesh: &Mesh, frame: usize) -> (Vec3A, f32) {
    let posed = mesh.posed(frame);
    let corners = || mesh.triangles.iter().flatten().map(|&v| Vec3A::from(posed.positions[v as usize]));
    let (low, high) = corners().fold((Vec3A::INFINITY, Vec3A::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)));
    let center = 0.5 * (low + high);
    (center, corners().map(|p| p.distance_squared(center)).fold(0.0, f32::max).sqrt())
}

/// A sphere around what `transform` makes of a sphere; `None` where it has no size.
fn transformed((center, radius): (Vec3A, f32), transform: &Affine3A) -> Option<(Vec3A, f32)> {
    // In double precision: the difference below leaves the root of a rounding.
    let [x, y, z] = [transform.matrix3.x_axis, transform.matrix3.y_axis, transform.matrix3.z_axis].map(|axis| axis.as_dvec3());
    let matrix = DMat3::from_cols(x, y, z);
    let squared = matrix.transpose() * matrix;
    let trace = |m: &DMat3| m.x_axis.x + m.y_axis.y + m.z_axis.z;
    // The largest eigenvalue is at most this (Wolkowicz and Styan 1980), and exactly this where all scales are the same.
    let mean = trace(&squared) / 3.0;
    let spread = (trace(&(squared * squared)) / 3.0 - mean * mean).max(0.0).sqrt();
    let scale = (mean + std::f64::consts::SQRT_2 * spread).sqrt() as f32;
    let center = transform.transform_point3a(center);
    // Roundings, of the points on triangles too.
    let radius = radius * scale * 1.001 + 1e-6 * center.abs().max_element();
    (center.is_finite() && radius.is_finite() && radius > 0.0).then_some((center, radius))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Quat, Vec3};
    use renderflow_scenes::shapes::{Shape, mesh};

    /// Moments that have fewer and fewer paths, or more and more, or none for a time, use each number once, and without gaps.
    /// Where the count stays, numbers are those of a picture without a shutter.
    #[test]
    fn moments_share_no_light_path() {
        let caster = |paths: u32| CausticCaster { instance: 1, center: Vec3A::ZERO, radius: 1.0, paths, first: (0, 0) };
        for counts in [[31, 30, 24, 16, 8, 7], [7, 8, 16, 24, 30, 31], [9, 4, 0, 0, 12, 3], [5; 6]] {
            let (mut traced, mut next) = (Vec::new(), 0);
            for (moment, paths) in (0..).zip(counts).filter(|(_, paths)| *paths > 0) {
                let samples = moment * 4..moment * 4 + 4;
                let mut casters =
                    CausticCasters { list: vec![caster(paths)], of_instance: vec![None, Some(0)], environment: true };
                casters.go_on(&mut traced, &samples);
                let numbers = casters.list[0].numbers(&samples);
                assert_eq!(numbers, next..next + 4 * u64::from(paths), "{counts:?}");
                assert!(numbers.clone().all(|number| samples.contains(&casters.list[0].sample(number))), "{counts:?}");
                if counts == [5; 6] {
                    assert_eq!(numbers, caster(paths).numbers(&samples));
                }
                next = numbers.end;
            }
            assert_eq!(traced, [0, next]);
        }
    }

    #[test]
    fn counts_are_coarse() {
        assert_eq!([0.0, 0.4, 0.6, 7.2, 31.4, 33.2, 1000.0, 70_001.0].map(coarse), [0, 0, 1, 7, 31, 34, 992, 69_632]);
        assert_eq!(coarse(f32::NAN), 0);
    }

    #[test]
    fn spheres_hold_what_is_in_them() {
        let mesh = mesh(&Shape::Torus { radius: 1.0, tube: 0.3 });
        for scale in [Vec3::ONE, Vec3::new(3.0, 0.2, 1.0), Vec3::new(-1.0, 2.0, 0.5), Vec3::splat(1e-4)] {
            let turn = Quat::from_rotation_z(0.7) * Quat::from_rotation_x(1.1);
            let mut transform = Affine3A::from_scale_rotation_translation(scale, turn, Vec3::new(5.0, -2.0, 1.0));
            // Sheared, too.
            transform *= Affine3A::from_quat(turn);
            let (center, radius) = transformed(sphere_around(&mesh, 0), &transform).expect("a sphere");
            let farthest =
                mesh.positions.iter().map(|&p| transform.transform_point3a(p.into()).distance(center)).fold(0.0, f32::max);
            assert!(farthest <= radius && radius < 2.0 * farthest, "{scale}: {farthest} of {radius}");
        }
        assert_eq!(transformed((Vec3A::ZERO, 0.0), &Affine3A::IDENTITY), None);
        assert_eq!(transformed(sphere_around(&Mesh::default(), 0), &Affine3A::IDENTITY), None);
    }
}
