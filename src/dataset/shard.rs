//! The part of a plan that this process makes, as an option or the batch system says.

use anyhow::{Context, Result, bail, ensure};
use std::fmt;

/// Number of shards of the whole plan, set by whoever starts the tasks.
pub const SHARDS: &str = "RENDERFLOW_SHARDS";
/// Added to the task number: batch systems limit the length of an array, so a plan may need several arrays.
pub const SHARD_OFFSET: &str = "RENDERFLOW_SHARD_OFFSET";
const SLURM_TASK: &str = "SLURM_ARRAY_TASK_ID";
const KUBERNETES_INDEX: &str = "JOB_COMPLETION_INDEX";

/// Part `index` of `count`, both counted from 1: sequences whose number is `index - 1` modulo `count`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    /// From 1.
    pub index: u32,
    /// At least 1.
    pub count: u32,
}

/// A shard, and where it came from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Assigned {
    /// The part to make.
    pub shard: Shard,
    /// The option or the variables that named it.
    pub source: String,
}

impl Shard {
    /// Everything.
    pub const WHOLE: Self = Self { index: 1, count: 1 };

    /// Whether this shard makes sequence `sequence`.
    pub fn owns(self, sequence: u32) -> bool {
        sequence % self.count == self.index - 1
    }

    /// `flag` if it is given; otherwise the shard in the environment of this process, see [`Shard::from_variables`].
    pub fn choose(flag: Option<Self>) -> Result<Assigned> {
        match flag {
            Some(shard) => Ok(Assigned { shard, source: "--shard".into() }),
            None => Self::from_environment(),
        }
    }

    /// The shard in the environment of this process; see [`Shard::from_variables`].
    pub fn from_environment() -> Result<Assigned> {
        Self::from_variables(|name| std::env::var_os(name).map(|value| value.to_string_lossy().into_owned()))
    }

    /// The shard that variables name, `lookup` giving the value of each.
    ///
    /// - Slurm: shard `RENDERFLOW_SHARD_OFFSET` (0 unless set) + `SLURM_ARRAY_TASK_ID` of `RENDERFLOW_SHARDS`. Where the latter
    ///   is not set, the array is taken for the whole plan: its first task is shard 1 of `SLURM_ARRAY_TASK_COUNT`.
    /// - Kubernetes: shard `RENDERFLOW_SHARD_OFFSET` + `JOB_COMPLETION_INDEX` + 1 of `RENDERFLOW_SHARDS`.
    /// - Neither: 1/1.
    ///
    /// # Errors
    /// Values that are no numbers, a shard beyond the count, an array with holes and no count, both engines at once, and a count
    /// without an engine: each would leave sequences out or make every task render all of them.
    pub fn from_variables(lookup: impl Fn(&str) -> Option<String>) -> Result<Assigned> {
        let number = |name: &str| -> Result<Option<u32>> {
            let Some(value) = lookup(name) else { return Ok(None) };
            let parsed = value.trim().parse().with_context(|| format!("{name}={value:?}: not a whole number"))?;
            Ok(Some(parsed))
        };
        let (shards, offset) = (number(SHARDS)?, number(SHARD_OFFSET)?);
        match (number(SLURM_TASK)?, number(KUBERNETES_INDEX)?) {
            (Some(_), Some(_)) => bail!("{SLURM_TASK} and {KUBERNETES_INDEX} are both set; say which with --shard"),
            (Some(task), None) => {
                let Some(count) = shards else {
                    ensure!(offset.is_none(), "{SHARD_OFFSET} is set but {SHARDS} is not");
                    return whole_array(task, &number);
                };
                Self::at(task, offset, count, &format!("Slurm: {SLURM_TASK}={task}"))
            }
            (None, Some(index)) => {
                let count = shards
                    .with_context(|| format!("{KUBERNETES_INDEX} is set but {SHARDS} is not; set it to the number of shards"))?;
                let source = format!("Kubernetes: {KUBERNETES_INDEX}={index}");
                Self::at(index.checked_add(1).with_context(|| source.clone())?, offset, count, &source)
            }
            (None, None) => {
                if let Some(name) = [(SHARDS, shards), (SHARD_OFFSET, offset)].iter().find_map(|&(name, v)| v.map(|_| name)) {
                    bail!("{name} is set, but neither {SLURM_TASK} nor {KUBERNETES_INDEX}: say which shard with --shard");
                }
                Ok(Assigned { shard: Self::WHOLE, source: "the default".into() })
            }
        }
    }

