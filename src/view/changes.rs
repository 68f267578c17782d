//! Values of a material as the page shows and changes them.

use super::state::Value;
use anyhow::Result;
use renderflow_scenes::Principled;
use renderflow_scenes::description::Material;
use serde_json::Value as Json;
use std::collections::BTreeMap;

/// The parameters of a material, in the order of their declaration.
pub fn values(surface: &Principled) -> Vec<(String, Value)> {
    let mut found: Vec<(String, Value)> = Vec::new();
    surface.for_each(|pointer, number| match pointer.split_once('/') {
        None => found.push((pointer.to_owned(), Value::Number(number))),
        Some((name, place)) => match found.last_mut() {
            Some((last, Value::Color(color))) if last == name => {
                if let Some(value) = place.parse().ok().and_then(|place: usize| color.get_mut(place)) {
                    *value = number;
                }
            }
            _ => found.push((name.to_owned(), Value::Color([number, 0.0, 0.0]))),
        },
    });
    found
}

/// `surface` with the values that `changes` has.
pub fn changed(surface: &Principled, changes: Option<&BTreeMap<String, Value>>) -> Principled {
    let mut numbers = Vec::new();
    surface.for_each(|pointer, number| {
        let (name, place) = pointer.split_once('/').unwrap_or((pointer, "0"));
        numbers.push(match changes.and_then(|changes| changes.get(name)) {
            None => number,
            Some(Value::Number(number)) => *number,
            Some(Value::Color(color)) => place.parse().ok().and_then(|place: usize| color.get(place)).copied().unwrap_or(number),
        });
    });
    let mut numbers = numbers.into_iter();
    Principled::from_fn(|| numbers.next().unwrap_or(0.0)).clamped()
}

/// The description of a material with the values that `changes` has.
pub fn written(material: &Material, changes: &BTreeMap<String, Value>) -> Result<Material> {
    let surface = changed(&Principled::from(material), Some(changes));
    let mut whole = serde_json::to_value(material)?;
    for (name, value) in values(&surface) {
        if changes.contains_key(&name)
            && let Json::Object(fields) = &mut whole
        {
            fields.insert(name, serde_json::to_value(value)?);
        }
    }
    Ok(serde_json::from_value(whole)?)
}
