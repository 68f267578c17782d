//! The JSON of a glTF file: read, brought into the form that the gltf crate knows where that is stricter than glTF, and
//! validated.

use super::{READ, container};
use crate::error::{Error, Result};
use gltf::json::Root;
use gltf::json::validation::{self, Checked, Validate};
use gltf::{Document, Semantic};
use renderflow_frame::words::{number, plain, shortened};
use serde::Deserialize;
use serde::de::IgnoredAny;
use serde_json::{Map, Value};
use std::collections::{HashMap, HashSet};
use std::path::Path;

/// Whole numbers below this have one form as a double.
const LARGEST_WHOLE: f64 = 9_007_199_254_740_992.0;
/// Most parts of a value that are tried one by one to find the wrong one among them.
const MOST_PARTS: usize = 64;

/// The document, validated, and the binary chunk of a `.glb`.
pub(super) fn parse(path: &Path, bytes: &[u8]) -> Result<(Document, Option<Vec<u8>>)> {
    let (json, blob) = container::split(bytes).map_err(|reason| Error::model(path, "", reason))?;
    let json = json.strip_prefix(b"\xef\xbb\xbf").unwrap_or(json);
    let root = root(json).map_err(|(pointer, reason)| Error::model(path, pointer, format!("not glTF 2.0: {reason}")))?;
    let document = Document::from_json_without_validation(root);
    validate(path, document.as_json(), json)?;
    Ok((document, blob.map(<[u8]>::to_vec)))
}

/// Primitives, each by the numbers of its mesh and its own, whose morph targets have texture coordinates or colours. The gltf
/// crate does not know these (1.4), so the text of the file is looked at again.
pub(super) fn further_targets(bytes: &[u8]) -> HashSet<(usize, usize)> {
    #[derive(Deserialize, Default)]
    #[serde(default)]
    struct Top {
        meshes: Vec<Mesh>,
    }
    #[derive(Deserialize, Default)]
    #[serde(default)]
    struct Mesh {
        primitives: Vec<Primitive>,
    }
    #[derive(Deserialize, Default)]
    #[serde(default)]
    struct Primitive {
        targets: Vec<HashMap<String, IgnoredAny>>,
    }
    let Ok((json, _)) = container::split(bytes) else { return HashSet::new() };
    let top: Top = serde_json::from_slice(json.strip_prefix(b"\xef\xbb\xbf").unwrap_or(json)).unwrap_or_default();
    let further = |name: &String| name.starts_with("TEXCOORD_") || name.starts_with("COLOR_");
    let primitives =
        top.meshes.iter().enumerate().flat_map(|(m, mesh)| (0..).zip(&mesh.primitives).map(move |(p, x)| ((m, p), x)));
    let found = primitives.filter(|(_, primitive)| primitive.targets.iter().flat_map(HashMap::keys).any(further));
    found.map(|(place, _)| place).collect()
}

/// The parsed JSON. The error is a JSON pointer (empty where the reason tells a line) and a reason.
fn root(json: &[u8]) -> std::result::Result<Root, (String, String)> {
    if json.trim_ascii().is_empty() {
        return Err((String::new(), "there is no JSON in it".into()));
    }
    let error = match Root::from_slice(json) {
        Ok(root) => return Ok(root),
        Err(error) => error,
    };
    // The text may be valid all the same, where the crate knows one form of several.
    let whole = |error: &serde_json::Error| (String::new(), plain(&error.to_string()));
    let mut value: Value = serde_json::from_slice(json).map_err(|e| whole(&e))?;
    normalise(&mut value);
    let Value::Object(top) = &value else {
        return Err((String::new(), format!("found {} where an object is needed", kind(&value))));
    };
    Root::deserialize(&value).map_err(|_| locate(top).unwrap_or_else(|| whole(&error)))
}

/// What a value is, in words.
fn kind(value: &Value) -> &'static str {
    match value {
        Value::Null => "null",
        Value::Bool(_) => "true or false",
        Value::Number(_) => "a number",
        Value::String(_) => "a string",
        Value::Array(_) => "a list",
        Value::Object(_) => "an object",
    }
}

/// Takes away what is never looked at, adds lists that may be left out, and writes whole numbers without a fraction.
fn normalise(value: &mut Value) {
    if let Some(animations) = value.get_mut("animations").and_then(Value::as_array_mut) {
        for channels in animations.iter_mut().filter_map(|a| a.get_mut("channels")?.as_array_mut()) {
            // A channel without a node moves what an extension says (glTF 2.0, section 5.6.2).
            channels.retain(|channel| channel.get("target").is_none_or(|t| !t.is_object() || t.get("node").is_some()));
        }
    }
    // A scene may be empty (glTF 2.0, section 5.25).
    for scene in value.get_mut("scenes").and_then(Value::as_array_mut).into_iter().flatten().filter_map(Value::as_object_mut) {
        scene.entry("nodes").or_insert_with(|| Value::Array(vec![]));
    }
    tidy(value);
}

