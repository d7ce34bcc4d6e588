use std::path::PathBuf;

use cape_core::parse_device;
use cape_train::release::{self, ImportOptions, ImportReport};
use clap::Args;
use serde::Serialize;

use crate::{
    arguments::GlobalArgs,
    console::Console,
    error::{Error, Result},
    table::Table,
};

/// Make a run of the authors' TensorFlow checkpoint.
///
/// Reads TensorFlow's files itself, checksums included. The architecture shows in the weights;
/// variables that are missing, left over or of another shape are named. The run samples, evaluates
/// and trains on like any other, with the up-sampling weights of the release.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  cape import --tf-checkpoint checkpoints/CAPE_male --stats \
                        trainset_stats.npz --body SMPL_MALE.pkl --clothing clothing_verts_idx.npy \
                        --out run")]
pub(crate) struct ImportArgs {
    /// Directory of the checkpoint, or its path without `.index`.
    #[arg(long, value_name = "DIR")]
    tf_checkpoint: PathBuf,
    /// Mean and deviation of the training displacements.
    #[arg(long, value_name = "FILE.npz")]
    stats: PathBuf,
    /// SMPL's body, .pkl or .npz.
    #[arg(long, value_name = "SMPL")]
    body: PathBuf,
    /// Clothing vertices; else derived from the body's blend weights.
    #[arg(long, value_name = "FILE.npy")]
    clothing: Option<PathBuf>,
    /// The release's configuration, flat YAML: checked against the weights, and for training on.
    #[arg(long, value_name = "FILE.yaml")]
    config: Option<PathBuf>,
    /// The generator's down-sampling factors, if they are not the release's default.
    #[arg(long, value_name = "N,N,…", value_delimiter = ',')]
    factors: Option<Vec<u32>>,
    /// The discriminator's down-sampling factors, if they are not twos.
    #[arg(long, value_name = "N,N,…", value_delimiter = ',')]
    discriminator_factors: Option<Vec<u32>>,
    /// The run's directory; it must be empty or missing.
    #[arg(long, value_name = "RUN")]
    out: PathBuf,
}

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    #[serde(flatten)]
    imported: ImportReport,
}

impl ImportArgs {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        let device = parse_device(&global.device)?;
        let options = ImportOptions {
            body: self.body,
            statistics: self.stats,
            clothing: self.clothing,
            factors: self.factors,
            discriminator_factors: self.discriminator_factors,
            settings: self.config,
        };
        let imported = release::import(&self.tf_checkpoint, &options, &self.out, &device)
            .map_err(Error::from)?;
        if !imported.unused.is_empty() {
            console.note(&format!("settings not used: {}", imported.unused.join(", ")));
        }
        let report = Report { out: self.out, imported };
        console.result(&report, || report.text())
    }
}

impl Report {
    fn text(&self) -> String {
        let ImportReport { checkpoint, variables, parameters, velocities, step, ignored, .. } =
            &self.imported;
        let mut table = Table::default();
        for (name, value) in [
            ("checkpoint", checkpoint.display().to_string()),
            ("variables", variables.to_string()),
            ("parameters", parameters.to_string()),
            ("velocities", velocities.to_string()),
            ("step", step.map_or_else(|| "not said".into(), |step| step.to_string())),
            ("not imported", ignored.len().to_string()),
        ] {
            table.row([name.to_owned(), value]);
        }
        let out = self.out.display();
        format!(
            "{}\n\n{out}\nnext: cape sample {out} --outfit all --out samples; cape eval {out} --data \
             PACKED",
            table.text()
        )
    }
}
