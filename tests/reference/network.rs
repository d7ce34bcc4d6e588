//! The network, layer by layer, against the reference implementation.

use std::{collections::BTreeMap, path::Path};

use burn::tensor::{Device, Tensor};
use cape::{
    infer::DeviceBatch,
    model::{Cape, losses::LossWeights, release, weights},
    train::objective::{StepInput, evaluate},
};

use crate::fixture::{Fixture, deviation, norm};

const OUTPUT: f64 = 1e-4;
const LOSS: f64 = 1e-5;
const GRADIENT: f64 = 1e-3;
const ONE_GRADIENT: f64 = 5e-3;

pub fn check(path: &Path, device: &Device, report: &mut dyn FnMut(String)) {
    let mut fixture = Fixture::open(path, &device.clone().autodiff());
    let model = build(&fixture);
    outputs(&mut fixture, &model, report);
    losses(&mut fixture, &model, report);
    gradients(&mut fixture, &model, report);
}

/// The reference's weights in our model.
pub fn build(fixture: &Fixture) -> Cape {
    let model = Cape::new(&fixture.config, &fixture.graphs, 0, &fixture.device).unwrap();
    let imported = release::import(&fixture.config, &fixture.variables).unwrap();
    weights::apply(model, &imported).unwrap()
}

/// Frames of the reference's `prefix` (`in` or `train_in/k`), for `g` or `d`.
pub fn frames(fixture: &mut Fixture, prefix: &str, whose: &str) -> DeviceBatch {
    DeviceBatch {
        displacement: fixture.tensor(&format!("{prefix}/x_{whose}")),
        pose_feature: fixture.tensor(&format!("{prefix}/cond_{whose}")),
        outfit: fixture.tensor(&format!("{prefix}/cond2_{whose}")),
    }
}

fn values<const D: usize>(tensor: &Tensor<D>) -> Vec<f32> {
    tensor.clone().detach().into_data().try_into_vec().unwrap()
}

fn tap<'a>(
    taps: &'a mut BTreeMap<&'static str, Vec<Vec<f32>>>,
    of: &'static str,
) -> impl FnMut(usize, &Tensor<3>) + 'a {
    move |_, x| taps.entry(of).or_default().push(values(x))
}

pub fn outputs(fixture: &mut Fixture, model: &Cape, report: &mut dyn FnMut(String)) {
    let graphs = fixture.graphs.clone();
    let g = frames(fixture, "in", "g");
    let d = frames(fixture, "in", "d");
    let (generator, discriminator) = (&model.generator, model.discriminator.as_ref().unwrap());
    let discriminator_graph = graphs.discriminator.as_ref().unwrap();
    let mut found: Vec<(String, Vec<f32>)> = Vec::new();
    let mut taps: BTreeMap<&str, Vec<Vec<f32>>> = BTreeMap::new();
    let condition_g = generator.condition.forward(g.pose_feature.clone(), g.outfit.clone());
    let condition_d = generator.condition.forward(d.pose_feature.clone(), d.outfit.clone());
    let split = fixture.config.pose_embedding;
    for (whose, condition) in [("g", &condition_g), ("d", &condition_d)] {
        let Some(condition) = condition else { continue };
        let [batch, size] = condition.dims();
        let part = |from: usize, to: usize| values(&condition.clone().slice([0..batch, from..to]));
        found.push((format!("out/y_latent_{whose}"), part(0, split)));
        found.push((format!("out/y2_latent_{whose}"), part(split, size)));
    }
    let posterior = generator.encoder.forward_with(
        g.displacement.clone(),
        condition_g.as_ref(),
        &graphs.generator,
        &mut tap(&mut taps, "encoder"),
    );
    let z = posterior.sample(fixture.tensor("in/eps"));
    let x_hat = generator.decoder.forward_with(
        z.clone(),
        condition_g.as_ref(),
        &graphs.generator,
        &mut tap(&mut taps, "decoder"),
    );
    let real = discriminator.forward_with(
        d.displacement,
        condition_d.as_ref(),
        discriminator_graph,
        &mut tap(&mut taps, "discriminator"),
    );
    let fake = discriminator.forward_with(
        x_hat.clone(),
        condition_g.as_ref(),
        discriminator_graph,
        &mut tap(&mut taps, "discriminator+"),
    );
    found.push(("out/z_mean".into(), values(&posterior.mean)));
    found.push(("out/z_logvar".into(), values(&posterior.log_variance)));
    found.push(("out/z_sample".into(), values(&z)));
    found.push(("out/x_hat".into(), values(&x_hat)));
    found.push(("out/d_logits_real".into(), values(&real)));
    found.push(("out/d_logits_fake".into(), values(&fake)));

    let mut worst = (0.0, String::new());
    let mut note = |name: &str, deviation: f64| {
        assert!(deviation < OUTPUT, "{name}: deviation {deviation:.2e} of its norm");
        if deviation > worst.0 {
            worst = (deviation, name.to_owned());
        }
    };
    let mut checked = 0;
    for (name, found) in &found {
        if fixture.npz.contains(name) {
            note(name, deviation(found, &fixture.values(name)));
            checked += 1;
        }
    }
    for name in fixture.npz.names().into_iter().filter(|name| name.starts_with("tap/")) {
        let expected = fixture.values(&name);
        let Some((of, index)) = tap_of(&name) else {
            report(format!("{name}: not compared, of no known block"));
            continue;
        };
        let Some(found) = taps.get(of).and_then(|taps| taps.get(index)) else {
            panic!("{name}: no such block in {of}");
        };
        if found.len() == expected.len() {
            note(&name, deviation(found, &expected));
            checked += 1;
        } else {
            report(format!(
                "{name}: not compared, {} values against {}",
                expected.len(),
                found.len()
            ));
        }
    }
    report(format!(
        "{checked} outputs, largest deviation {:.1e} of the norm ({})",
        worst.0, worst.1
    ));
}

