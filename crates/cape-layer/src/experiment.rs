//! The paper's tables on any set: reconstruction (table 1) and regression (table 2).

use cape_core::SmplModel;
use ndarray::{Array2, ArrayView2, Axis};
use rayon::prelude::*;

use crate::{
    Association, Error, Keep, LayerPca, Result, StandardPose,
    regress::{Epoch, Features, Outcome, Training},
    sequence::LayerSet,
};

/// Distances between clothing vertices and their true places, millimetres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LayerError {
    /// Mean over vertices and frames.
    pub mean: f64,
    /// Largest of all.
    pub largest: f64,
}

impl LayerError {
    /// Between positions `[vertices, 3]`, metres.
    fn between(found: &Array2<f64>, truth: ArrayView2<'_, f64>) -> Self {
        let far = (found - &truth).map_axis(Axis(1), |d| 1e3 * d.dot(&d).sqrt());
        Self { mean: far.mean().unwrap_or(0.0), largest: far.iter().copied().fold(0.0, f64::max) }
    }

    fn over(frames: &[Self]) -> Self {
        Self {
            mean: frames.iter().map(|e| e.mean).sum::<f64>() / frames.len().max(1) as f64,
            largest: frames.iter().map(|e| e.largest).fold(0.0, f64::max),
        }
    }
}

/// A set whose clothing is tied to its bodies and freed from their poses.
#[derive(Debug, Clone)]
pub struct Unposed<'a> {
    model: &'a SmplModel,
    set: &'a LayerSet,
    association: &'a Association,
    standard: StandardPose,
    /// Offsets, a row for each frame of [`LayerSet::each_frame`], metres, `[frames, 3 · n_v · n_f]`.
    pub rows: Array2<f64>,
}

impl<'a> Unposed<'a> {
    /// Takes the poses out of all frames.
    pub fn new(
        model: &'a SmplModel,
        set: &'a LayerSet,
        association: &'a Association,
        standard: StandardPose,
    ) -> Result<Self> {
        let frames = set.each_frame();
        let numbers = 3 * association.clothing_vertices() * association.neighbours();
        let rows: Vec<Vec<f64>> = frames
            .par_iter()
            .map(|&(sequence, frame)| {
                let sequence = &set.sequences[sequence];
                let body = sequence.body(model, frame, &standard)?;
                let clothing = sequence.clothing.index_axis(Axis(0), frame);
                Ok(association.offsets(&body, clothing)?.into_iter().collect())
            })
            .collect::<Result<_>>()?;
        let rows = Array2::from_shape_vec((frames.len(), numbers), rows.concat())
            .map_err(|error| Error::argument(error.to_string()))?;
        Ok(Self { model, set, association, standard, rows })
    }

    /// Errors of offsets `[n, 3 · n_v · n_f]` for the frames numbered `frames`, in order.
    pub fn errors(
        &self,
        frames: &[usize],
        offsets: ArrayView2<'_, f64>,
    ) -> Result<Vec<LayerError>> {
        if offsets.nrows() != frames.len() {
            return Err(Error::argument(format!(
                "offsets of {} frames, expected {}",
                offsets.nrows(),
                frames.len()
            )));
        }
        let each = self.set.each_frame();
        let shape = (self.association.clothing_vertices(), self.association.neighbours(), 3);
        frames
            .par_iter()
            .zip(offsets.axis_iter(Axis(0)).into_par_iter())
            .map(|(&index, offsets)| {
                let (sequence, frame) = *each
                    .get(index)
                    .ok_or_else(|| Error::argument(format!("no frame {index} in the set")))?;
                let sequence = &self.set.sequences[sequence];
                let offsets = offsets
                    .into_shape_with_order(shape)
                    .map_err(|error| Error::argument(error.to_string()))?;
                let body = sequence.body(self.model, frame, &self.standard)?;
                let found = self.association.dress(&body, offsets)?;
                Ok(LayerError::between(&found, sequence.clothing.index_axis(Axis(0), frame)))
            })
            .collect()
    }

    /// Reconstruction error of each sequence by its own principal components (table 1): for each of
    /// `counts`, and with all components last. `[sequences, counts + 1]`
    pub fn reconstruction(&self, counts: &[usize]) -> Result<Vec<Vec<LayerError>>> {
        let mut start = 0;
        let mut table = Vec::new();
        for sequence in &self.set.sequences {
            let frames: Vec<usize> = (start..start + sequence.frames()).collect();
            start += sequence.frames();
            let rows = self.rows.select(Axis(0), &frames);
            let all = LayerPca::fit(rows.view(), Keep::All)?;
            let kept = counts.iter().copied().chain([all.len()]);
            let errors = kept.map(|count| {
                let pca = all.truncated(count);
                let back = pca.decode(pca.encode(rows.view())?.view())?;
                Ok(LayerError::over(&self.errors(&frames, back.view())?))
            });
            table.push(errors.collect::<Result<_>>()?);
        }
        Ok(table)
    }

