use std::{ffi::OsString, process::ExitCode};

use cape_core::Outfit;
use clap::{Args, CommandFactory, Parser, Subcommand};

use crate::{commands, console::Console, error::Result};

/// Clothed 3D people: CAPE's conditional Mesh-VAE-GAN on SMPL bodies.
#[derive(Debug, Parser)]
#[command(name = "cape", version, arg_required_else_help = true, propagate_version = true)]
pub(crate) struct Cli {
    #[command(flatten)]
    pub(crate) global: GlobalArgs,
    #[command(subcommand)]
    pub(crate) command: Command,
}

/// Options that every command takes.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Global options")]
pub(crate) struct GlobalArgs {
    /// Where tensors live: flex, ndarray, wgpu[:index] or cuda[:index], as far as compiled in.
    #[arg(long, global = true, default_value = default_device(), value_name = "NAME")]
    pub(crate) device: String,
    /// What all randomness follows from; each command has its own default.
    #[arg(long, global = true, value_name = "S")]
    pub(crate) seed: Option<u64>,
    /// Print the result on standard output as JSON.
    #[arg(long, global = true)]
    pub(crate) json: bool,
    /// Show no progress and no notes.
    #[arg(long, short, global = true)]
    pub(crate) quiet: bool,
    /// Threads to compute with; by default one for each core.
    #[arg(long, global = true, value_name = "N", value_parser = at_least_one)]
    pub(crate) threads: Option<usize>,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    Synth(commands::synth::SynthArgs),
    Pack(commands::pack::PackArgs),
    Pyramid(commands::pyramid::PyramidArgs),
    Train(commands::train::TrainArgs),
    Eval(commands::eval::EvalArgs),
    #[command(name = "table2")]
    Table2(commands::table2::Table2Args),
    Compare(commands::compare::CompareArgs),
    FitPrior(commands::fit_prior::FitPriorArgs),
    Sample(commands::sample::SampleArgs),
    EvalSamples(commands::eval_samples::EvalSamplesArgs),
    Vary(commands::vary::VaryArgs),
    Encode(commands::encode::EncodeArgs),
    Redress(commands::redress::RedressArgs),
    Generate(commands::generate::GenerateArgs),
    Animate(commands::animate::AnimateArgs),
    PoseEffect(commands::pose_effect::PoseEffectArgs),
    #[cfg(feature = "view")]
    View(commands::view::ViewArgs),
    Fit(commands::fit::FitArgs),
    FitScan(commands::fit_scan::FitScanArgs),
    FitBenchmark(commands::fit_benchmark::FitBenchmarkArgs),
    ScanBenchmark(commands::scan_benchmark::ScanBenchmarkArgs),
    FitPosePrior(commands::fit_pose_prior::FitPosePriorArgs),
    Layer(commands::layer::LayerArgs),
    Import(commands::import::ImportArgs),
    Export(commands::export::ExportArgs),
    Inspect(commands::inspect::InspectArgs),
    Unpose(commands::unpose::UnposeArgs),
    Info(commands::info::InfoArgs),
    Bench(commands::bench::BenchArgs),
    Demo(commands::demo::DemoArgs),
}

