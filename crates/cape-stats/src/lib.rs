//! Statistics of clothing: principal components, mixtures and kernel densities, error statistics,
//! bootstrap intervals and paired tests.

pub mod density;
pub mod errors;
mod paired_comparison;
pub mod pca;
pub mod resample;

pub use cape_core::{Error, Result};

pub use paired_comparison::PairedComparison;
