//! Runs the program as a user does.

use std::process::{Command, Output};

/// Runs `renderflow-bench` with `args`.
pub fn bench(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_renderflow-bench")).args(args).output().expect("the program starts")
}

/// Standard error as text.
pub fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Runs `renderflow-bench` and expects success.
pub fn succeed(args: &[&str]) -> String {
    let output = bench(args);
    assert!(output.status.success(), "renderflow-bench {args:?}: {}", stderr(&output));
    String::from_utf8_lossy(&output.stdout).into_owned()
}
