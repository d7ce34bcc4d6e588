//! Statistics of clothing displacements and of reconstruction errors.
//!
//! Models of data: principal components ([`pca`]) and densities ([`density`]: Gaussian mixtures, kernel
//! densities). Evaluation: streaming error statistics in millimetres ([`errors`]), bootstrap confidence
//! intervals ([`bootstrap`]) and paired tests ([`paired_test`], [`PairedComparison`]). Everything is
//! computed in `f64` and independent of the number of threads.
//!
//! ```
//! use cape_stats::{PairedComparison, errors::ErrorStats};
//!
//! let mut stats = ErrorStats::new();
//! stats.push(&[2.0, 3.0, 4.0]);
//! assert_eq!(stats.summary().mean, 3.0);
//!
//! let comparison = PairedComparison::new(&[4.0, 5.0, 6.0], &[3.0, 4.0, 5.0], 1)?;
//! assert_eq!((comparison.difference, comparison.wins), (-1.0, 3));
//! # Ok::<(), cape_stats::Error>(())
//! ```

pub mod bootstrap;
pub mod density;
pub mod errors;
mod paired_comparison;
pub mod paired_test;
pub mod pca;
pub mod ridge;

pub use cape_core::{Error, Result};

pub use paired_comparison::PairedComparison;
