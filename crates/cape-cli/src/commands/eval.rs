use std::path::PathBuf;

use cape_core::{parse_device, ply};
use cape_eval::{EvalOptions, EvalReport, PosteriorUse, evaluate};
use cape_infer::{Run, write_json};
use cape_render::colormap;
use cape_stats::errors::{ErrorSummary, GroupedSummary};
use clap::{Args, ValueEnum};

use crate::{
    arguments::{GlobalArgs, at_least_one},
    console::Console,
    dressed_mesh::eight_bit,
    error::Result,
    table::Table,
};

/// Measure reconstruction errors on held-out sequences.
///
/// Euclidean errors at the clothing vertices of the test frames, in millimetres, beside those of
/// always answering with the mean training displacement. Also written to RUN/eval.json.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  cape eval run --data packed --posterior mean")]
pub(crate) struct EvalArgs {
    /// A training run.
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// Packed set with test frames.
    #[arg(long, value_name = "DIR")]
    data: PathBuf,
    /// Which code of the posterior is decoded: a sample as in the paper's tables, or the mean.
    #[arg(long, value_enum, default_value_t = PosteriorName::Sample)]
    posterior: PosteriorName,
    /// Frames at a time.
    #[arg(long, default_value_t = 16, value_name = "N", value_parser = at_least_one)]
    batch: usize,
    /// Also write the body, coloured by the mean error at every vertex.
    #[arg(long, value_name = "FILE.ply")]
    map: Option<PathBuf>,
    /// Error that gets the brightest colour of the map, millimetres.
    #[arg(long, default_value_t = 20.0, value_name = "MM", requires = "map")]
    scale: f32,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum PosteriorName {
    Mean,
    Sample,
}

impl From<PosteriorName> for PosteriorUse {
    fn from(name: PosteriorName) -> Self {
        match name {
            PosteriorName::Mean => Self::Mean,
            PosteriorName::Sample => Self::Sample,
        }
    }
}

impl EvalArgs {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        let device = parse_device(&global.device)?;
        let run = Run::open(&self.run, &device)?;
        let options = EvalOptions {
            posterior: self.posterior.into(),
            seed: global.seed.unwrap_or(1),
            batch: self.batch,
        };
        let report = console.while_showing("evaluate", "frames", |progress| {
            evaluate(&run, &self.data, options, progress)
        })?;
        write_json(&run.paths().evaluation(), &report)?;
        if let Some(path) = &self.map {
            let colours: Vec<[u8; 3]> =
                report.vertex_means.iter().map(|mm| eight_bit(colormap(mm / self.scale))).collect();
            ply::write(path, &run.body().mesh(), Some(&colours))?;
        }
        console.result(&report, || text(&report))
    }
}

/// The report for people: overall, by outfit, by sequence, beside the baseline.
pub(crate) fn text(report: &EvalReport) -> String {
    let mut table = Table::new(["", "mean ± std", "median", "mean shape", "median", "less error"]);
    let GroupedSummary { overall, outfits, sequences } = &report.model;
    let base = &report.mean_shape;
    row(&mut table, "all", overall, Some(&base.overall));
    for (outfit, summary) in outfits {
        row(&mut table, outfit.name(), summary, base.outfits.get(outfit));
    }
    for (sequence, summary) in sequences {
        row(&mut table, sequence, summary, base.sequences.get(sequence));
    }
    format!("{}\n\nmillimetres at clothing vertices, {} test frames", table.text(), report.frames)
}

fn row(table: &mut Table, name: &str, model: &ErrorSummary, base: Option<&ErrorSummary>) {
    let spread = |s: &ErrorSummary| format!("{:.2} ± {:.2}", s.mean, s.std);
    let dash = || "–".to_owned();
    table.row([
        name.to_owned(),
        spread(model),
        format!("{:.2}", model.median),
        base.map_or_else(dash, spread),
        base.map_or_else(dash, |base| format!("{:.2}", base.median)),
        base.map_or_else(dash, |base| format!("{:.0} %", 100.0 * improvement(model, base))),
    ]);
}

/// By how much of the baseline's mean error the model's is smaller.
pub(crate) fn improvement(model: &ErrorSummary, base: &ErrorSummary) -> f64 {
    1.0 - model.mean / base.mean
}
