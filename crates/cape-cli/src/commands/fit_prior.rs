use std::path::{Path, PathBuf};

use cape_core::{Outfit, parse_device};
use cape_infer::{
    Run,
    prior::{Density, DensityKind, LatentCodes, Prior},
};
use cape_stats::density::MixtureOptions;
use clap::{Args, ValueEnum};
use serde::Serialize;

use crate::{
    arguments::{GlobalArgs, at_least_one},
    console::Console,
    error::{Error, Result},
    table::Table,
};

/// Most components that are tried where none are asked for.
const MOST_COMPONENTS: usize = 12;

/// Fit a density to a trained model's codes, to sample from instead of the standard normal prior.
///
/// Encodes training frames and fits a mixture of normal distributions, or a kernel density, to the
/// means of their posteriors, after training. `cape sample --prior gmm` or `--prior kde` then draws
/// from it.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  cape fit-prior run\n  cape fit-prior run --kind kde --joint")]
pub(crate) struct FitPriorArgs {
    /// A training run; the density is kept in it.
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// Packed set whose training frames are encoded; by default the run's own.
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// What is fitted: a Gaussian mixture or a kernel density.
    #[arg(long, value_enum, default_value_t = DensityName::Gmm)]
    kind: DensityName,
    /// Components of the mixture; by default as many as the Bayesian information criterion asks for.
    #[arg(long, value_name = "N", value_parser = at_least_one)]
    components: Option<usize>,
    /// One density for all outfits instead of one for each.
    #[arg(long)]
    joint: bool,
    /// Most training frames to encode, evenly spaced.
    #[arg(long, default_value_t = 4096, value_name = "N", value_parser = at_least_one)]
    frames: usize,
}

/// Kinds of densities, as files are named.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum DensityName {
    Gmm,
    Kde,
}

impl DensityName {
    const fn name(self) -> &'static str {
        match self {
            Self::Gmm => "gmm",
            Self::Kde => "kde",
        }
    }
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
        if self.components.is_some() && self.kind == DensityName::Kde {
            return Err(Error::message("--components: a kernel density has none"));
        }
        let device = parse_device(&global.device)?;
        let run = Run::open(&self.run, &device)?;
        let data = match self.data {
            Some(data) => data,
            None => run.data()?,
        };
        let codes = console.while_showing("encode", "frames", |progress| {
            LatentCodes::from_training(&run, &data, self.frames, progress)
        })?;
        let kind = match (self.kind, self.components) {
            (DensityName::Kde, _) => DensityKind::Kernel,
            (DensityName::Gmm, Some(components)) => DensityKind::Mixture(components),
            (DensityName::Gmm, None) => DensityKind::MixtureUpTo(MOST_COMPONENTS),
        };
        let options =
            MixtureOptions { seed: global.seed.unwrap_or(1), ..MixtureOptions::default() };
        let prior = Prior::fit(&codes, kind, !self.joint, &options)?;
        let file = run.paths().prior(self.kind.name());
        prior.save(&file)?;
        let report = Report { file, codes: codes.len(), groups: groups(&prior) };
        console.result(&report, || report.text(&self.run, self.kind))
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
    fn text(&self, run: &Path, kind: DensityName) -> String {
        let mut table = Table::new(["outfit", "density"]);
        for group in &self.groups {
            let outfit = group.outfit.map_or("all".to_owned(), |outfit| outfit.to_string());
            let density = match (group.components, group.bandwidth) {
                (Some(1), _) => "one normal distribution".to_owned(),
                (Some(count), _) => format!("{count} normal distributions"),
                (None, bandwidth) => format!("kernels of {:.3}", bandwidth.unwrap_or_default()),
            };
            table.row([outfit, density]);
        }
        format!(
            "{}\n\n{} codes → {}\nnext: cape sample {} --prior {} --outfit all --out samples",
            table.text(),
            self.codes,
            self.file.display(),
            run.display(),
            kind.name()
        )
    }
}
