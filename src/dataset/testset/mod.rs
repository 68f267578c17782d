//! Test sets: fixed plans, so that everybody reports numbers on the same pictures.
//!
//! A set is a folder of datasets, one for each class of scenes: `<set>/<class>/{plan.json, test/seq-000000/...}`. The plans of
//! `synthetic` draw from families that no other plan trains on. The plans of `assets` are filled with the user's own models and
//! maps.

mod audit;
mod make;

pub use audit::{Audit, decibel, display_variance};
pub use make::{Extent, SET, SetFile, audits, check, make, make_plans};

use crate::dataset::plan::{Allowed, Plan, UserFile};
use crate::dataset::planning;
use anyhow::{Context, Result, ensure};
use std::path::PathBuf;

/// A test set of the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum TestSet {
    /// Held-out mesh families, environments and seeds: 24 sequences of 50 frames at 256 x 256, 3 of 20 at 512 x 512
    Synthetic,
    /// The user's models and environment maps: 10 sequences of 50 frames at 256 x 256
    Assets,
}

/// A class of scenes of a test set: name of its folder, plan, BLAKE3 of its composed scenes in order.
struct Class {
    name: &'static str,
    plan: &'static str,
    /// Absent where the scenes depend on the user's files.
    scenes: Option<&'static str>,
}

macro_rules! class {
    ($set:literal, $name:literal, $scenes:expr) => {
        Class { name: $name, plan: include_str!(concat!("plans/", $set, "/", $name, ".json")), scenes: $scenes }
    };
}

const SYNTHETIC: [Class; 7] = [
    class!("synthetic", "open", Some("6a9a76bf0738793c6561ec531e5dbeaaeea5c037871bcff390eda2a387ac0fa8")),
    class!("synthetic", "interior", Some("d665f89851a95d90ddfdfc93581f8dab42b98d73a6ccae47fa9b09cce6bde21a")),
    class!("synthetic", "glossy", Some("9d6a72343a8c003da26a96cd3b96d54b272a1511b387b16eef528cc09f75c419")),
    class!("synthetic", "foliage", Some("c28bb189d28e3b1a2d02f1ea24b8299e65ee8c4a13652d63f732a3f53b49eae8")),
    class!("synthetic", "dense", Some("4db6666fa38c9c19738f2db7457513a7ce8b1c17e5ae402b0933eae1b1b68537")),
    class!("synthetic", "large", Some("518fbd8660ece414d26148b1538158eed444b095132aa7345e93eb8b7c1d8e92")),
    class!("synthetic", "glass", Some("69e1ac5a4e30325ab03cda47c2d7614439c5460e45e9e4036a66e8936c59e3ef")),
];
const ASSETS: [Class; 2] = [class!("assets", "open", None), class!("assets", "interior", None)];

/// The files that [`TestSet::Assets`] is made from.
#[derive(Clone, Debug, Default)]
pub struct Sources {
    /// Model files, or folders of them.
    pub models: Vec<PathBuf>,
    /// Environment maps, or folders of them.
    pub hdris: Vec<PathBuf>,
    /// More folders in which models may name files.
    pub allowed: Vec<PathBuf>,
}

