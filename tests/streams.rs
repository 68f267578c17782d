//! Output that nobody reads, or that cannot be stored, costs lines and no work.
#![cfg(unix)]

mod common;

use common::{renderflow, succeed};
use std::path::Path;
use std::process::{Command, Stdio};

/// Where both streams of a command go.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Sink {
    /// A pipe whose reader has gone.
    Closed,
    /// A device that is always full.
    Full,
}

/// The sinks there are on this system.
fn sinks() -> Vec<Sink> {
    if Path::new("/dev/full").exists() {
        return vec![Sink::Closed, Sink::Full];
    }
    println!("skipped in part: no /dev/full");
    vec![Sink::Closed]
}

/// Exit code of `renderflow` with standard output and standard error going to `sink`.
fn into(sink: Sink, arguments: &[&str]) -> Option<i32> {
    let stream = || match sink {
        Sink::Closed => {
            // The reading end is dropped here.
            let (_, writer) = std::io::pipe().unwrap();
            Stdio::from(writer)
        }
        Sink::Full => Stdio::from(std::fs::File::options().write(true).open("/dev/full").unwrap()),
    };
    let program = env!("CARGO_BIN_EXE_renderflow");
    Command::new(program).args(arguments).stdin(Stdio::null()).stdout(stream()).stderr(stream()).status().unwrap().code()
}

/// Files of a folder that do not depend on the clock.
fn files(folder: &Path) -> Vec<(String, Vec<u8>)> {
    common::files(folder).into_iter().filter(|(name, _)| !name.ends_with("timing.json") && !name.starts_with("logs/")).collect()
}

#[test]
fn jobs_come_to_their_end_without_a_reader() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let plan = path("plan.json");
    let small = ["--frames", "2", "--resolution", "16", "--spp", "1", "--denoise", "none"];
    let counts = ["--seed", "8", "--sequences", "2", "--mesh-count", "8", "--environment-count", "4", "--out", &plan];
    succeed(&[&["dataset", "plan"][..], &counts, &small].concat());
    let data = path("data");
    succeed(&["dataset", "render", "--plan", &plan, "--out", &data]);
    let whole = files(&folder.path().join("data"));
    let render = |out: &str| {
        let words = [&["render", "--seed", "3", "--out", out][..], &small].concat();
        words.into_iter().map(str::to_owned).collect::<Vec<_>>()
    };
    let plain = path("plain");
    succeed(&render(&plain).iter().map(String::as_str).collect::<Vec<_>>());
    for sink in sinks() {
        // What was printed is lost where the disk is full, and the exit code says so.
        let done = if sink == Sink::Closed { Some(0) } else { Some(1) };
        let out = path(&format!("data-{sink:?}"));
        // Everything is said on standard error, which nobody can be told of.
        assert_eq!(into(sink, &["dataset", "render", "--plan", &plan, "--out", &out]), Some(0), "{sink:?}");
        assert!(files(Path::new(&out)) == whole, "{sink:?}: dataset render");
        let out = path(&format!("render-{sink:?}"));
        assert_eq!(into(sink, &render(&out).iter().map(String::as_str).collect::<Vec<_>>()), done, "{sink:?}");
        assert!(files(Path::new(&out)) == files(Path::new(&plain)), "{sink:?}: render");
        assert!(Path::new(&out).join("frame.0001.png").is_file(), "{sink:?}");
        let packed = path(&format!("packed-{sink:?}"));
        assert_eq!(into(sink, &["dataset", "pack", &data, "--out", &packed]), done, "{sink:?}");
        assert!(renderflow(&["dataset", "pack", "--verify", &packed]).status.success(), "{sink:?}: pack");
        for listing in [
            &["dataset", "pack", "--verify", &packed][..],
            &["dataset", "verify", &data],
            &["dataset", "stats", &data, "--json"],
            &["schema"],
            &["check", &data],
            &["weights"],
            &["compose", "--seed", "7"],
            &["evaluate", &plain, &plain, "--out", &path(&format!("results-{sink:?}"))],
        ] {
            assert_eq!(into(sink, listing), done, "{sink:?} {listing:?}");
        }
        assert!(Path::new(&path(&format!("results-{sink:?}/results.json"))).is_file());
        // A failure stays one.
        assert_eq!(into(sink, &["render", "--scene", &path("none.json"), "--out", &path("none")]), Some(1), "{sink:?}");
        assert_eq!(into(sink, &["--help"]), into(sink, &["--version"]), "{sink:?}");
    }
}
