//! Datasets without a person watching: kills, signals, full disks, failures, damage, and the proof that nothing came of them.

mod common;

use common::{files, renderflow, stderr, succeed};
use renderflow::dataset::{Plan, Shard, manifest, record, render as rendering, verify};
use renderflow::util::cancel::{Cancel, Interrupted};
use renderflow_frame::exr;
use renderflow_scenes::procedural::Split;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// Writes a plan with `more` arguments.
fn plan(folder: &Path, name: &str, more: &[&str]) -> String {
    let path = folder.join(name).to_str().unwrap().to_owned();
    let common = ["dataset", "plan", "--seed", "3", "--denoise", "none", "--out", &path];
    succeed(&[&common[..], more].concat());
    path
}

const SMALL: [&str; 10] = ["--sequences", "3", "--frames", "4", "--resolution", "40", "--spp", "8", "--keyframe-gap", "2"];

fn render(plan: &str, out: &Path, more: &[&str]) -> std::process::Output {
    renderflow(&[&["dataset", "render", "--plan", plan, "--out", out.to_str().unwrap()][..], more].concat())
}

/// Files of a dataset that must not differ: all but clocks and logs.
fn lasting(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let passing = |name: &str| name.ends_with("timing.json") || name.starts_with("logs/");
    files(folder).into_iter().filter(|(name, _)| !passing(name)).collect()
}

/// The names that two datasets do not have alike.
fn differences(one: &Path, other: &Path) -> Vec<String> {
    let (one, other) = (lasting(one), lasting(other));
    let only = |a: &[(String, Vec<u8>)], b: &[(String, Vec<u8>)]| {
        a.iter().filter(|file| !b.contains(file)).map(|file| file.0.clone()).collect::<Vec<_>>()
    };
    let mut names = only(&one, &other);
    names.extend(only(&other, &one));
    names.sort();
    names.dedup();
    names
}

fn verified(out: &Path) -> String {
    succeed(&["dataset", "verify", out.to_str().unwrap()])
}

