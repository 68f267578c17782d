//! What the program does with jobs that are too large, too many threads, and signals in the middle of work.
#![cfg(unix)]

mod common;

use common::{files, stderr};
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

const PROGRAM: &str = env!("CARGO_BIN_EXE_renderflow");

/// Runs the program with at most `kilobytes` of address space.
fn limited(kilobytes: u64, args: &[&str]) -> Output {
    let script = format!("ulimit -v {kilobytes} && exec \"$@\"");
    Command::new("sh").args(["-c", &script, "sh", PROGRAM]).args(args).output().expect("the shell starts")
}

/// A render that would not fit is refused before anything is read or written; one that fits is made.
#[test]
fn renders_beyond_memory_are_refused_with_numbers_and_a_way_out() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let out = out.to_str().unwrap();
    let render = |resolution: &str, more: &[&str]| {
        let words = ["render", "--seed", "3", "--frames", "1", "--spp", "1", "--denoise", "none", "--out", out, "--resolution"];
        limited(6_000_000, &[&words[..], &[resolution], more].concat())
    };
    for more in [&[][..], &["--light-groups", "8"]] {
        let refused = render("16384", more);
        let text = stderr(&refused);
        assert_eq!(refused.status.code(), Some(1), "{text}");
        assert!(text.contains("a frame of 16384 x 16384 pixels takes about ") && text.contains(" GiB are available: "), "{text}");
        assert!(text.contains("a smaller resolution") && !text.contains("denoise none"), "{text}");
        assert_eq!(text.contains("fewer light groups"), !more.is_empty(), "{text}");
        assert!(!Path::new(out).exists());
    }
    let made = render("32", &[]);
    assert!(made.status.success(), "{}", stderr(&made));
}

#[test]
fn threads_are_at_most_four_for_each_core() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.obj");
    std::fs::write(&file, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
    let check = |threads: &str| {
        let output = Command::new(PROGRAM).args(["--threads", threads, "check"]).arg(&file).output().unwrap();
        assert!(output.status.success(), "{threads}: {}", stderr(&output));
        stderr(&output)
    };
    for threads in ["5000", "100000", "18446744073709551615"] {
        let text = check(threads);
        assert!(text.starts_with(&format!("note: --threads {threads}: ")) && text.contains("4 for each of "), "{text}");
    }
    assert_eq!([check("0"), check("1")], ["", ""]);
}

/// Sends the first signal to the program after `delay`, and waits for its end.
fn interrupted(mut child: Child, delay: Duration) -> Output {
    std::thread::sleep(delay);
    let sent = Command::new("kill").args(["-INT", &child.id().to_string()]).stderr(Stdio::null()).status().unwrap();
    // The program may have ended before.
    let deadline = Instant::now() + Duration::from_secs(120);
    while child.try_wait().unwrap().is_none() {
        assert!(Instant::now() < deadline, "no end in sight, {sent}");
        std::thread::sleep(Duration::from_millis(20));
    }
    child.wait_with_output().unwrap()
}

/// Whenever the first signal comes, a render ends, keeps what is finished, leaves nothing half written, and goes on later.
#[test]
fn a_render_heeds_the_first_signal_in_every_phase() {
    let folder = tempfile::tempdir().unwrap();
    let common = ["render", "--seed", "3", "--frames", "2", "--spp", "4", "--resolution", "320"];
    let render = |out: &Path| {
        let mut command = Command::new(PROGRAM);
        command.args(common).arg("--out").arg(out).stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    };
    let whole = folder.path().join("whole");
    let started = Instant::now();
    let output = render(&whole).output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    let seconds = started.elapsed();
    let without_clock =
        |folder: &Path| -> Vec<_> { files(folder).into_iter().filter(|(name, _)| name != "timing.json").collect() };
    let mut stopped = 0;
    for step in 0..8 {
        let out = folder.path().join(format!("out-{step}"));
        let output = interrupted(render(&out).spawn().unwrap(), seconds * step / 8);
        match output.status.code() {
            Some(0) => {}
            Some(75) => {
                stopped += 1;
                let text = stderr(&output);
                assert!(text.contains("interrupted; run the same command again to go on"), "{text}");
            }
            // Before it listens the signal is the system's.
            None if step == 0 => {}
            code => panic!("{code:?}: {}", stderr(&output)),
        }
        let written = if out.exists() { files(&out) } else { vec![] };
        assert!(!written.iter().any(|(name, _)| name.ends_with(".tmp")), "step {step}: {written:?}");
        let again = render(&out).output().unwrap();
        assert!(again.status.success(), "step {step}: {}", stderr(&again));
        assert!(without_clock(&out) == without_clock(&whole), "step {step}");
    }
    assert!(stopped >= 4, "{stopped}");
}

