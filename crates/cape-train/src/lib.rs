//! CAPE data sets, training and evaluation.
//!
//! [`data`] turns registrations in the release's raw layout into packed sets and packed sets into
//! batches on host arrays; [`metrics`] measures reconstructions in millimetres; [`tensorboard`]
//! writes what training reports.

pub mod data;
mod error;
pub mod metrics;
pub mod objective;
pub mod optim;
mod progress;
pub mod tensorboard;

pub use error::{Error, Result};
pub use progress::{Progress, silent};
