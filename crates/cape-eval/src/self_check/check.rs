//! Check of a configuration on a data set by a short training.

use cape_model::LossConfig;
use serde::Serialize;

use super::{Fixtures, ModelUnderTest};
use crate::Result;
use cape_core::{ProgressFn, tensors::to_host};
use cape_infer::{DeviceBatch, OptimiserKind, RateSchedule, RunConfig, TrainConfig, to_device};
use cape_stats::errors::{ErrorStats, vertex_errors_mm};
use cape_train::{
    active_units,
    learner::{Learner, NonFinite, UpdateOptions, UpdateReport},
    objective::{StepInput, reconstruct},
};

/// Options of [`check`](check()).
#[derive(Debug, Clone, Copy)]
pub struct CheckOptions {
    /// Number of frames to overfit.
    pub frames: usize,
    /// Largest number of steps of overfitting.
    pub overfit_steps: usize,
    /// Mean error to reach by overfitting, millimetres.
    pub target_mm: f64,
    /// Steps of training with the configuration itself.
    pub steps: usize,
}

impl Default for CheckOptions {
    fn default() -> Self {
        Self { frames: 16, overfit_steps: 2500, target_mm: 0.5, steps: 200 }
    }
}

/// Result of one check.
#[derive(Debug, Clone, Serialize)]
pub struct Finding {
    /// Name of the check.
    pub name: &'static str,
    /// True if the check passed.
    pub passed: bool,
    /// Value found.
    pub found: String,
    /// Value expected.
    pub expected: String,
}

/// Results of all checks.
#[derive(Debug, Clone, Serialize)]
pub struct CheckReport {
    /// Results in the order of the checks.
    pub findings: Vec<Finding>,
    /// True if all checks passed.
    pub passed: bool,
}

/// Steps between measurements of the overfitting error.
const MEASURED: usize = 50;
/// Largest number of frames whose posterior means are checked.
const CODES: usize = 256;
/// Range of the accuracy of a discriminator that learns and does not win.
const ALIVE: [f64; 2] = [0.02, 0.98];
/// Smallest Kullback–Leibler divergence of an informative code.
const LEAST_KL: f64 = 0.05;

/// Overfits a few frames, trains for a few steps with the configuration itself, and checks losses,
/// gradients, discriminator and latent code.
///
/// Overfitting uses Adam without sampling, discriminator and Kullback–Leibler term, because it
/// tests the capacity of the networks and their gradients only.
pub fn check(
    model: &ModelUnderTest<'_>,
    options: CheckOptions,
    progress: &mut ProgressFn,
) -> Result<CheckReport> {
    let fixtures = Fixtures::open(model)?;
    let total = options.overfit_steps + options.steps;
    let mut findings = vec![overfit(&fixtures, model.config, &options, &mut |done, _| {
        progress(done, total);
    })?];
    let mut learner = fixtures.learner(model.config)?;
    let updates = train(&fixtures, model.config, &mut learner, options.steps, &mut |done, _| {
        progress(options.overfit_steps + done, total);
    })?;
    match updates {
        Ok(updates) => {
            findings.extend(check_updates(model.config, &updates));
            findings.push(check_codes(&fixtures, model.config, &learner)?);
        }
        Err((error, step)) => findings.push(Finding {
            name: "losses and gradients are finite",
            passed: false,
            found: format!("{error} at step {step}"),
            expected: "finite numbers".into(),
        }),
    }
    let passed = findings.iter().all(|finding| finding.passed);
    Ok(CheckReport { findings, passed })
}

fn overfit(
    fixtures: &Fixtures,
    config: &RunConfig,
    options: &CheckOptions,
    progress: &mut ProgressFn,
) -> Result<Finding> {
    let mut config = RunConfig {
        loss: LossConfig { kl: 0.0, gan: 0.0, regularisation: 0.0, ..config.loss.clone() },
        train: TrainConfig {
            optimiser: OptimiserKind::Adam,
            schedule: RateSchedule::Cosine,
            peak_rate: 2e-3,
            epochs: 1,
            warmup_epochs: 0.05,
            ema: 0.0,
            ..config.train.clone()
        },
        ..config.clone()
    };
    config.model.discriminator = None;
    let rows = fixtures.statistics.training_rows(fixtures.set.frames());
    let count = options.frames.min(rows.len());
    let chosen: Vec<usize> = (0..count).map(|i| rows.start + i * rows.len() / count).collect();
    let batch = fixtures.set.batch(&chosen, Some(&fixtures.statistics))?;
    let fixed = to_device(batch.clone(), &fixtures.device.clone().inner());
    let input = StepInput {
        frames: to_device(batch, &fixtures.device),
        encoded: None,
        epsilon: None,
        real: None,
    };
    let mut learner = fixtures.learner(&config)?;
    let (mut best, mut steps) = (f64::INFINITY, 0);
    while steps < options.overfit_steps && best > options.target_mm {
        let rate = config.train.rate(steps as u64, options.overfit_steps);
        let update = UpdateOptions { rate, kl_share: 0.0, detailed: false };
        if learner.update(&input, update).is_err() {
            break;
        }
        steps += 1;
        if steps.is_multiple_of(MEASURED) || steps == options.overfit_steps {
            best = best.min(error_mm(fixtures, &learner, &fixed)?);
        }
        progress(steps, options.overfit_steps);
    }
    progress(options.overfit_steps, options.overfit_steps);
    Ok(Finding {
        name: "overfits a few frames",
        passed: best <= options.target_mm,
        found: format!("{count} frames to {best:.2} mm in {steps} steps"),
        expected: format!("{} mm in {} steps", options.target_mm, options.overfit_steps),
    })
}

