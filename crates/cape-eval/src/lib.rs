//! Evaluation of clothing models.
//!
//! [`evaluate`](evaluate()) measures reconstruction errors on held-out sequences, [`comparison`]
//! puts methods side by side, and [`table2`] reproduces CAPE's table 2. [`quality`](mod@quality)
//! measures samples, [`surface_detail`] wrinkles, [`self_check`] tests a training set-up, and
//! [`bench`](mod@bench) measures speed.

pub mod bench;
pub mod clothing;
pub mod comparison;
pub mod evaluate;
pub mod quality;
pub mod self_check;
pub mod store;
pub mod surface_detail;
pub mod table2;

pub use cape_infer::{Error, Result};

pub use evaluate::{
    ErrorSamples, EvalOptions, EvalReport, FrameError, FrameFn, PosteriorUse, evaluate,
    reconstruct_test,
};
