//! Number and place of a process by the variables of its launcher.

/// Number and place of a process among those that a launcher started together.
///
/// Open MPI's, PMI's (MPICH, Intel MPI), Slurm's and torchrun's variables are understood, in this order.
///
/// ```
/// use cape_train::collective::Launch;
///
/// let variables = [
///     ("OMPI_COMM_WORLD_RANK", "5"),
///     ("OMPI_COMM_WORLD_SIZE", "8"),
///     ("OMPI_COMM_WORLD_LOCAL_RANK", "1"),
///     ("OMPI_COMM_WORLD_LOCAL_SIZE", "4"),
/// ];
/// let launch = Launch::from_variables(|name| {
///     variables.iter().find(|(own, _)| *own == name).map(|(_, value)| value.to_string())
/// });
/// let launch = launch.expect("started by Open MPI");
/// assert_eq!((launch.rank, launch.size), (5, 8));
/// assert_eq!((launch.local_rank, launch.local_size), (1, 4));
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Launch {
    /// Name of the launcher.
    pub launcher: &'static str,
    /// Variable that tells the number of processes.
    pub variable: &'static str,
    /// Number of this process.
    pub rank: usize,
    /// Number of processes.
    pub size: usize,
    /// Number of this process among those on its host.
    pub local_rank: usize,
    /// Number of processes on its host.
    pub local_size: usize,
}

/// Names of a launcher's variables.
struct Variables {
    launcher: &'static str,
    rank: &'static str,
    size: &'static str,
    local_rank: &'static str,
    local_size: &'static str,
    /// Variable that must be there as well.
    with: Option<&'static str>,
}

const LAUNCHERS: [Variables; 4] = [
    Variables {
        launcher: "Open MPI",
        rank: "OMPI_COMM_WORLD_RANK",
        size: "OMPI_COMM_WORLD_SIZE",
        local_rank: "OMPI_COMM_WORLD_LOCAL_RANK",
        local_size: "OMPI_COMM_WORLD_LOCAL_SIZE",
        with: None,
    },
    Variables {
        launcher: "PMI",
        rank: "PMI_RANK",
        size: "PMI_SIZE",
        local_rank: "MPI_LOCALRANKID",
        local_size: "MPI_LOCALNRANKS",
        with: None,
    },
    // Within srun alone; a batch script has the number of tasks, but is none of them.
    Variables {
        launcher: "Slurm",
        rank: "SLURM_PROCID",
        size: "SLURM_STEP_NUM_TASKS",
        local_rank: "SLURM_LOCALID",
        local_size: "SLURM_STEP_TASKS_PER_NODE",
        with: None,
    },
    Variables {
        launcher: "torchrun",
        rank: "RANK",
        size: "WORLD_SIZE",
        local_rank: "LOCAL_RANK",
        local_size: "LOCAL_WORLD_SIZE",
        with: Some("MASTER_ADDR"),
    },
];

impl Launch {
    /// Reads the environment of this process; `None` if no launcher started it.
    pub fn detect() -> Option<Self> {
        Self::from_variables(|name| std::env::var(name).ok())
    }

    /// Reads variables that `get` returns by their names.
    pub fn from_variables(get: impl Fn(&str) -> Option<String>) -> Option<Self> {
        let number = |name: &str| get(name).and_then(|text| text.trim().parse::<usize>().ok());
        LAUNCHERS.iter().find_map(|variables| {
            let (rank, size) = (number(variables.rank)?, number(variables.size)?);
            if rank >= size || variables.with.is_some_and(|name| get(name).is_none()) {
                return None;
            }
            // Slurm starts processes with the variables of PMI for all but the place on the host.
            let places = || [variables.local_rank, "SLURM_LOCALID", "LOCAL_RANK"];
            let local_rank = places().into_iter().find_map(number).unwrap_or(0);
            let local_size = number(variables.local_size)
                .or_else(|| of_slurm(get("SLURM_STEP_TASKS_PER_NODE")?, number("SLURM_NODEID")?))
                .unwrap_or(1);
            Some(Self {
                launcher: variables.launcher,
                variable: variables.size,
                rank,
                size,
                local_rank,
                local_size: local_size.max(local_rank + 1),
            })
        })
    }

    /// Name of the device for this process: `cuda` without an index is the card of the process's number
    /// on its host, among those that are visible to it.
    ///
    /// ```
    /// use cape_train::collective::Launch;
    ///
    /// let launch = Launch {
    ///     launcher: "Open MPI",
    ///     variable: "OMPI_COMM_WORLD_SIZE",
    ///     rank: 6,
    ///     size: 8,
    ///     local_rank: 2,
    ///     local_size: 4,
    /// };
    /// assert_eq!(launch.device("cuda", None), "cuda:2");
    /// // One card for each process, as by `srun --gpus-per-task=1`.
    /// assert_eq!(launch.device("cuda", Some("5")), "cuda:0");
    /// assert_eq!(launch.device("cuda:1", None), "cuda:1");
    /// assert_eq!(launch.device("flex", None), "flex");
    /// ```
    pub fn device(&self, name: &str, visible: Option<&str>) -> String {
        if name != "cuda" {
            return name.to_owned();
        }
        let cards = visible.map_or(0, |list| list.split(',').filter(|id| !id.is_empty()).count());
        let index = if cards == 0 { self.local_rank } else { self.local_rank % cards };
        format!("cuda:{index}")
    }

