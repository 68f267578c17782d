//! Turns panics into errors: one broken piece of work must not end all others.

use anyhow::{Result, bail};
use std::panic::{AssertUnwindSafe, catch_unwind};

/// The message of a caught panic.
pub fn message(payload: &(dyn std::any::Any + Send)) -> String {
    let text = payload.downcast_ref::<&str>().map(|s| (*s).to_owned());
    text.or_else(|| payload.downcast_ref::<String>().cloned()).unwrap_or_else(|| "a panic without a message".into())
}

/// The result of `work`. A panic in it becomes an error.
///
/// # Errors
/// As `work`; for a panic, with its message.
pub fn guarded<T>(work: impl FnOnce() -> Result<T>) -> Result<T> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|payload| bail!("panic: {}", message(payload.as_ref())))
}
