mod names;

use std::{path::PathBuf, sync::Arc, time::Instant};

use cape_data::{PackedSet, Split};
use cape_eval::comparison::{
    ComparisonTable, MethodResults, RunErrors, check_comparable, common_data, measure_run,
    training_seconds,
};
use cape_infer::{Run, write_json};
use clap::Args;
use serde::Serialize;

use crate::{
    comparison,
    console::{Console, seconds},
    error::{Context, Result},
    files,
    options::GlobalArgs,
};

/// Compare trained runs on the same test frames.
///
/// The table of `cape table2` for any runs: errors with bootstrap intervals over captures, measures of
/// wrinkles, and the difference of every run from the first with a paired test. With --out, writes
/// compare.md, .csv, .json, .tex and histograms.png.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  cape eval compare runs/cape runs/other\n  cape eval compare runs/* --data \
                        packed --out comparison"
)]
pub(crate) struct CompareArgs {
    /// Directories of trained models; all are compared with the first.
    #[arg(value_name = "RUN", required = true)]
    runs: Vec<PathBuf>,
    /// Packed set with test frames [default: the one that all runs were trained on].
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Directory to write tables and histograms to.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

#[derive(Debug, Serialize)]
struct Report {
    data: PathBuf,
    runs: Vec<PathBuf>,
    seconds: f64,
    #[serde(flatten)]
    table: ComparisonTable,
}

impl CompareArgs {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        let start = Instant::now();
        let device = global.device()?;
        let data = match self.data {
            Some(data) => data,
            None => common_data(&self.runs)?,
        };
        check_comparable(&self.runs, &PackedSet::open(&data, Split::Test)?)?;
        let names = names::run_names(&self.runs);
        let mut results: Vec<(RunErrors, f64)> = Vec::new();
        for (root, name) in self.runs.iter().zip(&names) {
            let run = Run::open(root, &device)?;
            let set = Arc::new(run.open_set(&data, Split::Test)?);
            let measured = console
                .while_showing(name, "frames", |progress| {
                    let seed = global.seed();
                    measure_run(&run, &set, seed, progress, &mut |_, _, _| Ok(()))
                })
                .doing(|| format!("measuring {}", root.display()))?;
            let seconds = match run.paths() {
                Some(paths) => training_seconds(paths)?,
                None => run.progress().seconds,
            };
            results.push((measured, seconds));
        }
        let methods: Vec<MethodResults> = names
            .iter()
            .zip(&results)
            .map(|(name, (measured, seconds))| MethodResults {
                name: name.clone(),
                label: name.clone(),
                results: vec![measured],
                seconds: *seconds,
            })
            .collect();
        let report = Report {
            data,
            runs: self.runs,
            seconds: start.elapsed().as_secs_f64(),
            table: ComparisonTable::new(&methods, Some(0)),
        };
        if let Some(out) = &self.out {
            files::create_dir(out)?;
            comparison::write(out, "compare", &report.table)?;
            write_json(&out.join("compare.json"), &report)?;
            comparison::histograms(&report.table)?.save(out.join("histograms.png"))?;
        }
        console.result(&report, || report.text())
    }
}

impl Report {
    fn text(&self) -> String {
        format!(
            "{}\n\n{}: {}",
            comparison::text(&self.table),
            self.data.display(),
            seconds(self.seconds)
        )
    }
}
