//! Training time of jobs, estimated from updates timed on this machine.

use std::{collections::BTreeMap, time::Duration};

use burn::tensor::Device;
use serde::Serialize;

use super::{Table2Job, Table2Options, Table2Row};
use crate::{
    Result,
    bench::{Workload, timing::TimingOptions},
};
use cape_core::ProgressFn;
use cape_data::{
    DisplacementStatistics, PackedSet, STATISTICS_FILE, Split, steps_per_epoch, validation_count,
};
use cape_infer::{RunPaths, checkpoint};

/// Timing of a row's updates, which take seconds each at full size.
const UPDATES: TimingOptions =
    TimingOptions { warm_up: 1, most: 5, least: 2, budget: Duration::from_secs(15) };

/// Estimated training of a job.
///
/// ```
/// use cape_eval::table2::{JobEstimate, Table2Row};
///
/// let estimate = JobEstimate {
///     row: Table2Row::Cape,
///     seed: 1,
///     updates: 1000,
///     updates_done: 400,
///     seconds_per_update: 0.5,
/// };
/// assert_eq!(estimate.seconds_left(), 300.0);
/// ```
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct JobEstimate {
    /// The row.
    pub row: Table2Row,
    /// Its seed.
    pub seed: u64,
    /// Number of updates of the whole training; 0 for rows that are not trained.
    pub updates: u64,
    /// Number of updates at the newest checkpoint; all of them if the job is finished.
    pub updates_done: u64,
    /// Median duration of an update on this device, seconds; 0 if none is left.
    pub seconds_per_update: f64,
}

impl JobEstimate {
    /// Estimated duration of the remaining updates, seconds, without reading data, validation and
    /// measuring.
    pub fn seconds_left(&self) -> f64 {
        (self.updates - self.updates_done.min(self.updates)) as f64 * self.seconds_per_update
    }
}

impl Table2Options {
    /// Estimates the remaining training of `jobs`: the updates of every row are timed on `device` with
    /// random frames. Nothing is written.
    pub fn estimate(
        &self,
        jobs: &[Table2Job],
        device: &Device,
        progress: &mut ProgressFn,
    ) -> Result<Vec<JobEstimate>> {
        let set = PackedSet::open(&self.data, Split::Train)?;
        let (body, _) = self.body(&set)?;
        let statistics = self.data.join(STATISTICS_FILE);
        let validation = if statistics.exists() {
            DisplacementStatistics::load(statistics)?.validation()
        } else {
            validation_count(set.frames())
        };
        let frames = set.frames().saturating_sub(validation);
        let mut estimates = Vec::new();
        for job in jobs {
            let train = &job.config.train;
            let steps = train.epochs as u64 * steps_per_epoch(frames, train.batch) as u64;
            let updates = if job.row.is_trained() { steps } else { 0 };
            let updates_done = if job.result()?.is_some() {
                updates
            } else {
                let checkpoints = RunPaths::new(&job.run_directory()).checkpoints();
                checkpoint::list(&checkpoints)?.last().map_or(0, |(step, _)| *step)
            };
            let (row, seed) = (job.row, job.seed);
            estimates.push(JobEstimate {
                row,
                seed,
                updates,
                updates_done,
                seconds_per_update: 0.0,
            });
        }
        let mut timed: BTreeMap<Table2Row, Option<f64>> = BTreeMap::new();
        for estimate in estimates.iter().filter(|job| job.updates_done < job.updates) {
            timed.insert(estimate.row, None);
        }
        let total = timed.len() * UPDATES.runs();
        for (index, (row, seconds)) in timed.iter_mut().enumerate() {
            let mut workload = Workload::of_run(&row.configure(&self.config), &body, device)?;
            let mut done = index * UPDATES.runs();
            let timing = UPDATES.time(
                || workload.update(),
                || {
                    done += 1;
                    progress(done, total);
                },
            )?;
            *seconds = Some(timing.seconds);
            progress((index + 1) * UPDATES.runs(), total);
        }
        for estimate in &mut estimates {
            if let Some(Some(seconds)) = timed.get(&estimate.row) {
                estimate.seconds_per_update = *seconds;
            }
        }
        Ok(estimates)
    }
}
