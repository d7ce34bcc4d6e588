//! Models of all kinds, and what the library computes with them.

use burn::{
    module::Module,
    tensor::{Device, Tensor},
};
use cape_core::{BodyPose, ClothingMask, Pose, SmplInput, tensors::from_array2, tensors::to_host};
use cape_data::DisplacementStatistics;
use cape_graph::Weighting;
use cape_infer::{BodySpec, ClothedModel, ClothedModelParts, RunConfig, build_graphs, normal};
use cape_model::{Cape, CapeConfig, DecoderBlock, DecoderConditions};
use cape_onnx::WeightPrecision;
use cape_synth::synthetic_body;
use ndarray::{Array2, ArrayD, IxDyn};

/// A model with initial weights and made-up statistics.
fn untrained(model: CapeConfig, weighting: Weighting) -> ClothedModel {
    let (device, body) = (Device::default(), synthetic_body());
    let model = CapeConfig { discriminator: None, ..model };
    let config = RunConfig { model, weighting, ..RunConfig::default() };
    let graphs = build_graphs(&config, &body, &device).unwrap();
    let generator = Cape::new(&config.model, &graphs, 3, &device).unwrap().generator.valid();
    let table = |low: f64, step: f64| {
        Array2::from_shape_fn((body.vertices(), 3), |(v, i)| low + step * ((v * 7 + i) % 13) as f64)
    };
    let parts = ClothedModelParts {
        config,
        mask: ClothingMask::from_weights(&body).unwrap(),
        statistics: DisplacementStatistics::new(table(-6e-5, 1e-5), table(0.001, 0.001), 1)
            .unwrap(),
        body,
    };
    ClothedModel::new(parts, generator, &device).unwrap()
}

/// Models by name, with the precision to export them in.
pub(crate) fn cases() -> Vec<(&'static str, ClothedModel, WeightPrecision)> {
    let untrained = untrained_cases().into_iter();
    let mut cases: Vec<_> =
        untrained.map(|(name, model)| (name, model, WeightPrecision::Single)).collect();
    // Its weights are half precision already.
    let built_in = cape_weights::pretrained(&Device::default()).unwrap();
    cases.push(("built-in", built_in.model().clone(), WeightPrecision::Half));
    cases
}

fn untrained_cases() -> Vec<(&'static str, ClothedModel)> {
    // Signals do not vanish in narrow networks with these weights.
    let tiny = CapeConfig { deviation: 0.4, ..CapeConfig::tiny() };
    let barycentric = Weighting::Barycentric;
    vec![
        ("paper", untrained(CapeConfig::paper(), barycentric)),
        ("detail", untrained(CapeConfig::detail(), barycentric)),
        ("small", untrained(CapeConfig::small(), barycentric)),
        ("release-weights", untrained(tiny.clone(), Weighting::Release)),
        (
            "affine-release-weights",
            untrained(
                CapeConfig { decoder: DecoderBlock::Affine, order: 3, ..tiny.clone() },
                Weighting::Release,
            ),
        ),
        (
            "plain",
            untrained(
                CapeConfig {
                    decoder: DecoderBlock::Plain,
                    decoder_conditions: DecoderConditions::Latent,
                    pose_layers: 1,
                    outfit_layers: 2,
                    encoder_residual: true,
                    order: 4,
                    ..tiny.clone()
                },
                barycentric,
            ),
        ),
        (
            "conditioned-encoder",
            untrained(
                CapeConfig { encoder_conditions: true, order: 3, reduce: 0, ..tiny.clone() },
                Weighting::Release,
            ),
        ),
        (
            "linear-path",
            untrained(CapeConfig { linear_path: true, ..tiny.clone() }, Weighting::Release),
        ),
        (
            "unconditional",
            untrained(
                CapeConfig {
                    decoder_conditions: DecoderConditions::None,
                    pose_embedding: 0,
                    outfit_embedding: 0,
                    decoder: DecoderBlock::Plain,
                    order: 1,
                    ..tiny
                },
                barycentric,
            ),
        ),
    ]
}

/// Poses from none at all to more than half a turn.
fn pose(example: usize) -> BodyPose {
    std::array::from_fn(|i| example as f32 * 0.9 * ((i * 37 + example) as f32).sin())
}

/// Inputs and the library's outputs of all three graphs for `n` bodies, by name.
pub(crate) fn expected(model: &ClothedModel, n: usize) -> Vec<(&'static str, ArrayD<f32>)> {
    let outfits = model.outfits();
    let bodies: Vec<BodySpec> = (0..n)
        .map(|i| BodySpec { betas: Vec::new(), pose: pose(i), outfit: outfits[i % outfits.len()] })
        .collect();
    let codes = model.sample_codes(n, 5);
    let condition = model.condition(&bodies).unwrap();
    let device = model.device();
    let displacement = model.decode(from_array2(codes.clone(), device), &condition);
    let posterior = model.posterior(displacement.clone(), &condition);
    let betas = normal(6, 0, n, model.body().betas());
    let translation = normal(7, 0, n, 3);
    let poses = Array2::from_shape_fn((n, 72), |(i, j)| pose(i)[j]);
    let posed = model
        .smpl()
        .forward(SmplInput {
            betas: from_array2(betas.clone(), device),
            pose: Pose::AxisAngle(from_array2(poses.clone(), device)),
            transl: from_array2(translation.clone(), device),
            displacement: Some(displacement.clone()),
        })
        .unwrap();
    vec![
        ("code", codes.into_dyn()),
        ("pose", poses.into_dyn()),
        ("outfit", host(condition.outfit)),
        ("displacement", host(displacement)),
        ("mean", host(posterior.mean)),
        ("log_variance", host(posterior.log_variance)),
        ("betas", betas.into_dyn()),
        ("translation", translation.into_dyn()),
        ("vertices", host(posed.vertices)),
        ("joints", host(posed.joints)),
    ]
}

fn host<const D: usize>(tensor: Tensor<D>) -> ArrayD<f32> {
    let shape = tensor.dims();
    ArrayD::from_shape_vec(IxDyn(&shape), to_host(tensor)).unwrap()
}
