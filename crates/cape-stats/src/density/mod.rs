//! Probability densities of vectors: Gaussian mixtures and kernel estimates.

mod gaussian;
mod kernel;
mod mixture;

pub use gaussian::{GaussianMoments, GaussianTransport};
pub use kernel::KernelDensity;
pub use mixture::{Mixture, MixtureOptions};