    /// Shard `offset + task` of `count`, `task` counted from 1.
    fn at(task: u32, offset: Option<u32>, count: u32, source: &str) -> Result<Assigned> {
        let index = offset.unwrap_or(0).checked_add(task);
        let source = match offset {
            Some(offset) => format!("{source}, {SHARD_OFFSET}={offset}, {SHARDS}={count}"),
            None => format!("{source}, {SHARDS}={count}"),
        };
        match index {
            Some(index @ 1..) if index <= count => Ok(Assigned { shard: Self { index, count }, source }),
            _ => bail!("{source}: shards run from 1 to {count}"),
        }
    }
}

/// The shard of a task whose array is the whole plan. Such an array may start anywhere and have a step, but no holes.
fn whole_array(task: u32, number: &dyn Fn(&str) -> Result<Option<u32>>) -> Result<Assigned> {
    let needed = |name: &str| number(name)?.with_context(|| format!("{SLURM_TASK} is set but {SHARDS} and {name} are not"));
    let (count, min) = (needed("SLURM_ARRAY_TASK_COUNT")?, needed("SLURM_ARRAY_TASK_MIN")?);
    let step = number("SLURM_ARRAY_TASK_STEP")?.unwrap_or(1);
    let max = number("SLURM_ARRAY_TASK_MAX")?;
    let source = format!("Slurm: {SLURM_TASK}={task} of {count} tasks from {min}");
    let position = |task: u32| {
        let above = task.checked_sub(min)?;
        (above.checked_rem(step)? == 0).then_some(above / step)
    };
    match position(task) {
        Some(at) if at < count && max.is_none_or(|max| position(max) == Some(count - 1)) => {
            Ok(Assigned { shard: Shard { index: at + 1, count }, source })
        }
        _ => bail!("{source}: the array has holes, so that tasks do not number shards; set {SHARDS}"),
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.index, self.count)
    }
}

impl fmt::Display for Assigned {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "shard {} ({})", self.shard, self.source)
    }
}

