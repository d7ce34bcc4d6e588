//! Clothing layers of their own topology (Yang et al. 2018).

mod associate;
mod association;
mod clearance;
mod import;
mod learn;
mod motions;
mod pictures;
mod predict;
mod report;
mod synth;
mod transfer;

use clap::Subcommand;

use crate::{console::Console, error::Result, options::GlobalArgs};

/// Model skirts, dresses, T-shirts: synth, import, associate, learn, predict, transfer, report.
///
/// Clothing of its own topology over a moving body (Yang et al., ECCV 2018): simulated or imported
/// sequences are associated with the body, unposed, compressed by principal components and predicted
/// from motion, size and material.
#[derive(Debug, Subcommand)]
#[command(after_help = "Example:\n  cape layer synth --garment skirt --out skirt\n  \
                  cape layer learn skirt --out learned\n  \
                  cape layer predict learned/layer.npz --motion squats --out predicted")]
pub(crate) enum LayerCommand {
    Synth(synth::SynthArgs),
    Import(import::ImportArgs),
    Associate(associate::AssociateArgs),
    Learn(learn::LearnArgs),
    Predict(predict::PredictArgs),
    Transfer(transfer::TransferArgs),
    Report(report::ReportArgs),
}

impl LayerCommand {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        match self {
            Self::Synth(command) => command.run(console),
            Self::Import(command) => command.run(console),
            Self::Associate(command) => command.run(console),
            Self::Learn(command) => command.run(global, console),
            Self::Predict(command) => command.run(global, console),
            Self::Transfer(command) => command.run(console),
            Self::Report(command) => command.run(global, console),
        }
    }
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