    /// Number of threads for this process on a host of `cores` cores, of which it may use `allowed`: its
    /// share of them.
    ///
    /// ```
    /// # use cape_train::collective::Launch;
    /// # let launch = Launch {
    /// #     launcher: "Open MPI",
    /// #     variable: "OMPI_COMM_WORLD_SIZE",
    /// #     rank: 0,
    /// #     size: 4,
    /// #     local_rank: 0,
    /// #     local_size: 4,
    /// # };
    /// // Four processes on the host; then bound to two cores each.
    /// assert_eq!(launch.threads(32, 32), 8);
    /// assert_eq!(launch.threads(32, 2), 2);
    /// ```
    pub fn threads(&self, cores: usize, allowed: usize) -> usize {
        (cores / self.local_size.max(1)).clamp(1, allowed.max(1))
    }
}

/// Number of tasks on a node by Slurm's list, such as `4(x2),3`.
fn of_slurm(list: String, node: usize) -> Option<usize> {
    let mut left = node;
    for entry in list.split(',') {
        let (tasks, nodes) = match entry.split_once("(x") {
            Some((tasks, nodes)) => (tasks, nodes.strip_suffix(')')?.parse().ok()?),
            None => (entry, 1),
        };
        if left < nodes {
            return tasks.trim().parse().ok();
        }
        left -= nodes;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    fn launch(variables: &str) -> Option<Launch> {
        let find = |name: &str| {
            let mut pairs = variables.split_whitespace().filter_map(|pair| pair.split_once('='));
            pairs.find(|(own, _)| *own == name).map(|(_, value)| value.to_owned())
        };
        Launch::from_variables(find)
    }

    fn numbers(variables: &str) -> Option<(&'static str, [usize; 4])> {
        let Launch { launcher, rank, size, local_rank, local_size, .. } = launch(variables)?;
        Some((launcher, [rank, size, local_rank, local_size]))
    }

    #[test]
    fn launchers_are_understood() {
        let slurm = "SLURM_PROCID=6 SLURM_STEP_NUM_TASKS=11 SLURM_LOCALID=2 SLURM_NODEID=1";
        let per_node = "SLURM_STEP_TASKS_PER_NODE=4(x2),3";
        let pmi = "PMI_RANK=3 PMI_SIZE=4 MPI_LOCALRANKID=1 MPI_LOCALNRANKS=2";
        let torch = "RANK=3 WORLD_SIZE=4 LOCAL_RANK=1 LOCAL_WORLD_SIZE=2 MASTER_ADDR=a";
        assert_eq!(numbers(&format!("{slurm} {per_node}")), Some(("Slurm", [6, 11, 2, 4])));
        assert_eq!(numbers(slurm), Some(("Slurm", [6, 11, 2, 3])));
        assert_eq!(numbers(pmi), Some(("PMI", [3, 4, 1, 2])));
        assert_eq!(numbers(torch), Some(("torchrun", [3, 4, 1, 2])));
        // Slurm with PMI-2, and Open MPI within a job of Slurm.
        let pmi_of_slurm = format!("PMI_RANK=6 PMI_SIZE=11 {slurm} {per_node}");
        assert_eq!(numbers(&pmi_of_slurm), Some(("PMI", [6, 11, 2, 4])));
        let open = "OMPI_COMM_WORLD_RANK=0 OMPI_COMM_WORLD_SIZE=2 OMPI_COMM_WORLD_LOCAL_RANK=0 \
                    OMPI_COMM_WORLD_LOCAL_SIZE=2";
        assert_eq!(numbers(&format!("{slurm} {open}")), Some(("Open MPI", [0, 2, 0, 2])));
    }

    #[test]
    fn everything_else_is_one_process() {
        for variables in [
            "",
            "PATH=/bin RANK=1 WORLD_SIZE=2",
            // A batch script of Slurm.
            "SLURM_NTASKS=8 SLURM_PROCID=0 SLURM_LOCALID=0 SLURM_JOB_ID=5",
            "PMI_RANK=2 PMI_SIZE=2",
            "PMI_RANK=x PMI_SIZE=2",
        ] {
            assert_eq!(launch(variables), None, "{variables}");
        }
    }

    #[test]
    fn the_last_entry_of_slurms_list_is_for_the_last_node() {
        let tasks = |node| of_slurm("4(x2),3".to_owned(), node);
        assert_eq!([0, 1, 2, 3].map(tasks), [Some(4), Some(4), Some(3), None]);
        assert_eq!(of_slurm("2(xq)".to_owned(), 0), None);
    }
}
