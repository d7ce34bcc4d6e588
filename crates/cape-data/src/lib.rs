//! Data sets: from registrations to batches.
//!
//! The **raw layout** ([`raw`]) holds one file a frame, the **packed layout** ([`pack`](mod@pack))
//! one array for all frames; both are the release's own, so files made by the official tools can be
//! used here and the other way round. A [`SplitSpec`] says which frames train and which test.
//! [`PackedSet`] reads batches from a packed set, [`DisplacementStatistics`] normalises them, and [`Loader`]
//! draws and prefetches them for training.

mod components;
pub mod inspect;
mod loader;
mod npy_rows;
pub mod pack;
mod pack_log;
mod packed;
pub mod raw;
mod shuffle;
mod split;
mod split_writer;
mod statistics;
pub mod unpose;

pub use cape_core::{Error, Result};

pub use components::principal_components;
pub use loader::{Loader, LoaderOptions, LoaderState, StepBatches, sequential, steps_per_epoch};
pub use pack::{PackOptions, PackReport, pack};
pub use packed::{FrameOrigin, HostBatch, PackedSet, Split};
pub use shuffle::{Shuffle, ShufflePosition, ShuffleStream};
pub use split::{SequenceList, SplitSpec};
pub use statistics::{DisplacementStatistics, MIN_STD, STATISTICS_FILE, validation_count};
