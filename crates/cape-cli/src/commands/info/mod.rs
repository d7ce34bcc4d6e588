mod directory;
mod facts;
mod file;

use std::path::PathBuf;

use clap::Args;

use crate::{
    body_source::BuiltinBody,
    console::Console,
    error::{Error, Result},
};
use facts::FileSummary;

/// Describe a file or directory.
///
/// Recognises raw data, packed sets, runs, exported pyramids, TensorFlow checkpoints, bodies, pyramids,
/// statistics, frames, arrays, pickles, meshes, weights, model files and configurations.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  cape info packed\n  cape info body.npz --json\n  cape info female"
)]
pub(crate) struct InfoArgs {
    /// File, directory or built-in body: male, female, neutral or sculpted.
    #[arg(value_name = "PATH")]
    path: PathBuf,
}

impl InfoArgs {
    pub(crate) fn run(self, console: Console) -> Result {
        let path = &self.path;
        if let Some(body) = BuiltinBody::named(path) {
            let facts = file::describe_builtin(body)?;
            return console.result(&facts, || facts.text());
        }
        let metadata = std::fs::metadata(path).map_err(|error| Error::io(path, error))?;
        let facts: FileSummary =
            if metadata.is_dir() { directory::describe(path)? } else { file::describe(path)? };
        console.result(&facts, || facts.text())
    }
}