fn spawn(plan: &str, out: &Path, more: &[&str]) -> std::process::Child {
    Command::new(env!("CARGO_BIN_EXE_renderflow"))
        .args(["dataset", "render", "--plan", plan, "--out", out.to_str().unwrap()])
        .args(more)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

/// Kills runs with SIGKILL after random times until `kills` were dealt; whenever a run comes to its end, the dataset must be the
/// undisturbed one.
fn killed_datasets_are_the_undisturbed_one(kills: usize) {
    let folder = tempfile::tempdir().unwrap();
    let plan = plan(folder.path(), "plan.json", &SMALL);
    let whole = folder.path().join("whole");
    let started = Instant::now();
    assert!(render(&plan, &whole, &[]).status.success());
    let whole_time = started.elapsed().as_secs_f64();
    let (mut dealt, mut finished) = (0, 0);
    // A fixed sequence of "random" moments: the same test every time, as far as the clock allows.
    let mut state = 0x9e37_79b9_7f4a_7c15u64;
    while dealt < kills {
        let out = folder.path().join(format!("killed-{finished}"));
        loop {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let wait = 0.6 * whole_time * (state >> 11) as f64 / (1u64 << 53) as f64;
            let mut child = spawn(&plan, &out, &[]);
            std::thread::sleep(Duration::from_secs_f64(wait));
            let _ = child.kill();
            let status = child.wait().unwrap();
            if status.success() {
                break;
            }
            assert_eq!(status.code(), None, "a run that was not killed failed");
            dealt += 1;
        }
        assert_eq!(differences(&whole, &out), Vec::<String>::new());
        verified(&out);
        std::fs::remove_dir_all(&out).unwrap();
        finished += 1;
    }
    println!("{dealt} kills, {finished} datasets finished");
}

/// The records of all sequences of a finished dataset.
fn records(plan: &Plan, out: &Path) -> Vec<record::Record> {
    (0..plan.total()).map(|index| record::Record::read(&plan.folder(out, index)).unwrap().unwrap()).collect()
}

#[test]
fn a_few_kills_change_nothing() {
    killed_datasets_are_the_undisturbed_one(6);
}

#[test]
#[ignore = "two minutes"]
fn two_hundred_kills_change_nothing() {
    killed_datasets_are_the_undisturbed_one(200);
}

#[test]
fn shards_merged_are_the_whole() {
    let folder = tempfile::tempdir().unwrap();
    let plan = plan(folder.path(), "plan.json", &[&SMALL[..], &["--between-spp", "2", "--compact"]].concat());
    let whole = folder.path().join("whole");
    assert!(render(&plan, &whole, &[]).status.success());
    for shards in [3, 7] {
        let out = folder.path().join(format!("of-{shards}"));
        for index in (1..=shards).rev() {
            let shard = format!("{index}/{shards}");
            let output = render(&plan, &out, &["--shard", &shard, "--threads", "2", "--resume"]);
            assert!(output.status.success(), "{}", stderr(&output));
        }
        assert_eq!(differences(&whole, &out), Vec::<String>::new());
        // Merging again writes the same.
        succeed(&["dataset", "merge", "--plan", &plan, "--out", out.to_str().unwrap()]);
        assert_eq!(differences(&whole, &out), Vec::<String>::new());
    }
    let text = verified(&whole);
    assert!(text.contains("3 sequences, 12 frames") && text.contains("no faults"), "{text}");
    // What is said of the whole is what was found in all sequences.
    let records = records(&Plan::read(Path::new(&plan)).unwrap(), &whole);
    let found = verify::verify(&whole, &Cancel::default()).unwrap();
    let mut sum = records[0].agreement.clone();
    records[1..].iter().for_each(|record| sum.add(&record.agreement));
    assert_eq!(found.agreement, sum);
    assert!(sum.angles[1..].iter().sum::<u64>() > 0);
    // Keyframes at full quality, what is between them cheaper; all marked.
    for record in records {
        let frames: Vec<_> = record.frames.iter().map(|frame| (frame.number, frame.keyframe, frame.spp)).collect();
        assert_eq!(frames, [(0, true, 8), (1, false, 2), (2, true, 8), (3, false, 2)]);
        assert_eq!(record.keyframes, [0, 2]);
        let cameras = whole.join("train").join(&record.name).join("transforms.json");
        assert_eq!(renderflow_frame::transforms::read(&cameras).unwrap().keyframes, [0, 2]);
    }
}

#[cfg(unix)]
#[test]
fn a_termination_signal_lets_the_frame_finish() {
    let folder = tempfile::tempdir().unwrap();
    let plan = plan(folder.path(), "plan.json", &["--sequences", "2", "--frames", "3", "--resolution", "64", "--spp", "512"]);
    let out = folder.path().join("out");
    let mut child = spawn(&plan, &out, &[]);
    // In the middle of a frame: when the cameras are written, the first one is on its way.
    let cameras = out.join("train/seq-000000/transforms.json");
    let begun = Instant::now();
    while !cameras.is_file() && begun.elapsed() < Duration::from_secs(60) {
        std::thread::sleep(Duration::from_millis(5));
    }
    assert!(Command::new("kill").args(["-TERM", &child.id().to_string()]).status().unwrap().success());
    assert_eq!(child.wait().unwrap().code(), Some(75));
    let frames = files(&out).iter().filter(|(name, _)| name.ends_with(".exr")).count();
    assert!((1..6).contains(&frames), "{frames} frames");
    let logs = std::fs::read_to_string(out.join("logs/shard-00001-of-00001.jsonl")).unwrap();
    assert!(logs.lines().last().unwrap().contains("\"event\":\"interrupted\""), "{logs}");
    let output = render(&plan, &out, &[]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(stderr(&output).contains(&format!("{} frames made, {frames} kept", 6 - frames)), "{}", stderr(&output));
    verified(&out);
}

/// A hangup ends the work like other signals, but not under `nohup`, which ignores it.
#[cfg(target_os = "linux")]
#[test]
fn a_hangup_that_is_ignored_stays_ignored() {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:")).unwrap().trim();
    if u64::from_str_radix(ignored, 16).unwrap() & 1 == 1 {
        return println!("skipped: these tests run under nohup");
    }
    let folder = tempfile::tempdir().unwrap();
    let plan = plan(folder.path(), "plan.json", &["--sequences", "2", "--frames", "3", "--resolution", "64", "--spp", "256"]);
    for (name, script, code) in [("heeded", "exec \"$0\" \"$@\"", 75), ("ignored", "trap '' HUP; exec \"$0\" \"$@\"", 0)] {
        let out = folder.path().join(name);
        let mut shell = Command::new("sh");
        shell.args([
            "-c",
            script,
            env!("CARGO_BIN_EXE_renderflow"),
            "dataset",
            "render",
            "--plan",
            &plan,
            "--out",
            out.to_str().unwrap(),
        ]);
        let mut child = shell.stderr(Stdio::null()).stdout(Stdio::null()).spawn().unwrap();
        let cameras = out.join("train/seq-000000/transforms.json");
        let begun = Instant::now();
        while !cameras.is_file() && begun.elapsed() < Duration::from_secs(60) {
            std::thread::sleep(Duration::from_millis(5));
        }
        assert!(Command::new("kill").args(["-HUP", &child.id().to_string()]).status().unwrap().success());
        assert_eq!(child.wait().unwrap().code(), Some(code), "{name}");
    }
}

#[test]
fn a_frame_that_fails_is_recorded_and_the_others_go_on() {
    let folder = tempfile::tempdir().unwrap();
    let plan = plan(folder.path(), "plan.json", &SMALL);
    let (whole, out) = (folder.path().join("whole"), folder.path().join("out"));
    assert!(render(&plan, &whole, &[]).status.success());
    // A folder in the place of a frame cannot be replaced by a file.
    let (sequence, frame) = (out.join("train/seq-000001"), "frame.0002.exr");
    std::fs::create_dir_all(sequence.join(frame).join("x")).unwrap();
    let output = render(&plan, &out, &[]);
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains("11 frames made, 0 kept, 1 failure, "), "{}", stderr(&output));
    let failures: serde_json::Value = serde_json::from_slice(&std::fs::read(sequence.join("failures.json")).unwrap()).unwrap();
    let scene: serde_json::Value = serde_json::from_slice(&std::fs::read(sequence.join("scene.json")).unwrap()).unwrap();
    assert_eq!((failures[0]["frame"].as_u64(), &failures[0]["seed"]), (Some(2), &scene["seed"]));
    assert!(failures[0]["error"].as_str().unwrap().contains(frame), "{failures}");
    assert!(!out.join("manifest.json").exists() && !sequence.join("sequence.json").exists());
    let verdict = renderflow(&["dataset", "verify", out.to_str().unwrap()]);
    assert_eq!(verdict.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&verdict.stdout).contains("seq-000001 frame 2: failed when it was made"));
    let merged = renderflow(&["dataset", "merge", "--plan", &plan, "--out", out.to_str().unwrap()]);
    assert!(stderr(&merged).contains("not complete: 1 of 3 sequences (1 failure recorded), the first is seq-000001"));
    // The cause gone, the same command makes what is missing and forgets the failure.
    std::fs::remove_dir_all(sequence.join(frame)).unwrap();
    assert!(render(&plan, &out, &[]).status.success());
    assert_eq!(differences(&whole, &out), Vec::<String>::new());
}

