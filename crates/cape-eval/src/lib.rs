//! Evaluation of clothing models: errors on held-out sequences, comparison of methods, CAPE's table 2,
//! quality of samples, the self-check of a training set-up, and the benchmark.

pub mod bench;
pub mod comparison;
pub mod detail;
pub mod evaluate;
pub mod quality;
pub mod table2;
pub mod trial;

pub use cape_infer::{Error, Result};

pub use evaluate::{
    EachFrame, EvalOptions, EvalReport, FrameError, Gathered, PosteriorUse, evaluate,
    reconstruct_test,
};
