//! CAPE data sets, training and evaluation.
//!
//! [`data`] turns registrations in the release's raw layout into packed sets and packed sets into
//! batches on host arrays; [`metrics`] measures reconstructions in millimetres and [`comparison`] puts
//! methods side by side; [`tensorboard`] writes what training reports; [`bench`](mod@bench) times it
//! all.
//!
//! From captures to a dressed body:
//!
//! ```
//! use std::ops::ControlFlow;
//!
//! use burn::tensor::Device;
//! use cape_core::{Outfit, synth::{Motion, Synth, SynthSpec, synthetic_body}};
//! use cape_model::CapeConfig;
//! use cape_train::{
//!     Run, RunConfig, TrainConfig, Trainer, Wearer,
//!     data::{PackOptions, SequenceList, Split, pack},
//!     silent,
//! };
//!
//! let directory = tempfile::tempdir()?;
//! let [raw, packed, run] = ["raw", "packed", "run"].map(|name| directory.path().join(name));
//!
//! // A synthetic subject's squats, to train on.
//! let spec = SynthSpec {
//!     subjects: 1,
//!     frames_per_sequence: 4,
//!     outfits: vec![Outfit::LongLong],
//!     motions: vec![Motion::Squats],
//!     ..SynthSpec::default()
//! };
//! let split = Split {
//!     subjects: spec.subject_names(),
//!     outfits: spec.outfits.clone(),
//!     cut: 0,
//!     sample_rate: 1,
//!     train: SequenceList { sequences: vec!["squats".into()], exclude: Vec::new() },
//!     test: SequenceList::default(),
//! };
//! Synth::new(&synthetic_body(), spec)?.write(&raw, &mut silent)?;
//! pack(&raw, &packed, &split, PackOptions::default(), &mut silent)?;
//!
//! let config = RunConfig {
//!     model: CapeConfig {
//!         filters: vec![4],
//!         factors: vec![1],
//!         discriminator: None,
//!         ..CapeConfig::tiny()
//!     },
//!     train: TrainConfig { epochs: 1, warmup_epochs: 1.0, batch: 2, ..TrainConfig::default() },
//!     ..RunConfig::default()
//! };
//! let device = Device::default();
//! let mut trainer = Trainer::create(&run, &packed, None, None, config, &device)?;
//! assert!(trainer.run(&mut |_| ControlFlow::Continue(()))?.finished);
//!
//! let run = Run::open(&run, &device)?;
//! let wearer = Wearer { betas: vec![1.0], pose: [0.0; 72], outfit: Outfit::LongLong };
//! let dressed = run.dress(&run.sample_codes(1, 7), &[wearer])?;
//! assert_eq!(dressed[0].vertices.len(), 6890);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Further examples start from such captures, `captures()` or the smaller `triangles()`, from the
//! configuration `small_config()`, and from the run `trained()`: `doc/sets.rs` has these functions.

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
