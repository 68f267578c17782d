//! KHR_lights_punctual: lights on nodes. Candela and lux count as W/sr and W/m^2 of scene-linear light, one for one.

use super::tree::Node;
use crate::LoadReport;
use crate::error::{Error, Result};
use crate::loaded::PunctualKind;
use glam::DAffine3;
use gltf::Document;
use serde_json::Value;
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};
use std::path::Path;

const NAME: &str = "KHR_lights_punctual";

/// A light of a file, as the file rests.
pub(crate) struct Light {
    pub name: String,
    pub kind: PunctualKind,
    /// Node to model space.
    pub transform: DAffine3,
    /// Place of its node in the file's tree.
    pub node: usize,
}

/// The lights on the nodes of the file's scene.
pub(super) fn read(path: &Path, document: &Document, tree: &[Node], report: &mut LoadReport) -> Result<Vec<Light>> {
    let listed = document.extension_value(NAME).and_then(|value| value.get("lights"));
    let listed: &[Value] = listed.and_then(Value::as_array).map_or(&[], Vec::as_slice);
    let nodes: Vec<gltf::Node> = document.nodes().collect();
    let (mut found, mut ranges) = (Vec::new(), 0);
    let mut world: Vec<DAffine3> = Vec::with_capacity(tree.len());
    for (place, Node { index, parent, local, .. }) in tree.iter().enumerate() {
        let transform = parent.map_or(DAffine3::IDENTITY, |parent| world[parent]) * local.affine();
        world.push(transform);
        let Some(extension) = nodes[*index].extension_value(NAME) else { continue };
        let number = extension.get("light").and_then(Value::as_u64).and_then(|number| usize::try_from(number).ok());
        let Some((number, light)) = number.and_then(|number| Some((number, listed.get(number)?))) else {
            let place = format!("/nodes/{index}/extensions/{NAME}/light");
            return Err(Error::model(path, place, "names no light of the file"));
        };
        let fail =
            |(below, reason): (&str, String)| Error::model(path, format!("/extensions/{NAME}/lights/{number}/{below}"), reason);
        let kind = kind(light).map_err(fail)?;
        let own = nodes[*index].name().or(light.get("name").and_then(Value::as_str));
        let name = own.map_or_else(|| format!("light {number}"), str::to_owned);
        ranges += usize::from(light.get("range").is_some());
        found.push(Light { name, kind, transform, node: place });
    }
    if ranges > 0 {
        report.notes.push(format!("{ranges} lights have a range, which is ignored: light falls off with the distance squared"));
    }
    if found.is_empty() && !listed.is_empty() {
        report.notes.push("no node of the file's scene shows a light of the file".into());
    }
    Ok(found)
}

/// A light of the file's list. The error is the field and what is wrong with it.
fn kind(light: &Value) -> std::result::Result<PunctualKind, (&'static str, String)> {
    let number = |of: &Value, key: &'static str, otherwise: f64, most: f64| match of.get(key) {
        None => Ok(otherwise),
        Some(value) => match value.as_f64() {
            Some(number) if (0.0..=most).contains(&number) => Ok(number),
            _ => Err((key, format!("{value} is not a number from 0 to {most}"))),
        },
    };
    let intensity = number(light, "intensity", 1.0, f64::from(f32::MAX))?;
    let mut color = [1.0; 3];
    if let Some(value) = light.get("color") {
        let list = value.as_array().filter(|list| list.len() == 3);
        let numbers: Option<Vec<f64>> = list.and_then(|list| list.iter().map(Value::as_f64).collect());
        match numbers {
            Some(numbers) if numbers.iter().all(|v| *v >= 0.0) => color = [numbers[0], numbers[1], numbers[2]],
            _ => return Err(("color", "is not three numbers, each >= 0".into())),
        }
    }
    let strength = color.map(|v| ((v * intensity) as f32).min(f32::MAX));
    match light.get("type").and_then(Value::as_str) {
        Some("point") => Ok(PunctualKind::Point { intensity: strength }),
        Some("directional") => Ok(PunctualKind::Directional { irradiance: strength }),
        Some("spot") => {
            let nothing = Value::Null;
            let spot = light.get("spot").unwrap_or(&nothing);
            // Written in single precision, half pi is more than half pi.
            let most = FRAC_PI_2 + 1e-6;
            let inner = number(spot, "innerConeAngle", 0.0, most).map_err(|(_, reason)| ("spot/innerConeAngle", reason))?;
            let outer = number(spot, "outerConeAngle", FRAC_PI_4, most).map_err(|(_, reason)| ("spot/outerConeAngle", reason))?;
            if inner >= outer {
                return Err(("spot/innerConeAngle", format!("{inner} is not less than the outer angle, {outer}")));
            }
            Ok(PunctualKind::Spot { intensity: strength, inner: inner as f32, outer: outer.min(FRAC_PI_2) as f32 })
        }
        _ => Err(("type", "is not \"point\", \"spot\" or \"directional\"".into())),
    }
}
