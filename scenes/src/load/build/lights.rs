//! Lights of the scene file and of model files.

use super::Build;
use crate::description::{Light, LightKind, Object};
use crate::error::{Error, Result};
use crate::ies::Profile;
use crate::load::gltf::rig::Rig;
use crate::load::play::Play;
use crate::load::relative;
use crate::loaded::{PunctualKind, PunctualLight};
use crate::{Instance, Material, Mesh, Principled};
use glam::{Affine3A, DAffine3, Mat3A, Vec3, Vec3A};
use std::collections::HashMap;
use std::f64::consts::{PI, TAU};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Corners of a disk.
const CORNERS: u32 = 64;
/// How often the triangles of an icosahedron are cut into four for a sphere: 1280 triangles.
const CUTS: u32 = 3;

impl Build<'_> {
    /// The lights of the scene file. What has an area becomes an instance behind all objects, with a material of its own.
    pub(super) fn described_lights(&mut self) -> Result<()> {
        let mut profiles = HashMap::new();
        for (index, light) in self.scene.lights.iter().enumerate() {
            let frames = if light.moves() { self.scene.frames } else { 1 };
            let placements: Vec<DAffine3> = (0..frames).map(|frame| light.transform_at(frame)).collect();
            let profile = light.kind.ies().map(|file| self.profile(file, &mut profiles)).transpose();
            let profile = profile.map_err(|e| e.at(format!("/lights/{index} ({})", light.name)))?;
            let strength = |strength: f32| light.color.map(|v| (v * strength).min(f32::MAX));
            let kind = match light.kind {
                LightKind::Point { intensity, .. } => PunctualKind::Point { intensity: strength(intensity) },
                LightKind::Spot { intensity, inner_angle, outer_angle, .. } => PunctualKind::Spot {
                    intensity: strength(intensity),
                    inner: inner_angle.to_radians(),
                    outer: outer_angle.to_radians(),
                },
                LightKind::Directional { irradiance } => PunctualKind::Directional { irradiance: strength(irradiance) },
                LightKind::Sphere { power, radius } => {
                    self.glowing(index, light, power, sphere(radius), &placements);
                    continue;
                }
                LightKind::Disk { power, radius } => {
                    self.glowing(index, light, power, disk(radius), &placements);
                    continue;
                }
                LightKind::Rectangle { power, width, height } => {
                    self.glowing(index, light, power, rectangle(width, height), &placements);
                    continue;
                }
            };
            let transforms = placements.iter().map(|&p| upright(relative(p, self.origin))).collect();
            self.lights.push(PunctualLight { name: light.name.clone(), kind, profile, transforms });
        }
        Ok(())
    }

    fn profile(&self, file: &str, known: &mut HashMap<PathBuf, Arc<Profile>>) -> Result<Arc<Profile>> {
        let path = self.reach.resolve(file).map_err(|reason| Error::Name { reason })?;
        if let Some(known) = known.get(&path) {
            return Ok(Arc::clone(known));
        }
        let profile = Arc::new(Profile::read(&path)?);
        self.reach.note(&path);
        known.insert(path, Arc::clone(&profile));
        Ok(profile)
    }

    /// A surface that emits `power` watts, for light number `index`.
    fn glowing(&mut self, index: usize, light: &Light, power: f32, mesh: Mesh, placements: &[DAffine3]) {
        let place = placements[0].matrix3;
        let corners = |t: &[u32; 3]| t.map(|v| place * mesh.positions[v as usize].as_dvec3());
        let area: f64 = mesh.triangles.iter().map(corners).map(|[a, b, c]| 0.5 * (b - a).cross(c - a).length()).sum();
        let radiance = f64::from(power) / (PI * area);
        // A surface of one square nanometre has a radiance that single precision does not reach.
        let emissive = light.color.map(|v| (f64::from(v) * radiance).min(f64::from(f32::MAX)) as f32);
        // It reflects nothing: all the light that comes from it is its own.
        let surface = Principled { base_color: Vec3A::ZERO, specular: 0.0, roughness: 1.0, ..Principled::default() };
        let name = self.material_names.unique(&light.name);
        self.materials.push(Material { name, surface, emissive, double_sided: false, ..Material::default() });
        let material = self.materials.len() - 1;
        let name = self.instance_names.unique(&light.name);
        let mesh = self.add_mesh(Mesh { name: name.clone(), ..mesh });
        let object_id = (self.scene.objects.len() + index) as u32 + 1;
        let transforms = placements.iter().map(|&p| relative(p, self.origin)).collect();
        self.instances.push(Instance { name, mesh, material, object_id, transforms });
    }

    /// The lights of a model file that `object` shows. The model's own scales leave them as they are (KHR_lights_punctual); where
    /// the object is larger or smaller than the file, all distances are, and the lights become stronger or weaker, so that the
    /// model looks the same.
    pub(super) fn model_lights(
        &mut self,
        path: &Path,
        object: &Object,
        rig: Option<&Rig>,
        placements: &[DAffine3],
    ) -> Result<()> {
        let lights = &self.models[path].lights;
        if lights.is_empty() {
            return Ok(());
        }
        let transforms: Vec<Vec<Affine3A>> = match (rig, &object.animation) {
            (Some(rig), Some(animation)) => {
                let play = Play { rig, animation, frames: self.scene.frames };
                play.check(lights.len()).map_err(|reason| Error::model(path, "", reason))?;
                let nodes: Vec<_> = lights.iter().map(|light| (Some(light.node), DAffine3::IDENTITY)).collect();
                play.transforms(&nodes, placements, self.origin)
            }
            _ => {
                let of = |light: DAffine3| placements.iter().map(|&p| relative(p * light, self.origin)).collect();
                lights.iter().map(|light| of(light.transform)).collect()
            }
        };
        let size = f64::from(object.transform.scale.iter().product::<f32>().abs()).cbrt();
        let grown = |strength: [f32; 3]| strength.map(|v| (f64::from(v) * size * size).min(f64::from(f32::MAX)) as f32);
        for (light, transforms) in lights.iter().zip(transforms) {
            let kind = match light.kind {
                PunctualKind::Point { intensity } => PunctualKind::Point { intensity: grown(intensity) },
                PunctualKind::Spot { intensity, inner, outer } => {
                    PunctualKind::Spot { intensity: grown(intensity), inner, outer }
                }
                directional @ PunctualKind::Directional { .. } => directional,
            };
            if let Some(frame) = transforms.iter().position(|t| !t.is_finite()) {
                let reason = format!("the light {:?} is out of every range at frame {frame}", light.name);
                return Err(Error::model(path, "", reason));
            }
            let mut transforms: Vec<Affine3A> = transforms.into_iter().map(upright).collect();
            if transforms.iter().all(|t| *t == transforms[0]) {
                transforms.truncate(1);
            }
            let name = self.light_names.unique(&format!("{}/{}", object.name, light.name));
            self.lights.push(PunctualLight { name, kind, profile: None, transforms });
        }
        Ok(())
    }
}

