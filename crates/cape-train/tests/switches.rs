//! Every option of architecture and objective: the gradient agrees with finite differences, and
//! every parameter has one.

use burn::tensor::{Tensor, TensorData};
use cape_graph::Surface;
use cape_infer::{DeviceBatch, RunConfig, build_graphs};
use cape_model::{
    AdversarialLoss, Cape, CapeConfig, DecoderBlock, DecoderConditions, DisplacementUnit, Graphs,
    LossConfig, ReconstructionLoss,
    losses::{LossVertices, LossWeights},
    release,
    weights::{self, Weights},
};
use cape_train::{
    objective::{StepInput, evaluate},
    optim::collect_gradients,
};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};

/// A torus of 12 × 8 vertices.
fn torus() -> Surface {
    let (rings, sides) = (12u32, 8u32);
    let angle = |i: u32, n: u32| f64::from(i) / f64::from(n) * std::f64::consts::TAU;
    let mut torus = Surface { vertices: Vec::new(), faces: Vec::new() };
    for ring in 0..rings {
        for side in 0..sides {
            let (u, v) = (angle(ring, rings), angle(side, sides));
            let radius = 0.5 + 0.2 * v.cos() + 0.01 * (3.0 * u + v).sin();
            torus.vertices.push([radius * u.cos(), 0.2 * v.sin(), radius * u.sin()]);
            let at = |r: u32, s: u32| (r % rings) * sides + s % sides;
            let (a, b) = (at(ring, side), at(ring, side + 1));
            let (c, d) = (at(ring + 1, side), at(ring + 1, side + 1));
            torus.faces.extend([[a, b, c], [b, d, c]]);
        }
    }
    torus
}

struct Case {
    graphs: Graphs,
    model: Cape,
    loss: LossConfig,
    weights: LossWeights,
    input: StepInput,
    other: DeviceBatch,
}

impl Case {
    fn new(config: CapeConfig, loss: LossConfig) -> Self {
        let device = cape_core::parse_device(cape_core::DEVICES[0]).unwrap().autodiff();
        let run = RunConfig { model: config, ..RunConfig::default() };
        run.validate().unwrap();
        let torus = torus();
        let graphs = build_graphs(&run, &torus, &device).unwrap();
        let model = Cape::new(&run.model, &graphs, 3, &device).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let vertices = torus.vertices.len();
        let mut random = |shape: Vec<usize>| {
            let count = shape.iter().product::<usize>();
            let values: Vec<f32> = (0..count).map(|_| rng.random_range(-1.5..1.5)).collect();
            TensorData::new(values, shape)
        };
        let mut frames = || DeviceBatch {
            displacement: Tensor::from_data(random(vec![2, vertices, 3]), &device),
            pose_feature: Tensor::from_data(random(vec![2, 126]), &device),
            outfit: Tensor::from_data(random(vec![2, 4]), &device),
        };
        let (fitted, real, other) = (frames(), frames(), frames());
        let epsilon = Tensor::from_data(random(vec![2, run.model.latent]), &device);
        let input = StepInput {
            encoded: None,
            frames: fitted,
            epsilon: run.model.variational.then_some(epsilon),
            real: Some(real),
        };
        let deviations: Vec<f64> = (0..3 * vertices).map(|i| 0.001 * (1 + i % 7) as f64).collect();
        let clothing: Vec<usize> = (0..vertices / 2).collect();
        let of = LossVertices { deviations: &deviations, clothing: &clothing };
        let weights = LossWeights::new(&loss, of, graphs.discriminator.as_ref(), &device).unwrap();
        Self { graphs, model, loss, weights, input, other }
    }

    /// The same with the frames `other` encoded.
    fn with_encoded(mut self) -> Self {
        self.input.encoded = Some(self.other.clone());
        self
    }

    fn total(&self, model: &Cape) -> f64 {
        evaluate(model, &self.graphs, &self.loss, &self.weights, &self.input).losses.total_generator
    }

    fn check(&self, name: &str) {
        let evaluation =
            evaluate(&self.model, &self.graphs, &self.loss, &self.weights, &self.input);
        let gradients = collect_gradients(&self.model.generator, &evaluation.generator);
        let values = weights::collect(&self.model.generator);
        let variational = self.input.epsilon.is_some();
        let used = |path: &&String| variational || !path.contains("log_variance");
        for path in values.keys().filter(used) {
            assert!(gradients.contains_key(path), "{name}: {path} has no gradient");
        }
        let norm = |weights: &Weights| -> f64 {
            let all = weights.values().flat_map(|array| &array.values);
            all.map(|&x| f64::from(x).powi(2)).sum::<f64>().sqrt()
        };
        // The slope along the gradient is its norm, so that errors do not cancel. Kinks and
        // curvature disturb long steps and rounding disturbs short ones, so one length must agree.
        let slope = norm(&gradients);
        let along = |length: f64| {
            let total = self.total(&self.moved(&values, &gradients, length / slope))
                - self.total(&self.moved(&values, &gradients, -length / slope));
            total / (2.0 * length)
        };
        let found = [1e-3, 2e-4, 5e-5, 1e-5].map(along);
        let close = found.iter().any(|found| (found / slope - 1.0).abs() < 0.02);
        assert!(close, "{name}: slopes {found:?}, gradient {slope}");
    }

