//! The flag that asks long work to stop, and the error of work that has stopped.

use std::ops::Deref;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// The user stopped the work. What is finished stays, and the same command continues (exit code 75).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Interrupted;

impl std::fmt::Display for Interrupted {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("interrupted; run the same command again to go on")
    }
}

impl std::error::Error for Interrupted {}

/// A flag that is set once, when the user wants the work to stop. Clones share the flag. The renderer and the networks take it as
/// the atomic that it holds.
#[derive(Clone, Debug, Default)]
pub struct Cancel(Arc<AtomicBool>);

impl Cancel {
    /// Asks for a stop. Returns whether one was asked for before.
    pub fn set(&self) -> bool {
        self.0.swap(true, Ordering::SeqCst)
    }

    /// Whether a stop was asked for.
    pub fn is_set(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    /// Call it between the steps of long work.
    ///
    /// # Errors
    /// [`Interrupted`] when a stop was asked for.
    pub fn check(&self) -> Result<(), Interrupted> {
        if self.is_set() { Err(Interrupted) } else { Ok(()) }
    }
}

impl Deref for Cancel {
    type Target = AtomicBool;

    fn deref(&self) -> &AtomicBool {
        &self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clones_share_the_flag() {
        let (cancel, clone) = (Cancel::default(), Cancel::default());
        let shared = cancel.clone();
        assert_eq!(cancel.check(), Ok(()));
        assert!(!shared.set() && shared.set());
        assert_eq!(cancel.check(), Err(Interrupted));
        assert!(!clone.is_set(), "another flag was set too");
    }
}
