//! The paper's experiments on any set: reconstruction (§4, table 1), regression (§4.3, table 2),
//! and prediction of body shapes, motions (§5.1), materials (§5.2) and garment sizes (§5.3) that
//! are not in the training set.

mod factor;
mod run;
#[cfg(test)]
mod tests;
mod unposed;

use cape_stats::errors::distance_mm;
use ndarray::{ArrayView1, ArrayView2};
use serde::Serialize;

pub use factor::{Factor, SequenceGroup};
pub use run::{
    ExampleFrame, Experiment, ExperimentOutcome, ExperimentResults, ReconstructionResult,
    RegressionResult,
};
pub use unposed::UnposedSet;

use crate::{
    Pca,
    regress::{FeatureOptions, SemanticParameters, TrainedRegressor, TrainingOptions},
};

/// Distances of clothing vertices from the ground truth, millimetres.
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
    /// Largest over vertices and frames.
    pub largest: f64,
}

impl LayerError {
    /// Distances between positions `[vertices, 3]`, metres.
    pub fn between(found: ArrayView2<'_, f64>, truth: ArrayView2<'_, f64>) -> Self {
        let far = distances(found, truth);
        let mean = far.iter().sum::<f64>() / far.len().max(1) as f64;
        Self { mean, largest: far.into_iter().fold(0.0, f64::max) }
    }

    /// Mean and largest of frames with equal numbers of vertices.
    pub fn over(frames: &[Self]) -> Self {
        Self {
            mean: frames.iter().map(|e| e.mean).sum::<f64>() / frames.len().max(1) as f64,
            largest: frames.iter().map(|e| e.largest).fold(0.0, f64::max),
        }
    }
}

/// Distances between positions `[vertices, 3]` in metres: millimetres, `[vertices]`.
pub fn distances(found: ArrayView2<'_, f64>, truth: ArrayView2<'_, f64>) -> Vec<f64> {
    let point = |row: ArrayView1<'_, f64>| [row[0], row[1], row[2]];
    let pairs = found.rows().into_iter().zip(truth.rows());
    pairs.map(|(found, truth)| distance_mm(point(found), point(truth))).collect()
}

/// Options of principal components and regression.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LearningOptions {
    /// Number of principal components; the paper has 40 for one subject in one clothing, 100 for
    /// several.
    pub components: usize,
    /// Motion features.
    pub features: FeatureOptions,
    /// Most inputs of semantic parameters, to which more are reduced; the paper's 4 for a material
    /// (§5.2).
    pub semantics: Option<usize>,
    /// Options of the training.
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

/// Principal components of offsets and the regressor of their coordinates.
#[derive(Debug, Clone, PartialEq)]
pub struct TrainedModel {
    /// Principal components of the training frames.
    pub pca: Pca,
    /// Reduction of the semantic parameters.
    pub semantics: SemanticParameters,
    /// Regressor with its training curve and split. Frames are numbered among those of the training
    /// call.
    pub outcome: TrainedRegressor,
}

/// A trained model and its errors, millimetres.
#[derive(Debug, Clone, PartialEq)]
pub struct RegressionReport {
    /// Trained model.
    pub trained_model: TrainedModel,
    /// Error of the prediction on the training frames, `E_train`.
    pub train: LayerError,
    /// Error of the prediction on the held-out frames, `E_pred`.
    pub predict: LayerError,
    /// Error of the held-out frames' own coordinates in the components: the least error of a
    /// prediction.
    pub space: LayerError,
    /// Error of the mean of the training frames on the held-out frames.
    pub mean_baseline: LayerError,
}
