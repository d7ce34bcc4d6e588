use std::path::PathBuf;

use cape_core::Outfit;
use cape_data::Split;
use cape_infer::prior::{Density, DensityKind, Prior, PriorOptions};
use clap::Args;
use serde::Serialize;

use crate::{
    console::Console,
    error::{Error, Result},
    options::{DataArgs, GlobalArgs, RunArgs, at_least_one, choices},
    priors::PriorName,
    table::Table,
};

/// Fit a prior to the latent codes of the training frames.
///
/// Encodes training frames and fits a Gaussian mixture or a kernel density to the posterior means. A
/// training ends with a mixture for each outfit; this fits another one, or one for an imported model.
/// Other commands sample from RUN/prior-gmm.npz by default, and from RUN/prior-kde.npz with --prior kde.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  cape model prior runs/cape\n  cape model prior runs/cape --kind kde --joint"
)]
pub(crate) struct FitPriorArgs {
    #[command(flatten)]
    run: RunArgs,
    #[command(flatten)]
    data: DataArgs,
    /// Density: Gaussian mixture or kernel density.
    #[arg(
        long,
        default_value = "gmm",
        value_name = "KIND",
        value_parser = choices([("gmm", PriorName::Gmm), ("kde", PriorName::Kde)])
    )]
    kind: PriorName,
    /// Components of the mixture [default: by the Bayesian information criterion].
    #[arg(long, value_name = "N", value_parser = at_least_one)]
    components: Option<usize>,
    /// Fit one density to all outfits instead of one per outfit.
    #[arg(long)]
    joint: bool,
    /// Largest number of training frames to encode, evenly spaced.
    #[arg(long, default_value_t = 4096, value_name = "N", value_parser = at_least_one)]
    frames: usize,
}

#[derive(Debug, Serialize)]
struct Report {
    file: PathBuf,
    codes: usize,
    groups: Vec<DensityGroup>,
}

#[derive(Debug, Serialize)]
struct DensityGroup {
    outfit: Option<Outfit>,
    components: Option<usize>,
    bandwidth: Option<f64>,
}

impl FitPriorArgs {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        if self.components.is_some() && self.kind == PriorName::Kde {
            return Err(Error::message("--components: only for --kind gmm"));
        }
        let run = self.run.open(global)?;
        let data = self.data.of(&run)?;
        let kind = match (self.kind, self.components) {
            (PriorName::Kde, _) => DensityKind::Kernel,
            (_, Some(components)) => DensityKind::Mixture(components),
            (_, None) => PriorOptions::default().kind,
        };
        let options =
            PriorOptions { kind, by_outfit: !self.joint, frames: self.frames, seed: global.seed() };
        let set = run.open_set(&data, Split::Train)?;
        let mut codes = 0;
        let prior = console.while_showing("encode", "frames", |progress| {
            Prior::of_run(&run, &set, &options, &mut |done, total| {
                codes = total;
                progress(done, total);
            })
        })?;
        let paths = run.paths().ok_or_else(|| {
            Error::message(format!(
                "{}: a model file, expected the directory of a run",
                run.name().display()
            ))
        })?;
        let file = paths.prior(self.kind.name());
        prior.save(&file)?;
        let report = Report { file, codes, groups: groups(&prior) };
        console.result(&report, || report.text(&self.run.name(), self.kind))
    }
}

fn groups(prior: &Prior) -> Vec<DensityGroup> {
    let groups = prior.groups().map(|(outfit, density)| match density {
        Density::Mixture(mixture) => {
            DensityGroup { outfit, components: Some(mixture.components()), bandwidth: None }
        }
        Density::Kernel(density) => {
            DensityGroup { outfit, components: None, bandwidth: Some(density.bandwidth()) }
        }
    });
    groups.collect()
}

impl Report {
    fn text(&self, run: &str, kind: PriorName) -> String {
        let mut table = Table::new(["outfit", "density"]);
        for group in &self.groups {
            let outfit = group.outfit.map_or("all".to_owned(), |outfit| outfit.to_string());
            let density = match (group.components, group.bandwidth) {
                (Some(1), _) => "1 Gaussian".to_owned(),
                (Some(count), _) => format!("{count} Gaussians"),
                (None, bandwidth) => {
                    format!("kernels of bandwidth {:.3}", bandwidth.unwrap_or_default())
                }
            };
            table.row([outfit, density]);
        }
        format!(
            "{}\n\n{} codes → {}\nnext: cape sample {} --prior {} --outfit all --out samples",
            table.text(),
            self.codes,
            self.file.display(),
            run,
            kind.name()
        )
    }
}
