//! Models in and out, latent codes, priors and mesh pyramids.

mod encode;
mod export;
mod import;
mod pack;
mod prior;
pub(crate) mod pyramid;

use clap::Subcommand;

use crate::{console::Console, error::Result, options::GlobalArgs};

/// Convert models and their parts: import, export, pack, encode, prior, pyramid.
#[derive(Debug, Subcommand)]
#[command(
    after_help = "Example:\n  cape model prior runs/cape\n  cape model export runs/cape --npz weights.npz"
)]
pub(crate) enum ModelCommand {
    Import(import::ImportArgs),
    Export(export::ExportArgs),
    Pack(pack::PackModelArgs),
    Encode(encode::EncodeArgs),
    Prior(prior::FitPriorArgs),
    Pyramid(pyramid::PyramidArgs),
}

impl ModelCommand {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        match self {
            Self::Import(command) => command.run(global, console),
            Self::Export(command) => command.run(global, console),
            Self::Pack(command) => command.run(global, console),
            Self::Encode(command) => command.run(global, console),
            Self::Prior(command) => command.run(global, console),
            Self::Pyramid(command) => command.run(console),
        }
    }
}
