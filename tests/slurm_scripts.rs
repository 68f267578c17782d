//! The scripts of `dataset slurm` and `train slurm`, run with stand-ins for Slurm's commands and for the program. The real Slurm:
//! tests/slurm/run.sh.
#![cfg(unix)]

mod common;

use common::{renderflow, stderr, succeed};
use std::io::{BufRead, BufReader};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// A folder whose name means something to shells, to Slurm and to YAML.
struct Site {
    _root: tempfile::TempDir,
    folder: PathBuf,
}

/// What a stand-in does: appends its name and arguments to `calls`, one line each, then runs `body`.
const STAND_IN: &str = "#!/bin/sh\n{ printf '%s' \"${0##*/}\"; printf ' [%s]' \"$@\"; echo; } >>\"$CALLS\"\n";

impl Site {
    /// Scripts for a plan of `sequences`, with `options` of `dataset slurm`.
    fn new(sequences: u32, options: &[&str]) -> Self {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join("it's a \"site\" $HOME %A & `x`; #");
        std::fs::create_dir_all(&folder).unwrap();
        let site = Self { _root: root, folder };
        let plan = site.path("plan.json");
        succeed(&[
            "dataset",
            "plan",
            "--seed",
            "5",
            "--sequences",
            &sequences.to_string(),
            "--frames",
            "2",
            "--resolution",
            "16",
            "--spp",
            "1",
            "--denoise",
            "none",
            "--split",
            "train",
            "--out",
            &plan,
        ]);
        let (out, scripts, program) = (site.path("data"), site.path("jobs"), site.path("program"));
        let mut command =
            vec!["dataset", "slurm", "--plan", &plan, "--out", &out, "--script-dir", &scripts, "--program", &program];
        command.extend(options);
        succeed(&command);
        site.stand_in("sbatch", "n=$(grep -c '^sbatch' \"$CALLS\"); echo \"$((100 + n));cluster\"");
        site.stand_in("scontrol", "[ \"$1\" != \"${REFUSE-}\" ]");
        site.stand_in("scancel", "");
        site
    }

    fn path(&self, name: &str) -> String {
        self.folder.join(name).to_str().unwrap().to_owned()
    }

    fn stand_in(&self, name: &str, body: &str) {
        let path = self.folder.join(name);
        std::fs::write(&path, format!("{STAND_IN}{body}\n")).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
    }

    /// `shell` on one of the scripts, as Slurm would call it for task 7 of array 41.
    fn script(&self, shell: &str, name: &str, arguments: &[&str]) -> Command {
        let mut command = Command::new(shell);
        command.arg(self.path("jobs").as_str().to_owned() + "/" + name).args(arguments);
        let path = std::env::var("PATH").unwrap_or_default();
        command.env("PATH", format!("{}:{path}", self.folder.display())).env("CALLS", self.path("calls"));
        for variable in ["RENDERFLOW_SHARDS", "RENDERFLOW_SHARD_OFFSET", "SLURM_CPUS_PER_TASK", "SLURM_RESTART_COUNT"] {
            command.env_remove(variable);
        }
        command.env("SLURM_ARRAY_JOB_ID", "41").env("SLURM_ARRAY_TASK_ID", "7").env("SLURM_JOB_ID", "41");
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    /// The calls since the last time.
    fn calls(&self) -> Vec<String> {
        let path = self.folder.join("calls");
        let text = std::fs::read_to_string(&path).unwrap_or_default();
        std::fs::remove_file(&path).ok();
        text.lines().map(str::to_owned).collect()
    }
}

/// The shells of this machine that may be /bin/sh.
fn shells() -> Vec<&'static str> {
    let there = |shell: &&str| Command::new(shell).args(["-c", "exit 0"]).status().is_ok_and(|s| s.success());
    ["sh", "dash", "bash"].into_iter().filter(there).collect()
}

