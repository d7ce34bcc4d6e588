//! The first steps of training against a reference run.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
};

use burn::tensor::Device;
use cape::{
    core::npy::Npz,
    graph::Precision,
    infer::OptimiserKind,
    model::{
        Cape,
        losses::LossWeights,
        release,
        weights::{self, HostArray},
    },
    train::{
        objective::{Evaluation, StepInput, evaluate},
        optim::{Optimiser, global_norm},
    },
};
use serde::Deserialize;

use crate::{
    fixture::{Fixture, norm},
    network::{build, step_input},
};

const TOLERANCE: f64 = 1e-4;
/// Tolerance of the total losses with products in bfloat16, whose numbers have 8 bits, relative.
const BFLOAT16: f64 = 5e-3;
/// The same of gradient norms: gates and signs near zero, which gradients depend on, change.
const BFLOAT16_GRADIENTS: f64 = 0.15;
/// Relative change of the weights that crosses a kink of the leaky ReLU.
const NEARBY: f32 = 1e-6;
const ATTEMPTS: u64 = 24;
/// Steps of a run that may be beside a bend.
const BENDS: usize = 2;
/// Relative to the movement of each variable.
const WEIGHTS: f64 = 0.01;

#[derive(Deserialize)]
struct Run {
    fixture: String,
    momentum: f64,
    clip_norm: f64,
    regularization_effective: f64,
    steps: Vec<Step>,
}

#[derive(Deserialize)]
struct Step {
    #[serde(rename = "step")]
    number: usize,
    batch: usize,
    eps: String,
    lr_g: f64,
    lr_d: f64,
    #[serde(flatten)]
    listed: BTreeMap<String, f64>,
}

pub fn check(path: &Path, device: &Device, report: &mut dyn FnMut(String)) {
    let run: Run = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    let network = path.with_file_name(format!("network_{}.npz", run.fixture));
    let mut fixture = Fixture::open(&network, &device.clone().autodiff());
    fixture.loss.regularisation = run.regularization_effective;
    let mut model = build(&fixture);
    let before = weights::collect(&model);
    let mut generator_optimiser = Optimiser::new(OptimiserKind::Sgd, run.momentum, run.clip_norm);
    let mut discriminator_optimiser =
        Optimiser::new(OptimiserKind::Sgd, run.momentum, run.clip_norm);

    let mut worst = (0.0, String::new());
    let mut bends = BTreeSet::new();
    for step in &run.steps {
        let prefix = format!("train_in/{}", step.batch);
        let input = step_input(&mut fixture, &prefix, &step.eps);
        let mut compared = compare(&model, &fixture, &input, step);
        for seed in 0..ATTEMPTS {
            if compared.worst.0 < TOLERANCE {
                break;
            }
            // A unit within rounding of where its activation bends has one gradient or the other;
            // the reference's is then that of weights nearby. Whatever else is wrong stays wrong.
            let nearby = perturbed(&model, seed);
            let other = compare(&nearby, &fixture, &input, step);
            if other.worst.0 < compared.worst.0 {
                compared = other;
            }
            bends.insert(step.number);
        }
        assert!(
            compared.worst.0 < TOLERANCE,
            "step {}: {} deviates by {:.1e} relative",
            step.number,
            compared.worst.1,
            compared.worst.0
        );
        if compared.worst.0 > worst.0 {
            worst = compared.worst;
        }
        let Evaluation { generator: gradients_g, discriminator: gradients_d, .. } =
            compared.evaluation;
        let source = compared.model;
        let offset = (weights::collect(&model), weights::collect(&source));
        let (norm_g, norm_d) = compared.norms;
        let moved_g = generator_optimiser.step(source.generator, &gradients_g, norm_g, step.lr_g);
        let moved_d = discriminator_optimiser.step(
            source.discriminator.unwrap(),
            &gradients_d.unwrap(),
            norm_d,
            step.lr_d,
        );
        model = Cape { generator: moved_g, discriminator: Some(moved_d) };
        if offset.0 != offset.1 {
            let mut moved = weights::collect(&model);
            for (name, array) in &mut moved {
                let pairs = offset.0[name].values.iter().zip(&offset.1[name].values);
                array
                    .values
                    .iter_mut()
                    .zip(pairs)
                    .for_each(|(moved, (at, near))| *moved += at - near);
            }
            model = weights::apply(model, &moved).unwrap();
        }
    }
    assert!(bends.len() <= BENDS, "steps {bends:?} all match only beside a bend");
    if !bends.is_empty() {
        report(format!("steps {bends:?}: a unit within rounding of its activation's bend"));
    }
    report(format!(
        "{} steps, largest deviation {:.1e} relative ({})",
        run.steps.len(),
        worst.0,
        worst.1
    ));

    let stem = path.file_stem().unwrap().to_string_lossy();
    let mut after = Npz::open(path.with_file_name(format!("{stem}_after.npz"))).unwrap();
    let variables: Vec<(String, HostArray)> = after
        .names()
        .into_iter()
        .map(|key| {
            let array = after.f32(&key).unwrap();
            let name = key.strip_prefix("after/").unwrap_or(&key).to_owned();
            (
                name,
                HostArray {
                    shape: array.shape().to_vec(),
                    values: array.iter().copied().collect(),
                },
            )
        })
        .collect();
    let expected = release::import(&fixture.config, &variables).unwrap();
    let found = weights::collect(&model);
    let mut worst = (0.0, String::new());
    for (name, expected) in &expected {
        let moved = difference(&expected.values, &before[name].values);
        let off = difference(&found[name].values, &expected.values);
        assert!(off <= WEIGHTS * moved.max(1e-6), "{name}: off by {off:.2e}, moved {moved:.2e}");
        if moved > 0.0 && off / moved > worst.0 {
            worst = (off / moved, name.clone());
        }
    }
    report(format!(
        "{} weights, largest deviation {:.1e} of the way moved ({})",
        expected.len(),
        worst.0,
        worst.1
    ));
}

