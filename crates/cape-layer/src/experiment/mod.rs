//! The paper's experiments on any set: reconstruction (§4, table 1), regression (§4.3, table 2),
//! and prediction of body shapes, motions (§5.1), materials (§5.2) and garment sizes (§5.3) that
//! are not in the training set.

mod baselines;
mod components;
mod dressed;
mod factor;
mod run;
#[cfg(test)]
mod tests;
mod unposed;

use cape_stats::errors::distance_mm;
use ndarray::{ArrayView1, ArrayView2};
use serde::{Deserialize, Serialize};

pub use baselines::BaselineErrors;
pub use components::ComponentCurve;
pub use factor::{Factor, SequenceGroup};
pub use run::{
    ExampleFrame, Experiment, ExperimentOutcome, ExperimentResults, ReconstructionResult,
    RegressionResult,
};
pub use unposed::UnposedSet;

use crate::{
    InsideShares, Pca,
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

/// Numbers of principal components of one sequence and of several, as the paper has them.
const ONE: usize = 40;
const SEVERAL: usize = 100;

/// Options of principal components and regression.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LearningOptions {
    /// Number of principal components; by default the paper's: 40 for one sequence, 100 for
    /// several, or fewer if there are not as many frames.
    pub components: Option<usize>,
    /// Motion features.
    pub features: FeatureOptions,
    /// Most inputs of semantic parameters, to which more are reduced; the paper's 4 for a material
    /// (§5.2).
    pub semantics: Option<usize>,
    /// Use garment sizes (`length`, `width`, `sleeve`, `size`) as ratios to the wearer's measurements, as the
    /// paper does (§5.3), instead of to those of the body that the garment was cut for. Their names are then
    /// `length_ratio` and so on.
    pub wearer_ratios: bool,
    /// Share of the frames that play no part in the training where nothing else is held out; 20 % in the
    /// paper (§4.3).
    pub test: f64,
    /// Least number of sequences of which whole ones are validated on, where whole sequences are
    /// predicted.
    pub validated_sequences: usize,
    /// Number of trainings with different seeds, over which errors are averaged.
    pub trainings: usize,
    /// Options of the training.
    pub training: TrainingOptions,
}

impl Default for LearningOptions {
    fn default() -> Self {
        Self {
            components: None,
            features: FeatureOptions::default(),
            semantics: Some(4),
            wearer_ratios: false,
            test: 0.2,
            validated_sequences: 10,
            trainings: 1,
            training: TrainingOptions::default(),
        }
    }
}

impl LearningOptions {
    /// Number of principal components of a number of sequences and training frames.
    pub fn components_of(&self, sequences: usize, frames: usize) -> usize {
        let paper = if sequences > 1 { SEVERAL } else { ONE };
        self.components.unwrap_or(paper.min(frames.saturating_sub(1)).max(1))
    }

    /// The options with the seed of the training with this index.
    fn with_training(&self, index: usize) -> Self {
        let mut options = self.clone();
        options.training.seed = self.training.seed.wrapping_add(index as u64);
        options
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
    /// Model of the first training.
    pub trained_model: TrainedModel,
    /// Predicted frames that played no part in the training, ascending.
    pub held: Vec<usize>,
    /// Error of the prediction on the training frames, `E_train`, mean over the trainings.
    pub train: LayerError,
    /// Error of the prediction on the held-out frames, `E_pred`, mean over the trainings.
    pub predict: LayerError,
    /// Mean error on the held-out frames of each training.
    pub predict_each: Vec<f64>,
    /// Error of the held-out frames' own coordinates in the components, mean over the trainings: the least
    /// error of a prediction.
    pub space: LayerError,
    /// Errors of simpler predictions on the held-out frames.
    pub baselines: BaselineErrors,
    /// Measures of the prediction pushed 2 mm out of the body.
    pub pushed_out: PushedOut,
}

/// Measures of predicted clothing that is pushed out of the body.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PushedOut {
    /// Shares of the clothing's surface inside the body, before and after.
    pub inside: InsideShares,
    /// Mean error afterwards, millimetres.
    pub error_mm: f64,
}