/// A run that is stopped, or makes some of the frames only, leaves the failures of the others on record.
#[test]
fn failures_of_frames_that_a_run_does_not_come_to_stay_on_record() {
    let folder = tempfile::tempdir().unwrap();
    let plan_file = plan(folder.path(), "plan.json", &SMALL);
    let (plan, out) = (Plan::read(Path::new(&plan_file)).unwrap(), folder.path().join("out"));
    let sequence = out.join("train/seq-000001");
    let [first, second, third] = [0, 1, 2].map(|number| sequence.join(format!("frame.{number:04}.exr")));
    for taken in [&second, &third] {
        std::fs::create_dir_all(taken.join("x")).unwrap();
    }
    assert_eq!(render(&plan_file, &out, &[]).status.code(), Some(1));
    let failed = || record::failures(&sequence).unwrap().iter().map(|failure| failure.frame.unwrap()).collect::<Vec<_>>();
    assert_eq!(failed(), [1, 2]);
    // Stopped once the first frame is there again, before the second.
    std::fs::remove_file(&first).unwrap();
    let stop = Cancel::default();
    let until_the_first = |number: usize| {
        if number == 1 && first.is_file() {
            stop.set();
        }
        true
    };
    let stopped = rendering::run_some(&plan, &out, Shard::WHOLE, &until_the_first, &stop).unwrap_err();
    assert!(stopped.is::<Interrupted>() && first.is_file(), "{stopped:#}");
    assert_eq!(failed(), [1, 2]);
    // Only the second frame, which can be made now.
    std::fs::remove_dir_all(&second).unwrap();
    rendering::run_some(&plan, &out, Shard::WHOLE, &|number| number == 1, &Cancel::default()).unwrap();
    assert!(second.is_file());
    assert_eq!(failed(), [2]);
    std::fs::remove_dir_all(&third).unwrap();
    assert!(render(&plan_file, &out, &[]).status.success());
    assert!(!sequence.join("failures.json").exists());
}

