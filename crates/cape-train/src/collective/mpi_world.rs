//! Processes by MPI.

use std::{
    fmt,
    sync::{Mutex, MutexGuard, PoisonError},
    thread,
    time::Duration,
};

use mpi::{
    Threading,
    environment::Universe,
    topology::SimpleCommunicator,
    traits::{Communicator, CommunicatorCollectives, Root},
};

use super::Collective;
use crate::{Error, Result};

/// Time between two looks at a wait for other processes.
const LOOK: Duration = Duration::from_millis(1);

/// All processes that `mpirun` or `srun` started, by MPI. MPI ends when it is dropped, which waits for the
/// other processes; in a panic it ends all of them.
///
/// ```no_run
/// use cape_train::collective::{Collective, MpiWorld};
///
/// let world = MpiWorld::join()?;
/// let mut values = [world.rank() as f32];
/// world.sum(&mut values)?;
/// # Ok::<(), cape_train::Error>(())
/// ```
pub struct MpiWorld {
    rank: usize,
    size: usize,
    /// One call at a time; the values that are sent and received.
    state: Mutex<State>,
}

struct State {
    universe: Universe,
    sent: Vec<f32>,
    received: Vec<f32>,
}

impl fmt::Debug for MpiWorld {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.debug_struct("MpiWorld")
            .field("rank", &self.rank)
            .field("size", &self.size)
            .finish_non_exhaustive()
    }
}

impl MpiWorld {
    /// Initialises MPI, which a process can do once.
    ///
    /// # Errors
    /// If it has been initialised before.
    pub fn join() -> Result<Self> {
        let Some((universe, _)) = mpi::initialize_with_threading(Threading::Serialized) else {
            return Err(Error::Processes("MPI was initialised before in this process".into()));
        };
        let world = universe.world();
        let (rank, size) = (world.rank() as usize, world.size() as usize);
        let state = State { universe, sent: Vec::new(), received: Vec::new() };
        Ok(Self { rank, size, state: Mutex::new(state) })
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Collective for MpiWorld {
    fn rank(&self) -> usize {
        self.rank
    }

    fn size(&self) -> usize {
        self.size
    }

    /// Each process adds one piece of the values and sends the sums to the others.
    fn sum(&self, values: &mut [f32]) -> Result<()> {
        let State { universe, sent, received } = &mut *self.state();
        let world = universe.world();
        let piece = values.len().div_ceil(self.size);
        let padded = piece * self.size;
        sent.clear();
        sent.extend_from_slice(values);
        sent.resize(padded, 0.0);
        received.resize(padded, 0.0);
        world.all_to_all_into(&sent[..], &mut received[..]);
        let (sums, others) = received.split_at_mut(piece);
        for other in others.chunks_exact(piece.max(1)) {
            for (sum, value) in sums.iter_mut().zip(other) {
                *sum += value;
            }
        }
        world.all_gather_into(&*sums, &mut sent[..]);
        values.copy_from_slice(&sent[..values.len()]);
        Ok(())
    }

    fn broadcast(&self, bytes: &mut [u8]) -> Result<()> {
        self.state().universe.world().process_at_rank(0).broadcast_into(bytes);
        Ok(())
    }

    fn wait(&self) -> Result<()> {
        let world = self.state().universe.world();
        // MPI's own barrier keeps a core busy.
        let mut pending = world.immediate_barrier();
        while let Err(request) = pending.test() {
            pending = request;
            thread::sleep(LOOK);
        }
        Ok(())
    }

    fn abort(&self, code: i32) -> ! {
        // Without the lock: another thread may be within a call.
        SimpleCommunicator::world().abort(code)
    }
}

impl Drop for MpiWorld {
    fn drop(&mut self) {
        if thread::panicking() {
            self.abort(101);
        }
    }
}