    /// The model with the generator's weights moved by `step` times the gradients.
    fn moved(&self, values: &Weights, gradients: &Weights, step: f64) -> Cape {
        let mut moved = values.clone();
        for (path, array) in &mut moved {
            let Some(gradient) = gradients.get(path) else { continue };
            for (value, gradient) in array.values.iter_mut().zip(&gradient.values) {
                *value += (step * f64::from(*gradient)) as f32;
            }
        }
        let generator = weights::apply(self.model.generator.clone(), &moved).unwrap();
        Cape { generator, discriminator: self.model.discriminator.clone() }
    }
}

/// Variants of the tiny model with one option changed, by name.
fn switches() -> Vec<(&'static str, CapeConfig)> {
    let tiny = CapeConfig::tiny;
    let plain = || CapeConfig {
        decoder: DecoderBlock::Plain,
        decoder_conditions: DecoderConditions::None,
        pose_embedding: 0,
        outfit_embedding: 0,
        ..tiny()
    };
    vec![
        ("residual", tiny()),
        ("affine", CapeConfig { decoder: DecoderBlock::Affine, ..tiny() }),
        ("plain, unconditional", plain()),
        ("plain auto-encoder", CapeConfig { variational: false, discriminator: None, ..plain() }),
        (
            "plain, conditioned code",
            CapeConfig {
                decoder: DecoderBlock::Plain,
                decoder_conditions: DecoderConditions::Latent,
                ..tiny()
            },
        ),
        ("residual encoder", CapeConfig { encoder_residual: true, ..tiny() }),
        ("conditioned encoder", CapeConfig { encoder_conditions: true, ..tiny() }),
        ("no 1×1 convolutions", CapeConfig { reduce: 0, ..tiny() }),
        ("deeper condition nets", CapeConfig { outfit_layers: 2, ..tiny() }),
        ("shallow condition nets", CapeConfig { pose_layers: 1, ..tiny() }),
        ("release's groups", CapeConfig { group_channels: None, ..tiny() }),
        ("first order", CapeConfig { order: 1, ..tiny() }),
        ("fourth order", CapeConfig { order: 4, ..tiny() }),
        ("no discriminator", CapeConfig { discriminator: None, ..tiny() }),
    ]
}

#[test]
fn gradients_follow_every_switch() {
    let linear = CapeConfig { linear_path: true, ..CapeConfig::tiny() };
    for (name, config) in switches().into_iter().chain([("linear path", linear)]) {
        Case::new(config, LossConfig::default()).check(name);
    }
}

/// The configuration is inferred from weights under the release's names, and the weights are
/// imported unchanged, in any order of the variables.
#[test]
fn every_switch_goes_by_the_releases_names_and_back() {
    for (name, config) in switches() {
        let model = Case::new(config.clone(), LossConfig::default()).model;
        let ours = weights::collect(&model);
        let mut theirs = release::export(&config, &ours).unwrap();
        theirs.sort_by(|(a, _), (b, _)| a.cmp(b));
        let shapes: Vec<(String, Vec<usize>)> =
            theirs.iter().map(|(name, array)| (name.clone(), array.shape.clone())).collect();
        // Sampling in training, groups and the layers of absent nets cannot be inferred.
        let pose_layers = if config.pose_embedding == 0 { 1 } else { config.pose_layers };
        let expected =
            CapeConfig { variational: true, pose_layers, group_channels: None, ..config.clone() };
        assert_eq!(release::infer(&shapes).unwrap(), expected, "{name}");
        assert_eq!(release::import(&config, &theirs).unwrap(), ours, "{name}");
    }
}

#[test]
fn gradients_follow_frames_that_are_encoded_instead() {
    for encoder_conditions in [false, true] {
        let config = CapeConfig { encoder_conditions, ..CapeConfig::tiny() };
        let case = Case::new(config, LossConfig::default()).with_encoded();
        case.check("encoded");
    }
    // The same frames give the same posterior as none, others give another.
    let mut case = Case::new(CapeConfig::tiny(), LossConfig::default());
    let kl = |case: &Case| {
        let Case { graphs, model, loss, weights, input, .. } = case;
        evaluate(model, graphs, loss, weights, input).losses.kl
    };
    let plain = kl(&case);
    case.input.encoded = Some(case.input.frames.clone());
    assert_eq!(kl(&case), plain);
    case.input.encoded = Some(case.other.clone());
    assert_ne!(kl(&case), plain);
}

#[test]
fn gradients_follow_every_reconstruction_loss() {
    for kind in [ReconstructionLoss::L1, ReconstructionLoss::L2, ReconstructionLoss::Huber] {
        let loss = LossConfig { kind, edge: 0.0, gan: 0.0, ..LossConfig::default() };
        Case::new(CapeConfig::tiny(), loss).check(&format!("{kind:?}"));
    }
}

#[test]
fn gradients_follow_the_weights_of_vertices_and_patches() {
    for adversary in [AdversarialLoss::Bce, AdversarialLoss::Hinge] {
        let loss = LossConfig {
            unit: DisplacementUnit::Metres,
            bare_weight: 0.3,
            clothing_patches: true,
            adversary,
            gan: 1.0,
            ..LossConfig::default()
        };
        let case = Case::new(CapeConfig::tiny(), loss);
        assert!(case.weights.vertices.is_some() && case.weights.patches.is_some());
        case.check(&format!("weighted, {adversary:?}"));
    }
}
