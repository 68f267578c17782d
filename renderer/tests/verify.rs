//! Every check of the suite passes at its quick effort. `cargo test --test verify -- --nocapture` prints the worst values.

use renderflow_renderer::verify::{Effort, checks};

#[test]
fn quick_checks_pass() {
    let only = std::env::var("CHECK").unwrap_or_default();
    let effort = if std::env::var("EFFORT").is_ok_and(|e| e == "full") { Effort::Full } else { Effort::Quick };
    let mut failed = Vec::new();
    for check in checks().iter().filter(|c| c.name.contains(&only)) {
        let started = std::time::Instant::now();
        for outcome in check.outcomes(effort) {
            let line = format!(
                "{:<22} {}: {} cases, {:.3e} of {:.3e}; {}",
                check.name, outcome.name, outcome.cases, outcome.worst, outcome.limit, outcome.detail
            );
            println!("{} {line}", if outcome.passed { "  " } else { "! " });
            if !outcome.passed {
                failed.push(line);
            }
        }
        println!("   {:<22} {:.2} s", check.name, started.elapsed().as_secs_f64());
    }
    assert!(failed.is_empty(), "{}", failed.join("\n"));
}
