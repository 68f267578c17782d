//! The parts of a dataset, and which families of meshes and environments each may draw from.

use crate::catalog::Catalog;
use crate::seed::Seed;
use crate::sky;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, HashSet};

/// Which part of a dataset a scene belongs to. The splits share no family of meshes and none of environments.
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Split {
    /// What networks learn from.
    #[default]
    Train,
    /// For choosing settings.
    Val,
    /// For the numbers that are reported.
    Test,
}

impl Split {
    /// All splits, in the order in which a plan numbers its sequences.
    pub const ALL: [Self; 3] = [Self::Train, Self::Val, Self::Test];

    /// `train`, `val` or `test`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::Val => "val",
            Self::Test => "test",
        }
    }
}

impl std::fmt::Display for Split {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(self.name())
    }
}

/// Of this many members of a group, one goes to the test split and one to the validation split.
const HELD_OUT: usize = 6;
/// Families are dealt by this seed, whatever the plan's: what one plan holds out no other learns from, so that a network trained
/// on any of them may be judged on the program's own test sets. This one holds out grass, gyroids and a low sun: hard cases.
const FAMILIES: u64 = 2059;
/// Members of a catalogue that holds every family.
const WHOLE: u32 = 256;

/// Families that a split may draw from, sorted by name.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Families {
    /// Of meshes.
    pub meshes: Vec<String>,
    /// Of environments.
    pub environments: Vec<String>,
}

/// The families of a catalogue that `split` may draw from. From every group of families (vessels, furniture, low suns, studios,
/// ...) about one in six goes to the test split and to the validation split, so that what is held out is as varied as what is
/// learnt from. All catalogues are dealt alike.
pub fn families(catalog: &Catalog, split: Split) -> Families {
    let whole = Catalog::new(0, WHOLE, WHOLE);
    let sorted = |mut names: Vec<String>| {
        names.sort();
        names
    };
    Families {
        meshes: sorted(deal_families(mesh_families(&whole), mesh_families(catalog), split)),
        environments: sorted(deal_families(environment_families(&whole), environment_families(catalog), split)),
    }
}

/// What `split` gets of the families that are `there`, dealt as `all` of them are dealt. A catalogue too small to give every
/// split one that way deals its own few among the splits: those may be others than the test sets'.
fn deal_families(all: Vec<(&'static str, String)>, there: Vec<(&'static str, String)>, split: Split) -> Vec<String> {
    let lists = |members: Vec<(&'static str, String)>| {
        let mut lists = Split::ALL.map(|_| vec![]);
        deal(&Seed::root(FAMILIES), groups(members), |split, name| lists[split as usize].push(name));
        lists
    };
    let names: HashSet<&String> = there.iter().map(|(_, name)| name).collect();
    let dealt = lists(all).map(|list| list.into_iter().filter(|name| names.contains(name)).collect::<Vec<_>>());
    let mut dealt = if dealt.iter().any(Vec::is_empty) { lists(there) } else { dealt };
    std::mem::take(&mut dealt[split as usize])
}

/// (group, family) of every mesh family of a catalogue.
fn mesh_families(catalog: &Catalog) -> Vec<(&'static str, String)> {
    (0..catalog.meshes().min(WHOLE)).map(|k| (catalog.mesh(k).group(), catalog.mesh_family(k).to_owned())).collect()
}

/// (group, family) of every environment family of a catalogue.
fn environment_families(catalog: &Catalog) -> Vec<(&'static str, String)> {
    let families = (0..catalog.environments().min(WHOLE)).map(|k| catalog.environment_family(k));
    families.map(|family| (sky::group(family), family.to_owned())).collect()
}

fn groups(members: Vec<(&'static str, String)>) -> BTreeMap<&'static str, Vec<String>> {
    let mut groups: BTreeMap<&'static str, Vec<String>> = BTreeMap::new();
    for (group, family) in members {
        let members = groups.entry(group).or_default();
        if !members.contains(&family) {
            members.push(family);
        }
    }
    groups
}

/// Deals the members of each group among the splits, in an order drawn from `seed`: most to training.
pub fn deal(seed: &Seed, groups: BTreeMap<&'static str, Vec<String>>, mut give: impl FnMut(Split, String)) {
    // Small groups have none to spare: over several of them the count goes on, so that one in six is held out all the same.
    let mut dealt = 0;
    for (_, mut members) in groups {
        members.sort_by_key(|name| seed.child("split", 0).child(name, 0).u64());
        for name in members {
            let split = match dealt % HELD_OUT {
                2 => Split::Test,
                4 => Split::Val,
                _ => Split::Train,
            };
            give(split, name);
            dealt += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_member_is_dealt_once_and_one_in_six_is_held_out() {
        let group = |name, n: usize| (name, (0..n).map(|i| format!("{name}{i}")).collect::<Vec<_>>());
        let groups = BTreeMap::from([group("a", 5), group("b", 1), group("c", 12), group("d", 6)]);
        let mut splits = [vec![], vec![], vec![]];
        deal(&Seed::root(1), groups, |split, name| splits[split as usize].push(name));
        assert_eq!(splits.each_ref().map(Vec::len), [16, 4, 4]);
        let mut all = splits.concat();
        all.sort();
        all.dedup();
        assert_eq!(all.len(), 24);
    }
}
