//! Evaluation of clothing models.
//!
//! [`evaluate`](evaluate()) measures reconstruction errors on held-out sequences, [`comparison`]
//! puts methods side by side, and [`table2`] reproduces CAPE's table 2. [`quality`](mod@quality)
//! measures samples, [`surface_detail`] wrinkles, [`clothing_statistics`] data sets, [`self_check`]
//! tests a training set-up, and [`bench`](mod@bench) measures speed.
//!
//! ```
//! # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/../cape-train/doc/sets.rs"));
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use burn::tensor::Device;
//! use cape_core::silent;
//! use cape_eval::{EvalOptions, PosteriorUse, evaluate};
//! use cape_infer::Run;
//!
//! // A run and four test frames.
//! let directory = trained()?;
//! let [packed, run] = ["packed", "run"].map(|name| directory.path().join(name));
//! let run = Run::open(&run, &Device::default())?;
//! let options = EvalOptions { posterior: PosteriorUse::Mean, ..EvalOptions::default() };
//! let report = evaluate(&run, &packed, options, &mut silent)?;
//! assert_eq!(report.frames, 4);
//! # Ok(())
//! # }
//! ```

pub mod bench;
pub mod clothing;
pub mod clothing_statistics;
pub mod comparison;
pub mod evaluate;
mod high_pass;
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
