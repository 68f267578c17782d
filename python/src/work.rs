//! Long work: outside the interpreter's lock, and stopped by Ctrl-C.

use pyo3::exceptions::PyException;
use pyo3::prelude::*;
use renderflow::util::cancel::Cancel;
use std::sync::OnceLock;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::Duration;

pyo3::create_exception!(renderflow, Error, PyException, "Something cannot be read, rendered or compared. The message says why.");

/// Time between two looks at the signals of the process.
const PATIENCE: Duration = Duration::from_millis(50);
/// Stack of the thread that works: that of a main thread.
const STACK: usize = 8 << 20;

/// An error of the library as one of Python.
pub fn failed(error: impl Into<anyhow::Error>) -> PyErr {
    Error::new_err(format!("{:#}", error.into()))
}

/// Refuses work in a process that was forked from one whose threads had started, because they do not live on in it.
///
/// # Errors
/// Says how to start such a process instead.
fn own_threads() -> PyResult<()> {
    static FIRST: OnceLock<u32> = OnceLock::new();
    let own = std::process::id();
    if *FIRST.get_or_init(|| own) == own {
        return Ok(());
    }
    Err(Error::new_err(
        "this process was forked from one that had used the renderer, and has none of its threads; start processes with the method \"spawn\"",
    ))
}

/// Does `work` in a thread of its own. Python's signals are handled meanwhile; an exception of theirs, such as
/// `KeyboardInterrupt`, stops the work and is raised.
pub fn run<T: Send>(py: Python<'_>, work: impl FnOnce(&Cancel) -> anyhow::Result<T> + Send) -> PyResult<T> {
    own_threads()?;
    let cancel = Cancel::default();
    let (sender, mut receiver) = mpsc::channel();
    let flag = cancel.clone();
    thread::scope(|scope| {
        let spawned = thread::Builder::new().stack_size(STACK).spawn_scoped(scope, move || {
            // The receiver waits until the scope ends.
            let _ = sender.send(work(&flag));
        });
        let worker = spawned?;
        let mut raised = None;
        loop {
            let received;
            (receiver, received) = py.detach(move || {
                let received = receiver.recv_timeout(PATIENCE);
                (receiver, received)
            });
            match received {
                Err(RecvTimeoutError::Timeout) => {
                    if raised.is_none() {
                        raised = py.check_signals().err();
                        if raised.is_some() {
                            cancel.set();
                        }
                    }
                }
                Err(RecvTimeoutError::Disconnected) => {
                    // Joined here, a panic, which has printed its reason, becomes an ordinary exception.
                    let _ = worker.join();
                    return Err(Error::new_err("the work ended without a result: this is a bug"));
                }
                Ok(result) => return raised.map_or_else(|| result.map_err(failed), Err),
            }
        }
    })
}
