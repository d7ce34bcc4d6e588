//! Processes that train one model together, each on its part of every batch.
//!
//! A training by several processes is one with their whole batch: the gradients of all parts are summed
//! before they are used, in the order of the processes, so that every process makes the same update.
//! [`Trainer::create_together`](crate::Trainer::create_together) and
//! [`resume_together`](crate::Trainer::resume_together) take the processes as a [`Collective`]; [`join`]
//! makes it of what a launcher such as `mpirun` started.

mod launch;
#[cfg(feature = "mpi")]
mod mpi_world;
mod step;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod threads;

use std::sync::Arc;

pub use launch::Launch;
#[cfg(feature = "mpi")]
pub use mpi_world::MpiWorld;

pub(crate) use step::{StepAgreement, require_same_weights, sum_step};

use crate::{Error, Result};

/// A group of processes, numbered from 0.
///
/// All of them call `sum`, `broadcast` and `wait` in the same order; a call returns when all have made it.
///
/// ```
/// use cape_train::collective::{Collective, SingleProcess};
///
/// let mut values = [1.0, 2.0];
/// SingleProcess.sum(&mut values)?;
/// assert_eq!(values, [1.0, 2.0]);
/// assert_eq!((SingleProcess.rank(), SingleProcess.size()), (0, 1));
/// # Ok::<(), cape_train::Error>(())
/// ```
pub trait Collective: Send + Sync {
    /// Number of this process.
    fn rank(&self) -> usize;

    /// Number of processes.
    fn size(&self) -> usize;

    /// Replaces `values` by their sums over all processes, added in the order of their numbers: the same
    /// bits in every process. All give the same number of values.
    fn sum(&self, values: &mut [f32]) -> Result<()>;

    /// Replaces `bytes` by those of process 0. All give the same number of bytes.
    fn broadcast(&self, bytes: &mut [u8]) -> Result<()>;

    /// Waits for all processes, for as long as it takes, without using the processor.
    fn wait(&self) -> Result<()>;

    /// Ends all processes with the exit code `code`.
    fn abort(&self, code: i32) -> !;
}

/// A training by one process.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct SingleProcess;

impl Collective for SingleProcess {
    fn rank(&self) -> usize {
        0
    }

    fn size(&self) -> usize {
        1
    }

    fn sum(&self, _: &mut [f32]) -> Result<()> {
        Ok(())
    }

    fn broadcast(&self, _: &mut [u8]) -> Result<()> {
        Ok(())
    }

    fn wait(&self) -> Result<()> {
        Ok(())
    }

    fn abort(&self, code: i32) -> ! {
        std::process::exit(code)
    }
}

/// Joins the processes that a launcher started together with this one.
///
/// ```
/// use cape_train::collective::{Launch, join};
///
/// // Nothing but this process.
/// let processes = join(None)?;
/// assert_eq!(processes.size(), 1);
/// # Ok::<(), cape_train::Error>(())
/// ```
///
/// # Errors
/// If there are several, and the crate is built without the feature `mpi`, or with another MPI than the
/// launcher's.
pub fn join(launch: Option<&Launch>) -> Result<Arc<dyn Collective>> {
    match launch {
        Some(launch) if launch.size > 1 => join_several(launch),
        _ => Ok(Arc::new(SingleProcess)),
    }
}

#[cfg(feature = "mpi")]
fn join_several(launch: &Launch) -> Result<Arc<dyn Collective>> {
    let world = MpiWorld::join()?;
    if world.size() == launch.size {
        return Ok(Arc::new(world));
    }
    let Launch { launcher, size, variable, .. } = launch;
    let found = world.size();
    Err(Error::Processes(format!(
        "{launcher} started {size} processes ({variable}), but MPI knows of {found}: launch with the MPI that \
         the program was built with, such as its mpirun, or srun --mpi=pmix"
    )))
}

#[cfg(not(feature = "mpi"))]
fn join_several(launch: &Launch) -> Result<Arc<dyn Collective>> {
    let Launch { launcher, size, variable, rank, .. } = launch;
    Err(Error::Processes(format!(
        "process {rank} of {size} that {launcher} started, but this program was built without MPI: build it \
         with `--features mpi`, or unset {variable} for a training of its own"
    )))
}

/// Runs `work` in process 0 while the others wait; its result is there alone.
///
/// # Errors
/// In all processes if `work` fails: its error in process 0, [`Error::Processes`] in the others.
pub fn in_first<T>(
    processes: &dyn Collective,
    work: impl FnOnce() -> Result<T>,
) -> Result<Option<T>> {
    if processes.size() == 1 {
        return work().map(Some);
    }
    let result = (processes.rank() == 0).then(work).transpose();
    processes.wait()?;
    let mut failed = [u8::from(result.is_err())];
    processes.broadcast(&mut failed)?;
    match result {
        Ok(_) if failed != [0] => Err(elsewhere(&[0])),
        result => result,
    }
}

/// The result of every process's own work, if none failed.
///
/// # Errors
/// In all processes if one has an error: that of the first of them there, [`Error::Processes`] in the others.
pub(crate) fn agree<T>(processes: &dyn Collective, result: Result<T>) -> Result<T> {
    if processes.size() == 1 {
        return result;
    }
    processes.wait()?;
    let failed = ranks_where(processes, result.is_err())?;
    match failed.first() {
        Some(&first) if first != processes.rank() => Err(elsewhere(&[first])),
        _ => result,
    }
}

/// The processes in which `condition` holds.
pub(crate) fn ranks_where(processes: &dyn Collective, condition: bool) -> Result<Vec<usize>> {
    let mut flags = vec![0.0; processes.size()];
    flags[processes.rank()] = f32::from(u8::from(condition));
    processes.sum(&mut flags)?;
    Ok(raised(&flags))
}

/// Indices of the flags that are not 0.
fn raised(flags: &[f32]) -> Vec<usize> {
    flags.iter().enumerate().filter(|(_, flag)| **flag != 0.0).map(|(rank, _)| rank).collect()
}

/// The error of a process in which nothing went wrong, while it did in `ranks`.
pub(crate) fn elsewhere(ranks: &[usize]) -> Error {
    Error::Processes(format!("{} failed and ended the training", named(ranks)))
}

/// The processes in words.
pub(crate) fn named(ranks: &[usize]) -> String {
    let word = if ranks.len() == 1 { "process" } else { "processes" };
    let ranks: Vec<String> = ranks.iter().map(usize::to_string).collect();
    format!("{word} {}", ranks.join(", "))
}
