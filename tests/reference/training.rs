//! The first steps of training against a reference run.

use std::{collections::BTreeMap, path::Path};

use burn::tensor::Device;
use cape::{
    core::npy::Npz,
    model::{release, weights, weights::Array},
    train::{
        objective::evaluate,
        optim::{Momentum, global_norm},
    },
};
use serde::Deserialize;

use crate::{
    fixture::{Fixture, norm},
    network::{build, step_input},
};

const TOLERANCE: f64 = 1e-4;
/// Of how far each variable moved.
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
    let mut generator_optimiser = Momentum::new(run.momentum, run.clip_norm);
    let mut discriminator_optimiser = Momentum::new(run.momentum, run.clip_norm);

    let mut worst = (0.0, String::new());
    for step in &run.steps {
        let prefix = format!("train_in/{}", step.batch);
        let input = step_input(&mut fixture, &prefix, &step.eps);
        let evaluation = evaluate(&model, &fixture.graphs, &fixture.loss, &input);
        let losses = evaluation.losses;
        let (gradients_g, gradients_d) = (evaluation.generator, evaluation.discriminator.unwrap());
        let discriminator = model.discriminator.unwrap();
        let norm_g = global_norm(&model.generator, &gradients_g);
        let norm_d = global_norm(&discriminator, &gradients_d);
        let generator = generator_optimiser.step(model.generator, &gradients_g, norm_g, step.lr_g);
        let discriminator =
            discriminator_optimiser.step(discriminator, &gradients_d, norm_d, step.lr_d);
        model = cape::model::Cape { generator, discriminator: Some(discriminator) };

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
            assert!(
                deviation < TOLERANCE,
                "step {}: {name} is {found}, expected {expected}",
                step.number
            );
            if deviation > worst.0 {
                worst = (deviation, format!("{name} at step {}", step.number));
            }
        }
    }
    report(format!(
        "{} steps, largest deviation {:.1e} relative ({})",
        run.steps.len(),
        worst.0,
        worst.1
    ));

    let stem = path.file_stem().unwrap().to_string_lossy();
    let mut after = Npz::open(path.with_file_name(format!("{stem}_after.npz"))).unwrap();
    let variables: Vec<(String, Array)> = after
        .names()
        .into_iter()
        .map(|key| {
            let array = after.f32(&key).unwrap();
            let name = key.strip_prefix("after/").unwrap_or(&key).to_owned();
            (name, Array { shape: array.shape().to_vec(), values: array.iter().copied().collect() })
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

fn difference(a: &[f32], b: &[f32]) -> f64 {
    let difference: Vec<f32> = a.iter().zip(b).map(|(a, b)| a - b).collect();
    norm(&difference)
}
