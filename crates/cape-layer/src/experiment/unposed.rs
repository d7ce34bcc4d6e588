use cape_core::SmplModel;
use ndarray::{Array2, ArrayView1, ArrayView2, Axis, concatenate};
use rayon::prelude::*;

use super::{
    BaselineErrors, LayerError, LearningOptions, PushedOut, RegressionReport, TrainedModel,
    baselines::HeldOut,
};
use crate::{
    Association, Clearance, ComponentSelection, Error, InsideShares, Layer, Pca, Result,
    clearance::CLEARANCE,
    offsets::OffsetFrame,
    regress::{Epoch, FeatureOptions, RegressionInputs, SemanticParameters, TrainingOptions},
    sequence::LayerSet,
    wearer::{BodyMeasurements, ratio_name, size_name},
};
use cape_core::smpl::StandardPose;

/// Largest number of frames whose clothing is pushed out of the body for a measurement.
const MEASURED: usize = 200;

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
/// let training = TrainingOptions { hidden: vec![4], ..TrainingOptions::default() };
/// let learning = LearningOptions { components: Some(1), training, ..LearningOptions::default() };
/// let regression = unposed.regression(&[0], &learning, &mut |_, _| {})?;
/// assert_eq!(regression.trained_model.pca.latent(), 1);
/// assert!(regression.predict.mean < regression.baselines.mean_mm);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct UnposedSet<'a> {
    model: &'a SmplModel,
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
        model: &'a SmplModel,
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
        Ok(Self { model, set, association, standard: standard.clone(), offset_frames, rows })
    }

    /// The set.
    pub fn set(&self) -> &'a LayerSet {
        self.set
    }

    pub(super) fn model(&self) -> &'a SmplModel {
        self.model
    }

    pub(super) fn standard(&self) -> &StandardPose {
        &self.standard
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

    /// Motion features of all frames, `[frames, len]`.
    pub(super) fn motion_rows(&self, features: &FeatureOptions) -> Result<Array2<f64>> {
        let rows: Vec<Array2<f64>> =
            self.set.sequences.iter().map(|s| features.rows(&s.motion)).collect();
        let rows: Vec<_> = rows.iter().map(|rows| rows.view()).collect();
        concatenate(Axis(0), &rows).map_err(|error| {
            Error::argument(format!("layer set: motions of different numbers of joints: {error}"))
        })
    }

    /// Inputs of the regression of all frames: motion features, then semantic parameters, to which noise
    /// is added if they vary.
    ///
    /// # Errors
    /// If the semantic parameters are not those of the set.
    pub fn inputs(
        &self,
        features: &FeatureOptions,
        semantics: &SemanticParameters,
    ) -> Result<RegressionInputs> {
        let motion = self.motion_rows(features)?;
        let parameters = self.parameters(semantics.names())?;
        let reduced: Vec<Vec<f64>> = parameters
            .rows()
            .into_iter()
            .map(|row| semantics.reduced(&row.to_vec()))
            .collect::<Result<_>>()?;
        let each = self.set.each_frame();
        let semantic = Array2::from_shape_fn((each.len(), semantics.len()), |(frame, k)| {
            reduced[each[frame].0][k]
        });
        let joints = self.set.sequences.first().map_or(0, |s| s.motion.poses.ncols() / 3);
        let mut inputs = RegressionInputs::new(motion);
        inputs.floors = features.floors(joints);
        inputs.floors.resize(inputs.rows.ncols() + semantics.len(), 0.0);
        let varies = |column: ArrayView1<'_, f64>| column.iter().any(|&x| x != column[0]);
        inputs.noisy.extend(semantic.columns().into_iter().map(varies));
        inputs.rows = concatenate(Axis(1), &[inputs.rows.view(), semantic.view()])
            .map_err(|error| Error::argument(error.to_string()))?;
        Ok(inputs)
    }

    /// Trains on the sequences with the indices `sequences`, except a share of their frames, and measures
    /// the errors on these (table 2). `watch` is called after each iteration with the index of the
    /// training.
    ///
    /// # Errors
    /// If there are too few frames for the components, or an option is out of range.
    pub fn regression(
        &self,
        sequences: &[usize],
        learning: &LearningOptions,
        watch: &mut dyn FnMut(usize, Epoch),
    ) -> Result<RegressionReport> {
        let (frames, _) = self.frames_of(sequences);
        let split = TrainingOptions { validation: learning.test, ..learning.training.clone() };
        let (known, held) = split.split(frames.len());
        let pick = |of: Vec<usize>| of.into_iter().map(|k| frames[k]).collect::<Vec<_>>();
        let (known, held) = (pick(known), pick(held));
        self.trainings(&HeldOut { known: &known, held: &held, sequences: false }, learning, watch)
    }

    /// Trains on all frames of the set, of which a share is for validation. `watch` is called after each
    /// iteration.
    ///
    /// # Errors
    /// As of [`regression`](Self::regression).
    pub fn train(
        &self,
        learning: &LearningOptions,
        watch: &mut dyn FnMut(Epoch),
    ) -> Result<TrainedModel> {
        self.learn(&(0..self.set.frames()).collect::<Vec<_>>(), true, learning, watch)
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
        watch: &mut dyn FnMut(usize, Epoch),
    ) -> Result<RegressionReport> {
        let (new, known) = self.frames_of(held);
        if new.is_empty() || known.is_empty() {
            return Err(Error::argument(format!(
                "layer set: {} of {} frames held out, expected some but not all",
                new.len(),
                new.len() + known.len()
            )));
        }
        self.trainings(&HeldOut { known: &known, held: &new, sequences: true }, learning, watch)
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
        let inputs = self.inputs(features, &trained_model.semantics)?.select(frames).rows;
        let codes = trained_model.outcome.regressor.predict(inputs.view())?;
        Ok(trained_model.pca.decode(codes.view())?)
    }

    /// Trains on some frames; if whole sequences are predicted and there are enough, whole ones are
    /// validated on.
    fn learn(
        &self,
        frames: &[usize],
        whole_sequences: bool,
        learning: &LearningOptions,
        watch: &mut dyn FnMut(Epoch),
    ) -> Result<TrainedModel> {
        let LearningOptions { features, training, .. } = learning;
        let each = self.set.each_frame();
        let mut sequences: Vec<usize> = frames.iter().map(|&frame| each[frame].0).collect();
        sequences.dedup();
        let semantics = self.semantics(&sequences, learning)?;
        let mut inputs = self.inputs(features, &semantics)?.select(frames);
        if whole_sequences && sequences.len() >= learning.validated_sequences {
            inputs.groups = Some(frames.iter().map(|&frame| each[frame].0).collect());
        }
        let rows = self.rows.select(Axis(0), frames);
        // The components are those of the training frames only.
        let fitted = rows.select(Axis(0), &training.split_inputs(&inputs).0);
        let count = learning.components_of(sequences.len(), fitted.nrows());
        let pca = Pca::from_snapshots(fitted.view(), ComponentSelection::Components(count))?;
        let codes = pca.encode(rows.view())?;
        let outcome = training.train(&inputs, codes.view(), watch)?;
        Ok(TrainedModel { pca, semantics, outcome })
    }

    /// Reduction of the semantic parameters of some sequences.
    pub(super) fn semantics(
        &self,
        sequences: &[usize],
        learning: &LearningOptions,
    ) -> Result<SemanticParameters> {
        let mut names = self.set.semantic_parameters().0;
        if learning.wearer_ratios {
            for name in &mut names {
                *name = ratio_name(name).map_or_else(|| name.clone(), str::to_owned);
            }
        }
        let rows = self.parameters(&names)?.select(Axis(0), sequences);
        SemanticParameters::from_rows(names, rows.view(), learning.semantics)
    }

    /// Semantic parameters of all sequences by name, `[sequences, names]`: the set's, or its garment sizes as
    /// ratios to the wearers.
    fn parameters(&self, names: &[String]) -> Result<Array2<f64>> {
        let (known, values) = self.set.semantic_parameters();
        let mut rows = Array2::zeros((values.nrows(), names.len()));
        for (mut column, name) in rows.columns_mut().into_iter().zip(names) {
            let column_of = |name: &str| known.iter().position(|other| other == name);
            if let Some(at) = column_of(name) {
                column.assign(&values.column(at));
            } else if let Some(at) = size_name(name).and_then(column_of) {
                let cut_for = BodyMeasurements::new(self.model, &self.model.rest_shape(&[])?)?;
                for (row, sequence) in self.set.sequences.iter().enumerate() {
                    let wearer = BodyMeasurements::new(self.model, &sequence.shape(self.model)?)?;
                    let factor = wearer.factor(name, &cut_for).unwrap_or(1.0);
                    column[row] = values[(row, at)] * factor;
                }
            } else {
                return Err(Error::argument(format!(
                    "layer set: no semantic parameter `{name}`: it has {}",
                    known.join(", ")
                )));
            }
        }
        Ok(rows)
    }

    /// Clothing of frames pushed out of their bodies, `[n_v, 3]`, with the shares that were inside.
    pub(super) fn kept_out(
        &self,
        frames: &[usize],
        clothing: Vec<Array2<f64>>,
    ) -> Result<Vec<(Array2<f64>, InsideShares)>> {
        let (faces, vertices) = (&self.set.faces, self.set.vertices());
        let clearance = Clearance::new(CLEARANCE, self.model, faces, vertices);
        let each = self.set.each_frame();
        let push = |(&index, clothing): (&usize, Array2<f64>)| {
            let (sequence, frame) = each[index];
            let sequence = &self.set.sequences[sequence];
            let body = sequence.body(self.model, frame, &self.standard)?;
            Ok(clearance.apply(body.posed, clothing.view()))
        };
        frames.iter().zip(clothing).map(push).collect()
    }

    /// Shares of the predicted clothing inside the body, and the error once it is pushed out, over at most
    /// [`MEASURED`] of the frames.
    fn pushed_out(
        &self,
        model: &TrainedModel,
        features: &FeatureOptions,
        frames: &[usize],
    ) -> Result<PushedOut> {
        let step = frames.len().div_ceil(MEASURED).max(1);
        let some: Vec<usize> = frames.iter().copied().step_by(step).collect();
        let (mut shares, mut errors) = (InsideShares::default(), Vec::new());
        let each = self.set.each_frame();
        let pushed = self.kept_out(&some, self.predict(model, features, &some)?)?;
        for (&index, (pushed, inside)) in some.iter().zip(pushed) {
            let (sequence, frame) = each[index];
            let truth = self.set.sequences[sequence].clothing.index_axis(Axis(0), frame);
            errors.push(LayerError::between(pushed.view(), truth));
            shares.before += inside.before / some.len() as f64;
            shares.after += inside.after / some.len() as f64;
        }
        Ok(PushedOut { inside: shares, error_mm: LayerError::over(&errors).mean })
    }

    /// Trains with each seed, and measures.
    fn trainings(
        &self,
        frames: &HeldOut<'_>,
        learning: &LearningOptions,
        watch: &mut dyn FnMut(usize, Epoch),
    ) -> Result<RegressionReport> {
        let features = &learning.features;
        let error = |frames: &[usize], offsets: &Array2<f64>| -> Result<LayerError> {
            Ok(LayerError::over(&self.errors(frames, offsets.view())?))
        };
        let mut first = None;
        let (mut train, mut predict, mut space) = (Vec::new(), Vec::new(), Vec::new());
        let held_rows = self.rows.select(Axis(0), frames.held);
        for index in 0..learning.trainings.max(1) {
            let options = learning.with_training(index);
            let model =
                self.learn(frames.known, frames.sequences, &options, &mut |e| watch(index, e))?;
            let trained: Vec<usize> =
                model.outcome.training_frames.iter().map(|&k| frames.known[k]).collect();
            let offsets = |of: &[usize]| self.predicted_offsets(&model, features, of);
            train.push(error(&trained, &offsets(&trained)?)?);
            predict.push(error(frames.held, &offsets(frames.held)?)?);
            let codes = model.pca.encode(held_rows.view())?;
            space.push(error(frames.held, &model.pca.decode(codes.view())?)?);
            first.get_or_insert(model);
        }
        let trained_model = first.ok_or_else(|| Error::argument("layer set: no training"))?;
        Ok(RegressionReport {
            held: frames.held.to_vec(),
            train: LayerError::over(&train),
            predict: LayerError::over(&predict),
            predict_each: predict.iter().map(|error| error.mean).collect(),
            space: LayerError::over(&space),
            baselines: BaselineErrors::measure(self, frames, &trained_model, learning)?,
            pushed_out: self.pushed_out(&trained_model, features, frames.held)?,
            trained_model,
        })
    }
}
