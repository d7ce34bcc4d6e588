//! Threads in the place of processes, for tests.

use std::sync::{Arc, Barrier, Mutex, MutexGuard};

use super::Collective;
use crate::Result;

/// One of several threads that train together.
pub(crate) struct ThreadWorld {
    rank: usize,
    shared: Arc<Shared>,
}

struct Shared {
    barrier: Barrier,
    values: Mutex<Vec<Vec<f32>>>,
    bytes: Mutex<Vec<u8>>,
}

impl ThreadWorld {
    fn values(&self) -> MutexGuard<'_, Vec<Vec<f32>>> {
        self.shared.values.lock().unwrap()
    }
}

/// Runs `work` in `size` threads, and returns their results in order.
pub(crate) fn in_threads<T: Send>(
    size: usize,
    work: impl Fn(Arc<dyn Collective>) -> T + Sync,
) -> Vec<T> {
    let shared = Arc::new(Shared {
        barrier: Barrier::new(size),
        values: Mutex::new(vec![Vec::new(); size]),
        bytes: Mutex::new(Vec::new()),
    });
    let work = &work;
    std::thread::scope(|scope| {
        let spawn = |rank| {
            let world = Arc::new(ThreadWorld { rank, shared: shared.clone() });
            scope.spawn(move || work(world))
        };
        let threads: Vec<_> = (0..size).map(spawn).collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect()
    })
}

impl Collective for ThreadWorld {
    fn rank(&self) -> usize {
        self.rank
    }

    fn size(&self) -> usize {
        self.values().len()
    }

    fn sum(&self, values: &mut [f32]) -> Result<()> {
        self.values()[self.rank] = values.to_vec();
        self.wait()?;
        {
            let all = self.values();
            values.copy_from_slice(&all[0]);
            for other in &all[1..] {
                values.iter_mut().zip(other).for_each(|(sum, value)| *sum += value);
            }
        }
        self.wait()
    }

    fn broadcast(&self, bytes: &mut [u8]) -> Result<()> {
        if self.rank == 0 {
            *self.shared.bytes.lock().unwrap() = bytes.to_vec();
        }
        self.wait()?;
        bytes.copy_from_slice(&self.shared.bytes.lock().unwrap());
        self.wait()
    }

    fn wait(&self) -> Result<()> {
        self.shared.barrier.wait();
        Ok(())
    }

    fn abort(&self, code: i32) -> ! {
        std::process::exit(code)
    }
}
