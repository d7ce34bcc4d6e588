//! Clothing layers of their own topology (Yang et al. 2018).

mod learn;
mod predict;
mod synth;

use std::path::Path;

use cape_core::{SmplModel, synth::synthetic_body};
use clap::{Args, Subcommand};

use crate::{arguments::Global, console::Console, error::Result};

/// Clothing of its own topology over a moving body: skirts, dresses, T-shirts, shorts.
///
/// Simulated or imported sequences are tied to the body, freed from its pose, compressed by
/// principal components and predicted from motion, size and material (Yang et al., ECCV 2018).
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  cape layer synth --garment skirt --out skirt\n  \
                  cape layer learn skirt --out learnt\n  \
                  cape layer predict learnt/layer.npz --motion squats --out predicted")]
pub(crate) struct Layer {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Synth(synth::Synth),
    Learn(learn::Learn),
    Predict(predict::Predict),
}

impl Layer {
    pub(crate) fn run(self, global: &Global, console: Console) -> Result {
        match self.command {
            Command::Synth(command) => command.run(console),
            Command::Learn(command) => command.run(global, console),
            Command::Predict(command) => command.run(console),
        }
    }
}

/// The body that was given, or the synthetic one.
fn body(path: Option<&Path>) -> Result<SmplModel> {
    Ok(match path {
        Some(path) => SmplModel::load(path)?,
        None => synthetic_body(),
    })
}
