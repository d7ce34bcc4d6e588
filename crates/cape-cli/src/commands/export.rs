use std::path::PathBuf;

use cape_core::npy::NpzWriter;
use cape_infer::{RunConfig, RunPaths, checkpoint};
use cape_model::{release, weights};
use clap::Args;
use ndarray::{ArrayD, IxDyn};
use serde::Serialize;

use crate::{
    console::Console,
    error::{Error, Result},
    table::Table,
};

/// Write a run's weights for other programs.
///
/// As a NumPy archive by the names of the authors' TensorFlow variables, or as safetensors by the
/// names of this library.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  cape export run --npz weights.npz --safetensors \
                        weights.safetensors")]
pub(crate) struct ExportArgs {
    /// A training run.
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// All weights by the names of the authors' release.
    #[arg(long, value_name = "FILE.npz", required_unless_present = "safetensors")]
    npz: Option<PathBuf>,
    /// All weights by the names of this library.
    #[arg(long, value_name = "FILE")]
    safetensors: Option<PathBuf>,
}

#[derive(Debug, Serialize)]
struct Report {
    checkpoint: PathBuf,
    tensors: usize,
    numbers: usize,
    files: Vec<PathBuf>,
}

impl ExportArgs {
    pub(crate) fn run(self, console: Console) -> Result {
        let paths = RunPaths::new(&self.run);
        let config = RunConfig::load(&paths.config())?;
        let checkpoint = checkpoint::best(&paths.checkpoints())?;
        let found = checkpoint::load_weights(&checkpoint)?;
        let mut report = Report {
            tensors: found.len(),
            numbers: found.values().map(|array| array.values.len()).sum(),
            files: Vec::new(),
            checkpoint,
        };
        if let Some(path) = self.npz {
            let mut npz = NpzWriter::create(&path)?;
            for (name, array) in release::export(&config.model, &found)? {
                let array = ArrayD::from_shape_vec(IxDyn(&array.shape), array.values)
                    .map_err(|error| Error::message(format!("{name}: {error}")))?;
                npz.add(&name, &array)?;
            }
            npz.finish()?;
            report.files.push(path);
        }
        if let Some(path) = self.safetensors {
            weights::save(&found, &path)?;
            report.files.push(path);
        }
        console.result(&report, || report.text())
    }
}

impl Report {
    fn text(&self) -> String {
        let mut table = Table::default();
        table.row(["checkpoint".to_owned(), self.checkpoint.display().to_string()]);
        table.row(["tensors".to_owned(), self.tensors.to_string()]);
        table.row(["numbers".to_owned(), self.numbers.to_string()]);
        let files: Vec<String> = self.files.iter().map(|path| path.display().to_string()).collect();
        format!("{}\n\n{}", table.text(), files.join("\n"))
    }
}