fn tidy(value: &mut Value) {
    match value {
        Value::Object(fields) => {
            // Any value is allowed there; the crate asks for an object.
            fields.remove("extras");
            fields.values_mut().for_each(tidy);
        }
        Value::Array(items) => items.iter_mut().for_each(tidy),
        Value::Number(n) if n.is_f64() => {
            let v = n.as_f64().unwrap_or_default();
            let negative_zero = v == 0.0 && v.is_sign_negative();
            if v.fract() == 0.0 && !negative_zero && v.abs() < LARGEST_WHOLE {
                *value = Value::from(v as i64);
            }
        }
        _ => {}
    }
}

/// Where `top` is not what the crate knows: the smallest part that alone is to blame, and why.
fn locate(top: &Map<String, Value>) -> Option<(String, String)> {
    // An object of its own around each part, so that only the part can be wrong.
    let error = |key: &str, value: Value| {
        let mut alone = Map::from_iter([("asset".to_owned(), serde_json::json!({ "version": "2.0" }))]);
        alone.insert(key.into(), value);
        Root::deserialize(&Value::Object(alone)).err().map(|e| plain(&e.to_string()))
    };
    for (key, value) in top {
        let Some(reason) = error(key, value.clone()) else { continue };
        let Value::Array(items) = value else { return Some(narrowed(format!("/{key}"), reason, value, &|v| error(key, v))) };
        for (i, item) in items.iter().enumerate() {
            let alone = |v: Value| error(key, Value::Array(vec![v]));
            if let Some(reason) = alone(item.clone()) {
                return Some(narrowed(format!("/{key}/{i}"), reason, item, &alone));
            }
        }
        return Some((format!("/{key}"), reason));
    }
    let missing = Root::deserialize(&Value::Object(top.clone())).err()?;
    Some((String::new(), plain(&missing.to_string())))
}

/// Goes on into the part of `value` without which the error is another one or none.
fn narrowed(pointer: String, reason: String, value: &Value, error: &dyn Fn(Value) -> Option<String>) -> (String, String) {
    let parts: Vec<(String, Value)> = match value {
        Value::Object(fields) if fields.len() <= MOST_PARTS => fields.iter().map(|(k, v)| (k.clone(), v.clone())).collect(),
        Value::Array(items) if items.len() <= MOST_PARTS => {
            items.iter().enumerate().map(|(i, v)| (i.to_string(), v.clone())).collect()
        }
        _ => return (pointer, reason),
    };
    for (key, part) in parts {
        // No field is missing in what has none.
        if reason.starts_with("missing field") && !part.is_object() && !part.is_array() {
            continue;
        }
        let with = |replaced: Option<Value>| {
            let mut copy = value.clone();
            match (&mut copy, replaced) {
                (Value::Object(fields), Some(v)) => drop(fields.insert(key.clone(), v)),
                (Value::Object(fields), None) => drop(fields.remove(&key)),
                (Value::Array(items), v) => {
                    let at = key.parse().unwrap_or(0);
                    items.splice(at..=at, v).for_each(drop);
                }
                _ => {}
            }
            error(copy)
        };
        if with(None).as_ref() != Some(&reason) {
            return narrowed(format!("{pointer}/{key}"), reason, &part, &|v| with(Some(v)));
        }
    }
    (pointer, reason)
}

/// Refuses what contradicts itself or asks for what is not read here.
fn validate(path: &Path, root: &Root, json: &[u8]) -> Result<()> {
    let version = root.asset.version.split('.').next();
    if version != Some("2") {
        return Err(Error::model(path, "/asset/version", format!("{:?} is not 2.x", shortened(&root.asset.version))));
    }
    for (m, mesh) in root.meshes.iter().enumerate() {
        for (p, primitive) in mesh.primitives.iter().enumerate() {
            // The crate's validation reads this accessor before it checks the index (1.4).
            let positions = primitive.attributes.get(&Checked::Valid(Semantic::Positions));
            if positions.is_some_and(|index| index.value() >= root.accessors.len()) {
                let place = format!("/meshes/{m}/primitives/{p}/attributes/POSITION");
                return Err(Error::model(path, place, "the accessor does not exist"));
            }
        }
    }
    let mut problems = vec![];
    root.validate(root, gltf::json::Path::new, &mut |place, error| {
        let place = place().to_string();
        let read_here = place.starts_with("extensionsRequired") && READ.iter().any(|name| place.contains(name));
        // Bounds are not used here, primitives without positions are skipped, and accessors without a view are zeros.
        let absent =
            place.contains("attributes[\"POSITION\"]") || (place.starts_with("accessors[") && place.ends_with("].bufferView"));
        let not_needed = absent && matches!(error, validation::Error::Missing);
        if !read_here && !not_needed {
            problems.push((place, error));
        }
    });
    if problems.is_empty() {
        return Ok(());
    }
    // Only here, for the words of the message: nothing that is valid is read twice.
    let mut value: Value = serde_json::from_slice(json).unwrap_or_default();
    normalise(&mut value);
    let mut said: Vec<(validation::Error, String, String)> = problems
        .into_iter()
        .filter_map(|(place, error)| {
            // "meshes[0].primitives[1].indices" -> "/meshes/0/primitives/1/indices"
            let pointer = format!("/{}", place.replace('[', "/").replace(']', "").replace('.', "/").replace('"', ""));
            let Some(attributes) = pointer.strip_suffix("/<invalid semantic name>") else {
                let reason = reason(error, value.pointer(&pointer));
                return Some((error, pointer, reason));
            };
            let name = unknown_attribute(value.pointer(attributes)?)?;
            Some((error, format!("{attributes}/{}", shortened(&name)), "no attribute has this name".into()))
        })
        .collect();
    // A file that needs an extension looks broken without it: say the cause, not the consequences.
    said.sort_by_key(|(error, ..)| !matches!(error, validation::Error::Unsupported));
    let more = if said.len() > 1 { format!(" (and {} more problems)", said.len() - 1) } else { String::new() };
    match said.into_iter().next() {
        None => Ok(()),
        Some((_, pointer, reason)) => Err(Error::model(path, pointer, format!("{reason}{more}"))),
    }
}