#[test]
fn what_is_damaged_is_found_and_made_again() {
    let folder = tempfile::tempdir().unwrap();
    let plan_file = plan(folder.path(), "plan.json", &SMALL);
    let (whole, out) = (folder.path().join("whole"), folder.path().join("out"));
    for out in [&whole, &out] {
        assert!(render(&plan_file, out, &[]).status.success());
    }
    let faults = || {
        let verdict = renderflow(&["dataset", "verify", out.to_str().unwrap()]);
        assert_eq!(verdict.status.code(), Some(1));
        String::from_utf8_lossy(&verdict.stdout).into_owned()
    };
    let frame = |name: &str| out.join("train/seq-000000").join(name);
    // One byte of the pixels.
    let bytes = std::fs::read(frame("frame.0001.exr")).unwrap();
    let mut flipped = bytes.clone();
    let last = flipped.len() - 1;
    flipped[last] ^= 1;
    std::fs::write(frame("frame.0001.exr"), &flipped).unwrap();
    assert!(faults().contains("frame.0001.exr"));
    std::fs::write(frame("frame.0001.exr"), &bytes).unwrap();
    // Cut off, as after a power failure: size and record tell, and the frame is made again.
    std::fs::write(frame("frame.0001.exr"), &bytes[..bytes.len() / 2]).unwrap();
    assert!(faults().contains("frame.0001.exr"));
    let output = render(&plan_file, &out, &[]);
    assert!(output.status.success() && stderr(&output).contains("1 frame made, 11 kept"), "{}", stderr(&output));
    assert_eq!(differences(&whole, &out), Vec::<String>::new());
    // Gone.
    std::fs::remove_file(frame("frame.0003.exr")).unwrap();
    assert!(faults().contains("frame.0003.exr: is not there"));
    assert!(render(&plan_file, &out, &[]).status.success());
    assert_eq!(differences(&whole, &out), Vec::<String>::new());
    // Another plan does not mix in.
    let other = plan(folder.path(), "other.json", &[&SMALL[..], &["--mesh-count", "100"]].concat());
    let output = render(&other, &out, &[]);
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains("another plan"), "{}", stderr(&output));
}

