//! Model files in a scene: their parts, as they rest or as an animation moves them.

use super::Build;
use crate::description::{Animation, CameraPath, Geometry, Object};
use crate::error::{Error, Result};
use crate::load::gltf::{label, lights::Light, rig::Rig};
use crate::load::play::{self, Play};
use crate::load::{deform, invertible, model, relative};
use crate::{Instance, Material, Mesh, TextureSlot};
use glam::{Affine3A, DAffine3};
use std::path::Path;
use std::rc::Rc;

/// A model file in the scene: where its meshes and materials begin in the lists of the scene.
pub(super) struct Placed {
    /// As the scene names the file.
    file: String,
    pub parts: Vec<model::Part>,
    pub lights: Vec<Light>,
    /// Names of the file's cameras.
    cameras: Vec<String>,
    /// Names of the file's animations.
    animations: Vec<String>,
    /// Whether an object plays one of them.
    animated: bool,
    pub first_mesh: usize,
    /// `None` when nobody needed the file's own materials.
    first_material: Option<usize>,
}

impl Build<'_> {
    pub(super) fn add_model(&mut self, path: &Path, file: &str) -> Result<Placed> {
        // Materials and textures are read only when an object wants them.
        // Another object may write the name of the file in another way, as in `./model.glb`.
        let is_this = |name: &String| {
            name == file || Path::new(name).file_name() == path.file_name() && self.reach.resolve(name).is_ok_and(|p| p == path)
        };
        let of_file = || self.scene.objects.iter().filter(|o| matches!(&o.geometry, Geometry::File(name) if is_this(name)));
        let wanted = of_file().any(|o| o.material.is_none());
        let animated = of_file().any(|o| o.animation.is_some());
        let loaded = model::read(path, &self.reach.at(path), wanted.then_some(&self.budget), animated)?;
        let (first_mesh, first_material) = (self.meshes.len(), self.materials.len());
        for mesh in loaded.meshes {
            self.add_mesh(mesh);
        }
        let shift = self.textures.len();
        let moved = |slot: Option<TextureSlot>| slot.map(|s| TextureSlot { texture: s.texture + shift, ..s });
        for material in loaded.materials {
            let name = self.material_names.unique(&material.name);
            self.materials.push(Material {
                name,
                base_color_texture: moved(material.base_color_texture),
                metallic_roughness_texture: moved(material.metallic_roughness_texture),
                emissive_texture: moved(material.emissive_texture),
                transmission_texture: moved(material.transmission_texture),
                normal_texture: material.normal_texture.and_then(|(slot, scale)| moved(Some(slot)).map(|s| (s, scale))),
                ..material
            });
        }
        self.textures.extend(loaded.textures);
        self.report.triangles += loaded.report.triangles;
        self.report.notes.extend(loaded.report.notes.into_iter().map(|note| format!("{file}: {note}")));
        Ok(Placed {
            file: file.to_owned(),
            parts: loaded.parts,
            lights: loaded.lights,
            cameras: loaded.cameras,
            animations: loaded.animations,
            animated,
            first_mesh,
            first_material: wanted.then_some(first_material),
        })
    }

    pub(super) fn instantiate(
        &mut self,
        path: &Path,
        object: &Object,
        own: Option<usize>,
        object_id: u32,
        placements: &[DAffine3],
    ) -> Result<()> {
        let rig = object.animation.as_ref().map(|animation| self.rig(path, animation)).transpose()?;
        self.model_lights(path, object, rig.as_deref(), placements)?;
        let placed = &self.models[path];
        let single = placed.parts.len() == 1;
        let centered = |part: &model::Part| DAffine3::from_translation(self.centers[placed.first_mesh + part.mesh]);
        let mut deforming: Vec<Option<Mesh>> = placed.parts.iter().map(|_| None).collect();
        let transforms: Vec<Vec<Affine3A>> = match (&rig, &object.animation) {
            (Some(rig), Some(animation)) => {
                let play = Play { rig, animation, frames: self.scene.frames };
                let soft: usize = placed.parts.iter().filter_map(|part| part.deformer.as_ref()).map(|d| d.size()).sum();
                play.check(placed.parts.len() + soft).map_err(|reason| Error::model(path, "", reason))?;
                let seconds: Vec<f64> = play.seconds().collect();
                let poses = deform::play(rig, &seconds, &placed.parts);
                for ((part, poses), mesh) in placed.parts.iter().zip(poses).zip(&mut deforming) {
                    let moved = poses.zip(part.deformer.as_ref());
                    *mesh = moved.map(|(poses, deformer)| Mesh::clone(&deformer.base).moved_by(&deformer.shape, poses));
                }
                // A mesh that deforms stays where it is in its file.
                let first = |part: &model::Part| if part.deformer.is_some() { part.deformed_from() } else { centered(part) };
                let parts: Vec<_> = placed.parts.iter().map(|part| (part.moving_node(), first(part))).collect();
                play.transforms(&parts, placements, self.origin)
            }
            _ => {
                let locals = placed.parts.iter().map(|part| part.transform * centered(part));
                locals.map(|local| placements.iter().map(|&p| relative(p * local, self.origin)).collect()).collect()
            }
        };
        let parts: Vec<_> = placed
            .parts
            .iter()
            .map(|part| {
                let theirs = part.material.and_then(|m| placed.first_material.map(|first| first + m));
                (part.name.clone(), placed.first_mesh + part.mesh, own.or(theirs))
            })
            .collect();
        let mut hidden = 0;
        for (((part, mesh, material), transforms), deforming) in parts.into_iter().zip(transforms).zip(deforming) {
            let mesh = deforming.map_or(mesh, |made| self.add_deforming(made));
            let lists = if rig.is_some() {
                if let Some(frame) = transforms.iter().position(|t| !t.is_finite()) {
                    let reason = format!("the animation moves {part:?} out of every range at frame {frame}");
                    return Err(Error::model(path, "", reason));
                }
                let (lists, flattened) = play::seen(transforms);
                hidden += usize::from(flattened && !lists.is_empty());
                lists
            } else if transforms.iter().all(|&t| invertible(t)) {
                vec![transforms]
            } else {
                vec![]
            };
            if lists.is_empty() {
                self.report.notes.push(format!("{}/{part} skipped: its transform flattens everything", object.name));
                continue;
            }
            let whole = single && lists.len() == 1;
            let material = material.unwrap_or_else(|| self.default_material());
            let material = if own.is_some() { material } else { self.scaled(material, object) };
            for transforms in lists {
                let name =
                    if whole { object.name.clone() } else { self.instance_names.unique(&format!("{}/{part}", object.name)) };
                self.instances.push(Instance { name, mesh, material, object_id, transforms });
            }
        }
        if hidden > 0 {
            let what = "parts are hidden in frames in which the animation flattens them";
            self.report.notes.push(format!("{}: {hidden} {what}", object.name));
        }
        Ok(())
    }

    /// A material of a file for an object that is placed larger or smaller: what its inside absorbs over a distance of the file,
    /// it absorbs over the distance that this becomes.
    fn scaled(&mut self, material: usize, object: &Object) -> usize {
        let size = object.transform.scale.iter().product::<f32>().abs().cbrt();
        let absorption = self.materials[material].absorption;
        if absorption == [0.0; 3] || size == 1.0 {
            return material;
        }
        *self.scaled.entry((material, size.to_bits())).or_insert_with(|| {
            let name = self.material_names.unique(&self.materials[material].name);
            self.materials.push(Material {
                name,
                absorption: absorption.map(|v| (v / size).min(f32::MAX)),
                ..self.materials[material].clone()
            });
            self.materials.len() - 1
        })
    }

    /// The node tree of a file with an animation.
    fn rig(&mut self, path: &Path, animation: &Animation) -> Result<Rc<Rig>> {
        let key = (path.to_owned(), animation.clip.clone());
        if let Some(known) = self.rigs.get(&key) {
            return Ok(Rc::clone(known));
        }
        let rig = Rc::new(model::rig(path, &self.reach.at(path), Some(animation))?);
        let file = self.models.get(path).map_or("", |placed| &placed.file);
        self.report.notes.extend(rig.notes.iter().map(|note| format!("{file}: {note}")));
        self.rigs.insert(key, Rc::clone(&rig));
        Ok(rig)
    }

    /// Says which cameras and animations of model files are there to be used, where the scene has no poses of its own and the
    /// models rest.
    pub(super) fn note_unused(&mut self) {
        let mut placed: Vec<&Placed> = self.models.values().collect();
        placed.sort_by_key(|placed| placed.first_mesh);
        for Placed { file, cameras, animations, animated, .. } in placed {
            let looks = matches!(self.scene.camera, CameraPath::Orbit { .. });
            for (unused, names, what, option) in
                [(looks, cameras, "camera", "--camera NAME uses"), (!animated, animations, "animation", "--animation NAME plays")]
            {
                if unused && !names.is_empty() {
                    let plural = if names.len() == 1 { "" } else { "s" };
                    let known = label::list(names.iter().map(|name| Some(name.as_str())));
                    self.report
                        .notes
                        .push(format!("{file}: the file has {} {what}{plural} ({known}); {option} one", names.len()));
                }
            }
        }
    }
}