/// With fewer tasks at once than arrays, an array waits for an earlier one.
#[test]
fn few_tasks_at_once_are_few_over_all_arrays() {
    let site = Site::new(3500, &["--tasks-at-once", "2"]);
    for shell in shells() {
        let submitted = site.script(shell, "submit.sh", &[]).output().unwrap();
        assert!(submitted.status.success(), "{shell}: {}", stderr(&submitted));
        let calls = site.calls();
        let waits = |call: &String| call.split(' ').find(|word| word.starts_with("[--dependency")).map(str::to_owned);
        let after = |text: &str| Some(format!("[--dependency={text}]"));
        let expected = [None, None, after("afterany:101"), after("afterany:102"), after("afterok:101:102:103:104")];
        assert_eq!(calls.iter().map(waits).collect::<Vec<_>>(), expected, "{shell}: {calls:?}");
        assert!(calls[..4].iter().all(|call| call.contains("%1]")), "{shell}: {calls:?}");
    }
}

#[test]
fn arrays_of_a_thousand_then_the_merge() {
    let options = ["--tasks-at-once", "130", "--partition", "render", "--account", "lab", "--extra", "--qos=long"];
    let site = Site::new(1300, &options);
    let script = |name: &str| std::fs::read_to_string(site.folder.join("jobs").join(name)).unwrap();
    for name in ["array.sh", "merge.sh"] {
        let text = script(name);
        let directives: Vec<_> = text.lines().filter(|l| l.starts_with("#SBATCH")).collect();
        for line in ["#SBATCH --requeue", "#SBATCH --partition=render", "#SBATCH --account=lab", "#SBATCH --qos=long"] {
            assert!(directives.contains(&line), "{name}: {line}: {directives:?}");
        }
        // Slurm reads such lines up to the first command.
        let first = text.lines().position(|l| !l.is_empty() && !l.starts_with('#')).unwrap();
        assert!(text.lines().skip(first).all(|l| !l.starts_with("#SBATCH")), "{name}");
    }
    assert!(script("array.sh").contains("\n#SBATCH --signal=B:TERM@60\n"));
    for shell in shells() {
        for name in ["array.sh", "merge.sh", "submit.sh"] {
            let checked = Command::new(shell).arg("-n").arg(site.folder.join("jobs").join(name)).output().unwrap();
            assert!(checked.status.success(), "{shell} {name}: {}", stderr(&checked));
        }
        let dry = site.script(shell, "submit.sh", &["--dry-run"]).output().unwrap();
        assert!(dry.status.success() && site.calls().is_empty(), "{shell}: {}", stderr(&dry));
        assert_eq!(String::from_utf8_lossy(&dry.stdout).matches("sbatch --").count(), 3);

        let submitted = site.script(shell, "submit.sh", &[]).output().unwrap();
        assert!(submitted.status.success(), "{shell}: {}", stderr(&submitted));
        let logs = site.path("jobs/logs").replace('%', "%%");
        assert_eq!(
            site.calls(),
            [
                format!("sbatch [--parsable] [--array=1-1000%100] [--output={logs}/%A_%a.out] [array.sh] [0]"),
                format!("sbatch [--parsable] [--array=1-300%30] [--output={logs}/%A_%a.out] [array.sh] [1000]"),
                format!(
                    "sbatch [--parsable] [--dependency=afterok:101:102] [--kill-on-invalid-dep=yes] [--output={logs}/merge_%j.out] [merge.sh]"
                ),
            ],
            "{shell}"
        );
        let said = String::from_utf8_lossy(&submitted.stdout).into_owned();
        assert!(["101: ", "102: ", "103: "].iter().all(|job| said.contains(job)), "{said}");
    }
}

/// Arrays that are in the queue when a later one is refused must not be forgotten.
#[test]
fn a_refused_array_is_an_error_that_names_the_others() {
    let site = Site::new(1300, &[]);
    site.stand_in("sbatch", "[ $(grep -c '^sbatch' \"$CALLS\") -lt 2 ] && echo 7");
    for shell in shells() {
        let refused = site.script(shell, "submit.sh", &[]).output().unwrap();
        assert!(!refused.status.success(), "{shell}");
        assert!(stderr(&refused).contains("submitted before the failure: 7"), "{shell}: {}", stderr(&refused));
        site.calls();
    }
}