/// Conventions that others get wrong: each is found from the channels alone, with hashes that fit.
#[test]
fn wrong_conventions_are_found() {
    let folder = tempfile::tempdir().unwrap();
    let sizes = ["--sequences", "1", "--frames", "3", "--resolution", "64", "--spp", "0", "--distance"];
    let plan = plan(folder.path(), "plan.json", &sizes);
    let out = folder.path().join("out");
    assert!(render(&plan, &out, &[]).status.success());
    verified(&out);
    let frames: Vec<PathBuf> = (0..3).map(|i| out.join(format!("train/seq-000000/frame.{i:04}.exr"))).collect();
    let originals: Vec<_> = frames.iter().map(|path| exr::read(path).unwrap()).collect();
    assert!(originals.iter().all(|frame| frame.beauty.is_none() && frame.info.spp == 0 && frame.distance.is_some()));
    type Change = fn(&mut renderflow_frame::Frame);
    let changes: [(&str, Change, &str); 5] = [
        ("planar depth in place of distance", |frame| frame.distance = Some(frame.depth.clone()), "distance.Z is"),
        (
            "distance in place of depth",
            |frame| {
                let camera = frame.info.camera;
                for (i, depth) in frame.depth.pixels.iter_mut().enumerate() {
                    let pixel = glam::Vec2::new((i % frame.width) as f32 + 0.5, (i / frame.width) as f32 + 0.5);
                    *depth *= camera.direction_cam(pixel).length();
                }
                frame.distance = None;
            },
            "of the motion vectors differ",
        ),
        (
            "normals in the world",
            |frame| {
                let turn = frame.info.camera.camera_to_world.matrix3;
                frame.normal.pixels.iter_mut().for_each(|n| *n = (turn * glam::Vec3A::from(*n)).to_array());
            },
            "read as world space",
        ),
        (
            "motion up in place of down",
            |frame| frame.motion.as_mut().unwrap().pixels.iter_mut().for_each(|m| m[1] = -m[1]),
            "of the motion vectors differ",
        ),
        ("normals with y down", |frame| frame.normal.pixels.iter_mut().for_each(|n| n[1] = -n[1]), "read as y down"),
    ];
    for (what, change, expected) in changes {
        for (path, original) in frames.iter().zip(&originals) {
            let mut frame = original.clone();
            change(&mut frame);
            exr::write(path, &frame).unwrap();
        }
        let verdict = renderflow(&["dataset", "verify", out.to_str().unwrap()]);
        let text = String::from_utf8_lossy(&verdict.stdout).into_owned();
        // Hashes do not fit either: it is the first fault that counts.
        let fault = text.lines().find(|line| line.starts_with("FAULT")).unwrap_or_default();
        assert!(!verdict.status.success() && fault.contains(expected), "{what}: {text}");
    }
}

/// A file system of two megabytes fills up; with more room the same command ends as if nothing had been.
#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_stops_the_work_and_loses_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let plan = plan(folder.path(), "plan.json", &SMALL);
    let (whole, out, small) = (folder.path().join("whole"), folder.path().join("out"), folder.path().join("small"));
    assert!(render(&plan, &whole, &[]).status.success());
    let bytes: usize = files(&whole).iter().map(|file| file.1.len()).sum();
    std::fs::create_dir(&small).unwrap();
    let script = format!(
        "mount -t tmpfs -o size={} none {small} || exit 9\n\
         {exe} dataset render --plan {plan} --out {small}/data 2> {folder}/full.txt; echo $? > {folder}/code.txt\n\
         mount -o remount,size=64m {small} || exit 9\n\
         {exe} dataset render --plan {plan} --out {small}/data 2> {folder}/again.txt || exit 1\n\
         cp -r {small}/data {out}",
        bytes / 2,
        small = small.display(),
        exe = env!("CARGO_BIN_EXE_renderflow"),
        folder = folder.path().display(),
        out = out.display()
    );
    let output = Command::new("unshare").args(["--user", "--map-root-user", "--mount", "sh", "-c", &script]).output();
    match output {
        Ok(output) if output.status.success() => {}
        Ok(output) if output.status.code() == Some(1) && !stderr(&output).contains("unshare") => panic!("{}", stderr(&output)),
        _ => return println!("skipped: no small file system can be mounted here"),
    }
    let read = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap();
    assert_eq!(read("code.txt").trim(), "1");
    assert!(read("full.txt").contains("No space left"), "{}", read("full.txt"));
    assert!(!read("again.txt").contains(" 0 kept"), "{}", read("again.txt"));
    assert_eq!(differences(&whole, &out), Vec::<String>::new());
    verified(&out);
}

