//! Writes scripts that render a plan on a cluster: a Slurm array with one sequence for each task, retries of tasks that fail, and
//! a merge at the end.
//!
//! The templates are in `src/dataset/slurm/`; `docs/scale-out.md` explains the scripts.

use crate::dataset::Plan;
use crate::util::output;
use anyhow::{Context, Result, bail, ensure};
use renderflow_frame::words::shell;
use std::path::{Path, PathBuf};

const ARRAY: &str = include_str!("slurm/array.sh");
/// Runs a program under Slurm: it passes signals on and waits.
pub(crate) const WAIT: &str = include_str!("slurm/wait.sh");
const MERGE: &str = include_str!("slurm/merge.sh");
const SUBMIT: &str = include_str!("slurm/submit.sh");
const KUBERNETES: &str = include_str!("slurm/kubernetes.yaml");

/// An indexed Kubernetes job with a limit of failures for each index has at most this many completions.
const KUBERNETES_COMPLETIONS: u32 = 100_000;

/// What the scripts request from the cluster.
#[derive(Clone, Debug)]
pub struct Request {
    /// The program; every node must find it there.
    pub program: PathBuf,
    /// Plan file.
    pub plan: PathBuf,
    /// Dataset folder.
    pub out: PathBuf,
    /// Folders in which models may name files (`--allow-files`).
    pub allowed: Vec<PathBuf>,
    /// Folder for the scripts; logs go to `logs` in it.
    pub folder: PathBuf,
    /// Slurm partition; the cluster's default unless given.
    pub partition: Option<String>,
    /// Slurm account.
    pub account: Option<String>,
    /// Time limit of a task in Slurm's form, such as `hours:minutes:seconds`.
    pub time: String,
    /// Processor cores of a task.
    pub cpus: u32,
    /// Memory of a task.
    pub memory: Memory,
    /// Tasks that may run at the same time, over all arrays; `None` = any number.
    pub tasks_at_once: Option<u32>,
    /// How often a task that failed or was interrupted starts again.
    pub retries: u32,
    /// Seconds from SIGTERM to the end of the time limit; a frame should take less.
    pub grace: u32,
    /// More options of `sbatch`, with or without `#SBATCH` before them.
    pub extra: Vec<String>,
}

/// An amount of memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Memory {
    /// MiB; Slurm calls them MB.
    pub megabytes: u64,
}

impl std::str::FromStr for Memory {
    type Err = String;

    /// In Slurm's form: `8G`, `500M`, `2T`; a number alone is in MiB.
    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let (digits, scale) = match text.strip_suffix(['M', 'm']) {
            Some(digits) => (digits, 1),
            None => match (text.strip_suffix(['G', 'g']), text.strip_suffix(['T', 't'])) {
                (Some(digits), _) => (digits, 1 << 10),
                (_, Some(digits)) => (digits, 1 << 20),
                _ => (text, 1),
            },
        };
        let megabytes = digits.parse::<u64>().ok().and_then(|n| n.checked_mul(scale));
        match megabytes {
            // One PiB: shells can double it without overflow, and no node has it.
            Some(megabytes @ 1..=1_073_741_824) => Ok(Self { megabytes }),
            _ => Err(format!("{text:?}: write memory as 8G or 500M, 1M to 1024T")),
        }
    }
}

impl Request {
    /// Writes `array.sh`, `merge.sh`, `submit.sh` and `kubernetes.yaml`. Returns the number of tasks.
    ///
    /// # Errors
    /// When the plan cannot be read, when a path is not UTF-8, when an option would end its line or its word in a script, and
    /// when other files with these names are there, unless `overwrite`.
    pub fn write(&self, overwrite: bool) -> Result<u32> {
        let tasks = Plan::read(&self.plan)?.total();
        // Slurm replaces %A and similar codes anywhere in the name of a log. %% is a percent sign, and a backslash turns the
        // codes off.
        let logs = full(&self.folder.join("logs"))?;
        ensure!(!logs.contains('\\'), "{logs}: Slurm's logs cannot be in a folder with a backslash");
        let allowed = self.allowed.iter().map(|folder| Ok(format!(" --allow-files {}", shell(&full(folder)?))));
        let completions = tasks.min(KUBERNETES_COMPLETIONS);
        let values = [
            ("PROGRAM", shell(&full(&self.program)?)),
            ("PLAN", shell(&full(&self.plan)?)),
            ("OUT", shell(&full(&self.out)?)),
            ("ALLOWED", allowed.collect::<Result<String>>()?),
            ("FOLDER", shell(&full(&self.folder)?)),
            ("LOGS", shell(&logs.replace('%', "%%"))),
            ("WAIT", WAIT.trim_end().to_owned()),
            ("DIRECTIVES", directives(self.partition.as_deref(), self.account.as_deref(), &self.extra)?),
            ("TIME", word("--time", &self.time)?.into()),
            ("CPUS", self.cpus.to_string()),
            ("MEGABYTES", self.memory.megabytes.to_string()),
            ("AT_ONCE", self.tasks_at_once.unwrap_or(0).to_string()),
            ("RETRIES", self.retries.to_string()),
            ("GRACE", self.grace.to_string()),
            ("SHARDS", tasks.to_string()),
            ("COMPLETIONS", completions.to_string()),
            ("PARALLELISM", self.tasks_at_once.unwrap_or(completions).min(completions).to_string()),
        ];
        let scripts = [("array.sh", ARRAY), ("merge.sh", MERGE), ("submit.sh", SUBMIT), ("kubernetes.yaml", KUBERNETES)];
        let file = |(name, template)| Ok((self.folder.join(name), fill(template, &values)?.into_bytes()));
        let files = scripts.into_iter().map(file).collect::<Result<Vec<_>>>()?;
        output::write(&files, overwrite)?;
        for (path, _) in files.iter().filter(|(path, _)| path.extension().is_some_and(|e| e == "sh")) {
            set_mode(path, 0o755).with_context(|| format!("{}: cannot be made executable", path.display()))?;
        }
        Ok(tasks)
    }
}

