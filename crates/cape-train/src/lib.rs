//! CAPE data sets, training and evaluation.
//!
//! [`data`] turns registrations in the release's raw layout into packed sets and packed sets into
//! batches on host arrays; [`metrics`] measures reconstructions in millimetres and [`comparison`] puts
//! methods side by side; [`tensorboard`] writes what training reports; [`bench`](mod@bench) times it
//! all.

mod average;
pub mod bench;
pub mod checkpoint;
pub mod comparison;
pub mod config;
pub mod data;
pub mod detail;
mod error;
pub mod evaluate;
pub mod learner;
mod log;
pub mod metrics;
pub mod objective;
pub mod optim;
pub mod pca;
mod performance;
pub mod prior;
mod progress;
pub mod quality;
pub mod release;
mod run;
mod staging;
pub mod table2;
pub mod tensorboard;
mod trainer;
pub mod trial;
mod validate;
mod wear;

pub use config::{Rule, RunConfig, Schedule, TrainConfig, WarmUp};
pub use error::{Error, Result};
pub use evaluate::{
    EachFrame, EvalOptions, EvalReport, FrameError, Gathered, PosteriorUse, evaluate,
    reconstruct_test,
};
pub use performance::Performance;
pub use progress::{Progress, silent};
pub use run::{DataIdentity, Run, RunPaths, build_graphs, to_device, write_json};
pub use trainer::{Event, Outcome, Trainer};
pub use validate::{Illustrate, Picture, Preview};
pub use wear::{Wearer, directions_by_effect, interpolate_codes, walk_codes};
