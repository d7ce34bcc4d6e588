//! Work for the calling thread and rayon's.

use std::sync::{
    Mutex, MutexGuard, PoisonError,
    atomic::{AtomicUsize, Ordering},
};

/// Results of `work` for each of `tasks` and its index, in their order.
///
/// The calling thread works along instead of waiting for others to take over, which takes milliseconds
/// where they share their cores with threads that wait actively, as those of OpenMP do.
pub(super) fn share<T: Send, R: Send>(
    tasks: Vec<T>,
    work: impl Fn(usize, T) -> R + Sync,
) -> Vec<R> {
    let helpers = rayon::current_num_threads().min(tasks.len()).saturating_sub(1);
    if helpers == 0 {
        return tasks.into_iter().enumerate().map(|(at, task)| work(at, task)).collect();
    }
    let tasks: Vec<_> = tasks.into_iter().map(|task| Mutex::new((Some(task), None))).collect();
    let next = AtomicUsize::new(0);
    let run = || {
        loop {
            let at = next.fetch_add(1, Ordering::Relaxed);
            let Some(slot) = tasks.get(at) else { return };
            let task = lock(slot).0.take();
            let found = task.map(|task| work(at, task));
            lock(slot).1 = found;
        }
    };
    rayon::in_place_scope(|scope| {
        for _ in 0..helpers {
            scope.spawn(|_| run());
        }
        run();
    });
    let results = tasks.into_iter().map(Mutex::into_inner);
    results.filter_map(|slot| slot.unwrap_or_else(PoisonError::into_inner).1).collect()
}

fn lock<T>(slot: &Mutex<T>) -> MutexGuard<'_, T> {
    slot.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use rayon::ThreadPoolBuilder;

    use super::*;

    #[test]
    fn every_task_runs_once_and_results_keep_its_place() {
        for threads in 1..4 {
            let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            for count in [0, 1, 2, 1000] {
                let ran = AtomicUsize::new(0);
                let work = |at: usize, task: usize| {
                    ran.fetch_add(1, Ordering::Relaxed);
                    assert_eq!(task, at + 7);
                    task * task
                };
                let tasks: Vec<usize> = (7..7 + count).collect();
                let expected: Vec<usize> = tasks.iter().map(|task| task * task).collect();
                // From a thread of the pool, and from one that is none.
                assert_eq!(pool.install(|| share(tasks.clone(), work)), expected);
                assert_eq!(share(tasks, work), expected);
                assert_eq!(ran.into_inner(), 2 * count);
            }
        }
    }
}