    /// Inputs of the regression, `[frames, inputs]`, and which of them are semantic parameters.
    pub fn inputs(&self, features: &Features) -> Result<(Array2<f64>, Vec<bool>)> {
        let mut rows: Vec<f64> = Vec::new();
        let mut noisy = Vec::new();
        for sequence in &self.set.sequences {
            let motion = features.rows(&sequence.motion);
            noisy = vec![false; motion.ncols()];
            noisy.extend(sequence.parameters.iter().map(|_| true));
            for row in motion.rows() {
                rows.extend(row);
                rows.extend(sequence.parameters.iter().map(|p| p.1));
            }
        }
        let inputs = Array2::from_shape_vec((self.set.frames(), noisy.len()), rows)
            .map_err(|error| Error::argument(error.to_string()))?;
        Ok((inputs, noisy))
    }

    /// Regression of the first `components` coordinates (table 2): the errors of clothing predicted
    /// for training and for held-out frames, and what was trained.
    pub fn regression(
        &self,
        components: usize,
        features: &Features,
        training: &Training,
        watch: &mut dyn FnMut(Epoch),
    ) -> Result<Regression> {
        let all: Vec<usize> = (0..self.rows.nrows()).collect();
        let (pca, outcome) = self.learn(&all, components, features, training, watch)?;
        let inputs = self.inputs(features)?.0;
        let error_of = |frames: &[usize]| self.predicted(&pca, &outcome, &inputs, frames);
        let (train, predict) =
            (error_of(&outcome.training_frames)?, error_of(&outcome.validation_frames)?);
        Ok(Regression { pca, outcome, train, predict })
    }

    /// The same from all sequences but those numbered `held`, whose error is the prediction's: new
    /// bodies, motions, materials or sizes, as the set has them.
    pub fn transfer(
        &self,
        held: &[usize],
        components: usize,
        features: &Features,
        training: &Training,
        watch: &mut dyn FnMut(Epoch),
    ) -> Result<Regression> {
        let each = self.set.each_frame();
        let (new, known): (Vec<usize>, Vec<usize>) =
            (0..each.len()).partition(|&frame| held.contains(&each[frame].0));
        if new.is_empty() || known.is_empty() {
            return Err(Error::argument(format!(
                "{} of {} frames held out: expected some, not all",
                new.len(),
                each.len()
            )));
        }
        let (pca, outcome) = self.learn(&known, components, features, training, watch)?;
        let inputs = self.inputs(features)?.0;
        let trained: Vec<usize> = outcome.training_frames.iter().map(|&k| known[k]).collect();
        let train = self.predicted(&pca, &outcome, &inputs, &trained)?;
        let predict = self.predicted(&pca, &outcome, &inputs, &new)?;
        Ok(Regression { pca, outcome, train, predict })
    }

    fn learn(
        &self,
        frames: &[usize],
        components: usize,
        features: &Features,
        training: &Training,
        watch: &mut dyn FnMut(Epoch),
    ) -> Result<(LayerPca, Outcome)> {
        let rows = self.rows.select(Axis(0), frames);
        let pca = LayerPca::fit(rows.view(), Keep::Components(components))?;
        let codes = pca.encode(rows.view())?;
        let (inputs, noisy) = self.inputs(features)?;
        let inputs = inputs.select(Axis(0), frames);
        let outcome = training.train(inputs.view(), codes.view(), &noisy, watch)?;
        Ok((pca, outcome))
    }

    fn predicted(
        &self,
        pca: &LayerPca,
        outcome: &Outcome,
        inputs: &Array2<f64>,
        frames: &[usize],
    ) -> Result<LayerError> {
        let codes = outcome.regressor.predict(inputs.select(Axis(0), frames).view())?;
        Ok(LayerError::over(&self.errors(frames, pca.decode(codes.view())?.view())?))
    }
}

/// A regression and its errors.
#[derive(Debug, Clone, PartialEq)]
pub struct Regression {
    /// The space that is predicted in.
    pub pca: LayerPca,
    /// The regressor and its course.
    pub outcome: Outcome,
    /// Over frames that trained, `E_train`. Frames are counted among those that were learned from.
    pub train: LayerError,
    /// Over frames that did not, `E_pred`.
    pub predict: LayerError,
}

#[cfg(test)]
mod tests {
    use cape_core::synth::{Motion as Movement, MotionStyle, synthetic_body};
    use ndarray::Array3;

    use super::*;
    use crate::{
        AssociateOptions, Layer,
        cloth::{Garment, GarmentKind},
        geometry::Surface,
        regress::Motion,
        sequence::Sequence,
    };

