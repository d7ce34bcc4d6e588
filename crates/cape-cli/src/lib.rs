//! The `cape` command line: arguments, progress, tables and pictures around the `cape` libraries.
//!
//! Results go to standard output (as JSON with `--json`), everything else to standard error.

mod arguments;
mod commands;
mod comparison;
mod console;
mod dashboard;
mod dressed_mesh;
mod error;
mod files;
mod fitting;
mod html;
mod interrupt;
mod latent_sampler;
mod mesh_file;
mod priors;
mod registration;
mod table;
mod training;

use std::process::ExitCode;

use clap::Parser;

use arguments::{Cli, forwarded};
use console::Console;
use error::Error;

/// Runs the command line on the process's arguments and returns its exit code: 0 for success, 1 for
/// an error, 2 for arguments that cannot be understood, 130 for a training that was interrupted.
pub fn main() -> ExitCode {
    let Cli { global, command } = Cli::parse_from(forwarded(std::env::args_os()));
    let console = Console::new(global.json, global.quiet);
    match use_threads(global.threads).and_then(|()| command.run(&global, console)) {
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
