//! Data sets: from registrations to batches.
//!
//! The **raw layout** ([`raw`]) holds one file a frame, the **packed layout** ([`pack`](mod@pack))
//! one array for all frames; both are the release's own, so files made by the official tools can be
//! used here and the other way round. A [`Split`] says which frames train and which test.
//! [`PackedSet`] reads batches from a packed set, [`Statistics`] normalises them, and [`Loader`]
//! draws and prefetches them for training.

mod components;
pub mod inspect;
mod journal;
mod loader;
mod npy_rows;
pub mod pack;
mod packed;
mod part_writer;
pub mod raw;
mod shuffle;
mod split;
mod statistics;
pub mod unpose;

pub use cape_core::{Error, Result};

pub use components::principal_components;
pub use loader::{Loader, LoaderOptions, LoaderState, StepData, sequential, steps_per_epoch};
pub use pack::{PackOptions, PackReport, pack};
pub use packed::{Batch, Origin, PackedSet, Part};
pub use shuffle::{Position, Shuffle, Stream};
pub use split::{SequenceList, Split};
pub use statistics::{MIN_STD, STATISTICS_FILE, Statistics, validation_count};
