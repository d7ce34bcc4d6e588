//! Independent fits side by side on the CPU's threads.

use std::sync::{
    Mutex, PoisonError,
    atomic::{AtomicUsize, Ordering},
    mpsc,
};

use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::{Error, Result};

/// Workers that share the threads of the current thread pool.
///
/// One fit hardly uses two threads: a batch of one is small, and much of a step is sequential.
/// Results do not depend on the number of workers.
///
/// ```
/// use cape_fit::FitWorkers;
///
/// let mut done = 0;
/// let squares = FitWorkers::new()?.map(&[1, 2, 3], |_, x| x * x, &mut || done += 1);
/// assert_eq!((squares, done), (vec![1, 4, 9], 3));
/// # Ok::<(), cape_fit::Error>(())
/// ```
#[derive(Debug)]
pub struct FitWorkers {
    /// Thread pools, one for each worker; none for work on the calling thread.
    pools: Vec<ThreadPool>,
}

impl FitWorkers {
    /// One worker for each thread of the current pool.
    ///
    /// # Errors
    /// If no threads can be started.
    pub fn new() -> Result<Self> {
        let threads = rayon::current_num_threads();
        if threads < 2 {
            return Ok(Self::sequential());
        }
        let pool = || {
            let pool = ThreadPoolBuilder::new().num_threads(1).build();
            pool.map_err(|error| Error::Failed(format!("cannot start a thread: {error}")))
        };
        Ok(Self { pools: (0..threads).map(|_| pool()).collect::<Result<_>>()? })
    }

    /// The calling thread, with all threads of its pool for each item.
    pub const fn sequential() -> Self {
        Self { pools: Vec::new() }
    }

    /// Results of `work` on each index and item, in the order of the items; `progress` is called on
    /// the calling thread after each.
    pub fn map<T: Sync, R: Send>(
        &self,
        items: &[T],
        work: impl Fn(usize, &T) -> R + Sync,
        progress: &mut dyn FnMut(),
    ) -> Vec<R> {
        if self.pools.is_empty() || items.len() < 2 {
            let run = |(at, item)| {
                let result = work(at, item);
                progress();
                result
            };
            return items.iter().enumerate().map(run).collect();
        }
        let next = AtomicUsize::new(0);
        let results: Mutex<Vec<Option<R>>> = Mutex::new(items.iter().map(|_| None).collect());
        let keep = |at: usize, result: R| {
            results.lock().unwrap_or_else(PoisonError::into_inner)[at] = Some(result);
        };
        std::thread::scope(|scope| {
            let (sender, finished) = mpsc::channel();
            for pool in &self.pools {
                let (sender, next, work, keep) = (sender.clone(), &next, &work, &keep);
                scope.spawn(move || {
                    pool.install(|| {
                        loop {
                            let at = next.fetch_add(1, Ordering::Relaxed);
                            let Some(item) = items.get(at) else { break };
                            keep(at, work(at, item));
                            // The receiver lives as long as the scope.
                            sender.send(()).ok();
                        }
                    });
                });
            }
            drop(sender);
            for () in finished {
                progress();
            }
        });
        // The scope has passed on the panic of a worker: every place is filled.
        results.into_inner().unwrap_or_else(PoisonError::into_inner).into_iter().flatten().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_are_in_order_for_any_number_of_workers() {
        let items: Vec<usize> = (0..50).collect();
        for threads in [1, 2, 5] {
            let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let mut finished = 0;
            let found = pool.install(|| {
                let workers = FitWorkers::new().unwrap();
                // Work inside a worker is sequential.
                workers.map(
                    &items,
                    |at, item| (at, item * item, rayon::current_num_threads()),
                    &mut || finished += 1,
                )
            });
            let expected: Vec<_> = items.iter().map(|&item| (item, item * item, 1)).collect();
            assert_eq!((found, finished), (expected, 50));
        }
        assert!(FitWorkers::sequential().map(&[0; 0], |_, x| *x, &mut || {}).is_empty());
    }
}