impl std::str::FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let (index, count) = text.split_once('/').ok_or("write i/n, for example 1/4")?;
        let number = |s: &str| s.parse::<u32>().map_err(|e| format!("{s:?}: {e}"));
        let shard = Self { index: number(index)?, count: number(count)? };
        if shard.index == 0 || shard.index > shard.count {
            return Err(format!("shard {text}: i runs from 1 to n"));
        }
        Ok(shard)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_sequence_has_exactly_one_shard() {
        for count in 1..=7 {
            for sequence in 0..50 {
                assert_eq!((1..=count).filter(|&index| Shard { index, count }.owns(sequence)).count(), 1);
            }
        }
    }

    #[test]
    fn shard_syntax() {
        assert_eq!("3/7".parse(), Ok(Shard { index: 3, count: 7 }));
        for bad in ["0/7", "8/7", "7", "a/b", "1/0", ""] {
            assert!(bad.parse::<Shard>().is_err(), "{bad}");
        }
    }

    /// `text` is `NAME=value NAME=value ..`.
    fn assigned(text: &str) -> Result<Assigned> {
        Shard::from_variables(|name| {
            text.split(' ').filter_map(|pair| pair.split_once('=')).find(|pair| pair.0 == name).map(|pair| pair.1.to_owned())
        })
    }

    #[test]
    fn engines_number_shards() {
        for (variables, shard) in [
            ("", "1/1"),
            ("SLURM_JOB_ID=7", "1/1"),
            ("RENDERFLOW_SHARDS=1300 SLURM_ARRAY_TASK_ID=1", "1/1300"),
            ("RENDERFLOW_SHARDS=1300 RENDERFLOW_SHARD_OFFSET=0 SLURM_ARRAY_TASK_ID=1000", "1000/1300"),
            ("RENDERFLOW_SHARDS=1300 RENDERFLOW_SHARD_OFFSET=1000 SLURM_ARRAY_TASK_ID=300", "1300/1300"),
            // Resubmitting one task must not make it the whole plan.
            ("RENDERFLOW_SHARDS=9 SLURM_ARRAY_TASK_ID=4 SLURM_ARRAY_TASK_COUNT=1 SLURM_ARRAY_TASK_MIN=4", "4/9"),
            ("SLURM_ARRAY_TASK_ID=0 SLURM_ARRAY_TASK_COUNT=4 SLURM_ARRAY_TASK_MIN=0 SLURM_ARRAY_TASK_MAX=3", "1/4"),
            ("SLURM_ARRAY_TASK_ID=14 SLURM_ARRAY_TASK_COUNT=3 SLURM_ARRAY_TASK_MIN=10 SLURM_ARRAY_TASK_STEP=2", "3/3"),
            ("JOB_COMPLETION_INDEX=0 RENDERFLOW_SHARDS=5", "1/5"),
            ("JOB_COMPLETION_INDEX=4 RENDERFLOW_SHARDS=5", "5/5"),
            ("JOB_COMPLETION_INDEX=4 RENDERFLOW_SHARDS=15 RENDERFLOW_SHARD_OFFSET=10", "15/15"),
        ] {
            let assigned = assigned(variables).unwrap_or_else(|e| panic!("{variables}: {e:#}"));
            assert_eq!(assigned.shard.to_string(), shard, "{variables}");
        }
        let said = assigned("RENDERFLOW_SHARDS=1300 RENDERFLOW_SHARD_OFFSET=1000 SLURM_ARRAY_TASK_ID=300").unwrap().to_string();
        assert_eq!(
            said,
            "shard 1300/1300 (Slurm: SLURM_ARRAY_TASK_ID=300, RENDERFLOW_SHARD_OFFSET=1000, RENDERFLOW_SHARDS=1300)"
        );
    }

    #[test]
    fn a_flag_needs_no_variables() {
        let shard = Shard { index: 2, count: 3 };
        assert_eq!(Shard::choose(Some(shard)).unwrap().to_string(), "shard 2/3 (--shard)");
    }

    #[test]
    fn contradictions_are_errors() {
        for (variables, message) in [
            ("RENDERFLOW_SHARDS=5", "neither SLURM_ARRAY_TASK_ID nor JOB_COMPLETION_INDEX"),
            ("RENDERFLOW_SHARD_OFFSET=5", "neither SLURM_ARRAY_TASK_ID nor JOB_COMPLETION_INDEX"),
            ("RENDERFLOW_SHARDS=5 SLURM_ARRAY_TASK_ID=1 JOB_COMPLETION_INDEX=0", "both set"),
            ("RENDERFLOW_SHARDS=5 SLURM_ARRAY_TASK_ID=6", "shards run from 1 to 5"),
            ("RENDERFLOW_SHARDS=5 SLURM_ARRAY_TASK_ID=0", "shards run from 1 to 5"),
            ("RENDERFLOW_SHARDS=0 SLURM_ARRAY_TASK_ID=0", "shards run from 1 to 0"),
            ("RENDERFLOW_SHARDS=5 RENDERFLOW_SHARD_OFFSET=4294967295 SLURM_ARRAY_TASK_ID=1", "shards run from 1 to 5"),
            ("RENDERFLOW_SHARDS=five SLURM_ARRAY_TASK_ID=1", "RENDERFLOW_SHARDS=\"five\": not a whole number"),
            ("RENDERFLOW_SHARDS= SLURM_ARRAY_TASK_ID=1", "RENDERFLOW_SHARDS=\"\": not a whole number"),
            ("RENDERFLOW_SHARDS=5 SLURM_ARRAY_TASK_ID=-1", "SLURM_ARRAY_TASK_ID=\"-1\": not a whole number"),
            ("SLURM_ARRAY_TASK_ID=1 RENDERFLOW_SHARD_OFFSET=1", "RENDERFLOW_SHARDS is not"),
            ("SLURM_ARRAY_TASK_ID=1", "SLURM_ARRAY_TASK_COUNT"),
            ("SLURM_ARRAY_TASK_ID=3 SLURM_ARRAY_TASK_COUNT=3 SLURM_ARRAY_TASK_MIN=1 SLURM_ARRAY_TASK_MAX=7", "has holes"),
            ("SLURM_ARRAY_TASK_ID=7 SLURM_ARRAY_TASK_COUNT=3 SLURM_ARRAY_TASK_MIN=1", "has holes"),
            ("SLURM_ARRAY_TASK_ID=1 SLURM_ARRAY_TASK_COUNT=3 SLURM_ARRAY_TASK_MIN=2", "has holes"),
            ("SLURM_ARRAY_TASK_ID=1 SLURM_ARRAY_TASK_COUNT=0 SLURM_ARRAY_TASK_MIN=1 SLURM_ARRAY_TASK_MAX=1", "has holes"),
            ("SLURM_ARRAY_TASK_ID=1 SLURM_ARRAY_TASK_COUNT=1 SLURM_ARRAY_TASK_MIN=1 SLURM_ARRAY_TASK_STEP=0", "has holes"),
            ("JOB_COMPLETION_INDEX=0", "RENDERFLOW_SHARDS is not"),
            ("JOB_COMPLETION_INDEX=5 RENDERFLOW_SHARDS=5", "shards run from 1 to 5"),
            ("JOB_COMPLETION_INDEX=4294967295 RENDERFLOW_SHARDS=5", "JOB_COMPLETION_INDEX=4294967295"),
        ] {
            let error = format!("{:#}", assigned(variables).expect_err(variables));
            assert!(error.contains(message), "{variables}: {error}");
        }
    }
}
