use std::path::PathBuf;

use cape_eval::EvalReport;
use cape_train::TrainOutcome;
use serde::Serialize;

use crate::{
    commands::eval::run::{self as eval, improvement},
    console::seconds,
    table::Table,
};

/// A stage of the demo and its time.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Stage {
    pub(super) name: &'static str,
    pub(super) seconds: f64,
}

/// Result of the demo.
#[derive(Debug, Serialize)]
pub(super) struct Report {
    pub(super) out: PathBuf,
    /// True if training finished within the time limit.
    pub(super) finished: bool,
    pub(super) seconds: f64,
    pub(super) stages: Vec<Stage>,
    pub(super) training: TrainOutcome,
    pub(super) evaluation: EvalReport,
}

impl Report {
    pub(super) fn text(&self) -> String {
        let mut times = Table::default();
        for Stage { name, seconds: spent } in &self.stages {
            times.row([(*name).to_owned(), seconds(*spent)]);
        }
        times.row(["total".to_owned(), seconds(self.seconds)]);
        let (model, base) = (self.evaluation.model.overall, self.evaluation.mean_shape.overall);
        let TrainOutcome { epochs, steps, .. } = &self.training;
        let stopped = if self.finished { "" } else { ", stopped by the time limit" };
        format!(
            "{}\n\n{}\n\ntrained for {steps} steps ({epochs} epochs{stopped})\nmean error {:.2} mm; \
             baseline {:.2} mm; improvement {:.0} %\n\n{}: built_in.png, \
             contact_sheet.png, loss.png, OBJ meshes, run/, packed/",
            eval::text(&self.evaluation),
            times.text(),
            model.mean,
            base.mean,
            100.0 * improvement(&model, &base),
            self.out.display(),
        )
    }
}