/// The same steps with products in bfloat16, from the reference's weights on: losses and norms stay near
/// those of the reference, as its own rounding allows.
pub fn check_in_bfloat16(path: &Path, device: &Device, report: &mut dyn FnMut(String)) {
    let Some(instructions) = Precision::Bf16.instructions() else {
        report(
            "not tested in bfloat16: this processor has neither AMX nor AVX-512 BF16".to_owned(),
        );
        return;
    };
    let run: Run = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    let network = path.with_file_name(format!("network_{}.npz", run.fixture));
    let mut fixture = Fixture::open(&network, &device.clone().autodiff());
    fixture.loss.regularisation = run.regularization_effective;
    fixture.graphs = fixture.graphs.clone().with_precision(Precision::Bf16);
    let mut model = build(&fixture);
    let mut generator = Optimiser::new(OptimiserKind::Sgd, run.momentum, run.clip_norm);
    let mut discriminator = generator.clone();
    let mut worst = (0.0, String::new());
    for step in &run.steps {
        let prefix = format!("train_in/{}", step.batch);
        let input = step_input(&mut fixture, &prefix, &step.eps);
        let Compared { evaluation, norms, worst: found, .. } =
            compare(&model, &fixture, &input, step);
        assert!(
            found.0 < BFLOAT16_GRADIENTS,
            "{} deviates by {:.1e} in bfloat16",
            found.1,
            found.0
        );
        for (name, total) in [
            ("total_g", evaluation.losses.total_generator),
            ("total_d", evaluation.losses.total_discriminator),
        ] {
            let off = (total / step.listed[name] - 1.0).abs();
            assert!(
                off < BFLOAT16,
                "{name} at step {} deviates by {off:.1e} in bfloat16",
                step.number
            );
        }
        if found.0 > worst.0 {
            worst = found;
        }
        let gradients = evaluation.discriminator.unwrap();
        model = Cape {
            generator: generator.step(model.generator, &evaluation.generator, norms.0, step.lr_g),
            discriminator: model
                .discriminator
                .map(|model| discriminator.step(model, &gradients, norms.1, step.lr_d)),
        };
    }
    assert!(worst.0 > TOLERANCE, "products are in single precision, not by {instructions}");
    report(format!(
        "{} steps in bfloat16 by {instructions}, largest deviation {:.1e} relative ({})",
        run.steps.len(),
        worst.0,
        worst.1
    ));
}

/// An evaluation beside the listed numbers of its step.
struct Compared {
    model: Cape,
    evaluation: Evaluation,
    norms: (f64, f64),
    /// The largest relative deviation, and of what.
    worst: (f64, String),
}

fn compare(model: &Cape, fixture: &Fixture, input: &StepInput, step: &Step) -> Compared {
    let evaluation =
        evaluate(model, &fixture.graphs, &fixture.loss, &LossWeights::default(), input);
    let losses = evaluation.losses;
    let norm_g = global_norm(&model.generator, &evaluation.generator);
    let norm_d = global_norm(
        model.discriminator.as_ref().unwrap(),
        evaluation.discriminator.as_ref().unwrap(),
    );
    let mut worst = (0.0, String::new());
    for (name, found) in [
        ("grad_norm_g", norm_g),
        ("grad_norm_d", norm_d),
        ("recon", losses.reconstruction),
        ("kl", losses.kl),
        ("edge", losses.edge),
        ("fc_reg_g", losses.regularisation),
        ("gan_g", losses.gan_generator),
        ("gan_d", losses.gan_discriminator),
        ("total_g", losses.total_generator),
        ("total_d", losses.total_discriminator),
    ] {
        let expected = step.listed[name];
        let deviation = (found - expected).abs() / expected.abs().max(1e-12);
        if deviation.is_nan() || deviation > worst.0 {
            let deviation = if deviation.is_nan() { f64::INFINITY } else { deviation };
            worst = (deviation, format!("{name} at step {}", step.number));
        }
    }
    Compared { model: model.clone(), evaluation, norms: (norm_g, norm_d), worst }
}

/// The model with every weight moved a little, at random.
fn perturbed(model: &Cape, seed: u64) -> Cape {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut moved = weights::collect(model);
    for array in moved.values_mut() {
        for value in &mut array.values {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            *value *= 1.0 + NEARBY * (state as f32 / u64::MAX as f32 * 2.0 - 1.0);
        }
    }
    weights::apply(model.clone(), &moved).unwrap()
}

fn difference(a: &[f32], b: &[f32]) -> f64 {
    let difference: Vec<f32> = a.iter().zip(b).map(|(a, b)| a - b).collect();
    norm(&difference)
}