#[test]
fn what_follows_the_end_of_a_task() {
    let site = Site::new(1300, &["--memory", "3G", "--retries", "2", "--cpus", "5"]);
    let [plan, out] = [site.path("plan.json"), site.path("data")];
    let program = format!("program [dataset] [render] [--plan] [{plan}] [--out] [{out}] [--threads] [5]");
    let requeue = "scontrol [requeue] [41_7]";
    let more = ["scontrol [requeuehold] [41_7]", "scontrol [update] [JobId=41_7] [MinMemoryNode=6144]"];
    site.stand_in("program", "echo \"$RENDERFLOW_SHARD_OFFSET+$SLURM_ARRAY_TASK_ID/$RENDERFLOW_SHARDS\"; exit \"$STATUS\"");
    for shell in shells() {
        for (status, restarts, refuse, follows) in [
            (0, "0", "", vec![]),
            (75, "0", "", vec![requeue]),
            (75, "1", "", vec![requeue]),
            (143, "0", "", vec![requeue]),
            (75, "2", "", vec![]),
            (75, "0", "requeue", vec![requeue]),
            (1, "1", "", vec![requeue]),
            (1, "2", "", vec![]),
            (127, "0", "", vec![requeue]),
            // Usage: the same command fails the same way.
            (2, "0", "", vec![]),
            (137, "0", "", vec![more[0], more[1], "scontrol [release] [41_7]"]),
            (134, "0", "", vec![more[0], more[1], "scontrol [release] [41_7]"]),
            (137, "0", "update", vec![more[0], more[1], "scancel [41_7]"]),
            (137, "0", "requeuehold", vec![more[0]]),
            (137, "2", "", vec![]),
        ] {
            let case = format!("{shell}, status {status}, restart {restarts}, {refuse:?} refused");
            let mut command = site.script(shell, "array.sh", &["1000"]);
            command.env("STATUS", status.to_string()).env("REFUSE", refuse);
            if restarts != "0" {
                command.env("SLURM_RESTART_COUNT", restarts);
            }
            let output = command.output().unwrap();
            assert_eq!(output.status.code(), Some(status), "{case}: {}", stderr(&output));
            let said = String::from_utf8_lossy(&output.stdout).into_owned();
            assert!(said.contains("\n1000+7/1300\n"), "{case}: {said}");
            let calls = site.calls();
            assert_eq!(calls[0], program, "{case}");
            assert_eq!(calls[1..], follows, "{case}");
        }
        // The memory that Slurm gave, not that of the script: it may have been doubled before.
        let mut command = site.script(shell, "array.sh", &["0"]);
        command.env("STATUS", "137").env("SLURM_MEM_PER_NODE", "6144").output().unwrap();
        assert!(site.calls().contains(&"scontrol [update] [JobId=41_7] [MinMemoryNode=12288]".to_owned()), "{shell}");
    }
}

/// Slurm signals the shell alone, and `scancel` may do so twice. The program is told once, for a second signal would make it drop
/// the frame at hand, and is waited for.
#[test]
fn a_signal_reaches_the_program() {
    let site = Site::new(2, &[]);
    // Ends by itself after ten seconds, should no signal come.
    let body = "told=; n=0; trap 'told=1; echo told' TERM; echo ready\n\
                while [ -z \"$told\" ] && [ $n -lt 500 ]; do sleep 0.02; n=$((n + 1)); done\n\
                [ -z \"$told\" ] || { sleep 0.2; echo finished; }; exit 75";
    site.stand_in("program", body);
    for shell in shells() {
        for signals in [1, 2] {
            let case = format!("{shell}, {signals} signals");
            let mut child = site.script(shell, "array.sh", &["0"]).spawn().unwrap();
            let mut lines = BufReader::new(child.stdout.take().unwrap()).lines().map(|line| line.unwrap());
            let signal = || {
                let killed = Command::new("kill").args(["-TERM", &child.id().to_string()]).status().unwrap();
                assert!(killed.success(), "{case}");
            };
            assert!(lines.any(|line| line == "ready"), "{case}");
            signal();
            assert!(lines.any(|line| line == "told"), "{case}");
            if signals == 2 {
                signal();
            }
            assert_eq!(lines.next().as_deref(), Some("finished"), "{case}");
            assert!(lines.any(|line| line.ends_with("interrupted; goes on later")), "{case}");
            assert_eq!(child.wait().unwrap().code(), Some(75), "{case}");
            assert_eq!(site.calls()[1..], ["scontrol [requeue] [41_7]"], "{case}");
        }
    }
}

/// The options of a job that trains, up to the training's own.
fn training<'a>(scripts: &'a str, program: &'a str, options: &[&'a str]) -> Vec<&'a str> {
    let mut command = vec!["train", "slurm", "--overwrite", "--script-dir", scripts, "--program", program];
    command.extend(options);
    command.push("--");
    command
}

