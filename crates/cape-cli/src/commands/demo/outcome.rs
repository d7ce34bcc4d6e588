use std::path::PathBuf;

use cape_eval::EvalReport;
use cape_train::TrainOutcome;
use serde::Serialize;

use crate::{
    commands::eval::{self, improvement},
    console::seconds,
    table::Table,
};

/// A part of the demo and how long it took.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Stage {
    pub(super) name: &'static str,
    pub(super) seconds: f64,
}

/// What came out.
#[derive(Debug, Serialize)]
pub(super) struct Report {
    pub(super) out: PathBuf,
    /// Whether training was done before its time was up.
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
        times.row(["all".to_owned(), seconds(self.seconds)]);
        let (model, base) = (self.evaluation.model.overall, self.evaluation.mean_shape.overall);
        let TrainOutcome { epochs, steps, .. } = &self.training;
        let stopped = if self.finished { "" } else { ", stopped by the time limit" };
        format!(
            "{}\n\n{}\n\ntrained for {steps} steps ({epochs} epochs{stopped})\nmean error {:.2} mm; \
             the mean shape has {:.2} mm: {:.0} % less\n\n{}: contact_sheet.png, loss.png, OBJ \
             meshes, run/, packed/",
            eval::text(&self.evaluation),
            times.text(),
            model.mean,
            base.mean,
            100.0 * improvement(&model, &base),
            self.out.display(),
        )
    }
}
