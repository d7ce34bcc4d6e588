//! Learning-rate range test (Smith 2017).

use serde::Serialize;

use super::{Fixtures, ModelUnderTest};
use crate::{Error, Result};
use cape_core::ProgressFn;
use cape_train::learner::UpdateOptions;

/// Options of [`find_rate`].
#[derive(Debug, Clone, Copy)]
pub struct RateSearchOptions {
    /// First learning rate.
    pub low: f64,
    /// Last learning rate, unless the loss diverges before.
    pub high: f64,
    /// Number of steps, with geometrically spaced learning rates.
    pub steps: usize,
}

impl Default for RateSearchOptions {
    fn default() -> Self {
        Self { low: 1e-5, high: 1.0, steps: 120 }
    }
}

/// A step of the range test.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct RatePoint {
    /// Learning rate of the generator.
    pub rate: f64,
    /// Total loss of the generator before the step.
    pub loss: f64,
    /// Exponential moving average of the losses.
    pub smoothed: f64,
}

/// Report of [`find_rate`].
#[derive(Debug, Clone, Serialize)]
pub struct RateSearchReport {
    /// All steps.
    pub points: Vec<RatePoint>,
    /// Learning rate of the lowest average loss.
    pub lowest: f64,
    /// Learning rate of the steepest fall of the average loss.
    pub steepest: f64,
    /// Learning rate at which the loss diverged; `None` if it did not.
    pub diverged: Option<f64>,
    /// Suggested learning rate: a third of [`lowest`](Self::lowest), or
    /// [`steepest`](Self::steepest) if the loss fell to the end.
    pub suggested: f64,
}

/// Time constant of the moving average, steps.
const MEMORY: f64 = 12.0;
/// Ratio of the average loss to its lowest value above which it has diverged.
const EXPLODED: f64 = 3.0;

/// Trains with a learning rate that grows from step to step until the loss diverges.
pub fn find_rate(
    model: &ModelUnderTest<'_>,
    options: RateSearchOptions,
    progress: &mut ProgressFn,
) -> Result<RateSearchReport> {
    let RateSearchOptions { low, high, steps } = options;
    if !(low > 0.0 && high > low && high.is_finite() && steps >= 10) {
        return Err(Error::argument(format!(
            "learning rates from {low} to {high} in {steps} steps: expected 0 < low < high and at \
             least 10 steps"
        )));
    }
    let fixtures = Fixtures::open(model)?;
    let mut learner = fixtures.learner(model.config)?;
    let mut batches = fixtures.batches(model.config)?;
    let mut curve = RateCurve::default();
    for step in 0..steps {
        let rate = low * (high / low).powf(step as f64 / (steps - 1) as f64);
        let update = UpdateOptions { rate, kl_share: 1.0, detailed: false };
        let loss = match learner.update(&batches.next()?, update) {
            Ok(update) => update.losses.total_generator,
            Err(_) => f64::INFINITY,
        };
        progress(step + 1, steps);
        if !curve.push(rate, loss) {
            break;
        }
    }
    curve.report()
}

#[derive(Default)]
struct RateCurve {
    points: Vec<RatePoint>,
    average: f64,
    diverged: Option<f64>,
}

impl RateCurve {
    /// Adds a step; false if the loss has diverged.
    fn push(&mut self, rate: f64, loss: f64) -> bool {
        let decay = 1.0 - 1.0 / MEMORY;
        let count = self.points.len() as i32 + 1;
        let average = decay * self.average + (1.0 - decay) * loss;
        let smoothed = average / (1.0 - decay.powi(count));
        let lowest = self.points.iter().map(|point| point.smoothed).fold(smoothed, f64::min);
        if !smoothed.is_finite() || smoothed > EXPLODED * lowest {
            self.diverged = Some(rate);
            return false;
        }
        self.average = average;
        self.points.push(RatePoint { rate, loss, smoothed });
        true
    }

    fn report(self) -> Result<RateSearchReport> {
        let Self { points, diverged, .. } = self;
        let lowest = points.iter().min_by(|a, b| a.smoothed.total_cmp(&b.smoothed));
        let Some(&RatePoint { rate: lowest, .. }) = lowest else {
            return Err(Error::argument(
                "the loss is not finite at the lowest learning rate: start at a lower one",
            ));
        };
        // The average of the first steps is of too few losses.
        let settled = points.get(MEMORY as usize..).unwrap_or_default();
        let falls =
            settled.windows(4).map(|four| (four[0].smoothed - four[3].smoothed, four[2].rate));
        let steepest = falls.max_by(|a, b| a.0.total_cmp(&b.0)).map_or(lowest, |(_, rate)| rate);
        let fell_to_the_end = points.last().is_some_and(|last| last.rate == lowest);
        let suggested = if diverged.is_none() && fell_to_the_end { steepest } else { lowest / 3.0 };
        Ok(RateSearchReport { points, lowest, steepest, diverged, suggested })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Report of the range test for a loss that is a function of the learning rate.
    fn report(loss: impl Fn(f64) -> f64) -> RateSearchReport {
        let mut curve = RateCurve::default();
        for step in 0..200 {
            let rate = 1e-5 * 1e5f64.powf(f64::from(step) / 199.0);
            if !curve.push(rate, loss(rate)) {
                break;
            }
        }
        curve.report().unwrap()
    }

    #[test]
    fn the_valley_and_the_divergence_are_found() {
        let found = report(|rate| {
            let decade = rate.log10();
            let fall = 2.0 - 1.5 / (1.0 + (-6.0 * (decade + 3.0)).exp());
            if rate > 0.1 { fall + 1e4 * (rate - 0.1) } else { fall }
        });
        assert!((1e-3..3e-3).contains(&found.steepest), "{}", found.steepest);
        assert!((3e-3..0.12).contains(&found.lowest), "{}", found.lowest);
        let diverged = found.diverged.unwrap();
        assert!((0.1..0.2).contains(&diverged), "{diverged}");
        assert!(found.suggested < found.lowest);
    }

    #[test]
    fn a_loss_that_never_rises_suggests_where_it_fell_fastest() {
        let found = report(|rate| 2.0 - 1.5 / (1.0 + (-6.0 * (rate.log10() + 3.0)).exp()));
        assert!(found.diverged.is_none());
        assert_eq!(found.suggested, found.steepest);
    }

    #[test]
    fn losses_that_are_not_finite_end_the_search() {
        let found = report(|rate| if rate > 1e-2 { f64::NAN } else { 1.0 - rate });
        assert!((1e-2..1.2e-2).contains(&found.diverged.unwrap()));
        let mut curve = RateCurve::default();
        assert!(!curve.push(1e-5, f64::NAN));
        assert!(curve.report().is_err());
    }
}
