//! Bodies whose surfaces are sheets, so that they look hollow.

use super::Build;
use crate::load::mesh;
use std::collections::{BTreeMap, HashMap};

/// Least volume of a body that can look hollow, in area^1.5: that of a ball is 0.094, of a plate a twentieth as thick as wide
/// 0.015. Flatter ones are panes.
const LEAST_VOLUME: f64 = 0.02;

impl Build<'_> {
    /// Says which closed surfaces are thin-walled and how they become solid. Blender and others write glass without a thickness,
    /// which is thin-walled by the rules of glTF, whatever its shape.
    pub(super) fn note_hollow(&mut self) {
        let mut judged = HashMap::new();
        // By material, the first place that shows it so.
        let mut hollow = BTreeMap::new();
        for instance in &self.instances {
            let material = &self.materials[instance.material];
            if material.thin_walled && material.surface.transmission > 0.0 && !hollow.contains_key(&instance.material) {
                let mesh = &self.meshes[instance.mesh];
                let body =
                    *judged.entry(instance.mesh).or_insert_with(|| mesh::fullness(mesh) > LEAST_VOLUME && mesh::is_closed(mesh));
                if body {
                    hollow.insert(instance.material, (instance.name.clone(), instance.object_id));
                }
            }
        }
        let Some((&first, (name, object))) = hollow.first_key_value() else { return };
        let names: Vec<String> = hollow.keys().map(|&index| format!("{:?}", self.materials[index].name)).collect();
        let materials = if names.len() == 1 { "material" } else { "materials" };
        let remedy = match self.scene.materials.len() {
            // Materials of the scene come first.
            described if first < described => {
                format!("set thin_walled of the material to false (--set materials/{first}/thin_walled=false)")
            }
            // Objects are numbered from 1.
            _ => format!(
                "give the material a thickness in its file (KHR_materials_volume), or the object a material of the scene (--set \
'materials/-={{\"name\": \"solid\", \"transmission\": 1, \"roughness\": 0, \"base_color\": [1, 1, 1]}}' --set objects/{}/material=solid)",
                object - 1
            ),
        };
        self.report.notes.push(format!(
            "{name}: this closed surface is drawn as a thin wall and looks hollow ({materials} {}). To make it solid, {remedy}",
            names.join(", ")
        ));
    }
}