#[test]
fn what_follows_the_end_of_a_training() {
    let site = Site::new(2, &[]);
    let [plan, out, scripts, program] = ["plan.json", "run", "jobs", "program"].map(|name| site.path(name));
    for launcher in ["srun", "mpirun"] {
        site.stand_in(launcher, "exit \"$STATUS\"");
        let options = ["--nodes", "2", "--processes", "2", "--cpus", "5", "--retries", "2", "--launcher", launcher];
        let mut command = training(&scripts, &program, &options);
        command.extend(["--plan", &plan, "-o", &out, "--steps", "7"]);
        succeed(&command);
        let launch = match launcher {
            "srun" => "srun [--mpi=pmix] [--kill-on-bad-exit=1] [--cpus-per-task=5]",
            _ => "mpirun [-n] [2] [--bind-to] [none]",
        };
        let launched = format!("{launch} [{program}] [train] [--plan] [{plan}] [-o] [{out}] [--steps] [7] [--threads] [5]");
        let text = std::fs::read_to_string(site.path("jobs/job.sh")).unwrap();
        let signal = if launcher == "srun" { "TERM@120" } else { "B:TERM@120" };
        for line in ["#SBATCH --nodes=2", "#SBATCH --ntasks=2", "#SBATCH --requeue", &format!("#SBATCH --signal={signal}")] {
            assert!(text.lines().any(|l| l == line), "{line}: {text}");
        }
        let requeue = "scontrol [requeue] [41]";
        for shell in shells() {
            for (status, restarts, follows) in [
                (0, "0", vec![]),
                (75, "1", vec![requeue]),
                (143, "0", vec![requeue]),
                // A process was killed, and the launcher ended the others.
                (137, "0", vec![requeue]),
                (1, "1", vec![requeue]),
                (1, "2", vec![]),
                (2, "0", vec![]),
            ] {
                let case = format!("{launcher}, {shell}, status {status}, restart {restarts}");
                let mut command = site.script(shell, "job.sh", &[]);
                let output = command.env("STATUS", status.to_string()).env("SLURM_RESTART_COUNT", restarts).output().unwrap();
                assert_eq!(output.status.code(), Some(status), "{case}: {}", stderr(&output));
                let calls = site.calls();
                assert_eq!(calls[0], launched, "{case}");
                assert_eq!(calls[1..], follows, "{case}");
            }
        }
    }
}

#[test]
fn a_training_that_cannot_work_is_not_written() {
    let site = Site::new(2, &[]);
    let [plan, out, scripts, program] = ["plan.json", "run", "other jobs", "program"].map(|name| site.path(name));
    for (options, more, message) in [
        (["--processes", "3"], ["--steps", "7"], "crops.batch: 8 cannot be shared equally by 3 processes"),
        (["--time", "a b"], ["--steps", "7"], "--time \"a b\": not a word"),
        (["--processes", "2"], ["--stepps", "7"], "--stepps"),
        (["--processes", "2"], ["--vae", "x"], "--vae"),
    ] {
        let mut command = training(&scripts, &program, &options);
        command.extend(["--plan", &plan, "-o", &out]);
        command.extend(more);
        let refused = renderflow(&command);
        assert!(!refused.status.success() && stderr(&refused).contains(message), "{options:?}: {}", stderr(&refused));
        assert!(!Path::new(&scripts).exists(), "{options:?}");
    }
}

/// Processes that were started together and do not know each other would write into one folder.
#[test]
fn a_program_without_mpi_does_not_train_beside_others() {
    let site = Site::new(2, &[]);
    let train = |variables: &[(&str, &str)]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_renderflow"));
        command.args(["train", "--plan", &site.path("plan.json"), "-o", &site.path("run"), "--steps", "0"]);
        command.envs(variables.iter().copied()).output().unwrap()
    };
    for started in
        [[("OMPI_COMM_WORLD_SIZE", "2"), ("OMPI_COMM_WORLD_RANK", "0")], [("SLURM_STEP_NUM_TASKS", "2"), ("SLURM_PROCID", "1")]]
    {
        let refused = train(&started);
        let said = stderr(&refused);
        assert!(!refused.status.success() && said.contains(" says that 2 processes were started to train together"), "{said}");
    }
    // One process is one, however it was started. It is refused for another reason.
    for started in
        [[("OMPI_COMM_WORLD_SIZE", "1"), ("OMPI_COMM_WORLD_RANK", "0")], [("SLURM_NTASKS", "2"), ("SLURM_PROCID", "0")]]
    {
        let said = stderr(&train(&started));
        assert!(said.contains("steps: must be at least 1"), "{said}");
    }
}

