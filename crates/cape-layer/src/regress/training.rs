use std::convert::Infallible;

use cape_core::optimise::{LbfgsOptions, minimise_while};
use ndarray::{Array1, Array2, ArrayView1, ArrayView2, Axis, concatenate};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng, seq::SliceRandom};
use rand_distr::StandardNormal;
use serde::Serialize;

use super::{Network, Regressor, regressor::Standardiser};
use crate::{Error, Result};
use cape_core::expect_finite;

/// Options of the training of a regressor (§3.3).
///
/// ```
/// use cape_layer::regress::{RegressionInputs, TrainingOptions};
/// use ndarray::Array2;
///
/// // Learn a straight line from 40 points.
/// let x = Array2::from_shape_fn((40, 1), |(row, _)| row as f64);
/// let y = x.mapv(|x| 2.0 * x + 1.0);
/// let training = TrainingOptions { hidden: vec![4], ..TrainingOptions::default() };
/// let mut iterations = 0;
/// let inputs = RegressionInputs::new(x.clone());
/// let outcome = training.train(&inputs, y.view(), &mut |_| iterations += 1)?;
/// assert_eq!((outcome.training_frames.len(), outcome.validation_frames.len()), (32, 8));
/// assert_eq!(outcome.epochs.len(), iterations);
/// let off = outcome.regressor.predict(x.view())? - y;
/// assert!(off.iter().all(|gap| gap.abs() < 8.0));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TrainingOptions {
    /// Units of the hidden layers; 60 and 80 in the paper.
    pub hidden: Vec<usize>,
    /// Share of the frames for validation; 20 % in the paper.
    pub validation: f64,
    /// Consecutive rises of the validation error after which training continues, or all iterations. The
    /// weights of the lowest validation error are kept. The paper stops when the error starts to increase,
    /// 0.
    pub patience: Option<usize>,
    /// Copies of the training frames with Gaussian noise on the noisy inputs, if there are any.
    pub copies: usize,
    /// Standard deviation of the noise, relative to that of the input.
    pub noise: f64,
    /// Weight of the mean square of the network's parameters in the objective, beside the mean squared
    /// error of the targets in units of their standard deviation.
    pub decay: f64,
    /// Options of L-BFGS.
    pub minimiser: LbfgsOptions,
    /// Random seed of weights, split and noise.
    pub seed: u64,
}

impl Default for TrainingOptions {
    fn default() -> Self {
        Self {
            hidden: vec![60, 80],
            validation: 0.2,
            patience: None,
            copies: 8,
            noise: 0.1,
            decay: 0.0,
            minimiser: LbfgsOptions {
                steps: 300,
                gradient: 1e-8,
                gain: 0.0,
                ..LbfgsOptions::default()
            },
            seed: 1,
        }
    }
}

/// Inputs of a regression.
#[derive(Debug, Clone, PartialEq)]
pub struct RegressionInputs {
    /// Inputs of each frame, `[frames, inputs]`.
    pub rows: Array2<f64>,
    /// Least standard deviation that each input is divided by, `[inputs]`; 0 for none.
    pub floors: Vec<f64>,
    /// True for the inputs that get noise in the additional copies, usually the semantic parameters,
    /// `[inputs]`.
    pub noisy: Vec<bool>,
    /// Group of each frame, `[frames]`, if whole groups shall be validated on, such as sequences.
    pub groups: Option<Vec<usize>>,
}

impl RegressionInputs {
    /// Inputs `[frames, inputs]` without noise, least deviations and groups.
    pub fn new(rows: Array2<f64>) -> Self {
        let inputs = rows.ncols();
        Self { rows, floors: vec![0.0; inputs], noisy: vec![false; inputs], groups: None }
    }

    /// The inputs of some frames.
    pub(crate) fn select(&self, frames: &[usize]) -> Self {
        let groups = self.groups.as_ref();
        Self {
            rows: self.rows.select(Axis(0), frames),
            groups: groups.map(|groups| frames.iter().map(|&frame| groups[frame]).collect()),
            ..self.clone()
        }
    }
}

