use cape_core::SmplModel;
use ndarray::{Array2, ArrayView2, Axis};
use rayon::prelude::*;

use super::{LayerError, LearningOptions, RegressionReport, TrainedModel};
use crate::{
    Association, ComponentSelection, Error, Layer, Pca, Result,
    offsets::OffsetFrame,
    regress::{Epoch, FeatureOptions, SemanticParameters},
    sequence::LayerSet,
};
use cape_core::smpl::StandardPose;

/// The offsets of all frames of a set from the body in the standard pose (eq. 4), as rows for
/// principal components and regression.
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use cape_synth::synthetic_body;
/// use cape_core::smpl::StandardPose;
/// use cape_layer::{experiment::{LearningOptions, UnposedSet}, regress::TrainingOptions};
///
/// // A patch that rises and falls with the knees of a marching body.
/// let body = synthetic_body();
/// let (set, association) = patch(&body)?;
/// let unposed = UnposedSet::new(&body, &set, &association, &StandardPose::default())?;
/// assert_eq!(unposed.rows.dim(), (30, 9));
/// // One component reconstructs it; a small network predicts it better than the mean does.
/// assert!(unposed.reconstruction(&[1])?[0][0].largest < 1e-6);
/// let training = TrainingOptions { hidden: vec![4], patience: 10, ..TrainingOptions::default() };
/// let learning = LearningOptions { components: 1, training, ..LearningOptions::default() };
/// let regression = unposed.regression(&[0], &learning, &mut |_| {})?;
/// assert_eq!(regression.trained_model.pca.latent(), 1);
/// assert!(regression.predict.mean < regression.mean_baseline.mean);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct UnposedSet<'a> {
    set: &'a LayerSet,
    association: &'a Association,
    standard: StandardPose,
    /// Transforms of the clothing in each frame.
    offset_frames: Vec<OffsetFrame>,
    /// Offsets, one row for each frame of [`LayerSet::each_frame`], metres, `[frames, 3 · n_v ·
    /// n_f]`.
    pub rows: Array2<f64>,
}

impl<'a> UnposedSet<'a> {
    /// Unposes all frames.
    ///
    /// # Errors
    /// If the association does not fit the set, or a frame cannot be unposed.
    pub fn new(
        model: &SmplModel,
        set: &'a LayerSet,
        association: &'a Association,
        standard: &StandardPose,
    ) -> Result<Self> {
        let frames = set.each_frame();
        let numbers = 3 * association.clothing_vertices() * association.neighbours();
        let (rows, offset_frames): (Vec<Vec<f64>>, Vec<OffsetFrame>) = frames
            .par_iter()
            .map(|&(sequence, frame)| {
                let sequence = &set.sequences[sequence];
                let body = sequence.body(model, frame, standard)?;
                let clothing = sequence.clothing.index_axis(Axis(0), frame);
                let offsets = association.offsets(&body, clothing)?;
                Ok((offsets.into_iter().collect(), association.offset_frame(&body)?))
            })
            .collect::<Result<Vec<_>>>()?
            .into_iter()
            .unzip();
        let rows = Array2::from_shape_vec((frames.len(), numbers), rows.concat())
            .map_err(|error| Error::argument(error.to_string()))?;
        Ok(Self { set, association, standard: standard.clone(), offset_frames, rows })
    }

