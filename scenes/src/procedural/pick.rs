//! What a sequence draws from its split's pool.

use super::{Composition, LayoutKind, Pool};
use crate::description::EnvironmentSource;
use crate::draw::Draw;
use crate::error::{Error, Problem, Result};
use crate::load::{Extent, extent};
use crate::seed::Seed;
use crate::shapes::Shape;
use crate::sky;
use rand_pcg::Pcg64;
use renderflow_frame::reach::Reach;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// Something to be placed.
pub(super) enum Picked {
    Mesh { shape: Shape, family: &'static str, number: u32 },
    Model { path: String, extent: Extent },
}

impl Picked {
    /// Group of its shape; none for a file.
    pub fn group(&self) -> &'static str {
        match self {
            Self::Mesh { shape, .. } => shape.group(),
            Self::Model { .. } => "",
        }
    }
}

/// The environment of a sequence.
pub(super) struct Light {
    pub source: EnvironmentSource,
    /// Family, `builtin:NAME` or `file:PATH`.
    pub name: String,
    pub number: Option<u32>,
}

/// A pool whose names are known to be right.
pub(super) struct Picker<'a> {
    pool: &'a Pool<'a>,
    knobs: &'a Composition,
    /// Families and their groups.
    meshes: Vec<(&'static str, &'static str)>,
    environments: Vec<&'static str>,
}

impl<'a> Picker<'a> {
    /// # Errors
    /// [`Error::Invalid`] for families, maps or numbers that do not exist, and for a pool without meshes or without environments.
    pub fn new(pool: &'a Pool<'a>, knobs: &'a Composition) -> Result<Self> {
        let mut problems = vec![];
        let mut known = |list: &str, wanted: &[String], all: &[&'static str], count: u32| {
            let mut found = vec![];
            for (index, name) in wanted.iter().enumerate() {
                let place = all.iter().position(|known| known == name);
                match place {
                    Some(place) if (place as u32) < count => found.push(all[place]),
                    Some(place) => problems.push(Problem {
                        pointer: format!("/{list}/{index}"),
                        reason: format!("the catalogue's {count} have none of {name:?}, it takes {} at least", place + 1),
                    }),
                    None => problems.push(Problem {
                        pointer: format!("/{list}/{index}"),
                        reason: format!("there is no family {name:?}; there are {}", all.join(", ")),
                    }),
                }
            }
            found
        };
        let catalog = pool.catalog;
        let meshes = known("mesh_families", pool.mesh_families, catalog.mesh_families(), catalog.meshes());
        let environments =
            known("environment_families", pool.environment_families, catalog.environment_families(), catalog.environments());
        let mut say = |pointer: String, reason: String| problems.push(Problem { pointer, reason });
        for (index, name) in pool.builtin.iter().enumerate() {
            if !sky::names().contains(&name.as_str()) {
                let all = sky::names().join(", ");
                say(format!("/builtin/{index}"), format!("no environment is named {name:?}; there are {all}"));
            }
        }
        if pool.mesh_families.is_empty() && pool.models.is_empty() {
            say("/mesh_families".into(), "there are neither families nor models: nothing to show".into());
        }
        if pool.environment_families.is_empty() && pool.hdris.is_empty() && pool.builtin.is_empty() {
            say("/environment_families".into(), "there are neither families nor maps: no light".into());
        }
        if !problems.is_empty() {
            return Err(Error::Invalid { file: None, problems });
        }
        let group = |family: &'static str| (family, Shape::random_of(family, &mut Seed::root(0).rng()).group());
        Ok(Self { pool, knobs, meshes: meshes.into_iter().map(group).collect(), environments })
    }

    /// An object: a model file, or a mesh whose group ([`Shape::group`]) is one of those that `suits` accepts (any, where it
    /// accepts none).
    pub fn object(&self, rng: &mut Pcg64, suits: impl Fn(&str) -> bool) -> Result<Picked> {
        let models = self.pool.models;
        if !models.is_empty() && (self.meshes.is_empty() || rng.chance(self.knobs.user_models)) {
            let path = &models[rng.below(models.len() as u32) as usize];
            return Ok(Picked::Model { path: path.clone(), extent: extent_of(path, self.pool.allowed)? });
        }
        Ok(self.mesh(rng, &suits).or_else(|| self.mesh(rng, &|_| true)).unwrap_or_else(|| {
            // Every family that is left by `new` has a number.
            let (shape, family) = (self.pool.catalog.mesh(0), self.pool.catalog.mesh_family(0));
            Picked::Mesh { shape, family, number: 0 }
        }))
    }

    /// A mesh of one of the groups that `suits` accepts.
    pub fn mesh(&self, rng: &mut Pcg64, suits: &impl Fn(&str) -> bool) -> Option<Picked> {
        let families: Vec<&'static str> =
            self.meshes.iter().filter(|(_, group)| suits(group)).map(|(family, _)| *family).collect();
        let family = *families.get(rng.below(families.len().max(1) as u32) as usize)?;
        let number = self.pool.catalog.draw_mesh(family, rng)?;
        Some(Picked::Mesh { shape: self.pool.catalog.mesh(number), family, number })
    }

    /// An environment, of those that suit the layout where the pool has any.
    pub fn light(&self, rng: &mut Pcg64, layout: LayoutKind) -> Light {
        let (files, maps) = (self.pool.hdris, self.pool.builtin);
        let one = |rng: &mut Pcg64, list: &[String]| list[rng.below(list.len() as u32) as usize].clone();
        let others = !self.environments.is_empty() || !maps.is_empty();
        if !files.is_empty() && (!others || rng.chance(self.knobs.user_hdris)) {
            let path = one(rng, files);
            return Light { name: format!("file:{path}"), source: EnvironmentSource::File(path), number: None };
        }
        if !maps.is_empty() && (self.environments.is_empty() || rng.chance(self.knobs.builtin_maps)) {
            let name = one(rng, maps);
            return Light { name: format!("builtin:{name}"), source: EnvironmentSource::Builtin(name), number: None };
        }
        let skies: Vec<_> = self.environments.iter().copied().filter(|f| suits(f, layout)).collect();
        let families = if skies.is_empty() { &self.environments } else { &skies };
        let family = families[rng.below(families.len() as u32) as usize];
        let number = self.pool.catalog.draw_environment(family, rng).unwrap_or(0);
        Light { source: EnvironmentSource::Sky(self.pool.catalog.environment(number)), name: family.into(), number: Some(number) }
    }
}

/// Whether a layout may stand in an environment of this family: open country under a sky, rooms in what is no room itself.
fn suits(family: &str, layout: LayoutKind) -> bool {
    match layout {
        LayoutKind::Outdoor => matches!(sky::group(family), "outdoor_sun" | "outdoor_soft" | "sunset" | "night"),
        LayoutKind::Room => sky::group(family) != "interior",
        LayoutKind::Ground => true,
    }
}

/// The room that a model file takes up, read once a process.
fn extent_of(path: &str, allowed: &[PathBuf]) -> Result<Extent> {
    static KNOWN: Mutex<Option<HashMap<String, Extent>>> = Mutex::new(None);
    let known = || KNOWN.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    if let Some(found) = known().get_or_insert_default().get(path) {
        return Ok(*found);
    }
    // Read with the lock open: reading may run on several threads, and one of them may come here.
    let file = Path::new(path);
    let read = extent(file, &Reach::of(file).allow(allowed))?;
    known().get_or_insert_default().insert(path.into(), read);
    Ok(read)
}
