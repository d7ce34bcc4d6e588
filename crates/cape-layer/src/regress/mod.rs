//! Regression of clothing from motion, size and material (Yang et al. 2018, §3.3).
//!
//! [`FeatureOptions`] turn a sequence of poses, and [`SemanticParameters`] sizes and materials, into rows of numbers; a
//! [`Network`] trained by [`TrainingOptions`] maps them to coordinates in the space of principal
//! components; a [`Regressor`] holds both ends' scales and is one file.

mod features;
mod network;
mod regressor;
mod semantics;
mod stream;
#[cfg(test)]
mod tests;
mod training;

pub use features::FeatureOptions;
pub use network::Network;
pub use regressor::Regressor;
pub use semantics::SemanticParameters;
pub use stream::{FeatureStream, StreamedFrame};
pub use training::{Epoch, TrainedRegressor, TrainingOptions};
