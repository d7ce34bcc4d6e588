//! Is a configuration sound on these data?

use cape_model::LossConfig;
use serde::Serialize;

use super::{Fixtures, ModelUnderTest};
use crate::Result;
use cape_core::{ProgressFn, tensors::host};
use cape_infer::{DeviceBatch, OptimiserKind, RateSchedule, RunConfig, TrainConfig, to_device};
use cape_stats::errors::{ErrorStats, vertex_errors_mm};
use cape_train::{
    active_units,
    learner::{Learner, UpdateOptions, UpdateReport},
    objective::{StepInput, reconstruct},
};

/// How much is tried.
#[derive(Debug, Clone, Copy)]
pub struct CheckOptions {
    /// Frames to be learnt by heart.
    pub frames: usize,
    /// Most steps for that.
    pub overfit_steps: usize,
    /// Mean error to be reached, millimetres.
    pub target_mm: f64,
    /// Steps of the configuration itself.
    pub steps: usize,
}

impl Default for CheckOptions {
    fn default() -> Self {
        Self { frames: 16, overfit_steps: 2500, target_mm: 0.5, steps: 200 }
    }
}

/// One thing that was looked at.
#[derive(Debug, Clone, Serialize)]
pub struct Finding {
    /// What.
    pub name: &'static str,
    /// Whether it is as it should be.
    pub passed: bool,
    /// What was found.
    pub found: String,
    /// What was expected.
    pub expected: String,
}

/// All of them.
#[derive(Debug, Clone, Serialize)]
pub struct CheckReport {
    /// In the order of the work.
    pub findings: Vec<Finding>,
    /// Whether all passed.
    pub passed: bool,
}

/// Steps between measurements of what was learnt by heart.
const MEASURED: usize = 50;
/// Frames whose codes are looked at.
const CODES: usize = 256;
/// Accuracies between which a discriminator is neither dead nor perfect.
const ALIVE: [f64; 2] = [0.02, 0.98];
/// Below this the code says nothing.
const LEAST_KL: f64 = 0.05;

/// Learns a few frames by heart, then trains a little as the configuration says, and looks at what
/// usually goes wrong.
///
/// The frames are learnt without sampling, adversary and Kullback–Leibler term, by Adam: whether
/// the networks can represent clothes at all, and gradients are right, does not depend on those.
pub fn check(
    subject: &ModelUnderTest<'_>,
    options: CheckOptions,
    progress: &mut ProgressFn,
) -> Result<CheckReport> {
    let material = Fixtures::open(subject)?;
    let total = options.overfit_steps + options.steps;
    let mut findings = vec![overfit(&material, subject.config, &options, &mut |done, _| {
        progress(done, total);
    })?];
    let mut learner = material.learner(subject.config)?;
    let updates = train(&material, subject.config, &mut learner, options.steps, &mut |done, _| {
        progress(options.overfit_steps + done, total);
    })?;
    match updates {
        Ok(updates) => {
            findings.extend(check_updates(subject.config, &updates));
            findings.push(check_codes(&material, subject.config, &learner)?);
        }
        Err(found) => findings.push(Finding {
            name: "numbers are finite",
            passed: false,
            found,
            expected: "losses and gradients that are numbers".into(),
        }),
    }
    let passed = findings.iter().all(|finding| finding.passed);
    Ok(CheckReport { findings, passed })
}

fn overfit(
    material: &Fixtures,
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
    let rows = material.statistics.training_rows(material.set.frames());
    let count = options.frames.min(rows.len());
    let chosen: Vec<usize> = (0..count).map(|i| rows.start + i * rows.len() / count).collect();
    let batch = material.set.batch(&chosen, Some(&material.statistics))?;
    let fixed = to_device(batch.clone(), &material.device.clone().inner());
    let input = StepInput { frames: to_device(batch, &material.device), epsilon: None, real: None };
    let mut learner = material.learner(&config)?;
    let (mut best, mut steps) = (f64::INFINITY, 0);
    while steps < options.overfit_steps && best > options.target_mm {
        let rate = config.train.rate(steps as u64, options.overfit_steps);
        let pace = UpdateOptions { rate, kl_share: 0.0, detailed: false };
        if learner.update(&input, pace).is_err() {
            break;
        }
        steps += 1;
        if steps.is_multiple_of(MEASURED) || steps == options.overfit_steps {
            best = best.min(error_mm(material, &learner, &fixed)?);
        }
        progress(steps, options.overfit_steps);
    }
    progress(options.overfit_steps, options.overfit_steps);
    Ok(Finding {
        name: "learns frames by heart",
        passed: best <= options.target_mm,
        found: format!("{count} frames to {best:.2} mm in {steps} steps"),
        expected: format!("{} mm in {} steps", options.target_mm, options.overfit_steps),
    })
}

