//! Clothing layers of their own topology (Yang et al. 2018).

mod associate;
mod association;
mod import;
mod learn;
mod motions;
mod pictures;
mod predict;
mod report;
mod synth;

use std::path::Path;

use cape_core::SmplModel;
use cape_synth::synthetic_body;
use clap::{Args, Subcommand};

use crate::{arguments::GlobalArgs, console::Console, error::Result};

/// Clothing of its own topology over a moving body: skirts, dresses, T-shirts, shorts.
///
/// Simulated or imported sequences are tied to the body, freed from its pose, compressed by
/// principal components and predicted from motion, size and material (Yang et al., ECCV 2018).
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  cape layer synth --garment skirt --out skirt\n  \
                  cape layer learn skirt --out learnt\n  \
                  cape layer predict learnt/layer.npz --motion squats --out predicted\n  \
                  cape layer report --quick --out quick")]
pub(crate) struct LayerArgs {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Synth(synth::SynthArgs),
    Import(import::ImportArgs),
    Associate(associate::AssociateArgs),
    Learn(learn::LearnArgs),
    Predict(predict::PredictArgs),
    Report(report::ReportArgs),
}

impl LayerArgs {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        match self.command {
            Command::Synth(command) => command.run(console),
            Command::Import(command) => command.run(console),
            Command::Associate(command) => command.run(console),
            Command::Learn(command) => command.run(global, console),
            Command::Predict(command) => command.run(console),
            Command::Report(command) => command.run(global, console),
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

/// Parses `name=number`.
fn named(text: &str) -> Result<(String, f64), String> {
    let (name, value) = text.split_once('=').ok_or("expected NAME=NUMBER")?;
    let value: f64 = value.trim().parse().map_err(|_| format!("`{value}` is not a number"))?;
    if name.trim().is_empty() || !value.is_finite() {
        return Err("expected a name and a finite number".into());
    }
    Ok((name.trim().to_owned(), value))
}
