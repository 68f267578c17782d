//! Output that never ends a job: when standard output or standard error is a closed pipe or a full disk, lines are lost but work
//! is not.
//!
//! The macros below replace those of the standard library, which panic when a line cannot be written. They are in scope in the
//! whole crate, so that nobody uses the others by accident.

use std::fmt::Arguments;
use std::io::{ErrorKind, Write};
use std::sync::Mutex;

/// The first error on standard output. Nothing is written after it.
static FAILED: Mutex<Option<std::io::Error>> = Mutex::new(None);

/// Prints a line of results on standard output; see [`console`](crate::util::console).
#[macro_export]
macro_rules! println {
    () => { $crate::util::console::out(format_args!("\n")) };
    ($($argument:tt)*) => { $crate::util::console::out(format_args!("{}\n", format_args!($($argument)*))) };
}

/// Prints results on standard output; see [`console`](crate::util::console).
#[macro_export]
macro_rules! print {
    ($($argument:tt)*) => { $crate::util::console::out(format_args!($($argument)*)) };
}

/// Prints a line for people on standard error; see [`console`](crate::util::console).
#[macro_export]
macro_rules! eprintln {
    ($($argument:tt)*) => { $crate::util::console::err(format_args!("{}\n", format_args!($($argument)*))) };
}

/// Writes to standard output, unless that has failed before.
pub fn out(text: Arguments<'_>) {
    let mut failed = FAILED.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    if failed.is_none() {
        let mut out = std::io::stdout().lock();
        *failed = out.write_fmt(text).and_then(|()| out.flush()).err();
    }
}

/// Writes to standard error. If that fails, nobody can be told.
pub fn err(text: Arguments<'_>) {
    // One call for each text, so that lines of several threads do not mix.
    let _ = std::io::stderr().lock().write_all(text.to_string().as_bytes());
}

/// Whether standard output has failed: nobody reads it, or it cannot take more. A command that only lists things may end then.
pub fn is_closed() -> bool {
    FAILED.lock().unwrap_or_else(std::sync::PoisonError::into_inner).is_some()
}

/// The error that lost output, such as a full disk. A reader that has seen enough (`
/// head`) is not an error.
pub fn lost_output() -> Option<std::io::Error> {
    let failed = FAILED.lock().unwrap_or_else(std::sync::PoisonError::into_inner).take()?;
    (failed.kind() != ErrorKind::BrokenPipe).then_some(failed)
}

/// The error and its causes in one line. Many libraries quote the cause in the error; such a cause is not repeated.
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
