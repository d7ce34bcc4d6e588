//! Training of CAPE's networks: objective, optimisers, steps, checkpoints and logs.
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
//! use cape_core::Outfit;
//! use cape_synth::{Motion, CaptureGenerator, SynthSpec, synthetic_body};
//! use cape_model::CapeConfig;
//! use cape_core::silent;
//! use cape_data::{PackOptions, SequenceList, SplitSpec, pack};
//! use cape_infer::{Run, RunConfig, TrainConfig, BodySpec};
//! use cape_train::Trainer;
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
//! let split = SplitSpec {
//!     subjects: spec.subject_names(),
//!     outfits: spec.outfits.clone(),
//!     cut: 0,
//!     sample_rate: 1,
//!     train: SequenceList { sequences: vec!["squats".into()], exclude: Vec::new() },
//!     test: SequenceList::default(),
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
//! let mut trainer = Trainer::create(&run, &packed, None, None, config, &device)?;
//! assert!(trainer.run(&mut |_| ControlFlow::Continue(()))?.finished);
//!
//! let run = Run::open(&run, &device)?;
//! let wearer = BodySpec { betas: vec![1.0], pose: [0.0; 72], outfit: Outfit::LongLong };
//! let dressed = run.dress(&run.sample_codes(1, 7), &[wearer])?;
//! assert_eq!(dressed[0].vertices.len(), 6890);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Further examples start from such captures, `captures()` or the smaller `triangles()`, from the
//! configuration `small_config()`, and from the run `trained()`: `doc/sets.rs` has these functions.

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

pub use trainer::{TrainEvent, TrainOutcome, Trainer};
pub use validate::{Preview, PreviewFn, TensorBoardImage, active_units};
