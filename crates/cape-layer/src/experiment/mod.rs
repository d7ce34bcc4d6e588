//! The paper's experiments on any set: reconstruction (table 1), regression (table 2), and
//! prediction for bodies, motions, materials and sizes that were not learned from (§5.4).

mod factor;
#[cfg(test)]
mod tests;
mod unposed;

use ndarray::{Array2, ArrayView2, Axis};
use serde::Serialize;

pub use factor::{Factor, SequenceGroup};
pub use unposed::UnposedSet;

use crate::{
    LayerPca,
    regress::{FeatureOptions, SemanticParameters, TrainedRegressor, TrainingOptions},
};

/// Distances between clothing vertices and their true places, millimetres.
///
/// ```
/// use cape_layer::experiment::LayerError;
/// use ndarray::{arr2, aview2};
///
/// let found = arr2(&[[0.003, 0.004, 0.0], [1.0, 0.0, 0.0]]);
/// let error = LayerError::between(found.view(), aview2(&[[0.0; 3], [1.0, 0.0, 0.0]]));
/// assert!((error.mean - 2.5).abs() < 1e-9 && (error.largest - 5.0).abs() < 1e-9);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LayerError {
    /// Mean over vertices and frames.
    pub mean: f64,
    /// Largest of all.
    pub largest: f64,
}

impl LayerError {
    /// Between positions `[vertices, 3]`, metres.
    pub fn between(found: ArrayView2<'_, f64>, truth: ArrayView2<'_, f64>) -> Self {
        let far = distances(found, truth);
        let mean = far.iter().sum::<f64>() / far.len().max(1) as f64;
        Self { mean, largest: far.into_iter().fold(0.0, f64::max) }
    }

    /// Of several frames of as many vertices.
    pub fn over(frames: &[Self]) -> Self {
        Self {
            mean: frames.iter().map(|e| e.mean).sum::<f64>() / frames.len().max(1) as f64,
            largest: frames.iter().map(|e| e.largest).fold(0.0, f64::max),
        }
    }
}

/// Distances between positions `[vertices, 3]` in metres: millimetres, `[vertices]`.
pub fn distances(found: ArrayView2<'_, f64>, truth: ArrayView2<'_, f64>) -> Vec<f64> {
    let apart: Array2<f64> = &found - &truth;
    apart.map_axis(Axis(1), |d| 1e3 * d.dot(&d).sqrt()).to_vec()
}

/// What is learned, and how.
///
/// See [`UnposedSet`] for an example.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LearningOptions {
    /// Principal components that are predicted; the paper's 40.
    pub components: usize,
    /// What is seen of the motion.
    pub features: FeatureOptions,
    /// Numbers that more semantic parameters are reduced to; the paper's 4 for a material.
    pub semantics: Option<usize>,
    /// How the network is trained.
    pub training: TrainingOptions,
}

impl Default for LearningOptions {
    fn default() -> Self {
        Self {
            components: 40,
            features: FeatureOptions::default(),
            semantics: Some(4),
            training: TrainingOptions::default(),
        }
    }
}

/// A space of offsets and the way into it.
///
/// See [`UnposedSet`] for an example.
#[derive(Debug, Clone, PartialEq)]
pub struct TrainedModel {
    /// The space, of frames that trained.
    pub pca: LayerPca,
    /// What is seen of semantic parameters.
    pub semantics: SemanticParameters,
    /// The regressor and its course. Frames are numbered among those that were learned from.
    pub outcome: TrainedRegressor,
}

/// What was learned and its errors.
///
/// See [`UnposedSet`] for an example.
#[derive(Debug, Clone, PartialEq)]
pub struct RegressionReport {
    /// What was learned.
    pub trained_model: TrainedModel,
    /// Over frames that trained, `E_train`.
    pub train: LayerError,
    /// Over frames that did not, `E_pred`.
    pub predict: LayerError,
    /// Over those, of the first components' coordinates of the frames themselves: what the space
    /// alone costs.
    pub space: LayerError,
    /// Over those, of the mean of the frames that trained: what knowing nothing costs.
    pub mean_baseline: LayerError,
}