/// `check` writes nothing: the first signal ends it.
#[test]
fn a_check_ends_at_the_first_signal() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("large.obj");
    let side = 300;
    let mut text: String = (0..side * side).map(|i| format!("v {} {} {}\n", i % side, i / side, i * i % 97)).collect();
    for i in (0..side * (side - 1)).filter(|i| i % side < side - 1) {
        text += &format!("f {} {} {}\nf {} {} {}\n", i + 1, i + 2, i + side + 1, i + 2, i + side + 2, i + side + 1);
    }
    std::fs::write(&file, text).unwrap();
    let mut check = Command::new(PROGRAM);
    check.arg("check").args(vec![&file; 400]).stdout(Stdio::null()).stderr(Stdio::piped());
    let output = interrupted(check.spawn().unwrap(), Duration::from_millis(500));
    assert_eq!(output.status.code(), Some(130), "{}", stderr(&output));
}

/// The folder of maps is larger than what is read before the signal comes.
#[test]
fn a_plan_heeds_the_first_signal() {
    let folder = tempfile::tempdir().unwrap();
    let (maps, plan) = (folder.path().join("maps"), folder.path().join("plan.json"));
    std::fs::create_dir(&maps).unwrap();
    // What is said of the first file tells that the maps are being read.
    std::fs::write(maps.join("a.hdr"), "no map").unwrap();
    let head = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 256 +X 512\n".to_vec();
    std::fs::write(maps.join("b.hdr"), [head, [100, 110, 120, 128].repeat(256 * 512)].concat()).unwrap();
    for number in 0..1000 {
        std::fs::hard_link(maps.join("b.hdr"), maps.join(format!("c{number}.hdr"))).unwrap();
    }
    let mut command = Command::new(PROGRAM);
    command.args(["dataset", "plan", "--seed", "1", "--sequences", "1", "--hdris"]).arg(&maps).arg("--out").arg(&plan);
    let mut child = command.stderr(Stdio::piped()).spawn().unwrap();
    let (mut said, mut errors) = (String::new(), BufReader::new(child.stderr.take().unwrap()));
    errors.read_line(&mut said).unwrap();
    assert!(said.contains("a.hdr"), "{said}");
    assert!(Command::new("kill").args(["-TERM", &child.id().to_string()]).status().unwrap().success());
    errors.read_to_string(&mut said).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(75), "{said}");
    assert!(said.contains("interrupted") && !plan.exists(), "{said}");
}

/// A plan of many sequences takes long to look through.
#[test]
fn statistics_heed_the_first_signal() {
    let folder = tempfile::tempdir().unwrap();
    let plan = folder.path().join("plan.json");
    let mut command = Command::new(PROGRAM);
    command.args(["dataset", "plan", "--seed", "1", "--sequences", "1000000", "--out"]).arg(plan);
    assert!(command.output().unwrap().status.success());
    for step in 0..6 {
        let mut command = Command::new(PROGRAM);
        command.args(["dataset", "stats"]).arg(folder.path()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let output = interrupted(command.spawn().unwrap(), Duration::from_millis(100 << step));
        // Before it listens the signal is the system's.
        if output.status.code().is_some() {
            assert_eq!(output.status.code(), Some(75), "{}", stderr(&output));
            assert!(stderr(&output).contains("interrupted") && !folder.path().join("stats.html").exists());
            return;
        }
    }
    panic!("it never listened");
}
