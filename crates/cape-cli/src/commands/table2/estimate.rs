//! Estimate of the training time, `--dry-run`.

use burn::tensor::Device;
use cape_eval::table2::{JobEstimate, Table2Job, Table2Options};
use serde::Serialize;

use crate::{
    console::{Console, seconds},
    error::Result,
    exit_code::ExitCode,
    table::Table,
};

#[derive(Debug, Serialize)]
struct Report {
    jobs: Vec<JobEstimate>,
    /// Estimated training time of what is left, seconds.
    seconds_left: f64,
    threads: usize,
}

/// Prints the estimate of `jobs`.
pub(super) fn run(
    grid: &Table2Options,
    jobs: &[Table2Job],
    device: &Device,
    console: Console,
) -> Result<ExitCode> {
    let jobs = console
        .while_showing("time", "updates", |progress| grid.estimate(jobs, device, progress))?;
    let seconds_left = jobs.iter().map(JobEstimate::seconds_left).sum();
    let report = Report { jobs, seconds_left, threads: rayon::current_num_threads() };
    console.result(&report, || report.text())?;
    Ok(ExitCode::SUCCESS)
}

impl Report {
    fn text(&self) -> String {
        let mut table = Table::new(["row", "seed", "updates", "done", "s an update", "left"]);
        for job in &self.jobs {
            let trained = job.updates > 0;
            let left = job.updates_done < job.updates;
            let cell = |shown: bool, text: String| if shown { text } else { "–".to_owned() };
            table.row([
                job.row.name().to_owned(),
                job.seed.to_string(),
                cell(trained, job.updates.to_string()),
                cell(trained, job.updates_done.to_string()),
                cell(left, format!("{:.3}", job.seconds_per_update)),
                cell(left, seconds(job.seconds_left())),
            ]);
        }
        format!(
            "{}\n\ntraining left: {} with {} threads, one row after another; reading data, validation and \
             measuring come on top",
            table.text(),
            seconds(self.seconds_left),
            self.threads
        )
    }
}
