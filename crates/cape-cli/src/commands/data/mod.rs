//! Captures: synthetic ones, packing, inspection, unposing, and dressed bodies in bulk.

mod generate;
mod inspect;
mod pack;
mod simulated;
pub(crate) mod synth;
mod tree_files;
mod unpose;

use clap::Subcommand;

use crate::{console::Console, error::Result, options::GlobalArgs};

/// Create, pack and inspect training data: synth, pack, inspect, unpose, generate.
#[derive(Debug, Subcommand)]
#[command(
    after_help = "Example:\n  cape data synth --out raw\n  cape data pack raw --preset male --out packed"
)]
pub(crate) enum DataCommand {
    Synth(synth::SynthArgs),
    Pack(pack::PackArgs),
    Inspect(inspect::InspectArgs),
    Unpose(unpose::UnposeArgs),
    Generate(generate::GenerateArgs),
}

impl DataCommand {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        match self {
            Self::Synth(command) => command.run(global, console),
            Self::Pack(command) => command.run(console),
            Self::Inspect(command) => command.run(console),
            Self::Unpose(command) => command.run(console),
            Self::Generate(command) => command.run(global, console),
        }
    }
}
