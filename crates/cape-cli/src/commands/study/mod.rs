//! Perceptual studies (CAPE §6.2).

mod export;
mod make;
mod score;
#[cfg(feature = "view")]
mod serve;
#[cfg(feature = "view")]
mod server;
mod source;

use clap::Subcommand;

use crate::{console::Console, error::Result, options::GlobalArgs};

/// Judge generated clothing by people: make, serve, export, score.
///
/// The perceptual study of CAPE §6.2 (table 3): raters see two pictures side by side, one of a
/// registration and one generated, and choose the one that they take for real. Of generated bodies that
/// cannot be told from registrations, half are taken for real.
#[derive(Debug, Subcommand)]
#[command(after_help = "Example:\n  cape study make runs/cape --out study\n  \
                  cape study serve study --raters 10\n  cape study score study")]
pub(crate) enum StudyCommand {
    Make(make::MakeArgs),
    #[cfg(feature = "view")]
    Serve(serve::ServeArgs),
    Export(export::ExportArgs),
    Score(score::ScoreArgs),
}

impl StudyCommand {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        match self {
            Self::Make(command) => command.run(global, console),
            #[cfg(feature = "view")]
            Self::Serve(command) => command.run(console),
            Self::Export(command) => command.run(console),
            Self::Score(command) => command.run(console),
        }
    }
}
