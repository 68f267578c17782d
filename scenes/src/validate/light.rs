//! Validation of lights.

use super::{Check, MAX_EMISSION, MAX_SIZE, MAX_VALUE, MIN_SIZE};
use crate::Scene;
use crate::description::LightKind;

impl Check {
    pub(super) fn lights(&mut self, scene: &Scene) {
        self.unique("lights", scene.lights.iter().map(|light| light.name.as_str()));
        for (i, light) in scene.lights.iter().enumerate() {
            let at = |field: &str| format!("/lights/{i}/{field}");
            self.name(at("name"), &light.name);
            self.vector(&at("color"), light.color, 0.0..=MAX_EMISSION);
            self.transform(&at("transform"), &light.transform);
            if let Some(target) = light.target {
                self.position(&at("target"), target);
                if target == light.transform.translation {
                    self.say(at("target"), "is the place of the light");
                }
            }
            if let Some(motion) = &light.motion {
                self.motion(&at("motion"), motion, scene.frames);
            }
            let strength = 0.0..=MAX_VALUE;
            match &light.kind {
                LightKind::Point { intensity, .. } => self.range(at("kind/point/intensity"), *intensity, strength),
                LightKind::Spot { intensity, inner_angle, outer_angle, .. } => {
                    self.range(at("kind/spot/intensity"), *intensity, strength);
                    self.range(at("kind/spot/outer_angle"), *outer_angle, 0.0..=90.0);
                    if !(0.0..*outer_angle).contains(inner_angle) {
                        let reason = format!("{inner_angle} is not from 0 to less than outer_angle, {outer_angle}");
                        self.say(at("kind/spot/inner_angle"), reason);
                    }
                }
                LightKind::Directional { irradiance } => self.range(at("kind/directional/irradiance"), *irradiance, strength),
                LightKind::Sphere { power, radius } => {
                    self.range(at("kind/sphere/power"), *power, strength);
                    self.range(at("kind/sphere/radius"), *radius, MIN_SIZE..=MAX_SIZE);
                }
                LightKind::Disk { power, radius } => {
                    self.range(at("kind/disk/power"), *power, strength);
                    self.range(at("kind/disk/radius"), *radius, MIN_SIZE..=MAX_SIZE);
                }
                LightKind::Rectangle { power, width, height } => {
                    self.range(at("kind/rectangle/power"), *power, strength);
                    self.range(at("kind/rectangle/width"), *width, MIN_SIZE..=MAX_SIZE);
                    self.range(at("kind/rectangle/height"), *height, MIN_SIZE..=MAX_SIZE);
                }
            }
            if let Some(ies) = light.kind.ies() {
                let kind = if matches!(light.kind, LightKind::Spot { .. }) { "spot" } else { "point" };
                self.path(at(&format!("kind/{kind}/ies")), ies);
            }
        }
    }
}
