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
mod exit_code;
mod files;
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

use std::{
    env,
    ffi::OsString,
    io::{self, Write},
    process,
};

use cli::Cli;
use console::Console;
use error::Error;
use exit_code::ExitCode;

/// The tree of commands with its help, for tools that list or document it.
///
/// ```
/// let command = cape_cli::command();
/// assert!(command.find_subcommand("sample").is_some());
/// ```
pub fn command() -> clap::Command {
    cli::command()
}

/// Runs the command line on the process's arguments and returns its exit code, see [`run`].
pub fn main() -> process::ExitCode {
    run(env::args_os()).into()
}

/// Runs the command line on `arguments`, of which the first is the program's name, and returns its exit
/// code: 0 for success, 1 for an error, 2 for wrong usage, 130 for an interrupted command that can be
/// resumed.
///
/// ```
/// assert_eq!(cape_cli::run(["cape", "--version"]), 0);
/// assert_eq!(cape_cli::run(["cape", "undress"]), 2);
/// ```
pub fn run(arguments: impl IntoIterator<Item = impl Into<OsString> + Clone>) -> u8 {
    let code = Cli::from_arguments(arguments).map_or_else(usage, execute);
    // A host program, unlike Rust's own `main`, does not write out what is left in the buffer.
    let _ = io::stdout().flush();
    code
}

fn execute(cli: Cli) -> u8 {
    let console = Console::new(cli.global.json, cli.global.quiet);
    match use_threads(cli.global.threads).and_then(|()| cli.run(console)) {
        Ok(code) => code.number(),
        Err(Error::OutputClosed) => ExitCode::SUCCESS.number(),
        Err(error) => {
            eprintln!("{}", error::report(&error));
            ExitCode::FAILURE.number()
        }
    }
}

/// Prints help, the version or an error of usage.
fn usage(message: clap::Error) -> u8 {
    let _ = message.print();
    message.exit_code() as u8
}

/// Sets the number of CPU threads, if one is given.
pub(crate) fn use_threads(threads: Option<usize>) -> Result<(), Error> {
    let Some(threads) = threads else { return Ok(()) };
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build_global()
        .map_err(|error| Error::message(format!("--threads {threads}: {error}")))
}
