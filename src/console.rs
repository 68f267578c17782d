//! Output that never ends a job: a closed pipe or a full disk behind standard output or standard error costs lines, not work.
//!
//! The macros below stand in for those of the standard library, which panic when a line cannot be written. They are in scope in
//! the whole crate, and in crates that import them with `#[macro_use]`, so no other form can be used by accident.

use std::fmt::Arguments;
use std::io::{ErrorKind, Write};
use std::sync::Mutex;

/// The first failure of writing to standard output. Nothing is written after it.
static FAILED: Mutex<Option<std::io::Error>> = Mutex::new(None);

/// Prints a line of results on standard output; see [`console`](crate::console).
#[macro_export]
macro_rules! println {
    () => { $crate::console::out(format_args!("\n")) };
    ($($argument:tt)*) => { $crate::console::out(format_args!("{}\n", format_args!($($argument)*))) };
}

/// Prints results on standard output; see [`console`](crate::console).
#[macro_export]
macro_rules! print {
    ($($argument:tt)*) => { $crate::console::out(format_args!($($argument)*)) };
}

/// Prints a line for people on standard error; see [`console`](crate::console).
#[macro_export]
macro_rules! eprintln {
    ($($argument:tt)*) => { $crate::console::err(format_args!("{}\n", format_args!($($argument)*))) };
}

/// Writes to standard output, unless that has failed before.
pub fn out(text: Arguments<'_>) {
    let mut failed = FAILED.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    if failed.is_none() {
        let mut out = std::io::stdout().lock();
        *failed = out.write_fmt(text).and_then(|()| out.flush()).err();
    }
}

/// Writes to standard error. Nobody can be told when that fails.
pub fn err(text: Arguments<'_>) {
    // In one piece: lines of several threads do not mix.
    let _ = std::io::stderr().lock().write_all(text.to_string().as_bytes());
}

/// Whether nobody reads standard output any more, or it cannot take more. A command that only lists things may end.
pub fn is_closed() -> bool {
    FAILED.lock().unwrap_or_else(std::sync::PoisonError::into_inner).is_some()
}

/// The error that lost output, for instance of a full disk. A reader who has seen enough (`| head`) is no error.
pub fn lost_output() -> Option<std::io::Error> {
    let failed = FAILED.lock().unwrap_or_else(std::sync::PoisonError::into_inner).take()?;
    (failed.kind() != ErrorKind::BrokenPipe).then_some(failed)
}

/// The error and its causes in one line, without saying anything twice: many errors of libraries quote their cause, and are followed by it.
pub fn message(error: &anyhow::Error) -> String {
    let mut text = String::new();
    for cause in error.chain() {
        let cause = cause.to_string();
        if text.ends_with(&cause) {
            continue;
        }
        if !text.is_empty() {
            text.push_str(": ");
        }
        text.push_str(&cause);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use anyhow::{Context, anyhow};

    #[test]
    fn causes_are_said_once() {
        let missing = || std::io::Error::from(ErrorKind::NotFound);
        let of_frame = renderflow_frame::Error::io("x.json", "read")(missing());
        let error = anyhow::Error::from(of_frame).context("/environment");
        assert_eq!(message(&error), "/environment: x.json: cannot read: entity not found");
        let plain = Err::<(), _>(missing()).context("x.json: cannot read").unwrap_err();
        assert_eq!(message(&plain), "x.json: cannot read: entity not found");
        assert_eq!(message(&anyhow!("alone")), "alone");
    }
}
