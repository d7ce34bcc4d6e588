//! Regression of clothing from motion, garment size and material (Yang et al. 2018, §3.3).
//!
//! [`FeatureOptions`] computes motion features and [`SemanticParameters`] reduces garment sizes and
//! materials; a [`Network`], trained by [`TrainingOptions`], maps both to coordinates in the
//! principal components. A [`Regressor`] is the network with the scales of its inputs and targets.

mod features;
mod network;
mod regressor;
mod semantics;
mod stream;
#[cfg(test)]
mod tests;
mod training;

pub use features::{FeatureJoints, FeatureOptions};
pub use network::Network;
pub use regressor::Regressor;
pub use semantics::SemanticParameters;
pub use stream::{FeatureStream, StreamedFrame};
pub use training::{Epoch, RegressionInputs, TrainedRegressor, TrainingOptions};