/// Lines for `sbatch` that only some clusters need.
pub(crate) fn directives(partition: Option<&str>, account: Option<&str>, extras: &[String]) -> Result<String> {
    let mut lines = vec!["#SBATCH --job-name=renderflow".to_owned()];
    for (option, value) in [("--partition", partition), ("--account", account)] {
        if let Some(value) = value {
            lines.push(format!("#SBATCH {option}={}", word(option, value)?));
        }
    }
    for extra in extras {
        let option = extra.strip_prefix("#SBATCH").unwrap_or(extra).trim();
        let plain = option.starts_with('-') && !option.chars().any(char::is_control);
        ensure!(plain, "--extra {extra:?}: not one option of sbatch, such as --qos=long");
        lines.push(format!("#SBATCH {option}"));
    }
    Ok(lines.join("\n"))
}

/// `value`, if it can stand in a line for `sbatch` as it is.
pub(crate) fn word<'a>(option: &str, value: &'a str) -> Result<&'a str> {
    let plain = |c: char| c.is_ascii_alphanumeric() || "_-.,:+@/".contains(c);
    ensure!(!value.is_empty() && value.chars().all(plain), "{option} {value:?}: not a word");
    Ok(value)
}

/// `path` from the root.
pub(crate) fn full(path: &Path) -> Result<String> {
    let full = std::path::absolute(path).with_context(|| format!("{}: has no full name", path.display()))?;
    let text = full.to_str().with_context(|| format!("{}: is not UTF-8", full.display()))?;
    ensure!(!text.contains('\0'), "{}: has a zero byte", full.display());
    Ok(text.to_owned())
}

/// `template` with every `@NAME@` replaced by its value; names are in capitals. Values are not searched.
pub(crate) fn fill(template: &str, values: &[(&str, String)]) -> Result<String> {
    let mut filled = String::with_capacity(2 * template.len());
    let mut rest = template;
    while let Some((before, after)) = rest.split_once('@') {
        filled.push_str(before);
        match after.split_once('@') {
            Some((name, behind)) if !name.is_empty() && name.bytes().all(|b| b.is_ascii_uppercase() || b == b'_') => {
                let Some((_, value)) = values.iter().find(|(known, _)| *known == name) else { bail!("@{name}@: has no value") };
                filled.push_str(value);
                rest = behind;
            }
            _ => {
                filled.push('@');
                rest = after;
            }
        }
    }
    filled.push_str(rest);
    Ok(filled)
}

#[cfg(unix)]
pub(crate) fn set_mode(path: &Path, mode: u32) -> std::io::Result<()> {
    use std::os::unix::fs::PermissionsExt;
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode))
}

#[cfg(not(unix))]
pub(crate) fn set_mode(_path: &Path, _mode: u32) -> std::io::Result<()> {
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_as_slurm_writes_it() {
        for (text, megabytes) in [("8G", 8192), ("500M", 500), ("700", 700), ("2t", 2 << 20), ("1024T", 1 << 30)] {
            assert_eq!(text.parse(), Ok(Memory { megabytes }), "{text}");
        }
        for bad in ["", "G", "0", "0G", "1.5G", "-1", "8GB", "8 G", "1025T", "99999999999999999999G"] {
            assert!(bad.parse::<Memory>().is_err(), "{bad}");
        }
    }

    #[test]
    fn values_are_not_searched_for_names() {
        let values = [("A", "@B@".to_owned()), ("B", "b".to_owned())];
        assert_eq!(fill("TERM@@A@ @B@ a@b @ @", &values).unwrap(), "TERM@@B@ b a@b @ @");
        assert!(fill("@C@", &values).is_err());
    }

    #[test]
    fn options_stay_in_their_line() {
        let lines = |extra: &str, partition: &str| directives(Some(partition), None, &[extra.into()]);
        let found = lines("#SBATCH --qos=long", "gpu,big").unwrap();
        assert_eq!(found, "#SBATCH --job-name=renderflow\n#SBATCH --partition=gpu,big\n#SBATCH --qos=long");
        for (extra, partition) in [("--qos=a\nrm -r x", "p"), ("rm", "p"), ("", "p"), ("--qos=a", "p q"), ("--qos=a", "")] {
            assert!(lines(extra, partition).is_err(), "{extra:?} {partition:?}");
        }
    }
}
