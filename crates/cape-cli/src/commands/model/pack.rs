use std::{fs, path::PathBuf};

use cape_infer::{ModelFile, WeightStorage};
use clap::Args;
use serde::Serialize;

use crate::{
    console::Console,
    error::{Error, Result},
    options::{GlobalArgs, RunArgs},
    table::Table,
};

/// Pack a run into one file that every command takes in place of it.
///
/// The file has the generator's weights, configuration, statistics, clothing vertices and the mixture of
/// latent codes; the body must be a built-in one and is kept by name.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  cape model pack runs/cape --out model.safetensors --note \
                        'licence=CC BY 4.0'")]
pub(crate) struct PackModelArgs {
    #[command(flatten)]
    run: RunArgs,
    /// File to write.
    #[arg(long, value_name = "FILE.safetensors")]
    out: PathBuf,
    /// Keep the weights in single precision instead of half.
    #[arg(long)]
    single: bool,
    /// Keep matrices in eight bits, with a factor for each output: half the size of half precision.
    #[arg(long, conflicts_with = "single")]
    bytes: bool,
    /// Entry of the file's metadata; may be repeated.
    #[arg(long, value_name = "NAME=TEXT")]
    note: Vec<String>,
}

#[derive(Debug, Serialize)]
struct Report {
    file: PathBuf,
    body: String,
    numbers: usize,
    bytes: u64,
}

impl PackModelArgs {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        if self.out.extension().is_none_or(|end| end != "safetensors") {
            return Err(Error::message(format!(
                "--out {}: expected a file name that ends with .safetensors",
                self.out.display()
            )));
        }
        let mut model = ModelFile::of_run(&self.run.open(global)?)?;
        for note in &self.note {
            let Some((name, text)) = note.split_once('=') else {
                return Err(Error::message(format!("--note {note}: expected NAME=TEXT")));
            };
            model = model.with_entry(name, text);
        }
        let storage = match (self.single, self.bytes) {
            (true, _) => WeightStorage::Single,
            (_, true) => WeightStorage::Bytes,
            _ => WeightStorage::Half,
        };
        model.save(&self.out, storage)?;
        let size = fs::metadata(&self.out).map_err(|error| Error::io(&self.out, error))?;
        let report = Report {
            body: model.body().to_owned(),
            numbers: model.numbers(),
            bytes: size.len(),
            file: self.out,
        };
        console.result(&report, || report.text())
    }
}

impl Report {
    fn text(&self) -> String {
        let mut table = Table::default();
        table.row(["body".to_owned(), self.body.clone()]);
        table.row(["parameters".to_owned(), self.numbers.to_string()]);
        table.row(["size".to_owned(), format!("{:.1} MB", self.bytes as f64 / 1e6)]);
        format!("{}\n\n{}", table.text(), self.file.display())
    }
}
