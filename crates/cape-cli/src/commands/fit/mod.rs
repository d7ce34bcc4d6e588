//! Fitting clothed bodies to images and scans.

mod benchmark_image;
mod benchmark_scan;
mod drawing;
mod folder;
mod image;
mod mask_input;
mod method;
mod pose_prior;
mod scan;
mod video;

use clap::Subcommand;

use crate::{console::Console, error::Result, exit_code::ExitCode, options::GlobalArgs};

/// Fit clothed bodies to images and scans: image, scan, benchmark, pose-prior.
#[derive(Debug, Subcommand)]
#[command(
    after_help = "Example:\n  cape fit image runs/cape person_keypoints.json --mask person_mask.png --out \
                        fitted\n  cape fit scan runs/cape --scan person.ply --out fitted"
)]
pub(crate) enum FitCommand {
    Image(image::FitArgs),
    Scan(scan::FitScanArgs),
    #[command(subcommand)]
    Benchmark(BenchmarkCommand),
    PosePrior(pose_prior::FitPosePriorArgs),
}

/// Measure fitting on held-out frames of synthetic bodies: image, scan.
#[derive(Debug, Subcommand)]
#[command(
    after_help = "Example:\n  cape fit benchmark image runs/cape --out fits\n  cape fit benchmark \
                        scan runs/cape --out scans"
)]
pub(crate) enum BenchmarkCommand {
    Image(benchmark_image::FitBenchmarkArgs),
    Scan(benchmark_scan::ScanBenchmarkArgs),
}

impl FitCommand {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result<ExitCode> {
        match self {
            Self::Image(command) => return command.run(global, console),
            Self::Scan(command) => command.run(global, console)?,
            Self::Benchmark(BenchmarkCommand::Image(command)) => {
                return command.run(global, console);
            }
            Self::Benchmark(BenchmarkCommand::Scan(command)) => command.run(global, console)?,
            Self::PosePrior(command) => command.run(global, console)?,
        }
        Ok(ExitCode::SUCCESS)
    }
}