/// One iteration. Errors are mean squared errors of the targets, in units of their common standard
/// deviation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Epoch {
    /// Iteration number, from 1.
    pub iteration: usize,
    /// Error on the training frames.
    pub training: f64,
    /// Error on the validation frames.
    pub validation: f64,
}

/// A trained regressor, its training curve and its split.
#[derive(Debug, Clone, PartialEq)]
pub struct TrainedRegressor {
    /// Regressor with the weights of the lowest validation error.
    pub regressor: Regressor,
    /// Errors after each iteration.
    pub epochs: Vec<Epoch>,
    /// Training frames, ascending.
    pub training_frames: Vec<usize>,
    /// Validation frames, ascending.
    pub validation_frames: Vec<usize>,
}

impl TrainingOptions {
    /// Random split of `frames` frames by the seed: training and validation frames, both ascending.
    pub fn split(&self, frames: usize) -> (Vec<usize>, Vec<usize>) {
        let mut order: Vec<usize> = (0..frames).collect();
        order.shuffle(&mut ChaCha8Rng::seed_from_u64(self.seed));
        let most = frames.saturating_sub(1).max(1);
        let held = ((frames as f64 * self.validation).round() as usize).clamp(1, most);
        let mut training = order.split_off(held.min(frames));
        training.sort_unstable();
        order.sort_unstable();
        (training, order)
    }

    /// [`split`](Self::split) of the frames of `inputs`: of whole groups, if it has several.
    pub(crate) fn split_inputs(&self, inputs: &RegressionInputs) -> (Vec<usize>, Vec<usize>) {
        let frames = inputs.rows.nrows();
        let Some(groups) = &inputs.groups else { return self.split(frames) };
        let mut distinct = groups.clone();
        distinct.sort_unstable();
        distinct.dedup();
        if distinct.len() < 2 {
            return self.split(frames);
        }
        let (_, held) = self.split(distinct.len());
        let held: Vec<usize> = held.into_iter().map(|k| distinct[k]).collect();
        (0..frames).partition(|&frame| !held.contains(&groups[frame]))
    }

    /// Trains a regressor from inputs to targets `[frames, outputs]` by L-BFGS on their mean squared
    /// error. `watch` is called after each iteration.
    ///
    /// # Errors
    /// If shapes differ, there are fewer than two frames, numbers are not finite, or an option is
    /// out of range.
    pub fn train(
        &self,
        inputs: &RegressionInputs,
        targets: ArrayView2<'_, f64>,
        watch: &mut dyn FnMut(Epoch),
    ) -> Result<TrainedRegressor> {
        self.check(inputs, targets)?;
        let (training_frames, validation_frames) = self.split_inputs(inputs);
        let RegressionInputs { rows: inputs, floors, noisy, .. } = inputs;
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(1);
        let pick = |rows: ArrayView2<'_, f64>, frames: &[usize]| rows.select(Axis(0), frames);
        let plain = pick(inputs.view(), &training_frames);
        let wanted = pick(targets, &training_frames);
        let of_inputs = Standardiser::from_rows(plain.view(), floors);
        let of_targets = Standardiser::common(wanted.view());
        let (plain, wanted) = (of_inputs.bounded(plain.view()), of_targets.apply(wanted.view()));
        let (x, y) = self.augmented(&plain, &wanted, noisy, &mut rng)?;
        let held_x = of_inputs.bounded(pick(inputs.view(), &validation_frames).view());
        let held_y = of_targets.apply(pick(targets, &validation_frames).view());

        let mut sizes = vec![inputs.ncols()];
        sizes.extend(&self.hidden);
        sizes.push(targets.ncols());
        let mut network = Network::random(&sizes, &mut rng)?;
        let start = network.parameters().clone();
        let units = network.parameter_units(x.view());
        let validate =
            |at: &Array1<f64>| network.error_and_gradient(at, held_x.view(), held_y.view()).0;
        let mut best = (validate(&start), start.clone());
        let (mut last, mut rises) = (best.0, 0);
        let mut epochs = Vec::new();
        let minimised = minimise_while(
            (&start / &units).to_vec(),
            &self.minimiser,
            |at, gradient| {
                let at = &ArrayView1::from(at) * &units;
                let (error, slopes) = network.error_and_gradient(&at, x.view(), y.view());
                let decay = self.decay / at.len() as f64;
                let slopes = (slopes + 2.0 * decay * &at) * &units;
                gradient.iter_mut().zip(slopes).for_each(|(to, slope)| *to = slope);
                Ok::<_, Infallible>(error + decay * at.dot(&at))
            },
            |at, training| {
                let at = &ArrayView1::from(at) * &units;
                let validation = validate(&at);
                let epoch = Epoch { iteration: epochs.len() + 1, training, validation };
                watch(epoch);
                epochs.push(epoch);
                if validation < best.0 {
                    best = (validation, at);
                }
                rises = if validation > last { rises + 1 } else { 0 };
                last = validation;
                self.patience.is_none_or(|patience| rises <= patience)
            },
        );
        let Ok(_) = minimised;
        network.set_parameters(best.1);
        let regressor = Regressor::new(of_inputs, network, of_targets)?;
        Ok(TrainedRegressor { regressor, epochs, training_frames, validation_frames })
    }

