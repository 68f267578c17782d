//! Joins the processes that a launcher has started, by MPI.

use super::links::Links;
use crate::{Error, Result};

/// Without MPI, processes that were started together would train the same network into one folder.
#[cfg(not(feature = "mpi"))]
pub(super) fn join(variable: &str, size: usize) -> Result<Box<dyn Links>> {
    let reason = format!(
        "{variable} says that {size} processes were started to train together, but this program was built without MPI. Build it with \
         `cargo build --release --features mpi`, or start one process"
    );
    Err(Error::Team { reason })
}

/// What joins all `size` processes.
#[cfg(feature = "mpi")]
pub(super) fn join(variable: &str, size: usize) -> Result<Box<dyn Links>> {
    use mpi::traits::Communicator;
    // The thread that trains makes all calls.
    let started = mpi::initialize_with_threading(mpi::Threading::Funneled);
    let Some((universe, threading)) = started else {
        return Err(Error::Team { reason: "MPI has been started before in this process".into() });
    };
    if threading < mpi::Threading::Funneled {
        return Err(Error::Team { reason: "this MPI library does not work in programs with several threads".into() });
    }
    let found = universe.world().size() as usize;
    if found != size {
        let reason = format!(
            "{variable} says that {size} processes were started to train together, but MPI finds {found}. Start them with the mpirun \
             of the MPI library that this program was built with, or with `srun --mpi=pmix`"
        );
        return Err(Error::Team { reason });
    }
    Ok(Box::new(mpi_links::Mpi::new(universe)))
}

#[cfg(feature = "mpi")]
mod mpi_links {
    use crate::Result;
    use crate::train::links::{Links, Share};
    use mpi::environment::Universe;
    use mpi::topology::SimpleCommunicator;
    use mpi::traits::{Communicator, CommunicatorCollectives, Root};

    /// All processes of an MPI job. A failure of MPI ends them all, which is MPI's own default.
    pub(super) struct Mpi {
        world: SimpleCommunicator,
        /// Leaves MPI when it is dropped, and waits for the other processes to do so.
        _universe: Universe,
    }

    impl Mpi {
        pub(super) fn new(universe: Universe) -> Self {
            Self { world: universe.world(), _universe: universe }
        }
    }

    impl Links for Mpi {
        fn share(&self) -> Share {
            Share { rank: self.world.rank() as usize, size: self.world.size() as usize }
        }

        fn exchange(&self, sent: &[u8], received: &mut [u8]) -> Result<()> {
            self.world.all_to_all_into(sent, received);
            Ok(())
        }

        fn gather(&self, part: &[u8], all: &mut [u8]) -> Result<()> {
            self.world.all_gather_into(part, all);
            Ok(())
        }

        fn broadcast(&self, bytes: &mut [u8]) -> Result<()> {
            self.world.process_at_rank(0).broadcast_into(bytes);
            Ok(())
        }

        fn abort(&self, status: u8) {
            self.world.abort(status.into());
        }
    }
}
