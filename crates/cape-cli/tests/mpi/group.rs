//! Processes of one training.

use std::{
    fs,
    path::Path,
    process::{Child, Command, Stdio},
    sync::OnceLock,
    thread::sleep,
    time::{Duration, Instant},
};

use crate::support::{Packed, Ran};

/// `mpirun` with the processes that it started.
pub(crate) struct Group(Child);

impl Group {
    /// True if Open MPI's `mpirun` is installed; otherwise says that the test is skipped.
    pub(crate) fn possible() -> bool {
        static FOUND: OnceLock<bool> = OnceLock::new();
        let found = *FOUND.get_or_init(|| {
            let version = Command::new("mpirun").arg("--version").output();
            version.is_ok_and(|output| String::from_utf8_lossy(&output.stdout).contains("Open MPI"))
        });
        if !found {
            println!("skipped: no mpirun of Open MPI here");
        }
        found
    }

    /// Starts `size` processes of a command line in which `@` stands for the directory of `data`.
    pub(crate) fn start(data: &Packed, size: usize, line: &str) -> Self {
        let root = data.root().to_str().unwrap();
        let mut command = Command::new("mpirun");
        // This machine alone, through its memory.
        let of_mpi = "--oversubscribe --bind-to none --mca oob_tcp_if_include lo --mca btl self,vader \
                      --mca btl_vader_single_copy_mechanism none";
        command.args(of_mpi.split_whitespace());
        command.args(["-n", &size.to_string(), env!("CARGO_BIN_EXE_cape")]);
        command.args(line.split_whitespace().map(|word| word.replace('@', root)));
        command.env("OMPI_ALLOW_RUN_AS_ROOT", "1").env("OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "1");
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        Self(command.spawn().unwrap())
    }

    /// Identifier of a process of the group by its rank, if it runs.
    fn process(&self, rank: usize) -> Option<u32> {
        let parent = format!("PPid:\t{}\n", self.0.id());
        let own = format!("OMPI_COMM_WORLD_RANK={rank}");
        let ids = fs::read_dir("/proc").unwrap().flatten().filter_map(|entry| {
            entry.file_name().to_str().and_then(|name| name.parse::<u32>().ok())
        });
        ids.into_iter().find(|id| {
            let read = |what: &str| fs::read(format!("/proc/{id}/{what}")).unwrap_or_default();
            String::from_utf8_lossy(&read("status")).contains(&parent)
                && read("environ").split(|byte| *byte == 0).any(|pair| pair == own.as_bytes())
        })
    }

    /// Sends a signal to a process; false if it does not run.
    pub(crate) fn signal(&self, rank: usize, name: &str) -> bool {
        let Some(id) = self.process(rank) else { return false };
        let arguments = [format!("-{name}"), id.to_string()];
        Command::new("kill").args(arguments).stderr(Stdio::null()).status().unwrap().success()
    }

    /// Kills a process as soon as it runs; false if the group has ended.
    pub(crate) fn kill(&self, rank: usize) -> bool {
        let start = Instant::now();
        while start.elapsed() < Duration::from_secs(2) {
            if self.signal(rank, "KILL") {
                return true;
            }
            sleep(Duration::from_millis(2));
        }
        false
    }

    /// Exit code and output, when all have ended.
    pub(crate) fn ran(self) -> Ran {
        self.0.wait_with_output().unwrap().into()
    }
}

/// Waits until there is a file.
pub(crate) fn wait_for(path: &Path) {
    let start = Instant::now();
    while !path.exists() {
        assert!(start.elapsed() < Duration::from_mins(2), "no {}", path.display());
        sleep(Duration::from_millis(5));
    }
}
