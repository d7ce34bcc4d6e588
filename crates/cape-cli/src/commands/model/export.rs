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
    options::RunArgs,
    table::Table,
};

/// Export a run's weights for other programs.
///
/// Writes a NumPy archive with the names of the authors' TensorFlow variables, safetensors with the
/// names of this library, or both.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  cape model export runs/cape --npz weights.npz --safetensors \
                        weights.safetensors")]
pub(crate) struct ExportArgs {
    #[command(flatten)]
    run: RunArgs,
    /// Archive to write, with the authors' names.
    #[arg(long, value_name = "FILE.npz", required_unless_present = "safetensors")]
    npz: Option<PathBuf>,
    /// File to write, with the names of this library.
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
        let paths = RunPaths::new(self.run.directory()?);
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
        table.row(["parameters".to_owned(), self.numbers.to_string()]);
        let files: Vec<String> = self.files.iter().map(|path| path.display().to_string()).collect();
        format!("{}\n\n{}", table.text(), files.join("\n"))
    }
}
