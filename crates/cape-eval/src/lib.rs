//! Evaluation of clothing models: errors on held-out sequences, comparison of methods, CAPE's table 2,
//! quality of samples, the self-check of a training set-up, and the benchmark.

pub mod bench;
pub mod comparison;
pub mod evaluate;
pub mod quality;
pub mod self_check;
pub mod surface_detail;
pub mod table2;

pub use cape_infer::{Error, Result};

pub use evaluate::{
    ErrorSamples, EvalOptions, EvalReport, FrameError, FrameFn, PosteriorUse, evaluate,
    reconstruct_test,
};
