//! Data sets: from registrations to batches.
//!
//! The **raw layout** ([`raw`]) has one file per frame, the **packed layout** ([`pack`](mod@pack))
//! one array for all frames; both are those of the CAPE release, so that files can be exchanged
//! with the official tools. A [`SplitSpec`] selects training and test frames. [`PackedSet`] reads
//! batches from a packed set, [`DisplacementStatistics`] normalises them, and [`Loader`] draws and
//! prefetches them for training.
//!
//! ```
//! use cape_data::SplitSpec;
//!
//! let split = SplitSpec::preset("male")?;
//! assert_eq!((split.subjects.len(), split.test.sequences.len()), (7, 4));
//!
//! let directory = tempfile::tempdir()?;
//! let path = directory.path().join("split.toml");
//! std::fs::write(&path, split.to_toml()?)?;
//! assert_eq!(SplitSpec::from_file(&path)?, split);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod batch_part;
mod components;
mod foreign;
pub mod inspect;
mod loader;
mod npy_rows;
pub mod pack;
mod pack_log;
mod pack_plan;
mod packed;
mod pairing;
pub mod raw;
mod row_order;
mod shuffle;
mod split;
mod split_writer;
mod statistics;
mod tree;
pub mod unpose;

pub use cape_core::{Error, Result};

pub use batch_part::BatchPart;
pub use components::principal_components;
pub use foreign::ForeignData;
pub use loader::{Loader, LoaderOptions, LoaderState, StepBatches, sequential, steps_per_epoch};
pub use pack::{PackOptions, PackReport, pack};
pub use packed::{FrameOrigin, HostBatch, PackedSet, Split};
pub use shuffle::{Shuffle, ShufflePosition, ShuffleStream};
pub use split::{SequenceList, SplitSpec};
pub use statistics::{DisplacementStatistics, MIN_STD, STATISTICS_FILE, validation_count};
pub use tree::{FrameSource, KNOWN_BROKEN, ListedSequence, RawCapture, RawTree, SubjectParameters};
