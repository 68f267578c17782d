//! The chain of crates is one-way: frame <- scenes <- renderer, frame <- model. The root knows them all, and only what measures
//! knows the root. Inside crates, modules have no circles. Those of the root crate form floors.

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
        (
            "renderflow-python",
            &["renderflow", "renderflow-frame", "renderflow-model", "renderflow-renderer", "renderflow-scenes"],
        ),
        ("renderflow-renderer", &["renderflow-frame", "renderflow-scenes"]),
        ("renderflow-scenes", &["renderflow-frame"]),
    ];
    assert_eq!(edges.len(), allowed.len(), "a crate is missing here: {:?}", edges.keys());
    for (name, may_use) in allowed {
        let used = &edges[*name];
        assert!(used.iter().all(|d| may_use.contains(&d.as_str())), "{name} uses {used:?}, may use {may_use:?}");
    }
}

/// Below a crate's root, and below each module of the root crate and of `renderflow-model`, modules use each other in one
/// direction.
#[test]
fn modules_have_no_circles() {
    for (folder, every_level) in [("", true), ("model", true), ("renderer", false), ("renderer/frame", false), ("scenes", false)]
    {
        let sources = Sources::read(folder);
        assert!(!sources.uses.is_empty(), "{folder}: no module uses another");
        let parents = if every_level { sources.parents() } else { BTreeSet::from([Vec::new()]) };
        for parent in parents {
            if let Some(circle) = sources.circle(&parent) {
                panic!("{folder}, below `{}`: {}", parent.join("::"), circle.join(" -> "));
            }
        }
    }
}

/// The floors of `src/` from the lowest to the highest: a module uses its own floor and those below it.
const FLOORS: [&str; 8] = ["util", "metrics", "dataset", "evaluate", "report", "paper", "view", "cli"];

#[test]
fn floors_of_the_root_crate_use_lower_floors_alone() {
    let sources = Sources::read("");
    assert!(sources.modules.len() > 80, "only {} modules were read", sources.modules.len());
    let floor = |module: &Module| {
        let name = module.first()?;
        let place = FLOORS.iter().position(|floor| floor == name);
        Some(place.unwrap_or_else(|| panic!("{name} is on no floor")))
    };
    let of_floors = sources.uses.iter().filter_map(|(user, used)| Some((user, used, floor(user)?, floor(used)?)));
    let upwards: Vec<String> = of_floors
        .filter(|(_, _, own, other)| other > own)
        .map(|(user, used, _, _)| format!("{} uses {}", user.join("::"), used.join("::")))
        .collect();
    assert!(upwards.is_empty(), "{}", upwards.join("\n"));
}

/// A module by its path from the crate's root.
type Module = Vec<String>;

/// The modules of a crate.
#[derive(Default)]
struct Sources {
    modules: BTreeSet<Module>,
    /// Which module uses which.
    uses: BTreeSet<(Module, Module)>,
}

impl Sources {
    /// Reads the crate in `folder`.
    fn read(folder: &str) -> Self {
        let mut files = Vec::new();
        list(&Path::new(env!("CARGO_MANIFEST_DIR")).join(folder).join("src"), &mut Vec::new(), &mut files);
        let modules: BTreeSet<Module> = files.iter().map(|(module, _)| module.clone()).collect();
        let mut uses = BTreeSet::new();
        for (module, text) in &files {
            for path in paths(text) {
                let target = resolve(module, &path);
                // The longest beginning of the path that is a module; the rest names an item.
                let found = (1..=target.len()).rev().map(|n| target[..n].to_vec()).find(|path| modules.contains(path));
                uses.extend(found.map(|used| (module.clone(), used)));
            }
        }
        Self { modules, uses }
    }

    fn parents(&self) -> BTreeSet<Module> {
        self.modules.iter().flat_map(|module| (0..module.len()).map(|n| module[..n].to_vec())).collect()
    }