    /// A skirt that follows the hips and swings with the knees, in 60 frames of a march.
    fn set(model: &SmplModel) -> LayerSet {
        let (frames, rate) = (60, 30.0);
        let style = MotionStyle::default();
        let poses: Vec<f64> =
            (0..frames).flat_map(|f| Movement::WalkMarch.pose(&style, f as f64 / rate)).collect();
        let poses = Array2::from_shape_vec((frames, 72), poses).unwrap();
        let motion = Motion::new(rate, poses, Array2::zeros((frames, 3))).unwrap();
        let shape = model.shaped(&[]).unwrap();
        let skirt = Garment::of(GarmentKind::Skirt).sew(model, &shape).unwrap().surface;
        let clothing = Array3::from_shape_fn((frames, skirt.vertices.len(), 3), |(f, v, axis)| {
            let p = skirt.vertices[v];
            let knees = motion.poses[(f, 12)] - motion.poses[(f, 15)];
            p[axis] + if axis == 2 { 0.1 * knees * (-0.1 - p.y).max(0.0) * p.x } else { 0.0 }
        });
        let sequence = Sequence {
            name: "march".into(),
            clothing,
            betas: vec![],
            motion,
            parameters: vec![("length".into(), 0.85)],
        };
        LayerSet::new(skirt.faces, vec![sequence]).unwrap()
    }

    #[test]
    fn a_skirt_survives_the_round_trip_and_is_learned() {
        let model = synthetic_body();
        let set = set(&model);
        let standard = StandardPose::default();
        let body = set.sequences[0].body(&model, 0, &standard).unwrap();
        let body = Surface::new("body", body.posed, model.faces.clone()).unwrap();
        let clothing = set.clothing(0, 0).unwrap();
        let association = AssociateOptions::default().associate(&body, &clothing).unwrap();
        let unposed = Unposed::new(&model, &set, &association, standard).unwrap();
        let frames: Vec<usize> = (0..set.frames()).collect();
        let exact = unposed.errors(&frames, unposed.rows.view()).unwrap();
        assert!(exact.iter().all(|e| e.largest < 1e-6), "{exact:?}");
        let table = unposed.reconstruction(&[1, 5, 20]).unwrap();
        let means: Vec<f64> = table[0].iter().map(|e| e.mean).collect();
        println!("reconstruction with 1, 5, 20 and all components: {means:?} mm");
        assert!(means.windows(2).all(|pair| pair[1] <= pair[0]) && means[3] < 1e-3, "{means:?}");
        let training = Training { patience: 5, ..Training::default() };
        let regression =
            unposed.regression(10, &Features::default(), &training, &mut |_| {}).unwrap();
        println!("regression: {:?} {:?}", regression.train, regression.predict);
        assert!(regression.train.mean < 5.0 && regression.predict.mean < 20.0);

        let mut two = set.clone();
        two.sequences.push(Sequence { name: "again".into(), ..set.sequences[0].clone() });
        let both = Unposed::new(&model, &two, &association, StandardPose::default()).unwrap();
        let features = Features::default();
        let same = both.transfer(&[1], 10, &features, &training, &mut |_| {}).unwrap();
        assert_eq!(same.outcome, regression.outcome, "the held-out sequence plays no part");
        assert!(same.predict.mean < 5.0, "{:?}", same.predict);
        assert!(both.transfer(&[], 10, &features, &training, &mut |_| {}).is_err());

        let layer = Layer {
            faces: set.faces.clone(),
            association: association.clone(),
            standard: StandardPose::Other(StandardPose::A.angles(24)),
            pca: regression.pca,
            features: Features::default(),
            parameters: vec!["length".into()],
            regressor: regression.outcome.regressor,
        };
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("layer.npz");
        layer.save(&path).unwrap();
        let back = Layer::load(&path, model.vertices()).unwrap();
        assert_eq!(
            (&back.regressor, &back.pca, &back.faces),
            (&layer.regressor, &layer.pca, &layer.faces)
        );
        assert_eq!((&back.parameters, &back.standard), (&layer.parameters, &layer.standard));
        let sequence = &set.sequences[0];
        let shape = sequence.shape(&model).unwrap();
        let mut errors = Vec::new();
        back.predict(&model, &shape, &sequence.motion, &[0.85], &mut |frame, clothing| {
            let truth = sequence.clothing.index_axis(Axis(0), frame);
            errors.push(LayerError::between(&clothing, truth));
            Ok(())
        })
        .unwrap();
        assert_eq!(errors.len(), 60);
        let held =
            regression.outcome.training_frames.iter().map(|&f| errors[f]).collect::<Vec<_>>();
        assert!((LayerError::over(&held).mean - regression.train.mean).abs() < 1e-9);
        let none = back.predict(&model, &shape, &sequence.motion, &[], &mut |_, _| Ok(()));
        assert!(none.unwrap_err().to_string().contains("expected 1: length"));
        assert!(Layer::load(&path, 10).is_err());
    }
}
