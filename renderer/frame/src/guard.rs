//! Decoders of other crates, some of which panic at damaged data.

use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind, set_hook, take_hook};
use std::sync::Once;

thread_local! {
    /// Whether this thread runs a decoder.
    static DECODES: Cell<bool> = const { Cell::new(false) };
}

/// What `decode` returns; `None` where it panics, about which nothing is printed. It must work on bytes in memory, in one thread,
/// and keep nothing, so that unwinding leaves no broken state behind.
pub fn guarded<T>(decode: impl FnOnce() -> T) -> Option<T> {
    static QUIET: Once = Once::new();
    QUIET.call_once(|| {
        let others = take_hook();
        set_hook(Box::new(move |info| {
            if !DECODES.get() {
                others(info);
            }
        }));
    });
    let outer = DECODES.replace(true);
    let decoded = catch_unwind(AssertUnwindSafe(decode));
    DECODES.set(outer);
    decoded.ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn panics_become_nothing_and_leave_later_ones_as_they_are() {
        assert_eq!(guarded(|| 1), Some(1));
        assert_eq!(guarded(|| -> u32 { panic!("this must not be seen") }), None);
        assert_eq!(guarded(|| guarded(|| -> u32 { panic!("nor this") }).is_none()), Some(true));
        assert!(!DECODES.get());
    }
}