    /// The set.
    pub fn set(&self) -> &'a LayerSet {
        self.set
    }

    /// Frames of the sequences with the indices `sequences`, and the other frames, both ascending.
    pub fn frames_of(&self, sequences: &[usize]) -> (Vec<usize>, Vec<usize>) {
        let each = self.set.each_frame();
        (0..each.len()).partition(|&frame| sequences.contains(&each[frame].0))
    }

    /// Clothing of offsets `[n, 3 · n_v · n_f]`, one row for each of `frames`, on the bodies of those
    /// frames: metres, `[n_v, 3]` each.
    ///
    /// # Errors
    /// If shapes differ or there is no such frame.
    pub fn posed_clothing(
        &self,
        frames: &[usize],
        offsets: ArrayView2<'_, f64>,
    ) -> Result<Vec<Array2<f64>>> {
        if offsets.nrows() != frames.len() {
            return Err(Error::argument(format!(
                "offsets of {} frames, expected {}, one row for each frame",
                offsets.nrows(),
                frames.len()
            )));
        }
        let shape = (self.association.clothing_vertices(), self.association.neighbours(), 3);
        frames
            .par_iter()
            .zip(offsets.axis_iter(Axis(0)).into_par_iter())
            .map(|(&index, offsets)| {
                let offset_frame = self.offset_frames.get(index).ok_or_else(|| {
                    Error::argument(format!(
                        "layer set: no frame {index} of {}",
                        self.offset_frames.len()
                    ))
                })?;
                let offsets = offsets
                    .into_shape_with_order(shape)
                    .map_err(|error| Error::argument(error.to_string()))?;
                offset_frame.dress(self.association, offsets)
            })
            .collect()
    }

    /// Errors of the clothing of offsets `[n, 3 · n_v · n_f]`, one row for each of `frames`.
    ///
    /// # Errors
    /// As of [`posed_clothing`](Self::posed_clothing).
    pub fn errors(
        &self,
        frames: &[usize],
        offsets: ArrayView2<'_, f64>,
    ) -> Result<Vec<LayerError>> {
        let found = self.posed_clothing(frames, offsets)?;
        let each = self.set.each_frame();
        let error = |(found, &index): (Array2<f64>, &usize)| {
            let (sequence, frame) = each[index];
            let truth = self.set.sequences[sequence].clothing.index_axis(Axis(0), frame);
            LayerError::between(found.view(), truth)
        };
        Ok(found.into_iter().zip(frames).map(error).collect())
    }

    /// Reconstruction error of each sequence by its own principal components (table 1), with each of
    /// `counts` components, and with all last, `[sequences, counts + 1]`.
    ///
    /// # Errors
    /// If a sequence has fewer than two frames.
    pub fn reconstruction(&self, counts: &[usize]) -> Result<Vec<Vec<LayerError>>> {
        let sequences = 0..self.set.sequences.len();
        sequences.map(|sequence| self.reconstruction_of(sequence, counts)).collect()
    }

    /// [`reconstruction`](Self::reconstruction) of one sequence, `[counts + 1]`.
    ///
    /// # Errors
    /// If the sequence has fewer than two frames.
    pub fn reconstruction_of(&self, sequence: usize, counts: &[usize]) -> Result<Vec<LayerError>> {
        let (frames, _) = self.frames_of(&[sequence]);
        let rows = self.rows.select(Axis(0), &frames);
        let all = Pca::from_snapshots(rows.view(), ComponentSelection::All)?;
        let codes = all.encode(rows.view())?;
        let kept = counts.iter().copied().chain([all.latent()]);
        kept.map(|count| {
            let pca = all.truncated(count);
            let codes = codes.slice(ndarray::s![.., ..pca.latent()]);
            Ok(LayerError::over(&self.errors(&frames, pca.decode(codes)?.view())?))
        })
        .collect()
    }

    /// Inputs of the regression, `[frames, inputs]`, and a flag for each that is true for semantic
    /// parameters, `[inputs]`.
    ///
    /// # Errors
    /// If the semantic parameters are not those of the set.
    pub fn inputs(
        &self,
        features: &FeatureOptions,
        semantics: &SemanticParameters,
    ) -> Result<(Array2<f64>, Vec<bool>)> {
        let mut rows: Vec<f64> = Vec::new();
        let mut noisy = Vec::new();
        for sequence in &self.set.sequences {
            let motion = features.rows(&sequence.motion);
            let parameters: Vec<f64> = sequence.parameters.iter().map(|p| p.1).collect();
            let parameters = semantics.reduced(&parameters)?;
            noisy = vec![false; motion.ncols()];
            noisy.resize(motion.ncols() + parameters.len(), true);
            for row in motion.rows() {
                rows.extend(row);
                rows.extend(&parameters);
            }
        }
        let inputs = Array2::from_shape_vec((self.set.frames(), noisy.len()), rows)
            .map_err(|error| Error::argument(error.to_string()))?;
        Ok((inputs, noisy))
    }

    /// Trains on the sequences with the indices `sequences` and measures the errors on their
    /// training and validation frames (table 2). `watch` is called after each iteration.
    ///
    /// # Errors
    /// If there are too few frames for the components, or an option is out of range.
    pub fn regression(
        &self,
        sequences: &[usize],
        learning: &LearningOptions,
        watch: &mut dyn FnMut(Epoch),
    ) -> Result<RegressionReport> {
        let (frames, _) = self.frames_of(sequences);
        let trained_model = self.learn(&frames, learning, watch)?;
        let held: Vec<usize> =
            trained_model.outcome.validation_frames.iter().map(|&k| frames[k]).collect();
        self.measure_errors(trained_model, &frames, &held, learning)
    }

    /// Trains on all sequences except those with the indices `held` and measures the error of the
    /// prediction on these: new body shapes, motions, materials or garment sizes (§5.1–5.3).
    ///
    /// # Errors
    /// If no sequence or every sequence is held out, or as of [`regression`](Self::regression).
    pub fn leave_out(
        &self,
        held: &[usize],
        learning: &LearningOptions,
        watch: &mut dyn FnMut(Epoch),
    ) -> Result<RegressionReport> {
        let (new, known) = self.frames_of(held);
        if new.is_empty() || known.is_empty() {
            return Err(Error::argument(format!(
                "layer set: {} of {} frames held out, expected some but not all",
                new.len(),
                new.len() + known.len()
            )));
        }
        let trained_model = self.learn(&known, learning, watch)?;
        self.measure_errors(trained_model, &known, &new, learning)
    }

    /// Predicted clothing of `frames`, metres, `[n_v, 3]` each.
    ///
    /// # Errors
    /// If the model is of another set, or there is no such frame.
    pub fn predict(
        &self,
        trained_model: &TrainedModel,
        features: &FeatureOptions,
        frames: &[usize],
    ) -> Result<Vec<Array2<f64>>> {
        self.posed_clothing(frames, self.predicted_offsets(trained_model, features, frames)?.view())
    }

    /// Layer of a trained model with this set's association and standard pose.
    pub fn layer(&self, trained_model: &TrainedModel, features: FeatureOptions) -> Layer {
        Layer {
            faces: self.set.faces.clone(),
            association: self.association.clone(),
            standard: self.standard.clone(),
            pca: trained_model.pca.clone(),
            features,
            semantics: trained_model.semantics.clone(),
            regressor: trained_model.outcome.regressor.clone(),
            body: self.set.body.clone(),
        }
    }

    fn predicted_offsets(
        &self,
        trained_model: &TrainedModel,
        features: &FeatureOptions,
        frames: &[usize],
    ) -> Result<Array2<f64>> {
        let inputs = self.inputs(features, &trained_model.semantics)?.0.select(Axis(0), frames);
        let codes = trained_model.outcome.regressor.predict(inputs.view())?;
        Ok(trained_model.pca.decode(codes.view())?)
    }

    fn learn(
        &self,
        frames: &[usize],
        learning: &LearningOptions,
        watch: &mut dyn FnMut(Epoch),
    ) -> Result<TrainedModel> {
        let LearningOptions { components, features, semantics, training } = learning;
        let semantics = self.semantics(frames, *semantics)?;
        let (inputs, noisy) = self.inputs(features, &semantics)?;
        let rows = self.rows.select(Axis(0), frames);
        // The components are those of the training frames only.
        let fitted = rows.select(Axis(0), &training.split(frames.len()).0);
        let keep = ComponentSelection::Components(*components);
        let pca = Pca::from_snapshots(fitted.view(), keep)?;
        let codes = pca.encode(rows.view())?;
        let inputs = inputs.select(Axis(0), frames);
        let outcome = training.train(inputs.view(), codes.view(), &noisy, watch)?;
        Ok(TrainedModel { pca, semantics, outcome })
    }

    /// Reduction of the semantic parameters of the sequences that contain `frames`.
    fn semantics(&self, frames: &[usize], most: Option<usize>) -> Result<SemanticParameters> {
        let each = self.set.each_frame();
        let mut sequences: Vec<usize> = frames.iter().map(|&frame| each[frame].0).collect();
        sequences.dedup();
        let names = match self.set.sequences.first() {
            Some(first) => first.parameters.iter().map(|(name, _)| name.clone()).collect(),
            None => Vec::new(),
        };
        let rows = Array2::from_shape_fn((sequences.len(), names.len()), |(k, p)| {
            self.set.sequences[sequences[k]].parameters[p].1
        });
        SemanticParameters::from_rows(names, rows.view(), most)
    }

    fn measure_errors(
        &self,
        trained_model: TrainedModel,
        known: &[usize],
        held: &[usize],
        learning: &LearningOptions,
    ) -> Result<RegressionReport> {
        let trained: Vec<usize> =
            trained_model.outcome.training_frames.iter().map(|&k| known[k]).collect();
        let error = |frames: &[usize], offsets: &Array2<f64>| -> Result<LayerError> {
            Ok(LayerError::over(&self.errors(frames, offsets.view())?))
        };
        let features = &learning.features;
        let [train, predict] = [&trained[..], held].map(|frames| {
            error(frames, &self.predicted_offsets(&trained_model, features, frames)?)
        });
        let codes = trained_model.pca.encode(self.rows.select(Axis(0), held).view())?;
        let space = error(held, &trained_model.pca.decode(codes.view())?)?;
        let mean_baseline =
            error(held, &trained_model.pca.decode(Array2::zeros(codes.dim()).view())?)?;
        Ok(RegressionReport {
            train: train?,
            predict: predict?,
            space,
            mean_baseline,
            trained_model,
        })
    }
}