    fn augmented(
        &self,
        inputs: &Array2<f64>,
        targets: &Array2<f64>,
        noisy: &[bool],
        rng: &mut ChaCha8Rng,
    ) -> Result<(Array2<f64>, Array2<f64>)> {
        let mut x = vec![inputs.clone()];
        let mut y = vec![targets.view()];
        let copies = if noisy.contains(&true) { self.copies } else { 0 };
        for _ in 0..copies {
            let mut copy = inputs.clone();
            for mut row in copy.rows_mut() {
                for (value, _) in row.iter_mut().zip(noisy).filter(|&(_, &noisy)| noisy) {
                    *value += self.noise * rng.sample::<f64, _>(StandardNormal);
                }
            }
            x.push(copy);
            y.push(targets.view());
        }
        let stack = |parts: &[ArrayView2<'_, f64>]| {
            concatenate(Axis(0), parts).map_err(|error| Error::argument(error.to_string()))
        };
        let x: Vec<_> = x.iter().map(|copy| copy.view()).collect();
        Ok((stack(&x)?, stack(&y)?))
    }

    fn check(&self, inputs: &RegressionInputs, targets: ArrayView2<'_, f64>) -> Result<()> {
        let RegressionInputs { rows: inputs, floors, noisy, groups } = inputs;
        if inputs.nrows() != targets.nrows() || inputs.nrows() < 2 {
            return Err(Error::argument(format!(
                "training: {} rows of inputs and {} of targets, expected equal numbers, at least 2",
                inputs.nrows(),
                targets.nrows()
            )));
        }
        if [noisy.len(), floors.len()] != [inputs.ncols(); 2] {
            return Err(Error::argument(format!(
                "training: {} noise flags and {} least deviations, expected one for each of {} inputs",
                noisy.len(),
                floors.len(),
                inputs.ncols()
            )));
        }
        if groups.as_ref().is_some_and(|groups| groups.len() != inputs.nrows()) {
            return Err(Error::argument(format!(
                "training: expected a group for each of {} frames",
                inputs.nrows()
            )));
        }
        if !(self.validation > 0.0 && self.validation < 1.0) {
            return Err(Error::argument(format!(
                "training: validation share {}, expected between 0 and 1",
                self.validation
            )));
        }
        for (name, value) in [("noise", self.noise), ("weight decay", self.decay)] {
            if !(value >= 0.0 && value.is_finite()) {
                return Err(Error::argument(format!(
                    "training: {name} {value}, expected 0 or more"
                )));
            }
        }
        expect_finite("inputs", inputs)?;
        Ok(expect_finite("targets", targets)?)
    }
}
