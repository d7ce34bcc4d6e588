//! Probability densities of vectors: Gaussian mixtures and kernel estimates.

mod kernel;
mod mixture;

pub use kernel::KernelDensity;
pub use mixture::{Mixture, MixtureOptions};
