use std::path::PathBuf;

use cape_core::ply;
use cape_eval::{EvalOptions, EvalReport, PosteriorUse, evaluate};
use cape_infer::write_json;
use cape_render::colormap;
use cape_stats::errors::{ErrorSummary, GroupedSummary};
use clap::Args;

use crate::{
    console::Console,
    dressed_mesh::eight_bit,
    error::Result,
    options::{GlobalArgs, RunArgs, at_least_one, choices, positive},
    table::Table,
};

/// Measure reconstruction errors on test frames.
///
/// Euclidean errors at clothing vertices in millimetres, compared with the mean-displacement baseline.
/// Also written to RUN/eval.json.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  cape eval run runs/cape --data packed --posterior mean")]
pub(crate) struct EvalArgs {
    #[command(flatten)]
    run: RunArgs,
    /// Packed set with test frames.
    #[arg(long, value_name = "DIR")]
    data: PathBuf,
    /// Latent code to decode: a sample of the posterior, as in the paper's tables, or its mean.
    #[arg(
        long,
        default_value = "sample",
        value_name = "CODE",
        value_parser = choices([("sample", PosteriorUse::Sample), ("mean", PosteriorUse::Mean)])
    )]
    posterior: PosteriorUse,
    /// Frames per batch.
    #[arg(long, default_value_t = 16, value_name = "N", value_parser = at_least_one)]
    batch: usize,
    /// Also write the body coloured by the mean error per vertex.
    #[arg(long, value_name = "FILE.ply")]
    map: Option<PathBuf>,
    /// Error of the map's brightest colour, mm.
    #[arg(long, default_value_t = 20.0, value_name = "MM", requires = "map", value_parser = positive)]
    scale: f64,
}

impl EvalArgs {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        let run = self.run.open(global)?;
        let options =
            EvalOptions { posterior: self.posterior, seed: global.seed(), batch: self.batch };
        let report = console.while_showing("evaluate", "frames", |progress| {
            evaluate(&run, &self.data, options, progress)
        })?;
        if let Some(paths) = run.paths() {
            write_json(&paths.evaluation(), &report)?;
        }
        if let Some(path) = &self.map {
            let colour = |mm: &f32| eight_bit(colormap(mm / self.scale as f32));
            let colours: Vec<[u8; 3]> = report.vertex_means.iter().map(colour).collect();
            ply::write(path, &run.body().mesh(), Some(&colours))?;
        }
        console.result(&report, || text(&report))
    }
}

/// Errors overall, by outfit and by sequence, compared with the baseline.
pub(crate) fn text(report: &EvalReport) -> String {
    let mut table = Table::new(["", "mean ± std", "median", "mean shape", "median", "improvement"]);
    let GroupedSummary { overall, outfits, sequences } = &report.model;
    let base = &report.mean_shape;
    row(&mut table, "all", overall, Some(&base.overall));
    for (outfit, summary) in outfits {
        row(&mut table, outfit.name(), summary, base.outfits.get(outfit));
    }
    for (sequence, summary) in sequences {
        row(&mut table, sequence, summary, base.sequences.get(sequence));
    }
    let unknown = if sequences.is_empty() {
        "; their captures are unknown (no test_frames.csv): no errors by sequence"
    } else {
        ""
    };
    format!(
        "{}\n\nerrors at the {} clothing vertices, mm, {} test frames{unknown}",
        table.text(),
        report.clothing_vertices,
        report.frames
    )
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

/// Relative reduction of the baseline's mean error.
pub(crate) fn improvement(model: &ErrorSummary, base: &ErrorSummary) -> f64 {
    1.0 - model.mean / base.mean
}
