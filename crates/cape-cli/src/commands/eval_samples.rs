use std::path::PathBuf;

use cape_core::parse_device;
use cape_eval::quality::{QualityOptions, QualityReport, quality, standard_normal};
use cape_infer::{Run, write_json};
use clap::Args;
use serde::Serialize;

use crate::{
    arguments::{GlobalArgs, at_least_one},
    console::Console,
    error::Result,
    priors::{PriorArgs, load_prior},
    table::Table,
};

/// Measure how good samples are: against held-out clothes, and by themselves.
///
/// As many bodies are dressed as there are held-out frames, in their poses and outfits. Written to
/// the run's samples.json.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  cape eval-samples run --prior gmm")]
pub(crate) struct EvalSamplesArgs {
    /// A training run.
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// Packed set with the held-out frames; by default the run's own.
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    #[command(flatten)]
    drawn: PriorArgs,
    /// Most held-out frames to compare with, evenly spaced.
    #[arg(long, default_value_t = 200, value_name = "N", value_parser = at_least_one)]
    frames: usize,
}

#[derive(Debug, Serialize)]
struct Report {
    prior: &'static str,
    temperature: f64,
    #[serde(flatten)]
    quality: QualityReport,
}

impl EvalSamplesArgs {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        let device = parse_device(&global.device)?;
        let run = Run::open(&self.run, &device)?;
        let data = match self.data {
            Some(data) => data,
            None => run.data()?,
        };
        let seed = global.seed.unwrap_or(1);
        let temperature = self.drawn.temperature()?;
        let options = QualityOptions { frames: self.frames, seed, ..QualityOptions::default() };
        let prior = load_prior(&run, self.drawn.prior, console)?;
        let normal = standard_normal(run.config().model.latent, temperature, seed);
        let found = console.while_showing("measure", "parts", |progress| match &prior {
            None => quality(&run, &data, &normal, options, progress),
            Some(prior) => quality(
                &run,
                &data,
                &|outfit, n, call| prior.sample(outfit, n, temperature, seed ^ (call << 8)),
                options,
                progress,
            ),
        })?;
        let report = Report { prior: self.drawn.prior.name(), temperature, quality: found };
        write_json(&run.paths().root().join("samples.json"), &report)?;
        console.result(&report, || report.text())
    }
}

impl Report {
    fn text(&self) -> String {
        let QualityReport {
            frames,
            coverage,
            minimum_matching_mm,
            nearest_neighbour_accuracy,
            diversity_mm,
            held_out_diversity_mm,
            pose_sensitivity_mm,
            outfit_consistency,
            classifier_accuracy,
            inside_body: [inside, inside_held_out],
        } = &self.quality;
        let percent = |share: f64| format!("{:.0} %", 100.0 * share);
        let mut table = Table::new(["", "samples", "held out"]);
        let mut row = |name: &str, samples: String, held_out: String| {
            table.row([name.to_owned(), samples, held_out]);
        };
        row("coverage", percent(*coverage), String::new());
        row("minimum matching distance", format!("{minimum_matching_mm:.1} mm"), String::new());
        row(
            "nearest neighbours of the same kind (best 50 %)",
            percent(*nearest_neighbour_accuracy),
            String::new(),
        );
        for ((outfit, own), (_, theirs)) in diversity_mm.iter().zip(held_out_diversity_mm) {
            row(&format!("diversity, {outfit}"), format!("{own:.1} mm"), format!("{theirs:.1} mm"));
        }
        row("moved by a radian of a joint", format!("{pose_sensitivity_mm:.1} mm"), String::new());
        row(
            "taken for the right outfit",
            percent(*outfit_consistency),
            percent(*classifier_accuracy),
        );
        row(
            "clothing vertices inside the body",
            format!("{:.1} %", 100.0 * inside),
            format!("{:.1} %", 100.0 * inside_held_out),
        );
        let (prior, temperature) = (self.prior, self.temperature);
        format!(
            "{}\n\n{frames} held-out frames, prior {prior}, temperature {temperature}",
            table.text()
        )
    }
}