#[test]
fn the_merge_names_its_files() {
    let site = Site::new(2, &[]);
    site.stand_in("program", "exit 3");
    for shell in shells() {
        assert_eq!(site.script(shell, "merge.sh", &[]).status().unwrap().code(), Some(3));
        let expected = format!("program [dataset] [merge] [--plan] [{}] [--out] [{}]", site.path("plan.json"), site.path("data"));
        assert_eq!(site.calls(), [expected]);
    }
}

#[test]
fn kubernetes_counts_sequences() {
    let site = Site::new(1300, &["--tasks-at-once", "50", "--retries", "4", "--memory", "2G"]);
    let text = std::fs::read_to_string(Path::new(&site.path("jobs")).join("kubernetes.yaml")).unwrap();
    for line in [
        "  completions: 1300",
        "  parallelism: 50",
        "  backoffLimitPerIndex: 4",
        "              value: \"1300\"",
        "              memory: 2048Mi",
    ] {
        assert!(text.lines().any(|l| l == line), "{line}: {text}");
    }
}

#[test]
fn what_would_break_a_script_is_refused() {
    let site = Site::new(2, &[]);
    let plan = site.path("plan.json");
    for (scripts, option, value, message) in [
        ("jobs", "--partition", "a b", "--partition \"a b\": not a word"),
        ("jobs", "--time", "01:00:00\nreboot", "not a word"),
        ("jobs", "--extra", "reboot", "not one option of sbatch"),
        ("jobs", "--memory", "8GB", "write memory as 8G"),
        ("back\\slash", "--account", "a", "backslash"),
    ] {
        let (out, scripts) = (site.path("data"), site.path(scripts));
        let refused = renderflow(&["dataset", "slurm", "--plan", &plan, "--out", &out, "--script-dir", &scripts, option, value]);
        assert!(!refused.status.success() && stderr(&refused).contains(message), "{option} {value}: {}", stderr(&refused));
    }
}

/// A task renders its own sequence; a count without a task is an error, not the whole plan in every task.
#[test]
fn the_program_takes_its_shard_from_the_engine() {
    let site = Site::new(3, &[]);
    let render = |variables: &[(&str, &str)]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_renderflow"));
        command.args(["dataset", "render", "--plan", &site.path("plan.json"), "--out", &site.path("data")]);
        for variable in ["SLURM_ARRAY_TASK_ID", "JOB_COMPLETION_INDEX", "RENDERFLOW_SHARDS", "RENDERFLOW_SHARD_OFFSET"] {
            command.env_remove(variable);
        }
        command.envs(variables.iter().copied()).output().unwrap()
    };
    let there = || {
        let mut names: Vec<_> = common::files(&site.folder.join("data"))
            .into_iter()
            .filter_map(|(name, _)| name.contains("frame.").then(|| name.split('/').nth(1).unwrap().to_owned()))
            .collect();
        names.dedup();
        names
    };
    let done = render(&[("SLURM_ARRAY_TASK_ID", "2"), ("RENDERFLOW_SHARDS", "3")]);
    assert!(done.status.success(), "{}", stderr(&done));
    assert!(stderr(&done).contains("shard 2/3 (Slurm: SLURM_ARRAY_TASK_ID=2, RENDERFLOW_SHARDS=3)"), "{}", stderr(&done));
    assert_eq!(there(), ["seq-000001"]);
    let done = render(&[("JOB_COMPLETION_INDEX", "2"), ("RENDERFLOW_SHARDS", "3")]);
    assert!(done.status.success(), "{}", stderr(&done));
    assert_eq!(there(), ["seq-000001", "seq-000002"]);
    let refused = render(&[("RENDERFLOW_SHARDS", "3")]);
    assert!(!refused.status.success() && there().len() == 2, "{}", stderr(&refused));
}
