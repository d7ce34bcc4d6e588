//! Measuring trained models.

mod compare;
mod pose;
pub(crate) mod run;
mod samples;
mod speed;

use clap::Subcommand;

use crate::{console::Console, error::Result, options::GlobalArgs};

/// Measure trained models: run, compare, samples, pose, speed.
#[derive(Debug, Subcommand)]
#[command(
    after_help = "Example:\n  cape eval run runs/cape --data packed\n  cape eval compare runs/cape runs/other"
)]
pub(crate) enum EvalCommand {
    Run(run::EvalArgs),
    Compare(compare::CompareArgs),
    Samples(samples::EvalSamplesArgs),
    Pose(pose::PoseEffectArgs),
    Speed(speed::SpeedArgs),
}

impl EvalCommand {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        match self {
            Self::Run(command) => command.run(global, console),
            Self::Compare(command) => command.run(global, console),
            Self::Samples(command) => command.run(global, console),
            Self::Pose(command) => command.run(global, console),
            Self::Speed(command) => command.run(global, console),
        }
    }
}