#[test]
fn plans_say_where_they_are_wrong() {
    let folder = tempfile::tempdir().unwrap();
    let toml = plan(folder.path(), "plan.toml", &SMALL);
    let json = plan(folder.path(), "plan.json", &SMALL);
    let (out_toml, out_json) = (folder.path().join("t"), folder.path().join("j"));
    assert!(render(&toml, &out_toml, &[]).status.success() && render(&json, &out_json, &[]).status.success());
    assert_eq!(differences(&out_toml, &out_json), Vec::<String>::new());
    let text = std::fs::read_to_string(&json).unwrap();
    let refused = |from: &str, to: &str, expected: &str| {
        assert!(text.contains(from), "{from} is not in the plan");
        let bad = folder.path().join("bad.json");
        std::fs::write(&bad, text.replacen(from, to, 1)).unwrap();
        let output = render(bad.to_str().unwrap(), &folder.path().join("bad"), &[]);
        let said = stderr(&output);
        assert!(!output.status.success() && said.contains("bad.json") && said.contains(expected), "{to}: {said}");
    };
    refused("\"version\": 2", "\"version\": 1", "/version: 1 is not 2");
    refused("\"gap\": 2", "\"gap\": 0", "/keyframes/gap: 0 is outside");
    refused("\"frames\": 4", "\"frames\": 0", "/frames: 0 is outside");
    refused("\"frames\": 4", "\"frames\": 10000009", "/frames: 10000009 is outside 1..=100000");
    refused("\"degrees_per_frame\": 3.6", "\"degrees_per_frame\": 4.3e10", "/composition/degrees_per_frame");
    refused("\"moving\": ", "\"moving\": 7, \"x\": ", "unknown field `x`");
    refused("\"moving\": 0.", "\"moving\": 7.", "/composition/moving");
    // A mesh family of one split added to another.
    let plan: serde_json::Value = serde_json::from_str(&text).unwrap();
    let family = plan["splits"]["test"]["mesh_families"][0].as_str().unwrap();
    let mut leaking = plan.clone();
    leaking["splits"]["train"]["mesh_families"].as_array_mut().unwrap().push(family.into());
    let bad = folder.path().join("leak.json");
    std::fs::write(&bad, leaking.to_string()).unwrap();
    let said = stderr(&render(bad.to_str().unwrap(), &folder.path().join("bad"), &[]));
    assert!(said.contains(&format!("mesh family {family} belongs to train already")), "{said}");
}

#[test]
fn splits_share_nothing_and_sharing_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let sizes = ["--sequences", "12", "--frames", "1", "--resolution", "16", "--spp", "0"];
    let plan_file = plan(folder.path(), "plan.json", &sizes);
    let out = folder.path().join("out");
    assert!(render(&plan_file, &out, &[]).status.success());
    let plan = Plan::read(Path::new(&plan_file)).unwrap();
    assert_eq!([plan.sequences.train, plan.sequences.val, plan.sequences.test], [10, 1, 1]);
    let records = records(&plan, &out);
    let leaks = |records: &[record::Record]| -> Vec<String> {
        let leaks = manifest::leaks(&plan, (0..).zip(records));
        leaks.iter().map(ToString::to_string).collect()
    };
    assert_eq!(leaks(&records), Vec::<String>::new());
    // The same sequence in another split shares its scene, its light, and every mesh.
    let mut twice = records.clone();
    twice[11] = records[0].clone();
    let found = leaks(&twice);
    for what in ["scene ", "environment family ", "mesh family ", "geometry "] {
        assert!(found.iter().any(|leak| leak.starts_with(what)), "{what}: {found:?}");
    }
    // A mesh alone.
    let mut twice = records.clone();
    let geometry = twice[0].objects[0].geometry.clone();
    twice[11].objects[0].geometry = geometry.clone();
    assert_eq!(leaks(&twice), [format!("geometry {} is in train/seq-000000 and test/seq-000011", geometry[0])]);
}

