use std::path::{Path, PathBuf};

use cape_core::npy::NpzWriter;
use cape_infer::{RunConfig, RunPaths, checkpoint};
use cape_model::{release, weights};
use cape_onnx::{ExportedFile, WeightPrecision, export_model};
use clap::{ArgGroup, Args};
use ndarray::{ArrayD, IxDyn};
use serde::Serialize;

use crate::{
    console::Console,
    error::{Error, Result},
    files,
    options::{GlobalArgs, RunArgs},
    table::Table,
};

/// Export a model for other programs: as ONNX graphs, or its weights.
///
/// --onnx writes decoder.onnx (code, pose and outfit to displacements in metres), encoder.onnx and
/// smpl.onnx (shape, pose, translation and displacements to vertices and joints). --npz writes a NumPy
/// archive of the weights with the names of the authors' TensorFlow variables, --safetensors a file with
/// the names of this library; both need the directory of a run.
#[derive(Debug, Args)]
#[command(
    group(ArgGroup::new("target").required(true).multiple(true).args(["onnx", "npz", "safetensors"])),
    after_help = "Examples:\n  cape model export --onnx graphs --half\n  cape model export runs/cape --npz \
                  weights.npz --safetensors weights.safetensors"
)]
pub(crate) struct ExportArgs {
    #[command(flatten)]
    run: RunArgs,
    /// Directory to write ONNX graphs into; it is created if missing.
    #[arg(long, value_name = "DIR")]
    onnx: Option<PathBuf>,
    /// Keep the weights of the ONNX graphs in half precision; they compute in single precision.
    #[arg(long, requires = "onnx")]
    half: bool,
    /// Archive to write, with the authors' names.
    #[arg(long, value_name = "FILE.npz")]
    npz: Option<PathBuf>,
    /// File to write, with the names of this library.
    #[arg(long, value_name = "FILE")]
    safetensors: Option<PathBuf>,
}

#[derive(Debug, Serialize)]
struct Report {
    #[serde(flatten)]
    weights: Option<WeightsReport>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    graphs: Vec<ExportedFile>,
    files: Vec<PathBuf>,
}

#[derive(Debug, Serialize)]
struct WeightsReport {
    checkpoint: PathBuf,
    tensors: usize,
    numbers: usize,
}

impl ExportArgs {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        let mut report = Report { weights: None, graphs: Vec::new(), files: Vec::new() };
        if self.npz.is_some() || self.safetensors.is_some() {
            report.weights = Some(self.export_weights(&mut report.files)?);
        }
        if let Some(directory) = &self.onnx {
            report.graphs = self.export_graphs(directory, global)?;
            report.files.extend(report.graphs.iter().map(|graph| graph.path.clone()));
        }
        console.result(&report, || report.text())
    }

    fn export_graphs(&self, directory: &Path, global: &GlobalArgs) -> Result<Vec<ExportedFile>> {
        let run = self.run.open(global)?;
        files::create_dir(directory)?;
        let precision = if self.half { WeightPrecision::Half } else { WeightPrecision::Single };
        Ok(export_model(&run, directory, precision)?)
    }

    fn export_weights(&self, files: &mut Vec<PathBuf>) -> Result<WeightsReport> {
        let paths = RunPaths::new(self.run.directory()?);
        let config = RunConfig::load(&paths.config())?;
        let checkpoint = checkpoint::best(&paths.checkpoints())?;
        let found = checkpoint::load_weights(&checkpoint)?;
        if let Some(path) = &self.npz {
            let mut npz = NpzWriter::create(path)?;
            for (name, array) in release::export(&config.model, &found)? {
                let array = ArrayD::from_shape_vec(IxDyn(&array.shape), array.values)
                    .map_err(|error| Error::message(format!("{name}: {error}")))?;
                npz.add(&name, &array)?;
            }
            npz.finish()?;
            files.push(path.clone());
        }
        if let Some(path) = &self.safetensors {
            weights::save(&found, path)?;
            files.push(path.clone());
        }
        Ok(WeightsReport {
            tensors: found.len(),
            numbers: found.values().map(|array| array.values.len()).sum(),
            checkpoint,
        })
    }
}

impl Report {
    fn text(&self) -> String {
        let mut parts = Vec::new();
        if let Some(weights) = &self.weights {
            let mut table = Table::default();
            table.row(["checkpoint".to_owned(), weights.checkpoint.display().to_string()]);
            table.row(["tensors".to_owned(), weights.tensors.to_string()]);
            table.row(["parameters".to_owned(), weights.numbers.to_string()]);
            parts.push(table.text());
        }
        if !self.graphs.is_empty() {
            let mut table = Table::new(["graph", "size", "nodes", "inputs", "outputs"]);
            for graph in &self.graphs {
                table.row([
                    graph.path.file_name().unwrap_or_default().to_string_lossy().into_owned(),
                    format!("{:.1} MB", graph.bytes as f64 / 1e6),
                    graph.nodes.to_string(),
                    graph.inputs.join(", "),
                    graph.outputs.join(", "),
                ]);
            }
            parts.push(table.text());
        }
        let files: Vec<String> = self.files.iter().map(|path| path.display().to_string()).collect();
        parts.push(files.join("\n"));
        parts.join("\n\n")
    }
}
