//! From bodies to objects and materials of the description.

use super::Used;
use super::body::{Body, Origin, Part, Role};
use super::clear;
use super::materials::{self, MaterialKnobs};
use crate::description::{Geometry, Material, Object};
use crate::draw::Draw;
use crate::seed::Seed;
use glam::Vec3;
use rand_pcg::Pcg64;
use std::collections::HashMap;

/// The description's lists as they grow.
pub(super) struct Build<'a> {
    root: Seed,
    knobs: &'a MaterialKnobs,
    /// Gain of the environment, which lamps have to stand up to.
    gain: f32,
    /// Whether foliage has holes.
    leafy: bool,
    pub materials: Vec<Material>,
    pub objects: Vec<Object>,
    pub meshes: Vec<Used>,
    /// Numbers of the materials that may change: those of objects, or of the ground where no object has one.
    pub changeable: Vec<usize>,
    /// Materials that several parts share, by name.
    shared: HashMap<String, usize>,
}

impl<'a> Build<'a> {
    pub fn new(root: Seed, knobs: &'a MaterialKnobs, gain: f32, leafy: bool) -> Self {
        let lists = (vec![], vec![], vec![], vec![]);
        Self {
            root,
            knobs,
            gain,
            leafy,
            materials: lists.0,
            objects: lists.1,
            meshes: lists.2,
            changeable: lists.3,
            shared: HashMap::new(),
        }
    }

    /// Adds an object; plain structure of one kind shares a material.
    pub fn part(&mut self, name: &str, part: &Part, foot: Vec3) {
        let material = match part.geometry {
            // Models keep the materials of their files.
            Geometry::File(_) => None,
            Geometry::Shape(_) => Some(self.material(name, part.role)),
        };
        self.objects.push(Object {
            name: name.into(),
            geometry: part.geometry.clone(),
            material,
            transform: part.transform(foot),
            motion: None,
            animation: None,
        });
    }

    /// Adds the objects of a body.
    pub fn body(&mut self, name: &str, body: &Body) {
        for (index, part) in body.parts.iter().enumerate() {
            let name = if index == 0 { name.to_owned() } else { format!("{name}_{index}") };
            self.part(&name, part, body.foot);
            if let Some(object) = self.objects.last_mut() {
                object.motion.clone_from(&body.motion);
            }
            if let Some(origin) = &body.origin {
                let Origin { family, mesh, file } = origin.clone();
                self.meshes.push(Used { object: name, family, mesh, file });
            }
        }
    }

    /// Name of the material of a part.
    fn material(&mut self, name: &str, role: Role) -> String {
        let shared = match role {
            Role::Object | Role::Glass => name,
            Role::Ground => "ground",
            Role::Wall => "wall",
            Role::Ceiling => "ceiling",
            Role::Furniture => "furniture",
            Role::Foliage => "foliage",
            Role::Trunk => "trunk",
            Role::Lamp => "lamp",
            Role::Water => "water",
            Role::Pane => "pane",
        };
        if let Some(&known) = self.shared.get(shared) {
            return self.materials[known].name.clone();
        }
        let number = self.materials.len();
        let mut rng = match role {
            Role::Object => self.root.child("material", number as u64),
            Role::Glass => self.root.child("glass", 2 + number as u64),
            Role::Foliage if self.leafy => self.root.child("leaves", 1),
            Role::Water => self.root.child("water", 2),
            _ => self.root.child(shared, 0),
        }
        .rng();
        let rng = &mut rng;
        let made = match role {
            Role::Object | Role::Furniture => materials::object(rng, shared, self.knobs),
            Role::Ground => materials::floor(rng, shared, self.knobs),
            Role::Wall if rng.chance(0.5) => materials::wall(rng, shared, self.knobs),
            Role::Wall | Role::Ceiling => wall(rng, role == Role::Ceiling),
            Role::Glass => clear::glass(rng),
            Role::Water => clear::water(rng),
            Role::Pane => clear::pane(rng),
            Role::Foliage if self.leafy => clear::leaves(rng),
            Role::Foliage => {
                let (hue, saturation, value) = (rng.between(65.0, 135.0), rng.between(0.4, 0.8), rng.log(0.08, 0.3));
                plain(Pcg64::hsv(hue, saturation, value), rng.between(0.5, 0.9))
            }
            Role::Trunk => {
                let (hue, saturation, value) = (rng.between(15.0, 40.0), rng.between(0.2, 0.6), rng.log(0.06, 0.25));
                plain(Pcg64::hsv(hue, saturation, value), rng.between(0.7, 1.0))
            }
            Role::Lamp => {
                let warmth = rng.between(0.0, 1.0);
                let level = self.gain * rng.log(2.0, 10.0);
                let emissive = [1.0, 1.0 - 0.3 * warmth, 1.0 - 0.65 * warmth].map(|v| Pcg64::tidy(v * level));
                Material { emissive, ..plain([0.8; 3], 0.5) }
            }
        };
        self.materials.push(Material { name: shared.into(), ..made });
        if role == Role::Object || (role == Role::Ground && self.changeable.is_empty()) {
            if role == Role::Object && self.changeable.first().is_some_and(|&first| self.materials[first].name == "ground") {
                self.changeable.clear();
            }
            self.changeable.push(number);
        }
        if !matches!(role, Role::Object | Role::Glass) {
            self.shared.insert(shared.into(), number);
        }
        shared.into()
    }
}

fn plain(base_color: [f32; 3], roughness: f32) -> Material {
    Material { base_color, roughness, ..Material::default() }
}

/// Plaster and paint, bright: what lights a room is what its walls pass on.
fn wall(rng: &mut Pcg64, ceiling: bool) -> Material {
    let tinted = !ceiling && rng.chance(0.5);
    let (hue, value) = (rng.between(0.0, 360.0), rng.between(if ceiling { 0.75 } else { 0.55 }, 0.88));
    let saturation = if tinted { rng.between(0.1, 0.45) } else { rng.between(0.0, 0.08) };
    Material { specular: rng.between(0.1, 0.5), ..plain(Pcg64::hsv(hue, saturation, value), rng.between(0.5, 1.0)) }
}
