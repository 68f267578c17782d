//! The chain of crates is one-way: frame <- scenes <- renderer, frame <- model. The root knows them all, and only what measures
//! knows the root.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::process::Command;

#[test]
fn dependencies_point_one_way() {
    let output = Command::new(env!("CARGO"))
        .args(["metadata", "--format-version", "1", "--no-deps", "--offline"])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .expect("cargo metadata runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let metadata: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let mut edges: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for package in metadata["packages"].as_array().unwrap() {
        let dependencies = package["dependencies"].as_array().unwrap().iter();
        let ours = dependencies.filter_map(|d| d["name"].as_str()).filter(|name| name.starts_with("renderflow"));
        let mut ours: Vec<String> = ours.map(str::to_owned).collect();
        ours.sort();
        ours.dedup();
        edges.insert(package["name"].as_str().unwrap().to_owned(), ours);
    }
    let allowed: &[(&str, &[&str])] = &[
        ("renderflow", &["renderflow-frame", "renderflow-model", "renderflow-renderer", "renderflow-scenes"]),
        ("renderflow-bench", &["renderflow", "renderflow-frame", "renderflow-model", "renderflow-renderer", "renderflow-scenes"]),
        ("renderflow-frame", &[]),
        ("renderflow-model", &["renderflow-frame"]),
        ("renderflow-renderer", &["renderflow-frame", "renderflow-scenes"]),
        ("renderflow-scenes", &["renderflow-frame"]),
    ];
    assert_eq!(edges.len(), allowed.len(), "a crate is missing here: {:?}", edges.keys());
    for (name, may_use) in allowed {
        let used = &edges[*name];
        assert!(used.iter().all(|d| may_use.contains(&d.as_str())), "{name} uses {used:?}, may use {may_use:?}");
    }
}

/// The floors of `src/` from the lowest to the highest: a module uses its own floor and those below it.
const FLOORS: [&str; 6] = ["util", "metrics", "dataset", "evaluate", "report", "cli"];

/// A module by the names that lead to it: `["dataset", "pack", "list"]`.
type Module = Vec<String>;

#[test]
fn floors_of_the_root_crate_use_lower_floors_alone() {
    let uses = uses();
    assert!(uses.len() > 80, "only {} modules were read", uses.len());
    for (module, used) in &uses {
        let Some(own) = module.first() else { continue };
        let floor = |name: &String| FLOORS.iter().position(|floor| floor == name);
        let own_floor = floor(own).unwrap_or_else(|| panic!("{own} is on no floor"));
        for other in used.iter().filter_map(|used| used.first()) {
            let is_lower = floor(other).is_some_and(|other| other <= own_floor);
            assert!(is_lower, "{} uses {other}, which is above it", module.join("::"));
        }
    }
}

#[test]
fn modules_of_the_root_crate_form_no_circles() {
    // Parents and their children may use each other; everything else is told of the two siblings that a use leads between.
    let mut siblings: BTreeMap<Module, BTreeSet<Module>> = BTreeMap::new();
    for (module, used) in uses() {
        for other in used {
            let shared = module.iter().zip(&other).take_while(|(a, b)| a == b).count();
            if shared < module.len().min(other.len()) {
                siblings.entry(module[..=shared].to_vec()).or_default().insert(other[..=shared].to_vec());
            }
        }
    }
    // Whoever uses nothing that is left is in no circle.
    loop {
        let left: BTreeSet<Module> = siblings.keys().cloned().collect();
        siblings.values_mut().for_each(|used| used.retain(|other| left.contains(other)));
        let before = siblings.len();
        siblings.retain(|_, used| !used.is_empty());
        if siblings.len() == before {
            break;
        }
    }
    assert!(siblings.is_empty(), "in or above a circle: {siblings:#?}");
}

/// The modules of `src/`, each with the others that its code names by `crate::`, `super::` or the name of a child. Tests are left out.
fn uses() -> BTreeMap<Module, BTreeSet<Module>> {
    let mut sources = BTreeMap::new();
    read(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src"), &mut Vec::new(), &mut sources);
    let modules: BTreeSet<Module> = sources.keys().cloned().collect();
    let mut uses = BTreeMap::new();
    for (module, source) in &sources {
        let code = source.split("#[cfg(test)]\nmod tests").next().unwrap_or_default();
        let code: String = code.lines().map(|line| line.split("//").next().unwrap_or_default()).collect::<Vec<_>>().join("\n");
        let mut paths = Vec::new();
        for (at, _) in code.match_indices("::") {
            let head = code[..at].rfind(|c: char| !c.is_alphanumeric() && c != '_').map_or(0, |before| before + 1);
            if head < at && !code[..head].ends_with("::") {
                tree(&code[head..], &mut Vec::new(), &mut paths);
            }
        }
        let found = paths.iter().filter_map(|path| resolve(&modules, module, path)).filter(|other| other != module);
        uses.insert(module.clone(), found.collect());
    }
    uses
}

/// Reads every module at and below `folder`.
fn read(folder: &Path, module: &mut Module, sources: &mut BTreeMap<Module, String>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let stem = path.file_stem().unwrap().to_str().unwrap().to_owned();
        if path.is_dir() {
            module.push(stem);
            read(&path, module, sources);
            module.pop();
        } else if path.extension().is_some_and(|ending| ending == "rs") && stem != "main" {
            let name = if ["mod", "lib"].contains(&stem.as_str()) { None } else { Some(stem) };
            sources.insert(module.iter().cloned().chain(name).collect(), std::fs::read_to_string(&path).unwrap());
        }
    }
}

/// Adds the paths that a use tree or a path at the start of `code` names; returns what follows.
fn tree<'a>(code: &'a str, before: &mut Vec<String>, paths: &mut Vec<Vec<String>>) -> &'a str {
    let length = before.len();
    let mut rest = code.trim_start();
    loop {
        let end = rest.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(rest.len());
        before.push(rest[..end].to_owned());
        match rest[end..].strip_prefix("::") {
            Some(after) if after.starts_with('{') => {
                let mut inside = &after[1..];
                loop {
                    inside = tree(inside, before, paths).trim_start();
                    match inside.strip_prefix(',') {
                        Some(more) if !more.trim_start().starts_with('}') => inside = more,
                        Some(more) => break rest = &more.trim_start()[1..],
                        None => break rest = inside.get(1..).unwrap_or_default(),
                    }
                }
                break;
            }
            Some(after) => rest = after,
            None => {
                paths.push(before.clone());
                rest = &rest[end..];
                break;
            }
        }
    }
    before.truncate(length);
    // `name as other`
    match rest.strip_prefix(" as ") {
        Some(alias) => alias.trim_start_matches(|c: char| c.is_alphanumeric() || c == '_'),
        None => rest,
    }
}

/// The module that a path in `module` leads to or into.
fn resolve(modules: &BTreeSet<Module>, module: &Module, path: &[String]) -> Option<Module> {
    let (mut found, mut rest) = match path[0].as_str() {
        "crate" => (Vec::new(), &path[1..]),
        "self" => (module.clone(), &path[1..]),
        "super" => {
            let levels = path.iter().take_while(|name| *name == "super").count();
            (module[..module.len().saturating_sub(levels)].to_vec(), &path[levels..])
        }
        _ => (module.clone(), path),
    };
    let start = found.len();
    while let Some((name, after)) = rest.split_first() {
        found.push(name.clone());
        if !modules.contains(&found) {
            found.pop();
            break;
        }
        rest = after;
    }
    let named = ["crate", "self", "super"].contains(&path[0].as_str());
    (named || found.len() > start).then_some(found)
}
