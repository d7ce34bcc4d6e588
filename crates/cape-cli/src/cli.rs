//! The tree of commands: its help, and what each command runs.

mod help;

pub(crate) use help::command;

use std::{ffi::OsString, io, path::PathBuf};

use clap::{Args, FromArgMatches, Parser, Subcommand};
use clap_complete::Shell;

#[cfg(feature = "view")]
use crate::commands::view;
use crate::{
    commands::{
        animate, body, data, demo, eval, fit, info, layer, model, redress, sample, study, table2,
        train, vary,
    },
    console::Console,
    error::{Error, Result},
    exit_code::ExitCode,
    files,
    options::GlobalArgs,
};

/// Dress SMPL bodies: sample, train, evaluate and fit CAPE, a generative model of clothing.
#[derive(Debug, Parser)]
#[command(
    name = "cape",
    version,
    arg_required_else_help = true,
    propagate_version = true,
    after_help = "Example:\n  cape demo --out demo\n\n`cape COMMAND --help` explains a command."
)]
pub(crate) struct Cli {
    #[command(flatten)]
    pub(crate) global: GlobalArgs,
    #[command(subcommand)]
    pub(crate) command: Command,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    Demo(demo::DemoArgs),
    #[command(subcommand)]
    Data(data::DataCommand),
    Train(train::TrainArgs),
    #[command(subcommand)]
    Eval(eval::EvalCommand),
    #[command(name = "table2")]
    Table2(table2::Table2Args),
    Sample(sample::SampleArgs),
    Vary(vary::VaryArgs),
    Redress(redress::RedressArgs),
    Animate(animate::AnimateArgs),
    #[cfg(feature = "view")]
    View(view::ViewArgs),
    #[command(subcommand)]
    Fit(fit::FitCommand),
    #[command(subcommand)]
    Layer(layer::LayerCommand),
    #[command(subcommand)]
    Study(study::StudyCommand),
    #[command(subcommand)]
    Model(model::ModelCommand),
    #[command(subcommand)]
    Body(body::BodyCommand),
    Info(info::InfoArgs),
    Completions(CompletionsArgs),
    Man(ManArgs),
}

/// Print shell completions.
#[derive(Debug, Args)]
#[command(
    hide = true,
    after_help = "Example:\n  cape completions bash > ~/.local/share/bash-completion/completions/cape"
)]
pub(crate) struct CompletionsArgs {
    /// Shell.
    #[arg(value_name = "SHELL")]
    shell: Shell,
}

/// Write man pages, one for each command.
#[derive(Debug, Args)]
#[command(hide = true, after_help = "Example:\n  cape man man1")]
pub(crate) struct ManArgs {
    /// Directory to write; it is created if missing.
    #[arg(value_name = "DIR")]
    directory: PathBuf,
}

impl Cli {
    /// Parses arguments, of which the first is the program's name.
    ///
    /// # Errors
    /// Help or the version, where asked for, or an error of usage.
    pub(crate) fn from_arguments(
        arguments: impl IntoIterator<Item = impl Into<OsString> + Clone>,
    ) -> Result<Self, clap::Error> {
        let mut matches = command().try_get_matches_from(arguments)?;
        Self::from_arg_matches_mut(&mut matches).map_err(|error| error.format(&mut command()))
    }

    pub(crate) fn run(self, console: Console) -> Result<ExitCode> {
        let Self { global, command } = self;
        let global = &global;
        match command {
            Command::Demo(command) => command.run(global, console)?,
            Command::Data(command) => command.run(global, console)?,
            Command::Train(command) => return command.run(global, console),
            Command::Eval(command) => command.run(global, console)?,
            Command::Table2(command) => return command.run(global, console),
            Command::Sample(command) => command.run(global, console)?,
            Command::Vary(command) => command.run(global, console)?,
            Command::Redress(command) => command.run(global, console)?,
            Command::Animate(command) => command.run(global, console)?,
            #[cfg(feature = "view")]
            Command::View(command) => command.run(global, console)?,
            Command::Fit(command) => return command.run(global, console),
            Command::Layer(command) => command.run(global, console)?,
            Command::Study(command) => command.run(global, console)?,
            Command::Model(command) => command.run(global, console)?,
            Command::Body(command) => command.run(console)?,
            Command::Info(command) => command.run(console)?,
            Command::Completions(command) => command.run()?,
            Command::Man(command) => command.run()?,
        }
        Ok(ExitCode::SUCCESS)
    }
}

impl CompletionsArgs {
    fn run(self) -> Result {
        let mut script = Vec::new();
        clap_complete::generate(self.shell, &mut command(), "cape", &mut script);
        io::Write::write_all(&mut io::stdout(), &script).map_err(Error::output)
    }
}

impl ManArgs {
    fn run(self) -> Result {
        files::create_dir(&self.directory)?;
        clap_mangen::generate_to(help::plain(), &self.directory)
            .map_err(|error| Error::io(&self.directory, error))
    }
}