impl Command {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result<ExitCode> {
        match self {
            Self::Synth(command) => command.run(global, console)?,
            Self::Pack(command) => command.run(console)?,
            Self::Pyramid(command) => command.run(console)?,
            Self::Train(command) => return command.run(global, console),
            Self::Eval(command) => command.run(global, console)?,
            Self::Table2(command) => return command.run(global, console),
            Self::Compare(command) => command.run(global, console)?,
            Self::FitPrior(command) => command.run(global, console)?,
            Self::Sample(command) => command.run(global, console)?,
            Self::EvalSamples(command) => command.run(global, console)?,
            Self::Vary(command) => command.run(global, console)?,
            Self::Encode(command) => command.run(global, console)?,
            Self::Redress(command) => command.run(global, console)?,
            Self::Generate(command) => command.run(global, console)?,
            Self::Animate(command) => command.run(global, console)?,
            Self::PoseEffect(command) => command.run(global, console)?,
            #[cfg(feature = "view")]
            Self::View(command) => command.run(global, console)?,
            Self::Fit(command) => command.run(global, console)?,
            Self::FitScan(command) => command.run(global, console)?,
            Self::ScanBenchmark(command) => command.run(global, console)?,
            Self::FitBenchmark(command) => return command.run(global, console),
            Self::FitPosePrior(command) => command.run(global, console)?,
            Self::Layer(command) => command.run(global, console)?,
            Self::Import(command) => command.run(global, console)?,
            Self::Export(command) => command.run(console)?,
            Self::Inspect(command) => command.run(console)?,
            Self::Unpose(command) => command.run(console)?,
            Self::Info(command) => command.run(console)?,
            Self::Bench(command) => command.run(global, console)?,
            Self::Demo(command) => command.run(global, console)?,
        }
        Ok(ExitCode::SUCCESS)
    }
}

/// What commands with an option for scans stand for.
const FORWARDED: [[&str; 3]; 2] =
    [["fit", "--scan", "fit-scan"], ["fit-benchmark", "--scans", "scan-benchmark"]];

/// The arguments with `fit … --scan` as what it stands for, `fit-scan … --scan`, and others alike.
pub(crate) fn forwarded(arguments: impl IntoIterator<Item = OsString>) -> Vec<OsString> {
    let mut arguments: Vec<OsString> = arguments.into_iter().collect();
    let cli = Cli::command();
    let is_command =
        |word: &OsString| word.to_str().is_some_and(|word| cli.find_subcommand(word).is_some());
    let Some(at) = arguments.iter().skip(1).position(is_command).map(|at| at + 1) else {
        return arguments;
    };
    for [command, option, instead] in FORWARDED {
        let is_option = |word: &OsString| {
            let word = word.to_string_lossy();
            word == option || word.strip_prefix(option).is_some_and(|rest| rest.starts_with('='))
        };
        if arguments[at] == command
            && arguments[at..].iter().take_while(|word| *word != "--").any(is_option)
        {
            arguments[at] = instead.into();
        }
    }
    arguments
}

/// The device that is used if none is named: the first that is compiled in.
pub(crate) fn default_device() -> &'static str {
    cape_core::DEVICES.first().copied().unwrap_or("flex")
}

/// Parses a count.
pub(crate) fn at_least_one(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(0) => Err("must be at least 1".into()),
        Ok(count) => Ok(count),
        Err(_) => Err("expected a whole number".into()),
    }
}

/// Parses the name of an outfit.
pub(crate) fn outfit(text: &str) -> Result<Outfit, String> {
    text.parse().map_err(|error: cape_core::Error| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fits_with_a_scan_are_fits_to_it() {
        let command = |line: &str| {
            let words = forwarded(line.split_whitespace().map(OsString::from));
            words.iter().map(|word| word.to_str().unwrap()).collect::<Vec<_>>().join(" ")
        };
        assert_eq!(
            command("cape --json fit run --scan a.ply"),
            "cape --json fit-scan run --scan a.ply"
        );
        assert_eq!(command("cape fit --scan=a.ply run"), "cape fit-scan --scan=a.ply run");
        assert_eq!(command("cape fit-benchmark --scans"), "cape scan-benchmark --scans");
        for other in
            ["cape fit run a.json --mask b.png", "cape info fit --scan", "cape fit -- --scan"]
        {
            assert_eq!(command(other), other);
        }
    }

    #[test]
    fn the_arguments_are_consistent_and_every_command_has_an_example() {
        let mut cli = Cli::command();
        cli.build();
        cli.clone().debug_assert();
        for command in cli.get_subcommands().filter(|command| command.get_name() != "help") {
            let help = command.clone().render_long_help().to_string();
            let example = format!("cape {}", command.get_name());
            let after = help.split("Example").nth(1).unwrap_or_default();
            assert!(after.contains(&example), "{help}");
        }
    }
}