fn error_mm(fixtures: &Fixtures, learner: &Learner, frames: &DeviceBatch) -> Result<f64> {
    let generator = learner.valid_generator();
    let result = reconstruct(&generator, learner.graphs(), frames, None);
    let mut predicted = to_host(result.displacement);
    let mut truth = to_host(frames.displacement.clone());
    fixtures.statistics.denormalise(&mut predicted);
    fixtures.statistics.denormalise(&mut truth);
    let size = fixtures.set.vertices() * 3;
    let mut errors = ErrorStats::new();
    for (predicted, truth) in predicted.chunks(size).zip(truth.chunks(size)) {
        errors.push(&vertex_errors_mm(predicted, truth, &fixtures.clothing)?);
    }
    Ok(errors.summary().mean)
}

/// Trains with the configuration itself, its warm-up shortened to a quarter of the steps. Returns
/// the updates, or the step with a loss or gradient that is not finite.
fn train(
    fixtures: &Fixtures,
    config: &RunConfig,
    learner: &mut Learner,
    steps: usize,
    progress: &mut ProgressFn,
) -> Result<Result<Vec<UpdateReport>, (NonFinite, usize)>> {
    let mut batches = fixtures.batches(config)?;
    let warmup = (steps / 4).max(1) as f64;
    let peak = config.train.peak_rate;
    let mut updates = Vec::new();
    for step in 0..steps {
        let rate = if config.train.warmup_epochs * batches.steps_per_epoch as f64 <= warmup {
            config.train.rate(step as u64, batches.steps_per_epoch)
        } else {
            peak * ((step + 1) as f64 / warmup).min(1.0)
        };
        let options = UpdateOptions { rate, kl_share: 1.0, detailed: true };
        match learner.update(&batches.next()?, options) {
            Ok(update) => updates.push(update),
            Err(error) => return Ok(Err((error, step + 1))),
        }
        progress(step + 1, steps);
    }
    Ok(Ok(updates))
}

fn check_updates(config: &RunConfig, updates: &[UpdateReport]) -> Vec<Finding> {
    let part = (updates.len() / 5).max(1);
    let (first, last) = (&updates[..part], &updates[updates.len() - part..]);
    let mean = |updates: &[UpdateReport], of: fn(&UpdateReport) -> f64| {
        updates.iter().map(of).sum::<f64>() / updates.len() as f64
    };
    let mut findings = Vec::new();
    let falls = [
        (
            "reconstruction loss falls",
            (|u| u.losses.reconstruction) as fn(&UpdateReport) -> f64,
            true,
        ),
        ("edge loss falls", |u| u.losses.edge, config.loss.edge > 0.0),
    ];
    for (name, of, asked) in falls {
        if asked {
            let (before, after) = (mean(first, of), mean(last, of));
            findings.push(Finding {
                name,
                passed: after < before,
                found: format!("{before:.3} → {after:.3}"),
                expected: "a lower value at the end".into(),
            });
        }
    }
    if config.model.variational && config.loss.kl > 0.0 {
        let kl = mean(last, |u| u.losses.kl);
        findings.push(Finding {
            name: "latent code is informative",
            passed: kl > LEAST_KL,
            found: format!("KL divergence {kl:.2}"),
            expected: format!("more than {LEAST_KL}"),
        });
    }
    if config.model.discriminator.is_some() {
        let accuracy = mean(last, |u| u.losses.discriminator_accuracy);
        let [low, high] = ALIVE;
        findings.push(Finding {
            name: "discriminator learns and does not win",
            passed: (low..=high).contains(&accuracy),
            found: format!("accuracy {:.0} %", 100.0 * accuracy),
            expected: format!("{:.0} to {:.0} %", 100.0 * low, 100.0 * high),
        });
    }
    let norms: Vec<f64> = updates.iter().map(|update| update.generator_norm).collect();
    let clipped = norms.iter().filter(|&&norm| norm > config.train.clip).count();
    let least = norms.iter().copied().fold(f64::INFINITY, f64::min);
    let most = norms.iter().copied().fold(0.0, f64::max);
    findings.push(Finding {
        name: "gradients are not zero",
        passed: least > 0.0,
        found: format!("norms from {least:.2} to {most:.2}, {clipped} of {} clipped", norms.len()),
        expected: "all above zero".into(),
    });
    for (net, name) in
        ["gradients reach the pose net", "gradients reach the outfit net"].into_iter().enumerate()
    {
        let norms: Vec<f64> = updates.iter().filter_map(|u| u.condition_norms[net]).collect();
        if !norms.is_empty() {
            let mean = norms.iter().sum::<f64>() / norms.len() as f64;
            findings.push(Finding {
                name,
                passed: norms.iter().all(|&norm| norm > 0.0),
                found: format!("mean norm {mean:.1e}"),
                expected: "all above zero".into(),
            });
        }
    }
    findings
}

fn check_codes(fixtures: &Fixtures, config: &RunConfig, learner: &Learner) -> Result<Finding> {
    let rows = fixtures.statistics.training_rows(fixtures.set.frames());
    let count = CODES.min(rows.len());
    let chosen: Vec<usize> = (0..count).map(|i| rows.start + i * rows.len() / count).collect();
    let generator = learner.valid_generator();
    let mut codes = Vec::new();
    for chosen in chosen.chunks(config.train.batch) {
        let batch = fixtures.set.batch(chosen, Some(&fixtures.statistics))?;
        let frames = to_device(batch, &fixtures.device.clone().inner());
        codes.extend(to_host(
            reconstruct(&generator, learner.graphs(), &frames, None).posterior.mean,
        ));
    }
    let active = active_units(&codes, config.model.latent);
    Ok(Finding {
        name: "posterior has not collapsed",
        passed: active > 0,
        found: format!("{active} of {} latent dimensions active", config.model.latent),
        expected: "at least one".into(),
    })
}
