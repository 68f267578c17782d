//! The log on standard error: which files are read, how large scenes are, what is compiled, and how long stages take. It is off
//! unless the user asks for it.

use crate::util::console;
use std::io::Write;
use tracing::Level;
use tracing_subscriber::filter::Targets;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

/// The environment variable that chooses what is logged, such as `debug` or `renderflow::dataset=debug`. It overrides `-v`.
pub const VARIABLE: &str = "RENDERFLOW_LOG";

/// Starts the log: with `verbose` 1 what happens to a scene, with 2 also what happens to each frame. Returns whether anything is
/// logged.
///
/// # Errors
/// When [`VARIABLE`] is no filter; the message says why.
pub fn start(verbose: u8) -> Result<bool, String> {
    let filter = match (std::env::var(VARIABLE), verbose) {
        (Ok(filter), _) if !filter.is_empty() => filter.parse::<Targets>().map_err(|e| format!("{VARIABLE}={filter}: {e}"))?,
        (_, 0) => return Ok(false),
        (_, 1) => Targets::new().with_target("renderflow", Level::INFO),
        _ => Targets::new().with_target("renderflow", Level::DEBUG),
    };
    let lines = tracing_subscriber::fmt::layer()
        .with_writer(|| Lines)
        .with_ansi(false)
        .with_target(false)
        .with_timer(tracing_subscriber::fmt::time::uptime())
        .log_internal_errors(false);
    // A second start in one process changes nothing.
    let _ = tracing_subscriber::registry().with(filter).with(lines).try_init();
    Ok(true)
}

/// Standard error, whose loss is no error.
struct Lines;

impl Write for Lines {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        console::err(format_args!("{}", String::from_utf8_lossy(bytes)));
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}
