//! Training of CAPE's networks: objective, optimisers, steps, checkpoints and logs.
//!
//! A [`Trainer`] trains the model of a run directory on a packed set and can be resumed at any
//! step. Its parts can be used on their own: [`objective`] evaluates the losses and their
//! gradients, [`optim`] has the optimisers, and a [`learner`] combines both. [`tensorboard`] writes
//! event files, and [`release`] imports the authors' TensorFlow checkpoints as runs. The processes of a
//! [`collective`] train one model together.
//!
//! From captures to a dressed body:
//!
//! ```
//! use std::ops::ControlFlow;
//!
//! use burn::tensor::Device;
//! use cape_core::Outfit;
//! use cape_synth::{Motion, CaptureGenerator, SynthSpec, synthetic_body};
//! use cape_model::CapeConfig;
//! use cape_core::silent;
//! use cape_data::{PackOptions, SequenceList, SplitSpec, pack};
//! use cape_infer::{Run, RunConfig, TrainConfig, BodySpec};
//! use cape_train::{Trainer, TrainerOptions};
//!
//! let directory = tempfile::tempdir()?;
//! let [raw, packed, run] = ["raw", "packed", "run"].map(|name| directory.path().join(name));
//!
//! // Training data: squats of a synthetic subject.
//! let spec = SynthSpec {
//!     subjects: 1,
//!     frames_per_sequence: 4,
//!     outfits: vec![Outfit::LONG_LONG],
//!     motions: vec![Motion::Squats],
//!     ..SynthSpec::default()
//! };
//! let split = SplitSpec {
//!     subjects: spec.subject_names(),
//!     outfits: spec.outfits.clone(),
//!     cut: 0,
//!     train: SequenceList { sequences: vec!["squats".into()], exclude: Vec::new() },
//!     test: SequenceList::default(),
//!     ..SplitSpec::default()
//! };
//! CaptureGenerator::new(&synthetic_body(), spec)?.write(&raw, &mut silent)?;
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
//! let mut trainer = Trainer::create(&run, TrainerOptions::new(&packed, config), &device)?;
//! assert!(trainer.run(&mut |_| ControlFlow::Continue(()))?.finished);
//!
//! let run = Run::open(&run, &device)?;
//! let body = BodySpec { betas: vec![1.0], pose: [0.0; 72], outfit: Outfit::LONG_LONG };
//! let dressed = run.dress(&run.sample_codes(1, 7), &[body])?;
//! assert_eq!(dressed[0].vertices.len(), 6890);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Further examples use the functions in `doc/sets.rs`: the captures `captures()` and the smaller
//! `triangles()`, the configuration `small_config()` and the run `trained()`.

pub mod collective;
mod create;
pub mod learner;
mod log;
pub mod objective;
pub mod optim;
mod parameter_average;
pub mod release;
pub mod tensorboard;
mod trainer;
mod validate;

pub use cape_infer::{Error, Result};

pub use trainer::{TrainEvent, TrainOutcome, Trainer, TrainerOptions};
pub use validate::{Preview, PreviewFn, TensorBoardImage, active_units};