/// A thousand scenes one after the other in one process: what each takes is given back.
#[test]
#[ignore = "minutes"]
fn a_thousand_scenes_do_not_pile_up() {
    let folder = tempfile::tempdir().unwrap();
    let sizes = ["--sequences", "1000", "--frames", "1", "--resolution", "24", "--spp", "1"];
    let plan = plan(folder.path(), "plan.json", &sizes);
    let out = folder.path().join("out");
    assert!(render(&plan, &out, &[]).status.success());
    let log = std::fs::read_to_string(out.join("logs/shard-00001-of-00001.jsonl")).unwrap();
    let lines = log.lines().map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap());
    let rss: Vec<f64> = lines.filter(|line| line["event"] == "sequence").map(|line| line["rss"].as_f64().unwrap()).collect();
    assert_eq!(rss.len(), 1000);
    let median = |part: &[f64]| {
        let mut sorted = part.to_vec();
        sorted.sort_by(f64::total_cmp);
        sorted[sorted.len() / 2]
    };
    let quarters = [median(&rss[..250]), median(&rss[250..500]), median(&rss[500..750]), median(&rss[750..])];
    println!("median memory of the quarters, MiB: {quarters:?}");
    assert!(quarters[3] < 1.15 * quarters[1], "{quarters:?}");
}

/// The user's models and maps are mixed in; two files of one body go to one split, what cannot be read is left out, and a file
/// that changed after planning is refused.
#[test]
fn files_of_the_user_are_mixed_in() {
    let folder = tempfile::tempdir().unwrap();
    let (models, maps) = (folder.path().join("models"), folder.path().join("maps"));
    let wedge = |height: f32, remark: &str| {
        format!("# {remark}\nv 0 0 0\nv 1 0 0\nv 0 0 -1\nv 0 {height} 0\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n")
    };
    std::fs::create_dir_all(models.join("more")).unwrap();
    std::fs::create_dir_all(&maps).unwrap();
    for i in 0..12 {
        std::fs::write(models.join(format!("wedge{i}.obj")), wedge(1.0 + i as f32, "one")).unwrap();
        std::fs::write(models.join(format!("more/again{i}.obj")), wedge(1.0 + i as f32, "the same under another name")).unwrap();
        common::write_map(&maps.join(format!("map{i}.exr")), |x, y| 0.1 + 0.01 * (x + y + i) as f32);
    }
    std::fs::write(models.join("broken.obj"), "f 1 2 3\n").unwrap();
    let sizes = ["--sequences", "20", "--frames", "1", "--resolution", "16", "--spp", "0"];
    let folders = ["--meshes", models.to_str().unwrap(), "--hdris", maps.to_str().unwrap()];
    let plan_file = folder.path().join("plan.json").to_str().unwrap().to_owned();
    let common = ["dataset", "plan", "--seed", "3", "--denoise", "none", "--out", &plan_file];
    let output = renderflow(&[&common[..], &sizes, &folders].concat());
    assert!(output.status.success() && stderr(&output).contains("left out: ") && stderr(&output).contains("broken.obj"));
    let planned = Plan::read(Path::new(&plan_file)).unwrap();
    let mut seen = 0;
    for split in [Split::Train, Split::Val, Split::Test] {
        let sources = planned.splits.of(split);
        assert!(!sources.models.is_empty() && !sources.hdris.is_empty(), "{split} got none");
        let names: Vec<&str> = sources.models.iter().map(|file| file.path.as_str()).collect();
        for name in names.iter().filter_map(|name| name.split("wedge").nth(1)) {
            assert!(
                names.iter().any(|other| other.ends_with(&format!("again{name}"))),
                "{split} has one of two alike: {names:?}"
            );
        }
        seen += names.len();
    }
    assert_eq!(seen, 24);
    let out = folder.path().join("out");
    let output = render(&plan_file, &out, &[]);
    assert!(output.status.success(), "{}", stderr(&output));
    let records = records(&planned, &out);
    assert!(records.iter().flat_map(|r| &r.objects).any(|object| object.file.is_some() && object.family == "file"));
    assert!(records.iter().any(|r| r.environment.family.starts_with("file:")));
    verified(&out);
    // Other files under the same names.
    for i in 0..12 {
        std::fs::write(models.join(format!("wedge{i}.obj")), wedge(3.5, "another")).unwrap();
        std::fs::write(models.join(format!("more/again{i}.obj")), wedge(3.5, "another")).unwrap();
    }
    let output = render(&plan_file, &folder.path().join("changed"), &[]);
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains("is not the file that was planned"), "{}", stderr(&output));
}
