//! The self check and learning rate search of `--check` and `--find-rate`.

use std::{fmt::Write as _, path::Path};

use burn::tensor::Device;
use cape_eval::self_check::{
    CheckOptions, CheckReport, ModelUnderTest, RateSearchOptions, RateSearchReport, check,
    find_rate,
};
use cape_infer::RunConfig;
use cape_render::{Plot, Series};

use clap::Args;

use super::TrainArgs;
use crate::{
    console::Console,
    error::Result,
    exit_code::ExitCode,
    files,
    options::{GlobalArgs, at_least_one},
    table::Table,
};

/// Options for checks instead of a training.
#[derive(Debug, Args)]
pub(super) struct SelfCheckArgs {
    /// Check the configuration by short trainings instead of training.
    #[arg(long, conflicts_with_all = ["resume", "find_rate", "out"])]
    check: bool,
    /// Suggest a learning rate by a range test instead of training; curves go to --out.
    #[arg(long, conflicts_with = "resume")]
    find_rate: bool,
    /// Steps of --check [default: 200] or --find-rate [default: 120].
    #[arg(long, value_name = "N", value_parser = at_least_one)]
    trial_steps: Option<usize>,
}

impl SelfCheckArgs {
    pub(super) fn any(&self) -> bool {
        self.check || self.find_rate
    }
}

impl TrainArgs {
    pub(super) fn run_self_check(
        &self,
        global: &GlobalArgs,
        console: Console,
        device: &Device,
    ) -> Result<ExitCode> {
        let config = self.configured(RunConfig::default(), global)?;
        let body = self.body.load()?;
        let subject = ModelUnderTest {
            data: self.data.as_deref().unwrap_or(Path::new("")),
            body: body.as_ref(),
            clothing: self.clothing.as_deref(),
            config: &config,
            device,
        };
        if self.self_check.find_rate {
            let mut options = RateSearchOptions::default();
            super::settings::set(&mut options.steps, self.self_check.trial_steps);
            let report = console.while_showing("rates", "steps", |progress| {
                find_rate(&subject, options, progress)
            })?;
            if let Some(out) = &self.out {
                write_rates(&report, out)?;
            }
            console.result(&report, || rates(&report))?;
            return Ok(ExitCode::SUCCESS);
        }
        let mut options = CheckOptions::default();
        super::settings::set(&mut options.steps, self.self_check.trial_steps);
        let report = console
            .while_showing("check", "steps", |progress| check(&subject, options, progress))?;
        console.result(&report, || findings(&report))?;
        Ok(if report.passed { ExitCode::SUCCESS } else { ExitCode::FAILURE })
    }
}

fn findings(report: &CheckReport) -> String {
    let mut table = Table::new(["", "check", "found", "expected"]);
    for finding in &report.findings {
        let mark = if finding.passed { "✓" } else { "✗" };
        let cells = [mark, finding.name, &finding.found, &finding.expected];
        table.row(cells.map(str::to_owned));
    }
    let failed = report.findings.iter().filter(|finding| !finding.passed).count();
    let verdict = match failed {
        0 => "all checks passed".to_owned(),
        failed => format!("{failed} of {} checks failed", report.findings.len()),
    };
    format!("{}\n\n{verdict}", table.text())
}

fn rates(report: &RateSearchReport) -> String {
    let diverged = match report.diverged {
        Some(rate) => format!("diverged at {rate:.1e}"),
        None => "did not diverge".into(),
    };
    format!(
        "the loss fell fastest at a learning rate of {:.1e}, was lowest at {:.1e} and {diverged}\n\
         suggested: --peak-rate {:.0e}",
        report.steepest, report.lowest, report.suggested
    )
}

fn write_rates(report: &RateSearchReport, out: &Path) -> Result {
    files::create_dir(out)?;
    let mut csv = "rate,loss,smoothed\n".to_owned();
    for point in &report.points {
        // Writing to a string cannot fail.
        let _ = writeln!(csv, "{},{},{}", point.rate, point.loss, point.smoothed);
    }
    files::write_text(&out.join("rates.csv"), &csv)?;
    let curve = |of: fn(&cape_eval::self_check::RatePoint) -> f64| {
        report.points.iter().map(|point| (point.rate.log10(), of(point))).collect()
    };
    let plot = Plot {
        title: "loss by learning rate".into(),
        x_label: "learning rate, power of ten".into(),
        y_label: "loss".into(),
        series: vec![
            Series { name: "loss".into(), points: curve(|point| point.loss) },
            Series { name: "average".into(), points: curve(|point| point.smoothed) },
        ],
        log_y: false,
    };
    plot.draw(800, 500)?.save(out.join("rates.png"))?;
    Ok(())
}
