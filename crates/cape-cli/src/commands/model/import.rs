use std::path::PathBuf;

use cape_train::release::{self, ImportOptions, ImportReport};
use clap::Args;
use serde::Serialize;

use crate::{
    console::Console,
    error::{Error, Result},
    options::GlobalArgs,
    table::Table,
};

/// Import the authors' TensorFlow checkpoint as a run.
///
/// Reads the checkpoint without TensorFlow and verifies its checksums. The architecture is derived from
/// the weights; missing, unknown or misshapen variables are errors. The run can be sampled, evaluated
/// and trained further like any other.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  cape model import --tf-checkpoint checkpoints/CAPE --stats \
                        trainset_stats.npz --body SMPL_MALE.pkl --clothing clothing_verts_idx.npy \
                        --out runs/imported")]
pub(crate) struct ImportArgs {
    /// Directory of the checkpoint, or its path without .index.
    #[arg(long, value_name = "DIR")]
    tf_checkpoint: PathBuf,
    /// Mean and standard deviation of the training displacements.
    #[arg(long, value_name = "FILE.npz")]
    stats: PathBuf,
    /// SMPL body, .pkl or .npz.
    #[arg(long, value_name = "SMPL")]
    body: PathBuf,
    /// Indices of the clothing vertices [default: derived from blend weights].
    #[arg(long, value_name = "FILE.npy")]
    clothing: Option<PathBuf>,
    /// Configuration of the release, YAML: checked against the weights and used for training.
    #[arg(long, value_name = "FILE.yaml")]
    config: Option<PathBuf>,
    /// Down-sampling factors of the generator [default: the release's].
    #[arg(long, value_name = "N,N,…", value_delimiter = ',')]
    factors: Option<Vec<u32>>,
    /// Down-sampling factors of the discriminator [default: 2 everywhere].
    #[arg(long, value_name = "N,N,…", value_delimiter = ',')]
    discriminator_factors: Option<Vec<u32>>,
    /// Directory of the new run; it must be empty or missing.
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
        let device = global.device()?;
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
            console.note(&format!("settings ignored: {}", imported.unused.join(", ")));
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
            ("momentum arrays", velocities.to_string()),
            ("step", step.map_or_else(|| "unknown".into(), |step| step.to_string())),
            ("variables ignored", ignored.len().to_string()),
        ] {
            table.row([name.to_owned(), value]);
        }
        let out = self.out.display();
        format!(
            "{}\n\n{out}\nnext: cape sample {out} --outfit all --out samples; cape eval run {out} \
             --data PACKED",
            table.text()
        )
    }
}
