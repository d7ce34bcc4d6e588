//! The processes that a launcher such as `mpirun` started to train together.

use std::{env, fs, sync::Arc, thread, time::Duration};

use burn::tensor::Device;
use cape_core::parse_device;
use cape_train::collective::{Collective, Launch, join};

use crate::{
    console::Console,
    error::{Error, Result, report},
    exit_code::ExitCode,
    options::GlobalArgs,
    use_threads,
};

/// Time that a process waits for the one that failed to say so and to end all.
const PATIENCE: Duration = Duration::from_secs(10);

/// This process and the others of the same training.
pub(super) struct Processes {
    launch: Option<Launch>,
    world: Arc<dyn Collective>,
}

impl Processes {
    /// Joins the processes that were started together with this one, if there are any.
    pub(super) fn join() -> Result<Self> {
        let launch = Launch::detect().filter(|launch| launch.size > 1);
        let world = join(launch.as_ref())?;
        Ok(Self { launch, world })
    }

    pub(super) fn world(&self) -> Arc<dyn Collective> {
        self.world.clone()
    }

    /// True in the process that writes files and reports.
    pub(super) fn is_first(&self) -> bool {
        self.world.rank() == 0
    }

    /// The console, silent in all but the first process.
    pub(super) fn console(&self, console: Console) -> Console {
        if self.is_first() { console } else { Console::new(false, true) }
    }

    /// Returns an error if there are several processes.
    pub(super) fn require_one(&self, what: &str) -> Result {
        let size = self.world.size();
        if size == 1 {
            return Ok(());
        }
        self.in_first(|| {
            Err(Error::message(format!("{what}: works in one process, but {size} were started")))
        })
    }

    /// The device, by default the card of this process's number on its host.
    pub(super) fn device(&self, global: &GlobalArgs) -> Result<Device> {
        match &self.launch {
            None => global.device(),
            Some(launch) => {
                let visible = env::var("CUDA_VISIBLE_DEVICES").ok();
                Ok(parse_device(&launch.device(&global.device, visible.as_deref()))?)
            }
        }
    }

    /// Gives this process its share of the host's cores, unless the number of threads was set.
    pub(super) fn use_threads(&self, global: &GlobalArgs, console: Console) -> Result {
        let Some(launch) = &self.launch else { return Ok(()) };
        if global.threads.is_some() || env::var_os("RAYON_NUM_THREADS").is_some() {
            return Ok(());
        }
        let allowed = thread::available_parallelism().map_or(1, usize::from);
        let cores = host_cores().unwrap_or(allowed);
        let threads = launch.threads(cores, allowed);
        let size = launch.size;
        console.note(&format!("{size} processes, {threads} threads each"));
        if allowed == 1 && cores > launch.local_size {
            console.note(&format!(
                "the launcher bound each process to 1 of {cores} cores; `mpirun --bind-to none` or \
                 `--map-by slot:PE=N` gives them more"
            ));
        }
        use_threads(Some(threads))
    }

    /// Runs `work` in the first process; the others wait, and fail if it does.
    pub(super) fn in_first(&self, work: impl FnOnce() -> Result) -> Result {
        let mut failure = None;
        let done = cape_train::collective::in_first(&*self.world, || {
            work().map_err(|error| {
                failure = Some(error);
                cape_train::Error::Processes(String::new())
            })
        });
        match failure {
            Some(error) => Err(error),
            None => Ok(done.map(drop)?),
        }
    }

    /// Ends a training: an error of this process ends the others too, after it is reported.
    pub(super) fn end(&self, result: Result<ExitCode>) -> Result<ExitCode> {
        let Err(error) = result else { return result };
        let (rank, size) = (self.world.rank(), self.world.size());
        if size == 1 {
            return Err(error);
        }
        if happened_elsewhere(&error) {
            thread::sleep(PATIENCE);
        }
        eprintln!("{} (process {rank} of {size})", report(&error));
        self.world.abort(i32::from(ExitCode::FAILURE.number()))
    }
}

/// True if another process failed, which reports its error and ends this one.
fn happened_elsewhere(error: &Error) -> bool {
    match error {
        Error::Train(cape_train::Error::Processes(_)) => true,
        Error::Context { source, .. } => happened_elsewhere(source),
        _ => false,
    }
}

/// Number of the host's cores, whichever of them this process may use.
fn host_cores() -> Option<usize> {
    let text = fs::read_to_string("/sys/devices/system/cpu/online").ok()?;
    let count = |entry: &str| {
        let (first, last) = entry.split_once('-').unwrap_or((entry, entry));
        let (first, last): (usize, usize) = (first.parse().ok()?, last.parse().ok()?);
        Some((last + 1).saturating_sub(first))
    };
    text.trim().split(',').map(count).sum()
}
