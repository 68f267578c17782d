//! `renderflow stress`: lists, runs, writes JSON, goes on from it, and can be stopped.

mod common;

use common::{renderflow, stderr, succeed};

#[test]
fn checks_are_listed() {
    let text = succeed(&["stress", "--list"]);
    for name in ["sampler.uniform", "film.sums", "determinism.threads", "scale.size", "analytic.path"] {
        assert!(text.lines().any(|line| line.starts_with(name)), "{text}");
    }
    assert_eq!(succeed(&["stress", "--list", "--only", "film"]).lines().count(), 2);
    assert!(stderr(&renderflow(&["stress", "--only", "no-such-check"])).contains("no such check"));
}

#[test]
fn results_are_written_and_gone_on_from() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("results/stress.json");
    let args = ["stress", "--quick", "--only", "film", "--out", out.to_str().unwrap()];
    let table = succeed(&args);
    assert!(table.contains("film.sums") && table.contains("film.merge") && !table.contains("sampler"), "{table}");
    let read = || -> serde_json::Value { serde_json::from_slice(&std::fs::read(&out).unwrap()).unwrap() };
    let first = read();
    assert_eq!((&first["passed"], &first["effort"]), (&true.into(), &"quick".into()));
    let outcome = &first["checks"][0]["outcomes"][0];
    for key in ["name", "cases", "worst", "limit", "passed", "detail"] {
        assert!(!outcome[key].is_null(), "{outcome}");
    }

    // A finished check is not run again: a mark left in its result stays. What was not run yet is.
    let mut marked = first.clone();
    marked["checks"][0]["seconds"] = 12345.0.into();
    marked["checks"].as_array_mut().unwrap().truncate(1);
    std::fs::write(&out, marked.to_string()).unwrap();
    assert!(succeed(&args).contains("12345.0"));
    let second = read();
    assert_eq!(second["checks"][0]["seconds"], 12345.0);
    assert_eq!(second["checks"][1]["name"], first["checks"][1]["name"]);
    // Unless asked for.
    succeed(&[&args[..], &["--again"]].concat());
    assert_ne!(read()["checks"][0]["seconds"], 12345.0);

    // A failed claim is a failed run, also when it is only remembered.
    marked["checks"][0]["outcomes"][0]["passed"] = false.into();
    std::fs::write(&out, marked.to_string()).unwrap();
    let output = renderflow(&args);
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains("1 of 2 checks failed"), "{}", stderr(&output));
    assert_eq!(read()["passed"], false);

    // Another file is not overwritten.
    std::fs::write(&out, "{\"mine\": 1}").unwrap();
    assert_eq!(renderflow(&args).status.code(), Some(1));
    assert_eq!(std::fs::read_to_string(&out).unwrap(), "{\"mine\": 1}");
}

/// An interrupt ends the run within the check under way, exit code 75, and what is finished is kept.
#[test]
#[cfg(unix)]
fn an_interrupt_is_resumable() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("stress.json");
    let mut child = std::process::Command::new(env!("CARGO_BIN_EXE_renderflow"))
        .args(["stress", "--only", "film", "--only", "analytic", "--out", out.to_str().unwrap()])
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::null())
        .spawn()
        .unwrap();
    // The film is done in a second, the scenes take much longer.
    while !std::fs::read_to_string(&out).is_ok_and(|text| text.contains("film.merge")) {
        assert!(child.try_wait().unwrap().is_none(), "ended by itself");
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    let killed = std::process::Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(killed.success());
    assert_eq!(child.wait().unwrap().code(), Some(75));
    let text = std::fs::read_to_string(&out).unwrap();
    assert!(text.contains("film.sums") && !text.contains("analytic"), "{text}");
}
