use cape_eval::quality::{QualityOptions, QualityReport, SetQuality, quality, standard_normal};
use cape_infer::write_json;
use clap::Args;
use serde::Serialize;

use crate::{
    console::Console,
    error::Result,
    options::{DataArgs, GlobalArgs, RunArgs, at_least_one},
    priors::{PriorArgs, load_prior},
    table::Table,
};

/// Measure the quality of samples against held-out frames.
///
/// Samples a code for every held-out capture, decodes it in the poses of its frames, and measures coverage,
/// fidelity and diversity against captures of another half; these are measured against each other, too.
/// Also written to RUN/samples.json.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  cape eval samples runs/cape --prior gmm")]
pub(crate) struct EvalSamplesArgs {
    #[command(flatten)]
    run: RunArgs,
    #[command(flatten)]
    data: DataArgs,
    #[command(flatten)]
    drawn: PriorArgs,
    /// Largest number of held-out frames to compare with, evenly spaced.
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
        let run = self.run.open(global)?;
        let data = self.data.of(&run)?;
        let seed = global.seed();
        let temperature = self.drawn.temperature()?;
        let options = QualityOptions { frames: self.frames, seed, ..QualityOptions::default() };
        let prior = load_prior(&run, self.drawn.name(&run), console)?;
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
        let report = Report { prior: self.drawn.name(&run).name(), temperature, quality: found };
        if let Some(paths) = run.paths() {
            write_json(&paths.root().join("samples.json"), &report)?;
        }
        console.result(&report, || report.text())
    }
}

impl Report {
    fn text(&self) -> String {
        let QualityReport {
            frames,
            samples,
            held_out,
            training,
            principal,
            principal_held_out,
            principal_training,
            diversity_mm,
            held_out_diversity_mm,
            pose_sensitivity_mm,
            pose_transfer,
            outfit_consistency,
            classifier_accuracy,
            inside_body: [inside, inside_held_out],
        } = &self.quality;
        let percent = |share: f64| format!("{:.0} %", 100.0 * share);
        let mm = |distance: f64| format!("{distance:.1} mm");
        let mut table = Table::new(["", "samples", "training", "held out"]);
        for (sets, space) in [
            ([Some(samples), training.as_ref(), Some(held_out)], ""),
            (
                [Some(principal), principal_training.as_ref(), Some(principal_held_out)],
                ", 64 components",
            ),
        ] {
            let mut measure = |name: String, of: &dyn Fn(&SetQuality) -> String| {
                let [own, training, theirs] = sets.map(|set| set.map(of).unwrap_or_default());
                table.row([name, own, training, theirs]);
            };
            measure(format!("coverage{space}"), &|set| percent(set.coverage));
            measure(
                format!("minimum matching distance{space}"),
                &|set| mm(set.minimum_matching_mm),
            );
            measure(format!("1-nearest-neighbour accuracy{space} (best 50 %)"), &|set| {
                percent(set.nearest_neighbour_accuracy)
            });
        }
        let mut row = |name: &str, samples: String, held_out: String| {
            table.row([name.to_owned(), samples, String::new(), held_out]);
        };
        for ((outfit, own), (_, theirs)) in diversity_mm.iter().zip(held_out_diversity_mm) {
            row(&format!("diversity, {outfit}"), mm(*own), mm(*theirs));
        }
        row("mean change per radian of a joint", mm(*pose_sensitivity_mm), String::new());
        if let Some(transfer) = pose_transfer {
            row(
                "change between two poses of a capture",
                mm(transfer.model_change_mm),
                mm(transfer.true_change_mm),
            );
            row("error of clothing in another pose", mm(transfer.transferred_mm), String::new());
            row("  of offsets fixed to the body", String::new(), mm(transfer.fixed_offsets_mm));
            row("  of the pose's own reconstruction", mm(transfer.reconstructed_mm), String::new());
            row("  of the mean displacement", String::new(), mm(transfer.mean_shape_mm));
        }
        row(
            "outfit recognised by a classifier",
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
            "{}\n\n{frames} held-out frames; prior {prior}, temperature {temperature}",
            table.text()
        )
    }
}