/// The first attribute that glTF has not; names of applications begin with `_` (glTF 2.0, section 3.7.2.1).
fn unknown_attribute(attributes: &Value) -> Option<String> {
    let known = |name: &str| matches!(Checked::<Semantic>::deserialize(&Value::from(name)), Ok(Checked::Valid(_)));
    attributes.as_object()?.keys().find(|name| !name.starts_with('_') && !known(name)).cloned()
}

/// What is wrong with a value, in words.
fn reason(error: validation::Error, value: Option<&Value>) -> String {
    let value = value.map(|value| match value {
        Value::Number(n) => n.as_f64().map_or_else(|| n.to_string(), number),
        Value::String(text) => format!("{:?}", shortened(text)),
        other => shortened(&other.to_string()),
    });
    let value = value.as_deref();
    match error {
        validation::Error::IndexOutOfBounds => match value {
            Some(index) => format!("there is nothing with the index {index}"),
            None => "an index of something that does not exist".into(),
        },
        validation::Error::Invalid => match value {
            Some(value) => format!("{value} is not one of the values allowed here"),
            None => "not one of the values allowed here".into(),
        },
        validation::Error::Missing => "is missing".into(),
        validation::Error::Oversize => "larger than this machine can count".into(),
        validation::Error::Unsupported => "a required extension that this program does not read".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn refusal(value: Value) -> String {
        let json = value.to_string();
        match root(json.as_bytes()) {
            Err((pointer, reason)) => format!("{pointer}: {reason}"),
            Ok(_) => "accepted".into(),
        }
    }

    #[test]
    fn the_place_of_a_wrong_value_is_found() {
        let file = |key: &str, value: Value| json!({ "asset": { "version": "2.0" }, key: value });
        for (value, expected) in [
            (json!([1]), ": found a list where an object is needed"),
            (json!({}), ": missing field `asset`"),
            (json!({ "asset": 7 }), "/asset: found 7 where an object is needed"),
            (file("scene", json!(1.5)), "/scene: found 1.5 where a whole number from 0 to 4294967295 is needed"),
            (
                file("nodes", json!([{}, { "name": "a", "translation": [0, "far", 0] }])),
                "/nodes/1/translation/1: found the string \"far\" where a number is needed",
            ),
            (
                file("meshes", json!([{ "primitives": [{ "attributes": {} }, { "attributes": { "POSITION": -1 } }] }])),
                "/meshes/0/primitives/1/attributes/POSITION: found -1 where a whole number from 0 to 4294967295 is needed",
            ),
            (file("bufferViews", json!([{ "buffer": 0 }])), "/bufferViews/0: missing field `byteLength`"),
        ] {
            let said = refusal(value.clone());
            assert!(said.starts_with(expected), "{value}: {said}");
        }
    }

    #[test]
    fn what_gltf_allows_and_the_crate_does_not_is_accepted() {
        for value in [
            json!({ "asset": { "version": "2.0", "extras": "text" }, "extras": [1], "nodes": [{ "extras": 7 }] }),
            json!({ "asset": { "version": "2.0" }, "scene": 0.0, "nodes": [{ "mesh": 3.0 }], "accessors":
                [{ "componentType": 5126.0, "count": 3.0, "type": "VEC3" }] }),
            json!({ "asset": { "version": "2.0" }, "animations":
                [{ "samplers": [], "channels": [{ "sampler": 0, "target": { "path": "pointer", "extensions": {} } }] }] }),
            json!({ "asset": { "version": "2.0" }, "nodes": [{}], "scene": 0, "scenes": [{ "nodes": [0] }, { "name": "empty" }] }),
        ] {
            assert_eq!(refusal(value.clone()), "accepted", "{value}");
        }
    }
}