/// Block of a recorded tensor such as `tap/cnp_d:conv2+`; none for names of another kind.
fn tap_of(name: &str) -> Option<(&'static str, usize)> {
    let (method, block) = name.rsplit_once(':')?;
    let fake = block.ends_with('+');
    let block = block.trim_end_matches('+');
    let stem = block.trim_end_matches(|c: char| c.is_ascii_digit());
    let index: usize = block[stem.len()..].parse().ok()?;
    let of = if stem.contains("encoder") {
        "encoder"
    } else if stem.contains("decoder") || stem.contains("up") {
        "decoder"
    } else if method.ends_with("_d") {
        if fake { "discriminator+" } else { "discriminator" }
    } else {
        return None;
    };
    Some((of, index.checked_sub(1)?))
}

/// The step of the reference's `prefix` with the noise of that name.
pub fn step_input(fixture: &mut Fixture, prefix: &str, epsilon: &str) -> StepInput {
    StepInput {
        encoded: None,
        frames: frames(fixture, prefix, "g"),
        epsilon: Some(fixture.tensor(&format!("{prefix}/{epsilon}"))),
        real: Some(frames(fixture, prefix, "d")),
    }
}

fn losses(fixture: &mut Fixture, model: &Cape, report: &mut dyn FnMut(String)) {
    let input = step_input(fixture, "in", "eps");
    let losses =
        evaluate(model, &fixture.graphs, &fixture.loss, &LossWeights::default(), &input).losses;
    let mut worst: f64 = 0.0;
    for (name, found) in [
        ("recon", losses.reconstruction),
        ("latent", losses.kl),
        ("edge", losses.edge),
        ("fc_reg_g", losses.regularisation),
        ("gan_g", losses.gan_generator),
        ("gan_d", losses.gan_discriminator),
        ("total_g", losses.total_generator),
        ("total_d", losses.total_discriminator),
    ] {
        let expected = fixture.scalar(&format!("loss/{name}"));
        let deviation = (found - expected).abs() / expected.abs().max(1e-12);
        assert!(deviation < LOSS, "loss/{name}: {found} instead of {expected}");
        worst = worst.max(deviation);
    }
    report(format!("8 losses, largest deviation {worst:.1e} relative"));
}

fn gradients(fixture: &mut Fixture, model: &Cape, report: &mut dyn FnMut(String)) {
    let input = step_input(fixture, "in", "eps");
    let evaluation =
        evaluate(model, &fixture.graphs, &fixture.loss, &LossWeights::default(), &input);
    let shapes: Vec<(String, Vec<usize>)> =
        fixture.variables.iter().map(|(name, array)| (name.clone(), array.shape.clone())).collect();
    let names = release::name_map(&fixture.config, &shapes).unwrap();
    let generator = cape::train::optim::collect_gradients(&model.generator, &evaluation.generator);
    let discriminator = cape::train::optim::collect_gradients(
        model.discriminator.as_ref().unwrap(),
        evaluation.discriminator.as_ref().unwrap(),
    );
    for (kind, ours, part) in
        [("grad_g", &generator, "generator"), ("grad_d", &discriminator, "discriminator")]
    {
        let (mut difference, mut total, mut worst) = (0.0, 0.0, (0.0, String::new()));
        let mut count = 0;
        for (path, official) in &names {
            let key = format!("{kind}/{official}");
            let Some(local) = path.strip_prefix(&format!("{part}.")) else { continue };
            if !fixture.npz.contains(&key) {
                continue;
            }
            let expected = fixture.values(&key);
            let found = ours.get(local).unwrap_or_else(|| panic!("{path} has no gradient"));
            let one = deviation(&found.values, &expected);
            assert!(one < ONE_GRADIENT, "{key}: deviation {one:.2e} of its norm");
            let pairs = found.values.iter().zip(&expected);
            difference += pairs.map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
            total += norm(&expected).powi(2);
            count += 1;
            if one > worst.0 {
                worst = (one, official.clone());
            }
        }
        assert!(count > 0, "{kind}: nothing to compare");
        let whole = (difference / total).sqrt();
        assert!(whole < GRADIENT, "{kind}: deviation {whole:.2e} of the whole norm");
        report(format!(
            "{kind}: {count} gradients, {whole:.1e} of the whole, worst {:.1e} ({})",
            worst.0, worst.1
        ));
    }
}