    /// A circle among the children of a module, each taken with everything below it.
    fn circle(&self, parent: &Module) -> Option<Vec<String>> {
        let child = |module: &Module| module.strip_prefix(&parent[..]).and_then(|rest| rest.first().cloned());
        let mut edges: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
        for (a, b) in &self.uses {
            if let (Some(a), Some(b)) = (child(a), child(b))
                && a != b
            {
                edges.entry(a).or_default().insert(b);
            }
        }
        edges.keys().find_map(|start| {
            let mut way = vec![start.clone()];
            let mut seen = BTreeSet::new();
            returns(&edges, &mut way, &mut seen).then_some(way)
        })
    }
}

/// Extends a way until it is back at its start.
fn returns(edges: &BTreeMap<String, BTreeSet<String>>, way: &mut Vec<String>, seen: &mut BTreeSet<String>) -> bool {
    let last = way.last().expect("a start").clone();
    for next in edges.get(&last).into_iter().flatten() {
        way.push(next.clone());
        if *next == way[0] || (seen.insert(next.clone()) && returns(edges, way, seen)) {
            return true;
        }
        way.pop();
    }
    false
}

/// Every module below a folder with its text, without comments and inline tests.
fn list(folder: &Path, module: &mut Module, found: &mut Vec<(Module, String)>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_stem().unwrap().to_str().unwrap().to_owned();
        if path.is_dir() {
            module.push(name);
            list(&path, module, found);
            module.pop();
        } else if path.extension().is_some_and(|ending| ending == "rs") {
            let mut module = module.clone();
            module.extend((!["mod", "lib", "main"].contains(&name.as_str())).then_some(name));
            let text = std::fs::read_to_string(&path).unwrap();
            let code = text.split("#[cfg(test)]\nmod tests").next().unwrap().lines();
            found.push((module, code.map(|line| line.split("//").next().unwrap()).collect::<Vec<_>>().join("\n")));
        }
    }
}

/// The paths of a text that begin with `crate`, `super` or `self`. Those of a group in braces are listed one by one.
fn paths(text: &str) -> Vec<String> {
    let mut found = Vec::new();
    for start in ["crate::", "super::", "self::"] {
        for (at, _) in text.match_indices(start) {
            let before = text[..at].chars().next_back();
            if before.is_some_and(|c| c.is_alphanumeric() || c == '_' || c == ':' || c == '$') {
                continue;
            }
            let rest = &text[at..];
            let end = rest.find(|c: char| !(c.is_alphanumeric() || c == '_' || c == ':')).unwrap_or(rest.len());
            if rest[end..].starts_with('{') && rest[..end].ends_with("::") {
                expand(&rest[..end], &rest[end..], &mut found);
            } else {
                found.push(rest[..end].to_owned());
            }
        }
    }
    found
}

/// Adds `start` joined with each path of a group that begins with a brace.
fn expand(start: &str, group: &str, found: &mut Vec<String>) {
    let (mut depth, mut item) = (0, 1);
    for (at, c) in group.char_indices() {
        depth += i32::from(c == '{') - i32::from(c == '}');
        if (c == ',' && depth == 1) || depth == 0 {
            let path = group[item..at].trim();
            match path.split_once('{') {
                Some((head, _)) => expand(&format!("{start}{head}"), &path[head.len()..], found),
                None => found.push(format!("{start}{}", path.split(" as ").next().unwrap().trim())),
            }
            item = at + 1;
        }
        if depth == 0 {
            return;
        }
    }
}

/// The path from the crate's root that a path in `module` means.
fn resolve(module: &Module, path: &str) -> Module {
    let mut base = module.clone();
    let mut parts = path.split("::").filter(|part| !part.is_empty()).peekable();
    match parts.peek() {
        Some(&"crate") => base.clear(),
        Some(&"super") => drop(base.pop()),
        _ => {}
    }
    parts.next();
    while parts.next_if_eq(&"super").is_some() {
        base.pop();
    }
    base.extend(parts.map(str::to_owned));
    base
}
