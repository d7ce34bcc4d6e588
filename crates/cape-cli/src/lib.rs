//! The `cape` command line: arguments, progress, tables and pictures around the `cape` libraries.
//!
//! Results go to standard output (as JSON with `--json`), everything else to standard error.

mod body_source;
mod cli;
mod commands;
mod comparison;
mod console;
mod dashboard;
mod dressed_mesh;
mod error;
mod files;
mod garment_labels;
mod html;
mod interrupt;
mod latent_sampler;
mod mesh_file;
mod motion_source;
mod options;
#[cfg(feature = "view")]
mod page_server;
mod priors;
mod registration;
mod table;
mod training;

use std::process::ExitCode;

use cli::Cli;
use console::Console;
use error::Error;

/// The tree of commands with its help, for tools that list or document it.
///
/// ```
/// let command = cape_cli::command();
/// assert!(command.find_subcommand("sample").is_some());
/// ```
pub fn command() -> clap::Command {
    cli::command()
}

/// Runs the command line on the process's arguments and returns its exit code: 0 for success, 1 for an
/// error, 2 for wrong usage, 130 for an interrupted command that can be resumed.
pub fn main() -> ExitCode {
    let cli = Cli::from_arguments();
    let console = Console::new(cli.global.json, cli.global.quiet);
    match use_threads(cli.global.threads).and_then(|()| cli.run(console)) {
        Ok(code) => code,
        Err(Error::OutputClosed) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{}", error::report(&error));
            ExitCode::FAILURE
        }
    }
}

fn use_threads(threads: Option<usize>) -> Result<(), Error> {
    let Some(threads) = threads else { return Ok(()) };
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build_global()
        .map_err(|error| Error::message(format!("--threads {threads}: {error}")))
}