fn error_mm(material: &Fixtures, learner: &Learner, frames: &DeviceBatch) -> Result<f64> {
    let generator = learner.valid_generator();
    let result = reconstruct(&generator, learner.graphs(), frames, None);
    let mut predicted = host(result.displacement);
    let mut truth = host(frames.displacement.clone());
    material.statistics.denormalise(&mut predicted);
    material.statistics.denormalise(&mut truth);
    let size = material.set.vertices() * 3;
    let mut errors = ErrorStats::new();
    for (predicted, truth) in predicted.chunks(size).zip(truth.chunks(size)) {
        errors.push(&vertex_errors_mm(predicted, truth, &material.clothing)?);
    }
    Ok(errors.summary().mean)
}

/// The configuration as it is, its warm-up squeezed into a quarter of the steps; or what was not a
/// number.
fn train(
    material: &Fixtures,
    config: &RunConfig,
    learner: &mut Learner,
    steps: usize,
    progress: &mut ProgressFn,
) -> Result<Result<Vec<UpdateReport>, String>> {
    let mut batches = material.batches(config)?;
    let warmup = (steps / 4).max(1) as f64;
    let peak = config.train.peak_rate;
    let mut updates = Vec::new();
    for step in 0..steps {
        let rate = if config.train.warmup_epochs * batches.steps_per_epoch as f64 <= warmup {
            config.train.rate(step as u64, batches.steps_per_epoch)
        } else {
            peak * ((step + 1) as f64 / warmup).min(1.0)
        };
        let pace = UpdateOptions { rate, kl_share: 1.0, detailed: true };
        match learner.update(&batches.next()?, pace) {
            Ok(update) => updates.push(update),
            Err(what) => return Ok(Err(format!("{what} is not at step {}", step + 1))),
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
        ("reconstruction falls", (|u| u.losses.reconstruction) as fn(&UpdateReport) -> f64, true),
        ("edge error falls", |u| u.losses.edge, config.loss.edge > 0.0),
    ];
    for (name, of, asked) in falls {
        if asked {
            let (before, after) = (mean(first, of), mean(last, of));
            findings.push(Finding {
                name,
                passed: after < before,
                found: format!("{before:.3} → {after:.3}"),
                expected: "less than at first".into(),
            });
        }
    }
    if config.model.variational && config.loss.kl > 0.0 {
        let kl = mean(last, |u| u.losses.kl);
        findings.push(Finding {
            name: "the code says something",
            passed: kl > LEAST_KL,
            found: format!("a divergence of {kl:.2}"),
            expected: format!("more than {LEAST_KL}"),
        });
    }
    if config.model.discriminator.is_some() {
        let accuracy = mean(last, |u| u.losses.discriminator_accuracy);
        let [low, high] = ALIVE;
        findings.push(Finding {
            name: "the discriminator is neither dead nor perfect",
            passed: (low..=high).contains(&accuracy),
            found: format!("right for {:.0} % of patches", 100.0 * accuracy),
            expected: format!("{:.0} to {:.0} %", 100.0 * low, 100.0 * high),
        });
    }
    let norms: Vec<f64> = updates.iter().map(|update| update.generator_norm).collect();
    let clipped = norms.iter().filter(|&&norm| norm > config.train.clip).count();
    let least = norms.iter().copied().fold(f64::INFINITY, f64::min);
    let most = norms.iter().copied().fold(0.0, f64::max);
    findings.push(Finding {
        name: "gradients flow",
        passed: least > 0.0,
        found: format!("norms from {least:.2} to {most:.2}, {clipped} of {} clipped", norms.len()),
        expected: "none of them zero".into(),
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
                found: format!("a mean norm of {mean:.1e}"),
                expected: "none of them zero".into(),
            });
        }
    }
    findings
}

fn check_codes(material: &Fixtures, config: &RunConfig, learner: &Learner) -> Result<Finding> {
    let rows = material.statistics.training_rows(material.set.frames());
    let count = CODES.min(rows.len());
    let chosen: Vec<usize> = (0..count).map(|i| rows.start + i * rows.len() / count).collect();
    let generator = learner.valid_generator();
    let mut codes = Vec::new();
    for chosen in chosen.chunks(config.train.batch) {
        let batch = material.set.batch(chosen, Some(&material.statistics))?;
        let frames = to_device(batch, &material.device.clone().inner());
        codes.extend(host(reconstruct(&generator, learner.graphs(), &frames, None).posterior.mean));
    }
    let active = active_units(&codes, config.model.latent);
    Ok(Finding {
        name: "the code has not collapsed",
        passed: active > 0,
        found: format!("{active} of {} numbers are active", config.model.latent),
        expected: "at least one".into(),
    })
}