/// The rotation and the translation of a transform: its -Z keeps its direction, +X as far as it can.
fn upright(transform: Affine3A) -> Affine3A {
    let axis = |v: Vec3A| v.as_dvec3().try_normalize();
    let z = axis(transform.matrix3.z_axis).unwrap_or(glam::DVec3::Z);
    let x = transform.matrix3.x_axis.as_dvec3();
    let x = (x - z * z.dot(x)).try_normalize().unwrap_or_else(|| z.any_orthonormal_vector());
    let matrix3 = Mat3A::from_cols(x.as_vec3a(), z.cross(x).as_vec3a(), z.as_vec3a());
    Affine3A { matrix3, translation: transform.translation }
}

/// In the plane z = 0, seen from -z.
fn rectangle(width: f32, height: f32) -> Mesh {
    let (x, y) = (0.5 * width, 0.5 * height);
    let corner = |x: f32, y: f32| Vec3::new(x, y, 0.0);
    let positions = vec![corner(-x, -y), corner(-x, y), corner(x, y), corner(x, -y)];
    Mesh { positions, triangles: vec![[0, 1, 2], [0, 2, 3]], ..Mesh::default() }
}

/// A polygon of the disk's area in the plane z = 0, seen from -z.
fn disk(radius: f32) -> Mesh {
    let step = TAU / f64::from(CORNERS);
    // Area of the polygon: corners / 2 sin(step) r^2.
    let r = f64::from(radius) * (PI / (0.5 * f64::from(CORNERS) * step.sin())).sqrt();
    let corner = |k: u32| {
        let (sin, cos) = (-f64::from(k) * step).sin_cos();
        Vec3::new((r * cos) as f32, (r * sin) as f32, 0.0)
    };
    let positions = (0..CORNERS).map(corner).collect();
    Mesh { positions, triangles: (1..CORNERS - 1).map(|k| [0, k, k + 1]).collect(), ..Mesh::default() }
}

/// A ball of triangles that has the surface of the sphere.
fn sphere(radius: f32) -> Mesh {
    let golden = 0.5 * (1.0 + 5.0_f64.sqrt());
    let corner = |x: f64, y: f64, z: f64| glam::DVec3::new(x, y, z).normalize();
    let mut positions = vec![];
    for (a, b) in [(-1.0, golden), (1.0, golden), (-1.0, -golden), (1.0, -golden)] {
        positions.extend([corner(a, b, 0.0), corner(0.0, a, b), corner(b, 0.0, a)]);
    }
    // Every three corners that are neighbours of each other, seen from outside.
    let near = |a: glam::DVec3, b: glam::DVec3| a.dot(b) > 0.4 && a != b;
    let mut triangles = vec![];
    for i in 0..12 {
        for j in i + 1..12 {
            for k in j + 1..12 {
                let [a, b, c] = [i, j, k].map(|v| positions[v]);
                if near(a, b) && near(b, c) && near(c, a) {
                    let outside = (b - a).cross(c - a).dot(a) > 0.0;
                    triangles.push(if outside { [i, j, k] } else { [i, k, j] });
                }
            }
        }
    }
    for _ in 0..CUTS {
        let mut between = HashMap::new();
        let mut middle = |i: usize, j: usize| {
            *between.entry((i.min(j), i.max(j))).or_insert_with(|| {
                positions.push((positions[i] + positions[j]).normalize());
                positions.len() - 1
            })
        };
        let cut = |[a, b, c]: [usize; 3]| {
            let [ab, bc, ca] = [middle(a, b), middle(b, c), middle(c, a)];
            [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
        };
        triangles = triangles.into_iter().flat_map(cut).collect();
    }
    let area = |[a, b, c]: [usize; 3]| 0.5 * (positions[b] - positions[a]).cross(positions[c] - positions[a]).length();
    let surface: f64 = triangles.iter().map(|&t| area(t)).sum();
    let r = f64::from(radius) * (4.0 * PI / surface).sqrt();
    Mesh {
        positions: positions.iter().map(|p| (*p * r).as_vec3()).collect(),
        triangles: triangles.into_iter().map(|t| t.map(|v| v as u32)).collect(),
        ..Mesh::default()
    }
}
