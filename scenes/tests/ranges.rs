//! Ranges of parameters: what the JSON Schema says of each number is what validation refuses beyond.

use renderflow_scenes::catalog::Catalog;
use renderflow_scenes::pattern::Pattern;
use renderflow_scenes::schema::json_schema;
use renderflow_scenes::seed::Seed;
use renderflow_scenes::shapes::{FAMILIES, Shape};
use renderflow_scenes::sky::{self, Sky};
use serde_json::{Value, json};

/// The part of the schema that `value` is held to.
fn resolve<'a>(root: &'a Value, mut schema: &'a Value, value: &Value) -> &'a Value {
    loop {
        if let Some(name) = schema["$ref"].as_str() {
            schema = root.pointer(name.trim_start_matches('#')).expect(name);
            continue;
        }
        let Some(options) = schema["oneOf"].as_array().or(schema["anyOf"].as_array()) else { return schema };
        let fits = |option: &&Value| match ["family", "kind"].iter().find(|tag| option["properties"][tag]["const"].is_string()) {
            Some(tag) => option["properties"][tag]["const"] == value[tag],
            None => option["type"] != "null",
        };
        schema = options.iter().find(fits).unwrap_or_else(|| panic!("{value} is none of {options:?}"));
    }
}

/// Every number of `value`: its pointer and what the schema says of it.
fn numbers<'a>(root: &'a Value, schema: &'a Value, value: &Value, at: &str, found: &mut Vec<(String, &'a Value)>) {
    let schema = resolve(root, schema, value);
    match value {
        Value::Object(fields) => {
            for (field, value) in fields {
                numbers(root, &schema["properties"][field], value, &format!("{at}/{field}"), found);
            }
        }
        Value::Array(items) => {
            for (index, value) in items.iter().enumerate() {
                numbers(root, &schema["items"], value, &format!("{at}/{index}"), found);
            }
        }
        Value::Number(_) => found.push((at.to_owned(), schema)),
        _ => {}
    }
}

/// Takes every number of `value` just beyond both ends of its range; returns how many there are.
fn hold<T: serde::Serialize + serde::de::DeserializeOwned>(
    root: &Value,
    kind: &str,
    value: &T,
    validate: impl Fn(&T) -> Vec<(String, String)>,
) -> usize {
    assert_eq!(validate(value), []);
    let whole = serde_json::to_value(value).unwrap();
    let mut found = Vec::new();
    numbers(root, &root["$defs"][kind], &whole, "", &mut found);
    for (pointer, schema) in &found {
        // Seeds are free, and where a lamp stands is a matter of its distance.
        let free = ["/seed", "/glass"].iter().any(|end| pointer.ends_with(end)) || pointer.contains("/position/");
        assert_eq!(schema["maximum"].is_null(), free, "{kind} {pointer}: {schema}");
        if free {
            continue;
        }
        let integer = schema["format"] == "uint32";
        for (end, step) in [("minimum", -1.0), ("maximum", 1.0)] {
            let end = schema[end].as_f64().expect("a number");
            let beyond = end + step * (end.abs() * 1e-3).max(if integer { 1.0 } else { 1e-3 });
            if integer && beyond < 0.0 {
                continue;
            }
            let mut broken = whole.clone();
            *broken.pointer_mut(pointer).unwrap() = if integer { json!(beyond as u32) } else { json!(beyond) };
            let faults = validate(&serde_json::from_value(broken).unwrap());
            assert!(faults.iter().any(|(at, _)| at == pointer), "{kind} {pointer} = {beyond} of {whole}: {faults:?}");
        }
    }
    found.len()
}

#[test]
fn shapes_skies_and_patterns_keep_to_the_ranges_of_the_schema() {
    let root = json_schema();
    let mut count = 0;
    for family in FAMILIES {
        count += hold(&root, "Shape", &Shape::random_of(family, &mut Seed::root(7).child(family, 0).rng()), Shape::validate);
    }
    for kind in Pattern::KINDS {
        count += hold(&root, "Pattern", &Pattern::named(kind).unwrap(), Pattern::validate);
    }
    let catalog = Catalog::new(7, 1, 1);
    for number in 0..sky::ENVIRONMENTS.len() as u32 {
        count += hold(&root, "Sky", &catalog.environment(number), Sky::validate);
    }
    for (_, sky) in sky::library() {
        count += hold(&root, "Sky", sky, Sky::validate);
    }
    assert!(count > 1500, "{count} numbers");
}

#[test]
fn lists_keep_to_the_counts_of_the_schema() {
    let root = json_schema();
    let lathe =
        |radii: usize| serde_json::from_value::<Shape>(json!({"family": "lathe", "radii": vec![0.3; radii], "height": 1.0}));
    for (radii, fine) in [(1, false), (2, true), (16, true), (17, false)] {
        let faults = lathe(radii).unwrap().validate();
        let expected = [("/radii".to_owned(), format!("{radii} entries, outside 2..=16"))];
        assert_eq!(faults, if fine { &[][..] } else { &expected[..] });
    }
    let text = root["$defs"]["Shape"].to_string();
    assert!(text.contains(r#""maxItems":16,"minItems":2"#), "{text}");
}

#[test]
fn bounds_that_depend_on_other_parameters_are_named() {
    let shape = |text: &str| serde_json::from_str::<Shape>(text).unwrap().validate();
    let fault = |at: &str, reason: &str| vec![(at.to_owned(), reason.to_owned())];
    assert_eq!(shape(r#"{"family":"box","size":[1,2,3],"bevel":0.6}"#), fault("/bevel", "0.6 is outside 0..=0.5"));
    assert_eq!(shape(r#"{"family":"capsule","radius":0.5,"height":0.9}"#), fault("/height", "0.9 is outside 1..=1000"));
    let knot = r#"{"family":"torus_knot","p":2,"q":4,"radius":0.5,"tube":0.01}"#;
    assert_eq!(shape(knot), fault("/q", "4 shares a factor with p = 2: the curve would be walked twice"));
    let sky = |text: &str| serde_json::from_str::<Sky>(text).unwrap().validate();
    let sunset = r#"{"family":"sunset","sun":{"elevation":20},"turbidity":3,"bands":0,"seed":1,"ground":[0,0,0],"luminance":1}"#;
    assert_eq!(sky(sunset), fault("/sun/elevation", "20 is outside -5..=15"));
    let room = r#"{"family":"room","size":[4,3,4],"eye_height":2.9,"walls":[0,0,0],"floor":[0,0,0],"ceiling":[0,0,0],
        "openings":[{"wall":"north","offset":[2,0],"size":[1,5],"radiance":[1,1,1]}]}"#;
    let pointers: Vec<String> = sky(room).into_iter().map(|(at, _)| at).collect();
    assert_eq!(pointers, ["/eye_height", "/openings/0/offset/0", "/openings/0/size/1"]);
}
