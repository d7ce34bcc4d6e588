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
/// use cape_layer::regress::TrainingOptions;
/// use ndarray::Array2;
///
/// // Learn a straight line from 40 points.
/// let x = Array2::from_shape_fn((40, 1), |(row, _)| row as f64);
/// let y = x.mapv(|x| 2.0 * x + 1.0);
/// let training = TrainingOptions { hidden: vec![4], patience: 20, ..TrainingOptions::default() };
/// let mut iterations = 0;
/// let outcome = training.train(x.view(), y.view(), &[false], &mut |_| iterations += 1)?;
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
    /// Consecutive rises of the validation error after which training continues; the paper stops when
    /// the error starts to increase, 0.
    pub patience: usize,
    /// Copies of the training frames with Gaussian noise on the noisy inputs.
    pub copies: usize,
    /// Standard deviation of the noise, relative to that of the input.
    pub noise: f64,
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
            patience: 0,
            copies: 0,
            noise: 0.05,
            minimiser: LbfgsOptions {
                steps: 500,
                gradient: 1e-8,
                gain: 0.0,
                ..LbfgsOptions::default()
            },
            seed: 1,
        }
    }
}

/// One iteration. Errors are mean squared errors of the standardised targets.
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

    /// Trains a regressor from `inputs` `[frames, inputs]` to `targets` `[frames, outputs]` by
    /// L-BFGS on the mean squared error of the standardised targets. `noisy` marks the inputs that
    /// get noise in the additional copies, usually the semantic parameters. `watch` is called after
    /// each iteration.
    ///
    /// # Errors
    /// If shapes differ, there are fewer than two frames, numbers are not finite, or an option is
    /// out of range.
    pub fn train(
        &self,
        inputs: ArrayView2<'_, f64>,
        targets: ArrayView2<'_, f64>,
        noisy: &[bool],
        watch: &mut dyn FnMut(Epoch),
    ) -> Result<TrainedRegressor> {
        let frames = inputs.nrows();
        self.check(inputs, targets, noisy)?;
        let (training_frames, validation_frames) = self.split(frames);
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(1);
        let pick = |rows: ArrayView2<'_, f64>, frames: &[usize]| rows.select(Axis(0), frames);
        let plain = pick(inputs, &training_frames);
        let wanted = pick(targets, &training_frames);
        let (of_inputs, of_targets) =
            (Standardiser::from_rows(plain.view()), Standardiser::from_rows(wanted.view()));
        let (plain, wanted) = (of_inputs.bounded(plain.view()), of_targets.apply(wanted.view()));
        let (x, y) = self.augmented(&plain, &wanted, noisy, &mut rng)?;
        let held_x = of_inputs.bounded(pick(inputs, &validation_frames).view());
        let held_y = of_targets.apply(pick(targets, &validation_frames).view());

        let mut sizes = vec![inputs.ncols()];
        sizes.extend(&self.hidden);
        sizes.push(targets.ncols());
        let mut network = Network::random(&sizes, &mut rng)?;
        let start = network.parameters().clone();
        let validate =
            |at: &Array1<f64>| network.error_and_gradient(at, held_x.view(), held_y.view()).0;
        let mut best = (validate(&start), start.clone());
        let (mut last, mut rises) = (best.0, 0);
        let mut epochs = Vec::new();
        let minimised = minimise_while(
            start.to_vec(),
            &self.minimiser,
            |at, gradient| {
                let at = ArrayView1::from(at).to_owned();
                let (error, slopes) = network.error_and_gradient(&at, x.view(), y.view());
                gradient.iter_mut().zip(slopes).for_each(|(to, slope)| *to = slope);
                Ok::<_, Infallible>(error)
            },
            |at, training| {
                let at = ArrayView1::from(at).to_owned();
                let validation = validate(&at);
                let epoch = Epoch { iteration: epochs.len() + 1, training, validation };
                watch(epoch);
                epochs.push(epoch);
                if validation < best.0 {
                    best = (validation, at);
                }
                rises = if validation > last { rises + 1 } else { 0 };
                last = validation;
                rises <= self.patience
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
        for _ in 0..self.copies {
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

    fn check(
        &self,
        inputs: ArrayView2<'_, f64>,
        targets: ArrayView2<'_, f64>,
        noisy: &[bool],
    ) -> Result<()> {
        if inputs.nrows() != targets.nrows() || inputs.nrows() < 2 {
            return Err(Error::argument(format!(
                "training: {} rows of inputs and {} of targets, expected equal numbers, at least 2",
                inputs.nrows(),
                targets.nrows()
            )));
        }
        if noisy.len() != inputs.ncols() {
            return Err(Error::argument(format!(
                "training: {} noise flags, expected one for each of {} inputs",
                noisy.len(),
                inputs.ncols()
            )));
        }
        if !(self.validation > 0.0 && self.validation < 1.0) {
            return Err(Error::argument(format!(
                "training: validation share {}, expected between 0 and 1",
                self.validation
            )));
        }
        if !(self.noise >= 0.0 && self.noise.is_finite()) {
            return Err(Error::argument(format!(
                "training: noise {}, expected 0 or more",
                self.noise
            )));
        }
        expect_finite("inputs", inputs)?;
        Ok(expect_finite("targets", targets)?)
    }
}