impl TestSet {
    /// Name of its folder.
    pub fn name(self) -> &'static str {
        match self {
            Self::Synthetic => "synthetic",
            Self::Assets => "assets",
        }
    }

    fn classes(self) -> &'static [Class] {
        match self {
            Self::Synthetic => &SYNTHETIC,
            Self::Assets => &ASSETS,
        }
    }

    /// Folder name and plan of every class.
    ///
    /// # Errors
    /// When the set needs files and there are none, when it needs none and there are, or when one cannot be read.
    pub fn plans(self, sources: &Sources) -> Result<Vec<(&'static str, Plan)>> {
        let (models, hdris) = match self {
            Self::Synthetic => {
                ensure!(sources.models.is_empty() && sources.hdris.is_empty(), "the synthetic set is made without files");
                (Vec::new(), Vec::new())
            }
            Self::Assets => {
                let files = |paths: &[PathBuf], what: &str, endings: &[&str]| -> Result<Vec<UserFile>> {
                    let files = planning::files_in(paths, endings)?;
                    ensure!(!files.is_empty(), "the assets set needs {what} ({})", endings.join(", "));
                    Ok(files)
                };
                (
                    files(&sources.models, "models: --models FILE_OR_FOLDER", &planning::MODELS)?,
                    files(&sources.hdris, "environment maps: --hdris FILE_OR_FOLDER", &planning::MAPS)?,
                )
            }
        };
        let fill = |class: &Class| -> Result<(&'static str, Plan)> {
            let mut plan: Plan = serde_json::from_str(class.plan).with_context(|| format!("plan of {}", class.name))?;
            if self == Self::Assets {
                plan.splits.test.models = models.clone();
                plan.splits.test.hdris = hdris.clone();
            }
            plan.allowed = Allowed(sources.allowed.clone());
            plan.check().with_context(|| format!("plan of {}", class.name))?;
            Ok((class.name, plan))
        };
        self.classes().iter().map(fill).collect()
    }
}

/// BLAKE3 of the scenes of a plan, in order.
fn scenes_hash(plan: &Plan) -> Result<String> {
    let catalog = plan.catalog();
    let mut hasher = blake3::Hasher::new();
    for index in 0..plan.total() {
        hasher.update(&serde_json::to_vec(&plan.compose(&catalog, index)?.scene)?);
    }
    Ok(hasher.finalize().to_hex().to_string())
}

/// Checks that this program composes the scenes of the published set.
fn check_scenes(set: TestSet, plans: &[(&str, Plan)]) -> Result<()> {
    let mut others = Vec::new();
    for ((name, plan), class) in plans.iter().zip(set.classes()) {
        if let Some(expected) = class.scenes {
            let found = scenes_hash(plan)?;
            if found != expected {
                others.push(format!("{name} ({found}, not {expected})"));
            }
        }
    }
    ensure!(others.is_empty(), "this build composes other scenes than those of the published set: {}", others.join(", "));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::plan::{SPLITS, Splits};
    use crate::util::cancel::Cancel;

    #[test]
    fn the_scenes_are_those_of_the_published_set() {
        let plans = TestSet::Synthetic.plans(&Sources::default()).unwrap();
        check_scenes(TestSet::Synthetic, &plans).unwrap();
        let sequences = |size| plans.iter().filter(|(_, p)| p.resolution == [size; 2]).map(|(_, p)| p.total()).sum::<u32>();
        assert_eq!((sequences(256), sequences(512)), (24, 3));
        assert!(plans.iter().all(|(_, p)| p.frames == if p.resolution == [512; 2] { 20 } else { 50 }));
    }

    #[test]
    fn no_plan_learns_from_families_of_the_set() {
        let sets = TestSet::Synthetic.plans(&Sources::default()).unwrap();
        for seed in [1, 77] {
            let (_, mut plan) = sets[0].clone();
            (plan.seed, plan.splits) = (seed, Splits::default());
            let splits = planning::splits(&plan, None, None, &Cancel::default()).unwrap();
            for split in &SPLITS[..2] {
                let learnt = splits.of(*split);
                assert!(!learnt.mesh_families.is_empty());
                for (name, set) in &sets {
                    let held = &set.splits.test;
                    assert!(!held.mesh_families.iter().any(|family| learnt.mesh_families.contains(family)), "{name}");
                    let shared = |family: &String| learnt.environment_families.contains(family);
                    assert!(!held.environment_families.iter().any(shared), "{name}");
                }
            }
        }
    }

    #[test]
    fn the_assets_set_needs_files_and_the_other_none() {
        assert!(TestSet::Assets.plans(&Sources::default()).unwrap_err().to_string().contains("--models"));
        let sources = Sources { models: vec!["a.obj".into()], ..Sources::default() };
        assert!(TestSet::Synthetic.plans(&sources).is_err());
    }
}
